"""Ten thousand targets that the paper's robot can reach: how many `inverse` reaches, and how fast.

Inputs are random, tensions up to 1 N and pressures up to 40 kPa; their tips are the targets. Prints
figures; with 1 N, the robot curls up by more than a turn, where tips hardly follow the inputs.

    python benchmarks/inverse.py [TARGETS]
"""

import sys
import time

import jax

jax.config.update("jax_enable_x64", True)

import numpy as np

import softrod_jax as sr

LIMITS = {"tensions": (0.0, 1.0), "pressures": (0.0, 40e3)}
METHOD = sr.Collocation(6)


def targets(robot, count: int) -> np.ndarray:
    """Tips under random admissible inputs, (count, 3) [m]."""
    draw = np.random.default_rng(0)
    tensions, pressures = draw.uniform(0, 1.0, (count, 3)), draw.uniform(0, 40e3, (count, 1))

    def tip(tensions, pressures):
        return sr.solve_static(robot, tensions, pressures, method=METHOD).tip_position

    return np.asarray(sr.spread(tip)(tensions, pressures))


def main(count: int) -> None:
    robot = sr.hybrid_robot()
    places = targets(robot, count)
    solve = lambda: jax.block_until_ready(
        sr.inverse(robot, places, LIMITS, method=METHOD, samples=1000, throw=False)
    )
    solve()
    start = time.perf_counter()
    found = solve()
    seconds = time.perf_counter() - start
    distance, iterations = np.asarray(found.distance), np.asarray(found.iterations)
    percentiles = np.percentile(iterations, [50, 90, 99, 100]).astype(int)
    print(f"{count} targets in {seconds:.1f} s, {1e3 * seconds / count:.2f} ms each")
    print(f"within 1e-6 m: {100 * np.mean(distance < 1e-6):.2f} %; farthest {distance.max():.1e} m")
    print(f"iterations: median {percentiles[0]}, 90 % {percentiles[1]}, 99 % {percentiles[2]}")
    print(f"codes: {dict(zip(*np.unique(found.result, return_counts=True), strict=True))}")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 10_000)
