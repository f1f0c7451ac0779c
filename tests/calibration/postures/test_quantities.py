"""What is measured besides markers: tensions, the wrench at the base, curvatures."""

import json

import jax.numpy as jnp
import numpy as np
import pytest

import softrod_jax as sr
from calibration import RecordingError
from calibration.experiment.quantities import simulated
from calibration.postures.data import Postures, joined, load_postures
from calibration.postures.fitting import calibrate_postures
from softrod_jax.scene.inputs import Inputs

GRID = sr.Collocation(intervals=4)
LENGTH, RADIUS, E = 0.1, 3e-3, 2e6
PULLS = np.linspace(0.0, 8e-3, 24)[:, None]
NOISE = {"tension1": 0.02, "middle_curvature": 0.05}


def robot(E=E, stiffness=400.0, **parts):
    """A rod with a tendon that an elastic servo pulls; no gravity, so that forces have no scale."""
    return sr.Scene(
        length=LENGTH,
        section=sr.Circle(RADIUS),
        young_modulus=jnp.array(E),
        poisson_ratio=0.45,
        density=1070.0,
        tendons=sr.Tendons(
            np.array([[4e-3, 0.0]]), control="length", stiffness=(stiffness,), guided="disks"
        ),
        markers=(sr.Marker("middle", 0.05),),
        **parts,
    )


def test_closed_forms():
    """A bar that hardly bends: the base carries what acts on it."""
    force, moment = np.array([0.3, -0.2, 0.1]), np.array([0.0, 0.02, 0.01])
    stiff = sr.Scene(
        length=LENGTH, section=sr.Circle(RADIUS), young_modulus=1e12, poisson_ratio=0.3,
        density=1070.0, gravity=[0.0, 9.81, 0.0], tip_load=sr.TipLoad(force, moment),
        markers=(sr.Marker("middle", 0.03, jnp.array([1e-3, 0.0, 0.0])),),
    )  # fmt: skip
    solution = sr.solve_static(stiff, method=GRID)
    weight = 1070.0 * np.pi * RADIUS**2 * LENGTH * 9.81 * np.array([0.0, 1.0, 0.0])
    np.testing.assert_allclose(simulated(stiff, solution, "base_force"), force + weight, rtol=1e-6)
    arm = np.array([0.0, 0.0, LENGTH])
    expected = moment + np.cross(arm, force) + np.cross(arm / 2, weight)
    np.testing.assert_allclose(simulated(stiff, solution, "base_moment"), expected, rtol=1e-4)
    # Where the moment is that of the tip and of the force beyond.
    bent = simulated(stiff, solution, "middle_curvature")[0]
    there = moment[0] - force[1] * 0.07 - weight[1] * 0.7 * 0.035
    EI = 1e12 * np.pi * RADIUS**4 / 4
    assert float(bent) == pytest.approx(there / EI, rel=1e-4)
    soft = robot()
    pulled = sr.solve_static(soft, pulls=(5e-3,), method=GRID)
    tension = simulated(soft, pulled, "tension1")
    np.testing.assert_allclose(tension, pulled.tensions)
    # A straight tendon bends the rod into an arc, E I u = tension offset.
    curvature = float(tension[0]) * 4e-3 / (E * np.pi * RADIUS**4 / 4)
    for name in ("middle", "tip"):
        assert abs(float(simulated(soft, pulled, f"{name}_curvature")[1])) == pytest.approx(
            curvature, rel=1e-6
        )


def measured(seed=0):
    """A load cell and a fibre grating, no camera."""
    scene, rng = robot(), np.random.default_rng(seed)
    rows = [sr.solve_static(scene, pulls=tuple(row), method=GRID) for row in PULLS.tolist()]
    others = {key: np.array([simulated(scene, row, key) for row in rows]) for key in NOISE}
    noisy = {key: x + NOISE[key] * rng.normal(size=x.shape) for key, x in others.items()}
    noisy["middle_curvature"][:, 2] = np.nan  # a grating does not see twist
    return Postures(Inputs(pulls=PULLS), {}, noise=NOISE, others=noisy)


FIT = ("young_modulus", "tendon_stiffness")


def test_a_load_cell_tells_the_scale_of_forces():
    start = robot(E=1.2e6, stiffness=700.0)
    fit = calibrate_postures(start, measured(), fit=FIT, method=GRID)
    assert fit.converged and fit.noise_scale == pytest.approx(1.0, abs=0.2)
    for name, value in zip(FIT, (E, 400.0)):
        low, high = (np.ravel(x)[0] for x in fit.parameters[name].ci95)
        assert low < value < high < 1.15 * low, (name, low, high)
    for key, noise in NOISE.items():
        assert fit.others[key].rms == pytest.approx(noise, rel=0.5)
        assert fit.others[key].noise == noise
    # Without it no number of a force is known.
    other = measured()
    bent = Postures(other.inputs, {}, others={"middle_curvature": other.others["middle_curvature"]})
    fit = calibrate_postures(start, bent, fit=FIT, method=GRID)
    assert not any(fit.parameters[name].identifiable for name in FIT)


def log(path):
    made = measured()
    names = ["pull1_m", "tension1_N", "middle_ux_per_m", "middle_uy_per_m"]
    names += ["tension1_noise_N", "middle_curvature_noise_per_m"]
    curvature = made.others["middle_curvature"][:, :2]
    noise = np.tile([NOISE["tension1"], NOISE["middle_curvature"]], (made.rows, 1))
    table = np.hstack([made.inputs.pulls, made.others["tension1"], curvature, noise])
    rows = [",".join(map(repr, row)) for row in table.tolist()]
    path.write_text("\n".join([",".join(names), *rows]), encoding="utf-8")
    return made


def test_they_are_columns_of_a_log(tmp_path, capsys):
    from calibration.cli.main import main

    path, scene = tmp_path / "cells.csv", tmp_path / "robot.toml"
    made = log(path)
    sr.save_scene(robot(E=1.2e6, stiffness=700.0), scene)
    read = load_postures(path, robot())
    assert dict(read.noise) == NOISE
    for key, values in made.others.items():
        np.testing.assert_array_equal(read.others[key], values)
    both = joined([read, Postures(Inputs(pulls=PULLS[:8]), {"tip": np.zeros((8, 3))})])
    assert both.rows == 32 and np.isnan(both.others["tension1"][24:]).all()
    out = tmp_path / "out"
    words = ["calibrate", str(scene), "--postures", str(path), "--fit", ",".join(FIT)]
    assert main([*words, "--out", str(out), "--intervals", "4"]) == 0, capsys.readouterr().err
    assert "tension1: " in capsys.readouterr().out
    told = json.loads((out / "parameters.json").read_text(encoding="utf-8"))
    assert told["others"]["tension1"]["unit"] == "N"
    assert told["others"]["tension1"]["rms_by_noise"] == pytest.approx(1.0, abs=0.5)
    assert told["rmse_m"] == {"cells": None}
    assert "Other measurements" in (out / "report.html").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    "change, message",
    [
        (("tension1_N", "tension2_N"), "'tension2_N' is unknown; .* tension1, base_force"),
        (("0.02,", "-0.02,"), "tension1_noise_N: -0.02; a number above 0"),
    ],
)
def test_bad_columns_are_told(tmp_path, change, message):
    path = tmp_path / "cells.csv"
    log(path)
    path.write_text(path.read_text(encoding="utf-8").replace(*change, 1), encoding="utf-8")
    with pytest.raises(RecordingError, match=message):
        load_postures(path, robot())


def test_what_cannot_be_is_told():
    bad = Postures(Inputs(pulls=PULLS), {}, others={"tension2": np.zeros((24, 1))})
    with pytest.raises(ValueError, match="'tension2' is no measurement; known: tension1"):
        calibrate_postures(robot(), bad, fit=FIT, method=GRID)
    with pytest.raises(ValueError, match="folds: the places of markers"):
        calibrate_postures(robot(), measured(), fit=FIT, folds=2, method=GRID)
