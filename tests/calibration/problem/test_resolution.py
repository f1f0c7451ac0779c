"""A fit finds the time step and the grid that its scene and its recordings need."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest

import softrod_jax as sr
from calibration import Recording, calibrate
from calibration.parameters.unknowns import choose_unknowns
from calibration.problem.dataset import datasets
from calibration.problem.motion import METHOD
from calibration.problem.resolution import Resolution, choose_resolution
from calibration.report.numbers import as_json

NAMES = ("young_modulus", "bending_damping")


def chosen(scene, recording, dt=None, method=None):
    """The steps [s] and the intervals that a fit of `scene` to `recording` begins with."""
    setup, parameters = choose_unknowns(scene, [recording], [recording.name], NAMES)
    resolution = Resolution(datasets(scene, recording)[0], dt, method)
    first = resolution.first_problem(setup, parameters, time_offset=False)
    problem = choose_resolution(first, resolution)
    return problem.space.clocks[0].dt, problem.method.intervals


def rod(length, **parts):
    return sr.Scene(
        length=length,
        section=sr.Circle(6e-3),
        young_modulus=5e4,
        poisson_ratio=0.49,
        density=1070.0,
        bending_damping=2e-5,
        drag_coefficient=0.03,
        gravity=jnp.array([9.81, 0.0, 0.0]),
        **parts,
    )


def released(scene, interval, duration, noise=2e-4):
    """The rod, held out level and let go, by steps and a grid that are finer than those of fits."""
    every = max(1, round(interval / 2.5e-3))
    steps = every * round(duration / interval)
    motion = sr.simulate(scene, interval / every, steps=steps, method=sr.Collocation(32))
    tip = np.asarray(motion.tip_positions)[::every]
    tip = tip + noise * np.random.default_rng(0).normal(size=tip.shape)
    return Recording(interval * np.arange(len(tip)), None, None, tip, name="release")


@pytest.mark.long
@pytest.mark.parametrize("length", [0.2, 0.3])
def test_heavy_robots_need_more_intervals(length):
    """rho A g L^3 / EI is 190 and 630: the bending is in a layer at the clamp."""
    scene = rod(length)
    recording = released(scene, 0.01, 1.5)
    fit = calibrate(scene, [recording], fit=NAMES, time_offset=False, progress=False)
    assert fit.method.intervals > METHOD.intervals
    assert fit.parameters["young_modulus"].value == pytest.approx(5e4, rel=1e-3)
    assert fit.rmse_m["release"] == pytest.approx(2e-4 * np.sqrt(3), rel=0.05)
    assert fit.result == "converged"
    for estimate in fit.parameters.values():
        assert abs(estimate.grid_shift) < 0.25 and abs(estimate.step_shift) < 0.25


@pytest.mark.long
def test_a_slow_log_needs_few_steps_and_a_quick_one_more():
    """Twelve seconds at 20 Hz in which a tendon is pulled slowly, and a rod that rings at 20 Hz."""
    scene = rod(0.1, tendons=sr.Tendons(jnp.array([[4e-3, 0.0]])))
    scene = replace(scene, young_modulus=2e5)
    times = np.arange(0, 12, 0.05)
    pull = 0.1 * (1 - np.cos(2 * np.pi * times / 10))
    some = np.linspace(0, 0.2, 5)
    tips = [sr.solve_static(scene, jnp.array([t])).tip_position for t in some]
    tip = np.stack([np.interp(pull, some, x) for x in np.array(tips).T], axis=1)
    slow = Recording(times, pull[:, None], None, tip, name="slow", starts_hanging=True)
    dt, intervals = chosen(scene, slow)
    assert dt > 0.05 * (1 - 1e-12) and intervals == METHOD.intervals
    rings = replace(slow, times=times[:20], tip_positions=tip[:20], starts_hanging=False)
    rings = replace(rings, tensions=np.full((20, 1), 0.1))
    assert chosen(scene, rings)[0] < 0.02
    # What a user chooses stays.
    assert chosen(scene, rings, 0.05, METHOD) == (pytest.approx(0.05), METHOD.intervals)


@pytest.mark.long
def test_a_log_that_was_simulated_with_its_own_step():
    """As by `softrod simulate` at 5 ms: such a log holds the error of that step, which only the
    same step explains, and the report says so."""
    scene = sr.hybrid_robot(gravity=jnp.array([0.0, 0.0, 9.81]))
    scene = replace(scene, payload=sr.Payload(jnp.array(2e-3)), chambers=None)
    tensions = np.tile([0.1, 0.0, 0.0], (101, 1))
    motion = sr.simulate(scene, 5e-3, jnp.array(tensions[1:]))
    log = Recording(np.asarray(motion.ts), tensions, None, np.asarray(motion.tip_positions))
    start = replace(scene, young_modulus=1.3 * scene.young_modulus)
    fit = calibrate(start, [log], fit=NAMES, progress=False)
    for name in NAMES:
        truth, estimate = float(getattr(scene, name)), fit.parameters[name]
        assert estimate.value == pytest.approx(truth, rel=1e-3)
        assert estimate.ci95[0] < truth < estimate.ci95[1] and estimate.identifiable
    assert any("they look as if they had been simulated" in r for r in as_json(fit)["remarks"])
