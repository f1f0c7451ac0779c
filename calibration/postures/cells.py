"""The cells of a table in a CSV file, and the numbers in them."""

import csv
import math
from collections.abc import Sequence
from dataclasses import dataclass
from os import PathLike

import numpy as np

from calibration.data.recording import RecordingError
from calibration.data.text_files import read_lines

_MISSING = ("", "nan", "na")


@dataclass(frozen=True)
class Cells:
    """A CSV file: its `header`, and of each row its line in the file and its cells."""

    path: str | PathLike
    header: list[str]
    table: list[tuple[int, list[str]]]

    def numbers(self, columns: Sequence[str], whole: bool = False) -> np.ndarray:
        """(rows, columns); NaN where a cell is empty, which is an error if they must be `whole`.

        Raises `RecordingError` with file, row and column.
        """
        out = np.full((len(self.table), len(columns)), np.nan)
        for i, (line, row) in enumerate(self.table):
            for j, column in enumerate(columns):
                text = row[self.header.index(column)]
                if text.lower() in _MISSING:
                    value = math.nan
                else:
                    try:
                        value = float(text)
                    except ValueError:
                        value = math.inf
                if math.isinf(value) or (whole and math.isnan(value)):
                    raise RecordingError(
                        f"{self.path}: row {line}, column {column}: {text!r} is not a finite number"
                    )
                out[i, j] = value
        return out

    def texts(self, column: str) -> tuple[str, ...]:
        """The cells of a column."""
        return tuple(row[self.header.index(column)] for _, row in self.table)


def read_cells(path: str | PathLike) -> Cells:
    """The table in `path`. Raises `RecordingError` if there is none."""
    lines, _ = read_lines(path)
    reader = csv.reader(lines, strict=True)
    header, table = None, []
    try:
        for row in reader:
            cells = [cell.strip() for cell in row]
            if not any(cells):
                continue
            if header is None:
                header = cells
            elif len(cells) != len(header):
                raise RecordingError(
                    f"{path}: row {reader.line_num}: {len(cells)} cells, and the header has "
                    f"{len(header)} columns"
                )
            else:
                table.append((reader.line_num, cells))
    except csv.Error as e:
        raise RecordingError(f"{path}: row {reader.line_num}: not a CSV file: {e}") from None
    if header is None or not table:
        raise RecordingError(f"{path}: no rows: expected a header, and a row for each posture")
    if len(set(header)) < len(header):
        twice = next(name for name in header if header.count(name) > 1)
        raise RecordingError(f"{path}: column {twice!r} is there twice; rename one")
    return Cells(path, header, table)
