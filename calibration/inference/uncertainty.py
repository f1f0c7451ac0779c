"""How well the recordings determine what was fitted.

The covariance is that of least squares, H^-1 (J^T Cov(r) J) H^-1 with H = J^T J and the noise's
covariance from `calibration.inference.noise`.

A parameter that the data say little of has no interval that follows from J alone. Its bounds are
looked for: how far can it go until the fit, with everything else fitted again, is worse by more
than noise explains? If that never happens on a side, the side is open. A parameter is identified
if its interval is closed and no wider than its scale allows: a damping known to within an order of
magnitude is not known.
"""

from dataclasses import dataclass

import numpy as np

from calibration.inference.noise import Noise, estimate_noise
from calibration.problem.problem import Point
from calibration.search.progress import Report

_QUANTILE = 1.959964  # of the normal distribution, 97.5 %
_TRIES, _PRECISION = 7, 0.2
_FOLLOWS = 0.2
# What is believed of a delay beforehand, in sample intervals.
PRIOR_DELAY = 7.0

IDENTIFIED = "identified"
ABOVE, BELOW = "bounded above only", "bounded below only"
NOT_IDENTIFIABLE = "not identifiable"


@dataclass(frozen=True)
class Uncertainty:
    """How well each coordinate of x is determined (`calibration.problem.space.SearchSpace`).

    - `standard_errors`, (unknowns,); `correlation`, (unknowns, unknowns).
    - `low`, `high`: ends of the 95 % intervals, (unknowns,); -inf and inf on an open side.
    - `verdicts`: for each parameter, one of the four above.
    - `samples`, `effective_samples`: how many coordinates were fitted, and how many independent
      ones they are worth.
    - `allowed` [m^2], (unknowns,): by how much the sum of squares may grow inside the interval.
    - `quantile`, (unknowns,): of Student's t; the intervals' half widths in standard errors.
    - `information`, (unknowns, unknowns) [m^2]: J^T J and what is believed beforehand.
    """

    standard_errors: np.ndarray
    correlation: np.ndarray
    low: np.ndarray
    high: np.ndarray
    verdicts: tuple[str, ...]
    samples: int
    effective_samples: float
    allowed: np.ndarray
    quantile: np.ndarray
    information: np.ndarray

    def shift(self, point: Point, change: np.ndarray) -> np.ndarray:
        """How x moves if all residuals at `point` change by `change` [m]."""
        return -np.linalg.solve(self.information, point.jacobian.T @ change)


def estimate_uncertainty(best: Point, report: Report) -> Uncertainty:
    """Intervals at the best point of a fit. Evaluates more points for vague parameters."""
    space, n = best.problem.space, best.x.size
    items = space.parameters.items
    noise = estimate_noise(best)
    # Keeps directions that the data say nothing of from taking infinite variance to the others:
    # beforehand theta is 0 within the largest theta, as a 95 % interval.
    width = [u.parameter.scale.largest / 2 for u in items]
    width += [PRIOR_DELAY] * (space.delays.stop - space.delays.start)
    width += [1.0] * (n - len(width))
    prior = noise.variance * np.diag(np.array(width) ** -2.0)
    # What is believed of parameters counts as measurements that are independent of each other.
    _, by_x = best.beliefs
    variance = best.problem.variance
    known = variance * by_x.T @ by_x
    information = best.jacobian.T @ best.jacobian + prior + known
    inverse = np.linalg.inv(information)
    meat = noise.meat + noise.variance * prior + variance * known
    covariance = inverse @ meat @ inverse
    errors = np.sqrt(np.diag(covariance))
    freedom = _freedom(best, noise, inverse, covariance)
    # Cornish and Fisher (1938): Student's t from the normal distribution.
    quantile = _QUANTILE + (_QUANTILE**3 + _QUANTILE) / (4 * freedom)
    low, high = best.x - quantile * errors, best.x + quantile * errors
    # The noise as each parameter feels it.
    allowed = quantile**2 * np.diag(covariance) / np.diag(inverse)
    for i, u in enumerate(items):
        if errors[i] > u.parameter.scale.vague:
            # How the others follow where this one goes.
            valley = covariance[:, i] / covariance[i, i]
            low[i] = _bound(best, i, -1.0, valley, errors[i], allowed[i], prior, report)
            high[i] = _bound(best, i, 1.0, valley, errors[i], allowed[i], prior, report)
    return Uncertainty(
        standard_errors=errors,
        correlation=covariance / np.outer(errors, errors),
        low=low,
        high=high,
        verdicts=tuple(
            _verdict(a, b, u.parameter.scale.identified)
            for a, b, u in zip(low, high, items, strict=False)
        ),
        samples=noise.samples,
        effective_samples=noise.effective_samples,
        allowed=allowed,
        quantile=quantile,
        information=information,
    )


def _freedom(best: Point, noise: Noise, inverse, covariance) -> np.ndarray:
    """How many degrees of freedom the variance of each unknown has, (unknowns,).

    The noise of recordings, and of what was measured beside them, is known from their own
    residuals. What rests on the fewer of them is known the less well (Welch 1947, Satterthwaite
    1946). Priors are known.
    """
    n, beside = best.x.size, best.problem.beside
    from_recordings = noise.effective_samples + len(best.from_priors[0]) - n
    if beside is None:
        return np.full(n, max(from_recordings, 2.0))
    by_x = best.beliefs[1][len(best.from_priors[0]) :]
    told = best.problem.variance * by_x.T @ by_x
    # Unknowns are fitted to both, and take freedom from each as far as it tells them.
    absorbed = float(np.trace(inverse @ told))
    freedoms = from_recordings + absorbed, beside.effective - absorbed
    meats = noise.meat, best.problem.variance * told
    parts = [np.diag(inverse @ meat @ inverse) for meat in meats]
    whole = np.diag(covariance)
    spread = sum(part**2 / max(f, 2.0) for part, f in zip(parts, freedoms, strict=True))
    return np.maximum(whole**2 / np.maximum(spread, 1e-300 * whole**2), 2.0)


def _verdict(low: float, high: float, widest: float) -> str:
    match bool(np.isfinite(low)), bool(np.isfinite(high)):
        case True, True:
            return IDENTIFIED if high - low < widest else NOT_IDENTIFIABLE
        case True, False:
            return BELOW
        case False, True:
            return ABOVE
    return NOT_IDENTIFIABLE


def _bound(best: Point, i: int, side: float, valley, error, allowed, prior, report) -> float:
    """Where the best loss at fixed x[i] exceeds the least by more than noise explains.

    +-inf if nowhere within the bounds of the fit; a place that cannot be simulated is beyond. The
    other unknowns stay, or follow along the `valley`, (unknowns,), whichever is better, and are
    fitted again by one Gauss-Newton step, which costs no simulation.
    """
    problem = best.problem
    reached = np.sum(best.rows[0] ** 2)
    room = abs(problem.space.bounds[0 if side < 0 else 1][i] - best.x[i])
    alone = np.where(np.arange(best.x.size) == i, 1.0, 0.0)
    ways = [valley, alone] if np.max(np.abs(valley - alone)) > _FOLLOWS else [alone]

    def excess(distance):
        least = np.inf
        for way in ways:
            point = problem.at(best.x + side * distance * way)
            report(point)
            if point.ok:
                others = np.delete(np.arange(best.x.size), i)
                r, J = point.rows[0], point.rows[1][:, others]
                step = -np.linalg.solve(J.T @ J + prior[np.ix_(others, others)], J.T @ r)
                least = min(least, max(np.sum((r + J @ step) ** 2) - reached, 0.0))
            if least <= allowed:
                break
        return least

    if room == 0:
        return side * np.inf
    # (distance, square root of the excess in units of what is allowed) on both sides of 1.
    inside, outside = (0.0, 0.0), None
    distance = min(_QUANTILE * error, 0.5 * room)
    for _ in range(_TRIES):
        size = np.sqrt(excess(distance) / allowed)
        if size > 1:
            outside = (distance, size)
        elif outside is None:
            # The effect of a damping that becomes small fades: the end alone tells.
            size_there = np.sqrt(excess(room) / allowed)
            if size_there <= 1:
                return side * np.inf
            inside, outside = (distance, size), (room, size_there)
        else:
            inside = (distance, size)
        if abs(size - 1) < _PRECISION:
            break
        # The excess grows like the square of the distance; an end may be far or no number.
        part = (1 - inside[1]) / (min(outside[1], 20.0) - inside[1])
        distance = inside[0] + np.clip(part, 0.1, 0.9) * (outside[0] - inside[0])
    return best.x[i] + side * distance
