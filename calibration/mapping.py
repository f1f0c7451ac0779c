"""Mapping files: from somebody's columns, units and axes to a `Recording`.

    [time]
    column = "Time"                     # or rate = 100.0 [Hz]; a C3D knows its own
    unit = "ms"
    [tip]
    columns = ["X", "Y", "Z"]           # or markers = [["a.x", "a.y", "a.z"], ..]: their mean
    unit = "mm"
    axes = "-y,x,z"                     # which axes of the file are the scene's x, y, z
    missing = -9999.0                   # what stands for a sample that was not seen
    origin = [0.0, 12.0, 250.0]         # the clamp in the file's axes and unit; or rest = true:
                                        # put the rest at the beginning at the straight tip
    [[tensions]]                        # one for each tendon, in the scene's order
    column = "Load cell 1"
    unit = "gf"
    offset = -12.0                      # added first, in the file's unit
    time = { column = "t_daq", unit = "s" }  # if it has a clock rate of its own
    [[pressures]]
    column = "P"
    unit = "kPa"
    [[base_markers]]                    # three or more: the frame is fitted to them
    columns = ["b1.x", "b1.y", "b1.z"]
    position = [0.02, 0.0, 0.0]         # m, where the marker is in the scene's frame
    [conditions]                        # in what this experiment differs from the scene
    payload_mass = 0.052
    [csv]
    delimiter = ";"
    decimal = ","
    skip_rows = 3                       # lines before the header
"""

import tomllib
from os import PathLike
from pathlib import Path

import numpy as np

from calibration.frames import axes_matrix, from_base_markers, from_rest
from calibration.recording import Recording, RecordingError, check_reach
from calibration.tables import Table, read_table

UNITS = {
    "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "min": 60.0},
    "length": {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "in": 0.0254},
    "force": {"N": 1.0, "mN": 1e-3, "kN": 1e3, "gf": 9.80665e-3, "kgf": 9.80665, "lbf": 4.4482216},
    "pressure": {"Pa": 1.0, "hPa": 1e2, "kPa": 1e3, "MPa": 1e6, "mbar": 1e2, "bar": 1e5,
                 "psi": 6894.757},
}  # fmt: skip
_LARGEST_INTERVAL = 5.0  # s


def read_mapped(path: str | PathLike, mapping: str | PathLike, scene) -> Recording:
    """The recording in `path`, as the mapping file `mapping` describes it; for `scene`.

    Raises `RecordingError` naming file, row, column, value and remedy; for a mapping that cannot
    be, naming its key.
    """
    spec = _read_toml(mapping)
    options = spec.table("csv", required=False)
    table = read_table(
        path,
        delimiter=options.text("delimiter", None),
        decimal=options.text("decimal", "."),
        skip_rows=int(options.number("skip_rows", 0.0)),
    )
    options.done()
    clock = _clock(table, spec.table("time", required=table.interval is None))
    tip, clock_of_tip, note, known = _tip(table, spec, clock, scene)
    inputs = {
        name: [
            _input(table, part, kind, clock, i)
            for i, part in enumerate(spec.tables(name))
        ]
        for name, kind in (("tensions", "force"), ("pressures", "pressure"))
    }
    conditions = spec.table("conditions", required=False).numbers()
    spec.done()
    _check_counts(mapping, inputs, scene)
    times, tip, columns = _merged(clock_of_tip, tip, inputs)
    recording = Recording(
        times=times,
        tensions=columns["tensions"],
        pressures=columns["pressures"],
        tip_positions=tip,
        name=Path(path).stem,
        source=str(path),
        origin_known=known,
        notes=note,
        conditions=conditions,
    )
    if not np.any(recording.has_tip):
        raise RecordingError(f"{path}: the tip's columns: every sample is missing")
    interval = float(np.median(np.diff(times[recording.has_tip]))) if len(times) > 1 else 0.0
    if interval > _LARGEST_INTERVAL:
        raise RecordingError(
            f"{path}: samples are {interval:g} s apart: is the time in ms? set [time] unit in "
            f"{mapping}"
        )
    names = dict(zip(clock_of_tip.tolist(), range(len(clock_of_tip)), strict=True))
    check_reach(recording, scene, [table.row(names.get(t, 0)) for t in times.tolist()])
    return recording


class _Spec:
    """A table of a mapping file; everything in it must be asked for before `done`."""

    def __init__(self, content: dict, where: str):
        self.content, self.where, self.asked = content, where, set()

    def _get(self, key, kind, what, default, required):
        self.asked.add(key)
        if key not in self.content:
            if required:
                raise RecordingError(f"{self.where}{key} is missing: expected {what}")
            return default
        value = self.content[key]
        if not isinstance(value, kind) or isinstance(value, bool) != (kind is bool):
            raise RecordingError(f"{self.where}{key} = {value!r}: expected {what}")
        return value

    def table(self, key, required=True) -> "_Spec":
        content = self._get(key, dict, "a table", {}, required)
        return _Spec(content, f"{self.where}{key}.")

    def tables(self, key) -> list["_Spec"]:
        content = self._get(key, list, f"tables [[{key}]]", [], False)
        for part in content:
            if not isinstance(part, dict):
                raise RecordingError(f"{self.where}{key}: expected tables [[{key}]]")
        return [_Spec(part, f"{self.where}{key}[{i}].") for i, part in enumerate(content)]

    def text(self, key, *default):
        return self._get(key, str, "a text", *(default or (None,)), not default)

    def flag(self, key) -> bool:
        return self._get(key, bool, "true or false", False, False)

    def number(self, key, *default):
        value = self._get(key, int | float, "a number", *(default or (None,)), not default)
        return None if value is None else float(value)

    def texts(self, key, count, required=True):
        return self._list(key, str, f"a list of {count} column names", count, required)

    def vector(self, key, required=True):
        values = self._list(key, int | float, "a list of 3 numbers", 3, required)
        return None if values is None else np.array(values, dtype=float)

    def _list(self, key, kind, what, count, required):
        values = self._get(key, list, what, None, required)
        if values is not None and not (
            len(values) == count and all(isinstance(v, kind) for v in values)
        ):
            raise RecordingError(f"{self.where}{key} = {values!r}: expected {what}")
        return values

    def unit(self, kind: str, default: str) -> float:
        name = self.text("unit", default)
        if name not in UNITS[kind]:
            raise RecordingError(
                f"{self.where}unit = {name!r}: expected one of {', '.join(UNITS[kind])}"
            )
        return UNITS[kind][name]

    def numbers(self) -> dict[str, float]:
        return {key: self.number(key) for key in self.content}

    def done(self) -> None:
        for key in self.content:
            if key not in self.asked:
                allowed = ", ".join(sorted(self.asked))
                raise RecordingError(f"{self.where}{key}: unknown key; allowed here: {allowed}")


def _read_toml(path) -> _Spec:
    try:
        with open(path, "rb") as file:
            return _Spec(tomllib.load(file), f"{path}: ")
    except OSError as e:
        raise RecordingError(f"{path}: cannot read the mapping: {e.strerror or e}") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as e:
        raise RecordingError(f"{path}: not a TOML file: {e}") from None


def _numbers(table: Table, name: str) -> np.ndarray:
    """A column; a cell that is no number is an error, one that is missing is NaN."""
    values = table.column(name)
    for k in np.flatnonzero(np.isinf(values))[:1]:
        raise RecordingError(
            f"{table.path}: {table.row(k)}, column {name}: not a finite number; leave the cell "
            "empty if the sample is missing"
        )
    return values


def _clock(table: Table, spec: _Spec) -> np.ndarray:
    """Times [s], NaN where the clock has no sample."""
    length = len(next(iter(table.columns.values())))
    if not spec.content:
        return table.interval * np.arange(length)
    rate = spec.number("rate", None)
    if rate is not None:
        spec.done()
        if not rate > 0:
            raise RecordingError(f"{spec.where}rate = {rate:g}: expected a number above 0 [Hz]")
        return np.arange(length) / rate
    name = spec.text("column")
    times = spec.unit("time", "s") * _numbers(table, name)
    spec.done()
    there = np.flatnonzero(np.isfinite(times))
    steps = np.diff(times[there])
    for k in np.flatnonzero(steps <= 0)[:1]:
        what = "repeats the time of" if steps[k] == 0 else "is earlier than"
        raise RecordingError(
            f"{table.path}: {table.row(there[k + 1])}, column {name}: "
            f"{table.column(name)[there[k + 1]]:g} {what} {table.row(there[k])}; time must "
            "increase from row to row: sort the rows and delete repeated ones"
        )
    return times


def _paired(table: Table, name: str, clock: np.ndarray) -> np.ndarray:
    values = _numbers(table, name)
    if len(values) != len(clock):
        raise RecordingError(
            f"{table.path}: column {name}: {len(values)} samples, and its time has {len(clock)}; "
            "give it a time of its own"
        )
    return values


def _tip(table: Table, spec: _Spec, clock, scene):
    part = spec.table("tip")
    own = part.table("time", required=False)
    clock = _clock(table, own) if own.content else clock
    columns = part.texts("columns", 3, required=False)
    markers = part._get("markers", list, "a list of lists of 3 column names", None, False)
    if (columns is None) == (markers is None):
        raise RecordingError(f"{part.where}columns or {part.where}markers: one of them is needed")
    unit, missing = part.unit("length", "m"), part.number("missing", None)
    turn = axes_matrix(part.text("axes", "x,y,z"), part.where)
    origin, rest = part.vector("origin", required=False), part.flag("rest")
    part.done()

    def place(names):
        if not (isinstance(names, list) and len(names) == 3):
            raise RecordingError(f"{part.where}markers: {names!r}: expected 3 column names")
        xyz = np.stack([_paired(table, name, clock) for name in names], axis=1)
        if missing is not None:
            xyz = np.where(xyz == missing, np.nan, xyz)
        return unit * xyz @ turn.T

    tip = np.mean([place(names) for names in (markers or [columns])], axis=0)
    base = spec.tables("base_markers")
    seen, meant = [], []
    for marker in base:
        seen.append(place(marker.texts("columns", 3)))
        meant.append(marker.vector("position"))
        marker.done()
    there = np.isfinite(clock)
    clock, tip, seen = clock[there], tip[there], [s[there] for s in seen]
    notes = ()
    if base:
        tip, notes = from_base_markers(tip, seen, meant, spec.where)
    elif origin is not None:
        tip = tip - turn @ (unit * origin)
    if rest:
        tip, note = from_rest(tip, scene, table.path)
        notes = (*notes, note)
    return tip, clock, notes, not rest


def _input(table: Table, part: _Spec, kind: str, clock, index: int):
    """Times [s] and values [SI] of one actuator, without missing samples."""
    own = part.table("time", required=False)
    clock = _clock(table, own) if own.content else clock
    name = part.text("column")
    values = _paired(table, name, clock)
    scale, offset = part.number("scale", 1.0), part.number("offset", 0.0)
    values = part.unit(kind, {"force": "N", "pressure": "Pa"}[kind]) * scale * (values + offset)
    part.done()
    there = np.isfinite(clock)
    for k in np.flatnonzero(there & ~np.isfinite(values))[:1]:
        raise RecordingError(
            f"{table.path}: {table.row(k)}, column {name}: missing; inputs are needed in every "
            "row (only the tip may be missing): fill it in or delete the row"
        )
    for k in np.flatnonzero(there & (values < 0))[:1] if kind == "force" else ():
        raise RecordingError(
            f"{table.path}: {table.row(k)}, column {name}: {values[k]:.4g} N is negative; a tendon "
            "can only pull: correct the zero of the load cell with `offset`, or the sign with "
            "`scale = -1`"
        )
    return clock[there], values[there]


def _check_counts(mapping, inputs, scene) -> None:
    for name, part in (("tensions", "tendons"), ("pressures", "chambers")):
        actuators = getattr(scene, part)
        count = 0 if actuators is None else actuators.count
        given = len(inputs[name])
        if given not in (0, count):
            raise RecordingError(
                f"{mapping}: {name}: {given} given, and the scene has {count} {part}; one for each "
                "is needed"
            )


def _merged(clock, tip, inputs):
    """One clock for all: every time at which anything was sampled. Inputs change linearly."""
    others = [times for parts in inputs.values() for times, _ in parts]
    times = np.unique(np.concatenate([clock, *others]))
    all_tips = np.full((len(times), 3), np.nan)
    all_tips[np.searchsorted(times, clock)] = tip
    columns = {
        name: np.stack([np.interp(times, *part) for part in parts], axis=1) if parts else None
        for name, parts in inputs.items()
    }
    return times, all_tips, columns
