"""Equilibria and motions of one robot in one fit."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest
from beams import FIT, NOISE, TRUTH, beam, release

import softrod_jax as sr
from calibration import calibrate, compare, write_log
from calibration.cli.main import main
from calibration.inference.explain import _step
from calibration.parameters.laws import Model
from calibration.postures.data import Postures
from calibration.report.numbers import as_json
from calibration.report.plots import postures_figure
from calibration.report.results import PosturesFit
from calibration.report.text import summary_text
from softrod_jax.scene.inputs import Inputs

NAMES = ("young_modulus", "bending_damping", "density")
TENSIONS = np.linspace(0.0, 6.0, 14)[:, None]
GRID = sr.Collocation(intervals=2, order=6)
SEEN = 5e-4  # m, of the equilibria


def robot(E=TRUTH["young_modulus"], B=TRUTH["bending_damping"], density=1070.0):
    scene = replace(beam(young_modulus=E, bending_damping=B), density=jnp.array(density))
    return replace(scene, tendons=sr.Tendons(jnp.array([[0.0, 8e-3]])))


@pytest.fixture(scope="module")
def postures():
    """Seen to half a millimetre, which is not said."""
    scene = robot()
    solve = lambda T: sr.solve_static(scene, T, method=GRID).tip_position
    tip = np.asarray(sr.spread(solve)(jnp.asarray(TENSIONS)))
    noise = SEEN * np.random.default_rng(4).normal(size=tip.shape)
    return Postures(Inputs(tensions=TENSIONS), {"tip": tip + noise}, name="rest", source="made")


@pytest.fixture(scope="module")
def recording():
    return release(beam())


def fitted(recording, **options):
    parts = {"checks": False, "progress": False, "window": (0.0, 1.0), "fit": NAMES}
    return calibrate(robot(2.4e5, 9e-5, 980.0), [recording], **{**parts, **FIT, **options})


def test_together_they_tell_what_neither_tells_alone(recording, postures):
    """A release tells moduli over density, tensions modulus and weight, and no damping."""
    found = fitted(recording, postures=postures)
    truth = {**TRUTH, "density": 1070.0}
    for name in NAMES:
        e = found.parameters[name]
        low, high = e.ci95
        assert e.identifiable and low < truth[name] < high < 1.3 * low, (name, e)
    # The noise of each is its own: what is said of the equilibria is twice too much.
    assert found.postures.noise_scale == pytest.approx(SEEN / 1e-3, rel=0.2)
    assert found.postures.rmse_m == pytest.approx(SEEN * np.sqrt(3), rel=0.2)
    assert found.rmse_m["release"] == pytest.approx(NOISE * np.sqrt(3), rel=0.15)
    assert "rest: 14 equilibria, 0.9" in summary_text(found)
    told = as_json(found)["postures"]
    assert told["rows"] == 14 and told["unsolved"] == 0
    alone = fitted(recording)
    assert not alone.parameters["density"].identifiable and alone.postures is None


@pytest.mark.long
def test_what_else_would_explain_it_must_suit_the_equilibria(recording, postures):
    """Of a release a density that is too low by a tenth is as good as a modulus that is too high;
    equilibria under tension tell that it is not the modulus."""
    scene = robot(density=0.9 * 1070.0)
    parts = {"checks": False, "progress": False, "window": (0.0, 1.0), **FIT}
    parts |= {"fit": ("young_modulus", "bending_damping"), "explain": True}
    found = calibrate(scene, [recording], postures=postures, **parts)
    (density,) = (e for e in found.explanations if e.name == "density")
    assert density.values["density"] == pytest.approx(1070.0, rel=0.03)


def test_a_step_must_suit_what_is_told_besides():
    """The least squares of all of it, and what is left of the residuals alone."""
    rng = np.random.default_rng(0)
    J, r = rng.normal(size=(9, 2)), rng.normal(size=9)
    by, told = 5 * rng.normal(size=(4, 2)), rng.normal(size=4)
    step, loss = _step(J, r, (told, by))
    all_ = np.linalg.lstsq(np.concatenate([J, by]), -np.concatenate([r, told]), rcond=None)[0]
    np.testing.assert_allclose(step, all_)
    assert loss == pytest.approx(float(np.sum((r + J @ all_) ** 2)))
    assert loss > _step(J, r)[1]


def test_equilibria_are_drawn(tmp_path):
    rng = np.random.default_rng(1)
    measured = rng.normal(size=(7, 2, 3))
    measured[3, 1] = np.nan
    shown = PosturesFit("rest", "", 7, 0, 1e-3, {"tip": 1e-3, "middle": 2e-3}, 1.0,
                        measured + 1e-3, measured)  # fmt: skip
    figure = postures_figure(shown)
    *_, apart = figure.axes
    assert [line.get_label() for line in apart.lines] == ["tip", "middle"]
    np.testing.assert_allclose(apart.lines[0].get_ydata(), 1.0 * np.sqrt(3), rtol=1e-9)
    assert np.isnan(apart.lines[1].get_ydata()[3])


def test_a_comparison_does_not_count_them(recording, postures):
    models = {name: Model(robot(), (name,)) for name in NAMES}
    with pytest.raises(ValueError, match="not counted"):
        compare(models, [recording], postures=postures)


def test_the_command_line_fits_both(recording, postures, tmp_path, monkeypatch, capsys):
    asked = {}

    def calibrated(scene, recordings, **options):
        asked.update(options)
        raise KeyboardInterrupt

    monkeypatch.setattr("calibration.fit.calibrate", calibrated)
    monkeypatch.setattr("calibration.calibrate", calibrated)
    monkeypatch.setattr("calibration.cli.calibrate.prepare_jax", lambda: None)
    scene, swing, rest = (tmp_path / name for name in ("robot.toml", "swing.csv", "rest.csv"))
    sr.save_scene(robot(), scene)
    tensions = np.zeros((len(recording.times), 1))
    write_log(swing, recording.times, tensions=tensions, tip_positions=recording.tip_positions)
    table = np.hstack([TENSIONS, postures.positions["tip"]])
    np.savetxt(rest, table, delimiter=",", header="tau1_N,tip_x_m,tip_y_m,tip_z_m", comments="")
    call = ["calibrate", str(scene), str(swing), "--with-postures", str(rest)]
    assert main([*call, "--out", str(tmp_path / "out")]) == 130
    np.testing.assert_allclose(asked["postures"].positions["tip"], postures.positions["tip"])
    assert main([*call, "--compare", "--out", str(tmp_path / "out")]) == 2
    assert "--with-postures" in capsys.readouterr().err
