"""A small calibration problem: a rod of silicone, let go or swung, on a coarse grid and quickly.

The recordings are made with the same discretisation as the fits use: what is tested is the fit and
not the simulation, and noise is the only difference.
"""

import jax.numpy as jnp
import numpy as np

import softrod_jax as sr
from calibration import Recording
from calibration.experiment.release import with_supporting_hand
from softrod_jax.scene.scene import as_arrays

SETTINGS = dict(scheme=sr.SDIRK(order=2), method=sr.Collocation(intervals=2, order=6))
TRUTH = {"young_modulus": 2.9e5, "bending_damping": 6e-5}
RATE, STEPS, RELEASE, NOISE = 100.0, 32, 0.05, 2e-4
# Of fits: with the steps of the recordings, too.
# A log that is made by the very steps that fit it.
AS_FITTED = dict(substeps=1, max_time_error=jnp.inf, **SETTINGS)
FIT = dict(dt=1 / RATE, **SETTINGS)


def beam(**values):
    """A square rod, 0.1 m long, clamped horizontally."""
    parts = {**TRUTH, **values}
    return as_arrays(
        sr.Scene(
            length=0.1,
            section=sr.Rectangle(0.03, 0.03),
            poisson_ratio=0.49,
            density=1070.0,
            gravity=jnp.array([-9.81, 0.0, 0.0]),
            **parts,
        )
    )


def release(scene, seed=0, noise=NOISE, name="release", correlation=0.0, duration=None, **parts):
    """The rod of `scene`, held straight and let go at RELEASE [s], at once or within `duration`
    [s]; noise that is white, or an AR(1) of this correlation from sample to sample."""
    tensions = None
    if duration is not None:
        scene, tensions = with_supporting_hand(
            scene, jnp.array(duration), jnp.array(1 / RATE), STEPS
        )
    motion = sr.simulate(scene, 1 / RATE, tensions, steps=STEPS, **AS_FITTED)
    lead = round(RELEASE * RATE)
    tip = np.asarray(motion.tip_positions)
    tip = np.concatenate([np.repeat(tip[:1], lead, axis=0), tip])[: STEPS + lead]
    white = np.random.default_rng(seed).normal(size=tip.shape)
    coloured = white.copy()
    for k in range(1, len(white)):
        fresh = np.sqrt(1 - correlation**2) * white[k]
        coloured[k] = correlation * coloured[k - 1] + fresh
    times = np.arange(len(tip)) / RATE
    return Recording(times, None, None, tip + noise * coloured, name=name, **parts)
