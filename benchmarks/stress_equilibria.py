"""Random equilibria far beyond the ordinary, each judged by an independent solver.

    python benchmarks/stress_equilibria.py [--count 2000] [--seed 0] [--judge 2000]
        [--processes 2] [--rows FILE] [--only K,K,..]

Length 0.02 to 1 m, slenderness L/r 9 to 1000, Young's modulus 1e4 to 2e11 Pa, solid, hollow and
rectangular sections, in space and in a plane, with stretch and without. Of seven kinds, each has
one large load: weight rho A g L^3/EI or a payload's to 1e4, tip forces to P L^2/EI = 1e4, tip
moments to 80 EI/L with any axis, rest curvature and twist of ten turns, tensions up to 90 % of
where a path vanishes and pressures; or all of them. Strains stay below a half, as in a real rod.

Each scene is solved as a user would, without any option, and once more under `jit`, on the default
grid. The first --judge are compared with `judge_static.py`, which starts from the answer; the rest
with `Collocation(96)`. What counts: the error against the estimate, and what is called successful
and is not. --rows keeps each scene's row in a file, and a later run goes on from there.
"""

import argparse
import json
import multiprocessing
import time
from collections import Counter
from pathlib import Path

import jax

jax.config.update("jax_enable_x64", True)

import judge_rod
import judge_static
import numpy as np
from report import machine, table

import softrod_jax as sr
from softrod_jax.scene import as_arrays

KINDS = "heavy", "payload", "force", "moment", "coil", "robot", "mixed"
STRUCTURES = "circle", "annulus", "rectangle", "plane", "inextensible"
WRONG, SEEN, FACTOR = 1e-2, 1e-5, 3.0
# An answer that is this far from what the judge found may be nearer to something else.
ANOTHER = 0.05
LARGEST, STRAIN, MOMENT, TURNS = 1e4, 0.3, 80.0, 10.0


class Draw:
    """Random numbers of one scene; those of a scene in a plane are in that plane."""

    def __init__(self, rng, planar):
        self.rng, self.planar = rng, planar

    def log(self, low, high):
        return float(np.exp(self.rng.uniform(np.log(low), np.log(max(low, high)))))

    def maybe(self, part, value):
        return value if self.rng.random() < part else 0.0

    def direction(self):
        x = self.rng.normal(size=3) * np.array([1.0, not self.planar, 1.0])
        return x / np.linalg.norm(x)

    def axis(self):
        """Of a turn: any, or nearly the rod's own, which twists it."""
        if self.planar:
            return np.array([0.0, self.rng.choice([-1.0, 1.0]), 0.0])
        slant = np.array([1.0, 1.0, 1.0]) if self.rng.random() < 0.5 else np.array([0.1, 0.1, 1.0])
        x = self.rng.normal(size=3) * slant
        return x / np.linalg.norm(x)

    def offsets(self, count, low, high):
        size = self.rng.uniform(low, high)
        if self.planar:
            return size * np.stack([np.array([1, -1, 0.5])[:count], np.zeros(count)], 1)
        angle = self.rng.uniform(0, 2 * np.pi) + 2 * np.pi / 3 * np.arange(count)
        return size * np.stack([np.cos(angle), np.sin(angle)], 1)


def random_section(draw, structure, r):
    if structure == "annulus":
        return sr.Annulus(r, draw.rng.uniform(0.3, 0.9) * r)
    if structure == "rectangle":
        return sr.Rectangle(*(2 * r * draw.rng.uniform(0.3, 1.0, 2)))
    return sr.Circle(r)


def random_loads(draw, kind, slenderness, limit):
    """Sizes in units of EI and L. What the kind is about is large, other loads are now and then."""
    wide = lambda high: draw.log(1.0, high)
    size = {
        "heavy": draw.maybe(0.3, draw.log(1e-2, 10)),
        "payload": draw.maybe(0.2, draw.log(1e-2, 10)),
        "force": draw.maybe(0.3, draw.log(1e-2, 10)),
        "moment": draw.maybe(0.3, draw.log(1e-2, 5)),
        "coil": 2 * np.pi * draw.maybe(0.2, draw.log(1e-2, 0.5)),
    }
    bend = 0.5 * slenderness
    largest = {
        "heavy": min(LARGEST, limit),
        "payload": min(LARGEST, limit),
        "force": min(LARGEST, limit),
        "moment": min(MOMENT, bend),
        "coil": min(2 * np.pi * TURNS, bend),
    }
    for name, high in largest.items():
        if kind == name or (kind == "mixed" and draw.rng.random() < 0.4):
            size[name] = wide(high)
    return size


def random_equilibrium(rng):
    """A scene, its tensions and pressures (or None), and the numbers that it was drawn with."""
    kind = str(rng.choice(KINDS))
    structure = str(rng.choice(STRUCTURES, p=[0.35, 0.15, 0.15, 0.175, 0.175]))
    draw = Draw(rng, structure == "plane")
    L, slenderness = draw.log(0.02, 1.0), draw.log(9, 1000)
    E, density, nu = draw.log(1e4, 2e11), draw.log(900, 8000), rng.uniform(0.0, 0.49)
    r = L / slenderness
    section = random_section(draw, structure, r)
    area, I, _ = judge_rod.section_numbers(section)
    EI, EA = E * np.min(I), E * area
    size = random_loads(draw, kind, slenderness, STRAIN * EA * L**2 / EI)
    # A payload needs gravity; its mass is what its weight asks for.
    weight = max(size["heavy"], 1e-2 if size["payload"] else 0.0)
    gravity = weight * EI / (density * area * L**3)
    mass = size["payload"] * EI / L**2 / gravity if size["payload"] else 0.0
    tensions, pressures, part, parts = None, None, 0.0, {}
    if kind == "robot" or (kind == "mixed" and rng.random() < 0.4):
        offsets = draw.offsets(3, 0.1 * r, 0.5 * r)
        offset = np.max(np.linalg.norm(offsets, axis=1))
        most = 1 / (1 / EA + offset**2 / EI)
        part = draw.maybe(0.9, rng.uniform(0, 0.9))
        part = min(part, 3 * 2 * np.pi * EI / (L * offset) / most)
        tensions = part * most * rng.dirichlet(np.ones(3) * 0.5)
        pressures = np.array([draw.maybe(0.5, draw.log(1e-3, 0.1)) * EA / (0.1 * area)])
        chambers = sr.Chambers(np.array([0.1 * area]), draw.offsets(1, 0.0, 0.2 * r))
        parts = {"tendons": sr.Tendons(offsets), "chambers": chambers}
    scene = as_arrays(
        sr.Scene(
            length=L,
            section=section,
            young_modulus=E,
            poisson_ratio=nu,
            density=density,
            gravity=gravity * draw.direction(),
            payload=sr.Payload(mass),
            tip_load=sr.TipLoad(
                size["force"] * EI / L**2 * draw.direction(), size["moment"] * EI / L * draw.axis()
            ),
            rest_curvature=size["coil"] / L * draw.axis(),
            inextensible=structure == "inextensible",
            plane="xz" if draw.planar else None,
            **parts,
        )
    )
    numbers = {"kind": kind, "structure": structure, "slenderness": slenderness, "E": E}
    return scene, tensions, pressures, {**numbers, **size, "tension": part}


@jax.jit
def on_the_default_grid(scene, tensions, pressures):
    return sr.solve_static(scene, tensions, pressures, throw=False)


class Truth:
    """Equilibria near the answers to one scene; the judge is asked when an answer needs it."""

    def __init__(self, case, judged):
        self.case, self.judged = case, judged
        self.tips, self.own, self.finer, self.starts = [], 0.0, None, []

    def error(self, answer, estimate):
        """The distance of an answer from the nearest equilibrium known, in lengths, or NaN."""
        if not self.judged:
            self.refine()
            return self.distance(answer)
        expected = max(3 * estimate, 1e-3) if np.isfinite(estimate) else 1e-3
        if not self.distance(answer) < expected:
            self.ask(answer, "answer")
        if not self.distance(answer) < ANOTHER:
            self.refine()
        return self.distance(answer)

    def distance(self, answer):
        tip, L = np.asarray(answer.tip_position), float(self.case[0].length)
        off = [np.linalg.norm(tip - other) / L for other in self.tips]
        return float(np.min(off)) if off else np.nan

    def ask(self, answer, name):
        try:
            verdict = judge_static.judge_answer(self.case[0], answer, *self.case[1:])
        except judge_rod.NoAnswer:
            return
        self.tips.append(verdict.tip)
        self.starts.append(name)
        self.own = max(self.own, verdict.error)

    def refine(self):
        """The same on finer grids, as a start for the judge or in its place."""
        for intervals in (48, 96) if self.finer is None else ():
            method = sr.Collocation(intervals)
            self.finer = sr.solve_static(*self.case, method=method, throw=False)
            if int(self.finer.result) == 0 and (self.judged or intervals == 96):
                if self.judged:
                    self.ask(self.finer, f"{intervals} intervals")
                else:
                    self.tips.append(np.asarray(self.finer.tip_position))
                    self.starts.append("Collocation(96)")


def measured(answer, truth):
    estimate = float(answer.stats["error"])
    return {
        "result": sr.RESULTS(int(answer.result)).name,
        "stable": bool(answer.stats["stable"]),
        "estimate": estimate,
        "error": truth.error(answer, estimate)
        if np.all(np.isfinite(answer.tip_position))
        else np.nan,
        "intervals": answer.method.intervals,
    }


def one(task):
    """The row of one scene: {what: a number or a name}."""
    seed, k, judged = task
    *case, numbers = random_equilibrium(np.random.default_rng([seed, k]))
    times = []
    for _ in range(2):  # the first may compile
        start = time.perf_counter()
        answer = jax.block_until_ready(sr.solve_static(*case, throw=False))
        times.append(time.perf_counter() - start)
    truth = Truth(case, judged)
    begin = time.perf_counter()
    row = measured(answer, truth)
    fixed = measured(on_the_default_grid(*case), truth)
    return {
        "scene": k,
        **row,
        **{f"grid_{name}": value for name, value in fixed.items()},
        "time": min(times),
        "judge": "; ".join(truth.starts) or "none",
        "judge_error": truth.own,
        "judge_time": time.perf_counter() - begin,
        **numbers,
    }


def run(tasks, processes):
    if processes == 1:
        yield from map(one, tasks)
        return
    with multiprocessing.get_context("spawn").Pool(processes) as pool:
        yield from pool.imap_unordered(one, tasks, chunksize=2)


def is_solved(row, of=""):
    return row[of + "result"] == "successful"


def is_wrong(row, of=""):
    """Called successful, and off by more than a hundredth of the rod, or near no equilibrium."""
    error = row[of + "error"]
    return is_solved(row, of) and not (error <= WRONG)


def is_flattering(row, of=""):
    """The estimate is below a third of an error that can be seen."""
    error, estimate = row[of + "error"], row[of + "estimate"]
    return error > SEEN and not FACTOR * estimate >= error


def counts(rows, of=""):
    """A line of the table."""
    solved = [row for row in rows if is_solved(row, of)]
    codes = Counter(row[of + "result"] for row in rows if not is_solved(row, of))
    seen = [row for row in solved if row[of + "error"] > SEEN]
    ratio = [row[of + "estimate"] / row[of + "error"] for row in seen]
    quantiles = np.nanquantile(ratio, [0.0, 0.05, 0.5, 0.95]) if ratio else []
    others = [row for row in rows if not is_solved(row, of) and is_flattering(row, of)]
    return [
        str(len(rows)),
        str(len(solved)),
        ", ".join(f"{n} `{name}`" for name, n in codes.items()) or "none",
        str(sum(np.isfinite(row[of + "error"]) for row in rows)),
        str(sum(is_wrong(row, of) for row in rows)),
        str(len(seen)),
        str(sum(is_flattering(row, of) for row in seen)),
        str(len(others)),
        ", ".join(f"{q:.2g}" for q in quantiles),
    ]


def summary(rows) -> str:
    header = [
        "",
        "scenes",
        "solved",
        "codes of the others",
        "judged",
        "solved, off by over 1 %",
        "off by over 1e-5",
        "of them estimate < error/3",
        "the same, of those not solved",
        "estimate/error: least, 5 %, median, 95 %",
    ]
    lines = []
    for of, name in (("", "as called"), ("grid_", "under jit")):
        lines.append([f"**{name}**", *counts(rows, of)])
        for kind in KINDS:
            here = [row for row in rows if row["kind"] == kind]
            lines.append([kind, *counts(here, of)] if here else [kind])
    times = [row["time"] for row in rows]
    more = sum(row["intervals"] > row["grid_intervals"] for row in rows)
    own = max(row["judge_error"] for row in rows)
    return (
        f"{table(header, lines)}\n\nTime: median {np.median(times):.2g} s, 95 % "
        f"{np.quantile(times, 0.95):.2g} s. {more} of {len(rows)} took a finer grid than the "
        f"default. The judge's own error is {own:.0e} L at most."
    )


def worst(rows, of="", count=30) -> str:
    """Scenes to look at first: wrong ones, then those whose estimate flatters most."""
    bad = [row for row in rows if is_wrong(row, of) or is_flattering(row, of)]
    score = lambda row: (
        not is_solved(row, of),
        not is_wrong(row, of),
        row[of + "estimate"] / row[of + "error"],
    )
    lines = []
    for row in sorted(bad, key=score)[:count]:
        loads = [f"{n} {row[n]:.3g}" for n in (*KINDS[:5], "tension") if row[n]]
        lines.append(
            [
                str(row["scene"]),
                row["kind"],
                row["structure"],
                row[of + "result"],
                f"{row[of + 'estimate']:.1e}",
                f"{row[of + 'error']:.1e}",
                str(row[of + "intervals"]),
                str(row[of + "stable"]),
                f"{row['slenderness']:.3g}",
                ", ".join(loads),
                row["judge"],
            ]
        )
    header = [
        "scene",
        "kind",
        "structure",
        "code",
        "estimate",
        "error",
        "intervals",
        "stable",
        "L/r",
        "loads",
        "judge's starts",
    ]
    return table(header, lines)


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--count", type=int, default=2000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--judge", type=int, default=2000)
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--rows", type=Path)
    parser.add_argument("--only", type=lambda text: [int(k) for k in text.split(",")])
    options = parser.parse_args()
    rows, begin = [], time.perf_counter()
    if options.rows and options.rows.exists():
        rows = [json.loads(line) for line in options.rows.read_text().splitlines()]
    done = {row["scene"] for row in rows}
    scenes = options.only or range(options.count)
    tasks = [(options.seed, k, k < options.judge) for k in scenes if k not in done]
    for row in run(tasks, options.processes):
        rows.append(row)
        if options.rows:
            with options.rows.open("a") as file:
                file.write(json.dumps(row) + "\n")
        elif options.only:
            print(json.dumps(row))
    print(f"{(time.perf_counter() - begin) / 60:.1f} min, seed {options.seed}\n")
    for title, text in (
        ("", summary(rows)),
        ("As called", worst(rows)),
        ("Under jit", worst(rows, "grid_")),
    ):
        print(f"{title}\n\n{text}\n")
    print(machine())


if __name__ == "__main__":
    main()
