"""Several trials in one file, and several files by one pattern."""

import glob
import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from os import PathLike

import numpy as np

from calibration.data.arrays import TRIAL
from calibration.data.mapping_file import Spec
from calibration.data.recording import Recording, RecordingError
from calibration.data.table import Table

_LEAST_ROWS = 2


@dataclass(frozen=True)
class Trials:
    """How a file is divided: `parts`, tables with a name each, empty for a file that is one trial;
    and `windows` [s], pairs of start and end on its clock."""

    parts: tuple[tuple[str, Table], ...]
    windows: tuple[tuple[float, float], ...] = ()


def trial_axis(spec: Spec) -> int | None:
    """Along which axis of a file's arrays its trials are, counted from 1; None where not said."""
    axis = spec.whole("axis", None)
    if axis is not None and axis not in (1, 2, 3):
        raise spec.wrong("axis", axis, "1, 2 or 3")
    return axis


def trials_of(table: Table, spec: Spec) -> Trials:
    """The trials of a file, as [trials] of a mapping says.

    Raises `RecordingError` for a column that numbers nothing, and for windows that are none.
    """
    name, windows = spec.text("column", None), _windows(spec)
    only = [_label(x) for x in spec.scalars("only")]
    if trial_axis(spec) is not None:
        if name is not None:
            raise RecordingError(f"{spec.where}column and {spec.where}axis: one is too much")
        name = TRIAL
    spec.done()
    if name is not None and windows:
        raise RecordingError(f"{spec.where}column and {spec.where}windows: one of them is too much")
    if name is None:
        if only:
            raise RecordingError(
                f"{spec.where}only: it chooses among {spec.where}column: name that"
            )
        return Trials((("", table),), windows)
    column = table.find(name)
    labels = [_label(x) for x in table.columns[column]]
    there = [x for x in dict.fromkeys(labels) if x]
    for label in only:
        if label not in there:
            raise RecordingError(
                f"{spec.where}only: {label!r} is not in column {column}, which has "
                f"{', '.join(there[:20])}"
            )
    if not there:
        raise RecordingError(f"{table.path}: column {column}: every cell is missing")
    rows = {label: [] for label in there}
    for k, label in enumerate(labels):
        if label:
            rows[label].append(k)
    chosen = only or there
    for label in chosen:
        if len(rows[label]) < _LEAST_ROWS:
            raise RecordingError(
                f"{table.path}: column {column}: {label!r} stands in one row only; a trial has "
                "several: is it a column that numbers trials?"
            )
    return Trials(tuple((label, _part(table, np.array(rows[label]), column)) for label in chosen))


def cut(recording: Recording, windows: Sequence[tuple[float, float]]) -> list[Recording]:
    """The recording's parts in `windows` [s], numbered from 1, or itself if there are none."""
    if not windows:
        return [recording]
    return [
        replace(recording.window(*window), name=f"{recording.name}-{k + 1}")
        for k, window in enumerate(windows)
    ]


def files_of(patterns: Sequence[str | PathLike]) -> list[str]:
    """The files that `patterns` such as "run_*.csv" stand for, each in the order of the names in
    it; what is a file or has no sign of a pattern stands for itself.

    Raises `RecordingError` for a pattern that no file has.
    """
    found = []
    for pattern in map(str, patterns):
        if not glob.has_magic(pattern) or os.path.exists(pattern):
            found.append(pattern)
            continue
        own = sorted(glob.glob(pattern, recursive=True), key=_natural)
        if not own:
            raise RecordingError(f"{pattern}: no file is called so")
        found += own
    return found


def _natural(name: str):
    """run_2 comes before run_10."""
    parts, digits = [], ""
    for sign in name + "\0":
        if sign.isdigit():
            digits += sign
            continue
        if digits:
            parts.append((0, int(digits), ""))
            digits = ""
        parts.append((1, 0, sign))
    return parts


def _windows(spec: Spec) -> tuple[tuple[float, float], ...]:
    what = "a list of pairs [start, end] in s, end after start"
    given = spec.get("windows", list, what, [], False)
    for pair in given:
        good = isinstance(pair, list) and len(pair) == 2
        good = good and all(isinstance(x, int | float) and not isinstance(x, bool) for x in pair)
        if not (good and -np.inf < pair[0] < pair[1] < np.inf):
            raise spec.wrong("windows", given, what)
    return tuple((float(a), float(b)) for a, b in given)


def _label(cell) -> str:
    """A cell as the name of a trial, "" where it is missing; 3.0 is 3."""
    if isinstance(cell, str):
        return cell.strip()
    if isinstance(cell, np.datetime64):
        return "" if np.isnat(cell) else str(cell)
    return "" if np.isnan(cell) else f"{float(cell):.12g}"


def _part(table: Table, rows: np.ndarray, column: str) -> Table:
    """The table of some rows. Columns of another number of samples have no part in it."""
    count = len(table.columns[column])
    own = {k: x for k, x in table.columns.items() if len(x) == count}
    place = {int(k): i for i, k in enumerate(rows)}
    wrong = {
        name: (place[k], text, hint)
        for name, (k, text, hint) in table.wrong.items()
        if name in own and k in place
    }
    others = {
        k: f"of another number of samples than {column}" for k in table.columns if k not in own
    }
    return replace(
        table,
        columns={name: values[rows] for name, values in own.items()},
        wrong=wrong,
        skipped={**table.skipped, **others},
        rows={len(rows): [table.row(int(k), count) for k in rows]},
    )
