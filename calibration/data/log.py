"""The log format of this project: a CSV with SI units in the names of its columns."""

import csv
import re
from array import array
from dataclasses import replace
from os import PathLike
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from calibration.data import dates, units
from calibration.data.carried import at_first, checked_rows, pose_places
from calibration.data.cells import CellError, NumberFormat
from calibration.data.clocks import find_gaps
from calibration.data.loads import without_noise_below_zero
from calibration.data.other_columns import Measured, beside_the_tip, measured_beside
from calibration.data.plausible import Source, check_pulls, check_reach
from calibration.data.recording import TIP_COLUMNS, Recording, RecordingError
from calibration.data.text_files import read_lines
from calibration.data.unseen import at_zero, base_is_zero
from softrod_jax.scene.contacts import contact_names
from softrod_jax.scene.inputs import KINDS, Kind
from softrod_jax.scene.logs import force_columns

# Columns that may stand anywhere after the time.
_ANYWHERE = re.compile(r"pull\d+_")


class _Columns(NamedTuple):
    """Which columns are what: `inputs` by the name of their kind, `tip` none or three of them."""

    inputs: dict[str, list[int]]
    tip: list[int]


def read_log(path: str | PathLike, scene=None, *, need_tip: bool = True) -> Recording:
    """The CSV log in `path`; see `calibration.data.loading.load_recording`.

    Columns, in this order: t_s, tau1_N, tau2_N, .. (a tension per tendon that is driven by
    tension), p1_Pa, .. (a pressure per chamber), tip_x_m, tip_y_m, tip_z_m; and anywhere after the
    time pull1_m, .. (a pull per tendon that is driven by its length). An empty cell, `nan` or `NA`
    is a missing coordinate of the tip; time and inputs must be complete. Places of
    markers may follow, NAME_x_m, NAME_y_m, NAME_z_m, and without a scene are left unread, as
    forces of obstacles always are, NAME_fx_N, NAME_fy_N, NAME_fz_N. Where the base and obstacles
    are carried is anywhere after the time, base_x_m, .., base_qz and NAME_x_m, .., NAME_qz. With a
    scene,
    the columns of `calibration.data.quantities` may be anywhere after the time, and how good they
    are; numbers may be missing there. Rows in messages are lines of the file, the header being row
    1.
    """
    header, columns, values, lines, measured, carried = _table(path, scene, need_tip)
    here = scene if scene is None else at_first(scene, carried)
    _check_values(values, header, columns.tip, lines, path)
    inputs: dict[str, Any] = dict.fromkeys(columns.inputs)
    inputs |= {name: values[:, own] for name, own in columns.inputs.items() if own}
    tip, unseen = values[:, columns.tip], []
    if scene is not None and tip.shape[1]:
        tip, unseen = at_zero(tip, always=base_is_zero(here))
    if need_tip and not np.any(np.isfinite(tip)):
        raise RecordingError(f"{path}: columns {', '.join(TIP_COLUMNS)}: every sample is missing")
    where = lambda i, k: f"{path}: row {lines[k]}, column tau{i + 1}_N"
    clipped = ()
    if inputs["tensions"] is not None:
        tensions, clipped = without_noise_below_zero(list(inputs["tensions"].T), where)
        inputs["tensions"] = np.stack(tensions, axis=1)
    recording = Recording(
        times=values[:, 0],
        **inputs,
        tip_positions=tip if tip.shape[1] else np.full((len(values), 3), np.nan),
        name=Path(path).stem,
        source=str(path),
        notes=(*unseen, *clipped, *_beside(measured)),
        others=measured.others,
        noise=measured.noise,
        carried={} if scene is None else carried,
    )
    source = Source(
        [f"row {line}" for line in lines],
        f"columns {', '.join(TIP_COLUMNS)}",
        unit="with a mapping, [tip] unit",
        origin="with a mapping, [tip] rest = true or origin",
    )
    check_reach(recording, scene, source)
    check_pulls(recording, scene, "is it in millimetres?")
    return replace(recording, notes=(*recording.notes, *_gaps(recording)))


def _beside(measured: Measured) -> list[str]:
    """A note on what else is compared, if there is anything."""
    return [f"measured besides the tip: {', '.join(measured.others)}"] if measured.others else []


def _gaps(recording: Recording) -> list[str]:
    """Notes on rows that are missing."""
    times, notes = recording.track[0], []
    interval = float(np.median(np.diff(times))) if len(times) > 1 else 0.0
    for kind, inputs in recording.driven_by:
        for j, column in enumerate(inputs.T):
            label = kind.column.format(j + 1)
            notes += find_gaps(
                recording.times, column, label, float(np.ptp(inputs)), interval
            ).notes
    return notes


def _table(path, scene, need_tip):
    """Header, which of its columns are what, values (T, columns), lines of the rows, what else was
    measured, and where things are carried."""
    lines, encoding = read_lines(path)
    reader = csv.reader(lines, strict=True)
    header, whole, beside, places = None, [], set(), {}
    values, numbers = array("d"), []
    known, columns = 0, _Columns({}, [])
    missing = NumberFormat()
    try:
        for row in reader:
            if len(row) < 2 and not any(cell.strip() for cell in row):
                continue
            row, line = [cell.strip() for cell in row], reader.line_num
            if header is None:
                whole, beside = row, beside_the_tip(row, scene, path)
                places = pose_places(row, scene, path)
                beside = beside.union(*places.values())
                header = [name for j, name in enumerate(row) if j not in beside]
                known = len(header) - _unread_columns(header, scene)
                columns = _columns(header[:known], path, scene, need_tip, encoding)
                continue
            if len(row) != len(whole):
                raise RecordingError(
                    f"{path}: row {line}: {len(row)} cells, and the header has {len(whole)} columns"
                )
            for name, text in zip(whole, row, strict=True):
                values.append(_number(text, missing, f"{path}: row {line}, column {name}", name))
            numbers.append(line)
    except csv.Error as e:
        raise RecordingError(f"{path}: row {reader.line_num}: not a CSV file: {e}") from None
    if header is None:
        raise RecordingError(
            f"{path}: empty: expected a header row t_s, .., {', '.join(TIP_COLUMNS)}"
        )
    if not numbers:
        raise RecordingError(f"{path}: a header and no rows: nothing was recorded")
    table = np.array(values).reshape(len(numbers), len(whole))
    others = beside.difference(*places.values())
    measured = measured_beside({whole[j]: table[:, j] for j in others}, scene, path)
    carried = {
        name: checked_rows(name, table[:, own], numbers, path)
        for name, own in places.items()
        if scene is not None
    }
    table = np.delete(table, list(beside), axis=1)
    return header[:known], columns, table[:, :known], numbers, measured, carried


def _unread_columns(header: list[str], scene) -> int:
    """How many columns at the end are places of markers, or forces of obstacles, of the scene."""
    if scene is None:
        markers = [end[1] for end in _ending(header, "_z_m") if end[1] != "tip"]
        obstacles = [end[1] for end in _ending(header, "_fz_N")]
    else:
        markers = [marker.name for marker in scene.markers or ()]
        obstacles = contact_names(scene.contacts)
    triples = {tuple(f"{name}_{axis}_m" for axis in "xyz") for name in markers}
    triples |= {tuple(force_columns(name)) for name in obstacles}
    count = 0
    while tuple(header[len(header) - count - 3 : len(header) - count]) in triples:
        count += 3
    return count


def _ending(header: list[str], end: str) -> list[re.Match]:
    """Names that end so; the first group is what is before."""
    found = [re.fullmatch(rf"([A-Za-z]\w*){end}", name) for name in header]
    return [match for match in found if match]


def _columns(header, path, scene, need_tip, encoding) -> _Columns:
    """Which columns are what; anything but the format is an error."""
    for sign, name in ((";", "';'"), ("\t", "tabs")):
        if len(header) == 1 and sign in header[0]:
            raise RecordingError(
                f"{path}: row 1: cells are separated by {name}, expected commas; a mapping reads "
                f"it: softrod import {path}"
            )
    inputs = {kind.name: _named(kind, _count(kind, header, scene)) for kind in KINDS}
    tip = TIP_COLUMNS if need_tip or any(name.startswith("tip") for name in header) else []
    expected = ["t_s", *(name for own in inputs.values() for name in own), *tip]
    problem = _unlike(header, expected)
    if problem is None:
        place = header.index
        return _Columns({k: [*map(place, own)] for k, own in inputs.items()}, [*map(place, tip)])
    whose = "expected"
    if scene is not None:
        # That nothing is driven by its length is worth no word.
        said = [k for k in KINDS if inputs[k.name] or k.control != "length"]
        parts = [f"{len(inputs[kind.name])} {kind.of(scene)}" for kind in said]
        whose = f"the scene has {', '.join(parts[:-1])} and {parts[-1]}, so expected"
    letters = "" if encoding.startswith("utf") else f"; it is not UTF-8, and was read as {encoding}"
    raise RecordingError(
        f"{path}: row 1: {problem} ({whose} {', '.join(expected)}){letters}; a mapping reads "
        f"other tables: softrod import {path}"
    )


def _named(kind: Kind, count: int) -> list[str]:
    return [kind.column.format(i + 1) for i in range(count)]


def _count(kind: Kind, header: list[str], scene) -> int:
    """How many columns of a kind are expected: those of the scene or, without one, of the log."""
    if scene is not None:
        return kind.count(scene)
    beginning = kind.column.partition("{}")[0]
    return sum(
        name.startswith(beginning)
        # Every pull begins as a pressure does.
        and not (beginning == "p" and _ANYWHERE.match(name))
        for name in header
    )


def _unlike(header: list[str], expected: list[str]) -> str | None:
    """In what a header is not the expected one: the first such column, or none."""
    placed = [(j, name) for j, name in enumerate(header) if j == 0 or not _ANYWHERE.match(name)]
    fixed = [name for name in expected if not _ANYWHERE.match(name)]
    for k, wanted in enumerate(fixed):
        if k >= len(placed):
            return f"column {wanted} is missing"
        j, name = placed[k]
        if name != wanted:
            problem = f"column {j + 1} is {name[:60]!r}, expected {wanted!r}"
            return problem + _other_unit(name, wanted)
    if len(placed) > len(fixed):
        j, name = placed[len(fixed)]
        return f"column {j + 1} is {name[:60]!r}, one too many"
    free = [(j, name) for j, name in enumerate(header) if j > 0 and _ANYWHERE.match(name)]
    for wanted in expected:
        if _ANYWHERE.match(wanted) and wanted not in header:
            alike = (_other_unit(name, wanted) for _, name in free)
            return f"column {wanted} is missing" + next(filter(None, alike), "")
    for j, name in free:
        if name not in expected or name in header[:j]:
            return f"column {j + 1} is {name[:60]!r}, one too many"
    return None


def _other_unit(name: str, wanted: str) -> str:
    """What to do where a column is the wanted quantity in another unit."""
    quantity, _, unit = wanted.rpartition("_")
    alike = name.rsplit("_", 1)[0] == quantity
    return f"; convert it to {unit} and rename it" if alike else ""


def _number(text: str, missing: NumberFormat, where: str, column: str) -> float:
    try:
        return missing.read(text)
    except CellError as e:
        hint = f"; {e}" if str(e) and str(e) != "not finite" else ""
        if dates.looks_like_one(text):
            hint = "; a date: with a mapping, [time] column reads it"
        elif column in TIP_COLUMNS and not hint:
            hint = "; leave the cell empty if the sample is missing"
        elif units.is_unit(text):
            hint = "; is this a row of units? delete it, the header has them"
        shown = text if len(text) <= 60 else text[:57] + "..."
        raise RecordingError(f"{where}: {shown!r} is not a finite number{hint}") from None


def _check_values(values, header, tip, lines, path) -> None:
    missing = np.isnan(values)
    missing[:, tip] = False
    for k, j in np.argwhere(missing)[:1]:
        raise RecordingError(
            f"{path}: row {lines[k]}, column {header[j]}: missing; time and inputs are needed in "
            "every row (only the tip may be missing): fill it in or delete the row"
        )
    steps = np.diff(values[:, 0])
    for k in np.flatnonzero(steps <= 0)[:1]:
        what = "is repeated" if steps[k] == 0 else f"follows {float(values[k, 0])!r}"
        raise RecordingError(
            f"{path}: row {lines[k + 1]}, column t_s: {float(values[k + 1, 0])!r} {what}; time "
            "must increase from row to row: sort the rows and delete repeated ones"
        )
