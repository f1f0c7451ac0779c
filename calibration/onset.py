"""When the tip first moves: the first guess of a recording's clock offset.

A motion capture does not know when the rod was let go, and a log's clock need not start with
its inputs. The tip itself shows the moment to within a sample.
"""

import numpy as np

from calibration.recording import Recording, RecordingError

# Samples from which noise and rest are taken.
_FEW = 20
# Movement is clear above this many standard deviations of one coordinate's noise ..
_CLEAR_SIGMAS = 6.0
# .. and above this part of the largest movement: cameras settle, hands that hold tremble.
_CLEAR_PART = 0.05


def detect_onset(recording: Recording) -> float:
    """Time [s], on the recording's clock, of the last sample before the tip clearly moves.

    The first sample's time if the tip moves from the start. Raises `RecordingError` if it
    never clearly moves, or if there are fewer than three samples of it.
    """
    times, tip = recording.track
    where = recording.source or recording.name
    if len(tip) < 3:
        raise RecordingError(f"{where}: fewer than three samples of the tip: nothing to go by")
    index = last_rest_sample(tip)
    if index is None:
        raise RecordingError(
            f"{where}: the tip never moves clearly beyond its noise; give a recording in which "
            "it does, or switch the fit of the time offset off"
        )
    return float(times[index])


def last_rest_sample(tip: np.ndarray) -> int | None:
    """Index of the last sample of `tip`, (T, 3) without NaN, before it clearly moves.

    None if it never does. Samples before the index are at rest, up to noise.
    """
    noise = white_noise(tip[:_FEW])
    moved = np.linalg.norm(tip - np.median(tip[:5], axis=0), axis=1)
    clear = moved > max(_CLEAR_SIGMAS * noise, _CLEAR_PART * np.max(moved))
    # Two in a row: one sample alone is an outlier.
    clear = clear[:-1] & clear[1:]
    if not np.any(clear):
        return None
    first = int(np.argmax(clear))
    if first == 0:
        return 0
    # Clear movement is seen late: go back to the last sample that noise and drift explain.
    start = max(0, first - _FEW)
    rest = tip[start:first]
    moved = np.linalg.norm(rest - np.median(rest, axis=0), axis=1)
    quiet = max(_CLEAR_SIGMAS * noise, 2 * np.median(moved))
    return start + int(np.flatnonzero(moved <= quiet)[-1])


def white_noise(tip: np.ndarray) -> float:
    """Standard deviation of one coordinate's noise [m], whatever slow movement there is.

    From second differences, which a smooth movement hardly has and whose standard deviation is
    sqrt(6) times that of white noise; the median is deaf to single outliers.
    """
    # A coordinate that was not measured is zero throughout.
    tip = tip[:, np.any(tip != 0, axis=0)]
    if len(tip) < 3 or not tip.shape[1]:
        return 0.0
    return float(np.median(np.abs(np.diff(tip, n=2, axis=0))) / (0.6745 * np.sqrt(6)))
