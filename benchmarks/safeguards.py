"""What the safeguards cost on an ordinary scene: a plain solver beside the real one.

    python benchmarks/safeguards.py [--write-docs]

The robot of `softrod_jax.hybrid_robot` at dt = 15 ms, under gravity alone and with a tendon. The
plain solver is the same without continuation behind Newton's method, without estimates of the
errors along the rod and in time, and without artificial viscosity. Runs alternate; the ratio is
that of neighbours, so that a slow moment of the machine falls on both.
"""

import time
from unittest import mock

import jax

jax.config.update("jax_enable_x64", True)

import jax.numpy as jnp
import numpy as np
from report import machine, publish, table

import softrod_jax as sr
from softrod_jax.bvp.boundary_value import search_directly
from softrod_jax.rod import constants as rod
from softrod_jax.stepping import moving_rod

DT, STEPS, PAIRS = 15e-3, 400, 25


def plainly(equations, options, U, before):
    return search_directly(equations, options, U, before.reused)


def without_viscosity(*arguments, spread_fronts=False, **options):
    return rod.make_rod(*arguments, **options)


def plain():
    """Everything that is left out, as patches."""
    nothing = lambda *_: jnp.zeros(())
    return (
        mock.patch.object(moving_rod, "search_by_inertia", plainly),
        mock.patch.object(moving_rod, "make_rod", without_viscosity),
        mock.patch.object(sr.Collocation, "error_in_motion", nothing),
        mock.patch.object(moving_rod, "accumulated", nothing),
    )


def program(tendon: bool, scheme):
    """The compiled motion, a function of nothing."""
    scene = sr.hybrid_robot(gravity=jnp.array([-9.81, 0.0, 0.0]))
    tensions = jnp.tile(jnp.array([0.1, 0.0, 0.0]), (STEPS, 1)) if tendon else None
    steps = None if tendon else STEPS

    def tips(dt):
        motion = sr.simulate(scene, dt, tensions, steps=steps, scheme=scheme, throw=False)
        return motion.tip_positions, motion.result, motion.stats

    jax.clear_caches()
    compiled = jax.jit(tips).lower(DT).compile()
    return lambda: jax.block_until_ready(compiled(DT))


def compare(tendon: bool, scheme):
    """Time of a step, plain and safe [ms], medians, and the quartiles of their ratio."""
    safe = program(tendon, scheme)
    patches = plain()
    for patch in patches:
        patch.start()
    bare = program(tendon, scheme)
    for patch in patches:
        patch.stop()
    far = jnp.max(jnp.abs(bare()[0] - safe()[0]))
    assert far < 1e-4, f"not the same motion: {far} m apart"
    times = []
    for _ in range(PAIRS):
        pair = []
        for run in (bare, safe):
            begin = time.perf_counter()
            run()
            pair.append(1e3 * (time.perf_counter() - begin) / STEPS)
        times.append(pair)
    times = np.array(times)
    return *np.median(times, 0), *np.quantile(times[:, 1] / times[:, 0], [0.25, 0.5, 0.75])


def main():
    rows = []
    for scheme in (sr.SDIRK(3), sr.BDFAlpha(-0.2)):
        for tendon in (False, True):
            bare, safe, low, middle, high = compare(tendon, scheme)
            name = "SDIRK(3)" if scheme.one_step else f"BDFAlpha({scheme.alpha:g})"
            where = "gravity and a tendon" if tendon else "gravity"
            ratio = f"{middle:.2f} ({low:.2f}, {high:.2f})"
            rows.append([f"`{name}`", where, f"{bare:.2f}", f"{safe:.2f}", ratio])
    header = ["scheme", "scene", "plain [ms a step]", "real", "ratio (quartiles)"]
    publish("safeguards", "reliability.md", f"{table(header, rows)}\n\n{machine()}.")


if __name__ == "__main__":
    main()
