"""Files of other people as named columns of numbers: CSV, MAT, HDF5, Parquet, C3D.

A two-dimensional array gives a column for each of its own, counted from 1: `tip[1]`, `tip[2]`.
Names inside structures and groups are joined by a slash: `robot/tip[1]`. A marker of a C3D gives
`LABEL.x`, `LABEL.y` and `LABEL.z`.
"""

import csv
import math
from dataclasses import dataclass
from os import PathLike
from pathlib import Path

import numpy as np

from calibration.recording import RecordingError

_METADATA = ("__header__", "__version__", "__globals__")
# Larger than any log: not columns of samples but images or matrices.
_MOST_COLUMNS = 64


@dataclass(frozen=True)
class Table:
    """`columns`, (T,) each, by name; `rows`: what each sample is called in messages, by length.

    `interval` [s]: between samples, where the file itself knows it (C3D).
    """

    path: str
    columns: dict[str, np.ndarray]
    row_names: list[str] | None = None
    interval: float | None = None

    def column(self, name: str) -> np.ndarray:
        """Raises `RecordingError`, with the names that there are, for another."""
        if name in self.columns:
            return self.columns[name]
        some = ", ".join(list(self.columns)[:40])
        raise RecordingError(f"{self.path}: no column {name!r}; the file has {some}")

    def row(self, k: int) -> str:
        """The name of sample `k`."""
        return self.row_names[k] if self.row_names else f"row {k + 1}"


def read_table(
    path: str | PathLike, *, delimiter: str | None = None, decimal: str = ".", skip_rows: int = 0
) -> Table:
    """The columns of `path`. The options are for CSV: the character between cells (found from the
    header if None), the decimal sign, and the lines before the header.

    Raises `RecordingError` if the file cannot be read, its package is not installed, or it holds
    no columns of numbers.
    """
    kind = _READERS.get(Path(path).suffix.lower())
    if kind is None:
        raise RecordingError(
            f"{path}: unknown kind of recording {Path(path).suffix!r}: expected one of "
            f"{', '.join(_READERS)}"
        )
    try:
        with open(path, "rb"):
            pass
        if kind is _csv:
            return _csv(path, delimiter, decimal, skip_rows)
        table = kind(path)
    except OSError as e:
        raise RecordingError(
            f"{path}: cannot read the recording: {e.strerror or _first_line(e)}"
        ) from None
    if not table.columns:
        raise RecordingError(f"{path}: holds no columns of numbers")
    return table


def _csv(path, delimiter, decimal, skip_rows) -> Table:
    try:
        with open(path, newline="", encoding="utf-8-sig") as file:
            lines = file.read().splitlines()
    except UnicodeDecodeError as e:
        raise RecordingError(f"{path}: not UTF-8 text (byte {e.start}): is it a CSV?") from None
    if len(lines) <= skip_rows:
        raise RecordingError(f"{path}: {len(lines)} lines, and skip_rows = {skip_rows}")
    head = lines[skip_rows]
    if delimiter is None:
        delimiter = max(",;\t", key=head.count)
    names = [name.strip() for name in next(csv.reader([head], delimiter=delimiter))]
    for name in names:
        if names.count(name) > 1:
            raise RecordingError(f"{path}: row {skip_rows + 1}: two columns are called {name!r}")
    values, rows = [], []
    for number, cells in enumerate(csv.reader(lines[skip_rows + 1 :], delimiter=delimiter)):
        if not any(cell.strip() for cell in cells):
            continue
        row = f"row {number + skip_rows + 2}"
        if len(cells) != len(names):
            raise RecordingError(
                f"{path}: {row}: {len(cells)} cells, and the header has {len(names)} columns"
            )
        values.append([_number(cell.strip(), decimal) for cell in cells])
        rows.append(row)
    if not rows:
        raise RecordingError(f"{path}: a header and no rows: nothing was recorded")
    return Table(str(path), dict(zip(names, np.array(values).T, strict=True)), rows)


def _number(text: str, decimal: str) -> float:
    """NaN for an empty cell, and infinity for one that is no number: it may be a comment."""
    if text == "":
        return math.nan
    try:
        value = float(text.replace(decimal, ".")) if "_" not in text else math.inf
    except ValueError:
        return math.inf
    return value


def _mat(path) -> Table:
    try:
        from scipy.io import loadmat
    except ImportError:
        raise _missing(path, "MAT", "scipy", "mat") from None
    with open(path, "rb") as file:
        if file.read(128)[:19] == b"MATLAB 7.3 MAT-file":
            return _hdf5(path)
    try:
        content = loadmat(str(path), simplify_cells=True)
    except Exception as e:  # scipy raises whatever it meets
        raise RecordingError(f"{path}: not a readable MAT file: {_first_line(e)}") from None
    columns: dict[str, np.ndarray] = {}
    _collect("", {k: v for k, v in content.items() if k not in _METADATA}, columns)
    return Table(str(path), columns)


def _hdf5(path) -> Table:
    try:
        import h5py
    except ImportError:
        raise _missing(path, "HDF5", "h5py", "hdf5") from None
    matlab = Path(path).suffix.lower() == ".mat"
    columns: dict[str, np.ndarray] = {}

    def visit(name, item):
        if isinstance(item, h5py.Dataset) and item.dtype.kind in "fiu" and item.ndim in (1, 2):
            # MATLAB stores columns as rows.
            _collect(name, np.asarray(item).T if matlab else np.asarray(item), columns)

    try:
        with h5py.File(path, "r") as file:
            file.visititems(visit)
    except (OSError, RuntimeError) as e:
        raise RecordingError(f"{path}: not a readable HDF5 file: {_first_line(e)}") from None
    return Table(str(path), columns)


def _parquet(path) -> Table:
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError:
        raise _missing(path, "Parquet", "pyarrow", "parquet") from None
    try:
        table = pyarrow.parquet.read_table(path)
    except (pyarrow.ArrowException, ValueError) as e:
        raise RecordingError(f"{path}: not a readable Parquet file: {_first_line(e)}") from None
    columns = {}
    for name, column in zip(table.column_names, table.columns, strict=True):
        kind = column.type
        if pyarrow.types.is_temporal(kind):
            whole = column.cast(pyarrow.timestamp("ns"), safe=False).cast(pyarrow.int64())
            columns[name] = np.asarray(whole.to_numpy(), dtype=float) * 1e-9
        elif pyarrow.types.is_integer(kind) or pyarrow.types.is_floating(kind):
            columns[name] = np.asarray(column.to_numpy(), dtype=float)
    return Table(str(path), columns)


def _c3d(path) -> Table:
    from calibration.c3d import read_points

    points, labels, unit, rate, _ = read_points(path)
    columns = {
        f"{label}.{axis}": unit * points[:, j, i]
        for j, label in enumerate(labels)
        for i, axis in enumerate("xyz")
    }
    names = [f"frame {k + 1}" for k in range(len(points))]
    return Table(str(path), columns, names, 1 / rate)


def _collect(name: str, value, columns: dict) -> None:
    """Numbers of one or two dimensions under their names; anything else is passed over."""
    if isinstance(value, dict):
        for key, part in value.items():
            _collect(f"{name}/{key}" if name else key, part, columns)
        return
    array = np.asarray(value)
    if array.dtype.kind not in "fiu" or array.ndim not in (1, 2):
        return
    array = np.squeeze(array.astype(float))
    if array.ndim == 1:
        columns[name] = array
    elif array.ndim == 2 and array.shape[1] <= _MOST_COLUMNS:
        for j, column in enumerate(array.T):
            columns[f"{name}[{j + 1}]"] = column


def _missing(path, kind, package, extra) -> RecordingError:
    return RecordingError(
        f"{path}: reading {kind} files needs {package}: pip install 'softrod_jax[{extra}]'"
    )


def _first_line(error: Exception) -> str:
    return (str(error) or type(error).__name__).splitlines()[0]


_READERS = {
    ".csv": _csv,
    ".tsv": _csv,
    ".txt": _csv,
    ".mat": _mat,
    ".h5": _hdf5,
    ".hdf5": _hdf5,
    ".parquet": _parquet,
    ".c3d": _c3d,
}
SUFFIXES = tuple(_READERS)
