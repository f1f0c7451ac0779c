"""Stress test: random scenes far beyond the ordinary, each against a refined solution.

    python benchmarks/stress.py [--scenes 1000] [--seed 0]

Half of the scenes are equilibria, half are motions of 20 steps. They span length 0.02 to 1 m,
slenderness L/r 5 to 150, Young's modulus 3e4 to 2e11 Pa, density 900 to 8000 kg/m^3, damping
B/EI 1e-5 to 3e-2 s, dt 1e-5 to 5e-2 s, gravity up to rho A g L^3 / EI = 50, tensions up to 90 %
of where a tendon's path vanishes, pressures, tip loads, payloads and drag; inputs step or ramp.
Numbers change and programs do not, so that it compiles a handful of times. A scene that takes over
5 s, has no answer, or is off by over 1e-3 lengths is printed; in the end, counts.
"""

import argparse
import time
from collections import Counter

import jax

jax.config.update("jax_enable_x64", True)

import numpy as np

import softrod_jax as sr
from softrod_jax.scene import as_arrays

STEPS, TOLERANCE, WRONG = 20, 1e-3, 1e-2
GRIDS = sr.Collocation(), sr.Collocation(24)


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
    weight = maybe(log(1e-2, 50.0))
    limit = 1 / (1 / EA + offset**2 / EI)
    pull = maybe(rng.uniform(0, 0.9)) * limit * rng.dirichlet(np.ones(3) * 0.5)
    chamber = 0.1 * area
    scene = as_arrays(
        sr.Scene(
            length=L,
            section=sr.Circle(r),
            young_modulus=E,
            poisson_ratio=rng.uniform(0.0, 0.49),
            density=density,
            bending_damping=log(1e-5, 3e-2) * EI,
            gravity=weight * EI / (density * area * L**3) * direction(),
            drag_coefficient=maybe(log(1e-3, 3.0) * density * r),
            tendons=sr.Tendons(offset * np.stack([np.cos(angle), np.sin(angle)], 1)),
            chambers=sr.Chambers(
                np.array([chamber]), rng.uniform(-0.3, 0.3, (1, 2)) * r
            ),
            payload=sr.Payload(maybe(log(0.01, 2.0) * density * area * L)),
            tip_load=sr.TipLoad(
                maybe(log(1e-2, 10.0) * EI / L**2 * direction()),
                maybe(log(1e-2, 5.0) * EI / L * direction()),
            ),
        )
    )
    pressure = maybe(log(1e-3, 0.1)) * EA / chamber
    numbers = {"slenderness": slenderness, "young_modulus": E, "weight": weight, "length": L}
    return scene, pull, np.array([pressure]), log(1e-5, 5e-2), rng.random() < 0.5, numbers


def try_static(case):
    scene, tensions, pressures, *_ = case
    solve = lambda method: sr.solve_static(
        scene, tensions, pressures, method=method, tolerance=TOLERANCE, throw=False
    )
    start = time.perf_counter()
    solution = solve(GRIDS[0])
    tip = np.array(solution.tip_position)
    took = time.perf_counter() - start
    refined = solve(GRIDS[1])
    error = np.linalg.norm(tip - refined.tip_position) / scene.length
    stats = solution.stats
    return solution.result, refined.result, error, int(stats["iterations"]), took, stats


def try_motion(case):
    scene, tensions, pressures, dt, ramp, _ = case
    rise = np.minimum(1.0, np.arange(1, STEPS + 1) / 10) if ramp else np.ones(STEPS)
    run = lambda **settings: sr.simulate(
        scene, dt, rise[:, None] * tensions, rise[:, None] * pressures, throw=False, **settings
    )
    start = time.perf_counter()
    motion = run(tolerance=TOLERANCE)
    tip = np.array(motion.tip_positions)
    took = time.perf_counter() - start
    refined = run(method=GRIDS[1], tolerance=TOLERANCE / 10)
    error = np.linalg.norm(tip - refined.tip_positions, axis=1).max() / scene.length
    stats = motion.stats
    return motion.result, refined.result, error, int(np.sum(stats["iterations"])), took, stats


def run(count, seed):
    """One row a scene."""
    rows = []
    for k in range(count):
        rng = np.random.default_rng([seed, k])
        case = random_scene(rng)
        kind, attempt = (("equilibrium", try_static), ("motion", try_motion))[k % 2]
        result, refined, error, iterations, took, stats = attempt(case)
        row = {
            "scene": k,
            "kind": kind,
            "result": sr.RESULTS(int(result)).name,
            "refined": sr.RESULTS(int(refined)).name,
            "error": float(error),
            "iterations": iterations,
            "time": took,
            "dt": case[3],
            **case[-1],
        }
        for name in ("substeps", "load_steps", "transient_steps"):
            row[name] = int(stats.get(name, 0))
        rows.append(row)
        bad = row["result"] != "successful" or row["error"] > 1e-3
        if bad or k % 50 < 2 or took > 5:
            shown = {n: f"{v:.3g}" if isinstance(v, float) else v for n, v in row.items()}
            print(shown, flush=True)
    return rows


def is_wrong(row):
    """Called successful, and not."""
    return row["result"] == row["refined"] == "successful" and row["error"] > WRONG


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("--scenes", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    rows = run(options.scenes, options.seed)
    for kind in ("equilibrium", "motion"):
        of_kind = [row for row in rows if row["kind"] == kind]
        print(kind, dict(Counter(row["result"] for row in of_kind)))
        print("  wrong:", [row["scene"] for row in of_kind if is_wrong(row)])
        print("  refined failed:", [r["scene"] for r in of_kind if r["refined"] != "successful"])
        times = np.array([row["time"] for row in of_kind])
        print("  time median %.3g, 95 %% %.3g, most %.3g s" % (
            np.median(times), np.quantile(times, 0.95), times.max()))
