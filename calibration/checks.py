"""Is it the material, or the simulation? And does the fit hold for what it has not seen?

Numerical damping must not pose as material damping: the fit is compared with simulations at half
the time step and on twice the grid. Recordings that were kept aside are predicted: of them only
the clock is fitted.
"""

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np

import softrod_jax as sr
from calibration.loss import Point, Problem, predict
from calibration.model import Batch, Motion
from calibration.start import in_time
from calibration.uncertainty import Uncertainty


@dataclass(frozen=True)
class Refined:
    """What finer simulations say; entries are None where they failed.

    - `by_step`, `by_grid`: change of x (unknowns,) with half the time step and twice the grid.
    - `motions`: of each recording, with half the time step.
    """

    by_step: np.ndarray | None
    by_grid: np.ndarray | None
    motions: Motion | None


def refine(best: Point, known: Uncertainty, half_step: Batch) -> Refined:
    """Simulate again, more finely. `half_step`: the batch with half the time step."""
    problem = best.problem
    finer = problem.method.finer()
    by_step, motions = _shift(best, known, half_step, problem.method)
    by_grid, _ = _shift(best, known, problem.batch, finer)
    return Refined(by_step, by_grid, motions)


def _shift(best: Point, known: Uncertainty, batch: Batch, method):
    problem = best.problem
    predicted = predict(
        problem.setup,
        batch,
        jnp.asarray(problem.unknowns.theta(best.x)),
        problem.courses(best.x),
        problem.unknowns.names,
        problem.scheme,
        method,
    )
    residuals, motions = jax.device_get(predicted)
    if np.any(motions.result != sr.RESULTS.successful):
        return None, None
    change = problem.weights * (residuals - best.evaluation.residuals)
    return known.shift(best, change.ravel()), motions


_CLOCK_STEPS = 4


def hold_out(problem: Problem, best: Point) -> Point:
    """`problem`, of recordings that were kept aside, at the parameters of `best` that all
    recordings share; their clocks are fitted."""
    x = problem.start()
    x[: problem.size] = best.x[: problem.size]
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


def row(tree, k: int):
    """Recording `k` of a batch of arrays."""
    return jax.tree.map(lambda x: x[k], tree)
