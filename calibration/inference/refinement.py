"""Does the result of a fit hold for finer simulations? It is fitted again with these until it does.

Where a search ended, the recordings are simulated with half the steps and on twice the grid. What
counts there is not the error of the tip but whether it would lead to other values.
"""

import logging
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from calibration.inference.beliefs import weighed
from calibration.inference.uncertainty import IDENTIFIED, Uncertainty, estimate_uncertainty
from calibration.problem.motion import Motion
from calibration.problem.problem import Point
from calibration.problem.resolution import MOST_INTERVALS, Resolution, told
from calibration.search.history import History
from calibration.search.minimum import minimise_from
from calibration.search.optimise import Outcome

_LOG = logging.getLogger(__name__)

# A finer simulation is called for if it would move a value by this part of the half width of its
# interval, and by more than this in theta, or leaves less than this part of the residuals; if it
# leaves more than that part, the log was itself simulated no finer than that.
_PART_OF_INTERVAL, _LEAST_SHIFT, _CLEARLY_BETTER, _CLEARLY_WORSE = 0.25, 3e-4, 0.9, 1.5
_REFITS = 3


@dataclass(frozen=True)
class Refinement:
    """What finer simulations say of a fit; None where they failed or were not asked for.

    - `by_step`, `by_grid`: change of x (unknowns,) with half the time step and twice the grid.
    - `motions`: of each recording, with half the time step.
    - `needed`: whether to fit again, with a step divided by `steps` and with `intervals`.
    - `note`: what is to be said of it, or "".
    """

    by_step: Float[np.ndarray, "unknowns"] | None = None
    by_grid: Float[np.ndarray, "unknowns"] | None = None
    motions: Motion | None = None
    steps: int = 1
    intervals: int = 0
    note: str = ""
    needed: bool = False


@dataclass(frozen=True, eq=False)
class Resolved:
    """How a search ended, its intervals, and what finer simulations say of it."""

    outcome: Outcome
    uncertainty: Uncertainty
    refinement: Refinement

    @property
    def best(self) -> Point:
        return self.outcome.best


def refine_until_resolved(
    outcome: Outcome, resolution: Resolution, checks: bool, max_iterations: int, history: History
) -> Resolved:
    """Fit again with finer simulations as long as they say something else, a few times at most.

    Without `checks` only the intervals are computed.
    """
    for attempt in range(_REFITS + 1):
        outcome = weighed(outcome, max_iterations, history)
        history.stage("intervals", None)
        uncertainty = estimate_uncertainty(outcome.best, history.add)
        if not checks:
            return Resolved(outcome, uncertainty, Refinement())
        history.stage("checks", None)
        refinement = refine(outcome.best, uncertainty, resolution)
        resolved = Resolved(outcome, uncertainty, refinement)
        if not refinement.needed or attempt == _REFITS or outcome.result == "interrupted":
            return resolved
        finer = resolution.refined(outcome.best.problem, refinement.steps, refinement.intervals)
        _LOG.info("a finer simulation would lead to other values; again with %s", told(finer))
        again = minimise_from(outcome.best, finer, max_iterations, history)
        if not again.best.ok:
            return resolved
        result = again.result if outcome.result == "converged" else outcome.result
        outcome = Outcome(again.best, result, outcome.iterations + again.iterations)
    return resolved


def refine(best: Point, uncertainty: Uncertainty, resolution: Resolution) -> Refinement:
    """Simulate the result of a fit again, more finely."""
    problem = best.problem
    finer = resolution.simulate_finer(problem, best.x)
    steps, intervals, notes = 1, problem.method.intervals, []
    by_step = by_grid = None
    if finer.same is not None:
        change = finer.same - best.evaluation.residuals
        by_grid, verdict = _judged(best, uncertainty, change)
        if verdict == _FINER and resolution.method is None and 2 * intervals <= MOST_INTERVALS:
            intervals *= 2
        elif verdict == _SIMULATED:
            notes.append("twice the grid along the rod")
        if finer.half is not None:
            by_step, verdict = _judged(best, uncertainty, finer.half - finer.same)
            if verdict == _FINER and resolution.dt is None:
                steps = 2
            elif verdict == _SIMULATED:
                notes.append("half the time step")
    note = ""
    if notes:
        note = (
            f"With {' or '.join(notes)} the simulation would be further from the recordings than "
            "it is now, which is not so of a real robot: they look as if they had been simulated "
            "like this, and no finer. The values are those of that simulation."
        )
    needed = steps > 1 or intervals > problem.method.intervals
    return Refinement(by_step, by_grid, finer.motions, steps, intervals, note, needed)


_FINER, _SIMULATED, _FINE = "finer", "simulated", "fine"


def _judged(
    best: Point, uncertainty: Uncertainty, change: Float[np.ndarray, "recordings samples all"]
) -> tuple[Float[np.ndarray, "unknowns"], str]:
    """How x moves if residuals change by `change` [m], and what follows from that."""
    problem = best.problem
    change = (problem.statistics.weights * change).ravel()
    shift = uncertainty.shift(best, change)
    n = problem.space.parameter_count
    now = np.linalg.norm(best.residuals)
    then = np.linalg.norm(best.residuals + change + best.jacobian @ shift)
    floor = 1e-4 * float(problem.scene.length) * np.sqrt(problem.statistics.samples)
    half = uncertainty.quantile[:n] * uncertainty.standard_errors[:n]
    moved = np.abs(shift[:n])
    identified = np.array([v == IDENTIFIED for v in uncertainty.verdicts])
    matters = np.any(identified & (moved > _PART_OF_INTERVAL * half) & (moved > _LEAST_SHIFT))
    if matters and then > _CLEARLY_WORSE * now:
        return shift, _SIMULATED
    if matters or (now > floor and then < _CLEARLY_BETTER * now):
        return shift, _FINER
    return shift, _FINE
