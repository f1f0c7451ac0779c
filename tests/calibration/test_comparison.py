"""Models of one recording are compared; which of them is true is known."""

import json
from dataclasses import replace

import numpy as np
import pytest
from beams import FIT, beam, release

import softrod_jax as sr
from calibration import Model, compare, damped, write_log
from calibration.cli.common import UsageError
from calibration.cli.comparing import models_in
from calibration.cli.main import main
from calibration.problem import evaluation

QUIET = {"checks": False, "window": (0.0, 1.0), "progress": False, **FIT}
E, G, TAU = 2.9e5, 0.3, 0.04
LAWS = ("viscous", "one-branch", "two-branches")


@pytest.fixture(scope="module")
def creeping():
    """A beam that loses its swing by one branch, and by nothing else; two recordings of it."""
    truth = beam(young_modulus=E, bending_damping=None, relaxation=[[G, TAU]])
    return release(truth), release(truth, seed=5, name="other")


@pytest.fixture(scope="module")
def found(creeping):
    recording, other = creeping
    start = Model(beam(young_modulus=2.5e5), ("young_modulus", "bending_damping"))
    compiled = evaluation._compiled(evaluation._sensitivities)
    before = compiled._cache_size()
    found = compare(damped(start, LAWS), [recording], held_out=[other], **QUIET)
    # All laws ran through one program.
    assert compiled._cache_size() == before + 1
    return found


def test_one_branch_is_chosen_over_none_and_two(found):
    verdict = found.verdict
    assert verdict.chosen == "one-branch"
    viscous, one, two = verdict.candidates
    assert (viscous.numbers, one.numbers, two.numbers) == (3, 4, 6)  # with the clock
    assert verdict.bic[0] > 100 and verdict.bic[2] > 2
    assert viscous.predicted > 2 * one.predicted
    assert any("relaxation" in name for name in two.vague)
    for name, value in (("young_modulus", E), ("relaxation_part_1", G), ("relaxation_time_1", TAU)):
        low, high = found.best.parameters[name].ci95
        assert low < value < high
    # The scene that is handed back has what was chosen, and no trace of the others.
    assert found.best.scene.relaxation.shape == (1, 2)
    assert found.best.scene.bending_damping is None


def test_the_command_line_reports_the_comparison(found, creeping, tmp_path, capsys, monkeypatch):
    asked = {}

    def compared(models, recordings, **options):
        asked.update(options, models=models, recordings=recordings)
        return found

    monkeypatch.setattr("calibration.comparison.compare", compared)
    monkeypatch.setattr("calibration.cli.calibrate.prepare_jax", lambda: None)
    monkeypatch.setattr("calibration.report.writing.write_films", lambda *_: {})
    monkeypatch.setattr("calibration.report.writing.write_plots", lambda *_: {})
    scene, log, out = tmp_path / "rod.toml", tmp_path / "log.csv", tmp_path / "out"
    sr.save_scene(beam(), scene)
    write_log(log, creeping[0].times, tip_positions=creeping[0].tip_positions)
    call = ["calibrate", str(scene), str(log), "--fit", "young_modulus", "--compare"]
    assert main([*call, "--out", str(out)]) == 0
    assert tuple(asked["models"]) == LAWS and asked["models"]["viscous"].names[0] == E_NAME
    said = capsys.readouterr().out
    assert "one-branch *" in said and "The data ask for one-branch" in said
    content = json.loads((out / "parameters.json").read_text())
    assert content["comparison"]["chosen"] == "one-branch"
    assert set(content["comparison"]["models"]) == set(LAWS)
    assert "relaxation_part_1" in content["parameters"]
    assert "<h2>Models compared</h2>" in (out / "report.html").read_text()
    assert sr.load_scene(out / "scene.toml").relaxation.shape == (1, 2)
    assert main([*call, "--resume", "--out", str(out)]) == 2
    assert "keeps no checkpoints" in capsys.readouterr().err


E_NAME = "young_modulus"


def test_models_that_are_named(tmp_path):
    scene = beam(drag_coefficient=0.05)
    both = ["young_modulus,bending_damping", "young_modulus,bending_damping,drag_coefficient"]
    assert list(models_in(["+drag_coefficient"], scene, both[0])) == both
    assert list(models_in(both, scene, None)) == both
    assert list(models_in([], scene, None)) == list(LAWS)
    other = tmp_path / "rubber.toml"
    sr.save_scene(beam(), other)
    found = models_in([f"{other}:young_modulus", "viscous"], scene, both[0])
    assert list(found) == ["viscous", "rubber:young_modulus"]
    assert found["viscous"].names == ("young_modulus", "bending_damping")
    for words, motions, said in (
        (["viscous"], True, "name at least two"),
        (["viscous", "+density"], False, "an equilibrium"),
        (["+density"], False, "besides what"),
    ):
        with pytest.raises(UsageError, match=said):
            models_in(words, scene, None, motions)
    with pytest.raises(ValueError, match="unknown parameter"):
        models_in(["+wrong"], scene, None)


def test_starts_of_laws():
    """Branches begin where the rod rings; a scene that has them begins with its own."""
    plain = damped(Model(beam()), LAWS)["two-branches"].scene.relaxation
    # The first mode of a cantilever by Rayleigh: 3 E I / L^3 over 0.2427 of its mass.
    rings = np.sqrt(3 * E * 0.03**4 / 12 / 0.1**3 / (0.2427 * 1070 * 0.03**2 * 0.1))
    np.testing.assert_allclose(np.sqrt(plain[0, 1] * plain[1, 1]), 1 / rings, rtol=2e-3)
    assert plain[1, 1] == pytest.approx(10 * plain[0, 1])
    own = damped(Model(beam(relaxation=[[G, TAU]])), LAWS)
    np.testing.assert_allclose(own["one-branch"].scene.relaxation[0], [G, TAU])
    part = sr.Segment(length=0.1, section=sr.Circle(6e-3), young_modulus=E, bending_damping=1e-6)
    segmented = replace(beam(young_modulus=None), length=None, section=None, segments=(part,))
    with pytest.raises(ValueError, match=r"segments\[0\].bending_damping"):
        damped(Model(segmented, ("segments[0].young_modulus",)), LAWS)
    with pytest.raises(ValueError, match="no law of damping"):
        damped(Model(beam()), ("fractional",))


def test_options_of_a_comparison_are_checked(creeping):
    models = damped(Model(beam()), LAWS)
    for options, said in (
        (dict(bounds={"density": (1.0, 2.0)}), "fitted by none"),
        (dict(loss="tukey"), "weights would differ"),
    ):
        with pytest.raises(ValueError, match=said):
            compare(models, creeping, **options)
    with pytest.raises(ValueError, match="at least two"):
        compare({"one": Model(beam())}, creeping)
