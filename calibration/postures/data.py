"""Postures: what held a robot still, row by row, and where its markers were."""

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

import softrod_jax as sr
from calibration.data.quantities import NOISE as NOISE
from calibration.data.quantities import quantities_of
from calibration.data.recording import RecordingError
from calibration.postures.cells import Cells, read_cells
from softrod_jax.scene.inputs import KINDS, Inputs

_LOG = logging.getLogger(__name__)

# The noise of a marker's attitude where nothing is said [rad].
TURN = 0.01


@dataclass(frozen=True, eq=False)
class Postures:
    """Equilibria under `inputs`, one row each, in the order in which they were taken.

    - `inputs`: arrays (rows, actuators), or `None`.
    - `positions` [m], (rows, 3) by the name of a marker of the scene, or "tip"; NaN where missing.
    - `quaternions` (w, x, y, z), (rows, 4), likewise.
    - `others`: what else was measured, (rows, numbers) by key, such as "tension1"
      (`calibration.data.quantities`).
    - `noise` [m]: of the markers, by name; `NOISE` where nothing is said; [rad] of the attitude of
      one, by NAME_attitude; of what else was measured, by its key. It weighs measurements against
      each other and against priors; how large it is altogether a fit tells.
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
    others: Mapping[str, np.ndarray] = field(default_factory=dict)

    @property
    def rows(self) -> int:
        measured = self.positions, self.quaternions, self.others
        each = (*(x for part in measured for x in part.values()), *self.inputs)
        return next((len(x) for x in each if x is not None), 0)

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
            others={k: x[rows] for k, x in self.others.items()},
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
        together(lambda x: x.others),
    )


def load_postures(path: str | PathLike, scene: sr.Scene) -> Postures:
    """The postures in a CSV log, one row each.

    Columns in any order: `tau1_N`, .., `p1_Pa`, .., `pull1_m`, .. for all actuators of the scene
    that are driven so; `NAME_x_m`, `NAME_y_m`, `NAME_z_m` and `NAME_qw`, .., `NAME_qz` for markers
    of the scene, the tip among them, where an empty cell or `nan` is a missing number; and, where
    they are there, `t_s`, `trial` (a name or a number), `NAME_noise_m` and `NAME_noise_rad`, the
    same in all rows, and the columns of `calibration.data.quantities`.

    Raises `RecordingError` with file, row and column.
    """
    postures = _read(path, scene)
    _LOG.info("%s: %d postures", path, len(postures.labels))
    if not (postures.positions or postures.quaternions or postures.others):
        raise RecordingError(
            f"{path}: nothing was measured: expected columns such as tip_x_m, tip_y_m, tip_z_m"
        )
    return postures


def load_candidates(
    path: str | PathLike, scene: sr.Scene, seen: Sequence[str] | None = None
) -> Postures:
    """Inputs under which postures could be recorded: a log as of `load_postures`, with or without
    measurements.

    `seen`: the markers that will be; by default those that have columns, or else all of the scene
    and the tip. The numbers where nothing was measured stand for themselves.

    Raises `RecordingError` as `load_postures`, and for a marker that the scene does not have.
    """
    postures = _read(path, scene)
    known = ("tip", *(marker.name for marker in scene.markers or ()))
    measured = postures.positions or postures.quaternions or postures.others
    names = tuple(seen or (() if measured else known))
    for name in names:
        if name not in known:
            raise RecordingError(f"{path}: the scene has no marker {name!r}; {', '.join(known)}")
    if not names:
        return postures
    nothing = {name: np.zeros((len(postures.labels), 3)) for name in names}
    return replace(postures, positions=nothing, quaternions={}, others={})


def _read(path: str | PathLike, scene: sr.Scene) -> Postures:
    """What is in the log; there may be no marker."""
    cells = read_cells(path)
    inputs, used = _inputs(cells, scene)
    known = sorted(used - _OTHERS)
    markers = ("tip", *(marker.name for marker in scene.markers or ()))
    positions, quaternions, noise = {}, {}, {}
    for name in markers:
        for suffixes, found in ((("x_m", "y_m", "z_m"), positions), (_QUATERNION, quaternions)):
            columns = [f"{name}_{suffix}" for suffix in suffixes]
            used |= set(columns)
            if all(c in cells.header for c in columns):
                found[name] = cells.numbers(columns)
        for key, column in ((name, f"{name}_noise_m"), (attitude_of(name), f"{name}_noise_rad")):
            noise |= _noise(cells, key, column, used)
    others = {}
    for key, quantity in quantities_of(scene).items():
        used |= set(quantity.columns)
        there = [c for c in quantity.columns if c in cells.header]
        if there:
            values = np.full((len(cells.table), len(quantity.columns)), np.nan)
            values[:, [quantity.columns.index(c) for c in there]] = cells.numbers(there)
            others[key] = values
        noise |= _noise(cells, key, quantity.noise_column, used)
    unknown = [name for name in cells.header if name not in used]
    if unknown:
        raise RecordingError(
            f"{path}: column {unknown[0]!r} is unknown; the scene's markers are "
            f"{', '.join(markers)}, its inputs {', '.join(known)}, and what else can be measured "
            f"is {', '.join(quantities_of(scene))}"
        )
    trials = cells.texts("trial") if "trial" in cells.header else ()
    name = Path(path).stem
    return Postures(inputs, positions, quaternions, noise, trials, name, str(path), others=others)


def attitude_of(name: str) -> str:
    """Under what the noise of a marker's attitude is."""
    return f"{name}_attitude"


def _noise(cells: Cells, key: str, column: str, used: set[str]) -> dict[str, float]:
    """What a column says of the noise of `key`, if it is there."""
    used.add(column)
    if column not in cells.header:
        return {}
    value = float(cells.numbers([column], whole=True)[0, 0])
    if not value > 0:
        raise RecordingError(
            f"{cells.path}: column {column}: {value:g}; a number above 0 is needed"
        )
    return {key: value}


_QUATERNION = ("qw", "qx", "qy", "qz")
_OTHERS = {"t_s", "trial"}


def _inputs(cells: Cells, scene: sr.Scene) -> tuple[Inputs, set[str]]:
    """The inputs, and which columns may be theirs or of what is no measurement."""
    own: dict[str, Any] = {}
    used = set(_OTHERS)
    for kind in KINDS:
        names = [kind.column.format(i + 1) for i in range(kind.count(scene))]
        there = [n for n in names if n in cells.header]
        used |= set(names)
        if there and len(there) < len(names):
            missing = next(n for n in names if n not in cells.header)
            raise RecordingError(
                f"{cells.path}: no column {missing}; one for each of {kind.of(scene)}"
            )
        own[kind.name] = cells.numbers(there, whole=True) if there else None
    return Inputs(**own), used
