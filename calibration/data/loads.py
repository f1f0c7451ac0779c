"""Tensions as a load cell shows them: a little below zero where a tendon is slack."""

from collections.abc import Callable, Sequence

import numpy as np

from calibration.data.recording import RecordingError

# Below zero by less than this part of the largest tension is the noise or the drift of the cell.
_NOISE_PART = 0.02
# Of a log in which no tendon is pulled by more than this, below zero by less than ..
_SLACK = 0.05  # N
# .. so many standard deviations.
_SIGMAS = 6.0


def without_noise_below_zero(
    tensions: Sequence[np.ndarray], where: Callable[[int, int], str]
) -> tuple[list[np.ndarray], tuple[str, ...]]:
    """Tensions [N], (T,) of each tendon, at least 0, and a note on what was noise below.

    `where(i, k)`: file, row and column of sample k of tendon i. Raises `RecordingError` for a
    tension that is really negative.
    """
    largest = max((float(np.max(x, initial=0.0)) for x in tensions), default=0.0)
    lowest, clipped = 0.0, []
    for i, x in enumerate(tensions):
        allowed = _NOISE_PART * largest
        if largest <= _SLACK:
            # Of noise alone, of which the second differences are sqrt(6) times as large.
            ripple = np.sort(np.abs(np.diff(x, n=2)))
            noise = ripple[int(0.7 * len(ripple))] / np.sqrt(6) if len(ripple) > 10 else 0.0
            allowed = max(allowed, min(_SIGMAS * noise, _SLACK))
        for k in np.flatnonzero(x < -allowed)[:1]:
            raise RecordingError(
                f"{where(i, k)}: {x[k]:.4g} N is negative, and more than noise; a tendon can only "
                "pull: give at least 0 or, in a mapping, correct the zero of the load cell with "
                "`offset`, or the sign with `scale = -1`"
            )
        lowest = min(lowest, float(np.min(x, initial=0.0)))
        clipped.append(np.maximum(x, 0.0))
    if lowest == 0:
        return list(tensions), ()
    number = sum(int(np.sum(x < 0)) for x in tensions)
    return clipped, (
        f"{number} tension{'s'[: number > 1]} below zero, by up to {-1e3 * lowest:.3g} mN, taken "
        "for the noise of the load cell and set to 0",
    )
