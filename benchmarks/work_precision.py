"""Error against run time: every method and scheme on five scenes, other packages beside them.

    python benchmarks/work_precision.py [--write-docs] [--peers DIR] [--scenes gravity,steel]

On one core: `taskset -c 1 python ...` (the last line says how many it saw). DIR is where virtual
environments of PyElastica, soromox and MuJoCo are, or will be made by pip. `--quick` takes
few settings and one round: it shows that all is in place. `--cached` lets JAX keep compiled
programs, and leaves the times of compiling out. `--rows FILE` keeps what was measured, scene by
scene, and a later run with the same file goes on from there. What the figure shows is kept beside
it, and `--redraw` draws it again. About 20 minutes.

An error is the tip's distance [m] from a solution of another method, refined until it hardly
changes, or from an independent one where `../shared/reference` is there: the largest, and the
root mean square, over all samples of the motion. Times are medians of rounds in which every
setting and every package runs once, so that a slow moment falls on all. Compiling is apart.
"""

import argparse
import json
import time
from pathlib import Path

import jax
import jax.numpy as jnp
import matplotlib
import matplotlib.ticker
import numpy as np
import peer_runs
from report import machine, publish, table
from work_scenes import CASES, REFERENCE

import softrod_jax as sr

FIGURE = Path(__file__).parent / "figures" / "work_precision.png"
ROUNDS = 5
PEER_LABELS = (
    "★ other packages: M MuJoCo (step in ms), P PyElastica (elements), S soromox (segments), "
    "E explicit finite differences (elements)"
)
# Schemes in time and, for equilibria, methods along the rod, each with a colour.
SCHEMES = [f"SDIRK({k})" for k in ("4", "3", "3, stages=6", "2")]
SCHEMES += [f"BDFAlpha({a})" for a in ("-0.45", "-0.2", "0")]
METHODS = ["order 6", "order 4", "shooting, Tsit5", "shooting, Bosh3", "shooting, Dopri8"]
METHODS += ["single shooting, Tsit5", "shooting, Heun"]
COLOURS = ["#d55e00", "#0072b2", "#009e73", "#cc79a7", "#000000", "#999999", "#c9a400"]
DASHES = {  # by what the name of a line has in it; the first that fits
    "loose": ("--", "^"),
    "shooting": (":", "v"),
    "order 4": ("-.", "s"),
    "order 6": ("-", "o"),
}
IN_TABLE = ("M20", "M2", "P10", "P50", "S1", "S8", "E50", "E330")
LEAST = 0.02  # s: shorter programs run several times a round


class Program:
    """A case with one setting, compiled."""

    def __init__(self, case, setting):
        self.setting, self.seconds = setting, []
        self._every = 1 if case.duration is None else round(case.sample / setting.step)
        begin = time.perf_counter()
        lowered, self._inputs = _lowered(case, setting)
        self._compiled = lowered.compile()
        self.compile_seconds = time.perf_counter() - begin
        begin = time.perf_counter()
        tip, result = self.run()
        self.count = max(1, int(LEAST / (time.perf_counter() - begin)))
        self.tip = np.asarray(tip)[:: self._every] if int(result) == 0 else None

    def run(self):
        return jax.block_until_ready(self._compiled(*self._inputs))

    def measure(self) -> None:
        begin = time.perf_counter()
        for _ in range(self.count):
            self.run()
        self.seconds.append((time.perf_counter() - begin) / self.count)


def _lowered(case, setting):
    """The program before it is compiled, and its inputs."""
    scene = jax.tree.map(lambda x: jnp.asarray(x, float), case.scene)
    options = dict(method=setting.method, newton=setting.newton, throw=False)

    def equilibrium(scene, tensions, pressures):
        solution = sr.solve_static(scene, tensions, pressures, **options)
        return solution.tip_position[None], solution.result

    def motion(scene, tensions, pressures, dt):
        choice = dict(steps=steps, scheme=setting.scheme, max_time_error=jnp.inf, **options)
        moved = sr.simulate(scene, dt, tensions, pressures, **choice)
        return moved.tip_positions, moved.result

    if case.duration is None:
        inputs = scene, *case.inputs(None)
        return jax.jit(equilibrium).lower(*inputs), inputs
    dt = 1e-3 * setting.step
    steps = round(case.duration / dt)
    actuation = jax.tree.map(jnp.asarray, case.inputs(dt * np.arange(1, steps + 1)))
    inputs = scene, *actuation, dt
    return jax.jit(motion).lower(*inputs), inputs


def answer(case):
    """The solution to compare with, how well it is known [m], and what it is."""
    fine = Program(case, case.fine[0])
    independent = case.independent()
    other = Program(case, case.fine[1]).tip if independent is None else independent[0]
    apart = errors(fine.tip, other)[0]
    if independent is None:
        return fine.tip, apart, case.fine[0].name
    print(f"{case.title}: {case.fine[0].name} is {apart:.1e} m from the independent solution")
    return *independent, "independent solution"


def errors(tip, exact) -> tuple[float, float]:
    """The largest, and the root mean square."""
    distance = np.linalg.norm(np.asarray(tip) - exact, axis=-1)
    return float(np.max(distance)), float(np.sqrt(np.mean(distance**2)))


def measure(case, folder, quick):
    """Rows of one case: {name, family, time, compile, largest, rms}; and its answer."""
    exact, known, source = answer(case)
    settings = case.settings[::6] if quick else case.settings
    programs = [Program(case, setting) for setting in settings]
    for program in programs:
        if program.tip is None:
            print(f"{case.title}: {program.setting.name}: no solution")
    programs = [program for program in programs if program.tip is not None]
    running = peer_runs.start(peer_runs.peers_of(case, quick), folder)
    for _ in range(1 if quick else ROUNDS):
        for program in programs:
            program.measure()
        for peer in running:
            peer.run()
    rows = [
        _row(p.setting.name, p.setting.family, p.seconds, p.compile_seconds, p.tip, exact)
        for p in programs
    ]
    for one in running:
        one.close()
        if one.answers and one.answers[-1]["tip"] is not None:
            seconds, tip = [a["seconds"] for a in one.answers], one.answers[-1]["tip"]
            rows.append(_row(one.peer.name, None, seconds, one.setup, tip, exact))
            rows[-1]["label"] = one.peer.label
        elif one.answers:
            print(f"{one.peer.name}: its motion blew up: left out")
    for row in rows:
        print(
            f"  {row['name']}: largest {row['largest']:.1e}, rms {row['rms']:.1e} m, "
            f"{1e3 * row['time']:.3g} ms, compiled in {row['compile']:.1f} s",
            flush=True,
        )
    return rows, (known, source)


def _row(name, family, seconds, compile_seconds, tip, exact):
    """`family`: None for another package."""
    largest, rms = errors(tip, exact)
    return {
        "name": name,
        "family": family,
        "time": float(np.median(seconds)),
        "compile": compile_seconds,
        "largest": largest,
        "rms": rms,
    }


def fastest(rows, largest, rms=np.inf):
    """Of our rows, the fastest one whose errors are at most these, or None."""
    good = [
        row for row in rows if row["family"] and row["largest"] <= largest and row["rms"] <= rms
    ]
    return min(good, key=lambda row: row["time"], default=None)


def levels_table(measured, cached) -> str:
    """For every case, the fastest setting at a few errors."""
    rows, sources = [], []
    for name, (found, (known, source)) in measured.items():
        sources.append(f"*{CASES[name]().title}*: {source} ({_short(known)} m)")
        for level in CASES[name]().levels:
            best = fastest(found, level)
            if best is None:
                shown = ["none of those tried", "", "", ""]
            else:
                shown = [best["name"], _short(best["largest"]), _milliseconds(best["time"])]
                shown.append("" if cached else f"{best['compile']:.1f}")
            rows.append([CASES[name]().title, _short(level), *shown])
    header = ["", "error at most [m]", "fastest setting", "its error [m]", "time [ms]"]
    header.append("compile [s]")
    known_to = f"Errors are distances from (known to): {'; '.join(sources)}."
    return f"{table(header, rows)}\n\n{known_to}"


def peers_table(rows) -> str:
    """Packages' rows of the gravity step, and for each our fastest that is no less accurate.

    The rows between are in the diagram.
    """
    lines = []
    for peer in rows:
        if peer["family"] is not None or peer["label"] not in IN_TABLE:
            continue
        best = fastest(rows, peer["largest"], peer["rms"])
        ours = ["none of those tried", "", "", ""]
        if best is not None:
            ratio = peer["time"] / best["time"]
            pair = f"{_short(best['largest'])}, {_short(best['rms'])}"
            ours = [best["name"], pair, _milliseconds(best["time"]), f"{ratio:.2g}"]
            ours[-1] = f"{ratio:.0f}" if ratio >= 10 else f"{ratio:.1f}"
        theirs = f"{_short(peer['largest'])}, {_short(peer['rms'])}"
        lines.append([peer["name"], theirs, _milliseconds(peer["time"]), *ours])
    header = ["", "error: largest, rms [m]", "time [ms]", "here, at most that error"]
    return table([*header, "error: largest, rms [m]", "time [ms]", "times faster"], lines)


def _short(error) -> str:
    return f"{error:.1e}".replace("e-0", "e-").replace(".0e", "e")


def _milliseconds(seconds) -> str:
    value = 1e3 * seconds
    return f"{value:.2g}" if value < 100 else f"{value:.0f}"


def look(family: str) -> dict:
    """How a line is drawn: its colour is the scheme, its dashes what is along the rod.

    Equilibria have no scheme: there the method along the rod is the colour.
    """
    place = METHODS.index(family) if family in METHODS else SCHEMES.index(scheme_of(family))
    line, marker = next(look for part, look in DASHES.items() if part in family)
    return dict(color=COLOURS[place], ls=line, marker=marker)


def scheme_of(family: str) -> str:
    """The scheme in time that the name of a family of settings begins with."""
    return next(scheme for scheme in SCHEMES if family.startswith(f"{scheme}, "))


def draw(measured):
    """One panel a case; a line for each family, and the other packages by their labels."""
    import matplotlib.pyplot as plt

    measured = {name: found for name, found in measured.items() if CASES[name]().drawn}
    figure, axes = plt.subplots(2, 3, figsize=(11, 7.8), layout="constrained")
    panels = list(axes.flat)
    handles = {}
    for panel, (name, (rows, (known, _))) in zip(panels, measured.items(), strict=False):
        lines = {}
        for family in dict.fromkeys(row["family"] for row in rows if row["family"]):
            here = sorted((r["time"], r["largest"]) for r in rows if r["family"] == family)
            x, y = zip(*here, strict=True)
            (lines[family],) = panel.plot(x, y, ms=4, lw=1.1, **look(family))
        still = CASES[name]().duration is None
        handles |= {} if still else lines
        for row in (r for r in rows if not r["family"]):
            panel.plot(row["time"], row["largest"], "k*", ms=6)
            # Those of MuJoCo and PyElastica are close to each other.
            below = dict(xytext=(0, -4), va="top", ha="center")
            beside = dict(xytext=(4, 3))
            place = below if row["label"].startswith("M") else beside
            spot = (row["time"], row["largest"])
            panel.annotate(row["label"], spot, textcoords="offset points", fontsize=8, **place)
        panel.axhspan(min(known, panel.get_ylim()[0]), known, color="0.9", zorder=0)
        panel.set(xscale="log", yscale="log", title=CASES[name]().title)
        panel.set(xlabel="time of a run [s]", ylabel="largest error of the tip [m]")
        panel.xaxis.set_minor_formatter(matplotlib.ticker.NullFormatter())
        panel.margins(x=0.12)
        if still:  # with room for the key beside the lines
            panel.set_xlim(right=60 * panel.get_xlim()[1])
            panel.legend(lines.values(), lines, fontsize=8, loc="upper right")
        panel.grid(alpha=0.3)
    for panel in panels[len(measured) :]:
        panel.axis("off")
    if len(measured) < len(panels):
        order = sorted(handles, key=lambda family: (SCHEMES.index(scheme_of(family)), family))
        key = panels[-1].legend([handles[f] for f in order], order, loc="upper left", fontsize=8.5)
        key.set_title("motions: scheme in time, along the rod", prop={"size": 9})
        figure.supxlabel(PEER_LABELS, fontsize=9)
    return figure


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--scenes", default=",".join(CASES), help=f"of {', '.join(CASES)}")
    parser.add_argument("--peers", type=Path, metavar="DIR")
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--cached", action="store_true")
    parser.add_argument("--rows", type=Path, metavar="FILE")
    parser.add_argument("--figure", type=Path, default=FIGURE)
    parser.add_argument("--write-docs", action="store_true")
    parser.add_argument("--redraw", action="store_true")
    options = parser.parse_args()
    names = options.scenes.split(",")
    if options.write_docs and (options.quick or set(names) != set(CASES)):
        parser.error("--write-docs needs all scenes and no --quick")
    data = options.figure.with_suffix(".json")
    if options.redraw:
        matplotlib.use("agg")
        draw(json.loads(data.read_text())).savefig(options.figure, dpi=130)
        return
    jax.config.update("jax_enable_x64", True)
    jax.config.update("jax_enable_compilation_cache", options.cached)
    begin = time.perf_counter()
    print(f"{machine()}; independent solutions: {REFERENCE.is_dir()}", flush=True)
    measured = {}
    if options.rows and options.rows.exists():
        measured = json.loads(options.rows.read_text())
    for name in names:
        if name not in measured:
            measured[name] = measure(CASES[name](), options.peers, options.quick)
            if options.rows:
                options.rows.write_text(json.dumps(measured))
    matplotlib.use("agg")
    options.figure.parent.mkdir(exist_ok=True)
    data.write_text(json.dumps(measured))
    draw(measured).savefig(options.figure, dpi=130)
    publish(
        "work and precision",
        "benchmarks.md",
        f"{levels_table(measured, options.cached)}\n\n{machine()}.",
    )
    if any(not row["family"] for row in measured.get("gravity", ([], None))[0]):
        publish(
            "work and precision: packages", "comparison.md", peers_table(measured["gravity"][0])
        )
    print(f"{(time.perf_counter() - begin) / 60:.1f} min")


if __name__ == "__main__":
    main()
