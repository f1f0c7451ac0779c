"""Files of other people as named columns: CSV and its kin, MAT, HDF5, Parquet, C3D.

A two-dimensional array gives a column for each of its own, counted from 1: `tip[1]`, `tip[2]`.
Names inside structures and groups are joined by a slash: `robot/tip[1]`. A marker of a motion
capture gives `LABEL.x`, `LABEL.y` and `LABEL.z`.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from calibration.data import dates, units
from calibration.data.cells import NumberFormat
from calibration.data.recording import RecordingError

_SHOWN = 40  # names in a message


@dataclass(frozen=True)
class Table:
    """The columns of a file as it has them, in the file's own units.

    - `columns`: by name, (T,) each: numbers, moments (datetime64), or texts that are neither.
    - `units`: what the file itself says of a column's unit, by name.
    - `wrong`: of columns of numbers the first cell that is none: its index, text, and a hint.
    - `skipped`: columns that hold no numbers, and what they are.
    - `rows`: what the samples are called in messages, by their number.
    - `interval` [s]: between samples, where the file itself knows it.
    - `notes`: what the reader had to assume.
    """

    path: str
    columns: Mapping[str, np.ndarray]
    units: Mapping[str, str] = field(default_factory=dict)
    wrong: Mapping[str, tuple[int, str, str]] = field(default_factory=dict)
    skipped: Mapping[str, str] = field(default_factory=dict)
    rows: Mapping[int, list[str]] = field(default_factory=dict)
    interval: float | None = None
    notes: tuple[str, ...] = ()

    def find(self, name: str, among: str = "", key: str = "") -> str:
        """The column that a mapping calls `name`: with its marker's name or not, as `LABEL.x` or as
        `x` alone, with its unit or not. Of several that of the marker named `among` is meant.
        `key`: that of the mapping, for messages.

        Raises `RecordingError`, with the names that there are, if there is none or more than one.
        """
        if name in self.columns:
            return name
        plain = lambda text: text.strip().casefold()
        asked = f" ({key})" if key else ""
        for same in (
            lambda column: plain(column) == plain(name),
            lambda column: plain(bare_name(column)) == plain(name),
            lambda column: plain(bare_name(column).rpartition(".")[2]) == plain(name),
        ):
            found = [column for column in self.columns if same(column)]
            own = [c for c in found if plain(c.rpartition(".")[0].split(":")[-1]) == plain(among)]
            if len(own if len(found) > 1 else found) == 1:
                return (own if len(found) > 1 else found)[0]
            if found:
                raise RecordingError(
                    f"{self.path}: {len(found)} columns are called {name!r}{asked}; name one of "
                    f"{_listed(found)}"
                )
        if name in self.skipped:
            raise RecordingError(f"{self.path}: column {name!r} is {self.skipped[name]}{asked}")
        hint = "; is the header another line? [csv] skip_rows" if len(self.columns) == 1 else ""
        if all(_is_number(bare_name(column)) for column in self.columns):
            hint = (
                "; if its first row is no header, set [csv] header = false: then they are 1, 2, .."
            )
        raise RecordingError(
            f"{self.path}: no column {name!r}{asked}; the file has "
            f"{_listed(list(self.columns))}{hint}"
        )

    def numbers(self, column: str, missing: str) -> np.ndarray:
        """The numbers of a column, NaN where a cell is missing. `missing`: what to do about a cell
        that is no number. Raises `RecordingError` for it."""
        values = self.columns[column]
        if values.dtype.kind in "OM":
            k, text = (0, str(values[0])) if values.dtype.kind == "M" else _first_text(values)
            self._complain(column, k, text, missing)
        if column in self.wrong:
            k, text, hint = self.wrong[column]
            self._complain(column, k, text, hint or missing)
        for k in np.flatnonzero(np.isinf(values))[:1]:
            self._complain(column, k, f"{values[k]:g}", missing)
        return values

    def times(self, column: str, form: str | None) -> np.ndarray:
        """Numbers, or moments (datetime64) if the cells are dates; times of day are in seconds."""
        values = self.columns[column]
        if values.dtype.kind == "M":
            return values
        if values.dtype.kind != "O":
            if form is not None:
                raise RecordingError(
                    f"{self.path}: column {column} holds numbers: leave the format of its dates out"
                )
            return self.numbers(column, "a time is a number or a date; delete the row")
        number = NumberFormat()
        moments = []
        for k, text in enumerate(values):
            try:
                moments.append(None if number.is_missing(text) else dates.moment(text, form))
            except dates.DateError as e:
                self._complain(column, k, text, str(e))
        if any(isinstance(x, float) for x in moments):
            for k, x in enumerate(moments):
                if isinstance(x, np.datetime64):
                    self._complain(column, k, values[k], "a date among times of day")
            return np.array([np.nan if x is None else x for x in moments])
        return np.array([np.datetime64("NaT") if x is None else x for x in moments], "M8[ns]")

    def unit(self, column: str) -> str | None:
        """What the file says of a column's unit: in a place of its own, or in the name."""
        return self.units.get(column) or units.in_name(column)

    def row(self, k: int, count: int) -> str:
        """The name of sample `k` of `count`."""
        return self.rows[count][k] if count in self.rows else f"row {k + 1}"

    def _complain(self, column, k, text, hint):
        what = "not finite" if hint == "not finite" else "not a number"
        if str(text).lower().lstrip("+-") in ("inf", "infinity"):
            what, hint = "not a finite number", "" if hint == "not finite" else hint
        if dates.looks_like_one(text) and "[time]" not in hint:
            hint = f"a date or time of day; {hint}"
        shown = text if len(text) <= 60 else text[:57] + "..."
        raise RecordingError(
            f"{self.path}: {self.row(k, len(self.columns[column]))}, column {column}: {shown!r} is "
            f"{what}" + (f"; {hint}" if hint else "")
        )


def _first_text(values) -> tuple[int, str]:
    number = NumberFormat()
    for k, text in enumerate(values):
        if not number.is_missing(text):
            return k, text
    return 0, ""


def bare_name(column: str) -> str:
    """The name without its unit, and without the number that tells it from another of that name."""
    column = re.sub(r" ?\(column \d+\)$", "", column)
    unit = units.in_name(column)
    return (
        column if unit is None else column[: column.rfind(unit)].rstrip(" [(/_").removesuffix(" in")
    )


def _listed(names: list[str]) -> str:
    return ", ".join(names[:_SHOWN]) + (
        f" and {len(names) - _SHOWN} more" if len(names) > _SHOWN else ""
    )


def _is_number(text: str) -> bool:
    return NumberFormat().looks_like_one(text)
