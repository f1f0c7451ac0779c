"""How a text file is written: what is between its cells, and which sign is the decimal one.

The readers refuse what could mean two things. Here the ways of reading it are tried on the whole
file, and what was chosen is said, so that a person can contradict.
"""

from dataclasses import dataclass, replace
from os import PathLike
from pathlib import Path

from calibration.data.cells import NumberFormat
from calibration.data.recording import RecordingError
from calibration.data.table import Table, bare_name
from calibration.data.tables import read_table
from calibration.data.text_files import read_lines
from calibration.data.text_tables import TextOptions

_TEXT = (".csv", ".tsv", ".txt", ".dat", ".asc", ".lvm", ".trc")
_NAMES = {";": "semicolons", "\t": "tabs", ",": "commas", " ": "spaces"}


@dataclass(frozen=True)
class Sniffed:
    """A `table`, and how it was read: `delimiter` and `decimal` if the reader has to be told them.

    `header`: whether it has one. `notes`: what was assumed.
    """

    table: Table
    delimiter: str | None = None
    decimal: str | None = None
    header: bool = True
    notes: tuple[str, ...] = ()


def sniff(
    path: str | PathLike,
    delimiter: str | None = None,
    decimal: str | None = None,
    encoding: str | None = None,
    skip: int | None = None,
) -> Sniffed:
    """The columns of any file that the readers know, with the way of reading it that fits best.

    What is given is not tried otherwise. Raises `RecordingError` if it cannot be read at all.
    """
    if Path(path).suffix.lower() not in _TEXT:
        return Sniffed(read_table(path))
    best = _best(path, delimiter, decimal, encoding, skip, header=True)
    number = NumberFormat()
    if all(number.looks_like_one(bare_name(column)) for column in best.table.columns):
        best = _best(path, delimiter, decimal, encoding, skip, header=False)
    return replace(best, notes=_notes(best))


def _best(path, delimiter, decimal, encoding, skip, header: bool) -> Sniffed:
    """The way of reading that leaves most numbers."""
    lines, _ = read_lines(path, encoding)
    held = [sign for sign in ";\t" if any(sign in line for line in lines[:200])]
    first, best = None, None
    for sign in [delimiter] if delimiter else [None, *held]:
        for comma in [decimal] if decimal else [None, ",", "."]:
            options = TextOptions(
                delimiter=sign,
                numbers=NumberFormat(comma),
                encoding=encoding,
                skip=skip,
                header=header,
            )
            try:
                table = read_table(path, options)
            except RecordingError as e:
                first = first or e
                continue
            found = Sniffed(table, sign, comma, header)
            if best is None or _badness(found) < _badness(best):
                best = found
    if best is None:
        raise first or RecordingError(f"{path}: cannot be read as a table")
    return best


def _badness(found: Sniffed) -> tuple[int, int]:
    """How many columns are not numbers, and how little of the file was taken apart."""
    columns = found.table.columns
    texts = sum(values.dtype.kind == "O" for values in columns.values())
    return len(found.table.wrong) + texts, -len(columns)


def _notes(found: Sniffed) -> tuple[str, ...]:
    notes = []
    if not found.header:
        notes.append("there is no header: columns are called 1, 2, ..")
    if found.delimiter is not None:
        notes.append(f"{_NAMES.get(found.delimiter, found.delimiter)} are between the cells")
    if found.decimal == ",":
        notes.append("a comma is the decimal sign: 1,5 is one and a half")
    elif found.decimal == ".":
        notes.append("a comma separates thousands: 1,500 is fifteen hundred")
    return (*notes, *found.table.notes)
