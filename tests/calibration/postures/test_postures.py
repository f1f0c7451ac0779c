"""Fits to postures; the truth is known."""

import json
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import softrod_jax as sr
from calibration import RecordingError
from calibration.experiment.setup import Setup
from calibration.parameters.paths import path_parameter
from calibration.postures.data import Postures, joined, load_postures
from calibration.postures.design import chosen_rows, design_postures
from calibration.postures.fitting import calibrate_postures
from softrod_jax.scene.inputs import Inputs
from softrod_jax.scene.scene import as_arrays

GRID = sr.Collocation(intervals=6)


def robot(E=(2.0e5, 1.2e5), friction=None, control="tension", stiffness=None):
    """Two segments and four tendons; a marker in the middle, off the axis."""
    both = lambda x: None if x is None else (x,) * 4
    tendons = sr.Tendons(
        5e-3 * np.array([[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]]),
        ends_at=(0.06, 0.06, None, None),
        friction=both(friction),
        control=control,
        stiffness=both(stiffness),
    )
    segments = tuple(
        sr.Segment(length=0.06, section=sr.Circle(6e-3), young_modulus=jnp.array(e)) for e in E
    )
    return sr.Scene(
        segments=segments,
        poisson_ratio=0.45,
        density=1070.0,
        gravity=jnp.array([0.0, 0.0, 9.81]),
        tendons=tendons,
        markers=(sr.Marker("middle", 0.06, jnp.array([0.0, 8e-3, 0.0])),),
    )


def measured(scene, inputs, noise=(3e-4, 1e-3), seed=1, trials=()):
    """What markers would be measured, the middle one better than the tip."""
    solve = lambda row: sr.solve_static(scene, *row, method=GRID, throw=False).markers
    path = lambda rows: sr.solve_path(scene, *rows, method=GRID, throw=False).markers
    rubs = scene.tendons.friction is not None
    inputs = Inputs(*(None if x is None else jnp.asarray(x) for x in inputs))
    seen = path(inputs) if rubs else sr.spread(solve)(inputs)
    rng = np.random.default_rng(seed)
    noisy = {
        name: np.asarray(seen[name].position) + spread * rng.normal(size=(len(x), 3))
        for name, spread in zip(("middle", "tip"), noise)
        for x in (seen[name].position,)
    }
    return Postures(inputs, noisy, noise=dict(zip(("middle", "tip"), noise)), trials=trials)


def pulls(rows, seed=1, most=1.0):
    return most * np.random.default_rng(seed).uniform(size=(rows, 4)) ** 2


MODULI = ("segments[0].young_modulus", "segments[1].young_modulus")
TENSIONS = Inputs(tensions=pulls(24))


def test_moduli_of_segments_are_recovered():
    truth = (2.0e5, 1.2e5)
    postures = measured(robot(truth), TENSIONS)
    found = calibrate_postures(robot((1.2e5, 2e5)), postures, fit=MODULI, method=GRID)
    assert found.converged and found.unsolved == 0
    for name, value in zip(MODULI, truth):
        estimate = found.parameters[name]
        low, high = estimate.ci95
        assert estimate.identifiable and low < value < high < 1.1 * low, (name, estimate)
    assert found.rmse_by_marker["tip"] == pytest.approx(1e-3 * np.sqrt(3), rel=0.25)
    assert found.rmse_by_marker["middle"] == pytest.approx(3e-4 * np.sqrt(3), rel=0.25)
    assert found.noise_scale == pytest.approx(1.0, abs=0.15)


@pytest.mark.long
def test_intervals_hold_the_truth_as_often_as_they_say():
    truth, fits, held = np.array([2.0e5, 1.2e5]), 200, 0
    made = measured(robot(truth), TENSIONS, noise=(0.0, 0.0))
    rng, noise = np.random.default_rng(5), {"middle": 4e-4, "tip": 1.5e-3}
    for _ in range(fits):
        positions = {k: x + noise[k] * rng.normal(size=x.shape) for k, x in made.positions.items()}
        postures = replace(made, positions=positions, noise=noise)
        found = calibrate_postures(robot(truth), postures, fit=MODULI, method=GRID)
        ends = np.array([found.parameters[name].ci95 for name in MODULI])
        held += np.sum((ends[:, 0] < truth) & (truth < ends[:, 1]))
    # 95 %, give or take what 400 intervals may show by chance.
    assert 0.925 < held / (2 * fits) < 0.975


def test_gaps_in_the_data_are_no_data():
    postures = measured(robot(), TENSIONS)
    tip = postures.positions["tip"].copy()
    tip[::2] = np.nan
    tip[1, 0] = np.nan
    holed = replace(postures, positions={**postures.positions, "tip": tip})
    found = calibrate_postures(robot(), holed, fit=MODULI, method=GRID)
    assert np.isnan(found.measured[0, 1]).all() and found.rmse_m < 2e-3
    for name, value in zip(MODULI, (2.0e5, 1.2e5)):
        low, high = found.parameters[name].ci95
        assert low < value < high


def test_attitudes_are_measurements_too():
    solve = lambda T: sr.solve_static(robot(), tensions=T, method=GRID).markers["tip"].quaternion
    turned = {"tip": np.array(sr.spread(solve)(jnp.asarray(TENSIONS.tensions)))}
    turned["tip"][3] *= -1.0  # the same attitude
    postures = Postures(TENSIONS, {}, turned)
    found = calibrate_postures(robot((1.5e5, 1.5e5)), postures, fit=MODULI, method=GRID)
    for name, value in zip(MODULI, (2.0e5, 1.2e5)):
        assert found.parameters[name].value == pytest.approx(value, rel=1e-4)


@pytest.mark.long
def test_friction_is_told_by_the_way_there_and_back():
    up = np.linspace(0.05, 0.8, 6)
    tensions = np.zeros((22, 4))
    tensions[:11, 0] = tensions[11:, 2] = np.concatenate([up, up[::-1][1:]])
    trials = ("first",) * 11 + ("second",) * 11
    truth = robot((1.8e5, 1.8e5), friction=0.25)
    both = [measured(truth, Inputs(tensions=x)) for x in (tensions[:11], tensions[11:])]
    postures = replace(joined(both), trials=trials)
    fit = ("segments[*].young_modulus", "tendon_friction")
    found = calibrate_postures(robot((1.5e5, 1.5e5), friction=0.1), postures, fit=fit, method=GRID)
    for name, value in zip(fit, (1.8e5, 0.25)):
        low, high = (np.ravel(end)[0] for end in found.parameters[name].ci95)
        assert low < value < high < 1.5 * low, (name, low, high)


def test_a_prior_helps_and_a_wrong_one_is_told():
    postures = measured(robot(), Inputs(tensions=pulls(6, most=0.2)))
    fit = (*MODULI, "density")
    right = calibrate_postures(
        robot(), postures, fit=fit, priors={"density": (1070.0, 20.0)}, method=GRID
    )
    assert not right.conflicts
    low, high = right.parameters["density"].ci95
    assert low < 1070.0 < high and high - low < 90.0
    wrong = calibrate_postures(
        robot(), measured(robot(), TENSIONS), fit=MODULI,
        priors={MODULI[0]: (1.5e5, 1e3)}, method=GRID,
    )  # fmt: skip
    assert set(wrong.conflicts) == {MODULI[0]}


def test_trials_are_kept_aside_in_turn():
    postures = replace(measured(robot(), TENSIONS), trials=tuple("abcdefgh" * 3))
    found = calibrate_postures(robot(), postures, fit=MODULI, folds=4, method=GRID)
    assert found.held_out_m == pytest.approx(found.rmse_m, rel=0.3)


def test_chosen_postures_tell_more_than_others():
    candidates = measured(robot(), TENSIONS)
    chosen = design_postures(robot(), candidates, fit=MODULI, count=4, method=GRID)
    assert len(set(chosen.rows.tolist())) == 4
    area = lambda fit: np.linalg.slogdet(fit.information)[1]
    own = calibrate_postures(robot(), candidates.take(chosen.rows), fit=MODULI, method=GRID)
    rng, better = np.random.default_rng(2), 0
    for _ in range(10):
        rows = rng.choice(24, 4, replace=False)
        other = calibrate_postures(robot(), candidates.take(rows), fit=MODULI, method=GRID)
        better += area(replace(own, information=own.information * own.noise_scale**2)) > area(
            replace(other, information=other.information * other.noise_scale**2)
        )
    assert better >= 9
    one = np.eye(2)[None] * np.arange(1.0, 6.0)[:, None, None]
    assert chosen_rows(one, [0, 1, 2, 3, 4], 2, np.zeros((2, 2)) + 1e-9 * np.eye(2)) == [4, 3]


def values(scene, name):
    return np.asarray(path_parameter(scene, name).get(Setup(scene)))


def test_paths_lead_to_the_numbers_of_a_scene():
    scene = robot(friction=0.2, control="length", stiffness=300.0)
    np.testing.assert_allclose(values(scene, "segments[1].young_modulus"), 1.2e5)
    np.testing.assert_allclose(values(scene, "segments[*].young_modulus"), [2e5, 1.2e5])
    np.testing.assert_allclose(values(scene, "tendons[2].friction"), 0.2)
    np.testing.assert_allclose(values(scene, "tendons[*].stiffness"), [300.0] * 4)
    np.testing.assert_allclose(values(scene, "tendons[1].offset[0]"), -5e-3)
    np.testing.assert_allclose(values(scene, "markers[0].offset[1]"), 8e-3)
    np.testing.assert_allclose(values(scene, "rod.density"), 1070.0)
    np.testing.assert_allclose(values(scene, "gravity[2]"), 9.81)
    np.testing.assert_allclose(values(scene, "segments[0].section.radius"), 6e-3)
    tied = path_parameter(scene, "segments[0].young_modulus = segments[1].young_modulus")
    moved = tied.put(Setup(scene), tied.scale.value(tied.get(Setup(scene)), np.log(2.0))).scene
    np.testing.assert_allclose([x.young_modulus for x in moved.segments], [4e5, 2.4e5])
    one = path_parameter(scene, "tendons[3].friction")
    moved = one.put(Setup(scene), jnp.array(0.7)).scene.tendons
    np.testing.assert_allclose(moved.friction, [0.2, 0.2, 0.2, 0.7])


def test_paths_lead_to_the_numbers_of_a_material():
    branches = np.array([[0.3, 0.05], [0.2, 1.0]])
    part = lambda **own: sr.Segment(length=0.05, section=sr.Circle(6e-3), **own)
    parts = part(), part(material=sr.NeoHookean(2e4), relaxation=0.5 * branches)
    law = sr.MooneyRivlin(6e3, 2e3)
    scene = sr.Scene(segments=parts, material=law, density=1070.0, relaxation=branches)
    scene = jax.tree.map(jnp.asarray, as_arrays(scene))
    np.testing.assert_allclose(values(scene, "material.c1"), 6e3)
    np.testing.assert_allclose(values(scene, "segments[1].material.mu"), 2e4)
    np.testing.assert_allclose(values(scene, "relaxation[1][0]"), 0.2)
    np.testing.assert_allclose(values(scene, "relaxation[*][1]"), [0.05, 1.0])
    np.testing.assert_allclose(values(scene, "segments[1].relaxation[0][1]"), 0.025)
    # A part of the stiffness stays one, a time above zero.
    part, time = (path_parameter(scene, f"relaxation[0][{k}]") for k in (0, 1))
    assert (part.unit, time.unit) == ("1", "s")
    values_at = lambda p, theta: p.scale.value(p.get(Setup(scene)), theta)
    assert 0.99 < values_at(part, 7.0) < 1.0 and 0.0 < values_at(part, -7.0) < 0.01
    np.testing.assert_allclose(values_at(time, np.log(3.0)), 0.15)
    moved = part.put(Setup(scene), jnp.array(0.4)).scene
    np.testing.assert_allclose(moved.relaxation, [[0.4, 0.05], [0.2, 1.0]])
    for name in ("relaxation", "relaxation[0]", "relaxation[0][2]", "relaxation[0][*]"):
        with pytest.raises(ValueError, match="of a branch a part of the stiffness or a time"):
            path_parameter(scene, name)
    with pytest.raises(ValueError, match="its shape is"):
        path_parameter(scene, "relaxation[2][0]")


@pytest.mark.parametrize(
    "name, message",
    [
        ("segments[2].young_modulus", "there are 2, counted from 0"),
        ("segments[0].colour", "no 'colour'"),
        ("tendons[0].backlash", "backlash a starting value"),
        ("stiffness.bending[0]", "no 'stiffness'"),
        ("Segments[0]", "is no path"),
        ("density = gravity[2]", "units"),
        ("gravity[3]", r"its shape is \(3,\)"),
    ],
)
def test_paths_that_lead_nowhere_are_refused(name, message):
    scene = jax.tree.map(jnp.asarray, robot())
    with pytest.raises(ValueError, match=message):
        path_parameter(scene, name)


def log(path, postures, header=None):
    """As a CSV file."""
    names = header or [
        *(f"tau{i + 1}_N" for i in range(4)),
        *(f"{m}_{a}_m" for m in postures.positions for a in "xyz"),
    ]
    table = np.hstack([postures.inputs.tensions, *postures.positions.values()])
    rows = [",".join(map(repr, row)) for row in table.tolist()]
    path.write_text("\n".join([",".join(names), *rows]), encoding="utf-8")
    return path


@pytest.mark.long
def test_the_command_line_fits_postures(tmp_path, capsys):
    from calibration.cli.main import main

    scene, made = tmp_path / "robot.toml", measured(robot(), TENSIONS)
    sr.save_scene(robot((1.5e5, 1.5e5)), scene)
    logs = [log(tmp_path / f"{k}.csv", made.take(np.arange(k, 24, 2))) for k in range(2)]
    out = tmp_path / "out"
    code = main(
        ["calibrate", str(scene), "--postures", *map(str, logs), "--fit", ",".join(MODULI),
         "--prior", "segments[0].young_modulus=2e5:1e5", "--folds", "3", "--out", str(out)]
    )  # fmt: skip
    assert code == 0, capsys.readouterr().err
    told = json.loads((out / "parameters.json").read_text(encoding="utf-8"))
    for name, value in zip(MODULI, (2.0e5, 1.2e5)):
        low, high = told["parameters"][name]["ci95"]
        assert low < value < high and told["parameters"][name]["identifiable"]
    assert set(told["rmse_m"]) == {"0", "1"} and told["unsolved_rows"] == 0
    assert len(told["made_by"]["sha256"]) == 2
    assert "24 postures" in capsys.readouterr().out
    fitted = sr.load_scene(out / "scene.toml").segments
    assert fitted[0].young_modulus == pytest.approx(told["parameters"][MODULI[0]]["value"])
    assert "Worst postures" in (out / "report.html").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    "change, message",
    [
        (("tau4_N", "tau5_N"), "no column tau4_N"),
        (("tip_x_m", "top_x_m"), "column 'top_x_m' is unknown"),
        (("tip_x_m", "tip_y_m"), "there twice"),
        (("\n", "\n0.1,"), "cells, and the header has"),
        (("0.0", "nought"), "is not a finite number"),
    ],
)
def test_bad_logs_of_postures_are_told(tmp_path, change, message):
    made = measured(robot(), TENSIONS)
    path = log(tmp_path / "bad.csv", made)
    text = path.read_text(encoding="utf-8")
    changed = text.replace(*change, 1) if change[0] in text else text.replace("0.", "x", 1)
    path.write_text(changed, encoding="utf-8")
    with pytest.raises(RecordingError, match=message):
        load_postures(path, robot())
