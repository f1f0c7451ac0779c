"""The catheter of `notebooks/12_catheter.ipynb`: its force on a beating wall, and the gradient.

    python benchmarks/catheter.py [force] [gradient]

The article's robot of 0.519 MPa presses on a wall that moves by 8 mm at 1.2 Hz, with friction.

- `force`: at steps of 10 ms on 12 and 24 intervals, and of 5 ms on 24, against 2.5 ms on 48.
- `gradient`: of the mean force over the second beat, by each coefficient of the tension (a constant
  and five harmonics), against central differences of two sizes, and by two tolerances of Newton's
  method.
"""

import argparse
import dataclasses

import jax

jax.config.update("jax_enable_x64", True)

import jax.numpy as jnp
import numpy as np
from report import machine

import softrod_jax as sr

RATE, LEAN, HELD, HARMONICS = 1.2, np.deg2rad(68.0), 2.8216, 5
OUT = np.array([np.sin(LEAN), 0.0, np.cos(LEAN)])
AIR = jnp.array([1e4])
# What the notebook finds, rounded: the constant, cosines, sines.
FOUND = [-0.03, -0.32, 0.00, 0.08, 0.00, -0.02, -0.31, -0.01, -0.04, 0.01, 0.02]


def robot(friction: float) -> sr.Scene:
    """On its wall."""
    plane = sr.Plane(np.array([0.025, 0.0, 0.08]), -OUT)
    tissue = sr.Contact(plane, 2e4, damping=2.0, friction=friction, name="tissue")
    return dataclasses.replace(sr.hybrid_robot(), young_modulus=0.519e6, contacts=(tissue,))


def pressing(dt: float, intervals: int, friction: float = 0.2, **options):
    """A function from coefficients to the force on the wall [N], at steps over almost two beats."""
    scene, method = robot(friction), sr.Collocation(intervals)
    start = sr.solve_static(scene, (HELD, 0.0, 0.0), AIR, method=method)
    steps = round(1.66 / dt)
    t = dt * np.arange(1, steps + 1)
    poses = np.zeros((steps, 7))
    poses[:, :3] = -4e-3 * (1 - np.cos(2 * np.pi * RATE * t))[:, None] * OUT
    poses[:, 3] = 1.0
    phase = 2 * np.pi * RATE * t[:, None] * np.arange(1, HARMONICS + 1)
    series = np.concatenate([np.ones((steps, 1)), np.cos(phase), np.sin(phase)], axis=1)
    series = jnp.asarray(series * np.minimum(t / 0.1, 1.0)[:, None])

    def force(x):
        motion = sr.simulate(
            scene,
            dt,
            jnp.zeros((steps, 3)).at[:, 0].set(HELD + series @ x),
            jnp.tile(AIR, (steps, 1)),
            contacts={"tissue": poses},
            initial=start,
            max_time_error=1.0,
            throw=False,
            **options,
        )
        return motion.contact_forces["tissue"] @ -OUT, motion.result

    return force


def force() -> None:
    """Of constant tension, and of the found commands."""
    for friction in (0.0, 0.2):
        exact = None
        for dt, intervals in ((0.0025, 48), (0.01, 12), (0.01, 24), (0.005, 24)):
            run = jax.jit(pressing(dt, intervals, friction or None))
            for name, x in (("constant", np.zeros(len(FOUND))), ("found", np.array(FOUND))):
                found, result = run(x)
                assert int(result) == 0
                found = np.asarray(found)[:: round(0.01 / dt)]
                if exact is None or len(exact) < 2:
                    exact = {**(exact or {}), name: found}
                    continue
                off = 100 * np.abs(found / exact[name] - 1)
                print(
                    f"friction {friction}, {name}, {1e3 * dt:g} ms, {intervals} intervals: "
                    f"{np.median(off):.3f} % off in the median, {off.max():.2f} % at most, "
                    f"{off[20:].max():.2f} % after 0.2 s; the mean "
                    f"{100 * abs(found.mean() / exact[name].mean() - 1):.3f} %"
                )


def gradient() -> None:
    """At constant tension and at the found commands."""
    for tolerance in (1e-10, 1e-12):
        options = dict(newton=sr.NewtonOptions(tolerance=tolerance))
        run = pressing(0.01, 12, **options)
        mean = lambda x, run=run: jnp.mean(run(x)[0][84:])
        slopes, value = jax.jit(jax.jacfwd(mean)), jax.jit(jax.vmap(mean))
        for name, x in (("constant", np.zeros(len(FOUND))), ("found", np.array(FOUND))):
            own = np.asarray(slopes(x))
            for d in (1e-4, 1e-5):
                sides = x + d * np.concatenate([np.eye(len(x)), -np.eye(len(x))])
                ahead, behind = np.split(np.asarray(value(sides)), 2)
                off = np.abs((ahead - behind) / (2 * d) - own)
                print(
                    f"tolerance {tolerance:g}, {name}, differences of {d:g} N: {off.max():.1e} N/N "
                    f"apart at most, of slopes up to {np.abs(own).max():.3f}: "
                    f"{(off / np.abs(own)).max():.1e} of the own slope, "
                    f"{off.max() / np.abs(own).max():.1e} of the largest"
                )


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("parts", nargs="*", default=["force", "gradient"])
    args = parser.parse_args()
    print(machine())
    for name, part in (("force", force), ("gradient", gradient)):
        if name in args.parts:
            part()
