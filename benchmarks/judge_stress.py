"""Motions of the stress test, judged by an independent explicit code.

    python benchmarks/judge_stress.py --rows FILE [--seed 6] [--found FILE] [--steps 300000]

`stress.py --rows FILE` has left the tip of each motion there, as it came out at the default
settings. Those that `explicit_rod.py` can follow are followed by it: rods that stretch, whose
stretching is not damped, in at most --steps of its own steps. It takes three grids, each twice as
fine; the finer two are extrapolated, and the change by that is how well the tip is known.
Numbers of a scene are read by `judge_rod.py`, so that nothing of the package's code is used.
Tips of the judge are kept in --found, and not computed again.
"""

import argparse
import json
import math
from pathlib import Path
from typing import NamedTuple

import jax

jax.config.update("jax_enable_x64", True)

import judge_rod
import numpy as np
from explicit_rod import ExplicitRods, Rods, motion
from report import machine, table
from stress_motions import FACTOR, MOVING, STEPS, WRONG, random_motion

GRIDS = (24, 48, 96)
# The judge's doubt from which on it is no judge, and the least error looked at, in lengths.
SURE, LEAST = 3e-3, 1e-5
# Motions of about equal cost that are followed side by side.
BESIDE = 24


class Case(NamedTuple):
    """A motion in units of L, EI and the mass per length: its rod, its inputs, and its step."""

    rod: Rods
    pulls: np.ndarray
    pressures: np.ndarray
    dt: float


def case_of(scene, tensions, pressures, dt) -> Case | None:
    """What the explicit code is to follow; nothing where it has no such rod."""
    if scene.inextensible or (scene.shear_damping is not None and np.any(scene.shear_damping)):
        return None
    # In these units the clamp is at 0 along z, and loads are turned into its frame.
    unit = judge_rod.rod_of(scene)
    A, (Ix, Iy), _ = judge_rod.section_numbers(scene.section)
    L, E, rho = float(scene.length), float(scene.young_modulus), float(scene.density)
    EI = E * max(Ix, Iy)
    time = L**2 * math.sqrt(rho * A / EI)
    turned = judge_rod.matrix(unit.h_base / np.linalg.norm(unit.h_base)).T
    payload = 0.0 if scene.payload is None else float(scene.payload.mass) / (rho * A * L)
    spread = lambda x: np.broadcast_to(np.asarray(0.0 if x is None else x, float), (3,))
    count = 0 if tensions is None else tensions.shape[1]
    offsets = np.zeros((3, 2))
    offsets[:count] = np.asarray(scene.tendons.offsets, float) / L if count else 0.0
    pulls, thrust = np.zeros((STEPS, 3)), np.zeros((STEPS, 1))
    pulls[:, :count] = 0.0 if tensions is None else tensions * L**2 / EI
    arm = np.zeros(2)
    if pressures is not None:
        thrust[:] = pressures * np.asarray(scene.chambers.areas, float) * L**2 / EI
        arm = np.asarray(scene.chambers.offsets, float).reshape(-1, 2)[0] / L
    rod = Rods(
        L=np.array(1.0),
        K_se=unit.k[:3],
        K_bt=unit.k[3:],
        B_bt=spread(scene.bending_damping) / (EI * time),
        rho_A=np.array(1.0),
        rho_J=np.array([Ix, Iy, Ix + Iy]) / (A * L**2),
        drag=spread(scene.drag_coefficient) * L / (rho * A),
        gravity=turned @ unit.weight,
        payload=np.array(payload),
        force=turned @ (unit.force - payload * unit.weight),
        moment=turned @ unit.moment,
        offsets=offsets,
        thrust_area=np.array(1.0),
        thrust_arm=arm,
        curvature=unit.rest[3:],
    )
    return Case(rod, pulls, thrust, dt / time)


def at_both_ends(values):
    """(steps, 2, channels): inputs at both ends of each step, linear between them.

    They jump in the first step, and where they are let go.
    """
    before = np.concatenate([values[:1], values[:-1]])
    return np.stack([np.where(values == 0.0, values, before), values], 1)


def steps_of(case: Case, n: int) -> int:
    """How many steps the explicit code takes."""
    alone = Rods(*(np.asarray(x)[None] for x in case.rod))
    return STEPS * math.ceil(case.dt / ExplicitRods(alone, n).longest_step()[0])


def follow(cases, n):
    """Tips (motions, steps + 1, 3) in lengths, in the frame of the clamp."""
    rods = Rods(*(np.stack(column) for column in zip(*(case.rod for case in cases), strict=True)))
    inputs = [
        np.stack([at_both_ends(x) for x in column])
        for column in zip(*((case.pulls, case.pressures) for case in cases), strict=True)
    ]
    with np.errstate(all="ignore"):  # a rod that the grid cannot follow is not known
        return motion(rods, np.array([case.dt for case in cases]), *inputs, n)


def judge(some, cases):
    """{scene: (tips, how well they are known in each step)} of motions of about equal cost."""
    coarse, middle, fine = (follow([cases[k] for k in some], n) for n in GRIDS)
    best = fine + (fine - middle) / 3
    # Where the change does not fall as it should, all of it is doubt.
    apart = np.linalg.norm(fine - middle, axis=-1)
    before = np.linalg.norm(middle - coarse, axis=-1)
    falls = np.maximum.accumulate(before, 1) > 2.5 * np.maximum.accumulate(apart, 1)
    known = np.where(falls, apart / 3, 2 * apart)
    return {k: (best[i].tolist(), known[i].tolist()) for i, k in enumerate(some)}


def in_frame(scene, tips):
    """Tips [m] in the world as the judge has them."""
    rod = judge_rod.rod_of(scene)
    return (np.asarray(tips) - rod.clamp) @ judge_rod.matrix(rod.h_base) / float(scene.length)


def compared(row, scene, tips, known):
    """What the judge says of a motion of the stress test."""
    apart = np.linalg.norm(in_frame(scene, row["tips"]) - np.asarray(tips), axis=1)
    names = "scene", "kind", "course", "result", "estimate"
    return {name: row[name] for name in names} | {
        "error": float(np.max(apart)),
        "known": float(np.max(known)) if np.all(np.isfinite(known)) else math.inf,
    }


def summary(rows, followed) -> str:
    sure = [row for row in rows if row["known"] < SURE]
    off = [max(row["error"] - row["known"], 0.0) for row in sure]
    seen = [
        row["estimate"] / row["error"]
        for row in sure
        if row["error"] > max(LEAST, 3 * row["known"])
    ]
    pairs = list(zip(sure, off, strict=True))
    line = [
        f"{len(sure)} of {followed}",
        str(sum(row["result"] == "successful" for row in sure)),
        str(sum(row["result"] == "successful" and x > WRONG for row, x in pairs)),
        str(sum(x > LEAST and FACTOR * row["estimate"] < x for row, x in pairs)),
        " / ".join(f"{q:.2g}" for q in np.quantile(seen, [0.0, 0.05, 0.5, 0.95])),
    ]
    header = [
        "known to 0.3 %, of those followed",
        "successful",
        "of them off by over 1 %",
        "estimate below a third of an error above 1e-5",
        "estimate / error: least, 5 %, median, 95 %",
    ]
    return table(header, [line])


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--rows", type=Path, required=True)
    parser.add_argument("--seed", type=int, default=6)
    parser.add_argument("--found", type=Path)
    parser.add_argument("--steps", type=int, default=300_000)
    options = parser.parse_args()
    rows = [json.loads(line) for line in options.rows.read_text().splitlines()]
    rows = {row["scene"]: row for row in rows if row["what"] == "motion" and "tips" in row}
    found = {}
    if options.found and options.found.exists():
        found = {int(k): x for k, x in json.loads(options.found.read_text()).items()}
    scenes, cases = {}, {}
    for k in sorted(rows):
        *motion_k, _ = random_motion(np.random.default_rng([options.seed, k]))
        case = case_of(*motion_k)
        if case is not None and steps_of(case, GRIDS[-1]) <= options.steps:
            scenes[k], cases[k] = motion_k[0], case
    left = sorted((k for k in cases if k not in found), key=lambda k: steps_of(cases[k], GRIDS[-1]))
    for some in np.array_split(left, -(-len(left) // BESIDE)) if left else ():
        found |= judge(list(map(int, some)), cases)
        print(f"{len(found)} of {len(cases)} followed", flush=True)
        if options.found:
            options.found.write_text(json.dumps(found))
    here = [k for k in cases if rows[k]["result"] in MOVING]
    judged = [compared(rows[k], scenes[k], *found[k]) for k in here]
    for row in judged:
        worse = FACTOR * row["estimate"] < row["error"] - row["known"]
        if row["known"] < SURE and (worse or row["error"] - row["known"] > WRONG):
            print({n: f"{v:.3g}" if isinstance(v, float) else v for n, v in row.items()})
    print(f"{summary(judged, len(here))}\n\n{machine()}.")


if __name__ == "__main__":
    main()
