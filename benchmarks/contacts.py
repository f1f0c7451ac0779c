"""Rods against obstacles: random equilibria on three grids, a bounce, forces by the step, cost.

    python benchmarks/contacts.py [equilibria] [bounce] [steps] [cost] [tube]
                                  [--count 200] [--seed 0]

- `equilibria`: a rod of 0.1 m under gravity and tensions against a plane, a ball or a bent tube, of
  300 to 30,000 N/m^2, on 12, 24 and 48 intervals, and how the estimated errors compare with the
  distances from the finest.
- `bounce`: a rod that falls on a wall and flies on, undamped: how much of its energy it keeps.
- `steps`: its tip and its mean force over half a second against steps of 0.5 ms, twice the grid.
- `cost`: a step with the wall against one without, in a plane and in space: processor time.
- `tube`: a slender rod of 0.3 m that is pushed into a straight tube, and the pitch of its helix
  away from the ends against Lubinski's (F = 8 pi^2 EI / pitch^2).
"""

import argparse
import dataclasses
import time

import equinox as eqx
import jax

jax.config.update("jax_enable_x64", True)

import jax.numpy as jnp
import numpy as np
from report import machine

import softrod_jax as sr
from softrod_jax.scene.scene import as_arrays

L, R, E, NU, RHO, G, DEPTH = 0.1, 6e-3, 5e4, 0.49, 1070.0, 9.81, -0.03
A, I = np.pi * R**2, np.pi * R**4 / 4
GRIDS = 12, 24, 48


def obstacle(kind: int, rng):
    """A plane beside the rod, a ball, or a tube that bends away from it."""
    side = rng.uniform(0, 2 * np.pi)
    away = np.array([np.cos(side), np.sin(side), 0.0])
    if kind == 0:
        return sr.Plane(rng.uniform(8e-3, 0.03) * away, -away + 0.3 * rng.normal(size=3))
    if kind == 1:
        return sr.Sphere(rng.uniform(0.03, 0.045) * away + [0, 0, rng.uniform(0.04, 0.1)], 0.02)
    bend = np.linspace(0.0, rng.uniform(0.3, 1.5), 12)
    x, z = (0.15 / bend[-1]) * np.stack([1 - np.cos(bend), np.sin(bend)])
    return sr.Tube(np.outer(x, away) + np.outer(z, [0, 0, 1]), rng.uniform(8e-3, 12e-3))


@eqx.filter_jit
def solved(scene, tensions, intervals):
    """The tip, the code and the estimate on a grid."""
    method = sr.Collocation(intervals, max_error=1e-2)
    solution = sr.solve_static(scene, tensions, method=method, throw=False)
    return solution.tip_position, solution.result, solution.stats["error"]


def equilibria(rng, count: int) -> None:
    """Random ones."""
    found, off, told = {n: 0 for n in GRIDS}, {n: [] for n in GRIDS[:-1]}, []
    begun = time.perf_counter()
    for k in range(count):
        direction = rng.normal(size=3)
        contact = sr.Contact(obstacle(k % 3, rng), 10 ** rng.uniform(2.5, 4.5))
        gravity = jnp.array(G * direction / np.linalg.norm(direction))
        scene = as_arrays(
            eqx.tree_at(
                lambda s: s.contacts,
                sr.hybrid_robot(gravity=gravity),
                (contact,),
                is_leaf=lambda x: x is None,
            )
        )
        tensions = jnp.array(rng.uniform(0, 0.3, 3))
        answers = {n: solved(scene, tensions, n) for n in GRIDS}
        good = {n: int(a[1]) in (0, int(sr.RESULTS.inaccurate)) for n, a in answers.items()}
        for n in GRIDS:
            found[n] += good[n]
        for n in GRIDS[:-1]:
            if good[n] and good[GRIDS[-1]]:
                apart = np.linalg.norm(answers[n][0] - answers[GRIDS[-1]][0]) / L
                off[n].append(apart)
                if n == GRIDS[0] and apart > 1e-5:
                    told.append(apart / max(float(answers[n][2]), 1e-12))
    print(f"found of {count}: {found}; {time.perf_counter() - begun:.0f} s with compiling")
    for n, x in off.items():
        print(f"{n} intervals: off by {np.median(x):.1e} L in the median, {np.max(x):.1e} at most")
    print(f"error / estimate above 3: {sum(x > 3 for x in told)}, largest {max(told):.1f}")


def falling(stiffness=None, damping=None) -> sr.Scene:
    """Held at one end above a wall, on which it falls; without it, if there is no stiffness."""
    wall = None
    if stiffness is not None:
        plane = sr.Plane([DEPTH, 0.0, 0.0], [1.0, 0.0, 0.0])
        wall = (sr.Contact(plane, stiffness, damping=damping, name="wall"),)
    return as_arrays(
        sr.Scene(
            length=L, section=sr.Circle(R), young_modulus=E, poisson_ratio=NU, density=RHO,
            gravity=[-G, 0.0, 0.0], plane="xz", contacts=wall,
        )
    )  # fmt: skip


@eqx.filter_jit
def moved(scene, dt, steps, intervals, scheme):
    """A motion on a grid as it is."""
    method = sr.Collocation(intervals, max_error=1e9)
    return sr.simulate(
        scene, dt, steps=steps, scheme=scheme, method=method, max_time_error=jnp.inf, throw=False
    )


def kept(motion, stiffness: float) -> float:
    """By how much the energy changes, in parts of the largest kinetic one: Simpson's rule."""
    nodes = len(motion.arc_lengths)
    rule = np.array([1, *[4, 2] * ((nodes - 3) // 2), 4, 1]) * L / (nodes - 1) / 3
    shear, bend = E * A / (2 * (1 + NU)), np.array([E * I, E * I, E * I / (1 + NU)])
    elastic = np.array([shear, shear, E * A, *bend])
    inertia = RHO * np.array([A, A, A, I, I, 2 * I])
    x = motion.positions[..., 0]
    depth = np.maximum(R - (x - DEPTH), 0)
    kinetic = motion.velocities**2 @ inertia / 2
    strains = motion.strains - np.array([0, 0, 1, 0, 0, 0])
    stored = strains**2 @ elastic / 2 + stiffness * depth**2 / 2 + RHO * A * G * x
    total = (kinetic + stored) @ rule
    return float(np.abs(total - total[0]).max() / (kinetic @ rule).max())


def bounce(stiffness: float = 2e3) -> None:
    """Of 0.15 s, in which it touches once."""
    for intervals in (12, 24):
        for dt in (5e-3, 2.5e-3):
            motion = moved(falling(stiffness), dt, round(0.15 / dt), intervals, sr.SDIRK(4))
            lost = kept(motion, stiffness)
            print(f"bounce, {intervals} intervals, {1e3 * dt} ms: energy to {100 * lost:.2f} %")


def steps() -> None:
    """Of tip and mean force."""
    for stiffness in (2e3, 2e4):
        scene, exact = falling(stiffness, damping=1.0), None
        for dt in (0.5e-3, 2.5e-3, 5e-3, 10e-3):
            intervals = 24 if exact is None else 12
            motion = moved(scene, dt, round(0.5 / dt), intervals, sr.SDIRK())
            every = round(10e-3 / dt)
            tip, force = motion.tip_positions[::every], motion.contact_forces["wall"][:, 0]
            mean = float(np.mean(0.5 * (force[1:] + force[:-1])))
            if exact is None:
                exact = tip, mean
                continue
            off = float(jnp.max(jnp.linalg.norm(tip - exact[0], axis=1))) / L
            part = 100 * abs(mean / exact[1] - 1)
            print(f"k {stiffness:g}, {1e3 * dt} ms: tip {off:.1e} L, mean force {part:.2f} %")


def cost(repeats: int = 9) -> None:
    """Of 100 steps of 5 ms."""
    walls = {"free": falling(), "wall": falling(2e3), "wall, damped": falling(2e3, 1.0)}
    for where, plane in (("in a plane", "xz"), ("in space", None)):
        best, evaluations = {}, {}
        for name in list(walls) * repeats:  # in turns: a slow moment falls on all
            scene = dataclasses.replace(walls[name], plane=plane)
            begun = time.process_time()
            motion = jax.block_until_ready(moved(scene, 5e-3, 100, 12, sr.SDIRK()))
            best[name] = min(best.get(name, np.inf), time.process_time() - begun)
            evaluations[name] = float(np.mean(motion.stats["iterations"]))
        for name, seconds in best.items():
            times = seconds / best["free"]
            print(
                f"{where}, {name}: {10 * seconds:.2f} ms a step, {times:.2f} times; "
                f"{evaluations[name]:.1f} evaluations"
            )


def tube(bending: float = 5e-5, gap: float = 1e-3) -> None:
    """Of loads whose pitch is a third, and a quarter, of the rod; a little weight says where."""
    length = 3 * L
    around = sr.Tube([[0.0, 0.0, 0.0], [0.0, 0.0, length]], R + gap)
    for turns, curvature, intervals in ((3, 1.0, 36), (3, 1.0, 48), (3, 0.3, 48), (4, 1.0, 60)):
        push = 8 * np.pi**2 * bending * (turns / length) ** 2
        scene = sr.Scene(
            length, sr.Circle(R), linear_density=0.12, inextensible=True,
            stiffness=sr.Stiffness(bending=[bending, bending], torsion=bending),
            gravity=[-0.3, 0.0, 0.0], rest_curvature=[curvature, 0.0, 0.0],
            tip_load=sr.TipLoad([0.0, 0.0, -push]), contacts=(sr.Contact(around, 1e5),),
        )  # fmt: skip
        begun = time.perf_counter()
        method = sr.Collocation(intervals, max_error=1e-2)
        solution = sr.solve_static(scene, method=method, throw=False)
        (x, y, _), s = np.asarray(solution.positions).T, np.asarray(solution.arc_lengths)
        middle = (s > 0.3 * length) & (s < 0.8 * length)
        turned = np.unwrap(np.arctan2(y, x))[middle]
        pitch = 2 * np.pi / abs(np.polyfit(s[middle], turned, 1)[0]) * turns / length
        stable = "stable" if solution.stats["stable"] else "not stable"
        print(
            f"tube, {push:.3f} N, {curvature} 1/m, {intervals} intervals: "
            f"{sr.RESULTS(int(solution.result)).name}, {stable}, error "
            f"{float(solution.stats['error']):.0e}; pitch {pitch:.4f} of the known one; "
            f"{time.perf_counter() - begun:.0f} s"
        )


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument(
        "parts", nargs="*", default=["equilibria", "bounce", "steps", "cost", "tube"]
    )
    parser.add_argument("--count", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    print(machine())
    if "equilibria" in args.parts:
        equilibria(np.random.default_rng(args.seed), args.count)
    for name, part in (("bounce", bounce), ("steps", steps), ("cost", cost), ("tube", tube)):
        if name in args.parts:
            part()
