"""The equilibria of the stress test: solved, judged by an independent solver, and counted.

The scenes are drawn in `stress_scenes.py`, which says what they span. Each is solved as a user
would, without any option, and once more under `jit`, on the default grid. Answers are compared with
`judge_static.py`, which starts from them; without a judge, with `Collocation(96)`. What counts: the
estimate against the error, and what is called successful and is not.
"""

import time
from collections import Counter

import jax

jax.config.update("jax_enable_x64", True)

import judge_rod
import judge_static
import numpy as np
from report import table
from stress_scenes import KINDS, random_equilibrium

import softrod_jax as sr

WRONG, SEEN, FACTOR = 1e-2, 1e-5, 3.0
# An answer that is this far from what the judge found may be nearer to something else.
ANOTHER = 0.05


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


def one(seed, k, judged):
    """The row of one scene: {what: a number or a name}."""
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
        "judged": judged,
        **numbers,
        "load": max(numbers[name] for name in ("heavy", "payload", "force", "moment", "coil")),
    }


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
            if here:
                lines.append([kind, *counts(here, of)])
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


def details(rows) -> str:
    """Counts by kind of scene, and the worst, as called and under `jit`."""
    under_jit = worst(rows, "grid_")
    return f"{summary(rows)}\n\nAs called:\n\n{worst(rows)}\n\nUnder jit:\n\n{under_jit}\n"
