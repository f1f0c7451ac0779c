"""Calibration: recovers what made the data, says what the data do not tell, fits a real beam."""

from dataclasses import replace
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest

import softrod_jax as sr
from calibration import Recording, calibrate, load_recording
from softrod_jax.scene.scene import as_arrays

BEAM = Path(__file__).parents[3] / "shared" / "data" / "beam" / "beam_gravity_V2_a.c3d"
LOADED = BEAM.with_name("beam_load52_V2_a.c3d")
TRUTH = {"young_modulus": 2.9e5, "bending_damping": 6e-5}
OFFSET, RATE, NOISE = 0.2036, 100.0, 3e-4


def beam(**values):
    return as_arrays(
        sr.Scene(
            length=0.1,
            section=sr.Rectangle(0.03, 0.03),
            poisson_ratio=0.49,
            density=1070.0,
            gravity=jnp.array([-9.81, 0.0, 0.0]),
            **values,
        )
    )


@pytest.fixture(scope="module")
def release():
    """A beam let go at OFFSET, made with a finer grid and time step than the fit uses."""
    motion = sr.simulate(
        beam(**TRUTH), 1e-3, steps=1000, method=sr.Collocation(20), scheme=sr.SDIRK(order=3)
    )
    times = np.arange(110) / RATE
    at = np.clip(times - OFFSET, 0.0, None)
    tip = np.stack([np.interp(at, motion.ts, x) for x in np.array(motion.tip_positions).T], 1)
    tip += NOISE * np.random.default_rng(0).normal(size=tip.shape)
    tip[[40, 41, 60]] = np.nan
    return Recording(times, None, None, tip, name="release")


@pytest.fixture(scope="module")
def fits(release):
    start = beam(young_modulus=2e5, bending_damping=1.5e-4)
    return {
        name: calibrate(start, [release], optimiser=name, checks=False, progress=False)
        for name in ("levenberg_marquardt", "adam")
    }


@pytest.mark.parametrize("optimiser", ["levenberg_marquardt", "adam"])
def test_truth_is_recovered(fits, optimiser):
    fit = fits[optimiser]
    for name, truth in TRUTH.items():
        estimate = fit.parameters[name]
        low, high = estimate.ci95
        assert estimate.identifiable
        assert low < truth < high, (name, estimate)
    assert high / low < 2
    assert abs(fit.time_offset_s["release"] - OFFSET) < 1e-3
    # What is left is the noise: NOISE in each of three coordinates.
    np.testing.assert_allclose(fit.rmse_m["release"], NOISE * np.sqrt(3), rtol=0.1)


def test_both_optimisers_agree(fits):
    by_lm, by_adam = (fits[name].parameters for name in ("levenberg_marquardt", "adam"))
    for name in TRUTH:
        low, high = by_lm[name].ci95
        assert abs(by_lm[name].value - by_adam[name].value) < 0.1 * (high - low)


def test_a_parameter_without_information_is_called_so(release, caplog):
    # The recording was made without drag: from above it is bounded, from below it is not.
    damping = TRUTH["bending_damping"]
    scene = beam(young_modulus=2.5e5, bending_damping=damping, drag_coefficient=1e-4)
    names = ("young_modulus", "drag_coefficient")
    caplog.set_level("INFO", "calibration")
    fit = calibrate(scene, [release], fit=names, checks=False, progress=False)
    said = [record.getMessage() for record in caplog.records]
    assert (
        f"simulated with steps of {fit.dt['release']:.4g} s, {fit.method.intervals} intervals"
        in said[0]
    )
    assert "stage: levenberg marquardt" in said and "stage: intervals" in said
    assert fit.parameters["young_modulus"].identifiable
    drag = fit.parameters["drag_coefficient"]
    assert np.isfinite(drag.value)
    assert not drag.identifiable


@pytest.mark.parametrize(
    "arguments, words",
    [
        (dict(fit=("stiffness",)), "stiffness"),
        (dict(fit=("drag_coefficient",)), "no drag_coefficient"),
        (dict(fit=()), "no parameters"),
        (dict(fit=("density", "density")), "twice"),
        (dict(optimiser="luck"), "luck"),
        (dict(max_iterations=0), "max_iterations"),
    ],
)
def test_bad_arguments(release, arguments, words):
    scene = beam(young_modulus=2e5, bending_damping=1e-3)
    with pytest.raises(ValueError, match=words):
        calibrate(scene, [release], progress=False, **arguments)


def test_no_recordings():
    with pytest.raises(ValueError, match="recordings"):
        calibrate(beam(young_modulus=2e5), [], progress=False)


@pytest.mark.long
@pytest.mark.skipif(not BEAM.exists(), reason="shared/data/beam is absent")
def test_a_real_beam():
    """Silicone beam, motion capture: the modulus is known, shear damping and drag are not."""
    scene = beam(young_modulus=2e5, bending_damping=1e-3, drag_coefficient=0.03, shear_damping=0.1)
    names = ("young_modulus", "bending_damping", "drag_coefficient", "shear_damping")
    fit = calibrate(scene, [load_recording(BEAM, scene)], fit=names, checks=False, progress=False)
    assert fit.rmse_m[BEAM.stem] < 2.3e-4
    modulus = fit.parameters["young_modulus"]
    assert modulus.identifiable and 2.6e5 < modulus.value < 3.3e5
    assert not fit.parameters["drag_coefficient"].identifiable
    assert not fit.parameters["shear_damping"].identifiable


@pytest.mark.long
@pytest.mark.skipif(not LOADED.exists(), reason="shared/data/beam is absent")
@pytest.mark.usefixtures("optimised_fits")
def test_a_real_beam_with_and_without_a_weight():
    """One modulus and one damping for both, if the fit knows that a hand let go of the weight."""
    scene = beam(young_modulus=3e5, bending_damping=5e-5)
    recordings = [
        replace(load_recording(path, scene), conditions={"payload_mass": mass})
        for path, mass in ((BEAM, 0.0), (LOADED, 0.052))
    ]
    fit = calibrate(
        scene,
        recordings,
        fit=("young_modulus", "bending_damping", "release_duration"),
        per_recording=("release_duration",),
        checks=False,
        progress=False,
    )
    assert all(rmse < 6e-4 for rmse in fit.rmse_m.values())
    assert all(fit.parameters[n].identifiable for n in ("young_modulus", "bending_damping"))
    # Fingers follow a weight for longer.
    bare, loaded = (fit.parameters[f"release_duration@{p.stem}"] for p in (BEAM, LOADED))
    assert bare.ci95[1] < loaded.ci95[0]


@pytest.mark.long
@pytest.mark.skipif(not LOADED.exists(), reason="shared/data/beam is absent")
@pytest.mark.usefixtures("optimised_fits")
def test_a_real_beam_relaxes():
    """A branch that relaxes, in place of the viscous damping, leaves a quarter less of one."""
    scene = beam(young_modulus=3e5, relaxation=[[0.1, 0.1]])
    recordings = [
        replace(load_recording(path, scene), conditions={"payload_mass": mass})
        for path, mass in ((BEAM, 0.0), (LOADED, 0.052))
    ]
    names = ("young_modulus", "relaxation_part_1", "relaxation_time_1")
    fit = calibrate(
        scene,
        recordings,
        fit=(*names, "release_duration"),
        per_recording=("release_duration",),
        checks=False,
        progress=False,
        dt=5e-3,
        method=sr.Collocation(4),
    )
    assert all(fit.parameters[name].identifiable for name in names)
    # 0.52 and 0.56 mm with a viscous damping, which has one number less.
    assert fit.rmse_m[BEAM.stem] < 4e-4 and fit.rmse_m[LOADED.stem] < 5.3e-4
