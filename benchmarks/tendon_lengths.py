"""Tendons driven by their length: random robots, a release, and what a step costs.

    python benchmarks/tendon_lengths.py [inverse] [equilibria] [motions] [release] [cost]
        [--count 1000] [--seed 0]

- `inverse`: two-segment robots are solved with tensions, and again with the lengths found.
- `equilibria`: rods from soft to stiff, short to long, light to heavy, pulled at random. Each is
  judged under its own tensions by `judge_static.py`, and its tendons are measured along the curve.
- `motions`: such rods under pulls that jump, ramp and are let go, against one with a tolerance.
- `release`: the energy of a rod whose tendon is let go and caught again.
- `cost`: a step against one with the same tensions given, for 3 and 9 tendons.
"""

import argparse
import dataclasses
import time

import jax

jax.config.update("jax_enable_x64", True)

import jax.numpy as jnp
import numpy as np
from judge_rod import NoAnswer
from judge_static import judge_answer
from report import machine

import softrod_jax as sr
from softrod_jax.scene.scene import as_arrays

WRONG = 1e-2
# Errors that motions with a tolerance of a third of it tell.
KNOWN = 3e-4
THIRDS = 2 * np.pi * np.arange(3) / 3


def two_segments(rng):
    """A robot of two segments with six tendons, one of them helical, and tensions for it."""
    lengths, radius = rng.uniform(0.04, 0.1, 2), rng.uniform(4e-3, 8e-3)
    moduli = 10 ** rng.uniform(4.5, 6.5) * rng.uniform(0.5, 2.0, 2)
    segments = tuple(
        sr.Segment(length=a, section=sr.Circle(radius * k), young_modulus=E)
        for a, k, E in zip(lengths, (1.0, 0.9), moduli)
    )
    angles = np.concatenate([THIRDS, THIRDS + rng.uniform(0, 2)])
    offsets = 0.7 * radius * np.stack([np.cos(angles), np.sin(angles)], 1)
    offsets[5] = 0.0
    helix = sr.Helix(0.7 * radius, angles[5], rng.uniform(-0.6, 0.6))
    end = lengths[0]
    EI, L = float(np.mean(moduli)) * np.pi * radius**4 / 4, float(sum(lengths))
    weight = 1070.0 * np.pi * radius**2 * L**3 / EI
    direction = rng.normal(size=3)
    scene = sr.Scene(
        segments=segments,
        poisson_ratio=0.45,
        density=1070.0,
        gravity=min(9.81, 6.0 / weight) * direction / np.linalg.norm(direction),
        tendons=sr.Tendons(
            offsets, paths=(None,) * 5 + (helix,), ends_at=(end, end, end, None, None, None)
        ),
    )
    return as_arrays(scene), jnp.array(rng.uniform(0, 1.0, 6) * EI / (L * radius))


def inverse(count, seed):
    rng = np.random.default_rng(seed)
    samples = [two_segments(rng) for _ in range(count)]
    scenes, tensions = jax.tree.map(lambda *x: jnp.stack(x), *samples)

    def both(scene, tensions):
        there = sr.solve_static(scene, tensions, throw=False)
        pulls = sr.tendon_pulls(scene, there)
        tendons = dataclasses.replace(scene.tendons, control="length")
        scene = dataclasses.replace(scene, tendons=tendons)
        back = sr.solve_static(scene, pulls=pulls, throw=False)
        return there.result, back.result, back.tensions, there.tip_position - back.tip_position

    first, second, found, moved = jax.jit(jax.vmap(both))(scenes, tensions)
    fine = np.asarray((first == 0) & (second == 0))
    error = np.abs(found - tensions)[fine].max(1) / np.asarray(tensions)[fine].max(1)
    moved = np.linalg.norm(moved, axis=1)[fine]
    print(
        f"inverse: {count} robots; solved with tensions {np.sum(first == 0)}, and of these with"
        f" lengths {np.sum(fine)}\n"
        f"  tensions come back to {error.max():.1e} of the largest (99 %: "
        f"{np.quantile(error, 0.99):.1e}), tips to {moved.max():.1e} m; "
        f"above 1e-9: {np.sum(error > 1e-9)}; the same rod not found again: "
        f"{np.sum(error > 1e-3)}"
    )


def random_rod(rng, elastic):
    """A rod with three tendons, and how far its tip is bent by a pull of unit angle."""
    L = 10 ** rng.uniform(-1.5, 0.5)
    radius = L / rng.uniform(15, 80)
    E = 10 ** rng.uniform(4, 10)
    EI, area = E * np.pi * radius**4 / 4, np.pi * radius**2
    load = 10 ** rng.uniform(-2, 2)
    direction = rng.normal(size=3)
    density = rng.uniform(900, 3000)
    gravity = load * EI / (density * area * L**3) * direction / np.linalg.norm(direction)
    r = radius * rng.uniform(0.4, 0.95)
    angles = THIRDS + rng.uniform(0, 2 * np.pi)
    stiffness = None
    if elastic:
        stiffness = (E * area / L * 10 ** rng.uniform(-2, 2),) * 3
    # One relaxation time for all strains, as a material has it.
    relaxation = L**2 * np.sqrt(density * area / EI) * 10 ** rng.uniform(-3, -1)
    scene = sr.Scene(
        length=L,
        section=sr.Circle(radius),
        young_modulus=E,
        poisson_ratio=rng.uniform(0.3, 0.49),
        density=density,
        bending_damping=relaxation * EI,
        shear_damping=relaxation * E * area,
        gravity=gravity,
        tendons=sr.Tendons(
            r * np.stack([np.cos(angles), np.sin(angles)], 1), control="length", stiffness=stiffness
        ),
    )
    return scene, r, angles


def random_pulls(rng, r, angles, length):
    """Of a bend of up to four radians, with up to two hundredths of the length more or less."""
    common = rng.uniform(-0.02, 0.02) * length
    return r * rng.uniform(0, 4) * np.cos(angles - rng.uniform(0, 2 * np.pi)) + common


def measured(scene, solution):
    """How much shorter than at rest each tendon is along the curve of dense output [m]."""
    s = jnp.linspace(0, float(scene.length), 2401)
    pose = jax.vmap(solution.at)(s)
    p, h = np.asarray(pose.position), np.asarray(pose.quaternion)
    shorter = []
    for x, y in np.asarray(scene.tendons.offsets):
        w, v = h[:, :1], h[:, 1:]
        r = np.array([x, y, 0.0])
        turned = r + 2 * np.cross(v, np.cross(v, r) + w * r)
        chords = lambda q: np.sum(np.linalg.norm(np.diff(q, axis=0), axis=1))
        line = p + turned
        # Chords are too short by the square of their length.
        shorter.append(float(scene.length) - (4 * chords(line) - chords(line[::2])) / 3)
    return np.array(shorter)


def equilibria(count, seed):
    rng = np.random.default_rng(seed + 1)
    rows = []
    for k in range(count):
        scene, r, angles = random_rod(rng, elastic=k % 2 == 1)
        pulls = random_pulls(rng, r, angles, float(scene.length))
        start = time.perf_counter()
        answer = sr.solve_static(scene, pulls=pulls, throw=False)
        row = dict(k=k, code=int(answer.result), time=time.perf_counter() - start)
        if row["code"] == 0:
            row |= judged(scene, answer, pulls)
        rows.append(row)
        if row["code"] or max(row.get("error", 0), row.get("gap", 0)) > WRONG:
            print("  ", row, flush=True)
    solved = [row for row in rows if row["code"] == 0]
    known = [row for row in solved if row["error"] is not None]
    errors, gaps = (np.array([row[n] for row in known]) for n in ("error", "gap"))
    print(
        f"equilibria: {count}, solved {len(solved)} ({len(solved) / count:.1%}); judged "
        f"{len(known)}: tips off by at most {errors.max():.1e} L (99 %: "
        f"{np.quantile(errors, 0.99):.1e}), tendons by {gaps.max():.1e} L; off by over {WRONG:g}: "
        f"{np.sum((errors > WRONG) | (gaps > WRONG))}; median time "
        f"{np.median([row['time'] for row in rows]) * 1e3:.0f} ms"
    )


def judged(scene, answer, pulls):
    """How far the tip is from where an independent solver has it, and how wrong tendons are."""
    L, tensions = float(scene.length), np.asarray(answer.tensions)
    given, slack = pulls.copy(), tensions == 0
    if scene.tendons.stiffness is not None:
        given = given - tensions / np.array([float(k) for k in scene.tendons.stiffness])
    apart = measured(scene, answer) - given
    # A slack tendon may be longer than its path, and no tendon shorter.
    gap = np.max(np.where(slack, np.maximum(-apart, 0.0), np.abs(apart))) / L
    try:
        verdict = judge_answer(scene, answer, tensions=tensions)
        error = float(np.linalg.norm(verdict.tip - np.asarray(answer.tip_position))) / L
    except NoAnswer:
        error = None
    return dict(error=error, gap=gap)


def random_course(rng, r, angles, length, steps):
    """Pulls that jump, ramp or are let go."""
    a, b = (random_pulls(rng, r, angles, length) for _ in range(2))
    x = np.linspace(0, 1, steps)[:, None]
    kind = rng.integers(3)
    if kind == 0:
        return np.where(x < 0.5, a, b)
    return np.minimum(3 * x, 1.0) * a if kind == 1 else np.where(x < 0.6, x / 0.6, 0.0) * a


def motions(count, seed):
    rng = np.random.default_rng(seed + 2)
    wrong, solved, errors, told, times = 0, 0, [], [], []
    for k in range(count):
        scene, r, angles = random_rod(rng, elastic=k % 2 == 1)
        L = float(scene.length)
        pulls = random_course(rng, r, angles, L, 20)
        EI = float(scene.young_modulus) * np.pi * float(scene.section.radius) ** 4 / 4
        mass = float(scene.density) * np.pi * float(scene.section.radius) ** 2
        dt = L**2 * np.sqrt(mass / EI) * rng.uniform(0.02, 0.1)
        start = time.perf_counter()
        motion = sr.simulate(scene, dt, pulls=pulls, throw=False)
        times.append(time.perf_counter() - start)
        solved += int(motion.result) == 0
        if int(motion.result):
            print(
                "  ", dict(k=k, code=int(motion.result), step=int(motion.failed_step)), flush=True
            )
            continue
        better = sr.simulate(scene, dt, pulls=pulls, tolerance=1e-4, throw=False)
        if int(better.result):
            continue
        error = np.linalg.norm(motion.tip_positions - better.tip_positions, axis=1).max() / L
        errors.append(error)
        estimate = float(motion.stats["time_error"][-1] + motion.stats["error"].max())
        if error > KNOWN:
            told.append(estimate / error)
        if error > 2 * WRONG or (error > KNOWN and estimate < error / 3):
            wrong += error > 2 * WRONG
            row = dict(k=k, error=float(error), estimate=estimate)
            print("  ", row, flush=True)
    print(
        f"motions: {count}, solved {solved} ({solved / count:.1%}); off from one with a tolerance "
        f"by over {2 * WRONG:g} L at any time: {wrong} of {len(errors)}; median "
        f"{np.median(errors):.1e}, 99 % {np.quantile(errors, 0.99):.1e}, largest "
        f"{np.max(errors):.1e}; of {len(told)} errors above {KNOWN:g} estimates are below a third "
        f"in {np.sum(np.array(told) < 1 / 3)} (least {np.min(told):.2f}, median "
        f"{np.median(told):.1f}); median time {np.median(times) * 1e3:.0f} ms, longest "
        f"{np.max(times):.0f} s"
    )


def release(*_):
    """A rod held by one tendon, let go at once, and caught by it on its way back."""
    rod = sr.Scene(
        length=0.1,
        section=sr.Circle(6e-3),
        young_modulus=5e4,
        poisson_ratio=0.49,
        density=1070.0,
        bending_damping=1e-7,
        shear_damping=3e-3,
        gravity=[0.0, 0.0, 9.81],
    )
    at = dataclasses.replace(
        rod, tendons=sr.Tendons([[4e-3, 0.0]], control="length", stiffness=(400.0,))
    )
    method = sr.Collocation(24)
    held = sr.solve_static(at, pulls=[8e-3], method=method)
    tips = []
    for dt in (1e-3, 2.5e-4):
        rows = np.full((round(0.3 / dt), 1), 1e-3)
        motion = sr.simulate(at, dt, pulls=rows, initial=held, throw=False)
        tips.append(np.asarray(motion.tip_positions)[:: round(1e-3 / dt)])
        slack = np.asarray(motion.tensions)[:, 0] == 0
        print(
            f"release, {dt * 1e3:g} ms: code {motion.result}; {balance(at, held, motion)}; "
            f"slack in {np.mean(slack):.0%} of the time, caught "
            f"{np.sum(slack[:-1] & ~slack[1:])} times"
        )
    print(f"  a quarter of the step moves the tip by {np.abs(tips[0] - tips[1]).max():.1e} m")


def balance(scene, held, motion):
    """Energies of a uniform rod by Simpson's rule over nodes."""
    radius, L, E = (float(x) for x in (scene.section.radius, scene.length, scene.young_modulus))
    A, I, G = np.pi * radius**2, np.pi * radius**4 / 4, E / (2 * (1 + float(scene.poisson_ratio)))
    K = np.array([G * A, G * A, E * A, E * I, E * I, G * 2 * I])
    B = np.repeat([float(scene.shear_damping), float(scene.bending_damping)], 3)
    inertia = float(scene.density) * np.array([A, A, A, I, I, 2 * I])
    n = len(motion.arc_lengths) - 1
    simpson = np.ones(n + 1)
    simpson[1:-1:2], simpson[2:-1:2] = 4, 2
    w = simpson * L / n / 3
    strain, velocity, ts = (np.asarray(x) for x in (motion.strains, motion.velocities, motion.ts))
    sum_of = lambda x, k: np.einsum("p,tpi,i->t", w, x**2, k)
    stored = 0.5 * sum_of(strain - np.array([0, 0, 1.0, 0, 0, 0]), K) + 0.5 * sum_of(
        velocity, inertia
    )
    weight = -float(scene.density) * A * 9.81 * np.asarray(motion.positions)[..., 2] @ w
    k = float(scene.tendons.stiffness[0])
    tendon = 0.5 * np.asarray(motion.tensions)[:, 0] ** 2 / k
    power = sum_of(np.gradient(strain, ts, axis=0), B)
    lost = np.concatenate([[0], np.cumsum(0.5 * (power[1:] + power[:-1]) * np.diff(ts))])
    total = stored + weight + tendon + lost
    # What was put in is what the rod and the tendon hold beyond the rod at rest.
    put_in = float(total[0] - weight[0])
    # The tendon's own energy leaves with its actuator in the first step.
    drift = np.abs(total[1:] - (total[0] - tendon[0])).max()
    return f"energy off by at most {drift / put_in:.2%} of what was put in, {put_in:.2e} J"


def cost(*_):
    print(f"cost, on {machine()}")
    for n in (3, 9):
        ends, angles = None, THIRDS
        if n == 9:
            angles = np.concatenate([THIRDS + a for a in (0, 0.4, 0.8)])
            ends = tuple(np.repeat([0.03, 0.06, 0.1], 3))
        offsets = 4e-3 * np.stack([np.cos(angles), np.sin(angles)], 1)
        base = dataclasses.replace(
            sr.hybrid_robot(), gravity=np.array([-3.0, 0.0, 9.81]), chambers=None
        )
        given = dataclasses.replace(base, tendons=sr.Tendons(offsets, ends_at=ends))
        driven = dataclasses.replace(
            base, tendons=sr.Tendons(offsets, ends_at=ends, control="length")
        )
        t = np.arange(1, 61)[:, None] * 0.01
        courses = {
            "one side": 1.5e-3 * (1 - np.cos(3 * np.pi * t)) * np.maximum(np.cos(angles), 0) + 8e-4,
            "a circle": np.minimum(5 * t, 1) * (2e-3 * np.cos(3 * np.pi * t - angles) + 3e-3),
        }
        for name, pulls in courses.items():
            print(f"  {n} tendons, {name}: {_ratio(driven, given, pulls)}")


def _ratio(driven, given, pulls, rounds=31):
    by_length = jax.jit(lambda x: _view(sr.simulate(driven, 0.01, pulls=x, throw=False)))
    by_tension = jax.jit(lambda x: _view(sr.simulate(given, 0.01, tensions=x, throw=False)))
    tensions = by_length(pulls)[1][1:]
    jax.block_until_ready(by_tension(tensions))
    times = []
    for _ in range(rounds):
        pair = []
        for call, x in ((by_length, pulls), (by_tension, tensions)):
            start = time.perf_counter()
            jax.block_until_ready(call(x))
            pair.append(time.perf_counter() - start)
        times.append(pair)
    times = np.array(times)
    return (
        f"{times[:, 0].min() / len(pulls) * 1e3:.2f} ms a step against "
        f"{times[:, 1].min() / len(pulls) * 1e3:.2f}: {np.median(times[:, 0] / times[:, 1]):.2f} "
        f"times in the median of {rounds} pairs, {times[:, 0].min() / times[:, 1].min():.2f} times "
        "at best"
    )


def _view(motion):
    return motion.tip_positions, motion.tensions, motion.result


def main():
    parts = dict(
        inverse=inverse, equilibria=equilibria, motions=motions, release=release, cost=cost
    )
    parser = argparse.ArgumentParser()
    parser.add_argument("parts", nargs="*", choices=[*parts, []])
    parser.add_argument("--count", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    for name in options.parts or parts:
        parts[name](options.count, options.seed)


if __name__ == "__main__":
    main()
