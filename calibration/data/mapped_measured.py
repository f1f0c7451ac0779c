"""What else a file measured, as its mapping says: tensions, the wrench at the base, curvatures,
where markers were and how they were turned.

A load cell may have a clock of its own; what it measured is interpolated to the tip's samples. A
camera that sees a marker is that of the tip: axes, origin and unit are those of [tip].
"""

from collections.abc import Sequence
from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from calibration.data.frames import axes_matrix, quaternion_of_turn
from calibration.data.mapped_columns import TimeColumn, factor
from calibration.data.mapped_tip import SeenFrame, place_of
from calibration.data.mapping_file import Spec
from calibration.data.quantities import PLACE, TURN, quantities_in_motion
from calibration.data.recording import RecordingError
from calibration.data.table import Table
from softrod_jax.rod.rotations import quaternion_product

# A quaternion of a motion capture has so many digits.
_UNIT = 0.01
_MISSING = "leave the cell empty if nothing was measured, or name its text in [csv] missing"


@dataclass(frozen=True, eq=False)
class MeasuredPart:
    """`values`, (samples, numbers), of `key` at `times`; `noise`, None where not said."""

    key: str
    times: np.ndarray
    values: Float[np.ndarray, "samples numbers"]
    noise: float | None


def measured_parts(
    table: Table, spec: Spec, clock: TimeColumn, scene, frame: SeenFrame | None
) -> list[MeasuredPart]:
    """Those of all tables [[measured]]; markers as the tip's `frame` sees them. Raises
    `RecordingError` for one that cannot be."""
    return [_part(table, part, clock, scene, frame) for part in spec.tables("measured")]


def _part(table: Table, part: Spec, clock: TimeColumn, scene, frame) -> MeasuredPart:
    if scene is None:
        raise RecordingError(f"{part.where}what can be measured the scene says: give the scene")
    known, key = quantities_in_motion(scene), part.text("key")
    if key not in known:
        raise part.wrong("key", key, f"one of {', '.join(known)}")
    own = part.table("time", required=False)
    clock = TimeColumn(table, own) if own.content else clock
    quantity = known[key]
    names = part.texts("columns", len(quantity.columns))
    found = [table.find(name, key=f"{part.where}columns") if name else "" for name in names]
    if not any(found):
        raise part.wrong("columns", names, "at least one that is not empty")
    noise = part.number("noise", None)
    if noise is not None and not noise > 0:
        raise part.wrong("noise", noise, f"a number above 0 [{quantity.unit}]")
    counts = {len(table.columns[name]) for name in found if name}
    if len(counts) > 1:
        raise RecordingError(f"{part.where}columns: have different numbers of samples")
    times = clock.of(counts.pop(), next(name for name in found if name))
    there = ~np.isnan(times)
    if key.endswith(PLACE):
        values = _places(table, part, found, frame, there)
    elif key.endswith(TURN):
        values = _turns(table, part, found, frame)[there]
    else:
        scale, offset = part.number("scale", 1.0) or 0.0, part.number("offset", 0.0) or 0.0
        values = scale * (_numbers(table, found)[there] + offset)
    part.done()
    return MeasuredPart(key, times[there], values, noise)


def _numbers(table: Table, found: list[str]) -> Float[np.ndarray, "samples numbers"]:
    count = len(table.columns[next(name for name in found if name)])
    nothing = np.full(count, np.nan)
    return np.stack([table.numbers(n, _MISSING) if n else nothing for n in found], 1)


def _places(table: Table, part: Spec, found, frame: SeenFrame | None, there) -> np.ndarray:
    """A marker [m] in the scene's frame, (samples, 3)."""
    if frame is None:
        raise RecordingError(f"{part.where}key: a marker is seen as the tip is: there is no [tip]")
    said = "unit" in part.content
    unit = factor(table, part, "length", [name for name in found if name])
    seen = place_of(table, found, frame.missing, unit if said else frame.unit, frame.turn)[there]
    if frame.samples not in (None, len(seen)):
        raise RecordingError(
            f"{part.where}columns: {len(seen)} samples, and the base markers, which move with each "
            f"of the tip's, have {frame.samples}"
        )
    return frame.moved(seen)


def _turns(table: Table, part: Spec, found, frame: SeenFrame | None) -> np.ndarray:
    """An attitude as a unit quaternion (w, x, y, z) from the section's axes to the scene's,
    (samples, 4); NaN where it is not known."""
    turn = np.eye(3) if frame is None else frame.turn
    body = axes_matrix(part.text("body_axes", "x,y,z"), f"{part.where}body_")
    q = _numbers(table, found)
    size = np.linalg.norm(q, axis=1, keepdims=True)
    far = np.flatnonzero(np.abs(size[:, 0] - 1) > _UNIT)
    seen = size[:, 0] > 0
    for k in far[seen[far]][:1]:
        raise RecordingError(
            f"{table.path}: {table.row(int(k), len(q))}: a quaternion of length {size[k, 0]:.4g}; "
            f"{part.where}columns are w, x, y and z of a unit quaternion"
        )
    q = np.where(size > 0, q / np.where(size > 0, size, 1.0), np.nan)
    before, after = quaternion_of_turn(turn), quaternion_of_turn(body.T)
    before, q, after = (jnp.asarray(x) for x in (before, q, after))
    return np.asarray(quaternion_product(quaternion_product(before, q), after))


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
