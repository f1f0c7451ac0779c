"""Stress test of contact: random scenes, each against half the step and twice the grid.

    python benchmarks/contact_stress.py [--equilibria 700] [--motions 300] [--seed 0] [--rows FILE]
        [--minutes M] [--given N] [--write-docs]

The article's robot under gravity from any side and up to 0.3 N of each tendon (in motions from rest
and raised within 0.1 s), against a plane, a ball, a bent tube or a rounded box that is given as a
grid, of 300 to 30,000 N/m^2, damped in motions and half of them with friction. All is solved as a
user would, without any option. The judge has twice the intervals and, of motions, half the step: it
shares the code, and tells errors of grid and steps only.

--given N only compares, of the first N motions, those that touch, on given grids of 12 and 24
intervals with 48 at steps of 2.5 ms: the error against its estimate, `touch_error`.

--rows keeps each scene's row in a file, and a later run with it goes on from there; --minutes ends
a run early. A scene that has no answer, a wrong one or takes long is printed.
"""

import argparse
import itertools
import json
import time
from collections import Counter
from pathlib import Path

import jax

jax.config.update("jax_enable_x64", True)

import jax.numpy as jnp
import numpy as np
from contacts import G, L, obstacle
from report import machine, publish, table

import softrod_jax as sr

SHAPES = "plane", "ball", "tube", "grid"
STEPS, DT = 30, 0.01
WRONG, LONG = 1e-2, 30.0
_HALF, _ROUND = np.array([6e-3, 8e-3, 10e-3]), 8e-3


def rounded_box(p):
    """The signed distance of a box with round edges, about the origin."""
    q = jnp.abs(p) - _HALF
    most, out = jnp.max(q), jnp.maximum(q, 0.0)
    square = jnp.maximum(out @ out, 1e-30)
    return jnp.where(most > 0, jnp.sqrt(square), most) - _ROUND


BOX = sr.sample_distance(rounded_box, [-0.03] * 3, [0.03] * 3, 2e-3)


def scene_of(seed: int, k: int, moving: bool):
    """The scene and its tensions [N]."""
    rng = np.random.default_rng([seed, k, moving])
    if k % 4 < 3:
        shape = obstacle(k % 4, rng)
    else:
        side = rng.uniform(0, 2 * np.pi)
        place = rng.uniform(0.025, 0.04) * np.array([np.cos(side), np.sin(side), 0.0])
        place[2] = rng.uniform(0.04, 0.1)
        origin = BOX.origin + place
        shape = sr.DistanceGrid(BOX.values, origin, BOX.spacing)
    direction = rng.normal(size=3)
    gravity = jnp.array(G * direction / np.linalg.norm(direction))
    rubs = {"damping": 1.0} if moving else {}
    if moving and k // 4 % 2:
        rubs |= {"friction": rng.uniform(0.1, 0.6), "slip_speed": 1e-2}
    contact = sr.Contact(shape, 10 ** rng.uniform(2.5, 4.5), name="it", **rubs)
    robot = sr.hybrid_robot(gravity=gravity)
    scene = sr.Scene(**{**vars(robot), "contacts": (contact,)})
    return scene, jnp.array(rng.uniform(0, 0.3, 3))


def equilibrium(scene, tensions, method=None):
    """The tip, (1, 3), and the solution."""
    solution = sr.solve_static(scene, tensions, method=method, throw=False)
    return solution.tip_position[None], solution


def motion(scene, tensions, method=None, **options):
    """Tips at the ends of the steps, (steps + 1, 3), and the solution."""
    rise = jnp.minimum(jnp.arange(1, STEPS + 1) * DT / 0.1, 1.0)
    found = sr.simulate(scene, DT, rise[:, None] * tensions, method=method, throw=False, **options)
    return found.tip_positions, found


def half_the_step(found) -> dict:
    """Options for a motion with at least twice the substeps; a power of two, to compile few."""
    most = int(np.max(found.stats["substeps"]))
    return {"substeps": 2 ** int(np.ceil(np.log2(2 * most))), "max_time_error": np.inf}


def one(seed: int, k: int, moving: bool) -> dict:
    """The row of a scene."""
    scene, tensions = scene_of(seed, k, moving)
    solve = motion if moving else equilibrium
    begun = time.perf_counter()
    jax.block_until_ready(solve(scene, tensions))
    compiled = time.perf_counter()
    tips, found = jax.block_until_ready(solve(scene, tensions))
    seconds, first = time.perf_counter() - compiled, compiled - begun
    intervals = (len(found.arc_lengths) - 1) if moving else found.method.intervals
    options = half_the_step(found) if moving else {}
    better, judge = solve(scene, tensions, sr.Collocation(2 * intervals), **options)
    usable = int(judge.result) in (0, int(sr.RESULTS.inaccurate))
    force = found.contact_forces["it"] if moving else found.contact_force["it"]
    return {
        "k": k, "moving": moving, "shape": SHAPES[k % 4],
        "result": sr.RESULTS(int(found.result)).name,
        "friction": scene.contacts[0].friction is not None,
        "stiffness": float(scene.contacts[0].stiffness), "seconds": seconds, "first": first,
        "touches": bool(jnp.any(jnp.abs(force) > 0)), "intervals": intervals,
        "judge": sr.RESULTS(int(judge.result)).name,
        "off": float(jnp.max(jnp.linalg.norm(tips - better, axis=-1))) / L if usable else None,
    }  # fmt: skip


def given(seed: int, count: int) -> None:
    """How the errors of given grids compare with their estimates."""
    ratios, told = [], []
    for k in range(count):
        scene, tensions = scene_of(seed, k, True)
        rise = jnp.minimum(jnp.arange(1, 4 * STEPS + 1) * DT / 0.4, 1.0)[:, None] * tensions
        run = lambda n, scene=scene, rise=rise: sr.simulate(
            scene, DT / 4, rise, method=sr.Collocation(n), max_time_error=np.inf, throw=False
        )
        fine = run(48)
        if not np.any(fine.contact_forces["it"]):
            continue
        for n in (12, 24):
            found = run(n)
            apart = jnp.linalg.norm(found.tip_positions - fine.tip_positions, axis=-1)
            error = float(jnp.max(apart)) / L
            estimate = float(found.stats["touch_error"][-1])
            told += [(k, n, error)] if n == 12 and estimate > 1e-2 else []
            if error > 5e-5:
                ratios.append(estimate / error)
                print(f"{k}, {n} intervals: {error:.1e} off, {estimate:.1e} estimated", flush=True)
    quantiles = ", ".join(f"{q:.2g}" for q in np.quantile(ratios, [0, 0.05, 0.5, 0.95, 1]))
    print(f"{len(ratios)}: estimate / error, least, 5 %, median, 95 %, largest: {quantiles}")
    print(f"above 1e-2 on 12 intervals (scene, intervals, error): {told}")


def is_wrong(row) -> bool:
    """Called successful, and off by more than a hundredth of the rod."""
    return row["result"] == "successful" and row["off"] is not None and row["off"] > WRONG


def summary(rows) -> str:
    """The table, a line for each kind."""
    lines = []
    for moving, shape in itertools.product((False, True), (*SHAPES, None)):
        own = [r for r in rows if r["moving"] == moving and shape in (None, r["shape"])]
        if not own:
            continue
        good = [r for r in own if r["result"] == "successful"]
        codes = Counter(r["result"] for r in own if r not in good)
        judged = [r["off"] for r in good if r["off"] is not None]
        seconds = [r["seconds"] for r in own]
        lines.append([
            f"{'motions' if moving else 'equilibria'}, {shape or 'all'}", str(len(own)),
            str(sum(r["touches"] for r in own)), f"{100 * len(good) / len(own):.1f} %",
            ", ".join(f"{n} `{code}`" for code, n in codes.items()) or "none", str(len(judged)),
            str(sum(map(is_wrong, own))), f"{max(judged, default=0):.0e}",
            f"{np.median(seconds):.2f}, {max(seconds):.1f}", f"{max(r['first'] for r in own):.0f}",
        ])  # fmt: skip
    header = ["", "scenes", "touch", "solved", "codes of the others", "judged", "wrong"]
    header += ["largest error, lengths", "time, median and most [s]", "most with compiling [s]"]
    return table(header, lines)


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--equilibria", type=int, default=700)
    parser.add_argument("--motions", type=int, default=300)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--minutes", type=float, default=np.inf)
    parser.add_argument("--rows", type=Path, default=None)
    parser.add_argument("--write-docs", action="store_true")
    parser.add_argument("--given", type=int, default=0)
    args = parser.parse_args()
    if args.given:
        given(args.seed, args.given)
        return
    begun, rows = time.monotonic(), []
    if args.rows is not None and args.rows.exists():
        rows = [json.loads(line) for line in args.rows.read_text().splitlines()]
    done = {(r["moving"], r["k"]) for r in rows}
    # Both kinds by turns, so that a run that is ended early has both.
    counts = {False: args.equilibria, True: args.motions}
    tasks = [(m, k) for k in range(max(counts.values())) for m in counts if k < counts[m]]
    for moving, k in tasks:
        if (moving, k) in done:
            continue
        if time.monotonic() - begun > 60 * args.minutes:
            break
        row = one(args.seed, k, moving)
        rows.append(row)
        if args.rows is not None:
            with args.rows.open("a") as file:
                file.write(json.dumps(row) + "\n")
        if row["result"] != "successful" or is_wrong(row) or row["seconds"] > LONG:
            print(row, flush=True)
    publish("contact stress", "contact.md", f"{summary(rows)}\n\n{machine()}.")


if __name__ == "__main__":
    main()
