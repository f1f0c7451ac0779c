"""Fits to logs of tendons that are driven by their length; the truth is known."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest
from beams import AS_FITTED, SETTINGS

import softrod_jax as sr
from calibration import Recording, RecordingError, calibrate, load_recording, write_log
from calibration.experiment.beginning import _linear_deflection, hangs
from calibration.experiment.setup import Setup
from calibration.parameters.catalogue import catalogue, choose, prepared, with_values
from calibration.problem.batch import make_batch
from calibration.problem.dataset import datasets
from calibration.report.granted import scale_of_forces, taken_for_granted
from softrod_jax.scene.scene import as_arrays

TRUTH = {"young_modulus": 2.8e5, "bending_damping": 4e-6}
STIFFNESS, PRETENSION = 150.0, 0.1
STEPS, DT, NOISE = 48, 0.02, 2e-4


def robot(stiffness=STIFFNESS, pretension=PRETENSION, friction=None, backlash=None, **values):
    """Horizontal in a plane, with two tendons above and below."""
    tendons = sr.Tendons(
        [[4e-3, 0.0], [-4e-3, 0.0]],
        control="length",
        stiffness=(stiffness, stiffness),
        pretension=(pretension, pretension),
        friction=None if friction is None else (friction, friction),
        backlash=None if backlash is None else (backlash, backlash),
    )
    return as_arrays(
        sr.Scene(
            length=0.1,
            section=sr.Circle(6e-3),
            poisson_ratio=0.45,
            density=1070.0,
            gravity=jnp.array([-9.81, 0.0, 0.0]),
            plane="xz",
            tendons=tendons,
            **{**TRUTH, **values},
        )
    )


def log(seed=0, truth=None):
    """The upper tendon is pulled and let go, then the lower one; it begins in equilibrium.

    `truth`: the robot, where it is another one.
    """
    times = DT * np.arange(STEPS + 1)
    rise = lambda t: 0.5 - 0.5 * np.cos(np.pi * np.clip(t / 0.1, 0, 1))
    first = 4e-3 * (rise(times - 0.05) - rise(times - 0.3))
    second = 3e-3 * (rise(times - 0.5) - rise(times - 0.7))
    pulls = np.stack([first - second, second - first], axis=1)
    method = SETTINGS["method"]
    truth = robot() if truth is None else truth
    initial = sr.solve_static(truth, None, None, pulls[0], method=method)
    motion = sr.simulate(truth, DT, None, None, pulls[1:], initial=initial, **AS_FITTED)
    noise = NOISE * np.random.default_rng(seed).normal(size=(STEPS + 1, 3)) * [1, 0, 1]
    tip = np.asarray(motion.tip_positions) + noise
    return Recording(times, None, None, tip, name="pulled", starts_hanging=True, pulls=pulls)


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    """As a log says it, which says nothing of how it begins."""
    path, made = tmp_path_factory.mktemp("log") / "pulled.csv", log()
    write_log(path, made.times, None, None, made.tip_positions, pulls=made.pulls)
    return load_recording(path, robot())


def fit(recording, scene, names):
    return calibrate(
        scene, [recording], fit=names, dt=DT, time_offset=False, checks=False, progress=False,
        **SETTINGS,
    )  # fmt: skip


def test_a_modulus_is_recovered(recording):
    found = fit(recording, robot(young_modulus=2e5, bending_damping=8e-6), tuple(TRUTH))
    for name, truth in TRUTH.items():
        estimate = found.parameters[name]
        low, high = estimate.ci95
        assert low < truth < high and high / low < 1.3, (name, estimate)
    assert found.recordings[0].rmse == pytest.approx(NOISE * np.sqrt(2), rel=0.3)
    assert {"the pulls", "the tendons' stiffness"} <= set(taken_for_granted(found))
    assert "density, the tendons' stiffness together" in scale_of_forces(found)


def test_what_the_tendons_are_is_recovered(recording):
    names = ("tendon_stiffness", "pretension")
    found = fit(recording, robot(stiffness=120.0, pretension=0.13), names)
    for name, truth in zip(names, (STIFFNESS, PRETENSION), strict=True):
        low, high = (np.asarray(x) for x in found.parameters[name].ci95)
        assert np.all((low < truth) & (truth < high) & (high < 1.2 * low)), (name, low, high)
    tendons = found.scene.tendons
    assert tendons.stiffness[0] == tendons.stiffness[1] != 120.0


@pytest.mark.long
def test_friction_and_play_are_recovered():
    truth = {"tendon_friction": 0.3, "backlash": 4e-4}
    scene = lambda friction, backlash: robot(friction=friction, backlash=backlash)
    recording = log(truth=scene(*truth.values()))
    found = fit(recording, scene(0.15, 6e-4), tuple(truth))
    for name, value in truth.items():
        low, high = (np.asarray(x) for x in found.parameters[name].ci95)
        assert np.all((low < value) & (value < high) & (high < 1.5 * low)), (name, low, high)
    own = with_values(
        Setup(scene(0.3, 0.0)), ("tendon_friction_each_2",), [np.log(2.0)]
    ).scene.tendons
    np.testing.assert_allclose(own.friction, [0.3, 0.6])


def test_one_number_for_all_tendons_that_have_it():
    scene = robot()
    tendons = replace(scene.tendons, stiffness=(jnp.array(100.0), None), control="length")
    scene = replace(scene, tendons=tendons)
    moved = with_values(Setup(scene), ("tendon_stiffness",), [np.log(2.0)]).scene.tendons
    np.testing.assert_allclose(moved.stiffness[0], 200.0)
    assert moved.stiffness[1] is None
    known, _ = catalogue(scene)
    assert not {"tendon_efficiency", "tendon_efficiency_each_1"} & set(known)
    rigid = replace(scene, tendons=replace(scene.tendons, stiffness=None))
    with pytest.raises(ValueError, match=r"no tendon_stiffness.*\[\[tendons\]\] stiffness"):
        choose(rigid, ["tendon_stiffness"])
    with pytest.raises(ValueError, match="unknown parameter 'tendon_stiffness'"):
        choose(sr.hybrid_robot(), ["tendon_stiffness"])
    # An efficiency is one of tensions.
    mixed = replace(scene, tendons=replace(tendons, control=("length", "tension"), pretension=None))
    assert prepared(mixed, ["tendon_efficiency"]).tendon_efficiency.shape == (1,)


def test_a_recording_without_pulls_holds_the_tendons():
    recording = replace(log(), pulls=None)
    data, _ = datasets(robot(), recording)
    batch, _ = make_batch(robot(), data, False, DT)
    assert batch.inputs.tensions is None
    np.testing.assert_array_equal(batch.inputs.pulls, np.zeros((1, batch.steps + 1, 2)))
    with pytest.raises(RecordingError, match="1 columns of pulls, and the scene has 2 tendons dr"):
        data, _ = datasets(robot(), replace(log(), pulls=log().pulls[:, :1]))
        make_batch(robot(), data, False, DT)


def test_where_a_rod_begins_that_is_held_by_tendons():
    """Small deflections, by linear theory and by the solver."""
    stiff = dict(young_modulus=5e6)
    for scene, pulls in (
        (robot(**stiff), [2e-4, -2e-4]),
        (robot(pretension=0.0, **stiff), [3e-4, -5e-3]),
        (robot(pretension=1.0, **stiff), [0.0, 0.0]),
        (robot(stiffness=1e5, **stiff), [1e-4, -1e-4]),
    ):
        tip = np.array([[0.0, 0.0, 0.1]])
        recording = Recording(np.zeros(1), None, None, tip, pulls=np.array([pulls]))
        expected = np.asarray(sr.solve_static(scene, None, None, pulls).tip_position) - tip[0]
        linear = _linear_deflection(scene, recording)
        size = np.linalg.norm(expected)
        np.testing.assert_allclose(linear, expected, rtol=0, atol=0.03 * size + 1e-5)


def test_a_log_tells_that_it_hangs(recording):
    assert hangs(robot(), recording)
    straight = recording.tip_positions - recording.tip_positions[0] + [0.0, 0.0, 0.1]
    assert not hangs(robot(), replace(recording, tip_positions=straight))
