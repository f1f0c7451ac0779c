"""The tip as a mapping describes it, and the frame in which it and other markers were seen."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from calibration.data import units
from calibration.data.frames import axes_matrix, check_one_body, from_base_markers, from_rest
from calibration.data.mapped_columns import TimeColumn, factor
from calibration.data.mapping_file import Spec
from calibration.data.plausible import Source
from calibration.data.recording import RecordingError
from calibration.data.rigid import tip_of_body
from calibration.data.table import Table
from calibration.data.unseen import at_zero, base_is_zero


@dataclass(frozen=True, eq=False)
class SeenFrame:
    """How what a camera saw gets into the scene's frame, as the tip does.

    - `turn`: from the file's axes to the scene's. `unit` [m]: that of the tip.
    - `moved`: places [m] in the scene's axes, (samples, 3), in the scene's frame.
    - `missing`: numbers that stand for a sample that was not seen.
    - `samples`: how many a marker must have, where base markers move with each; else None.
    """

    turn: Float[np.ndarray, "3 3"]
    unit: float
    moved: Callable[[np.ndarray], np.ndarray]
    missing: tuple
    samples: int | None


@dataclass(frozen=True, eq=False)
class SeenTip:
    """The tip's `positions` [m], (samples, 3), at `times`.

    `notes`: what was assumed. `placed` [m]: what was added where the rest gave the origin.
    `source`: for messages. `frame`: that of other markers.
    """

    positions: Float[np.ndarray, "samples 3"]
    times: np.ndarray
    notes: list[str]
    placed: np.ndarray | None
    source: Source
    frame: SeenFrame


def mapped_tip(table: Table, spec: Spec, part: Spec, clock: TimeColumn, scene) -> SeenTip:
    """The tip as the table [tip], `part`, of a mapping `spec` says. Raises `RecordingError`."""
    own = part.table("time", required=False)
    clock = TimeColumn(table, own) if own.content else clock
    key, triples = _triples(part)
    missing = part.scalars("missing")
    turn = axes_matrix(part.text("axes", "x,y,z"), part.where)
    origin, rest = part.vector("origin", required=False), part.flag("rest")
    positions = _positions(part, triples if key.endswith("markers") else None)
    if origin is not None and rest:
        raise RecordingError(f"{part.where}origin and {part.where}rest: one of them is too much")
    if rest and scene is None:
        raise RecordingError(
            f"{part.where}rest = true: puts the rest at the scene's straight tip: give the scene"
        )
    found = [[table.find(name, "tip", key) if name else "" for name in names] for names in triples]
    unit = factor(table, part, "length", [name for names in found for name in names if name])
    part.done()
    place = lambda names: place_of(table, names, missing, unit, turn)
    placed = [place(names) for names in found]
    count = len(placed[0])
    at = clock.of(count, next(name for name in found[0] if name))
    labels = [table.row(k, count) for k in range(count)]
    if any(len(p) != count for p in placed):
        raise RecordingError(
            f"{part.where}markers: their columns have different numbers of samples"
        )
    if scene is not None:
        check_one_body(table.path, np.stack(placed, axis=1), [names[0] for names in found], scene)
    seen, meant = _base_markers(table, spec, place, count)
    notes, placed_by = [], None
    always = origin is None and not rest and not seen and scene is not None and base_is_zero(scene)
    for several in (placed, seen):
        for k, p in enumerate(several):
            several[k], note = at_zero(p, always=always)
            notes += note
    there = ~np.isnan(at)
    tip = np.mean(placed, axis=0)
    if positions is not None:
        tip, note = tip_of_body(np.stack(placed, axis=1), positions, part.where)
        notes.append(note)
    tip, seen = tip[there], [s[there] for s in seen]
    moved = lambda p: p
    if seen:
        tip, note = from_base_markers(tip, seen, meant, spec.where)
        notes += note
        moved = lambda p: from_base_markers(p, seen, meant, spec.where)[0]
    elif origin is not None:
        moved = lambda p: p - turn @ (unit * origin)
        tip = moved(tip)
    if rest:
        tip, placed_by, note = from_rest(tip, scene, table.path)
        notes.append(note)
        before = moved
        moved = lambda p: before(p) + placed_by
    now = next(name for name, size in units.UNITS["length"].items() if np.isclose(size, unit))
    source = Source(
        [label for label, use in zip(labels, there, strict=True) if use],
        f"columns {', '.join(name or '(none)' for name in found[0])}",
        unit="[tip] unit",
        origin=None if rest or seen else "[tip] rest = true, or the clamp as [tip] origin",
        now=now,
    )
    frame = SeenFrame(turn, unit, moved, tuple(missing), len(tip) if seen else None)
    return SeenTip(tip, at[there], notes, placed_by, source, frame)


def _triples(part: Spec) -> tuple[str, list[list[str]]]:
    """The key that names the tip's columns, and those of each marker, 3 each."""
    columns = part.texts("columns", 3, required=False)
    markers = part.get("markers", list, "a list of lists of 3 column names", None, False)
    if (columns is None) == (markers is None):
        raise RecordingError(f"{part.where}columns or {part.where}markers: one of them is needed")
    triples = [columns] if columns is not None else markers or [[]]
    text = lambda names: isinstance(names, list) and all(isinstance(x, str) for x in names)
    for names in triples:
        if not (text(names) and len(names) == 3 and any(names)):
            raise part.wrong("markers", names, "3 column names, at least one not empty")
    return f"{part.where}{'columns' if columns is not None else 'markers'}", triples


def _positions(part: Spec, markers) -> np.ndarray | None:
    """Where the markers are on the tip, (markers, 3) [m]; None if that is not said."""
    what = "a list of 3 finite numbers for each of the markers"
    given = part.get("positions", list, what, None, False)
    if given is None:
        return None
    real = lambda x: isinstance(x, int | float) and not isinstance(x, bool) and abs(x) < np.inf
    whole = all(isinstance(p, list) and len(p) == 3 and all(map(real, p)) for p in given)
    if not whole or markers is None or len(given) != len(markers):
        raise part.wrong("positions", given, what)
    return np.array(given, dtype=float)


def _base_markers(table: Table, spec: Spec, place, count: int):
    """Where markers on the clamp were seen, (T, 3) [m] each, and where they are meant to be."""
    seen, meant = [], []
    for marker in spec.tables("base_markers"):
        columns = marker.texts("columns", 3)
        names = [table.find(name, "base", f"{marker.where}columns") for name in columns]
        seen.append(place(names))
        meant.append(marker.vector("position"))
        marker.done()
        if len(seen[-1]) != count:
            raise RecordingError(
                f"{marker.where}columns: {len(seen[-1])} samples, the tip has {count}"
            )
    return seen, meant


def place_of(table: Table, names, missing, unit, turn) -> np.ndarray:
    """A marker (T, 3) [m] in the scene's axes; NaN where it, or a coordinate, was not seen."""
    count = len(table.columns[next(name for name in names if name)])
    if any(name and len(table.columns[name]) != count for name in names):
        raise RecordingError(
            f"{table.path}: columns {', '.join(names)}: have different lengths; name others in "
            "[tip] columns"
        )
    leave = "leave the cell empty if the sample is missing, or name its text in [csv] missing"
    xyz = np.full((count, 3), np.nan)
    for i, name in enumerate(names):
        if name:
            values = table.numbers(name, leave)
            marks = [m for m in missing if not isinstance(m, str)]
            xyz[:, i] = np.where(np.isin(values, marks), np.nan, values)
    # The matrix has one entry in each row: NaN times zero must not spread to other axes.
    return unit * np.stack([sign * xyz[:, i] for i, sign in _picked(turn)], axis=1)


def _picked(turn):
    return [(int(np.argmax(np.abs(row))), float(np.sum(row))) for row in turn]
