"""Models of postures are compared; which of them is true is known."""

import json
from dataclasses import replace

import numpy as np
import pytest
from test_postures import GRID, MODULI, TENSIONS, measured, robot

import softrod_jax as sr
from calibration.cli.main import main
from calibration.parameters.laws import Model
from calibration.postures.compare import compare_postures

TIED = "segments[0].young_modulus=segments[1].young_modulus"


@pytest.fixture(scope="module")
def found():
    postures = measured(robot((2.0e5, 1.2e5)), TENSIONS)
    start = robot((1.5e5, 1.5e5))
    models = {"one": Model(start, (TIED,)), "two": Model(start, MODULI)}
    return compare_postures(models, postures, method=GRID)


def test_two_moduli_are_asked_for_where_there_are_two(found):
    assert found.verdict.chosen == "two" and found.verdict.bic[0] > 100
    one, two = found.verdict.candidates
    assert (one.numbers, two.numbers) == (1, 2)
    # Noise of markers is independent: nearly all that was measured counts, 24 rows of 2 markers.
    assert two.measurements == 144 and 0.6 * 144 < two.effective <= 144


def test_one_modulus_is_asked_for_where_there_is_one_and_errors_of_a_row_count_once():
    postures = measured(robot((1.6e5, 1.6e5)), TENSIONS)
    start = robot((1.5e5, 1.5e5))
    models = {"one": Model(start, (TIED,)), "two": Model(start, MODULI)}
    assert compare_postures(models, postures, method=GRID).verdict.chosen == "one"
    shaken = np.random.default_rng(2).normal(size=(24, 3))
    positions = {
        name: x + 10 * postures.noise[name] * shaken for name, x in postures.positions.items()
    }
    together = replace(postures, positions=positions)
    found = compare_postures(models, together, method=GRID).verdict
    assert found.candidates[0].effective < 0.6 * 144


def test_the_command_line_compares_postures(found, tmp_path, capsys, monkeypatch):
    asked = {}
    compared = lambda models, postures, **options: asked.update(models) or found
    monkeypatch.setattr("calibration.postures.compare.compare_postures", compared)
    scene, log, out = tmp_path / "robot.toml", tmp_path / "log.csv", tmp_path / "out"
    sr.save_scene(robot((1.5e5, 1.5e5)), scene)
    names = [f"tau{k}_N" for k in range(1, 5)] + [f"tip_{a}_m" for a in "xyz"]
    table = np.hstack([np.asarray(TENSIONS.tensions), found.best.postures.positions["tip"]])
    np.savetxt(log, table, delimiter=",", header=",".join(names), comments="")
    words = ["calibrate", str(scene), "--postures", str(log), "--out", str(out)]
    assert main([*words, "--compare", TIED, ",".join(MODULI)]) == 0
    assert [model.names for model in asked.values()] == [(TIED,), MODULI]
    assert "The data ask for two" in capsys.readouterr().out
    content = json.loads((out / "parameters.json").read_text())
    assert content["comparison"]["chosen"] == "two"
    assert set(content["parameters"]) == set(MODULI)
    assert "Models compared" in (out / "report.html").read_text()
