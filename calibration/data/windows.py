"""Long logs in pieces: an error early in a log must not ruin what comes after it.

A simulation of minutes drifts away from the robot, whatever the parameters: a tendon creeps, a
sensor warms up, and a phase error grows with every period. Cut into windows, each simulated from
its own beginning, a log tells as much of the material and less of the drift. A window begins in
equilibrium under its first inputs: it is made to begin where the tip is quietest, and a lead before
the window is simulated and not compared, in which the motion forgets how it began. A rod that rings
for longer than the lead, and never rests, cannot be cut.
"""

from dataclasses import replace

import numpy as np

from calibration.data.clocks import gaps_of
from calibration.data.recording import Recording, RecordingError

_LEAST_SAMPLES = 10
# Movement is looked at over so many samples; below this part of the tip's range it is rest.
_LOOK, _STILL = 5, 0.02


def split(recording: Recording, duration: float, lead: float) -> list[Recording]:
    """Windows of `duration` [s] with a lead of at least `lead` [s] before each but the first.

    A lead of a few decay times of the rod does; it begins up to half a window earlier if the tip is
    quieter there, and the window's `notes` say so if it is not at rest at all. What is left at the
    end joins the last window if it is shorter than half a window.

    Raises `ValueError` for bad durations and `RecordingError` for a
    recording without inputs, which is one release and cannot be cut.
    """
    if not (np.isfinite(duration) and duration > 0 and np.isfinite(lead) and lead >= 0):
        raise ValueError(
            f"duration={duration:g} s, lead={lead:g} s: a duration above 0 and a lead of at least "
            "0 are needed"
        )
    if not recording.has_inputs:
        raise RecordingError(
            f"{recording.source or recording.name}: a release without inputs is one motion and "
            "cannot be cut into windows"
        )
    begin, end = float(recording.times[0]), float(recording.times[-1])
    count = max(1, int(np.floor((end - begin) / duration + 0.5)))
    edges = [begin + k * duration for k in range(count)] + [end]
    if count == 1:
        return [recording]
    windows, gaps = [], gaps_of(recording)
    for k in range(count):
        start, notes = begin, ()
        if k:
            low, high = edges[k] - lead - duration / 2, edges[k] - lead
            # Not before a gap in the inputs: the motion after it depends on what is not known.
            known_from = max((end for _, end in gaps if end <= edges[k]), default=-np.inf)
            if known_from > low:
                low, high = known_from, max(high, known_from + lead)
            start, moving = _quietest(recording, low, high)
            if moving > _STILL:
                notes = (
                    f"the tip moves by {moving:.0%} of its range where the window's lead begins, "
                    "and is simulated as if it rested: give a longer lead, or a moment of rest",
                )
        last = k == count - 1
        window = recording.window(start, edges[k + 1])
        before = window.times < edges[k]
        after = np.zeros_like(before) if last else window.times >= edges[k + 1]
        tip = np.where((before | after)[:, None], np.nan, window.tip_positions)
        gap = next(iter(gaps_of(window)), None)
        known = replace(window, tip_positions=tip).has_tip
        if np.count_nonzero(known if gap is None else known & (window.times < gap[0])) < (
            _LEAST_SAMPLES
        ):
            continue
        windows.append(
            replace(
                window,
                tip_positions=tip,
                name=f"{recording.name}-{k + 1}",
                notes=(*recording.notes, *notes),
                starts_hanging=recording.starts_hanging if k == 0 else True,
            )
        )
    return windows


def _quietest(recording: Recording, low: float, high: float) -> tuple[float, float]:
    """The time [s] between `low` and `high` at which the tip moves least, and by how much it moves
    there within a few samples, as a part of its range. `high` and 0 if no tip is known there."""
    times, tip = recording.track
    inside = np.flatnonzero((times >= low) & (times <= high))
    inside = inside[inside + _LOOK <= len(tip)]
    if not len(inside):
        return max(high, float(recording.times[0])), 0.0
    whole = np.linalg.norm(np.ptp(tip, axis=0))
    moved = [np.linalg.norm(np.ptp(tip[k : k + _LOOK], axis=0)) for k in inside]
    best = int(np.argmin(moved))
    return float(times[inside[best]]), float(moved[best] / whole) if whole > 0 else 0.0
