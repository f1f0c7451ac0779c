"""Natural frequencies and damping ratios about one static equilibrium, the slowest first.

Exit status 0 only if the equilibrium was found; otherwise 1, with the reason.
"""

import sys

from calibration.cli.common import (
    actuation,
    add_actuation,
    add_grid,
    grid,
    intervals,
    note,
    prepare_jax,
    print_json,
    reason,
)
from calibration.cli.solve import UNSTABLE

_AXES = "xyz"


def add_arguments(parser) -> None:
    parser.add_argument("scene", metavar="SCENE.toml", help="the scene file")
    parser.add_argument(
        "--count", type=intervals, default=6, metavar="N", help="how many modes (6)"
    )
    add_actuation(parser)
    add_grid(parser, "refine the grid until the tip's error is below X lengths of the rod")
    parser.add_argument("--json", action="store_true", help="JSON instead of a table")


def run(args) -> int:
    prepare_jax()
    import numpy as np

    import softrod_jax as sr

    scene = sr.load_scene(args.scene)
    inputs = actuation(args, scene)
    solution = sr.solve_static(scene, *inputs, throw=False, **grid(args))
    if int(solution.result) != 0:
        print(f"softrod: failed: {reason(solution.result)}", file=sys.stderr)
        return 1
    found = sr.modes(scene, *inputs, count=args.count, method=solution.method)
    if not bool(solution.stats["stable"]):
        note(UNSTABLE)
    moved = np.abs(np.asarray(found.shapes)).max(axis=1)
    rows = [
        {
            "frequency_Hz": float(frequency),
            "damping_ratio": float(ratio),
            "eigenvalue_per_s": [pole.real, pole.imag],
            "along": _AXES[int(np.argmax(way))] if np.any(way > 0) else None,
        }
        for frequency, ratio, pole, way in zip(
            found.frequencies, found.damping_ratios, np.asarray(found.eigenvalues), moved
        )
    ]
    if args.json:
        print_json({"modes": rows, "intervals": solution.method.intervals})
        return 0
    print("mode  frequency [Hz]  damping ratio  moves along")
    for k, row in enumerate(rows, 1):
        way = row["along"] or "-"
        print(f"{k:4d}  {row['frequency_Hz']:14.6g}  {row['damping_ratio']:13.6g}  {way}")
    return 0
