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

from calibration.problem.problem import Point

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
    weights = problem.statistics.weights
    used = weights > 0
    residuals = best.residuals.reshape(weights.shape)
    J = best.jacobian.reshape(*weights.shape, n)
    # A perfect fit leaves rounding errors, which are no noise of zero.
    floor = (1e-9 * float(problem.scene.length)) ** 2
    H = best.jacobian.T @ best.jacobian
    # Where nothing depends on the unknowns, nothing of the noise is fitted away.
    H = H + max(1e-12 * np.trace(H), np.finfo(float).tiny) * np.eye(n)
    meat, plain, variances = np.zeros((n, n)), np.zeros((n, n)), []
    for k in range(len(used)):
        blocks = [
            _series(problem, residuals, J, used, k, axis)
            for axis in np.flatnonzero(np.any(used[k], axis=0))
        ]
        lags = [_autocorrelation(series, fitted, H) for series, _, fitted in blocks]
        # A camera is as slow in one direction as in another: all together tell more than each.
        counts = np.array([count for _, count, _ in blocks])
        least = min(len(rho) for rho in lags)
        together = np.average([rho[:least] for rho in lags], axis=0, weights=counts)
        common = _peak(together, int(np.sum(counts)))
        for (series, count, fitted), rho in zip(blocks, lags, strict=True):
            JJ = fitted.T @ fitted
            peak = max(_peak(rho, count), common)
            # What the unknowns have fitted away of this noise; so many they are here.
            absorbed = min(peak * np.trace(np.linalg.solve(H, JJ)), 0.5 * count)
            variance = max(np.sum(series**2) / (count - absorbed), floor)
            meat += variance * peak * JJ
            plain += variance * JJ
            variances.append(variance)
    total = int(np.sum(used))
    trace = lambda M: float(np.trace(np.linalg.solve(H, M)))
    effective = total * (min(1.0, trace(plain) / trace(meat)) if np.any(meat) else 1.0)
    return Noise(meat, float(np.mean(variances)), total, effective)


def _series(problem, residuals, J, used, k, axis):
    """Residuals of a recording and axis on an even grid, 0 where missing; how many there are; and
    their sensitivities on that grid."""
    at = used[k, :, axis]
    times = np.asarray(problem.batch.times)[k, at]
    index = np.rint((times - times[0]) / problem.space.clocks[k].interval).astype(int)
    series, fitted = np.zeros(index[-1] + 1), np.zeros((index[-1] + 1, J.shape[-1]))
    series[index], fitted[index] = residuals[k, at, axis], J[k, at, axis]
    return series, int(np.sum(at)), fitted


def _autocorrelation(series, fitted, H) -> np.ndarray:
    """The autocorrelation of the noise, from residuals of a fit: (lags,), 1 at lag 0.

    A fit takes out of the noise what looks like its sensitivities, and of correlated noise more.
    To first order in 1/samples, that lowers a lag by the autocorrelation of the projection.
    """
    count = len(series)
    largest = min(_LARGEST_ORDER, count // _SAMPLES_AN_ORDER)
    power = np.sum(series**2)
    if largest < 1 or power == 0:
        return np.ones(1)
    projected = np.linalg.solve(H, fitted.T).T
    rho = []
    for lag in range(largest + 1):
        ahead, behind = series[lag:], series[: count - lag]
        absorbed = np.sum(fitted[lag:] * projected[: count - lag])
        rho.append((np.sum(ahead * behind) / power * count + absorbed) / count)
    return np.array(rho) / rho[0]


def _peak(rho: np.ndarray, count: int) -> float:
    """The largest value of a spectrum relative to that of white noise, at least 1, from the
    autocorrelations `rho` of `count` samples."""
    # Levinson-Durbin; `left` is the part of the variance that the model does not explain.
    best, a, left = (0.0, np.zeros(0), 1.0), np.zeros(0), 1.0
    for order in range(1, len(rho)):
        reflection = (rho[order] - a @ rho[order - 1 : 0 : -1]) / left
        reflection = np.clip(reflection, -0.99, 0.99)
        a = np.append(a - reflection * a[::-1], reflection)
        left *= 1 - reflection**2
        criterion = count * np.log(left) + order * np.log(count)
        if criterion < best[0]:
            best = (criterion, a, left)
    _, a, left = best
    frequencies = np.linspace(0, 0.5, 513)
    z = np.exp(-2j * np.pi * np.outer(frequencies, np.arange(1, len(a) + 1)))
    return max(1.0, float(np.max(left / np.abs(1 - z @ a) ** 2)))
