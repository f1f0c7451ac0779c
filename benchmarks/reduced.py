"""The nonlinear model of few coordinates against the whole rod: errors of the tip, and times.

    python benchmarks/reduced.py            # prints a table, some minutes
    python benchmarks/reduced.py --quick    # one row

The paper's robot hangs, and three tendons lead its tip around a circle in 2 s, steps of 10 ms. What
is true is the whole rod on 12 intervals with a quarter of the steps. Times are those of the
processor, on one core, the least of five, for each step of 10 ms.
"""

import argparse
import os
import time

import jax
import jax.numpy as jnp
import numpy as np

import softrod_jax as sr

ROBOT = sr.hybrid_robot(gravity=jnp.array([0.0, 0.0, 9.81]))
DT, PERIOD, STEPS, LENGTH = 0.01, 2.0, 400, 0.1


def circle(largest):
    """Tensions [N], (steps, 3), after a ramp of half a second."""
    t = DT * np.arange(1, STEPS + 1)[:, None]
    phase = 2 * np.pi * (t / PERIOD - np.arange(3) / 3)
    return np.minimum(t / 0.5, 1.0) * 0.5 * largest * (1 + np.cos(phase))


def timed(run):
    """[ms] of the processor for each step, and what `run` returns."""
    found, times = jax.block_until_ready(run()), []
    for _ in range(5):
        begun = time.process_time()
        jax.block_until_ready(run())
        times.append(time.process_time() - begun)
    return 1e3 * min(times) / STEPS, np.asarray(found.tip_positions)


def percent(tip, true):
    off = 100 * np.linalg.norm(tip - true, axis=1) / LENGTH
    return f"{off.max():.2f} %, {np.sqrt(np.mean(off**2)):.2f} % rms"


def rows(largest, models):
    """Prints a line for the whole rod and for each model: coordinates, those that follow, grid."""
    tensions, none = circle(largest), np.zeros((STEPS, 1))
    begun = sr.solve_static(ROBOT, np.zeros(3), np.zeros(1), method=sr.Collocation(12))

    def whole(scheme, substeps=1):
        how = dict(initial=begun, scheme=scheme, substeps=substeps, throw=False)
        return sr.simulate(ROBOT, DT, tensions, none, **how)

    true = np.asarray(whole(sr.SDIRK(), 4).tip_positions)
    radius = np.linalg.norm(true[STEPS // 2 :, :2], axis=1).mean()
    print(f"tensions up to {largest} N, a circle of radius {1e3 * radius:.0f} mm")
    for scheme in (sr.SDIRK(), sr.BDFAlpha()):
        spent, tip = timed(lambda scheme=scheme: whole(scheme))
        print(
            f"whole rod, {type(scheme).__name__}: {percent(tip, true)}; {spent:.3f} ms", flush=True
        )
    for order, following, intervals in models:
        for scheme in (sr.SDIRK(2), sr.BDFAlpha()):
            limits = {"tensions": (0.0, largest)}
            grid = sr.Collocation(intervals, order=4)
            few = sr.reduce_nonlinear(
                ROBOT, limits, order, following=following, scheme=scheme, method=grid
            )
            rest = few.equilibrium(np.zeros(3), np.zeros(1))
            run = lambda few=few, rest=rest: few.simulate(DT, tensions, none, initial=rest)
            spent, tip = timed(run)
            name = f"{2 * order} states, {following} follow, {intervals} intervals"
            name = f"{name}, {type(scheme).__name__}"
            print(f"{name}: {percent(tip, true)}; {spent:.3f} ms", flush=True)


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true")
    quick = parser.parse_args().quick
    models = (6, 0, 2), (6, 0, 4), (6, 2, 4), (6, 4, 4), (5, 0, 4), (4, 0, 4)
    for largest in (0.2,) if quick else (0.2, 0.6):
        rows(largest, models[:1] if quick else models)


if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})
    main()
