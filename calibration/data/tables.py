"""Files of other people as tables: text, MAT, HDF5, Parquet and C3D.

A two-dimensional array gives a column for each of its own, counted from 1: `tip[1]`, `tip[2]`.
Names inside structures and groups are joined by a slash: `robot/tip[1]`. A marker of a C3D gives
`LABEL.x`, `LABEL.y` and `LABEL.z`.
"""

from os import PathLike
from pathlib import Path

import numpy as np

from calibration.data.arrays import stacked
from calibration.data.c3d_points import read_points
from calibration.data.recording import RecordingError
from calibration.data.table import Table
from calibration.data.text_tables import TextOptions, read_text

_METADATA = ("__header__", "__version__", "__globals__")
# Larger than any log: not columns of samples but images or matrices.
_MOST_COLUMNS = 64


def read_table(
    path: str | PathLike, options: TextOptions = TextOptions(), trial_axis: int | None = None
) -> Table:
    """The columns of `path`; the options are for text.

    `trial_axis`: along which axis of its arrays of three dimensions a MAT or HDF5 file has trials,
    counted from 1 (`calibration.data.arrays`).

    Raises `RecordingError` if the file cannot be read, its package is not installed, or it holds
    no columns of numbers.
    """
    kind = _READERS.get(Path(path).suffix.lower())
    if kind is None:
        raise RecordingError(
            f"{path}: unknown kind of recording {Path(path).suffix!r}: expected one of "
            f"{', '.join(_READERS)}" + _INSTEAD.get(Path(path).suffix.lower(), "")
        )
    try:
        with open(path, "rb"):
            pass
        if kind is read_text:
            table = read_text(path, options)
        elif trial_axis is not None and kind in (_mat, _hdf5):
            table = kind(path, trial_axis)
        else:
            table = kind(path)
    except OSError as e:
        raise RecordingError(
            f"{path}: cannot read the recording: {e.strerror or _first_line(e)}"
        ) from None
    except ValueError as e:
        if isinstance(e, RecordingError):
            raise
        raise RecordingError(f"{path}: cannot read the recording: {e}") from None
    except MemoryError:
        raise RecordingError(f"{path}: does not fit into memory: cut it") from None
    if trial_axis is not None and kind not in (_mat, _hdf5):
        raise RecordingError(
            f"{path}: [trials] axis = {trial_axis}: is for arrays of MAT and HDF5 files"
        )
    if not table.columns:
        known = "".join(f"; {name} is {what}" for name, what in list(table.skipped.items())[:5])
        raise RecordingError(f"{path}: holds no columns of numbers{known}")
    return table


def _mat(path, trial_axis: int | None = None) -> Table:
    try:
        from scipy.io import loadmat
    except ImportError:
        raise _missing(path, "MAT", "scipy", "mat") from None
    with open(path, "rb") as file:
        if file.read(128)[:19] == b"MATLAB 7.3 MAT-file":
            return _hdf5(path, trial_axis)
    try:
        content = loadmat(str(path), simplify_cells=True)
    except Exception as e:  # scipy raises whatever it meets
        raise RecordingError(f"{path}: not a readable MAT file: {_first_line(e)}") from None
    columns: dict[str, np.ndarray] = {}
    content = {k: v for k, v in content.items() if k not in _METADATA}
    if trial_axis is not None:
        _arrays("", content, columns)
        return Table(str(path), stacked(path, columns, trial_axis))
    _collect("", content, columns)
    return Table(str(path), columns)


def _hdf5(path, trial_axis: int | None = None) -> Table:
    try:
        import h5py
    except ImportError:
        raise _missing(path, "HDF5", "h5py", "hdf5") from None
    matlab = Path(path).suffix.lower() == ".mat"
    columns, said, skipped = {}, {}, {}

    def visit(name, item):
        if not isinstance(item, h5py.Dataset):
            return
        if trial_axis is not None:
            _arrays(name, np.asarray(item).T if matlab else np.asarray(item), columns)
            return
        if item.dtype.kind not in "fiu" or item.ndim not in (1, 2):
            skipped[name] = f"an array {item.shape} of {item.dtype}, not a column of numbers"
            return
        before = set(columns)
        # MATLAB stores columns as rows.
        _collect(name, np.asarray(item).T if matlab else np.asarray(item), columns)
        unit = item.attrs.get("units", item.attrs.get("unit"))
        unit = unit.decode("utf-8", "replace") if isinstance(unit, bytes) else unit
        if isinstance(unit, str):
            said.update(dict.fromkeys(set(columns) - before, unit))

    try:
        with h5py.File(path, "r") as file:
            file.visititems(visit)
    except (OSError, RuntimeError, KeyError, ValueError, TypeError) as e:
        raise RecordingError(f"{path}: not a readable HDF5 file: {_first_line(e)}") from None
    if trial_axis is not None:
        columns = stacked(path, columns, trial_axis)
    return Table(str(path), columns, units=said, skipped=skipped)


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
    columns, skipped, said = {}, {}, {}
    for name, column in zip(table.column_names, table.columns, strict=True):
        try:
            values, unit = _arrow(column)
        except (pyarrow.ArrowException, ValueError, TypeError, NotImplementedError):
            values = unit = None
        if values is None:
            skipped[name] = f"of type {column.type}, neither numbers nor times"
            continue
        columns[name] = values
        if unit:
            said[name] = unit
    return Table(str(path), columns, units=said, skipped=skipped)


def _arrow(column):
    """A column of Parquet as numbers or moments, with its unit if its type has one; else None."""
    import pyarrow as pa

    kind, is_ = column.type, pa.types
    if is_.is_dictionary(kind):
        return _arrow(column.cast(kind.value_type))
    if is_.is_timestamp(kind) or is_.is_date(kind):
        return column.cast(pa.timestamp("ns"), safe=False).to_numpy().astype("M8[ns]"), None
    if is_.is_duration(kind) or is_.is_time(kind):
        whole = pa.int64() if is_.is_duration(kind) or is_.is_time64(kind) else pa.int32()
        size = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}[kind.unit]
        return np.asarray(column.cast(whole).to_numpy(), dtype=float) * size, "s"
    if is_.is_decimal(kind):
        column, kind = column.cast(pa.float64()), pa.float64()
    if is_.is_integer(kind) or is_.is_floating(kind):
        return np.asarray(column.to_numpy(), dtype=float), None
    return None, None


def _c3d(path) -> Table:
    points = read_points(path)
    columns, said, skipped = {}, {}, {}
    for j, label in enumerate(points.labels):
        if label in points.twice:
            skipped |= {f"{label}.{axis}": "of a label that two markers have" for axis in "xyz"}
            continue
        for i, axis in enumerate("xyz"):
            columns[f"{label}.{axis}"] = points.positions[:, j, i]
            said[f"{label}.{axis}"] = points.kinds.get(label, points.unit)
    names = [f"frame {k + 1}" for k in range(len(points.positions))]
    return Table(
        str(path),
        columns,
        units={name: unit for name, unit in said.items() if unit},
        skipped=skipped,
        rows={len(names): names},
        interval=None if points.rate is None else 1 / points.rate,
        notes=points.notes,
    )


def _collect(name: str, value, columns: dict) -> None:
    """Numbers of one or two dimensions under their names; anything else is passed over."""
    if isinstance(value, dict):
        for key, part in value.items():
            _collect(f"{name}/{key}" if name else key, part, columns)
        return
    array = np.asarray(value)
    if array.dtype.kind not in "fiu" or array.ndim not in (1, 2):
        return
    array = np.atleast_1d(np.squeeze(array.astype(float)))
    if (
        array.ndim == 2
        and array.shape[0] <= _MOST_COLUMNS
        and (array.shape[1] > _MOST_COLUMNS or array.shape[0] <= 4 and array.shape[1] >= 10)
    ):
        array = array.T  # a coordinate in each row
    if array.ndim == 1:
        columns[name] = array
    elif array.ndim == 2 and array.shape[1] <= _MOST_COLUMNS:
        for j, column in enumerate(array.T):
            columns[f"{name}[{j + 1}]"] = column


def _arrays(name: str, value, arrays: dict) -> None:
    """Numbers of one to three dimensions under their names, as they are."""
    if isinstance(value, dict):
        for key, part in value.items():
            _arrays(f"{name}/{key}" if name else key, part, arrays)
        return
    array = np.asarray(value)
    if array.dtype.kind in "fiu" and array.ndim in (1, 2, 3):
        array = array.astype(float)
        arrays[name] = np.squeeze(array) if array.ndim == 2 and 1 in array.shape else array


def _missing(path, kind, package, extra) -> RecordingError:
    return RecordingError(
        f"{path}: reading {kind} files needs {package}: pip install 'softrod_jax[{extra}]'"
    )


def _first_line(error: Exception) -> str:
    return (str(error) or type(error).__name__).splitlines()[0]


_INSTEAD = {
    ".xlsx": "; save the sheet as CSV",
    ".xls": "; save the sheet as CSV",
    ".ods": "; save the sheet as CSV",
    ".tdms": "; export it as CSV",
    ".npz": "; save it with scipy.io.savemat, or as CSV",
    ".bag": "; export its topics as CSV",
}
_READERS = {
    **dict.fromkeys((".csv", ".tsv", ".txt", ".dat", ".asc", ".lvm", ".trc"), read_text),
    ".mat": _mat,
    ".h5": _hdf5,
    ".hdf5": _hdf5,
    ".parquet": _parquet,
    ".c3d": _c3d,
}
