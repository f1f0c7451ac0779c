"""The log format of this project: a CSV with SI units in the names of its columns."""

import csv
import re
from array import array
from dataclasses import replace
from os import PathLike
from pathlib import Path

import numpy as np

from calibration.data import dates, units
from calibration.data.cells import CellError, NumberFormat
from calibration.data.clocks import find_gaps
from calibration.data.loads import without_noise_below_zero
from calibration.data.plausible import Source, check_reach
from calibration.data.recording import TIP_COLUMNS, Recording, RecordingError
from calibration.data.text_files import read_lines
from calibration.data.unseen import at_zero, base_is_zero


def read_log(path: str | PathLike, scene=None, *, need_tip: bool = True) -> Recording:
    """The CSV log in `path`; see `calibration.data.loading.load_recording`.

    Columns, in this order: t_s, tau1_N, tau2_N, .. (a tension per tendon), p1_Pa, .. (a
    pressure per chamber), tip_x_m, tip_y_m, tip_z_m. An empty cell, `nan` or `NA` is a missing
    coordinate of the tip; time and inputs must be complete. Places of the scene's markers may
    follow, NAME_x_m, NAME_y_m, NAME_z_m, and are left unread. Rows in messages are lines of the
    file, the header being row 1.
    """
    header, tendons, chambers, values, lines = _table(path, scene, need_tip)
    _check_values(values, header, lines, path)
    tip, unseen = values[:, 1 + tendons + chambers :], []
    if scene is not None and tip.shape[1]:
        tip, unseen = at_zero(tip, always=base_is_zero(scene))
    if need_tip and not np.any(np.isfinite(tip)):
        raise RecordingError(f"{path}: columns {', '.join(TIP_COLUMNS)}: every sample is missing")
    where = lambda i, k: f"{path}: row {lines[k]}, column tau{i + 1}_N"
    tensions, clipped = without_noise_below_zero(list(values[:, 1 : 1 + tendons].T), where)
    recording = Recording(
        times=values[:, 0],
        tensions=np.stack(tensions, axis=1) if tendons else None,
        pressures=values[:, 1 + tendons : 1 + tendons + chambers] if chambers else None,
        tip_positions=tip if tip.shape[1] else np.full((len(values), 3), np.nan),
        name=Path(path).stem,
        source=str(path),
        notes=(*unseen, *clipped),
    )
    source = Source(
        [f"row {line}" for line in lines],
        f"columns {', '.join(TIP_COLUMNS)}",
        unit="with a mapping, [tip] unit",
        origin="with a mapping, [tip] rest = true or origin",
    )
    check_reach(recording, scene, source)
    return replace(recording, notes=(*recording.notes, *_gaps(recording)))


def _gaps(recording: Recording) -> list[str]:
    """Notes on rows that are missing."""
    times, notes = recording.track[0], []
    interval = float(np.median(np.diff(times))) if len(times) > 1 else 0.0
    for name, unit, inputs in (
        ("tau", "N", recording.tensions),
        ("p", "Pa", recording.pressures),
    ):
        if inputs is None:
            continue
        for j, column in enumerate(inputs.T):
            label = f"{name}{j + 1}_{unit}"
            notes += find_gaps(
                recording.times, column, label, float(np.ptp(inputs)), interval
            ).notes
    return notes


def _table(path, scene, need_tip):
    """Header, numbers of tendons and chambers, values (T, columns) and each row's line in the
    file."""
    lines, encoding = read_lines(path)
    reader = csv.reader(lines, strict=True)
    header, values, numbers = None, array("d"), []
    known, tendons, chambers = 0, 0, 0
    missing = NumberFormat()
    try:
        for row in reader:
            if len(row) < 2 and not any(cell.strip() for cell in row):
                continue
            row, line = [cell.strip() for cell in row], reader.line_num
            if header is None:
                header = row
                known = len(header) - _marker_columns(header, scene)
                tendons, chambers = _check_header(header[:known], path, scene, need_tip, encoding)
                continue
            if len(row) != len(header):
                raise RecordingError(
                    f"{path}: row {line}: {len(row)} cells, and the header has {len(header)} "
                    "columns"
                )
            for name, text in zip(header, row, strict=True):
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
    table = np.array(values).reshape(len(numbers), len(header))
    return header[:known], tendons, chambers, table[:, :known], numbers


def _marker_columns(header: list[str], scene) -> int:
    """How many columns at the end are places of markers of the scene, which are not used."""
    if scene is None:
        ends = [re.fullmatch(r"([A-Za-z]\w*)_z_m", name) for name in header]
        names = [end[1] for end in ends if end and end[1] != "tip"]
    else:
        names = [marker.name for marker in scene.markers or ()]
    count, triples = 0, {tuple(f"{name}_{axis}_m" for axis in "xyz") for name in names}
    while tuple(header[len(header) - count - 3 : len(header) - count]) in triples:
        count += 3
    return count


def _check_header(header, path, scene, need_tip, encoding) -> tuple[int, int]:
    """The numbers of tension and of pressure columns; anything but the format is an error."""
    for sign, name in ((";", "';'"), ("\t", "tabs")):
        if len(header) == 1 and sign in header[0]:
            raise RecordingError(
                f"{path}: row 1: cells are separated by {name}, expected commas; a mapping reads it"
            )
    if scene is None:
        tendons = sum(name.startswith("tau") for name in header)
        chambers = sum(name.startswith("p") for name in header)
        whose = "expected"
    else:
        tendons = 0 if scene.tendons is None else scene.tendons.count
        chambers = 0 if scene.chambers is None else scene.chambers.count
        whose = f"the scene has {tendons} tendons and {chambers} chambers, so expected"
    expected = ["t_s"]
    expected += [f"tau{i + 1}_N" for i in range(tendons)]
    expected += [f"p{i + 1}_Pa" for i in range(chambers)]
    if need_tip or any(name.startswith("tip") for name in header):
        expected += TIP_COLUMNS
    if header == expected:
        return tendons, chambers
    for j, wanted in enumerate(expected):
        if j >= len(header):
            problem = f"column {wanted} is missing"
            break
        if header[j] != wanted:
            quantity = wanted.rsplit("_", 1)[0]
            problem = f"column {j + 1} is {header[j][:60]!r}, expected {wanted!r}"
            if header[j].rsplit("_", 1)[0] == quantity:
                problem += f"; convert it to {wanted.rsplit('_', 1)[1]} and rename it"
            break
    else:
        problem = f"column {len(expected) + 1} is {header[len(expected)][:60]!r}, one too many"
    letters = "" if encoding.startswith("utf") else f"; it is not UTF-8, and was read as {encoding}"
    raise RecordingError(
        f"{path}: row 1: {problem} ({whose} {', '.join(expected)}){letters}; a mapping reads "
        "other tables"
    )


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


def _check_values(values, header, lines, path) -> None:
    inputs = values[:, : len(header) - (3 if header[-1] == TIP_COLUMNS[-1] else 0)]
    for k, j in np.argwhere(np.isnan(inputs))[:1]:
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
