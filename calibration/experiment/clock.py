"""How a recording's time relates to the simulation's, and where the relation is looked for.

Each recording has a clock, and the simulation has its own: it starts at `origin + delay` of the
recording. The origin is the best guess beforehand; the delay is fitted.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from calibration.data.onset import detect_onset
from calibration.data.recording import Recording
from calibration.data.selection import input_onset

# A delay is sought this far around its first guess: so many samples, or seconds if that is more.
_DELAY_SAMPLES = 10
_DELAY_SECONDS = 0.1


@dataclass(frozen=True)
class Clock:
    """How a recording's time relates to the simulation's, which starts at `origin` + delay.

    All in s, the recording's clock; the delay is within `low` <= delay <= `high`. A time offset
    as reported is `origin - zero + delay`. `dt`: the time step; `interval`: between samples.
    `windows`: into how many the recording is divided for the drift of each channel, by name;
    `start` and `duration` of all of them together.
    """

    origin: float
    zero: float
    low: float
    high: float
    dt: float
    interval: float
    windows: Mapping[str, int] = field(default_factory=dict)
    start: float = 0.0
    duration: float = 0.0


def first_clock(recording: Recording, time_offset: bool, dt: float | None) -> Clock:
    """The clock of a recording, guessed by its first movement; exact without `time_offset`.

    `dt` [s]: the time step; None: the interval between samples. Raises `ValueError` for a bad one,
    and `RecordingError` if a release cannot be seen that `time_offset` asks for.
    """
    interval = sample_interval(recording)
    if dt is None:
        dt = interval
    elif not (np.isfinite(dt) and dt > 0):
        raise ValueError(f"dt={dt!r} s: a positive number is needed")
    begin = float(recording.times[0])
    if not time_offset:
        return Clock(begin, begin if recording.has_inputs else 0.0, 0.0, 0.0, dt, interval)
    margin = max(_DELAY_SAMPLES * interval, _DELAY_SECONDS)
    if recording.starts_hanging and recording.has_inputs:
        # A part of a longer log: it begins anywhere, and its clocks are about right.
        return Clock(begin, begin, -margin, margin, dt, interval)
    onset = detect_onset(recording)
    if not recording.has_inputs:
        return Clock(onset, 0.0, -margin, margin, dt, interval)
    # The inputs have a clock, and the tip's may be late or early. What moves the rod first is a
    # load that acts from the start, or an input: whichever asks for less.
    guess = min((onset - begin, onset - input_onset(recording)), key=abs)
    low, high = min(guess, 0.0) - margin, max(guess, 0.0) + margin
    return Clock(begin + guess, begin, low - guess, high - guess, dt, interval)


def sample_interval(recording: Recording) -> float:
    """The median interval between samples of the tip [s]; inputs may be sampled faster."""
    return float(np.median(np.diff(recording.times[recording.has_tip])))
