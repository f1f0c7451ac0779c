"""Intervals and verdicts on recordings whose truth is known."""

from dataclasses import replace

import numpy as np
import pytest
from beams import FIT, RELEASE, TRUTH, beam, release

from calibration import calibrate
from calibration.inference.noise import _peak

OPTIONS = dict(checks=False, window=(0.0, 1.0), progress=False, **FIT)


def autoregressive(rho, count=20000):
    noise = np.random.default_rng(0).normal(size=count)
    for k in range(1, count):
        noise[k] += rho * noise[k - 1]
    return noise


@pytest.mark.parametrize("rho", [0.0, 0.5, 0.9, -0.5])
def test_the_peak_of_a_spectrum(rho):
    x = autoregressive(rho)
    lags = np.array([np.sum(x[k:] * x[: len(x) - k]) for k in range(6)])
    # Of an AR(1): (1 + |rho|) / (1 - |rho|), at frequency 0 or at the highest.
    expected = (1 + abs(rho)) / (1 - abs(rho))
    assert _peak(lags / lags[0], len(x)) == pytest.approx(expected, rel=0.1)


def test_white_noise_has_no_peak():
    rho = np.array([1.0, 0.05, -0.04, 0.02])
    assert _peak(rho, 100) == 1.0


def test_verdicts():
    """What a release of an undamped beam tells of five parameters, and what it does not."""
    names = ("young_modulus", "density", "shear_damping", "sensor_offset_y", "gravity_tilt_x")
    recording = release(beam(bending_damping=0.0))
    shifted = recording.tip_positions + [0.0, 0.002, 0.0]
    scene = beam(young_modulus=2.7e5, bending_damping=0.0, shear_damping=1.0)
    fit = calibrate(scene, [replace(recording, tip_positions=shifted)], fit=names, **OPTIONS)
    # Without damping only modulus over density moves the tip: a ratio does not tell its parts.
    assert not any(fit.parameters[name].identifiable for name in names[:2])
    assert {name: fit.parameters[name].verdict for name in names[2:]} == {
        # An effect that is not there is bounded from above.
        "shear_damping": "bounded above only",
        # A marker aside of the axis is seen aside.
        "sensor_offset_y": "identified",
        # Gravity that is turned about itself is the same.
        "gravity_tilt_x": "not identifiable",
    }
    assert fit.correlation[0, 1] > 0.99
    assert fit.parameters["sensor_offset_y"].value == pytest.approx(0.002, abs=1e-4)
    low, high = fit.parameters["shear_damping"].ci95
    assert low is None and high > 0


@pytest.mark.long
@pytest.mark.parametrize("correlation, count", [(0.0, 200), (0.6, 80)])
@pytest.mark.usefixtures("optimised_fits")
def test_coverage(correlation, count):
    """95 % intervals hold the truth in 90 to 98 % of synthetic recordings."""
    start = beam(young_modulus=2.8e5, bending_damping=7e-5)
    held = {name: 0 for name in (*TRUTH, "release")}
    for seed in range(count):
        recording = release(beam(), seed=100 + seed, correlation=correlation)
        fit = calibrate(start, [recording], fit=tuple(TRUTH), **OPTIONS)
        for name, truth in TRUTH.items():
            low, high = fit.parameters[name].ci95
            held[name] += low <= truth <= high
        low, high = fit.recordings[0].time_offset_ci95
        held["release"] += low <= RELEASE <= high
    for name, times in held.items():
        assert 0.90 <= times / count <= 0.98, (name, times)
