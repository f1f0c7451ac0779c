"""Tables in text files: CSV, TSV and what programs of motion capture and of data acquisition
export.

Rows are read one after the other into columns of numbers. A column that begins with a text, such
as a date or a comment, stays one of texts, and is looked at only if a mapping asks for it.
"""

import csv
import math
from array import array
from dataclasses import dataclass
from os import PathLike

import numpy as np

from calibration.data.cells import CellError, NumberFormat
from calibration.data.layouts import Layout, cells_of, find_layout
from calibration.data.recording import RecordingError
from calibration.data.table import Table
from calibration.data.text_files import read_lines


@dataclass(frozen=True)
class TextOptions:
    """What a mapping says of a text file; None where it is to be found.

    - `delimiter`: between cells, one character. `skip`: lines before the header. `header`: False if
      there is none; columns are then called 1, 2, ..
    - `numbers`: how they are written. `encoding`: as Python calls it.
    """

    delimiter: str | None = None
    skip: int | None = None
    header: bool = True
    numbers: NumberFormat = NumberFormat()
    encoding: str | None = None


def read_text(path: str | PathLike, options: TextOptions = TextOptions()) -> Table:
    """The columns of a text file. Raises `RecordingError` if it has no header or no rows, or if a
    row has more or fewer cells than the header."""
    lines, encoding = read_lines(path, options.encoding)
    try:
        parts = find_layout(path, lines, options.delimiter, options.skip, options.header)
        tables = [_part(path, lines, part, options.numbers) for part in parts]
    except csv.Error as e:
        raise RecordingError(f"{path}: not a table of text: {e}") from None
    notes = [note for part in parts for note in part.notes]
    if encoding in ("cp1252", "latin-1") and options.encoding is None:
        notes.append(f"not UTF-8 text; read as {encoding}")
    return Table(
        str(path),
        {name: x for t in reversed(tables) for name, x in t.columns.items()},
        units={name: unit for part in parts for name, unit in part.units.items()},
        wrong={name: cell for t in reversed(tables) for name, cell in t.wrong.items()},
        rows={count: rows for t in reversed(tables) for count, rows in t.rows.items()},
        interval=parts[0].interval,
        notes=tuple(notes),
    )


def _part(path, lines: list[str], layout: Layout, numbers: NumberFormat) -> Table:
    columns = [_Column(numbers) for _ in layout.names]
    rows = []
    for cells, line in _rows(lines, layout):
        extra = len(cells) - len(columns)
        if extra > 0 and not any(cells[len(columns) :]):
            cells = cells[: len(columns)]  # a separator after the last cell
        elif extra < 0 and _ends_unheeded(layout.names[extra:]):
            cells = cells + [""] * -extra
        elif extra:
            raise RecordingError(
                f"{path}: row {line}: {len(cells)} cells, and the header has {len(columns)} "
                "columns; with a mapping, [csv] delimiter and [csv] skip_rows say what is between "
                "cells and where the header is"
            )
        for column, cell in zip(columns, cells, strict=True):
            column.add(cell)
        rows.append(f"row {line}")
    if not rows:
        raise RecordingError(
            f"{path}: a header and no rows: nothing was recorded; if the header is another line, a "
            "mapping says so with [csv] skip_rows"
        )
    named = dict(zip(layout.names, columns, strict=True))
    return Table(
        str(path),
        {name: column.values() for name, column in named.items()},
        wrong={name: column.wrong for name, column in named.items() if column.wrong},
        rows={len(rows): rows},
    )


def _rows(lines, layout: Layout):
    """The cells of each row that has any, and the number of its last line."""
    part = lines[layout.first : layout.end]
    if layout.delimiter == " ":
        for k, line in enumerate(part):
            if line.strip():
                yield cells_of(line, " "), layout.first + k + 1
        return
    reader = csv.reader(part, delimiter=layout.delimiter)
    for cells in reader:
        if any(cell.strip() for cell in cells):
            yield [cell.strip() for cell in cells], layout.first + reader.line_num


def _ends_unheeded(names: list[str]) -> bool:
    """Whether a row may end before these columns: LabVIEW writes a comment in few of them."""
    return all(name.lower() == "comment" or name.startswith("(column") for name in names)


class _Column:
    """The cells of a column, numbers as long as the first that is not missing is one."""

    def __init__(self, numbers: NumberFormat):
        self.format, self.numbers, self.texts = numbers, array("d"), None
        self.wrong: tuple[int, str, str] | None = None
        self._seen = False

    def add(self, cell: str) -> None:
        if self.texts is not None:
            self.texts.append(cell)
            return
        try:
            value = self.format.read(cell)
        except CellError as e:
            if not self._seen and not self.format.looks_like_one(cell):
                self.texts = [""] * len(self.numbers) + [cell]
                return
            self.wrong = self.wrong or (len(self.numbers), cell, str(e))
            value = math.nan
        else:
            self._seen = self._seen or not math.isnan(value)
        self.numbers.append(value)

    def values(self) -> np.ndarray:
        if self.texts is None:
            return np.frombuffer(self.numbers) if len(self.numbers) else np.zeros(0)
        column = np.empty(len(self.texts), dtype=object)
        column[:] = self.texts
        return column
