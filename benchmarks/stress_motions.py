"""The motions of the stress test: run as a user would, compared with a refined run, and counted.

The scenes are those of `stress_scenes.py`, whose loads go to 1e4 EI/L^2 and 80 EI/L, with damping
B/EI of 1e-5 to 0.1 periods of the first bending mode, drag, and 20 steps in which inputs jump,
ramp, or rise and are let go; all loads of a scene act from rest at once. The motions last 0.1 to
`PERIODS` periods of that mode, made faster by the loads, with 5 to 200 steps in each: longer ones
take long, and no more.

Each motion is run without any option, so that steps, grid and `max_time_error` are the defaults.
The refined run is the same code on a grid twice as fine or finer, with several times smaller
substeps, chosen by `tolerance=`: it shows what steps and grids do, and no mistake of the equations.
Motions that took over a minute themselves are left without one, which would take several. The judge
that shares nothing with this code is `judge_stress.py`. How well a refined run knows the
tip is told by two of them, and taken off its difference to the motion.
"""

import dataclasses
import time
from collections import Counter

import jax

jax.config.update("jax_enable_x64", True)

import numpy as np
from report import table
from stress_scenes import KINDS, Draw, random_equilibrium

import softrod_jax as sr
from softrod_jax.scene.scene import as_arrays
from softrod_jax.stepping.first_mode import EFFECTIVE_MASS

STEPS, PERIODS = 20, 4.0
COURSES = "jump", "ramp", "let go"
WRONG, SEEN, FACTOR = 1e-2, 1e-5, 3.0
# Accuracies of the refined run, in lengths: the first is as large as the estimate that it is to
# judge, within these bounds, and the next one smaller by this factor.
COARSEST, FINEST, FINER = 1e-3, 2e-6, 10.0
# An error this many times as large as the refined run's own is known well enough.
CLEAR = 5.0
# Seconds: what took longer is not run again, be it to leave out the time to compile or for a
# refined run that is more refined.
LONG = 10.0
# Seconds: what took longer is not refined at all.
TOO_LONG = 60.0
# Programs are forgotten after so many motions: on some grids they take much memory.
FORGET = 20
# Codes of motions that have a tip to compare at every step.
MOVING = "successful", "inaccurate"


def course(kind):
    """The part of its largest value that an input has in each step, (steps,)."""
    k = np.arange(1, STEPS + 1)
    match kind:
        case "jump":
            return np.ones(STEPS)
        case "ramp":
            return np.minimum(1.0, k / 10)
    return np.minimum(1.0, k / 8) * (k <= 13)


def frequency(scene, size):
    """Of the first bending mode [rad/s], with what holds the tip under loads of these sizes."""
    weight = float(scene.density) * float(scene.section.area) * float(scene.length)
    mass = EFFECTIVE_MASS * weight
    mass += 0.0 if scene.payload is None else float(scene.payload.mass)
    EI = float(scene.young_modulus) * float(np.min(scene.section.second_moments))
    stiffer = 3.0 + size["force"] + size["payload"] + size["heavy"] / 2 + size["moment"]
    return np.sqrt(stiffer * EI / (float(scene.length) ** 3 * mass))


def random_motion(rng):
    """(scene, tensions and pressures in time or None, dt), and the numbers it was drawn with."""
    scene, tensions, pressures, numbers = random_equilibrium(rng)
    draw = Draw(rng, numbers["structure"] == "plane")
    omega = frequency(scene, numbers)
    dt = draw.log(0.1, PERIODS) * 2 * np.pi / omega / STEPS
    EI = float(scene.young_modulus) * float(np.min(scene.section.second_moments))
    EA = float(scene.young_modulus) * float(scene.section.area)
    damping = draw.log(1e-5, 0.1) * 2 * np.pi / omega
    stretch_damping = draw.maybe(0.5, damping)
    drag = draw.maybe(0.5, draw.log(1e-3, 3.0))
    moved = as_arrays(
        dataclasses.replace(
            scene,
            bending_damping=damping * EI,
            shear_damping=None if scene.inextensible else stretch_damping * EA,
            drag_coefficient=drag * float(scene.density) * np.sqrt(float(scene.section.area)),
        )
    )
    kind = str(rng.choice(COURSES))
    in_time = lambda x: None if x is None else course(kind)[:, None] * x
    wave = dt * np.sqrt(float(scene.young_modulus / scene.density)) / float(scene.length)
    numbers |= {
        "load": max(numbers[name] for name in ("heavy", "payload", "force", "moment", "coil")),
        "course": kind,
        "dt": dt,
        "periods": STEPS * dt * omega / (2 * np.pi),
        "wave": wave,
        "damping": damping,
        "stretch_damping": stretch_damping,
        "drag": drag,
    }
    return moved, in_time(tensions), in_time(pressures), dt, numbers


def run(scene, tensions, pressures, dt, **options):
    steps = STEPS if tensions is None else None
    return sr.simulate(scene, dt, tensions, pressures, steps=steps, throw=False, **options)


def estimate_of(motion):
    """The estimated error of a motion, in time and along the rod, in lengths."""
    return float(motion.stats["time_error"][-1]) + float(np.max(motion.stats["error"]))


def compared(case, motion):
    """What refined runs say of a motion: how far it is off, and how well that is known."""
    tips, length = np.asarray(motion.tip_positions), float(case[0].length)
    grid = sr.Collocation(2 * int(motion.stats["intervals"]))
    found = {"refined": "none", "error": np.nan, "known": np.nan}
    estimate = estimate_of(motion)
    tolerance = float(np.clip(estimate, FINEST, COARSEST))
    took = 0.0
    while tolerance >= FINEST and took < LONG:
        start = time.perf_counter()
        fine = run(*case, method=grid, tolerance=tolerance)
        if int(fine.result) != 0:
            if found["refined"] == "none":
                found["refined"] = sr.RESULTS(int(fine.result)).name
            break
        took = time.perf_counter() - start
        moved = np.linalg.norm(tips - np.asarray(fine.tip_positions), axis=1)
        error, known = float(np.max(moved)) / length, float(fine.stats["time_error"][-1])
        found = {"refined": "successful", "error": error, "known": known}
        if error > CLEAR * known or error + known < max(SEEN, FACTOR * estimate):
            break
        tolerance /= FINER
    return found


def one(seed, k):
    """The row of one motion: {what: a number or a name}."""
    if k % FORGET == 0:
        jax.clear_caches()
    *case, numbers = random_motion(np.random.default_rng([seed, k]))
    times = []
    for _ in range(2):  # the first may compile
        start = time.perf_counter()
        motion = jax.block_until_ready(run(*case))
        times.append(time.perf_counter() - start)
        if times[0] > LONG:
            break
    begin, result = time.perf_counter(), sr.RESULTS(int(motion.result)).name
    is_refined = result in MOVING and min(times) < TOO_LONG
    unknown = {"refined": "none", "error": np.nan, "known": np.nan}
    return {
        "scene": k,
        "result": result,
        "estimate": estimate_of(motion),
        "time_error": float(motion.stats["time_error"][-1]),
        "along": float(np.max(motion.stats["error"])),
        **(compared(case, motion) if is_refined else unknown),
        "substeps": int(np.sum(motion.stats["substeps"])),
        "intervals": int(motion.stats["intervals"]),
        "tips": np.asarray(motion.tip_positions).tolist(),
        "time": min(times),
        "refined_time": time.perf_counter() - begin,
        **numbers,
    }


def is_solved(row):
    return row["result"] == "successful"


def off(row):
    """By how much a motion is off for certain, in lengths; NaN where nothing tells."""
    return max(row["error"] - row["known"], 0.0)


def is_wrong(row):
    """Called successful, and off by more than a hundredth of the rod."""
    return is_solved(row) and off(row) > WRONG


def is_flattering(row):
    """The estimate is below a third of an error that can be seen."""
    return off(row) > SEEN and not FACTOR * row["estimate"] >= off(row)


def counts(rows):
    """A line of the table."""
    known = [row for row in rows if np.isfinite(row["error"])]
    codes = Counter(row["result"] for row in rows if not is_solved(row))
    clear = [row for row in known if off(row) > SEEN and row["error"] > CLEAR * row["known"]]
    ratio = [row["estimate"] / row["error"] for row in clear]
    quantiles = np.quantile(ratio, [0.0, 0.05, 0.5, 0.95]) if ratio else []
    times = [row["time"] for row in rows]
    return [
        str(len(rows)),
        str(sum(map(is_solved, rows))),
        ", ".join(f"{n} `{name}`" for name, n in codes.items()) or "none",
        str(len(known)),
        str(sum(map(is_wrong, rows))),
        str(sum(is_flattering(row) for row in rows if is_solved(row))),
        str(sum(is_flattering(row) for row in rows if not is_solved(row))),
        ", ".join(f"{q:.2g}" for q in quantiles),
        f"{np.median(times):.2g}, {np.quantile(times, 0.95):.2g}",
    ]


def details(rows) -> str:
    """Counts by kind of scene, and the motions to look at first."""
    if not rows:
        return ""
    lines = [["all", *counts(rows)]]
    for kind in KINDS:
        here = [row for row in rows if row["kind"] == kind]
        if here:
            lines.append([kind, *counts(here)])
    header = [
        "",
        "motions",
        "solved",
        "codes of the others",
        "compared",
        "solved, off by over 1 %",
        "estimate < error/3",
        "the same, of those not solved",
        "estimate/error: least, 5 %, median, 95 %",
        "time, median and 95 % [s]",
    ]
    names = "scene", "kind", "structure", "course", "result", "substeps", "intervals"
    numbers = "time_error", "along", "error", "known", "periods", "load", "tension", "slenderness"
    bad = [row for row in rows if is_wrong(row) or is_flattering(row)]
    bad.sort(key=lambda row: (not is_wrong(row), row["estimate"] / row["error"]))
    worst = [
        [*(str(row[name]) for name in names), *(f"{row[name]:.2g}" for name in numbers)]
        for row in bad
    ]
    return f"{table(header, lines)}\n\n{table([*names, *numbers], worst)}\n"
