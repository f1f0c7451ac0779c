"""Tendons with friction: random paths of tensions, and what friction costs in a motion.

    python benchmarks/tendon_friction.py [paths] [cost] [--count 60] [--seed 0]

- `paths`: a robot with three tendons, one of them a helix, each with a coefficient between 0.01 and
  1, under gravity in any direction, along eight random tensions: how many equilibria are found, and
  how far they are from those of 48 intervals.
- `cost`: a motion of it against the same without friction, and with a coefficient of zero, all on
  the same grid, in seconds and in evaluations of Newton's method.
"""

import argparse
import dataclasses
import time

import jax

jax.config.update("jax_enable_x64", True)

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from report import machine

import softrod_jax as sr

ROBOT = sr.hybrid_robot()
ROWS, MOST = 8, 0.6


def robot(friction, turns, gravity) -> sr.Scene:
    """The third tendon winds about the axis, by part of a turn."""
    offsets = ROBOT.tendons.offsets * jnp.array([[1.0], [1.0], [0.0]])
    paths = (None, None, sr.Helix(4e-3, 0.3, jnp.array(turns)))
    tendons = sr.Tendons(offsets, paths=paths, friction=friction)
    return dataclasses.replace(ROBOT, tendons=tendons, gravity=jnp.asarray(gravity))


def drawn(rng):
    """A robot, and tensions [N], (rows, 3), some of them zero."""
    friction = tuple(jnp.array(x) for x in 10 ** rng.uniform(-2, 0, 3))
    direction = rng.normal(size=3)
    gravity = 9.81 * direction / np.linalg.norm(direction)
    scene = robot(friction, rng.uniform(-0.7, 0.7), gravity)
    walk = np.abs(np.cumsum(0.12 * rng.normal(size=(ROWS, 3)), axis=0))
    return scene, np.minimum(walk * (rng.uniform(size=walk.shape) < 0.9), MOST)


def paths(rng, count: int) -> None:
    """Along random paths."""
    found, apart = 0, []
    begun = time.perf_counter()
    for _ in range(count):
        scene, tensions = drawn(rng)
        own = sr.solve_path(scene, tensions, throw=False)
        fine = sr.solve_path(scene, tensions, throw=False, method=sr.Collocation(48))
        good = np.asarray(own.result == 0)
        found += int(np.sum(good))
        both = np.cumprod(good & np.asarray(fine.result == 0)).astype(bool)
        off = np.linalg.norm(own.tip_position - fine.tip_position, axis=1) / float(scene.length)
        apart += list(off[both])
    print(
        f"{found} of {count * ROWS} equilibria found; from those of 48 intervals they are off by "
        f"{np.median(apart):.1e} L in the median, {np.max(apart):.1e} at most ({len(apart)} "
        f"compared); {time.perf_counter() - begun:.0f} s with compiling"
    )


def cost(repeats: int = 5) -> None:
    """Of a swing of 1 s in steps of 5 ms."""
    t = 5e-3 * np.arange(1, 201)
    tensions = np.outer(0.125 - 0.125 * np.cos(4 * np.pi * t), [1.0, 0.0, 0.0])
    cases = {"none": None, "coefficient 0": (0.0,) * 3, "coefficient 0.2": (0.2,) * 3}
    best, evaluations, grid = {}, {}, sr.Collocation()
    for _ in range(repeats + 1):
        for name, friction in cases.items():
            scene = robot(friction, 0.3, [-9.81, 0.0, 0.0])
            begun = time.perf_counter()
            motion = one(scene, tensions, grid)
            evaluations[name] = float(np.mean(motion.stats["iterations"]))
            best[name] = min(best.get(name, np.inf), time.perf_counter() - begun)
    for name, seconds in best.items():
        print(
            f"{name}: {5 * seconds:.2f} ms a step, {seconds / best['none']:.2f} times; "
            f"{evaluations[name]:.1f} evaluations"
        )


@eqx.filter_jit
def _simulated(scene, tensions, grid):
    return sr.simulate(scene, 5e-3, tensions, substeps=1, method=grid, throw=False)


def one(scene, tensions, grid):
    """A motion, when it is there; under jit nothing is compared or refined."""
    return jax.block_until_ready(_simulated(scene, tensions, grid))


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("parts", nargs="*", default=["paths", "cost"])
    parser.add_argument("--count", type=int, default=60)
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    print(machine())
    if "paths" in args.parts:
        paths(np.random.default_rng(args.seed), args.count)
    if "cost" in args.parts:
        cost()
