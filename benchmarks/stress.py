"""Stress test: random scenes far beyond the ordinary, each against a better solution.

    python benchmarks/stress.py [--equilibria 2000] [--motions 500] [--seed 0] [--judge 2000]
        [--processes 2] [--rows FILE] [--only K,K,..] [--details] [--write-readme]

Equilibria are those of `stress_equilibria.py`: the first --judge of them are judged by an
independent solver, the others by a finer grid. --details shows them by kind, and the worst.

Motions have 20 steps. They span length 0.02 to 1 m, slenderness L/r 5 to 150, Young's modulus 3e4
to 2e11 Pa, density 900 to 8000 kg/m^3, damping B/EI 1e-5 to 3e-2 s, dt 1e-5 to 5e-2 s, gravity up
to rho A g L^3 / EI = 50, tensions up to 90 % of where a tendon's path vanishes, pressures, tip
loads, payloads and drag; inputs step or ramp. Only motions that would ring for more than 50 periods
are not drawn: they take long, and no more. Accuracy is asked for with `tolerance=`, as a user
would. The refined solution has a finer grid and half the tolerance.

Scenes that have no answer, a wrong one, or take long are printed; in the end, counts. With
--write-readme the map and the counts go into the README. --rows keeps each scene's row in a file,
and a later run with the same file goes on from there.
"""

import argparse
import json
import multiprocessing
import time
from collections import Counter
from pathlib import Path

import jax

jax.config.update("jax_enable_x64", True)

import jax.numpy as jnp
import matplotlib
import numpy as np
import stress_equilibria
from report import machine, publish, table

import softrod_jax as sr
from softrod_jax.scene.scene import as_arrays

FIGURE = Path(__file__).parent / "figures" / "stress.png"
STEPS, TOLERANCE, WRONG, LONG = 20, 2e-3, 1e-2, 20.0
GRIDS = sr.Collocation(), sr.Collocation(24)
# Tensions curl the rod by this many turns at most.
TURNS = 1.0
PERIODS = 50
NAMES = {"equilibrium": "equilibria", "motion": "motions"}
# In the map, scenes without a load or an error are drawn at the edge.
LOWEST = {"load": 1e-3, "error": 1e-12}


def periods(frequency, damping, dt):
    """How many a mode of `frequency` [rad/s] lasts: the whole motion, or until it is damped out."""
    decay = min(damping * frequency**2 / 2, frequency)
    lasts = np.log(1 / TOLERANCE) / decay if decay > 0 else np.inf
    return frequency / (2 * np.pi) * min(STEPS * dt, lasts)


def random_scene(rng):
    """A scene and its actuation: (scene, tensions (3,), pressures (1,), dt, ramp, numbers)."""
    log = lambda low, high: float(np.exp(rng.uniform(np.log(low), np.log(high))))
    maybe = lambda value: value if rng.random() < 0.5 else 0.0 * value
    direction = lambda: (lambda x: x / np.linalg.norm(x))(rng.normal(size=3))
    L, slenderness, E = log(0.02, 1.0), log(5, 150), log(3e4, 2e11)
    r, density = L / slenderness, log(900, 8000)
    area, I = np.pi * r**2, np.pi * r**4 / 4
    EI, EA = E * I, E * area
    angle = rng.uniform(0, 2 * np.pi) + np.array([0, 2, 4]) * np.pi / 3
    offset = rng.uniform(0.2, 0.8) * r
    weight, damping = maybe(log(1e-2, 50.0)), log(1e-5, 3e-2)
    part = maybe(rng.uniform(0, 0.9))  # of the tension at which a path vanishes
    part = min(part, 2 * np.pi * TURNS * EI / (L * offset) * (1 / EA + offset**2 / EI))
    pull = part / (1 / EA + offset**2 / EI) * rng.dirichlet(np.ones(3) * 0.5)
    chamber, pressure = 0.1 * area, maybe(log(1e-3, 0.1)) * EA / (0.1 * area)
    force, moment = maybe(log(1e-2, 10.0)), maybe(log(1e-2, 5.0))
    payload, stretch_damping = maybe(log(0.01, 2.0)), maybe(damping)
    bends = np.sqrt(3 * EI / (density * area * L**4) / (0.2427 + payload))  # rad/s
    stretches = np.pi / 2 * np.sqrt(E / density) / L
    dt = log(1e-5, 5e-2)
    while max(periods(bends, damping, dt), periods(stretches, stretch_damping, dt)) > PERIODS:
        dt = log(1e-5, 5e-2)
    scene = as_arrays(
        sr.Scene(
            length=L,
            section=sr.Circle(r),
            young_modulus=E,
            poisson_ratio=rng.uniform(0.0, 0.49),
            density=density,
            bending_damping=damping * EI,
            shear_damping=stretch_damping * EA,
            gravity=weight * EI / (density * area * L**3) * direction(),
            drag_coefficient=maybe(log(1e-3, 3.0) * density * r),
            tendons=sr.Tendons(offset * np.stack([np.cos(angle), np.sin(angle)], 1)),
            chambers=sr.Chambers(np.array([chamber]), rng.uniform(-0.3, 0.3, (1, 2)) * r),
            payload=sr.Payload(payload * density * area * L),
            tip_load=sr.TipLoad(force * EI / L**2 * direction(), moment * EI / L * direction()),
        )
    )
    load = max(weight, force, moment, np.sum(pull) * offset * L / EI)
    numbers = {
        "slenderness": slenderness,
        "young_modulus": E,
        "load": load,
        "tension": part,
        "wave": dt * np.sqrt(E / density) / L,
        "damping": damping,
    }
    return scene, pull, np.array([pressure]), dt, bool(rng.random() < 0.5), numbers


def try_motion(scene, tensions, pressures, dt, ramp):
    rise = np.minimum(1.0, np.arange(1, STEPS + 1) / 10) if ramp else np.ones(STEPS)
    run = lambda method, tolerance: sr.simulate(
        scene,
        dt,
        rise[:, None] * tensions,
        rise[:, None] * pressures,
        method=method,
        tolerance=tolerance,
        throw=False,
    )
    start = time.perf_counter()
    motion = jax.block_until_ready(run(GRIDS[0], TOLERANCE))
    took = time.perf_counter() - start
    refined = run(GRIDS[1], TOLERANCE / 2)
    moved = jnp.linalg.norm(motion.tip_positions - refined.tip_positions, axis=1)
    return motion.result, refined.result, jnp.max(moved) / scene.length, took, motion.stats


def one_motion(seed, k):
    """The row of one motion: {what: a number or a name}."""
    *case, numbers = random_scene(np.random.default_rng([seed, k]))
    result, refined, error, took, stats = try_motion(*case)
    return {
        "scene": k,
        "result": sr.RESULTS(int(result)).name,
        "refined": sr.RESULTS(int(refined)).name,
        "error": float(error),
        "iterations": int(np.sum(stats["iterations"])),
        "time": took,
        "dt": case[3],
        "ramp": case[4],
        **numbers,
        "substeps": int(np.sum(stats.get("substeps", 0))),
    }


def one(task):
    """The row of (what, seed, scene, whether to judge), by what it is."""
    what, seed, k, judged = task
    if what == "motion":
        return {"what": what, **one_motion(seed, k)}
    return {"what": what, **stress_equilibria.one(seed, k, judged)}


def is_solved(row):
    return row["result"] == "successful"


def is_wrong(row):
    """Called successful, and off by more than a hundredth of the rod."""
    if row["what"] == "equilibrium":
        return stress_equilibria.is_wrong(row)
    return is_solved(row) and row["refined"] == "successful" and row["error"] > WRONG


def is_remarkable(row):
    if not is_solved(row) or is_wrong(row) or row["time"] > LONG:
        return True
    if row["what"] == "equilibrium":
        return stress_equilibria.is_flattering(row)
    return row["refined"] != "successful" or row["error"] > TOLERANCE


def is_confirmed(row):
    """The refined solution ends in the same code."""
    return row["refined"] == row["result"]


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
        axis.set_title(f"{len(here)} {NAMES[what]}")
        if bad:
            axis.legend(loc="upper right")
    bar = figure.colorbar(dots, ax=axes)
    bar.set_label("error of the tip, $\\log_{10}$ of lengths")
    return figure


def compared_with(what, rows) -> str:
    if what == "motion":
        confirmed = sum(map(is_confirmed, rows))
        return f"a refined solution, which ends in the same code for {confirmed}"
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
        counted = [row for row in solved if "estimate" in row]
        flattering = sum(map(stress_equilibria.is_flattering, counted))
        lines.append(
            [
                name,
                str(len(here)),
                str(len(solved)),
                ", ".join(f"{n} `{code}`" for code, n in codes.items()) or "none",
                compared_with(what, here),
                str(sum(map(is_wrong, here))),
                str(flattering) if counted else "not counted",
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
    parser.add_argument("--write-readme", action="store_true")
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
            shown = {n: f"{v:.3g}" if isinstance(v, float) else v for n, v in row.items()}
            print(shown, flush=True)
    print(f"{(time.perf_counter() - begin) / 60:.1f} min, seed {options.seed}")
    if options.details:
        equilibria = [row for row in rows if row["what"] == "equilibrium"]
        print(stress_equilibria.details(equilibria))
    if options.write_readme:
        matplotlib.use("agg")
        draw(rows).savefig(FIGURE, dpi=130)
    publish("stress", f"{summary(rows)}\n\n{machine()}.")


if __name__ == "__main__":
    main()
