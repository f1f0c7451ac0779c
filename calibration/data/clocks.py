"""Clocks of a recording: where inputs are not known, and one clock for what several have measured.

Between two samples an input is taken to change linearly, and outside of its samples to stay. That
is an assumption where samples are missing, and nonsense where two clocks do not even overlap.
"""

from dataclasses import dataclass

import numpy as np

from calibration.data.recording import RecordingError

# An interval is a gap above so many usual ones; beyond the second number nothing can be said of
# what an input did in it. An input that is the same on both sides, to this part of its range,
# stayed.
_NOTED, _BROKEN, _SAME = 2.5, 5.0, 0.02
# Inputs that cover less of the tip's time than this are not of the same experiment.
_LEAST_COVER = 0.1
_FACTORS = {1e3: "ms", 1e6: "us", 60.0: "min", 3600.0: "h", 86400.0: "d"}


@dataclass(frozen=True)
class Gaps:
    """`open` (start, end) [s]: in which the inputs are not known; `notes`: what was assumed."""

    open: tuple[tuple[float, float], ...] = ()
    notes: tuple[str, ...] = ()


def find_gaps(
    times: np.ndarray, values: np.ndarray, name: str, whole: float, tip_interval: float = 0.0
) -> Gaps:
    """The gaps in samples `times` [s] of an input (T,) called `name`.

    `whole`: the range of all inputs of the kind, beside which a change is small.
    `tip_interval` [s]: what is shorter than between two samples of the tip is no gap.
    """
    steps = np.diff(times)
    if len(steps) < 4:
        return Gaps()
    # Logs of which many rows are far apart were meant so: there, a gap is what is longer still.
    usual, often = np.median(steps), np.quantile(steps, 0.9)
    changes = np.abs(np.diff(values)) > _SAME * whole
    # Moving on one side of a gap is moving in it, even if it comes back to the same value.
    about = changes | np.append(changes[1:], False) | np.append(False, changes[:-1])
    noted = steps > np.maximum(_NOTED * usual, 1.5 * tip_interval)
    broken = noted & about & (steps > np.maximum(_BROKEN * often, _NOTED * tip_interval))
    notes = [
        f"no samples of {name} from {times[k]:g} to {times[k + 1]:g} s, while it goes from "
        f"{values[k]:.4g} to {values[k + 1]:.4g}: what it did is not known, and a fit uses what "
        "comes before"
        for k in np.flatnonzero(broken)[:3]
    ]
    for small, what in (
        (noted & about & ~broken, "a straight line is drawn across"),
        (noted & ~about, "it is the same on both sides, and is taken to have stayed"),
    ):
        if np.any(small):
            k = int(np.argmax(np.where(small, steps, 0)))
            number = int(np.sum(small))
            notes.append(
                f"{number} gap{'s'[: number > 1]} in the samples of {name}, of up to "
                f"{steps[k]:.3g} s (at {times[k]:g} s): {what}"
            )
    found = tuple((float(times[k]), float(times[k + 1])) for k in np.flatnonzero(broken))
    return Gaps(found, tuple(notes))


def gaps_of(recording) -> list[tuple[float, float]]:
    """All (start, end) [s] in which the inputs of a recording are not known, in time: as its reader
    found, or by its times."""
    gaps = list(recording.gaps)
    known = recording.times[recording.has_tip]
    interval = float(np.median(np.diff(known))) if len(known) > 1 else 0.0
    for _, inputs in recording.driven_by:
        for column in inputs.T:
            whole = float(np.ptp(inputs))
            gaps += find_gaps(recording.times, column, "", whole, interval).open
    return sorted(set(gaps))


def check_overlap(path, name: str, own: np.ndarray, tip: np.ndarray, key: str) -> tuple[str, ...]:
    """Notes on an input whose clock `own` [s] does not cover the `tip`'s. `key`: of its time.

    Raises `RecordingError` if the clocks do not overlap, or one runs a thousand times as fast.
    """
    spans = (
        f"the clock of {name} runs from {own[0]:.10g} to {own[-1]:.10g} s, and that of the tip "
        f"from {tip[0]:.10g} to {tip[-1]:.10g} s"
    )
    ratio = np.ptp(own) / np.ptp(tip) if np.ptp(tip) > 0 else 1.0
    for factor, unit in _FACTORS.items():
        near = 0.05 if factor in (1e3, 1e6) else 0.01
        if abs(ratio / factor - 1) < near:
            raise RecordingError(f"{path}: {spans}: is it in {unit}? set {key}unit = '{unit}'")
        if abs(ratio * factor - 1) < near:
            raise RecordingError(
                f"{path}: {spans}: is the tip's in {unit}? set its unit = '{unit}'"
            )
    cover = np.mean((tip >= own[0]) & (tip <= own[-1]))
    if own[-1] < tip[0] or own[0] > tip[-1] or (cover < _LEAST_COVER and len(own) > 1):
        raise RecordingError(
            f"{path}: {spans}: they do not "
            f"overlap{'' if cover == 0 else f' but for {cover:.0%}'}; give "
            f"both from one clock, or subtract their beginnings ({key}offset, in the clock's unit)"
        )
    slack = 2 * np.median(np.diff(tip)) if len(tip) > 1 else 0.0
    parts = []
    if own[0] - tip[0] > slack:
        parts.append(f"before {own[0]:g} s")
    if tip[-1] - own[-1] > slack:
        parts.append(f"after {own[-1]:g} s")
    if not parts:
        return ()
    return (
        f"{name} was not measured {' and '.join(parts)}, and is held there while the tip goes on",
    )
