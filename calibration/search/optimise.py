"""Two ways down the same loss: Levenberg-Marquardt and gradient descent.

Both ask `Problem.at` for points and give the best one back.
"""

from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np
import optax

from calibration.problem.problem import Point, Problem
from calibration.search.progress import Report, Stage
from calibration.search.start import better, by_frequency, coarse_search, in_time, search_size

# Gradient descent: largest rate (in theta: 0.1 is 10 % of a value), the parts of the schedule
# at which it is reached and what it falls to, and when to stop.
_RATE, _WARM_UP, _LAST_RATE = 0.1, 0.05, 0.01
_STOP_WINDOW, _STOP_CHANGE = 25, 1e-4

# Levenberg-Marquardt: converged when a full step promises less than this part of the loss, a
# hundredth of a standard error or so for a few hundred samples.
_PROMISE = 1e-6
_LARGEST_DELAY_STEP = 3.0  # sample intervals
_LARGEST_DRIFT_STEP = 1.0  # standard deviations of a window
_FIRST_DAMPING, _LARGEST_DAMPING, _GROWTH = 1e-2, 1e10, 4.0
# It has stalled if so many evaluations gained less than this part of a loss that is still bad.
_PATIENCE, _LEAST_GAIN = 8, 0.1

# Up to so many parameters Levenberg-Marquardt is the faster, by the costs in
# `calibration.problem.evaluation`: it takes a tenth of the evaluations, and a parameter costs each
# of them a forward tangent.
MANY = 80


def usual(parameters: int) -> str:
    """The optimiser for so many parameters."""
    return "levenberg_marquardt" if parameters <= MANY else "adam"


@dataclass(frozen=True)
class Outcome:
    """The best point, how it ended, and after how many iterations."""

    best: Point
    result: str
    iterations: int


def minimise(
    problem: Problem,
    optimiser: str,
    max_iterations: int,
    report: Report,
    stage: Stage,
    x: np.ndarray | None = None,
) -> Outcome:
    """The best point for `optimiser`, one of `OPTIMISERS`, from `x` or the setup's own values.

    From where the recordings' frequency leads; again from the best of a coarse search if that
    ends badly. `stage` is told of each part and its largest size.
    """
    run, _ = OPTIMISERS[optimiser]
    title = optimiser.replace("_", " ")
    stage("first look", None)
    here = problem.at(problem.space.origin() if x is None else x)
    report(here)
    loss, x = in_time(here)
    if not problem.statistics.explained(loss):
        x = by_frequency(problem, here, report)
    start = problem.at(x)
    report(start)
    stage(title, max_iterations)
    first = run(problem, start, max_iterations, report)
    if first.best.ok and first.best.explains:
        return first
    stage("coarse search", search_size(problem))
    start = problem.at(coarse_search(problem, better(first.best, start), report))
    stage(title, max_iterations)
    second = run(problem, start, max_iterations, report)
    return second if better(second.best, first.best) is second.best else first


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
        update, state = adam.update(jnp.asarray(point.gradient / point.loss), state)
        x = np.clip(x + np.asarray(update), *problem.space.bounds)
        point = problem.at(x)
        if not point.ok:
            # No gradient there: go halfway back.
            x = (x + best.x) / 2
            point = problem.at(x)
            if not point.ok:
                x, point = best.x, best
        best = better(point, best)
        history.append(best.loss)
        report(point)
        if k > _STOP_WINDOW and history[-1] > (1 - _STOP_CHANGE) * history[-1 - _STOP_WINDOW]:
            return Outcome(best, "converged", k)
    return Outcome(best, f"stopped after {max_iterations} iterations", max_iterations)


def levenberg_marquardt(
    problem: Problem, start: Point, max_iterations: int, report: Report, fixed: tuple[int, ...] = ()
) -> Outcome:
    """Damped Gauss-Newton steps; an iteration is one evaluation. Unknowns `fixed` do not move."""
    low, high = problem.space.bounds
    point, damping, growth = start, _FIRST_DAMPING, _GROWTH
    losses = [start.loss]
    for k in range(1, max_iterations + 1):
        J, r = point.jacobian, point.residuals
        JJ = J.T @ J + point.known
        gradient = J.T @ r + point.pull
        # At a bound and pushed against it, an unknown stays there.
        free = ~((point.x <= low) & (gradient > 0)) & ~((point.x >= high) & (gradient < 0))
        free[list(fixed)] = False
        if not np.any(free):
            return Outcome(point, "converged", k - 1)
        diagonal = np.diag(JJ)
        # The floor keeps parameters in place that the data say nothing of.
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
            point, growth = trial, _GROWTH
        else:
            damping, growth = damping * growth, 2 * growth
            if damping > _LARGEST_DAMPING:
                return Outcome(point, "converged", k)
        losses.append(point.loss)
        little = len(losses) > _PATIENCE and losses[-1] > (1 - _LEAST_GAIN) * losses[-1 - _PATIENCE]
        if little and not point.explains:
            return Outcome(point, "converged to a place that explains little of the motion", k)
    return Outcome(point, f"stopped after {max_iterations} iterations", max_iterations)


def _stepped(problem: Problem, x, step):
    """The step, kept from overshooting, and where it leads from x."""
    step, x, space = step.copy(), x.copy(), problem.space
    for i, u in enumerate(space.parameters.items):
        step[i], moved = u.parameter.scale.limited(step[i])
        x[i] += moved
    for part, most in ((space.delays, _LARGEST_DELAY_STEP), (space.drifts, _LARGEST_DRIFT_STEP)):
        step[part] = np.clip(step[part], -most, most)
        x[part] += step[part]
    return step, x


# By name, each with its default for the largest number of iterations.
OPTIMISERS = {
    "levenberg_marquardt": (levenberg_marquardt, 60),
    "adam": (gradient_descent, 200),
}
