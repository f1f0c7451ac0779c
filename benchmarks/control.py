"""Estimation and predictive control of the paper's robot, hanging, against the full model.

    python benchmarks/control.py                 # all parts, some minutes
    python benchmarks/control.py eight --quick   # some of the parts, small
    python benchmarks/control.py consistency --sets 3

What is true is in all parts a `Stepper` with other steps and another grid than the estimator has.
Times of cycles are those of the wall and of the processor, on one core.
"""

import argparse
import dataclasses
import os
import time

import jax
import jax.numpy as jnp
import numpy as np
from consistency import told, told_together

import softrod_jax as sr
from softrod_jax.learning import Action, Stepper

NOISE, TURNED = 3e-4, np.deg2rad(0.3)
ROBOT = sr.hybrid_robot(gravity=jnp.array([0.0, 0.0, 9.81]))
LENGTH = 0.1
TRUE_GRID = sr.Collocation(10)
CYCLE, LIMIT = 0.005, 0.6


def zero(tensions=(0.0, 0.0, 0.0)):
    return Action(jnp.asarray(tensions), jnp.zeros(1))


def noisy_pose(view, rng):
    """The tip's position and quaternion as a camera sees them."""
    turn = TURNED * rng.standard_normal(3)
    angle = np.linalg.norm(turn)
    w, v = np.cos(angle / 2), np.sin(angle / 2) * turn / angle
    hw, hv = float(view.quaternions[-1, 0]), np.asarray(view.quaternions[-1, 1:])
    quaternion = np.append(w * hw - v @ hv, w * hv + hw * v + np.cross(v, hv))
    return np.asarray(view.tip_position) + NOISE * rng.standard_normal(3), quaternion


def estimated(estimator, forces, rng, modulus=1.0, moving=True):
    """One run: what was estimated beyond the truth and its covariance, after each of the steps.

    `forces` [N], (steps, 3), of 10 ms; three tendons move the robot meanwhile. The truth has a
    quarter of the estimator's steps, and another grid.
    """
    with_load = lambda force: dataclasses.replace(
        ROBOT,
        young_modulus=modulus * ROBOT.young_modulus,
        tip_load=sr.TipLoad(force=jnp.asarray(force)),
    )
    truth = Stepper(with_load(np.zeros(3)), 0.01, substeps=4, method=TRUE_GRID)
    state = truth.reset(sr.solve_static(truth.scene, *zero(), method=TRUE_GRID), zero())
    begun = sr.solve_static(ROBOT, *zero(), method=estimator.stepper.method)
    estimate = estimator.begin(begun, zero())
    found = []
    for k, force in enumerate(forces):
        phase = 2 * np.pi * (k / 100 + np.arange(3) / 3)
        action = zero(moving * min(1.0, k / 20) * 0.05 * (1 + np.cos(phase)))
        truth = dataclasses.replace(truth, scene=with_load(force))
        state = truth.step(state, action)
        position, quaternion = noisy_pose(truth.view(state), rng)
        estimate = estimator.step(estimate, action, position[None], quaternion[None])
        off = np.asarray(estimate.force) - force
        logs = [np.log(float(x)) - np.log(modulus) for x in estimate.parameters.values()]
        off = np.append(off, logs)
        covariance = np.asarray(estimate.covariance)
        found.append([off @ np.linalg.solve(covariance, off), float(estimate.surprise), *off])
    failed = int(estimate.state.progress.result) or int(state.progress.result)
    return np.array(found), failed


def force(quick):
    """A force of unknown size and direction sets in: how far is the estimate off, and when?"""
    estimator = sr.Estimator(ROBOT, 0.01, attitude_noise=TURNED, force=0.2, force_walk=0.02)
    sizes, runs, steps = ((0.1,), 1, 10) if quick else ((0.02, 0.05, 0.1, 0.2, 0.3), 10, 100)
    print("force [mN]: runs, failed; error [mN] after 0.1, 0.3 s; rms and worst of 0.5 to 1 s")
    for size in sizes:
        errors, failed = [], 0
        for run in range(runs):
            rng = np.random.default_rng(run)
            direction = rng.standard_normal(3)
            constant = np.tile(size * direction / np.linalg.norm(direction), (steps, 1))
            found, code = estimated(estimator, constant, rng)
            failed += code != 0
            errors.append(1e3 * np.linalg.norm(found[:, 2:5], axis=1))
        e = np.array(errors)
        at = [np.sqrt(np.mean(e[:, min(k, steps) - 1] ** 2)) for k in (10, 30)]
        late = e[:, steps // 2 :]
        runs_rms = np.sqrt(np.mean(late**2, 1))
        print(
            f"{1e3 * size:5.0f}: {runs}, {failed}; {at[0]:.1f}, {at[1]:.1f}; "
            f"{np.sqrt(np.mean(late**2)):.1f} (runs {runs_rms.min():.1f} to {runs_rms.max():.1f}), "
            f"{late.max():.1f}"
        )


def consistency(quick, sets=1):
    """Normalised squares of errors: of a wandering force, and of that and an unknown modulus.

    Of `sets` of 100 runs each.
    """
    runs, steps = (6, 10) if quick else (100, 100)
    for unknown in ({}, {"young_modulus": 0.2}):
        # What is known to a part of a percent shows the errors of long steps.
        given = dict(force=0.05, force_walk=0.1, parameters=unknown, substeps=2)
        estimator = sr.Estimator(ROBOT, 0.01, attitude_noise=TURNED, **given)
        all_found = []
        for first in range(0, sets * runs, runs):
            seeds = range(first, first + runs)
            found, failed = wandering(estimator, seeds, steps)
            name = f"force{' and modulus' if unknown else ''}, seeds {first} to {seeds[-1]}"
            told(f"{name}, {failed} failed", found)
            all_found.append(found)
        if sets > 1:
            told_together(np.concatenate(all_found), runs)


def wandering(estimator, seeds, steps):
    """Runs under a force that wanders as the estimator assumes, and how many of them failed."""
    every, failed = [], 0
    for seed in seeds:
        rng = np.random.default_rng(seed)
        modulus = np.exp(0.2 * rng.standard_normal()) if estimator.parameters else 1.0
        walk = np.cumsum(0.1 * 0.1 * rng.standard_normal((steps, 3)), 0)
        forces = 0.05 * rng.standard_normal(3) + walk
        found, code = estimated(estimator, forces, rng, modulus=modulus)
        failed += code != 0
        every.append(found)
    return np.array(every), failed


def eight(t, width=0.02):
    """A figure of eight at 0.5 Hz, (.., 2) [m]: twice `width` wide, and half of that high."""
    w = np.pi * np.asarray(t)
    return np.stack([width * np.sin(w), 0.5 * width * np.sin(2 * w)], -1)


def models(about):
    """Models about equilibria under these tensions; a little damping of stretch bounds states."""
    damped = dataclasses.replace(ROBOT, damping_time=0.002)
    how = dict(inputs=("tensions",), outputs=("tip",), method=sr.Collocation(6, order=6))
    return [sr.linearise(damped, u, (0.0,), **how).reduced(16) for u in about]


AROUND = ((0.05, 0.05, 0.05), (0.25, 0.05, 0.05), (0.05, 0.25, 0.05), (0.05, 0.05, 0.25))


def predictive(about=AROUND):
    """A controller that looks ahead; `begin` as of `followed`."""
    controller = sr.Predictive(
        models(about), CYCLE, {"tensions": (0.0, LIMIT)}, outputs=("tip_x_m", "tip_y_m")
    )
    ahead = np.asarray(controller.times)

    def begin(width):
        memory = [controller.begin(np.zeros(3), np.zeros(2))]

        def decide(k, measured):
            u, memory[0] = controller.step(memory[0], measured, eight(k * CYCLE + ahead, width))
            return np.asarray(u)

        return decide

    return begin


def proportional_integral(kp, ki, ahead):
    """PI by the static gain at rest, without a tension more than needed; `ahead`: feedforward."""
    gain = np.asarray(sr.actuation_jacobian(ROBOT, (0.0, 0.0, 0.0), (0.0,)))[:2, :3]
    back = np.linalg.pinv(gain)

    def begin(width):
        total = np.zeros(2)

        def decide(k, measured):
            nonlocal total
            error = eight(k * CYCLE, width) - measured
            asked = kp * error + ki * (total + CYCLE * error)
            asked = asked + (eight((k + 2) * CYCLE, width) if ahead else 0.0)
            u = back @ asked
            u = u - u.min()
            if u.max() < LIMIT:
                total = total + CYCLE * error
            return np.clip(u, 0.0, LIMIT)

        return decide

    return begin


def followed(begin, modulus, width, seconds=6.0, seed=0):
    """The full rod along the eight, with noise, and a cycle from a measurement to its use.

    `begin(width)` gives a new `decide(k, measured)`, which gives tensions.

    Returns errors after the first period [m], and the times that decisions took, of the wall and
    of the processor [s].
    """
    scene = dataclasses.replace(ROBOT, young_modulus=modulus * ROBOT.young_modulus)
    rod, rng = Stepper(scene, CYCLE), np.random.default_rng(seed)
    state = rod.reset(sr.solve_static(scene, *zero(), method=rod.method), zero())
    decide, late, errors, times = begin(width), np.zeros(3), [], []
    for k in range(round(seconds / CYCLE)):
        tip = np.asarray(rod.view(state).tip_position)[:2]
        errors.append(tip - eight(k * CYCLE, width))
        measured = tip + NOISE * rng.standard_normal(2)
        clocks = time.perf_counter(), time.process_time()
        decided = decide(k, measured)
        times.append((time.perf_counter() - clocks[0], time.process_time() - clocks[1]))
        state, late = rod.step(state, zero(late)), decided
    if int(state.progress.result):
        raise RuntimeError(f"the rod failed: {sr.result_message(state.progress.result)}")
    first = min(round(2.0 / CYCLE), len(errors) // 2)
    return np.linalg.norm(errors[first:], axis=1), np.array(times[5:])


def percent(errors):
    rms, worst = np.sqrt(np.mean(errors**2)), errors.max()
    return f"{100 * rms / LENGTH:.2f} % rms, {100 * worst / LENGTH:.2f} % at most"


def quantiles(name, times):
    """Of times [ms], for the eye."""
    half, most = np.quantile(times, [0.5, 0.99])
    return f"{name} {half:.2f} ms, 99 % {most:.2f} ms, worst {times.max():.2f} ms"


def on_the_eight(quick):
    """Seconds, moduli in terms of the true one, and widths."""
    return (0.2, (0.8,), (0.02,)) if quick else (4.0, (0.8, 1.0, 1.2), (0.02, 0.04))


def figure_of_eight(quick):
    """Predictive control at 200 Hz with a modulus that is 20 % off."""
    seconds, moduli, widths = on_the_eight(quick)
    seeds = 1 if quick else 3
    for about, what in ((AROUND[:1], "one model"), (AROUND, "four models")):
        begin, times = predictive(about[:1] if quick else about), []
        for width in widths:
            for modulus in moduli:
                runs = [followed(begin, modulus, width, seconds, seed) for seed in range(seeds)]
                times += [own for _, own in runs]
                each = "; ".join(percent(errors) for errors, _ in runs)
                print(f"{what}, {2e3 * width:.0f} mm wide, modulus x {modulus}: {each}", flush=True)
        wall, own = 1e3 * np.concatenate(times).T
        shown = quantiles("wall", wall) + "; " + quantiles("processor", own)
        print(f"{what}: {wall.size} cycles: {shown}; load {os.getloadavg()[0]:.1f}")


def pi_loop(quick):
    """The same by PI, with the gains of many that are best for the worse of two moduli."""
    seconds, moduli, widths = on_the_eight(quick)
    gains = [(p, i) for p in (0.5, 1.0, 2.0, 4.0) for i in (1.0, 4.0, 8.0, 16.0)]
    for ahead in (False, True):
        found = []
        for pair in gains[:1] if quick else gains:
            begin = proportional_integral(*pair, ahead)
            try:
                errors = [followed(begin, x, widths[0], seconds)[0] for x in moduli[::2]]
            except RuntimeError:
                continue
            found.append((max(np.sqrt(np.mean(e**2)) for e in errors), pair))
        pair = min(found)[1]
        begin = proportional_integral(*pair, ahead)
        for width in widths:
            for modulus in moduli:
                errors = followed(begin, modulus, width, seconds)[0]
                print(
                    f"PI{' with feedforward' if ahead else ''} {pair}, {2e3 * width:.0f} mm wide, "
                    f"modulus x {modulus}: {percent(errors)}"
                )


def minimum(quick):
    """The quadratic problem of a cycle: the package's own search, and that of qpax."""
    from softrod_jax.analysis.least_effort import bounded_minimum

    rng, m = np.random.default_rng(0), 18
    problems = []
    for _ in range(3 if quick else 200):
        J = rng.standard_normal((30, m)) / 6
        H = jnp.asarray(J.T @ J + 1e-3 * np.eye(m))
        problems.append((H, jnp.asarray(0.1 * rng.standard_normal(m))))
    low, high = -0.3 * jnp.ones(m), 0.7 * jnp.ones(m)
    ways = {"active sets": jax.jit(lambda H, g: bounded_minimum(H, g, low, high))}
    try:
        import qpax
    except ModuleNotFoundError:
        print("qpax is not installed: pip install qpax")
    else:
        G, h = jnp.concatenate([np.eye(m), -np.eye(m)]), jnp.concatenate([high, -low])
        A, b = jnp.zeros((0, m)), jnp.zeros(0)
        ways["qpax"] = jax.jit(lambda H, g: qpax.solve_qp(H, g, A, b, G, h)[0])
    found = {}
    for name, way in ways.items():
        jax.block_until_ready(way(*problems[0]))
        times, found[name] = [], []
        for problem in problems:
            begun = time.process_time()
            found[name].append(np.asarray(way(*problem)))
            times.append(1e3 * (time.process_time() - begun))
        print(f"{name}: median {np.median(times):.3f} ms, 99 % {np.quantile(times, 0.99):.3f} ms")
    if len(found) == 2:
        print("differ by", np.abs(np.subtract(*found.values())).max())


PARTS = dict(
    force=force, consistency=consistency, eight=figure_of_eight, pi=pi_loop, minimum=minimum
)


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("parts", nargs="*", choices=[*PARTS, []], default=[])
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--sets", type=int, default=1, help="of 100 runs, of consistency")
    asked = parser.parse_args()
    for name in asked.parts or PARTS:
        print(f"{name}:", flush=True)
        more = {"sets": asked.sets} if name == "consistency" else {}
        PARTS[name](asked.quick, **more)


if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})
    main()
