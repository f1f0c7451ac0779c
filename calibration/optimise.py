"""Three ways down the same loss: a coarse search, gradient descent, Levenberg-Marquardt.

All of them ask `Problem.at` for points and give the best one back, whatever happens on the way,
Ctrl-C included.
"""

from collections.abc import Callable
from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np
import optax

from calibration.loss import Point, Problem, losses_by_delay

# Factors of the coarse search. The tip of a rod that rings for n periods is in phase only within
# 1/n of the right modulus: a ratio of 1.4 does for three periods, beyond which damping helps.
_SEARCH = (
    ("young_modulus", 2.0 ** np.array([-2, -1.5, -1, -0.5, 0.5, 1, 1.5, 2])),
    ("bending_damping", 10.0 ** np.array([-2, -1.5, -1, -0.5, 0.5, 1])),
    ("young_modulus", 2.0 ** np.array([-0.5, -0.25, 0.25, 0.5])),
)
_SEARCH_DELAYS = 41

# Gradient descent: largest rate (in theta: 0.1 is 10 % of a value), the parts of the schedule
# at which it is reached and what it falls to, and when to stop.
_RATE, _WARM_UP, _LAST_RATE = 0.1, 0.05, 0.01
_STOP_WINDOW, _STOP_CHANGE = 25, 1e-4

# Levenberg-Marquardt: converged when a full step promises less than this part of the loss, a
# hundredth of a standard error or so for a few hundred samples.
_PROMISE = 1e-6
_LARGEST_FALL = -0.8  # of a value, relative
_LARGEST_DELAY_STEP = 3.0  # sample intervals
_LARGEST_DAMPING = 1e10


@dataclass(frozen=True)
class Outcome:
    """The best point, how it ended, and after how many iterations."""

    best: Point
    result: str
    iterations: int


# A first result that leaves less than this part of the tip's motion (rms) is taken for the
# right one; else the coarse search looks for a better place to start.
_UNEXPLAINED = 0.15

Report = Callable[[Point], None]
Stage = Callable[[str, int], None]


def minimise(
    problem: Problem, optimiser: str, max_iterations: int, report: Report, stage: Stage
) -> Outcome:
    """The best point for `optimiser`, one of `OPTIMISERS`.

    Levenberg-Marquardt starts where the scene is, which often does, and again from the
    best of a coarse search if it ends badly. Gradient descent, with its hundreds of iterations,
    always begins with the search. `stage` is told of each part and its largest size.
    """
    run, _ = OPTIMISERS[optimiser]
    title = optimiser.replace("_", " ")
    x = problem.start()
    first = None
    if optimiser == "levenberg_marquardt":
        stage(title, max_iterations)
        _, x = _shifted(problem.at(x))
        first = run(problem, problem.at(x), max_iterations, report)
        if first.best.ok and first.best.rms < _UNEXPLAINED * problem.motion_rms:
            return first
    stage("coarse search", search_size(problem))
    start = coarse_search(problem, problem.start(), report)
    stage(title, max_iterations)
    second = run(problem, start, max_iterations, report)
    if first is None or not first.best.ok or second.best.loss < first.best.loss:
        return second
    return first


def search_size(problem: Problem) -> int:
    """How many points `coarse_search` evaluates."""
    return 2 + sum(len(factors) for name, factors in _SEARCH if name in problem.names)


def coarse_search(problem: Problem, x: np.ndarray, report: Report) -> Point:
    """Try factors of the modulus and the damping at `x`, one after the other, with all delays.

    A sum of squares of a ringing tip has a minimum wherever a whole number of periods is gained
    or lost; this finds the right one of them.
    """
    first = problem.at(x)
    report(first)
    best_loss, best_x = _shifted(first)
    for name, factors in _SEARCH:
        if name not in problem.names:
            continue
        centre = best_x
        for theta in np.log(factors):
            x = centre.copy()
            x[problem.names.index(name)] += theta
            point = problem.at(x)
            report(point)
            loss, x = _shifted(point)
            if loss < best_loss:
                best_loss, best_x = loss, x
    best = problem.at(best_x)
    report(best)
    return best


def gradient_descent(
    problem: Problem, start: Point, max_iterations: int, report: Report
) -> Outcome:
    """Adam on the logarithm of the loss, with warm-up and cosine decay of the rate.

    The logarithm keeps the gradient's size, to which Adam is used, while the loss falls by
    orders of magnitude.
    """
    schedule = optax.warmup_cosine_decay_schedule(
        init_value=0.2 * _RATE,
        peak_value=_RATE,
        warmup_steps=max(1, round(_WARM_UP * max_iterations)),
        decay_steps=max(2, max_iterations),
        end_value=_LAST_RATE * _RATE,
    )
    adam = optax.adam(schedule, b1=0.8, b2=0.95)
    x, state = start.x, adam.init(jnp.asarray(start.x))
    point, best, history = start, start, [start.loss]
    for k in range(1, max_iterations + 1):
        gradient = 2 * point.jacobian.T @ point.residuals / point.loss
        update, state = adam.update(jnp.asarray(gradient), state)
        x = np.clip(x + np.asarray(update), *problem.bounds)
        point = problem.at(x)
        if not point.ok:
            # No gradient there: go halfway back.
            x = (x + best.x) / 2
            point = problem.at(x)
            if not point.ok:
                x, point = best.x, best
        best = _better(point, best)
        history.append(best.loss)
        report(point)
        if k > _STOP_WINDOW and history[-1] > (1 - _STOP_CHANGE) * history[-1 - _STOP_WINDOW]:
            return Outcome(best, "converged", k)
    return Outcome(best, f"stopped after {max_iterations} iterations", max_iterations)


def levenberg_marquardt(
    problem: Problem, start: Point, max_iterations: int, report: Report
) -> Outcome:
    """Damped Gauss-Newton steps; an iteration is one evaluation."""
    low, high = problem.bounds
    point, damping, growth = start, 1e-3, 2.0
    for k in range(1, max_iterations + 1):
        J, r = point.jacobian, point.residuals
        JJ, gradient = J.T @ J, J.T @ r
        # At a bound and pushed against it: held there.
        free = ~((point.x <= low) & (gradient > 0)) & ~((point.x >= high) & (gradient < 0))
        diagonal = np.diag(JJ)
        # The floor holds parameters that the data say nothing of.
        scale = np.maximum(diagonal, 1e-9 * np.max(diagonal, initial=1e-300))
        A = JJ + damping * np.diag(scale)
        step = np.zeros_like(gradient)
        step[free] = -np.linalg.solve(A[np.ix_(free, free)], gradient[free])
        promise = -(2 * gradient @ step + step @ JJ @ step)
        if promise <= _PROMISE * point.loss and damping <= 1:
            return Outcome(point, "converged", k - 1)
        step, x = _stepped(problem, point.x, step)
        promise = -(2 * gradient @ step + step @ JJ @ step)
        trial = problem.at(x)
        report(trial)
        gain = (point.loss - trial.loss) / promise if trial.ok and promise > 0 else -1.0
        if gain > 0:
            # Nielsen (1999): the damping follows how well the linear model did.
            damping = max(damping * max(1 / 3, 1 - (2 * gain - 1) ** 3), 1e-12)
            point, growth = trial, 2.0
        else:
            damping, growth = damping * growth, 2 * growth
            if damping > _LARGEST_DAMPING:
                return Outcome(point, "converged", k)
    return Outcome(point, f"stopped after {max_iterations} iterations", max_iterations)


def _stepped(problem: Problem, x, step):
    """The step, kept from overshooting, and where it leads from x.

    A parameter's step is a relative change of its value: what a damping or a drag does is
    linear in it, so that one that is far too small gets where it should be at once, and not by a
    limited number of doublings.
    """
    n = len(problem.names)
    step = step.copy()
    step[:n] = np.maximum(step[:n], _LARGEST_FALL)
    step[n:] = np.clip(step[n:], -_LARGEST_DELAY_STEP, _LARGEST_DELAY_STEP)
    return step, x + np.append(np.log1p(step[:n]), step[n:])


def _better(a: Point, b: Point) -> Point:
    return a if a.ok and (a.loss < b.loss or not b.ok) else b


def _shifted(point: Point) -> tuple[float, np.ndarray]:
    """Loss and x of the same motion with each recording's clock where it fits best.

    Needs no simulation: the motion is only shifted in time.
    """
    problem, x = point.problem, point.x.copy()
    if not point.ok:
        return np.inf, x
    if not problem.time_offset:
        return point.loss, x
    low, high = (np.array([getattr(c, k) for c in problem.clocks]) for k in ("low", "high"))
    delays = np.linspace(low, high, _SEARCH_DELAYS, axis=1)
    losses = np.asarray(
        losses_by_delay(point.evaluation.motion, problem.batch, delays, problem.scene.length)
    )
    best = np.argmin(losses, axis=1)
    rows = np.arange(len(best))
    x[len(problem.names) :] = delays[rows, best] / [c.interval for c in problem.clocks]
    return float(np.sum(losses[rows, best])), x


# By name, each with its default for the largest number of iterations.
OPTIMISERS = {
    "levenberg_marquardt": (levenberg_marquardt, 60),
    "adam": (gradient_descent, 200),
}
