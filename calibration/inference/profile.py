"""Profile likelihoods: how much worse a fit becomes where one parameter is somewhere else."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calibration.inference.uncertainty import Uncertainty
from calibration.problem.problem import Point
from calibration.search.history import History
from calibration.search.optimise import levenberg_marquardt
from calibration.search.progress import Report

_POINTS, _ITERATIONS = 5, 8  # on each side; of the fit at each of them


@dataclass(frozen=True)
class Profile:
    """The best fit at fixed values of one parameter.

    - `values`: of the parameter, growing; `excess`: by how much the sum of squares is larger than
      the least, in units in which 1 is the edge of the 95 % interval; inf where nothing could be
      simulated.
    """

    values: np.ndarray
    excess: np.ndarray


def profile_likelihoods(
    best: Point, uncertainty: Uncertainty, indices: Sequence[int], history: History
) -> dict[str, Profile]:
    """The profiles of the unknowns at `indices`, by label."""
    if indices:
        history.stage("profiles", None)
    items = best.problem.space.parameters.items
    return {items[i].label: profile(best, uncertainty, i, history.add) for i in indices}


def profile(best: Point, uncertainty: Uncertainty, i: int, report: Report) -> Profile:
    """The profile of unknown `i`: everything else is fitted again at each value."""
    low, high = best.problem.space.bounds
    reach = []
    for end, bound in ((uncertainty.low[i], low[i]), (uncertainty.high[i], high[i])):
        far = 1.4 * (end - best.x[i]) if np.isfinite(end) else bound - best.x[i]
        reach.append(np.clip(best.x[i] + far, low[i], high[i]))
    thetas, losses = [best.x[i]], [best.loss]
    for end in reach:
        start = best
        for theta in np.linspace(best.x[i], end, _POINTS + 1)[1:]:
            x = start.x.copy()
            x[i] = theta
            point = best.problem.at(x)
            report(point)
            if point.ok:
                start = levenberg_marquardt(
                    best.problem, point, _ITERATIONS, report, fixed=(i,)
                ).best
            thetas.append(theta)
            losses.append(start.loss if point.ok else np.inf)
    order = np.argsort(thetas)
    item = best.problem.space.parameters.items[i]
    values = np.array([np.max(item.value(thetas[k])) for k in order])
    excess = (np.array(losses)[order] - best.loss) / uncertainty.allowed[i]
    return Profile(values, excess)
