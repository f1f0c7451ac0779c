"""Do the 95 % intervals of fits to motions and postures together hold the truth as often?

    python benchmarks/joint_intervals.py [--fits 200] [--seed 0]

A beam with a tendon: a release without it, seen to 0.2 mm at 100 Hz, and 14 equilibria under
tensions, seen to 0.5 mm, which is not said. Modulus, bending damping and density are fitted to
both. For each fit noise of its own; how many intervals hold the truth, and how they are spread:
a standard score is (estimate - truth) / standard error.
"""

import argparse

import jax

jax.config.update("jax_enable_x64", True)


import jax.numpy as jnp
import numpy as np
from report import machine

import softrod_jax as sr
from calibration import Recording, calibrate
from calibration.postures.data import Postures
from softrod_jax.scene.inputs import Inputs
from softrod_jax.scene.scene import as_arrays

TRUTH = {"young_modulus": 2.9e5, "bending_damping": 6e-5, "density": 1070.0}
START = {"young_modulus": 2.4e5, "bending_damping": 9e-5, "density": 980.0}
RATE, STEPS, HELD = 100.0, 64, 10
SEEN = {"motion": 2e-4, "rest": 5e-4}  # m
TENSIONS = np.linspace(0.0, 6.0, 14)[:, None]
GRID = sr.Collocation(intervals=2, order=6)
FIT = {"dt": 1 / RATE, "method": GRID, "checks": False, "progress": False, "window": (0.0, 1.0)}


def robot(values, tendon: bool = True) -> sr.Scene:
    """The beam with these numbers."""
    scene = sr.Scene(
        length=0.1,
        section=sr.Rectangle(0.03, 0.03),
        poisson_ratio=0.45,
        gravity=[0.0, -9.81, 0.0],
        tendons=sr.Tendons(np.array([[0.0, 8e-3]])) if tendon else None,
        **values,
    )
    return as_arrays(scene)


def exact():
    """Tips of the release and of the equilibria, (samples, 3) and (rows, 3) [m]."""
    options = {"scheme": sr.SDIRK(), "method": GRID}
    motion = sr.simulate(robot(TRUTH, tendon=False), 1 / RATE, steps=STEPS, **options)
    tip = np.asarray(motion.tip_positions)
    solve = lambda T: sr.solve_static(robot(TRUTH), T, method=GRID).tip_position
    return np.concatenate([np.repeat(tip[:1], HELD, 0), tip]), np.asarray(
        jax.vmap(solve)(jnp.asarray(TENSIONS))
    )


def fitted(swing, rest, seed: int):
    """A fit to both, with noise of `seed`."""
    rng = np.random.default_rng(seed)
    noisy = lambda x, key: x + SEEN[key] * rng.normal(size=x.shape)
    times = (np.arange(len(swing)) - HELD) / RATE
    recording = Recording(times, None, None, noisy(swing, "motion"), name="release")
    postures = Postures(Inputs(tensions=TENSIONS), {"tip": noisy(rest, "rest")}, name="rest")
    return calibrate(robot(START), [recording], fit=tuple(TRUTH), postures=postures, **FIT)


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("--fits", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    print(machine())
    swing, rest = exact()
    held, scores = [], []
    for k in range(args.fits):
        found = fitted(swing, rest, args.seed + k).parameters
        inside, score = [], []
        for name, true in TRUTH.items():
            low, high = (x if x is not None else np.nan for x in found[name].ci95)
            inside.append(not (true < low or true > high))
            score.append(np.log(found[name].value / true) / found[name].standard_error)
        held.append(inside)
        scores.append(score)
        if (k + 1) % 10 == 0:
            part, z = 100 * np.mean(held, axis=0), np.array(scores)
            told = ", ".join(
                f"{name} {p:.1f} % (scores {np.mean(x):+.2f} +- {np.std(x):.2f})"
                for name, p, x in zip(TRUTH, part, z.T, strict=True)
            )
            print(f"{k + 1} fits: {told}", flush=True)
