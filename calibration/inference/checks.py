"""Does a fit hold for what it has not seen?

Recordings that were kept aside are predicted. Of them the clock is fitted, and of one that does
not know where the clamp is the frame: six more numbers, by which a prediction is kinder than it
should be. So it is made once more in the frame of the recordings that were fitted, which is right
if the cameras stood where they stood then.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from calibration.experiment.alignment import Alignment
from calibration.problem.evaluation import losses_by_delay, residuals_in
from calibration.problem.problem import Point, Problem
from calibration.search.start import in_time

_CLOCK_STEPS = 4
# Delays tried around the best one, again and again within their own spacing.
_DELAYS, _ROUNDS = 41, 3


def predicted(problem: Problem, x: np.ndarray, best: Point) -> tuple[Point, Point | None]:
    """`problem`, of recordings that were kept aside, at the parameters `x`: each in a frame that
    fits it best, and in the mean frame of those in `best`; None if they need none."""
    own_frame = _own_frame(problem, x)
    free = np.asarray(best.problem.batch.free_frame)
    if not (np.any(free) and own_frame.ok):
        return own_frame, None
    mean = lambda a: jnp.asarray(np.mean(np.asarray(a)[free], axis=0))
    return own_frame, _in_frame(own_frame, jax.tree.map(mean, best.evaluation.alignment))


def _own_frame(problem: Problem, parameters: np.ndarray) -> Point:
    x = problem.start()
    x[: problem.size] = parameters
    point = problem.at(in_time(problem.at(x))[1])
    low, high = problem.bounds
    for _ in range(_CLOCK_STEPS if problem.time_offset and point.ok else 0):
        # Gauss-Newton; each clock sees its own recording only.
        J = point.jacobian[:, problem.delays]
        step = -(J.T @ point.residuals) / np.maximum(np.sum(J**2, axis=0), 1e-30)
        x = point.x.copy()
        x[problem.delays] += np.clip(step, -1.0, 1.0)
        trial = problem.at(np.clip(x, low, high))
        if not (trial.ok and trial.loss < point.loss):
            break
        point = trial
    return point


def _in_frame(point: Point, frame: Alignment) -> Point:
    """The same motions seen in `frame`, where a recording's own is free; its clock fits best."""
    problem, motion = point.problem, point.evaluation.motion
    batch, courses = problem.batch, problem.courses(point.x)
    length = problem.scene.length
    if problem.time_offset:
        low, high = (np.array([getattr(c, k) for c in problem.clocks]) for k in ("low", "high"))
        rows, best = np.arange(len(low)), low
        for _ in range(_ROUNDS):
            delays = np.linspace(low, high, _DELAYS, axis=1)
            losses = np.asarray(losses_by_delay(motion, batch, courses, delays, length, frame))
            best = delays[rows, np.argmin(losses, axis=1)]
            reach = (high - low) / (_DELAYS - 1)
            low, high = np.maximum(best - reach, low), np.minimum(best + reach, high)
        courses = {**courses, "delay": best}
    residuals, alignment = jax.device_get(residuals_in(motion, batch, courses, length, frame))
    evaluation = eqx.tree_at(
        lambda e: (e.residuals, e.alignment), point.evaluation, (residuals, alignment)
    )
    x = point.x.copy()
    if problem.time_offset:
        x[problem.delays] = courses["delay"] / [c.interval for c in problem.clocks]
    return Point(x, evaluation, problem)


def row(tree, k: int):
    """Recording `k` of a batch of arrays."""
    return jax.tree.map(lambda x: x[k], tree)
