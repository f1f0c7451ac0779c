"""Recordings of a robot: what was done to it and where its tip went.

SI units; a sample of the tip that is missing is NaN. `calibration.data.loading` reads them from
files.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from softrod_jax.scene.inputs import KINDS, Kind
from softrod_jax.scene.logs import TIP_COLUMNS as TIP_COLUMNS


class RecordingError(ValueError):
    """A recording that cannot be used: the message names file, row, column, value and remedy."""


@dataclass(frozen=True, eq=False)
class Recording:
    """One experiment, sampled at `times`.

    - `times` [s], (T,), strictly increasing; the recording's own clock.
    - `tensions` [N], (T, tendons driven by tension), or None if the recording has none.
    - `pressures` [Pa], (T, chambers), or None if the recording has none.
    - `tip_positions` [m], (T, 3), in the scene's frame; NaN where a coordinate is missing. One that
      is NaN throughout was not measured: a camera sees two.
    - `name`: short, for plots and reports. `source`: the file, or how it was made.
    - `origin_known`: False if the file does not say where the clamp is, so that the tip was
      put in place by its rest position; only its displacement is then a measurement.
    - `notes`: what the reader had to assume.
    - `starts_hanging`: whether the rod begins in equilibrium under the first inputs, and not
      straight; None: told by the tip before it first moves (`calibration.experiment.beginning`).
    - `gaps` [s]: pairs (start, end) in which the inputs are not known, though they were moving: a
      fit uses what comes before (`calibration.data.clocks`).
    - `pulls` [m], (T, tendons driven by length), or None if the recording has none.
    - `placed` [m], (3,): what was added to the tip to put it in place, where its origin is not
      known; None if nothing was.
    - `others`: what else was measured, (T, numbers) by key, such as "tension1"; NaN where missing.
      `noise`: standard deviations, by key, [m] of the "tip"; usual ones where nothing is said
      (`calibration.data.quantities`). They weigh measurements against each other.
    - `conditions`: values of parameters in which this experiment differs from the scene, by name
      (`calibration.parameters.catalogue`), such as {"payload_mass": 0.052}.
    - `carried`: where the base and obstacles are, by name, (T, 7) each: position [m] and unit
      quaternion (w, x, y, z) (`calibration.data.carried`).
    """

    times: np.ndarray
    tensions: np.ndarray | None
    pressures: np.ndarray | None
    tip_positions: np.ndarray
    name: str = "recording"
    source: str = ""
    origin_known: bool = True
    notes: tuple[str, ...] = ()
    starts_hanging: bool | None = None
    conditions: Mapping[str, float] = field(default_factory=dict)
    gaps: tuple[tuple[float, float], ...] = ()
    pulls: np.ndarray | None = None
    placed: np.ndarray | None = None
    others: Mapping[str, np.ndarray] = field(default_factory=dict)
    noise: Mapping[str, float] = field(default_factory=dict)
    carried: Mapping[str, np.ndarray] = field(default_factory=dict)

    @property
    def driven_by(self) -> list[tuple[Kind, np.ndarray]]:
        """The inputs that it has, with their kinds."""
        given = [(kind, getattr(self, kind.name)) for kind in KINDS]
        return [(kind, values) for kind, values in given if values is not None]

    @property
    def has_inputs(self) -> bool:
        """Whether any inputs drove it, or its base or an obstacle was carried; without, it is a
        release."""
        return bool(self.driven_by or self.carried)

    @property
    def coordinates(self) -> np.ndarray:
        """(3,) bool: the coordinates of the tip that were measured at all."""
        return np.any(np.isfinite(self.tip_positions), axis=0)

    @property
    def has_tip(self) -> np.ndarray:
        """(T,) bool: whether the sample has all coordinates of the tip that were measured."""
        measured = self.coordinates
        if not np.any(measured):
            return np.zeros(len(self.tip_positions), dtype=bool)
        return np.all(np.isfinite(self.tip_positions[:, measured]), axis=1)

    @property
    def track(self) -> tuple[np.ndarray, np.ndarray]:
        """Times (K,) and tip (K, 3) of the samples that have it; zero in coordinates that were not
        measured."""
        known = self.has_tip
        tip = np.where(self.coordinates, self.tip_positions[known], 0.0)
        return self.times[known], tip

    def window(self, start: float, end: float) -> "Recording":
        """The samples with start <= time <= end [s], on the same clock.

        Raises `RecordingError` if fewer than two are left.
        """
        keep = (self.times >= start) & (self.times <= end)
        if np.count_nonzero(keep) < 2:
            raise RecordingError(
                f"{self.source or self.name}: the window {start:g} to {end:g} s holds fewer than "
                f"two samples; the recording runs from {self.times[0]:g} to {self.times[-1]:g} s"
            )
        return replace(
            self,
            times=self.times[keep],
            **{kind.name: values[keep] for kind, values in self.driven_by},
            tip_positions=self.tip_positions[keep],
            others={key: values[keep] for key, values in self.others.items()},
            carried={name: poses[keep] for name, poses in self.carried.items()},
            gaps=tuple(g for g in self.gaps if g[0] < end and g[1] > start),
        )
