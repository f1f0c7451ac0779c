"""Does a fit hold for what it has not seen?

Recordings that were kept aside are predicted. Of them the clock is fitted, and of one that does
not know where the clamp is the frame: six more numbers, by which a prediction is kinder than it
should be. So it is made once more in the frame of the recordings that were fitted, which is right
if the cameras stood where they stood then.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from calibration.data.recording import Recording
from calibration.experiment.alignment import Alignment
from calibration.experiment.hand import HAND, held_by_hands
from calibration.parameters.unknowns import conditioned
from calibration.problem.batch import make_batch
from calibration.problem.dataset import Dataset
from calibration.problem.problem import Point, Problem
from calibration.problem.residuals import losses_by_delay, residuals_in
from calibration.search.start import in_time

_CLOCK_STEPS = 4
# Delays tried around the best one, again and again within their own spacing.
_DELAYS, _ROUNDS = 41, 3


@dataclass(frozen=True, eq=False)
class Prediction:
    """Recordings that were kept aside, as many as a fit has, at the fitted parameters.

    - `data`: the recordings; the last is repeated where there are fewer than in the fit.
    - `count`: how many of them are meant, the first.
    - `own_frame`: each in the frame that fits it best; `fitted_frame`: in the mean frame of those
      that were fitted, None if they need none.
    """

    data: Dataset
    count: int
    own_frame: Point
    fitted_frame: Point | None


def predictions(best: Point, unseen: Dataset, dt: float | None) -> Iterator[Prediction]:
    """The recordings that were kept aside, through the program of the fit: as many at a time.

    `dt` [s]: the time step; None: the smallest of the fit.
    """
    problem, space = best.problem, best.problem.space
    many = len(space.clocks)
    step = dt or min(c.dt for c in space.clocks)
    for first in range(0, len(unseen), many):
        last = min(first + many, len(unseen))
        data = unseen.take([min(k, last - 1) for k in range(first, first + many)])
        data = replace(data, recordings=_held(best, data.recordings))
        batch, clocks = make_batch(problem.scene, data, space.time_offset, step, like=problem.batch)
        parameters, x = space.parameters.shared(best.x, many)
        its_space = replace(space, parameters=parameters, clocks=clocks)
        own_frame = _own_frame(replace(problem, batch=batch, space=its_space, beside=None), x)
        yield Prediction(data, last - first, own_frame, _fitted_frame(own_frame, best))


def _fitted_frame(own_frame: Point, best: Point) -> Point | None:
    """The same motions in the mean frame of the fitted recordings, if these have free ones."""
    free = np.asarray(best.problem.batch.free_frame)
    if not (np.any(free) and own_frame.ok):
        return None
    mean = lambda a: jnp.asarray(np.mean(np.asarray(a)[free], axis=0))
    return _in_frame(own_frame, jax.tree.map(mean, best.evaluation.alignment))


def _held(best: Point, recordings) -> tuple[Recording, ...]:
    """The recordings, a hand's loads in them such that the fitted rod is where it was held."""
    own = [replace(r, conditions=_without_hand(r.conditions)) for r in recordings]
    setup = best.problem.fitted_setup(best.x)
    names = best.problem.space.parameters.names
    return tuple(held_by_hands(lambda r: conditioned(setup, r.conditions), own, names))


def _without_hand(conditions):
    return {name: value for name, value in conditions.items() if name not in HAND}


def _own_frame(problem: Problem, parameters: np.ndarray) -> Point:
    """The point at `parameters`, with each clock and frame where it fits best."""
    space = problem.space
    x = space.origin()
    x[: space.parameter_count] = parameters
    point = problem.at(in_time(problem.at(x))[1])
    low, high = space.bounds
    for _ in range(_CLOCK_STEPS if space.time_offset and point.ok else 0):
        # Gauss-Newton; each clock sees its own recording only.
        J = point.jacobian[:, space.delays]
        step = -(J.T @ point.residuals) / np.maximum(np.sum(J**2, axis=0), 1e-30)
        x = point.x.copy()
        x[space.delays] += np.clip(step, -1.0, 1.0)
        trial = problem.at(np.clip(x, low, high))
        if not (trial.ok and trial.loss < point.loss):
            break
        point = trial
    return point


def _in_frame(point: Point, frame: Alignment) -> Point:
    """The same motions seen in `frame`, where a recording's own is free; its clock fits best."""
    problem, motion = point.problem, point.evaluation.motion
    space, batch, length = problem.space, problem.batch, problem.scene.length
    nuisance = space.nuisance(point.x)
    if space.time_offset:
        low, high = (np.array([getattr(c, k) for c in space.clocks]) for k in ("low", "high"))
        rows, best = np.arange(len(low)), low
        for _ in range(_ROUNDS):
            delays = np.linspace(low, high, _DELAYS, axis=1)
            losses = np.asarray(losses_by_delay(motion, batch, nuisance, delays, length, frame))
            best = delays[rows, np.argmin(losses, axis=1)]
            reach = (high - low) / (_DELAYS - 1)
            low, high = np.maximum(best - reach, low), np.minimum(best + reach, high)
        nuisance = {**nuisance, "delay": best}
    residuals, alignment = jax.device_get(residuals_in(motion, batch, nuisance, length, frame))
    evaluation = eqx.tree_at(
        lambda e: (e.residuals, e.alignment), point.evaluation, (residuals, alignment)
    )
    x = point.x.copy()
    if space.time_offset:
        x[space.delays] = nuisance["delay"] / [c.interval for c in space.clocks]
    return Point(x, evaluation, problem)
