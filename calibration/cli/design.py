"""Choose, out of candidate postures, those whose recording would tell most.

CANDIDATES is a table of inputs, a row for each equilibrium that could be recorded, with the columns
of a postures log; measurements may be there and are not used. The scene's numbers are the ones at
which it is told how much each row says: those of a first fit, or a guess.
"""

import csv
import json
from dataclasses import replace
from pathlib import Path

from calibration.cli.common import (
    UsageError,
    check_writable,
    names_in,
    positive,
    prepare_jax,
    print_json,
    prior_in,
)
from calibration.cli.common import intervals as interval_count
from calibration.cli.waiting import waiting


def add_arguments(parser) -> None:
    parser.add_argument("scene", metavar="SCENE.toml", help="the scene file")
    parser.add_argument("candidates", metavar="CANDIDATES.csv", help="a row for each posture")
    parser.add_argument("--fit", required=True, metavar="NAME,..", help="what will be fitted")
    parser.add_argument(
        "--count", required=True, type=interval_count, metavar="N", help="how many to choose"
    )
    parser.add_argument(
        "--shrink",
        metavar="NAME,..",
        help="those of --fit whose intervals count (default: all)",
    )
    parser.add_argument(
        "--criterion",
        choices=("D", "A"),
        default="D",
        help="D: the joint interval's volume; A: the sum of squares of the intervals (D)",
    )
    parser.add_argument(
        "--markers",
        metavar="NAME,..",
        help="what will be seen (default: markers that have columns, or else all and the tip)",
    )
    parser.add_argument(
        "--recorded", metavar="LOG", nargs="+", help="postures that have been recorded already"
    )
    parser.add_argument(
        "--prior", metavar="NAME=MEAN:SPREAD", nargs="+", help="what is known beforehand"
    )
    noise = parser.add_mutually_exclusive_group()
    noise.add_argument(
        "--noise",
        type=positive,
        metavar="M",
        help="of a coordinate of a marker [m], where no column says it (1e-3)",
    )
    noise.add_argument(
        "--noise-from",
        metavar="DIR",
        help="a directory of `softrod calibrate --postures`, whose fit tells how large it is",
    )
    parser.add_argument("--intervals", type=interval_count, metavar="N", help="along the rod")
    parser.add_argument("--out", metavar="FILE.csv", help="write the chosen rows of CANDIDATES")
    parser.add_argument("--json", action="store_true", help="JSON instead of a table")


def run(args) -> int:
    priors = dict(prior_in(text) for text in args.prior or ())
    scale = _noise_scale(args.noise_from) if args.noise_from else 1.0
    if args.out is not None:
        check_writable(args.out)
    prepare_jax()
    import softrod_jax as sr
    from calibration.postures.data import joined, load_candidates, load_postures
    from calibration.postures.design import design_postures

    scene = sr.load_scene(args.scene)
    candidates = _noisy(load_candidates(args.candidates, scene, names_in(args.markers)), args.noise)
    recorded = None
    if args.recorded:
        recorded = _noisy(joined([load_postures(log, scene) for log in args.recorded]), args.noise)
    with waiting("comparing candidates"):
        design = design_postures(
            scene,
            candidates,
            fit=names_in(args.fit),
            count=args.count,
            shrink=names_in(args.shrink) or None,
            criterion=args.criterion,
            recorded=recorded,
            priors=priors,
            noise_scale=scale,
            method=sr.Collocation() if args.intervals is None else sr.Collocation(args.intervals),
        )
    if args.out is not None:
        _write(args.candidates, design.rows, args.out)
    if args.json:
        print_json(_content(design))
    else:
        print(_told(design, args))
    return 0


def _noise_scale(directory: str) -> float:
    path = Path(directory) / "parameters.json"
    try:
        return float(json.loads(path.read_text(encoding="utf-8"))["noise_scale"])
    except (KeyError, TypeError, ValueError):
        raise UsageError(
            f"--noise-from {directory}: {path} is not what `softrod calibrate --postures` writes"
        ) from None


def _noisy(postures, noise: float | None):
    """With the noise of markers [m] of which no column says it."""
    if noise is None:
        return postures
    return replace(postures, noise={**dict.fromkeys(postures.positions, noise), **postures.noise})


def _content(design) -> dict:
    return {
        "rows": [int(k) + 1 for k in design.rows],
        "trials": list(design.trials),
        "parameters": {
            name: {
                "expected_ci95": list(design.intervals[name]),
                "unit": design.units[name],
                "half_width": design.half_widths[name],
                "half_width_before": design.before[name],
                "half_width_with_all": design.all_rows[name],
            }
            for name in design.half_widths
        },
        "unsolved_rows": [int(k) + 1 for k in design.unsolved],
    }


def _told(design, args) -> str:
    chosen = ", ".join(design.trials or [str(k + 1) for k in design.rows])
    lines = [f"{'trials' if design.trials else 'rows'} of {args.candidates}: {chosen}"]
    for name, (low, high) in design.intervals.items():
        half, least = design.half_widths[name], design.all_rows[name]
        unit = "" if design.units[name] == "1" else f" {design.units[name]}"
        lines.append(
            f"{name}: expected within [{low:.4g}, {high:.4g}]{unit}; the interval is "
            f"{half / least:.2g} times as wide as with all candidates"
        )
    if len(design.unsolved):
        rows = ", ".join(str(k + 1) for k in design.unsolved)
        lines.append(f"without an equilibrium, and not chosen: rows {rows}")
    return "\n".join(lines)


def _write(candidates: str, rows, out: str) -> None:
    """The chosen rows as they are, in the order of the file, so that hysteresis stays as it was."""
    from calibration.postures.cells import read_cells
    from softrod_jax.foundation.whole_files import whole_file

    cells = read_cells(candidates)
    with whole_file(out, newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(cells.header)
        writer.writerows(cells.table[k][1] for k in sorted(rows.tolist()))
