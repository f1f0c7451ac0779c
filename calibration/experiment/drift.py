"""Slow drifts in a long log: of the tip's clock, of the sensor, of what the inputs do.

A camera's clock runs a little slow, a marker slips, a tendon creeps. In a log of a second that is
nothing; later it is more than the noise, and a fit that does not know of it bends the material
until it explains the drift. A log is divided into windows. In each of them what drifts changes
linearly, from where it was at the end of the window before; the simulation itself goes on. The
changes are fitted along with the parameters, and are believed to be small beforehand.

A rod forgets where it began, so that a drift that lasts cannot be cured by windows that each begin
in a state of their own: what has drifted would drift the tip again within a few periods.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from calibration.data.recording import Recording
from calibration.data.selection import Selection
from calibration.experiment.clock import Clock

# What may drift, and how many numbers each has.
CHANNELS = {"clock": 1, "tip": 3, "inputs": 1}
# What is believed of one window beforehand, as a standard deviation: the clock is wrong by this
# part of the window's duration, the tip by this part of the rod's length, the inputs by this part
# of what they are.
_CLOCK, _TIP, _INPUTS = 0.02, 0.02, 0.05
# No window drifts by more standard deviations than this.
LARGEST = 10.0
# A simulation is long enough for a clock that is wrong by so many of them all the time.
_REACH = 2.0


@dataclass(frozen=True)
class Drift:
    """How a channel of a recording drifted: at the `edges` [s] of its windows, (windows + 1,), it
    had changed by `values`, (windows + 1, numbers).

    "clock": what it has gained [s], below 0 if it is slow. "tip": how far it is seen to have moved
    along x, y and z [m]. "inputs": what arrives of the inputs, relative.
    """

    edges: np.ndarray
    values: np.ndarray

    def at(self, times: np.ndarray) -> np.ndarray:
        """The change at `times` [s], (T, numbers)."""
        return np.stack([np.interp(times, self.edges, x) for x in self.values.T], axis=1)


def durations(drift: Mapping[str, float] | None) -> dict[str, float]:
    """What may drift, and the duration [s] of its windows. Raises `ValueError` for other names
    and for durations that are not above 0."""
    drift = dict(drift or {})
    for name, duration in drift.items():
        if name not in CHANNELS:
            raise ValueError(f"drift: {name!r} is unknown; choose from {', '.join(CHANNELS)}")
        if not (np.isfinite(duration) and duration > 0):
            raise ValueError(f"drift: {name} = {duration:g} s: a duration above 0 is needed")
    return drift


def divided(
    clock: Clock, recording: Recording, selection: Selection, drift: Mapping[str, float]
) -> Clock:
    """The clock with windows of about the durations `drift` [s] in what is used of the recording.

    A release without inputs has none: it is one motion, which alone tells of its clock.
    """
    if not recording.has_inputs:
        return clock
    whole = selection.end - selection.start
    count = {name: max(1, math.floor(whole / d + 0.5)) for name, d in drift.items()}
    return replace(clock, windows=count, start=selection.start, duration=whole)


def ramps(
    times: Float[np.ndarray, "times"], clock: Clock, channel: str
) -> Float[np.ndarray, "times windows"]:
    """What part of each window of a channel is over at `times` [s]: 0 before it, 1 after it."""
    windows = clock.windows.get(channel, 0)
    length = clock.duration / max(windows, 1)
    edges = clock.start + length * np.arange(windows)
    return np.clip((times[:, None] - edges) / max(length, 1e-12), 0.0, 1.0)


def drifts(nuisance: Mapping[str, np.ndarray | np.floating], clock: Clock) -> dict[str, Drift]:
    """The drift of each channel, from the nuisance parameters of a recording, see
    `calibration.problem.evaluation`."""
    found = {}
    for name, windows in clock.windows.items():
        steps = np.asarray(nuisance[name])[:windows]
        edges = clock.start + clock.duration * np.linspace(0, 1, windows + 1)
        values = np.concatenate([np.zeros_like(steps[:1]), np.cumsum(steps, axis=0)])
        found[name] = Drift(edges, values)
    return found


def size(clock: Clock, channel: str, length: float) -> float:
    """The standard deviation of a channel's change in a window, as it is believed beforehand."""
    if channel == "clock":
        return _CLOCK * clock.duration / clock.windows[channel]
    return _TIP * float(length) if channel == "tip" else _INPUTS


def latest(clock: Clock) -> float:
    """How much [s] a clock may be slow at the end: the simulation is longer by so much."""
    return _REACH * _CLOCK * clock.duration if "clock" in clock.windows else 0.0
