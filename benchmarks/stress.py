"""Stress test: random scenes far beyond the ordinary, each against a better solution.

    python benchmarks/stress.py [--equilibria 2000] [--motions 500] [--seed 0] [--judge 2000]
        [--processes 2] [--rows FILE] [--only K,K,..] [--details] [--write-docs]

Equilibria are those of `stress_equilibria.py`: the first --judge of them are judged by an
independent solver, the others by a finer grid. Motions are those of `stress_motions.py`, compared
with a refined run of the same code; `judge_motion.py` is their independent judge. --details shows
both by kind, and the worst.

Scenes that have no answer, a wrong one, or take long are printed; in the end, counts. With
--write-docs the map and the counts go into the documentation. --rows keeps each scene's row in a
file, and a later run with the same file goes on from there.
"""

import argparse
import json
import multiprocessing
import time
from collections import Counter
from pathlib import Path

import jax

jax.config.update("jax_enable_x64", True)

import matplotlib
import numpy as np
import stress_equilibria
import stress_motions
from report import machine, publish, table

FIGURE = Path(__file__).parent / "figures" / "stress.png"
LONG = 20.0
NAMES = {"equilibrium": "equilibria", "motion": "motions"}
KINDS = {"equilibrium": stress_equilibria, "motion": stress_motions}
# In the map, scenes without a load or an error are drawn at the edge.
LOWEST = {"load": 1e-3, "error": 1e-12}


def one(task):
    """The row of (what, seed, scene, whether to judge), by what it is."""
    what, seed, k, judged = task
    if what == "motion":
        return {"what": what, **stress_motions.one(seed, k)}
    return {"what": what, **stress_equilibria.one(seed, k, judged)}


def is_solved(row):
    return row["result"] == "successful"


def is_wrong(row):
    """Called successful, and off by more than a hundredth of the rod."""
    return KINDS[row["what"]].is_wrong(row)


def is_flattering(row):
    """The estimate is below a third of an error that can be seen."""
    return KINDS[row["what"]].is_flattering(row)


def is_answered(row):
    """There is a rod, if not one that is accurate: its error has an estimate."""
    return row["result"] in ("successful", "inaccurate")


def is_remarkable(row):
    return not is_solved(row) or is_wrong(row) or is_flattering(row) or row["time"] > LONG


def run(tasks, processes):
    """One row a task, as they are done."""
    if processes == 1:
        yield from map(one, tasks)
        return
    with multiprocessing.get_context("spawn").Pool(processes) as pool:
        yield from pool.imap_unordered(one, tasks, chunksize=2)


def draw(rows):
    """The map: each scene by two of its numbers, coloured by its error."""
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(1, 2, figsize=(10, 4), layout="constrained")
    places = {
        "equilibrium": ("slenderness", "load", "slenderness $L/r$", "largest load, in $EI/L^2$"),
        "motion": ("wave", "damping", "$c\\,\\Delta t/L$, $c$: speed of a wave", "$B/EI$ [s]"),
    }
    dots = None
    for axis, (what, (x, y, x_label, y_label)) in zip(axes, places.items(), strict=True):
        here = [row for row in rows if row["what"] == what]
        good = [row for row in here if is_solved(row) and np.isfinite(row["error"])]
        bad = [row for row in here if row not in good]
        column = lambda name, rows: np.maximum([row[name] for row in rows], LOWEST.get(name, 0.0))
        errors = np.log10(column("error", good))
        dots = axis.scatter(
            column(x, good), column(y, good), c=errors, s=9, cmap="viridis", vmin=-9, vmax=-2
        )
        axis.scatter(column(x, bad), column(y, bad), marker="x", color="#d62728", label="no answer")
        axis.set(xscale="log", yscale="log", xlabel=x_label, ylabel=y_label)
        axis.set_title(f"{len(here)} {NAMES[what]}", loc="left")
        if bad:  # above the points, which are everywhere
            axis.legend(loc="lower right", bbox_to_anchor=(1.0, 0.99), frameon=False)
    bar = figure.colorbar(dots, ax=axes)
    bar.set_label("error of the tip, $\\log_{10}$ of lengths")
    return figure


def compared_with(what, rows) -> str:
    if what == "motion":
        return f"a refined run for {sum(np.isfinite(row['error']) for row in rows)}"
    judged = sum(row["judged"] and np.isfinite(row["error"]) for row in rows)
    return f"an independent solver for {judged}, a finer grid for the others"


def summary(rows) -> str:
    lines = []
    for what, name in NAMES.items():
        here = [row for row in rows if row["what"] == what]
        if not here:
            continue
        times = np.array([row["time"] for row in here])
        solved = [row for row in here if is_solved(row)]
        codes = Counter(row["result"] for row in here if not is_solved(row))
        lines.append(
            [
                name,
                str(len(here)),
                str(len(solved)),
                ", ".join(f"{n} `{code}`" for code, n in codes.items()) or "none",
                compared_with(what, here),
                str(sum(map(is_wrong, here))),
                str(sum(map(is_flattering, filter(is_answered, here)))),
                f"{np.nanmax([row['error'] for row in solved]):.0e}".replace("e-0", "e-"),
                f"{np.median(times):.2g}, {np.quantile(times, 0.95):.2g}",
            ]
        )
    header = [
        "",
        "scenes",
        "solved",
        "codes of the others",
        "compared with",
        "solved, off by over 1 %",
        "estimate below a third of an error above 1e-5",
        "largest error, lengths",
        "time, median and 95 % [s]",
    ]
    return table(header, lines)


def chosen(options, done):
    """Tasks, (what, seed, scene, whether to judge), that are not yet done."""
    counts = {"equilibrium": options.equilibria, "motion": options.motions}
    for what, count in counts.items():
        for k in range(count) if options.only is None else options.only:
            if (what, k) not in done and count:
                yield what, options.seed, k, k < options.judge


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--equilibria", type=int, default=2000)
    parser.add_argument("--motions", type=int, default=500)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--judge", type=int, default=2000)
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--rows", type=Path)
    parser.add_argument("--only", type=lambda text: [int(k) for k in text.split(",")])
    parser.add_argument("--details", action="store_true")
    parser.add_argument("--write-docs", action="store_true")
    options = parser.parse_args()
    rows, begin = [], time.perf_counter()
    if options.rows and options.rows.exists():
        rows = [json.loads(line) for line in options.rows.read_text().splitlines()]
    done = {(row["what"], row["scene"]) for row in rows}
    for row in run(list(chosen(options, done)), options.processes):
        rows.append(row)
        if options.rows:
            with options.rows.open("a") as file:
                file.write(json.dumps(row) + "\n")
        if options.only or is_remarkable(row):
            told = {n: v for n, v in row.items() if not isinstance(v, list)}
            shown = {n: f"{v:.3g}" if isinstance(v, float) else v for n, v in told.items()}
            print(shown, flush=True)
    print(f"{(time.perf_counter() - begin) / 60:.1f} min, seed {options.seed}")
    if options.details:
        for what, kind in KINDS.items():
            here = [row for row in rows if row["what"] == what]
            print(kind.details(here) if here else "")
    if options.write_docs:
        matplotlib.use("agg")
        draw(rows).savefig(FIGURE, dpi=130)
    publish("stress", "reliability.md", f"{summary(rows)}\n\n{machine()}.")


if __name__ == "__main__":
    main()
