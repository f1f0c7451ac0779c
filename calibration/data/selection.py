"""Which samples of a recording are used: by default those between first movement and rest.

A release that is recorded for seconds after the motion has died out would otherwise be fitted
mostly to its rest, of which every sample says the same.
"""

from dataclasses import dataclass

import numpy as np

from calibration.data.clocks import gaps_of
from calibration.data.onset import detect_onset
from calibration.data.recording import Recording, RecordingError

# The motion is over when what is left of it is this part of the largest departure from rest,
_REST_PART = 0.05
# .. as a mean over this many samples, and beyond the noise.
_SMOOTHING = 9
# Before the motion: this part of its duration, and at least so many samples.
_LEAD_PART = 0.05
_LEAD_SAMPLES = 5

RULE = (
    f"from {_LEAD_SAMPLES} samples (or {_LEAD_PART:.0%} of the motion) before the tip or an input "
    f"first moves, until the tip stays within {_REST_PART:.0%} of its largest departure from "
    "its final rest"
)


@dataclass(frozen=True)
class Selection:
    """The samples with start <= time <= end [s, the recording's clock], and how chosen."""

    start: float
    end: float
    rule: str


def kept(recording: Recording, selection: Selection) -> np.ndarray:
    """(T,) bool: the samples inside the selection with at least one coordinate of the tip."""
    inside = (recording.times >= selection.start) & (recording.times <= selection.end)
    return inside & np.any(np.isfinite(recording.tip_positions), axis=1)


def select(recording: Recording, window: tuple[float, float] | None) -> Selection:
    """The samples to use: those in `window` [s] if given, else by the rule `RULE`; none after the
    inputs are not known for a while.

    Raises `RecordingError` if the window holds fewer than five samples with a tip, and
    `ValueError` if it is not a pair start < end.
    """
    if window is not None:
        try:
            start, end = (float(t) for t in window)
        except (TypeError, ValueError):
            raise ValueError(f"window={window!r}: expected a pair (start, end) in s") from None
        if not start < end:
            raise ValueError(f"window=({start:g}, {end:g}): the start must come before the end")
        selection = Selection(start, end, "window given")
    else:
        selection = _default(recording)
    gap = next(iter(gaps_of(recording)), None)
    if gap is not None and gap[0] < selection.end:
        # The motion after it depends on inputs that nobody knows.
        rule = f"{selection.rule}, but only up to {gap[0]:g} s, where the inputs have a gap"
        selection = Selection(selection.start, gap[0], rule)
    known = int(np.sum(kept(recording, selection)))
    if known < 5:
        where, begin, end = recording.source or recording.name, *recording.times[[0, -1]]
        if gap is not None and gap[0] <= selection.end:
            raise RecordingError(
                f"{where}: no inputs were recorded from {gap[0]:g} to {gap[1]:g} s, and before "
                f"that are only {known} samples of the tip that can be used; fill the rows in, or "
                "give the part after it alone, from a moment of rest on "
                f"(--window {gap[1]:g} {end:g})"
            )
        raise RecordingError(
            f"{where}: {known} samples of the tip between {selection.start:g} and "
            f"{selection.end:g} s; at least 5 are needed (the recording runs from {begin:g} to "
            f"{end:g} s)"
        )
    return selection


def _default(recording: Recording) -> Selection:
    times = recording.times
    if recording.starts_hanging:
        return Selection(times[0], times[-1], "all samples")
    try:
        onset = detect_onset(recording)
    except RecordingError:
        return Selection(times[0], times[-1], "all samples (no clear movement)")
    begin = min(onset, input_onset(recording))
    end = _end_of_motion(recording, onset)
    lead = max(_LEAD_PART * (end - begin), _LEAD_SAMPLES * np.median(np.diff(times)))
    return Selection(max(times[0], begin - lead), end, RULE)


def input_onset(recording: Recording) -> float:
    """The last time [s] before an input changes; infinite if none does."""
    if not recording.has_inputs:
        return np.inf
    given = [values for _, values in recording.driven_by] + list(recording.carried.values())
    inputs = np.concatenate(given, axis=1)
    range_ = np.ptp(inputs, axis=0)
    changed = np.any(np.abs(inputs - inputs[0]) > 0.01 * range_, axis=1) & np.any(range_ > 0)
    return float(recording.times[np.argmax(changed) - 1]) if np.any(changed) else np.inf


def _end_of_motion(recording: Recording, onset: float) -> float:
    """The last time [s] at which the tip still moves."""
    times, tip = recording.track
    last = tip[-max(len(tip) // 10, 5) :]
    departure = np.sum((tip - np.median(last, axis=0)) ** 2, axis=1)
    departure = np.where(times >= onset, departure, 0.0)
    # Noise by second differences, of which white noise has sqrt(6) times its own.
    noise = np.mean(np.diff(last, n=2, axis=0) ** 2) / 6 if len(last) > 2 else 0.0
    level = np.convolve(departure, np.ones(_SMOOTHING) / _SMOOTHING, mode="same")
    # Twice the noise of three coordinates: a mean of nine samples does not reach it.
    moving = level > _REST_PART**2 * np.max(departure) + 2 * 3 * noise
    return float(times[np.flatnonzero(moving)[-1]]) if np.any(moving) else float(times[-1])
