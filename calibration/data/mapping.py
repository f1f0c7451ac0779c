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
    before = 0.0                        # what it was, in the file's unit, before the first sample
    file = "commands.csv"               # if it is in another file of the same folder, whose clock
                                        # is described by [time], or by its own time
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
    [[measured]]                        # a marker of the scene, seen as the tip is: axes, origin
    key = "middle_position"             # and unit are those of [tip], or unit its own
    columns = ["X2", "Y2", "Z2"]
    [[measured]]                        # how it, or the tip, was turned: w, x, y, z
    key = "middle_attitude"
    columns = ["Q2w", "Q2x", "Q2y", "Q2z"]
    body_axes = "x,z,-y"                # which axes of the body are those of the section
    [conditions]                        # in what this experiment differs from the scene
    payload_mass = 0.052
    [trials]                            # of a file that holds several, each a recording
    column = "run"                      # rows with the same number or text belong together
    only = [1, 3]                       # which of them; absent: all
                                        # or axis = 3: along which axis, counted from 1, arrays of
                                        # three dimensions of a MAT or HDF5 file have trials
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

from calibration.data.cells import NumberFormat
from calibration.data.clocks import check_overlap, find_gaps
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
from calibration.data.mapped_tip import mapped_tip
from calibration.data.mapping_file import Spec, read_toml
from calibration.data.plausible import Source, check_pulls, check_reach
from calibration.data.recording import Recording, RecordingError
from calibration.data.table import Table
from calibration.data.tables import read_table
from calibration.data.text_tables import TextOptions
from calibration.data.trials import cut, trial_axis, trials_of
from softrod_jax.scene.inputs import KINDS

# Part of an interval in which a command jumps.
_JUMP = 1e-3
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
    axis = trial_axis(spec.table("trials", required=False))
    table = read_table(path, _text_options(spec.table("csv", required=False)), axis)
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
    seen = mapped_tip(table, spec, part, clock, scene) if part.content else None
    other = _OtherFiles(path, spec)
    one = lambda part, quantity: _input(
        *other.table_and_clock(part, table, clock, label), part=part, kind=quantity
    )
    inputs = {
        kind.name: [one(part, kind.quantity) for part in spec.tables(kind.name)] for kind in KINDS
    }
    measured = measured_parts(table, spec, clock, scene, None if seen is None else seen.frame)
    conditions = spec.table("conditions", required=False).numbers()
    spec.done()
    if scene is not None:
        _check_counts(mapping, inputs, scene)
    if seen is None:
        tip, clock_of_tip, notes, placed, source = _without_tip(mapping, inputs)
    else:
        tip, clock_of_tip, notes = seen.positions, seen.times, seen.notes
        placed, source = seen.placed, seen.source
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
    """Tip, its times, notes and source of a file that has none: on the clock of the first input."""
    times = next((parts[0][1] for parts in inputs.values() if parts), None)
    if times is None:
        raise RecordingError(f"{mapping}: neither [tip] nor inputs: nothing would be read")
    nothing = Source([""] * len(times), "no columns", "[tip] unit", None)
    return np.full((len(times), 3), np.nan), times, (), None, nothing


class _OtherFiles:
    """Files beside a recording, in which inputs were written, each read once."""

    def __init__(self, path, spec: Spec):
        self.folder, self.spec, self.read = Path(path).parent, spec, {}

    def table_and_clock(
        self, part: Spec, table: Table, clock: TimeColumn, label: str
    ) -> tuple[Table, TimeColumn]:
        """The table of the input `part` and its clock: those of the recording, unless `file` names
        another file, whose clock [time] describes as well."""
        name = part.text("file", None)
        if name is None:
            return table, clock
        if label:
            raise RecordingError(
                f"{part.where}file: the trials of a file have inputs in columns of their own"
            )
        if name not in self.read:
            content = self.spec.content
            beside = read_table(
                self.folder / name, _text_options(Spec(content.get("csv", {}), self.spec.where))
            )
            own = Spec(part.content.get("time", content.get("time", {})), f"{part.where}time.")
            self.read[name] = beside, TimeColumn(beside, own)
        return self.read[name]


def _input(table: Table, clock: TimeColumn, *, part: Spec, kind: str):
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
    before = part.number("before", None)
    given = part.number("scale", None)
    scale, offset = 1.0 if given is None else given, part.number("offset", 0.0) or 0.0
    own = [] if steps is not None else [name]
    unit = factor(table, part, kind, own, given is not None) * scale
    values = unit * (values + offset)
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
    times, values = times[there], values[there]
    if before is not None:
        # One sample earlier, and held until next to the first one, at which it jumps.
        lead = times[0] - (times[1] - times[0]) * np.array([1.0, _JUMP]) if len(times) > 1 else []
        times = np.concatenate([np.asarray(lead, times.dtype), times])
        values = np.concatenate([[unit * (before + offset)] * len(lead), values])
        labels = [*[f"before {labels[0]}"] * len(lead), *labels]
    return name, times, values, labels, f"{part.where}time."


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
