"""What the drivers of other packages share: the rod, and how they are asked for a run.

A driver runs in an environment of its own. It says that it is ready by a line of JSON,
`{"version", "setup_seconds"}`; then, for each line that it reads, it simulates once and prints
`{"seconds", "tip"}`: the time taken, and the tip [m] at t = 0, SAMPLE, 2 SAMPLE, .. in axes with z
along the straight rod, or null where the motion blew up. By hand:

    echo | python benchmarks/peers/mujoco_cable.py --segments 40 --dt 2e-3

The motion: the paper's rod, straight and at rest, under transverse gravity from t = 0.
"""

import json
import math
import sys
import time

DURATION, SAMPLE = 1.0, 0.04  # s
LENGTH, RADIUS = 0.1, 6e-3  # m
YOUNG, POISSON, DENSITY = 0.05e6, 0.49, 1070.0  # Pa, -, kg/m^3
BENDING_DAMPING = 1e-6  # N m^2 s, Kelvin-Voigt
GRAVITY = 9.81  # m/s^2, along -x

SHEAR = YOUNG / (2 * (1 + POISSON))
AREA, INERTIA = math.pi * RADIUS**2, math.pi * RADIUS**4 / 4
SAMPLES = round(DURATION / SAMPLE)


def steps_per_sample(dt: float) -> int:
    """So many that none is longer than `dt`."""
    return math.ceil(SAMPLE / dt - 1e-9)


def serve(version: str, prepare) -> None:
    """`prepare()` compiles what there is to compile and returns a simulation of no arguments,
    which returns the tip's path or None."""
    begin = time.perf_counter()
    simulate = prepare()
    setup = time.perf_counter() - begin
    print(json.dumps({"version": version, "setup_seconds": setup}), flush=True)
    for _ in sys.stdin:
        begin = time.perf_counter()
        path = simulate()
        seconds = time.perf_counter() - begin
        finite = path is not None and all(math.isfinite(x) for point in path for x in point)
        tip = [[float(x) for x in point] for point in path] if finite else None
        print(json.dumps({"seconds": seconds, "tip": tip}), flush=True)
