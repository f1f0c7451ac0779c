"""Recordings of a robot: what was done to it and where its tip went.

`load_recording` reads the log format of this project (CSV), motion capture (C3D) and, with a
mapping of their columns, other tables. SI units; a sample of the tip that is missing is NaN.
"""

import csv
import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from os import PathLike
from pathlib import Path

import numpy as np

# A rod under its own pressure may grow, but a tip further off than this is a wrong unit.
_LARGEST_REACH = 1.5
_TIP = ["tip_x_m", "tip_y_m", "tip_z_m"]


class RecordingError(ValueError):
    """A recording that cannot be used: the message names file, row, column, value and remedy."""


@dataclass(frozen=True, eq=False)
class Recording:
    """One experiment, sampled at `times`.

    - `times` [s], (T,), strictly increasing; the recording's own clock.
    - `tensions` [N], (T, tendons), or None if the recording has none.
    - `pressures` [Pa], (T, chambers), or None if the recording has none.
    - `tip_positions` [m], (T, 3), in the scene's frame; NaN where a coordinate is missing.
    - `name`: short, for plots and reports. `source`: the file, or how it was made.
    - `origin_known`: False if the file does not say where the clamp is, so that the tip was
      put in place by its rest position; only its displacement is then a measurement.
    - `notes`: what the reader had to assume.
    - `starts_hanging`: whether the rod begins in equilibrium under the first inputs, and not
      straight; None: told by the first sample of the tip.
    - `conditions`: values of parameters in which this experiment differs from the scene, by name
      (`calibration.parameters`), such as {"payload_mass": 0.052}.
    """

    times: np.ndarray
    tensions: np.ndarray | None
    pressures: np.ndarray | None
    tip_positions: np.ndarray
    name: str = "recording"
    source: str = ""
    origin_known: bool = True
    notes: tuple[str, ...] = ()
    starts_hanging: bool | None = None
    conditions: Mapping[str, float] = field(default_factory=dict)

    @property
    def has_tip(self) -> np.ndarray:
        """(T,) bool: whether the sample has all three coordinates of the tip."""
        return np.all(np.isfinite(self.tip_positions), axis=1)

    def window(self, start: float, end: float) -> "Recording":
        """The samples with start <= time <= end [s], on the same clock.

        Raises `RecordingError` if fewer than two are left.
        """
        keep = (self.times >= start) & (self.times <= end)
        if np.count_nonzero(keep) < 2:
            raise RecordingError(
                f"{self.source or self.name}: the window {start:g} to {end:g} s holds fewer than "
                f"two samples; the recording runs from {self.times[0]:g} to {self.times[-1]:g} s"
            )
        return replace(
            self,
            times=self.times[keep],
            tensions=None if self.tensions is None else self.tensions[keep],
            pressures=None if self.pressures is None else self.pressures[keep],
            tip_positions=self.tip_positions[keep],
        )


def load_recording(
    path: str | PathLike,
    scene=None,
    *,
    mapping: str | PathLike | None = None,
    need_tip: bool = True,
    **c3d_options,
) -> Recording:
    """The recording in `path`: a .csv log, a .c3d motion capture or, with a mapping, any table.

    With a `scene`, the log must have a column for each of its tendons and chambers, and the
    tip must be within reach of the rod. `mapping`: a file that says which columns of a .csv, .mat,
    .h5, .parquet or .c3d are what, see `calibration.mapping`. Without one a .csv has this project's
    columns, see `read_log`, and a .c3d is read by `calibration.c3d.read_c3d`, whose options are
    `tip_markers`, `base_markers` and `axes`. Both kinds but the .csv need the scene.
    `need_tip=False` accepts a CSV without tip columns: inputs alone.

    Raises `RecordingError` (a `ValueError`) naming file, row, column, value and remedy.
    """
    suffix = Path(path).suffix.lower()
    if c3d_options and (suffix != ".c3d" or mapping is not None):
        names = ", ".join(c3d_options)
        raise RecordingError(
            f"{path}: {names}: options of .c3d files without a mapping only; leave them out"
        )
    if mapping is not None:
        from calibration.mapping import read_mapped

        if scene is None:
            raise RecordingError(f"{path}: to read it by a mapping, give the scene")
        return read_mapped(path, mapping, scene)
    if suffix == ".csv":
        return read_log(path, scene, need_tip=need_tip)
    if suffix == ".c3d":
        from calibration.c3d import read_c3d  # needs an optional package

        return read_c3d(path, scene, **c3d_options)
    raise RecordingError(
        f"{path}: unknown kind of recording {suffix!r}: expected .csv or .c3d; .mat, .h5 and "
        ".parquet need a mapping that says which columns are what"
    )


def read_log(path: str | PathLike, scene=None, *, need_tip: bool = True) -> Recording:
    """The CSV log in `path`; see `load_recording`.

    Columns, in this order: t_s, tau1_N, tau2_N, .. (a tension per tendon), p1_Pa, .. (a
    pressure per chamber), tip_x_m, tip_y_m, tip_z_m. An empty cell or `nan` is a missing
    coordinate of the tip; time and inputs must be complete. Rows in messages are lines of the
    file, the header being row 1.
    """
    header, rows, lines = _cells(path)
    tendons, chambers = _check_header(header, path, scene, need_tip)
    if not rows:
        raise RecordingError(f"{path}: a header and no rows: nothing was recorded")
    values = np.empty((len(rows), len(header)))
    for k, (row, line) in enumerate(zip(rows, lines, strict=True)):
        if len(row) != len(header):
            raise RecordingError(
                f"{path}: row {line}: {len(row)} cells, and the header has {len(header)} columns"
            )
        for j, text in enumerate(row):
            values[k, j] = _number(text, f"{path}: row {line}, column {header[j]}", header[j])
    _check_values(values, header, lines, path, tendons)
    tip = values[:, 1 + tendons + chambers :]
    recording = Recording(
        times=values[:, 0],
        tensions=values[:, 1 : 1 + tendons] if tendons else None,
        pressures=values[:, 1 + tendons : 1 + tendons + chambers] if chambers else None,
        tip_positions=tip if tip.shape[1] else np.full((len(rows), 3), np.nan),
        name=Path(path).stem,
        source=str(path),
    )
    if need_tip and not np.any(np.isfinite(tip)):
        raise RecordingError(f"{path}: columns {', '.join(_TIP)}: every sample is missing")
    check_reach(recording, scene, [f"row {line}" for line in lines])
    return recording


def write_log(
    path: str | PathLike, times, tensions=None, pressures=None, tip_positions=None
) -> None:
    """Write a CSV log that `read_log` reads back bit by bit.

    `times` [s] (T,), `tensions` [N] (T, tendons), `pressures` [Pa] (T, chambers) and
    `tip_positions` [m] (T, 3), NaN where missing; columns of what is `None` are left out.
    Raises `OSError` if the file cannot be written.
    """
    header, columns = ["t_s"], [np.reshape(times, (-1, 1))]
    if tensions is not None:
        header += [f"tau{i + 1}_N" for i in range(np.shape(tensions)[1])]
        columns.append(tensions)
    if pressures is not None:
        header += [f"p{i + 1}_Pa" for i in range(np.shape(pressures)[1])]
        columns.append(pressures)
    if tip_positions is not None:
        header += _TIP
        columns.append(tip_positions)
    table = np.hstack([np.asarray(c, dtype=np.float64) for c in columns]).tolist()
    with open(path, "w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(header)
        writer.writerows([["" if math.isnan(x) else repr(x) for x in row] for row in table])


def check_reach(recording: Recording, scene, labels: list[str]) -> None:
    """Refuse a tip that the rod cannot reach; `labels` (T,) name the samples in the message.

    A wrong unit is the usual reason, and otherwise ends in a fit of nonsense.
    """
    if scene is None:
        return
    base = np.zeros(3) if scene.base_position is None else np.asarray(scene.base_position)
    stretch = 1.0 if scene.rest_stretch is None else np.linalg.norm(scene.rest_stretch)
    length = float(scene.length)
    reach = _LARGEST_REACH * length * stretch
    # A missing coordinate is NaN and counts as zero here: it can only bring the tip nearer.
    distance = np.linalg.norm(np.nan_to_num(recording.tip_positions - base), axis=1)
    if not np.any(distance > reach):
        return
    k = int(np.argmax(distance > reach))
    tip = ", ".join(f"{x:g}" for x in recording.tip_positions[k])
    in_mm = np.nan_to_num(recording.tip_positions / 1000 - base)
    remedy = (
        "dividing the tip by 1000 would fit: is it in millimetres?"
        if np.median(distance) > reach and np.all(np.linalg.norm(in_mm, axis=1) <= reach)
        else "check the unit (m), the scene's length and that the clamp is the origin"
    )
    raise RecordingError(
        f"{recording.source}: {labels[k]}, columns {', '.join(_TIP)}: the tip ({tip}) is "
        f"{distance[k]:.4g} m from the base of a rod {length:g} m long; {remedy}"
    )


def _cells(path) -> tuple[list[str], list[list[str]], list[int]]:
    """Header, rows and each row's line in the file; blank lines are passed over."""
    try:
        with open(path, newline="", encoding="utf-8-sig") as file:
            reader = csv.reader(file, strict=True)
            table = [
                ([cell.strip() for cell in row], reader.line_num)
                for row in reader
                if any(cell.strip() for cell in row) or len(row) > 1
            ]
    except UnicodeDecodeError as e:
        raise RecordingError(f"{path}: not UTF-8 text (byte {e.start}): is it a CSV?") from None
    except csv.Error as e:
        raise RecordingError(f"{path}: row {reader.line_num}: not a CSV file: {e}") from None
    except (OSError, ValueError) as e:
        reason = getattr(e, "strerror", None) or e
        raise RecordingError(f"{path}: cannot read the recording: {reason}") from None
    if not table:
        raise RecordingError(f"{path}: empty: expected a header row t_s, .., {', '.join(_TIP)}")
    rows, lines = zip(*table[1:], strict=True) if len(table) > 1 else ((), ())
    return table[0][0], list(rows), list(lines)


def _check_header(header, path, scene, need_tip) -> tuple[int, int]:
    """The numbers of tension and of pressure columns; anything but the format is an error."""
    if len(header) == 1 and ";" in header[0]:
        raise RecordingError(f"{path}: row 1: cells are separated by ';', expected commas")
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
        expected += _TIP
    if header == expected:
        return tendons, chambers
    for j, wanted in enumerate(expected):
        if j >= len(header):
            problem = f"column {wanted} is missing"
            break
        if header[j] != wanted:
            quantity = wanted.rsplit("_", 1)[0]
            problem = f"column {j + 1} is {header[j]!r}, expected {wanted!r}"
            if header[j].rsplit("_", 1)[0] == quantity:
                problem += f"; convert it to {wanted.rsplit('_', 1)[1]} and rename it"
            break
    else:
        problem = f"column {len(expected) + 1} is {header[len(expected)]!r}, one too many"
    raise RecordingError(f"{path}: row 1: {problem} ({whose} {', '.join(expected)})")


def _number(text: str, where: str, column: str) -> float:
    if text == "":
        return math.nan
    try:
        value = float(text) if "_" not in text else None  # Python would read 1_0 as 10
    except ValueError:
        value = None
    if value is None or math.isinf(value):
        missing = "; leave the cell empty if the sample is missing" if column in _TIP else ""
        raise RecordingError(f"{where}: {text!r} is not a finite number{missing}")
    return value


def _check_values(values, header, lines, path, tendons) -> None:
    inputs = values[:, : len(header) - (3 if header[-1] == _TIP[-1] else 0)]
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
    for k, j in np.argwhere(values[:, 1 : 1 + tendons] < 0)[:1]:
        raise RecordingError(
            f"{path}: row {lines[k]}, column {header[1 + j]}: {float(values[k, 1 + j])!r} is "
            "negative; a tendon can only pull: give the tension [N], at least 0"
        )
