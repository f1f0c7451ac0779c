"""Where the header of a text table is: the first line, or what a program writes before its rows.

Known by how they begin: the exports of OptiTrack Motive, Vicon Nexus, Qualisys (TSV), Motion
Analysis (TRC) and LabVIEW (LVM). Of any other file the header is the line before the rows of
numbers, with or without a row of units between them.
"""

import csv
from collections.abc import Callable
from dataclasses import dataclass, field

from calibration.data import dates, units
from calibration.data.cells import NumberFormat
from calibration.data.recording import RecordingError

# A header further down than this is not looked for.
_DEEPEST = 200


@dataclass(frozen=True)
class Layout:
    """`names` of the columns, and `units` by name; rows are the lines from `first` to `end`.

    `interval` [s]: between samples, where the header says it. `named`: whether there are names.
    """

    names: list[str]
    first: int
    delimiter: str
    end: int | None = None
    units: dict[str, str] = field(default_factory=dict)
    interval: float | None = None
    notes: tuple[str, ...] = ()


def cells_of(line: str, delimiter: str) -> list[str]:
    """The cells of one line; a space stands for any number of them."""
    if delimiter == " ":
        return line.split()
    return [cell.strip() for cell in next(csv.reader([line], delimiter=delimiter), [])]


def find_layout(
    path, lines: list[str], delimiter: str | None, skip: int | None, header: bool
) -> list[Layout]:
    """The parts of a table, one after the other; most files have one.

    `delimiter`: between cells, or None to find it; `skip`: lines before the header, or None to
    find it; `header`: False if there is none. Raises `RecordingError`.
    """
    begin = lines[0].lstrip("\ufeff").lower() if lines else ""
    for beginning, known in _KNOWN.items():
        if begin.startswith(beginning):
            return known(path, lines)
    if not any(line.strip() for line in lines):
        raise RecordingError(f"{path}: empty: nothing was recorded")
    if skip is not None and len(lines) <= skip:
        raise RecordingError(f"{path}: {len(lines)} lines, and [csv] skip_rows = {skip}")
    at = skip or 0
    while at < len(lines) and not lines[at].strip():
        at += 1
    if at == len(lines):
        raise RecordingError(f"{path}: no header after line {skip or 0} ([csv] skip_rows)")
    first = _first_row(lines, at, delimiter) if skip is None else at
    delimiter = delimiter or _delimiter(lines[first])
    if not header:
        count = len(cells_of(lines[at], delimiter)) if skip is not None else 0
        if skip is None:
            at, count = first, len(cells_of(lines[first], delimiter))
        return [Layout([str(j + 1) for j in range(count)], at, delimiter)]
    return [_general(path, lines, at, first, delimiter, skip is not None)]


def _general(path, lines, at, first, delimiter, told) -> Layout:
    """A header right before the rows of numbers, or at the line `at` if that was `told`."""
    cells = lambda k: cells_of(lines[k], delimiter)
    if told:
        first = at + 1
        while first < min(len(lines), at + _DEEPEST) and not _is_row(cells(first)):
            first += 1
        first = first if first < len(lines) and _is_row(cells(first)) else at + 1
    between = [k for k in range(at, first) if lines[k].strip()] or [first]
    if told:
        head, rest = at, between[1:]
    else:
        count = len(cells(first)) if first < len(lines) else 0
        wide = [k for k in between if len(cells(k)) >= count] or between
        head, rest = wide[-1], []
        if len(wide) > 1 and _is_units(cells(wide[-1])):
            head, rest = wide[-2], [wide[-1]]
    first = max(first, head + 1)
    names = cells(head)
    above = [cells(k) for k in range(head) if lines[k].strip()]
    names = _unique(names, above)
    notes, said = (), {}
    for k in rest:
        row = cells(k)
        if _is_units(row):
            said = {n: u for n, u in zip(names, row, strict=False) if u.strip("[](){} -")}
        else:
            notes = (
                *notes,
                f"row {k + 1} holds no numbers, and was passed over: {lines[k][:60]!r}",
            )
    return Layout(names, first, delimiter, units=said, notes=notes)


def _first_row(lines, at, delimiter) -> int:
    """The first line of numbers after the line `at` that has a line as wide before it, its header;
    `at` if there is none, or if that is one of numbers itself."""
    widest = 0
    for k in range(at, min(len(lines), at + _DEEPEST)):
        if not lines[k].strip():
            continue
        row = cells_of(lines[k], delimiter or _delimiter(lines[k]))
        if _is_row(row) and (k == at or len(row) <= widest):
            return k
        widest = max(widest, len(row))
    return at


def _is_row(row: list[str]) -> bool:
    """Whether most of the cells are numbers or dates, and more than one cell is there."""
    number = NumberFormat()
    filled = [cell for cell in row if not number.is_missing(cell)]
    good = sum(number.looks_like_one(cell) or dates.looks_like_one(cell) for cell in filled)
    return good > 0 and 2 * good >= len(filled) and (len(row) > 2 or good == len(filled))


def _is_units(row: list[str]) -> bool:
    return any(cell for cell in row) and all(units.is_unit(cell) for cell in row)


def _delimiter(line: str) -> str:
    found = max(";\t,", key=line.count)
    return found if found in line else " " if " " in line.strip() else ","


def _unique(names: list[str], above: list[list[str]]) -> list[str]:
    """Names that are there more than once, with the nearest row above that tells them apart."""
    if len(set(names)) == len(names):
        return names
    twice = [j for j, name in enumerate(names) if name and names.count(name) > 1]
    for row in reversed(above):
        filled = _filled(row, len(names))
        both = [
            f"{filled[j]}.{names[j]}" if j in twice and filled[j] else n
            for j, n in enumerate(names)
        ]
        if len({both[j] for j in twice}) == len(twice) and twice:
            names = both
            break
    return _numbered(names)


def _numbered(names: list[str]) -> list[str]:
    """Names that are still there more than once, or empty, with the number of their column."""
    return [
        name if name and names.count(name) == 1 else f"{name} (column {j + 1})".strip()
        for j, name in enumerate(names)
    ]


def _filled(row: list[str], count: int) -> list[str]:
    """Each empty cell as the last before it that is not: a marker's name stands over its x
    alone."""
    filled, last = [], ""
    for cell in (row + [""] * count)[:count]:
        last = cell or last
        filled.append(last)
    return filled


def _motive(path, lines) -> list[Layout]:
    """OptiTrack Motive: rows of types, names, identities and properties over x, y and z."""
    pairs = cells_of(lines[0], ",")
    said = dict(zip(pairs[::2], pairs[1::2], strict=False))
    head = next((k for k, line in enumerate(lines) if line.lower().startswith("frame,")), None)
    if head is None:
        raise RecordingError(f"{path}: an export of Motive without the row Frame, Time, X, ..")
    rows = [cells_of(line, ",") for line in lines[1:head] if line.strip(" ,")]
    axes = cells_of(lines[head], ",")
    if len(rows) < 3:
        raise RecordingError(
            f"{path}: an export of Motive with {len(rows)} rows between its first and the row "
            "Frame, .., expected those of types, names and properties: switch its header on"
        )
    kinds, labels, properties = (row + [""] * len(axes) for row in (rows[0], rows[1], rows[-1]))
    length = said.get("Length Units", "")
    names, told = [], {}
    for j, axis in enumerate(axes):
        name = axis
        if j > 1 and labels[j]:
            position = properties[j] == "Position"
            name = f"{labels[j]}.{axis}" if position else f"{labels[j]}.{properties[j]}.{axis}"
            same = [k for k in range(2, len(axes)) if (labels[k], properties[k], axes[k]) == (
                labels[j], properties[j], axis)]  # fmt: skip
            # A rigid body's ideal markers are called like those that were seen.
            if len({kinds[k] for k in same}) > 1:
                name = f"{kinds[j]} {name}"
            if position and length:
                told[name] = length
            elif properties[j] == "Rotation":
                told[name] = "quaternion" if said.get("Rotation Type") == "Quaternion" else "deg"
        names.append(name)
    rate = _rate(said.get("Export Frame Rate") or said.get("Capture Frame Rate"))
    return [Layout(_numbered(names), head + 1, ",", units=told, interval=rate)]


def _vicon(path, lines) -> list[Layout]:
    """Vicon Nexus: parts such as Trajectories and Devices, each with a rate, names and units."""
    parts, k = [], 0
    while k + 4 < len(lines):
        if not lines[k].strip(' ,\t"'):
            k += 1
            continue
        title = lines[k].strip(' ,\t"')
        end = next((j for j in range(k + 5, len(lines)) if not lines[j].strip(" ,\t")), len(lines))
        delimiter = _delimiter(lines[k + 3])
        over, axes, row = (cells_of(lines[k + i], delimiter) for i in (2, 3, 4))
        over = _filled(over, len(axes))
        names = [
            f"{o}.{a}" if o and j > 1 else a
            for j, (o, a) in enumerate(zip(over, axes, strict=True))
        ]
        names = _numbered(names)
        said = {n: u for n, u in zip(names, row, strict=False) if u}
        rate = _rate(lines[k + 1].strip(' ,\t"'))
        parts.append((title, Layout(names, k + 5, delimiter, end, said, rate)))
        k = end
    if not parts:
        raise RecordingError(f"{path}: an export of Vicon without rows")
    # The markers' clock is that of the table.
    return [part for _, part in sorted(parts, key=lambda p: p[0].lower() != "trajectories")]


def _qualisys(path, lines) -> list[Layout]:
    """Qualisys: keys with their values, MARKER_NAMES last, and perhaps a header of columns."""
    said, k = {}, 0
    while k < len(lines) and lines[k][:1].isalpha() and lines[k].split("\t")[0].isupper():
        key, *values = lines[k].rstrip("\t").split("\t")
        said[key] = values
        k += 1
    markers = said.get("MARKER_NAMES", [])
    names = [f"{marker.strip()}.{axis}" for marker in markers for axis in "xyz"]
    while k < len(lines) and not lines[k].strip():
        k += 1
    before = []
    if k < len(lines) and not _is_row(cells_of(lines[k], "\t")):
        before, k = cells_of(lines[k], "\t"), k + 1
    count = len(cells_of(lines[k], "\t")) if k < len(lines) else 0
    extra = max(count - len(names), 0)
    frame = (
        (before[:extra] if before else ["Frame", "Time"][:extra]) if extra <= 2 else before[:extra]
    )
    names = _numbered([*frame, *names])
    told = {name: "mm" for name in names[len(frame) :]}
    rate = _rate(said.get("FREQUENCY", [""])[0])
    return [Layout(names, k, "\t", units=told, interval=rate)]


def _trc(path, lines) -> list[Layout]:
    """Motion Analysis and OpenSim: names over the first of x1, y1, z1 of each marker."""
    if len(lines) < 6:
        raise RecordingError(f"{path}: a TRC file that ends in its header")
    keys, values = (cells_of(lines[k], "\t") for k in (1, 2))
    said = dict(zip(keys, values, strict=False))
    over, axes = (cells_of(lines[k].rstrip("\t"), "\t") for k in (3, 4))
    count = max(len(over), len(axes))
    over, axes = _filled(over, count), axes + [""] * (count - len(axes))
    names = [
        o if not a else f"{o}.{a.rstrip('0123456789').lower()}"
        for o, a in zip(over, axes, strict=True)
    ]
    told = {n: said.get("Units", "") for n in names if n[-2:] in (".x", ".y", ".z")}
    first = next((k for k in range(5, len(lines)) if lines[k].strip()), len(lines))
    return [Layout(_numbered(names), first, "\t", units=told, interval=_rate(said.get("DataRate")))]


def _labview(path, lines) -> list[Layout]:
    """LabVIEW: headers that end with a line of their own, the last of them before the columns."""
    ends = [k for k, line in enumerate(lines) if line.startswith("***End_of_Header***")]
    if not ends or ends[-1] + 1 >= len(lines):
        raise RecordingError(f"{path}: a LabVIEW file without ***End_of_Header*** and rows")
    delimiter = (
        "," if any(line.lower().startswith("separator,") for line in lines[: ends[-1]]) else "\t"
    )
    names = cells_of(lines[ends[-1] + 1], delimiter)
    return [Layout(_numbered(names), ends[-1] + 2, delimiter)]


def _rate(text: str | None) -> float | None:
    """The interval [s] to a rate [Hz], if it is one."""
    try:
        rate = float((text or "").replace(",", "."))
    except ValueError:
        return None
    return 1 / rate if 0 < rate < float("inf") else None


_KNOWN: dict[str, Callable] = {
    "format version,": _motive,
    "trajectories": _vicon,
    "devices": _vicon,
    "model outputs": _vicon,
    "joints": _vicon,
    "segments": _vicon,
    "no_of_frames\t": _qualisys,
    "pathfiletype": _trc,
    "labview measurement": _labview,
}
