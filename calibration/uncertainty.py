"""How well the recordings determine what was fitted.

The covariance is that of least squares, H^-1 (sum of J^T J s^2) H^-1 with H = J^T J: the noise s
is estimated for each recording and axis by itself (a camera is not as good along its view, and
a model may be wrong in one direction only), and is inflated for the autocorrelation of the
residuals: samples every 10 ms are not independent.

A parameter that the data say little of has no interval that follows from J alone. Its bounds are
looked for: how far can it go until the fit, with everything else fitted again, is worse by more
than noise explains? If that never happens on a side, the side is open. A parameter is called
identifiable if its interval is closed and its ends are less than a factor of four apart: a damping
known to within an order of magnitude is not known.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from calibration.loss import Point

_QUANTILE = 1.959964  # of the normal distribution, 97.5 %
# A parameter whose standard error (in theta; about relative) is larger gets its bounds looked for.
_VAGUE = 0.25
_IDENTIFIED = np.log(4.0)
# What is believed beforehand: theta is 0 +- 7, the bounds of the fit being a 95 % interval.
# Keeps directions that the data say nothing of from taking infinite variance to the others.
_PRIOR = 7.0
_FIRST_STEP, _TRIES, _PRECISION = 0.7, 8, 0.05


@dataclass(frozen=True)
class Uncertainty:
    """In terms of x = (theta of the parameters, delays in sample intervals), (unknowns,).

    - `standard_errors`, (unknowns,); `correlation`, (unknowns, unknowns).
    - `low`, `high`: ends of the 95 % intervals, (unknowns,); -inf and inf on an open side.
    - `identifiable`, (unknowns,): whether the interval is closed and small.
    - `effective_samples`: how many independent coordinates the residuals are worth.
    - `covariance_factor`: see `shift`.
    """

    standard_errors: np.ndarray
    correlation: np.ndarray
    low: np.ndarray
    high: np.ndarray
    identifiable: np.ndarray
    effective_samples: float
    information: np.ndarray

    def shift(self, point: Point, change: np.ndarray) -> np.ndarray:
        """How x moves if all residuals at `point` change by `change` [m]."""
        return -np.linalg.solve(self.information, point.jacobian.T @ change)


def estimate(best: Point, report: Callable[[Point], None]) -> Uncertainty:
    """Intervals at the best point of a fit. Evaluates more points for vague parameters."""
    J, n = best.jacobian, best.jacobian.shape[1]
    blocks, variances, effective = _noise(best)
    information, meat = J.T @ J, np.zeros((n, n))
    for rows, variance in zip(blocks, variances, strict=True):
        meat += variance * J[rows].T @ J[rows]
    noise = np.mean(variances)
    prior = noise / _PRIOR**2 * np.eye(n)
    information = information + prior
    inverse = np.linalg.inv(information)
    covariance = inverse @ (meat + noise * prior) @ inverse
    errors = np.sqrt(np.diag(covariance))
    low, high = best.x - _QUANTILE * errors, best.x + _QUANTILE * errors
    for i in range(len(best.problem.names)):
        if errors[i] > _VAGUE:
            # The noise as this parameter feels it.
            variance = covariance[i, i] / inverse[i, i]
            low[i] = _bound(best, i, -1.0, variance, prior, report)
            high[i] = _bound(best, i, 1.0, variance, prior, report)
    return Uncertainty(
        standard_errors=errors,
        correlation=covariance / np.outer(errors, errors),
        low=low,
        high=high,
        identifiable=high - low < _IDENTIFIED,
        effective_samples=effective,
        information=information,
    )


def _noise(best: Point):
    """Rows of each recording and axis, the variance [m^2] of their noise, inflated, and the
    number of independent coordinates."""
    used = np.asarray(best.problem.batch.used)
    residuals = best.residuals.reshape(used.shape)
    index = np.arange(best.residuals.size).reshape(used.shape)
    total = int(np.sum(used))
    freedom = total / max(total - best.x.size, 1)
    blocks, variances, effective = [], [], 0.0
    for k in range(used.shape[0]):
        for axis in range(3):
            known = used[k, :, axis]
            count = int(np.sum(known))
            if count == 0:
                continue
            r = residuals[k, :, axis]
            inflation = _inflation(r, known)
            blocks.append(index[k, known, axis])
            variances.append(freedom * np.sum(r**2) / count * inflation)
            effective += count / inflation
    # A perfect fit leaves rounding errors, which are no noise of zero.
    floor = (1e-9 * float(best.problem.scene.length)) ** 2
    return blocks, np.maximum(variances, floor), effective


def _inflation(r: np.ndarray, known: np.ndarray) -> float:
    """Samples per independent sample: 1 + 2 sum of autocorrelations, at least 1.

    The sum ends where two neighbours together are negative: beyond, it is noise (Geyer's
    initial positive sequence, Statistical Science 7, 1992). Missing samples are left out of it.
    """
    variance = np.sum(r**2) / np.sum(known)
    if variance == 0:
        return 1.0

    def rho(lag):
        pairs = np.sum(known[lag:] & known[:-lag])
        return np.sum(r[lag:] * r[:-lag]) / pairs / variance if pairs else 0.0

    total, lag = 1.0, 1
    while lag + 1 < len(r) // 2:
        pair = rho(lag) + rho(lag + 1)
        if pair <= 0:
            break
        total += 2 * pair
        lag += 2
    return max(total, 1.0)


def _bound(best: Point, i: int, side: float, variance: float, prior, report) -> float:
    """Where the best loss at fixed x[i] exceeds the least by more than noise explains.

    +-inf if nowhere within the bounds of the fit; a place that cannot be simulated is beyond. The
    other unknowns are fitted again by one Gauss-Newton step, which costs no simulation.
    """
    problem = best.problem
    end = problem.bounds[0 if side < 0 else 1][i]

    def excess(distance):
        x = best.x.copy()
        x[i] += side * distance
        point = problem.at(x)
        report(point)
        if not point.ok:
            return np.inf
        others = np.delete(np.arange(x.size), i)
        J, r = point.jacobian[:, others], point.residuals
        step = -np.linalg.solve(J.T @ J + prior[np.ix_(others, others)], J.T @ r)
        return np.sum((r + J @ step) ** 2) - best.loss

    # The excess grows like the square of the distance, which gives the next try.
    allowed = _QUANTILE**2 * variance
    room, distance = abs(end - best.x[i]), min(_FIRST_STEP, abs(end - best.x[i]))
    for _ in range(_TRIES):
        worse = excess(distance)
        if distance >= room and worse <= allowed:
            return side * np.inf
        factor = np.clip(np.sqrt(allowed / max(worse, 1e-300)), 1 / 3, 3.0)
        distance = min(distance * factor, room)
        if abs(factor - 1) < _PRECISION:
            break
    return best.x[i] + side * distance
