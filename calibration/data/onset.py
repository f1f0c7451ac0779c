"""When the tip first moves: the first guess of a recording's clock offset.

A motion capture does not know when the rod was let go, and a log's clock need not start with
its inputs. The tip itself shows the moment to within a sample.
"""

import numpy as np

from calibration.data.recording import Recording, RecordingError

# Samples from which noise and rest are taken.
_FEW = 20
# So many at rest tell where it is; else so many of the movement are traced back to its beginning,
# in so many rounds, each of which weighs down what the last one missed.
_REST, _TRACED, _ROUNDS = 5, 8, 30
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


def start_position(recording: Recording) -> tuple[np.ndarray, bool]:
    """Where the tip is [m] before it first moves, (3,), and whether it is seen to rest there.

    The median of all samples at rest; of a tip that moves from the first samples on, where they
    lead back to if it was still: x0 + a t^2 + b t^3, by least absolute deviations. One sample that
    is wrong moves neither. Zero in coordinates that were not measured.
    """
    times, tip = recording.track
    index = last_rest_sample(tip)
    if index is None or index + 1 >= _REST:
        return np.median(tip[: None if index is None else index + 1], axis=0), True
    t = times[:_TRACED] - times[0]
    t = t / max(t[-1], 1e-12)
    columns = np.stack([np.ones_like(t), t**2, t**3], axis=1)
    tip = tip[:_TRACED]
    found, weights = np.zeros((3, 3)), np.ones(len(tip))
    for _ in range(_ROUNDS):
        root = np.sqrt(weights)[:, None]
        found = np.linalg.lstsq(root * columns, root * tip, rcond=None)[0]
        missed = np.linalg.norm(tip - columns @ found, axis=1)
        weights = 1 / np.maximum(missed, 1e-3 * np.max(missed) + 1e-12)
    return found[0], False


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
