"""Random motions at the default settings, judged by an independent explicit code.

    python benchmarks/judge_motion.py [--motions 120] [--seed 0] [--tips FILE] [--rows FILE]
        [--write-docs]

Every motion has 40 steps. They span length 0.03 to 0.5 m, slenderness L/r 9 to 90, Young's modulus
1e5 to 1e11 Pa, damping ratios of the first mode 1e-4 to 0.2, 5 to 50 steps in its period; tensions
that jump, ramp, saw, pulse, are let go or jump twice, gravity, tip loads, payloads and drag. The
judge is `explicit_rod.py` on two grids, extrapolated; the change by that is how well it knows.
Tips of the judge are kept in --tips, and found again there; rows in --rows, where those of several
seeds may be. The table is of all of them, and goes into the documentation with --write-docs.
"""

import argparse
import json
import time
from pathlib import Path

import jax

jax.config.update("jax_enable_x64", True)

import numpy as np
from explicit_rod import Rods, motion
from report import machine, publish, table

import softrod_jax as sr
from softrod_jax.scene.scene import as_arrays
from softrod_jax.stepping.step_inputs import jumps

STEPS = 40
KINDS = ("jump", "ramp", "saw", "pulse", "release", "two jumps")
GRIDS = 16, 32
# The judge's doubt from which on it is no judge, the least error looked at, and what is wrong.
SURE, LEAST, WRONG = 3e-3, 1e-5, 1e-2
# Motions of about equal cost that the judge solves side by side.
BESIDE = 30


def course(kind, rng):
    """A tension's part of its largest, (steps,)."""
    k = np.arange(STEPS)
    at = int(rng.integers(3, 20))
    match kind:
        case "jump":
            return np.ones(STEPS)
        case "ramp":
            return np.minimum(1.0, (k + 1) / at)
        case "saw":
            return (k % at + 1) / at
        case "pulse":
            return 1.0 * (k % (2 * at) < at)
        case "release":
            return np.minimum(1.0, (k + 1) / 15) * (k < 20)
    return np.where(k < at, 1.0, 0.6)


def random_motion(seed, number):
    """(scene, tensions (steps, 3), dt, kind, EI / L^2)."""
    rng = np.random.default_rng([seed, number])
    log = lambda low, high: float(np.exp(rng.uniform(np.log(low), np.log(high))))
    maybe = lambda value, part=0.5: value if rng.random() < part else 0.0 * value
    direction = lambda: (lambda x: x / np.linalg.norm(x))(rng.normal(size=3))
    L, slenderness, E, density = log(0.03, 0.5), log(9, 90), log(1e5, 1e11), log(900, 8000)
    r = L / slenderness
    area, I = np.pi * r**2, np.pi * r**4 / 4
    EI, EA = E * I, E * area
    payload = maybe(log(0.01, 1.0), 0.3)
    omega = np.sqrt(3 * EI / (density * area * L**4) / (0.2427 + payload))
    damping = 2 * log(1e-4, 0.2) / omega * EI
    kind = KINDS[number % len(KINDS)]
    offset = rng.uniform(0.3, 0.8) * r
    path = 1 / (1 / EA + offset**2 / EI)  # the tension at which a path vanishes
    pull = min(log(0.1, 5.0) * EI / (L * offset), 0.5 * path)
    angle = rng.uniform(0, 2 * np.pi) + np.array([0, 2, 4]) * np.pi / 3
    weight = maybe(log(0.1, 10.0), 0.6)
    force, moment = maybe(log(0.1, 4.0), 0.3), maybe(log(0.1, 2.0), 0.3)
    scene = as_arrays(
        sr.Scene(
            length=L,
            section=sr.Circle(r),
            young_modulus=E,
            poisson_ratio=rng.uniform(0.0, 0.49),
            density=density,
            bending_damping=damping * rng.uniform(0.7, 1.4, 3),
            gravity=weight * EI / (density * area * L**3) * direction(),
            drag_coefficient=maybe(log(1e-3, 1.0) * density * r, 0.4) * np.ones(3),
            tendons=sr.Tendons(offset * np.stack([np.cos(angle), np.sin(angle)], 1)),
            payload=sr.Payload(payload * density * area * L),
            tip_load=sr.TipLoad(force * EI / L**2 * direction(), moment * EI / L * direction()),
        )
    )
    pulls = np.zeros((STEPS, 3))
    pulls[:, 0] = maybe(pull, 0.8) * course(kind, rng)
    if rng.random() < 0.3:
        pulls[:, 1] = 0.5 * pull * course(kind, rng)
    dt = 2 * np.pi / omega / log(5, 50)
    return scene, pulls, dt, kind


def as_rods(scenes) -> Rods:
    """What the judge knows of them."""
    rows = []
    for s in scenes:
        area, (Ix, Iy) = float(s.section.area), np.array(s.section.second_moments)
        E, G = float(s.young_modulus), float(s.shear_modulus)
        rows.append(
            Rods(
                L=float(s.length),
                K_se=np.array([G * area, G * area, E * area]),
                K_bt=np.array([E * Ix, E * Iy, G * (Ix + Iy)]),
                B_bt=np.array(s.bending_damping),
                rho_A=float(s.density) * area,
                rho_J=float(s.density) * np.array([Ix, Iy, Ix + Iy]),
                drag=np.array(s.drag_coefficient),
                gravity=np.array(s.gravity),
                payload=float(s.payload.mass),
                force=np.array(s.tip_load.force),
                moment=np.array(s.tip_load.moment),
                offsets=np.array(s.tendons.offsets),
                thrust_area=0.0,
                thrust_arm=np.zeros(2),
            )
        )
    return Rods(*(np.stack(column) for column in zip(*rows)))


def both_ends(pulls):
    """(steps, 2, tendons): inputs at the beginning and end of each step, as `simulate` says."""
    before = np.concatenate([np.zeros_like(pulls[:1]), pulls[:-1]])
    return np.stack([np.where(jumps(pulls), pulls, before), pulls], 1)


def judged(cases, file: Path | None):
    """Tips (motions, steps + 1, 3) by the judge, and how far they are known, in lengths.

    What is known already is found in `file`, and kept there; the cheapest motions come first.
    """
    lengths = np.array([float(case[0].length) for case in cases])
    hard = [case[2] * np.sqrt(float(case[0].young_modulus / case[0].density)) for case in cases]
    order = np.argsort(np.array(hard) / lengths)
    tips = np.full((len(cases), STEPS + 1, 3), np.nan)
    known = np.full((len(cases), STEPS + 1), np.nan)
    if file and file.exists():
        stored = np.load(file)
        count = min(len(cases), len(stored["tips"]))
        tips[:count], known[:count] = stored["tips"][:count], stored["known"][:count]
    order = [i for i in order if np.isnan(known[i, 0])]
    for some in np.array_split(order, -(-len(order) // BESIDE)) if order else ():
        rods = as_rods([cases[i][0] for i in some])
        pulls = np.stack([both_ends(cases[i][1]) for i in some])
        dt = np.array([cases[i][2] for i in some])
        coarse, fine = (motion(rods, dt, pulls, 0.0 * pulls[..., :1], n) for n in GRIDS)
        tips[some] = fine + (fine - coarse) / 3
        known[some] = np.linalg.norm(fine - coarse, axis=-1) / 3 / lengths[some, None]
        print(f"judged {len(some)}", flush=True)
        if file:
            np.savez(file, tips=tips, known=known)
    return tips, known


@jax.jit
def under_jit(scene, dt, tensions):
    return sr.simulate(scene, dt, tensions, throw=False)


def tried(case, tips, known):
    """One row: what `simulate` says of a motion, and what the judge says of that."""
    scene, pulls, dt, kind = case
    length = float(scene.length)
    row = {"kind": kind, "known": float(np.max(known))}
    for name, run in (
        ("jit", lambda tau: under_jit(scene, dt, tau)),
        ("given", lambda tau: sr.simulate(scene, dt, tau, substeps=1, throw=False)),
        ("default", lambda tau: sr.simulate(scene, dt, tau, throw=False)),
    ):
        begin = time.perf_counter()
        found = run(pulls)
        row[name] = {
            "result": sr.RESULTS(int(found.result)).name,
            "true": float(np.max(np.linalg.norm(found.tip_positions - tips, axis=1))) / length,
            "estimate": float(found.stats["time_error"][-1]),
            "along": float(np.max(found.stats["error"])),
            "substeps": int(np.max(found.stats["substeps"])),
            "time": time.perf_counter() - begin,
        }
    return row


def summary(rows) -> str:
    """Estimate against error of the steps as given, and what is called successful."""
    lines = []
    for name, title in (("jit", "under `jit`"), ("given", "`substeps=1`"), ("default", "default")):
        judged = [row for row in rows if row["known"] < SURE]
        here = [row[name] | {"known": row["known"]} for row in judged]
        seen = [r for r in here if r["true"] > max(LEAST, 3 * r["known"])]
        ratio = np.array([(r["estimate"] + r["along"]) / (r["true"] - r["known"]) for r in seen])
        off = [r for r in here if r["true"] - r["known"] > WRONG]
        good = [r for r in here if r["true"] < 1e-3]
        lines.append(
            [
                title,
                f"{len(here)} of {len(rows)}",
                " / ".join(f"{q:.2g}" for q in np.quantile(ratio, [0.0, 0.05, 0.5, 0.95])),
                str(int(np.sum(ratio < 1 / 3))),
                str(len(off)),
                str(sum(r["result"] == "successful" for r in off)),
                str(sum(r["result"] == "inaccurate" for r in good)),
                f"{np.median([r['time'] for r in here]):.2g}",
            ]
        )
    header = [
        "",
        "judged",
        "estimate / error: least, 5 %, median, 95 %",
        "below 1/3",
        "off by over 1 %",
        "of them successful",
        "good to 1e-3, and inaccurate",
        "median time [s]",
    ]
    return table(header, lines)


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--motions", type=int, default=120)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--tips", type=Path)
    parser.add_argument("--rows", type=Path)
    parser.add_argument("--write-docs", action="store_true")
    options = parser.parse_args()
    rows = []
    if options.rows and options.rows.exists():
        rows = [json.loads(line) for line in options.rows.read_text().splitlines()]
    done = {(row["seed"], row["motion"]) for row in rows}
    left = [k for k in range(options.motions) if (options.seed, k) not in done]
    cases = [random_motion(options.seed, k) for k in range(options.motions)] if left else []
    tips, known = judged(cases, options.tips) if left else ((), ())
    for k in left:
        row = {"seed": options.seed, "motion": k} | tried(cases[k], tips[k], known[k])
        rows.append(row)
        if options.rows:
            with options.rows.open("a") as file:
                file.write(json.dumps(row) + "\n")
    publish("judged motions", "reliability.md", f"{summary(rows)}\n\n{machine()}.")


if __name__ == "__main__":
    main()
