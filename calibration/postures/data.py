"""Postures: what held a robot still, row by row, and where its markers were."""

import csv
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

import softrod_jax as sr
from calibration.data.recording import RecordingError
from calibration.data.text_files import read_lines
from softrod_jax.scene.inputs import KINDS, Inputs

# The noise of a marker where nothing is said [m], and of an attitude [rad].
NOISE, TURN = 1e-3, 0.01
_MISSING = ("", "nan", "na")


@dataclass(frozen=True, eq=False)
class Postures:
    """Equilibria under `inputs`, one row each, in the order in which they were taken.

    - `inputs`: arrays (rows, actuators), or `None`.
    - `positions` [m], (rows, 3) by the name of a marker of the scene, or "tip"; NaN where missing.
    - `quaternions` (w, x, y, z), (rows, 4), likewise.
    - `noise` [m]: of the markers, by name; `NOISE` where nothing is said. It weighs markers against
      each other and against priors; how large it really is a fit tells.
    - `trials`: for each row what it belongs to, such as a pattern: rows of one are taken one after
      the other, and are kept aside together.
    - `name`, `source`: for messages and reports. `parts`: names and rows of the logs that it is
      made from, where there are several.
    """

    inputs: Inputs
    positions: Mapping[str, np.ndarray]
    quaternions: Mapping[str, np.ndarray] = field(default_factory=dict)
    noise: Mapping[str, float] = field(default_factory=dict)
    trials: tuple[str, ...] = ()
    name: str = "postures"
    source: str = ""
    parts: tuple[tuple[str, int], ...] = ()

    @property
    def rows(self) -> int:
        return len(next(iter((*self.positions.values(), *self.quaternions.values()))))

    @property
    def labels(self) -> np.ndarray:
        """The trial of each row; one for all where none is named."""
        return np.array(self.trials or [""] * self.rows)

    def take(self, rows) -> "Postures":
        """Some of the rows, by index or by a mask."""
        chosen = lambda x: None if x is None else np.asarray(x)[rows]
        return replace(
            self,
            inputs=Inputs(*map(chosen, self.inputs)),
            positions={k: x[rows] for k, x in self.positions.items()},
            quaternions={k: x[rows] for k, x in self.quaternions.items()},
            trials=tuple(self.labels[rows]) if self.trials else (),
            parts=(),
        )


def joined(logs: Sequence[Postures]) -> Postures:
    """Several logs as one; trials of different logs stay apart.

    Raises `RecordingError` if they have different inputs.
    """
    if len(logs) == 1:
        return logs[0]
    first = logs[0]
    for log in logs:
        same = [a is None for a in log.inputs] == [b is None for b in first.inputs]
        if not same:
            raise RecordingError(f"{log.source}: other inputs than {first.source} has")
    together = lambda pick: {
        name: np.concatenate([pick(x).get(name, np.full((x.rows, n), np.nan)) for x in logs])
        for x in logs
        for name, values in pick(x).items()
        for n in (values.shape[1],)
    }
    inputs = (None if x[0] is None else np.concatenate(x) for x in zip(*(x.inputs for x in logs)))
    trials = tuple(f"{x.name}: {t}" for x in logs for t in x.labels.tolist())
    return Postures(
        Inputs(*inputs),
        together(lambda x: x.positions),
        together(lambda x: x.quaternions),
        {k: v for x in logs for k, v in x.noise.items()},
        trials if any(x.trials for x in logs) else (),
        ", ".join(x.name for x in logs),
        "\n".join(x.source for x in logs),
        tuple((x.name, x.rows) for x in logs),
    )


def load_postures(path: str | PathLike, scene: sr.Scene) -> Postures:
    """The postures in a CSV log, one row each.

    Columns in any order: `tau1_N`, .., `p1_Pa`, .., `pull1_m`, .. for all actuators of the scene
    that are driven so; `NAME_x_m`, `NAME_y_m`, `NAME_z_m` and `NAME_qw`, .., `NAME_qz` for markers
    of the scene, the tip among them, where an empty cell or `nan` is a missing number; and, where
    they are there, `t_s`, `trial` (a name or a number) and `NAME_noise_m`, the same in all rows.

    Raises `RecordingError` with file, row and column.
    """
    header, table = _cells(path)
    own: dict[str, Any] = {}
    used = {"t_s", "trial"}
    for kind in KINDS:
        names = [kind.column.format(i + 1) for i in range(kind.count(scene))]
        there = [n for n in names if n in header]
        used |= set(names)
        if there and len(there) < len(names):
            missing = next(n for n in names if n not in header)
            raise RecordingError(f"{path}: no column {missing}; one for each of {kind.of(scene)}")
        own[kind.name] = _numbers(path, header, table, there, whole=True) if there else None
    markers = ("tip", *(marker.name for marker in scene.markers or ()))
    positions, quaternions, noise = {}, {}, {}
    for name in markers:
        for suffixes, found in ((("x_m", "y_m", "z_m"), positions), (_QUATERNION, quaternions)):
            columns = [f"{name}_{suffix}" for suffix in suffixes]
            used |= set(columns)
            if all(c in header for c in columns):
                found[name] = _numbers(path, header, table, columns)
        if (column := f"{name}_noise_m") in header:
            used.add(column)
            noise[name] = float(_numbers(path, header, table, [column], whole=True)[0, 0])
    unknown = [name for name in header if name not in used]
    if unknown:
        raise RecordingError(
            f"{path}: column {unknown[0]!r} is unknown; the scene's markers are "
            f"{', '.join(markers)}, and its inputs {', '.join(sorted(used - {'t_s', 'trial'}))}"
        )
    if not positions and not quaternions:
        raise RecordingError(f"{path}: no marker: expected columns tip_x_m, tip_y_m, tip_z_m")
    trials = ()
    if "trial" in header:
        trials = tuple(row[header.index("trial")] for _, row in table)
    return Postures(
        Inputs(**own), positions, quaternions, noise, trials, Path(path).stem, str(path)
    )


_QUATERNION = ("qw", "qx", "qy", "qz")


def _cells(path):
    """The header, and the rows with their lines."""
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
    return header, table


def _numbers(path, header, table, columns, whole=False) -> np.ndarray:
    """(rows, columns); NaN where a cell is empty, which is an error if they must be `whole`."""
    out = np.full((len(table), len(columns)), np.nan)
    for i, (line, row) in enumerate(table):
        for j, column in enumerate(columns):
            text = row[header.index(column)]
            if text.lower() in _MISSING:
                value = math.nan
            else:
                try:
                    value = float(text)
                except ValueError:
                    value = math.inf
            if math.isinf(value) or (whole and math.isnan(value)):
                raise RecordingError(
                    f"{path}: row {line}, column {column}: {text!r} is not a finite number"
                )
            out[i, j] = value
    return out
