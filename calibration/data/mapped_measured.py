"""What else a file measured, as its mapping says: tensions, the wrench at the base, curvatures.

A load cell may have a clock of its own; what it measured is interpolated to the tip's samples.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from calibration.data.mapped_columns import TimeColumn
from calibration.data.mapping_file import Spec
from calibration.data.quantities import quantities_of
from calibration.data.recording import RecordingError
from calibration.data.table import Table

_MISSING = "leave the cell empty if nothing was measured, or name its text in [csv] missing"


@dataclass(frozen=True, eq=False)
class MeasuredPart:
    """`values`, (samples, numbers), of `key` at `times`; `noise`, None where not said."""

    key: str
    times: np.ndarray
    values: Float[np.ndarray, "samples numbers"]
    noise: float | None


def measured_parts(table: Table, spec: Spec, clock: TimeColumn, scene) -> list[MeasuredPart]:
    """Those of all tables [[measured]]. Raises `RecordingError` for one that cannot be."""
    return [_part(table, part, clock, scene) for part in spec.tables("measured")]


def _part(table: Table, part: Spec, clock: TimeColumn, scene) -> MeasuredPart:
    if scene is None:
        raise RecordingError(f"{part.where}what can be measured the scene says: give the scene")
    known, key = quantities_of(scene), part.text("key")
    if key not in known:
        raise part.wrong("key", key, f"one of {', '.join(known)}")
    own = part.table("time", required=False)
    clock = TimeColumn(table, own) if own.content else clock
    quantity = known[key]
    names = part.texts("columns", len(quantity.columns))
    scale, offset = part.number("scale", 1.0) or 0.0, part.number("offset", 0.0) or 0.0
    noise = part.number("noise", None)
    if noise is not None and not noise > 0:
        raise part.wrong("noise", noise, f"a number above 0 [{quantity.unit}]")
    part.done()
    found = [table.find(name, key=f"{part.where}columns") for name in names if name]
    if not found:
        raise part.wrong("columns", names, "at least one that is not empty")
    columns = iter([table.numbers(name, _MISSING) for name in found])
    count = len(table.columns[found[0]])
    values = [next(columns) if name else np.full(count, np.nan) for name in names]
    if any(len(x) != count for x in values):
        raise RecordingError(f"{part.where}columns: have different numbers of samples")
    times = clock.of(count, found[0])
    there = ~np.isnan(times)
    return MeasuredPart(key, times[there], scale * (np.stack(values, 1)[there] + offset), noise)


def at_samples(
    parts: Sequence[MeasuredPart], times: Float[np.ndarray, "samples"]
) -> tuple[dict[str, np.ndarray], dict[str, float]]:
    """`others` and `noise` of a recording, at `times` [s]: NaN outside of what was sampled, and
    between samples of which one is missing."""
    others = {
        x.key: np.stack(
            [np.interp(times, x.times, c, left=np.nan, right=np.nan) for c in x.values.T], axis=1
        )
        for x in parts
    }
    return others, {x.key: x.noise for x in parts if x.noise is not None}
