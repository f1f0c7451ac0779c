"""Logs that drift: a slow clock, a marker that slips, a tendon that creeps; the truth is known."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest
from beams import AS_FITTED, SETTINGS

import softrod_jax as sr
from calibration import Recording, calibrate
from calibration.experiment.drift import durations
from calibration.parameters.unknowns import choose_unknowns
from calibration.problem.dataset import datasets
from calibration.problem.motion import Motion, tip_at
from calibration.problem.problem import make_problem
from calibration.report.numbers import as_json
from softrod_jax.scene.scene import as_arrays

TRUTH = {"young_modulus": 2.8e5, "bending_damping": 2e-6}
DURATION, INTERVAL, NOISE, LATE = 6.0, 0.02, 3e-4, 0.04
SLOW, SLIP, CREEP = 0.02, np.array([2e-3, -1e-3, 0.5e-3]), -0.2
DRIFT = {"clock": 2.0, "tip": 2.0, "inputs": 2.0}


def robot(**values):
    scene = replace(sr.hybrid_robot(), chambers=None, **{**TRUTH, **values})
    tendons = sr.Tendons(jnp.array([[4e-3, 0.0], [-2e-3, 3.5e-3]]))
    return as_arrays(replace(scene, drag_coefficient=None, tendons=tendons))


def log(drifting, seed=0):
    """Six seconds of two tendons that are pulled and let go in turn, and swing in between."""
    random = np.random.default_rng(seed)
    times = INTERVAL * np.arange(round(DURATION / INTERVAL) + 1)
    rise = lambda t: 0.5 - 0.5 * np.cos(np.pi * np.clip(t / 0.12, 0, 1))
    tensions, begin, tendon = np.zeros((len(times), 2)), 0.2, 0
    while begin < DURATION:
        end = begin + random.uniform(0.2, 0.5)
        tensions[:, tendon] += random.uniform(0.3, 0.8) * (rise(times - begin) - rise(times - end))
        begin, tendon = end + random.uniform(0.1, 0.6), 1 - tendon
    part = (times / DURATION)[:, None]
    arriving = tensions * (1 + CREEP * part * (drifting == "inputs"))
    trajectory = sr.simulate(robot(), INTERVAL, arriving[1:], **AS_FITTED)
    tip = (trajectory.tip_positions, trajectory.tip_velocities)
    motion = Motion(*tip, trajectory.positions, jnp.array(0), jnp.array(0.0))
    seen = times / (1 - SLOW * (drifting == "clock")) - LATE
    tip = np.array(tip_at(motion, INTERVAL, jnp.asarray(seen)))
    tip += SLIP * part * (drifting == "tip") + NOISE * random.normal(size=tip.shape)
    tip[seen > times[-1]] = np.nan
    return Recording(times, tensions, None, tip, name="log")


def fit(recording, drift=None):
    return calibrate(
        robot(young_modulus=2.2e5, bending_damping=1e-6),
        [recording],
        fit=tuple(TRUTH),
        drift=drift,
        dt=INTERVAL,
        window=(0.0, DURATION),
        checks=False,
        progress=False,
        **SETTINGS,
    )


@pytest.fixture(scope="module")
def fits():
    """Of each drifting log: without windows, and with windows for whatever may drift."""
    logs = {name: log(name) for name in DRIFT}
    return {name: (fit(recording), fit(recording, DRIFT)) for name, recording in logs.items()}


def half_width(found, name):
    low, high = found.parameters[name].ci95
    return (np.inf if high is None else high) / 2 - (0.0 if low is None else low) / 2


@pytest.mark.long
@pytest.mark.parametrize("drifting", DRIFT)
def test_windows_find_the_truth(fits, drifting):
    plain, windows = fits[drifting]
    assert windows.rmse_m["log"] == pytest.approx(NOISE * np.sqrt(3), rel=0.1)
    for name, truth in TRUTH.items():
        estimate = windows.parameters[name]
        assert estimate.identifiable
        assert abs(estimate.value - truth) < 1.5 * half_width(windows, name), name
        assert half_width(windows, name) < half_width(plain, name) / 2, name
    assert windows.time_offset_s["log"] == pytest.approx(LATE, abs=2e-3)


def misses(found):
    """Parameters whose 95 % interval does not hold the truth."""
    ends = {name: found.parameters[name].ci95 for name in TRUTH}
    return [name for name, (low, high) in ends.items() if not low < TRUTH[name] < high]


def test_a_creeping_tendon_ruins_plain_fits_beyond_their_intervals(fits):
    pairs = [fits["inputs"]]
    for seed in (1, 2):
        recording = log("inputs", seed)
        pairs.append((fit(recording), fit(recording, DRIFT)))
    assert all(misses(plain) for plain, _ in pairs)
    # One in twenty may.
    assert sum(len(misses(windows)) for _, windows in pairs) <= 1
    errors = [
        [abs(f.parameters["young_modulus"].value / TRUTH["young_modulus"] - 1) for f in pair]
        for pair in pairs
    ]
    assert all(windows < 0.2 * plain for plain, windows in errors)


@pytest.mark.parametrize(
    "channel, end, tolerance",
    [("clock", -DURATION * SLOW / (1 - SLOW), 5e-3), ("tip", SLIP, 3e-4), ("inputs", CREEP, 0.02)],
)
def test_what_drifted_is_told(fits, channel, end, tolerance):
    _, windows = fits[channel]
    (found,) = windows.recordings
    for name, drift in found.drift.items():
        assert len(drift.edges) == 4
        truth = np.outer(np.arange(4) / 3, np.atleast_1d(end)) if name == channel else 0.0
        allowed = {"clock": 5e-3, "tip": 3e-4, "inputs": 0.02}[name]
        np.testing.assert_allclose(drift.values, truth, atol=allowed)
    content = as_json(windows)
    assert content["drift"]["log"][channel]["edges_s"] == pytest.approx([0, 2, 4, 6])
    assert any("log drifted" in remark for remark in content["remarks"])


@pytest.mark.long
def test_derivatives_by_drifts():
    """Forward, reverse and finite differences agree."""
    recording, scene = log("tip").window(0.0, 0.6), robot(young_modulus=2.6e5)
    setup, parameters = choose_unknowns(scene, [recording], ["log"], tuple(TRUTH))
    drift = {name: 0.3 for name in DRIFT}
    data, _ = datasets(scene, recording, window=(0.0, 0.6), drift=drift)
    forward = make_problem(setup, parameters, data, True, INTERVAL, **SETTINGS)
    x = forward.space.origin() + 0.1
    assert len(x) == 3 + 2 * 5
    point = forward.at(x)
    for i in range(len(x)):
        step = 1e-4 * np.eye(len(x))[i]
        ends = [forward.at(x + sign * step).residuals for sign in (1, -1)]
        difference = (ends[0] - ends[1]) / 2e-4
        size = np.max(np.abs(difference))
        assert size > 1e-7
        np.testing.assert_allclose(point.jacobian[:, i], difference, atol=1e-4 * size)
    reverse = replace(forward, reverse=True).at(x)
    np.testing.assert_allclose(reverse.gradient, point.gradient, rtol=1e-6)


def test_bad_drifts():
    with pytest.raises(ValueError, match="'weather' is unknown"):
        durations({"weather": 1.0})
    with pytest.raises(ValueError, match="clock = 0 s"):
        durations({"clock": 0.0})
