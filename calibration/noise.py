"""What the residuals of a fit say about their own noise: how large, and how correlated in time.

Samples every 10 ms are not independent. For each recording and axis an autoregressive model is
fitted to the residuals (Yule-Walker, order by Schwarz's criterion), and its spectrum at the
frequency where it is largest is taken for the level of the noise at all. That is right for white
noise and cautious otherwise. The level where a parameter shows would be narrower, and is not to be
trusted: what a model leaves out lives at the frequencies of the motion, and a fit hides it just
there.
"""

from dataclasses import dataclass

import numpy as np

from calibration.loss import Point

_LARGEST_ORDER = 8
_SAMPLES_AN_ORDER = 12  # at least; more orders than this would fit the noise's accidents


@dataclass(frozen=True)
class Noise:
    """`meat`: sum over recordings and axes of J^T Cov(r) J, (unknowns, unknowns) [m^4].

    `effective_samples`: how many independent coordinates the residuals are worth to the unknowns;
    `samples`: how many there are. `variance` [m^2]: mean over recordings and axes.
    """

    meat: np.ndarray
    variance: float
    samples: int
    effective_samples: float


def estimate_noise(best: Point) -> Noise:
    """The noise of the weighted residuals at `best`."""
    problem, n = best.problem, best.x.size
    weights = problem.weights
    known = weights > 0
    residuals = best.residuals.reshape(weights.shape)
    J = best.jacobian.reshape(*weights.shape, n)
    # A perfect fit leaves rounding errors, which are no noise of zero.
    floor = (1e-9 * float(problem.scene.length)) ** 2
    meat, plain, variances = np.zeros((n, n)), np.zeros((n, n)), []
    for k, axis in np.argwhere(np.any(known, axis=1)):
        at = known[k, :, axis]
        times = np.asarray(problem.batch.times)[k, at]
        index = np.rint((times - times[0]) / problem.clocks[k].interval).astype(int)
        series = np.zeros(index[-1] + 1)
        series[index] = residuals[k, at, axis]
        variance = max(np.mean(residuals[k, at, axis] ** 2), floor)
        JJ = J[k, at, axis].T @ J[k, at, axis]
        meat += variance * _peak(series, int(np.sum(at))) * JJ
        plain += variance * JJ
        variances.append(variance)
    total = int(np.sum(known))
    H = best.jacobian.T @ best.jacobian
    H = H + 1e-12 * np.trace(H) * np.eye(n)
    trace = lambda M: float(np.trace(np.linalg.solve(H, M)))
    effective = total * min(1.0, trace(plain) / max(trace(meat), 1e-300))
    # What n unknowns have fitted away of the noise.
    freedom = effective / max(effective - n, 1.0)
    return Noise(freedom * meat, freedom * float(np.mean(variances)), total, effective)


def _peak(series: np.ndarray, count: int) -> float:
    """The largest value of the spectrum of `series` relative to that of white noise, at least 1.

    `count` of its samples are there, the others are 0 and left out of the autocovariances.
    """
    largest = min(_LARGEST_ORDER, count // _SAMPLES_AN_ORDER)
    power = np.sum(series**2)
    if largest < 1 or power == 0:
        return 1.0
    lagged = [np.sum(series[lag:] * series[: len(series) - lag]) for lag in range(largest + 1)]
    rho = np.array(lagged) / power
    # Levinson-Durbin; `left` is the part of the variance that the model does not explain.
    best, a, left = (0.0, np.zeros(0), 1.0), np.zeros(0), 1.0
    for order in range(1, largest + 1):
        reflection = (rho[order] - a @ rho[order - 1 : 0 : -1]) / left
        a = np.append(a - reflection * a[::-1], reflection)
        left *= max(1 - reflection**2, 1e-6)
        criterion = count * np.log(left) + order * np.log(count)
        if criterion < best[0]:
            best = (criterion, a, left)
    _, a, left = best
    frequencies = np.linspace(0, 0.5, 513)
    z = np.exp(-2j * np.pi * np.outer(frequencies, np.arange(1, len(a) + 1)))
    return max(1.0, float(np.max(left / np.abs(1 - z @ a) ** 2)))
