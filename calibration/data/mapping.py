"""Mapping files: from somebody's columns, units and axes to a `Recording`.

    [time]
    column = "Time"                     # or rate = 100.0 [Hz]; a motion capture knows its own
    unit = "ms"
    offset = -1704448800.0              # added first, in the file's unit
    format = "%d/%m/%Y %H:%M:%S.%f"     # of dates; not needed for 2024-01-05 or 05.01.2024
    [tip]
    columns = ["X", "Y", "Z"]           # or markers = [["a.x", "a.y", "a.z"], ..]: their mean;
                                        # "" for a coordinate that was not measured
    positions = [[0.01, 0, 0], ..]      # m, of three markers or more: where each is, seen from the
                                        # middle of the tip, along the axes of its section; the tip
                                        # is then fitted to them, and not their mean
    unit = "mm"
    axes = "-y,x,z"                     # which axes of the file are the scene's x, y, z
    missing = -9999.0                   # what stands for a sample that was not seen; or [0, -9999]
    origin = [0.0, 12.0, 250.0]         # the clamp in the file's axes and unit; or rest = true:
                                        # put the rest at the beginning at the straight tip
    [[tensions]]                        # one for each tendon driven by tension, as in the scene
    column = "Load cell 1"
    unit = "gf"
    offset = -12.0                      # added first, in the file's unit
    scale = 1.0                         # then multiplied with: units a volt of a sensor, or -1
    time = { column = "t_daq", unit = "s" }  # if it has a clock of its own
    [[pressures]]
    column = "P"
    unit = "kPa"
                                        # of what was commanded and not recorded: column is absent,
    steps = [[1.2, 20.0], [4.2, 0.0]]   # and from each time [s] on the value; before them it is 0
    [[pulls]]                           # one for each tendon that is driven by its length
    column = "Motor 1"
    unit = "mm"                         # of an angle in rad: scale = the pulley's radius in m
    [[base_markers]]                    # three or more: the frame is fitted to them
    columns = ["b1.x", "b1.y", "b1.z"]
    position = [0.02, 0.0, 0.0]         # m, where the marker is in the scene's frame
    [[measured]]                        # what else was, as calibration/data/quantities.py has it
    key = "base_force"
    columns = ["Fx", "Fy", "Fz"]        # "" for one that was not; offset, scale (to SI) and time as
                                        # of tensions
    noise = 0.02                        # N
    [conditions]                        # in what this experiment differs from the scene
    payload_mass = 0.052
    [trials]                            # of a file that holds several, each a recording
    column = "run"                      # rows with the same number or text belong together
    only = [1, 3]                       # which of them; absent: all
                                        # or windows = [[0.0, 3.5], [10.0, 14.0]]: start and end [s]
    [csv]                               # of text files
    delimiter = ";"                     # or "tab", "space"; found if absent, as the next three
    skip_rows = 3                       # lines before the header
    header = true                       # false if there is none: columns are then called 1, 2, ..
    encoding = "cp1252"
    decimal = ","
    thousands = "."
    missing = ["n.d.", "x"]             # cells that stand for nothing, beside NA, nan, - and so on

Where the file says its units (a C3D, Motive, a row of units below the header, `X [mm]`), `unit`
may be left out, and is an error if it says another; `ignore_file_unit = true` beside it overrules
the file. A sample of the tip at exactly (0, 0, 0) is one that was not seen. `softrod import` writes
such a file from what it finds.
"""

from dataclasses import replace
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from calibration.data import units
from calibration.data.cells import NumberFormat
from calibration.data.clocks import check_overlap, find_gaps
from calibration.data.frames import axes_matrix, check_one_body, from_base_markers, from_rest
from calibration.data.loads import without_noise_below_zero
from calibration.data.mapped_columns import (
    TimeColumn,
    check_interval,
    factor,
    one_zero,
    stepped,
    steps_of,
)
from calibration.data.mapped_measured import at_samples, measured_parts
from calibration.data.mapping_file import Spec, read_toml
from calibration.data.plausible import Source, check_pulls, check_reach
from calibration.data.recording import Recording, RecordingError
from calibration.data.rigid import tip_of_body
from calibration.data.table import Table
from calibration.data.tables import read_table
from calibration.data.text_tables import TextOptions
from calibration.data.trials import cut, trials_of
from calibration.data.unseen import at_zero, base_is_zero
from softrod_jax.scene.inputs import KINDS

_FILL = "fill it in or delete the row"


def read_mapped(
    path: str | PathLike, mapping: str | PathLike, scene=None, need_tip: bool = True
) -> list[Recording]:
    """The recordings in `path`, as the mapping file `mapping` describes it; for `scene`. There is
    one unless [trials] divides the file.

    Without a scene nothing is compared with the rod, and `[tip] rest` has no meaning. With
    `need_tip=False` the mapping may have no `[tip]`: inputs alone.

    Raises `RecordingError` naming file, row, column, value and remedy; for a mapping that cannot
    be, naming its key.
    """
    spec = read_toml(mapping)
    table = read_table(path, _text_options(spec.table("csv", required=False)))
    trials = trials_of(table, spec.table("trials", required=False))
    found = [_read(path, mapping, part, label, scene, need_tip) for label, part in trials.parts]
    return [part for recording in found for part in cut(recording, trials.windows)]


def _read(path, mapping, table: Table, label: str, scene, need_tip: bool) -> Recording:
    """The recording in the table, which is all of the file or its trial `label`."""
    spec = read_toml(mapping)
    # Read already: how the file is written, and what of it this is.
    spec.asked |= {"csv", "trials"}
    clock = TimeColumn(table, spec.table("time", required=table.interval is None))
    part = spec.table("tip", required=need_tip)
    seen = _tip(table, spec, part, clock, scene) if part.content else None
    inputs = {
        kind.name: [_input(table, part, kind.quantity, clock) for part in spec.tables(kind.name)]
        for kind in KINDS
    }
    measured = measured_parts(table, spec, clock, scene)
    conditions = spec.table("conditions", required=False).numbers()
    spec.done()
    if scene is not None:
        _check_counts(mapping, inputs, scene)
    tip, clock_of_tip, notes, placed, source = seen or _without_tip(mapping, inputs)
    clocks = [clock_of_tip, *(x.times for x in measured)]
    clocks, dated = one_zero(path, [*clocks, *(x[1] for p in inputs.values() for x in p)])
    clock_of_tip, others = clocks[0], iter(clocks[1:])
    measured = [replace(x, times=next(others)) for x in measured]
    inputs = {
        name: [(part, next(others), *rest) for part, _, *rest in parts]
        for name, parts in inputs.items()
    }
    check_interval(
        path, mapping, clock_of_tip[np.any(np.isfinite(tip), axis=1)] if seen else clock_of_tip
    )
    gaps, said = _clocks_of(path, clock_of_tip, tip, inputs)
    times, merged, columns, clipped = _merged(path, clock_of_tip, tip, inputs)
    beside, noise = at_samples(measured, times)
    recording = Recording(
        times=times,
        **columns,
        others=beside,
        noise=noise,
        tip_positions=merged,
        name=f"{Path(path).stem}-{label}" if label else Path(path).stem,
        source=str(path),
        origin_known=placed is None,
        placed=placed,
        notes=(*table.notes, *dated, *notes, *clipped, *said),
        conditions=conditions,
        gaps=gaps,
    )
    if seen and not np.any(recording.has_tip):
        raise RecordingError(
            f"{path}: {source.columns}: every sample is missing; name others in [tip] columns"
        )
    names = dict(zip(clock_of_tip.tolist(), source.labels, strict=True))
    check_reach(
        recording, scene, replace(source, labels=[names.get(t, "") for t in times.tolist()])
    )
    check_pulls(recording, scene, "check [[pulls]] unit, scale and offset")
    return recording


def _text_options(spec: Spec) -> TextOptions:
    decimal = spec.text("decimal", None)
    if decimal not in (None, ".", ","):
        raise spec.wrong("decimal", decimal, "'.' or ','")
    thousands = spec.character("thousands", None, {"space": " "})
    delimiter = spec.character("delimiter", None, {"tab": "\t", "space": " ", "\\t": "\t"})
    if thousands is not None and (thousands == (decimal or ".") or thousands.isalnum()):
        raise spec.wrong("thousands", thousands, "another sign than the decimal one, no digit")
    if delimiter is not None and (delimiter.isalnum() or delimiter in "+-."):
        raise spec.wrong("delimiter", delimiter, "a sign that is in no number")
    missing = frozenset(str(x).strip().lower() for x in spec.scalars("missing"))
    options = TextOptions(
        delimiter=delimiter,
        skip=spec.whole("skip_rows", None),
        header=spec.flag("header", True),
        numbers=NumberFormat(decimal, thousands, missing),
        encoding=spec.text("encoding", None),
    )
    spec.done()
    return options


def _without_tip(mapping, inputs):
    """What `_tip` gives, of a file that has none: on the clock of the first input."""
    times = next((parts[0][1] for parts in inputs.values() if parts), None)
    if times is None:
        raise RecordingError(f"{mapping}: neither [tip] nor inputs: nothing would be read")
    nothing = Source([""] * len(times), "no columns", "[tip] unit", None)
    return np.full((len(times), 3), np.nan), times, (), None, nothing


def _tip(table: Table, spec: Spec, part: Spec, clock: TimeColumn, scene):
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
    place = lambda names: _place(table, names, missing, unit, turn)
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
    if seen:
        tip, note = from_base_markers(tip, seen, meant, spec.where)
        notes += note
    elif origin is not None:
        tip = tip - turn @ (unit * origin)
    if rest:
        tip, placed_by, note = from_rest(tip, scene, table.path)
        notes.append(note)
    now = next(name for name, size in units.UNITS["length"].items() if np.isclose(size, unit))
    source = Source(
        [label for label, use in zip(labels, there, strict=True) if use],
        f"columns {', '.join(name or '(none)' for name in found[0])}",
        unit="[tip] unit",
        origin=None if rest or seen else "[tip] rest = true, or the clamp as [tip] origin",
        now=now,
    )
    return tip, at[there], notes, placed_by, source


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


def _place(table: Table, names, missing, unit, turn) -> np.ndarray:
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


def _input(table: Table, part: Spec, kind: str, clock: TimeColumn):
    """Name, times and values [SI] of one actuator, without missing samples; labels, time's key."""
    own = part.table("time", required=False)
    clock = TimeColumn(table, own) if own.content else clock
    steps = steps_of(part)
    if steps is None:
        name = table.find(part.text("column"), key=f"{part.where}column")
        values = table.numbers(name, f"inputs are needed in every row: {_FILL}")
        times = clock.of(len(values), name)
    else:
        name = f"{part.where}steps"
        times = clock.of(max(len(x) for x in table.columns.values()), name)
        values = stepped(part, steps, times)
    given = part.number("scale", None)
    scale, offset = 1.0 if given is None else given, part.number("offset", 0.0)
    own = [] if steps is not None else [name]
    values = factor(table, part, kind, own, given is not None) * scale * (values + offset)
    part.done()
    there = ~np.isnan(times)
    for k in np.flatnonzero(there & ~np.isfinite(values))[:1]:
        raise RecordingError(
            f"{table.path}: {table.row(k, len(values))}, column {name}: missing; inputs are "
            f"needed in every row (only the tip may be missing): {_FILL}"
        )
    if not np.any(there):
        raise RecordingError(
            f"{table.path}: column {name}: no sample has a time; say its clock in {part.where}time"
        )
    labels = [table.row(int(k), len(values)) for k in np.flatnonzero(there)]
    return name, times[there], values[there], labels, f"{part.where}time."


def _check_counts(mapping, inputs, scene) -> None:
    for kind in KINDS:
        count, given = kind.count(scene), len(inputs[kind.name])
        if given not in (0, count):
            raise RecordingError(
                f"{mapping}: {kind.name}: {given} given, and the scene has {count} "
                f"{kind.of(scene)}; one for each is needed"
            )


def _clocks_of(path, clock, tip, inputs):
    """Where inputs are not known, and notes."""
    gaps, notes = [], []
    known = clock[np.any(np.isfinite(tip), axis=1)]
    if not len(known):
        return (), ()
    interval = float(np.median(np.diff(known))) if len(known) > 1 else 0.0
    for parts in inputs.values():
        whole = max((np.ptp(values) for _, _, values, *_ in parts), default=0.0)
        for name, times, values, _, key in parts:
            notes += check_overlap(path, name, times, known, key)
            found = find_gaps(times, values, name, whole, interval)
            gaps += found.open
            notes += found.notes
    return tuple(sorted(set(gaps))), notes


def _merged(path, clock, tip, inputs):
    """One clock for all: every time at which anything was sampled. Inputs change linearly."""
    others = [times for parts in inputs.values() for _, times, *_ in parts]
    times = np.unique(np.concatenate([clock, *others]))
    all_tips = np.full((len(times), 3), np.nan)
    all_tips[np.searchsorted(times, clock)] = tip
    clipped = ()
    tensions = inputs["tensions"]
    if tensions:
        where = lambda i, k: f"{path}: {tensions[i][3][k]}, column {tensions[i][0]}"
        values, clipped = without_noise_below_zero([x[2] for x in tensions], where)
        tensions = [(x[0], x[1], v) for x, v in zip(tensions, values, strict=True)]
        inputs = {**inputs, "tensions": tensions}
    columns: dict[str, Any] = {
        name: np.stack([np.interp(times, x[1], x[2]) for x in parts], axis=1) if parts else None
        for name, parts in inputs.items()
    }
    return times, all_tips, columns, clipped
