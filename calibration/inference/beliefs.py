"""How priors weigh against recordings, and whether recordings contradict them.

A prior is worth one independent measurement of its parameter. Samples of a recording are not
independent of each other, so that how large their noise is must be known, correlation and all,
before the two can be weighed: from the residuals of a fit, which is then repeated.
"""

from dataclasses import replace

import numpy as np

from calibration.inference.noise import estimate_noise
from calibration.parameters.priors import CONTRADICTED, contradictions
from calibration.problem.problem import Point
from calibration.search.history import History
from calibration.search.optimise import Outcome, levenberg_marquardt

# It is repeated until the weight changes by less than this part.
_ROUNDS, _UNCHANGED = 4, 0.1


def weighed(outcome: Outcome, max_iterations: int, history: History) -> Outcome:
    """The outcome with priors, and what was measured beside, that weigh as much as they should; the
    same without any."""
    problem = outcome.best.problem
    if not (problem.priors or problem.beside is not None) or not outcome.best.ok:
        return outcome
    history.stage("priors", None)
    for _ in range(_ROUNDS):
        point = outcome.best
        variance, before = independent_variance(point), point.problem.beside
        beside = None if before is None else before.weighed(point.x)
        settled = abs(variance / point.problem.variance - 1) < _UNCHANGED
        if before is not None and beside is not None:
            settled = settled and abs(beside.scale / before.scale - 1) < _UNCHANGED
        problem = replace(point.problem, prior_variance=variance, beside=beside)
        if settled:
            # Intervals are those of the noise that is left, not of the last guess of it.
            return replace(outcome, best=replace(point, problem=problem))
        done = levenberg_marquardt(
            problem, replace(point, problem=problem), max_iterations, history.add
        )
        outcome = Outcome(done.best, outcome.result, outcome.iterations + done.iterations)
    return outcome


def independent_variance(point: Point) -> float:
    """Of a coordinate of the residuals [m^2], were there only as many as are independent."""
    noise = estimate_noise(point)
    return noise.variance * noise.samples / noise.effective_samples


def contradicted(best: Point) -> dict[str, float]:
    """Priors from which the recordings alone would be more than three standard deviations away, by
    the label of the parameter: how many."""
    if not best.problem.priors:
        return {}
    data = best.jacobian.T @ best.jacobian / best.problem.variance
    others = best.beliefs[1][len(best.from_priors[0]) :]
    data = data + others.T @ others
    vague = [(2.0 / u.parameter.scale.largest) ** 2 for u in best.problem.space.parameters.items]
    data[np.diag_indices(len(vague))] += vague
    apart = contradictions(*best.from_priors, data)
    items = best.problem.space.parameters.items
    labels = [items[i].label for i, *_ in best.problem.prior_places]
    return {k: float(x) for k, x in zip(labels, apart, strict=True) if x > CONTRADICTED}
