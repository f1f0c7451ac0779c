"""A planar rod by finite differences, explicit in time but for the damping (numpy, scipy).

    echo | python benchmarks/peers/explicit_rod.py --folder FOLDER --elements 50

FOLDER holds `dynamic.py`, an independent solver that is not part of the repository.
"""

import argparse
import sys

import common
import numpy as np


def prepare(folder: str, elements: int, case: str):
    sys.path.insert(0, folder)
    import dynamic

    times = common.SAMPLE * np.arange(common.SAMPLES + 1)

    def simulate(times=times):
        rod = dynamic.Planar(elements, **dynamic.CASES[case])
        path, _ = rod.leapfrog(times[-1], times)
        return np.stack([path[:, 1], 0 * path[:, 1], path[:, 2]], axis=1)

    simulate(times[:2])
    return simulate


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("--folder", required=True)
    parser.add_argument("--elements", type=int, required=True)
    parser.add_argument("--case", default="gravity_step")
    options = parser.parse_args()
    make = lambda: prepare(options.folder, options.elements, options.case)
    common.serve("explicit finite differences", make)
