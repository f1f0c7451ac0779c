"""The space in which a fit searches, and what each coordinate of it stands for."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Array, Float

from calibration.experiment import drift
from calibration.experiment.clock import Clock
from calibration.parameters.unknowns import Unknowns


@dataclass(frozen=True, eq=False)
class SearchSpace:
    """The space of all unknowns x, (unknowns,), of which 0 is the first guess.

    x is made of theta of the `parameters`, then of the delays in sample intervals if `time_offset`,
    then for each recording of the drifts of its windows in terms of their standard deviations
    (`calibration.experiment.drift`). Delays and drifts are nuisance parameters: nobody asks for
    them, and without them the others would be wrong.

    - `clocks`: of each recording.
    - `windows`: of each channel that may drift the largest number of windows of any recording.
    - `length` [m]: of the rod, by which drifts of the tip are measured.
    """

    parameters: Unknowns
    clocks: Sequence[Clock]
    time_offset: bool
    windows: Mapping[str, int]
    length: float

    @property
    def parameter_count(self) -> int:
        """How many entries of x are parameters, the first."""
        return len(self.parameters.items)

    @property
    def delays(self) -> slice:
        """Where the delays are in x."""
        first = self.parameter_count
        return slice(first, first + len(self.clocks) * self.time_offset)

    @cached_property
    def drifts(self) -> slice:
        """Where the drifts are in x, the last."""
        first = self.delays.stop
        count = sum(
            drift.CHANNELS[name] * windows
            for clock in self.clocks
            for name, windows in clock.windows.items()
        )
        return slice(first, first + count)

    def origin(self) -> Float[np.ndarray, "unknowns"]:
        """x at the setup's own values, the first guess of the clocks, and no drift."""
        return np.zeros(self.drifts.stop)

    @cached_property
    def bounds(self) -> tuple[Float[np.ndarray, "unknowns"], Float[np.ndarray, "unknowns"]]:
        """Lowest and highest x."""
        low, high = ([getattr(u, k) for u in self.parameters.items] for k in ("low", "high"))
        if self.time_offset:
            low += [c.low / c.interval for c in self.clocks]
            high += [c.high / c.interval for c in self.clocks]
        far = [drift.LARGEST] * (self.drifts.stop - self.drifts.start)
        return np.array(low + [-x for x in far]), np.array(high + far)

    @cached_property
    def nuisance_columns(self) -> dict[str, tuple[np.ndarray, np.ndarray]]:
        """For each nuisance parameter, by name and in the shape of `nuisance`: which entry of x it
        is, -1 for none, and its size in units of x."""
        many, end = len(self.clocks), self.drifts.start
        place = np.arange(many) + self.parameter_count if self.time_offset else np.full(many, -1)
        columns: dict[str, tuple[np.ndarray, np.ndarray]] = {}
        columns["delay"] = place, np.array([clock.interval for clock in self.clocks])
        for name, windows in self.windows.items():
            place = np.full((many, windows, drift.CHANNELS[name]), -1)
            size = np.zeros(place.shape)
            for k, clock in enumerate(self.clocks):
                own = place[k, : clock.windows.get(name, 0)]
                if own.size:
                    own[...] = end + np.arange(own.size).reshape(own.shape)
                    size[k] = drift.size(clock, name, self.length)
                    end += own.size
            columns[name] = place, size
        return columns

    def nuisance(self, x: Float[np.ndarray, "unknowns"]) -> dict[str, np.ndarray]:
        """The nuisance parameters at `x`, see `calibration.problem.evaluation.evaluate`."""
        return {
            name: np.where(place < 0, 0.0, x[np.maximum(place, 0)]) * size
            for name, (place, size) in self.nuisance_columns.items()
        }

    def values(self, x: Float[np.ndarray, "unknowns"]) -> dict[str, Array | np.ndarray | np.number]:
        """The parameters' values at `x`, by label."""
        return {u.label: u.value(t) for u, t in zip(self.parameters.items, x, strict=False)}

    def derivatives(
        self,
        by_parameter: Float[np.ndarray, "recordings *rest parameters"],
        by_nuisance: Mapping[str, np.ndarray],
    ) -> Float[np.ndarray, "recordings *rest unknowns"]:
        """Derivatives by x, from those by each recording's own parameters and nuisance parameters:
        the chain rule."""
        columns = self.parameters.columns
        by_x = np.zeros((*by_parameter.shape[:-1], self.drifts.stop))
        for k, j in np.argwhere(columns >= 0):
            by_x[k, ..., columns[k, j]] += by_parameter[k, ..., j]
        for name, (place, size) in self.nuisance_columns.items():
            for k, *j in np.argwhere(place >= 0):
                by_x[k, ..., place[k, *j]] = by_nuisance[name][k, ..., *j] * size[k, *j]
        return by_x
