"""Errors of the tip against refined solutions: methods along the rod, and time steps.

    python benchmarks/accuracy.py [--write-docs]

The robot of `softrod_jax.hybrid_robot`, 0.1 m long. An error is the largest distance of the tip
[m] from the refined solution. Some minutes on two cores, most of it compiling.
"""

import time

import jax
import jax.numpy as jnp
import numpy as np
from report import machine, publish, table
from work_scenes import scheme_name

import softrod_jax as sr

GRAVITY = jnp.array([-9.81, 0.0, 0.0])

METHODS = [
    sr.Collocation(10, order=4),
    sr.Collocation(20, order=4),
    sr.Collocation(),
    sr.Collocation(10, order=6),
    sr.Shooting(segments=1, steps=20),
    sr.Shooting(segments=10, steps=4),
]
FINE_METHOD = sr.Collocation(20, order=6)
MOTION = 0.2  # s, in the comparison of methods
MOTION_STEPS = (50, 5, 1)  # ms

SCHEMES = [  # and their time steps [ms]
    (sr.BDFAlpha(-0.2), (10, 5, 2, 1)),
    (sr.BDFAlpha(-0.45), (10, 5, 2, 1)),
    (sr.SDIRK(2), (20, 10, 5)),
    (sr.SDIRK(3), (20, 10, 5)),
    (sr.SDIRK(3, stages=6), (25, 20, 10)),
    (sr.SDIRK(4), (20, 10, 5)),
]
FINE_SCHEME, FINE_STEP = sr.SDIRK(4), 1
TENDON_SCHEMES = [(sr.BDFAlpha(-0.45), (10, 5, 2, 1)), (sr.SDIRK(3), (20, 10, 5))]
# SDIRK holds tensions within a step, which is an error of first order.
FINE_TENDON_SCHEME, FINE_TENDON_STEP = sr.BDFAlpha(-0.45), 0.25


def methods() -> str:
    """Errors of each method: an equilibrium, and motions at the same time step."""

    def tips(method):
        yield _tip_at_rest(method)
        for step in MOTION_STEPS:
            yield _motion(_gravity, step, MOTION, min(MOTION_STEPS), method=method)[0]

    fine = list(tips(FINE_METHOD))
    rows = [
        [f"`{_name(method)}`", *(_error(a, b) for a, b in zip(tips(method), fine, strict=True))]
        for method in METHODS
    ]
    header = ["method", "equilibrium", *(f"motion, dt = {step} ms" for step in MOTION_STEPS)]
    return table(header, rows)


def time_steps() -> str:
    """Errors of each scheme under gravity that acts from t = 0, and of one under tendons."""
    fine, _ = _motion(_gravity, FINE_STEP, 1.0, FINE_STEP, scheme=FINE_SCHEME)
    rows = []
    for scheme, steps in SCHEMES:
        for step in steps:
            tip, seconds = _motion(_gravity, step, 1.0, min(steps), scheme=scheme)
            error = _error(tip, fine[:: step // FINE_STEP])
            rows.append([f"`{_name(scheme)}`", f"{step}", error, f"{seconds:.2g}"])
    return table(["scheme", "dt [ms]", "error [m]", "time [s]"], rows)


def tendons() -> str:
    """Errors under a tension that rises smoothly, and under one that jumps."""
    loads = (_ramp, _step)
    fine = [
        _motion(load, FINE_TENDON_STEP, 1.0, FINE_TENDON_STEP, scheme=FINE_TENDON_SCHEME)[0]
        for load in loads
    ]
    rows = []
    for scheme, steps in TENDON_SCHEMES:
        for step in steps:
            errors = []
            for load, answer in zip(loads, fine, strict=True):
                tip, _ = _motion(load, step, 1.0, min(steps), scheme=scheme)
                errors.append(_error(tip, answer[:: round(step / FINE_TENDON_STEP)]))
            rows.append([f"`{_name(scheme)}`", f"{step}", *errors])
    return table(["scheme", "dt [ms]", "ramp, 0.3 N in 50 ms", "jump to 0.1 N"], rows)


def _gravity(t):
    """Gravity alone, switched on at t = 0: the scene, and tensions at the ends of steps."""
    return sr.hybrid_robot(gravity=GRAVITY), None


def _step(t):
    return sr.hybrid_robot(), _first_tendon(np.full_like(t, 0.1))


def _ramp(t):
    x = np.minimum(t / 0.05, 1.0)
    return sr.hybrid_robot(), _first_tendon(0.3 * x**3 * (10 - 15 * x + 6 * x**2))


def _first_tendon(tension):
    return jnp.zeros((len(tension), 3)).at[:, 0].set(tension)


def _tip_at_rest(method):
    scene = sr.hybrid_robot(gravity=GRAVITY)
    solution = sr.solve_static(scene, method=method, throw=False)
    return solution.tip_position if int(solution.result) == 0 else None


def _motion(load, step, duration, smallest, **options):
    """Tip positions over `duration` [s] at `step` [ms], and the time that took [s].

    Every step size takes as many steps, those of the smallest one, so that the program is
    compiled once; what lies beyond `duration` is cut off. None where the motion fails.
    """
    dt = step * 1e-3
    wanted, steps = round(duration / dt), round(1e3 * duration / smallest)
    scene, tensions = load(dt * np.arange(1, steps + 1))
    tensionless = steps if tensions is None else None
    as_given = dict(substeps=1, max_time_error=np.inf)

    def run():
        return jax.block_until_ready(
            sr.simulate(scene, dt, tensions, steps=tensionless, throw=False, **as_given, **options)
        )

    warm = (tensions is None, steps, *options.values())
    if warm not in _warm:
        run()
        _warm.add(warm)
    begin = time.perf_counter()
    trajectory = run()
    seconds = time.perf_counter() - begin
    failed = 0 <= int(trajectory.failed_step) < wanted
    tip = None if failed else trajectory.tip_positions[: wanted + 1]
    return tip, seconds * wanted / steps


_warm = set()


def _error(tip, answer) -> str:
    if tip is None:
        return "fails"
    largest = float(jnp.max(jnp.linalg.norm(tip - answer, axis=-1)))
    return f"{largest:.1e}".replace("e-0", "e-")


def _name(x) -> str:
    match x:
        case sr.BDFAlpha() | sr.SDIRK():
            return scheme_name(x)
        case sr.Collocation():
            return f"Collocation({x.intervals}, order={x.order})"
        case sr.Shooting():
            return f"Shooting({x.segments}, {x.steps})"


if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    publish("accuracy: methods", "settings.md", methods())
    publish("accuracy: time steps", "settings.md", f"{time_steps()}\n\n{machine()}.")
    publish("accuracy: tendons", "settings.md", tendons())
