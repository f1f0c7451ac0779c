"""Weights that take outliers out of a fit: iteratively reweighted least squares.

A marker that was swapped or a reflection is centimetres off; squared, one such sample outweighs
a whole recording. The weights are those of Huber (1964) and Tukey's biweight (Beaton & Tukey
1974) with the usual constants, 95 % efficient for normal noise; sizes are compared with the median
of the residuals' sizes, by recording and axis.
"""

import numpy as np
from jaxtyping import Float

from calibration.problem.problem import Point

_HUBER, _TUKEY = 1.345, 4.685
_MAD = 1.4826  # standard deviation / median absolute deviation of the normal distribution
LOSSES = ("squares", "huber", "tukey")


def robust_weights(
    point: Point, loss: str, round_: int
) -> Float[np.ndarray, "recordings samples all"]:
    """Factors of the residuals for the next round; 0 where unused.

    Tukey's, which forget an outlier altogether, need a good start: two rounds of Huber's.
    """
    used = np.asarray(point.problem.batch.used)
    raw = np.where(used, np.abs(point.evaluation.residuals), np.nan)
    sigma = np.zeros((len(raw), 1, raw.shape[-1]))
    for k, axis in np.argwhere(np.any(used, axis=1)):
        sigma[k, 0, axis] = _MAD * np.nanmedian(raw[k, :, axis])
    floor = 1e-7 * float(point.problem.scene.length)
    z = np.nan_to_num(raw) / np.maximum(sigma, floor)
    if loss == "tukey" and round_ >= 2:
        w = np.where(z < _TUKEY, (1 - (z / _TUKEY) ** 2) ** 2, 0.0)
    else:
        w = np.minimum(1.0, _HUBER / np.maximum(z, 1e-12))
    return np.sqrt(w) * used * np.asarray(point.problem.batch.factors)[:, None]
