"""Reading a recording, whatever kind of file it is in."""

import logging
import os
from collections.abc import Sequence
from dataclasses import replace
from os import PathLike
from pathlib import Path

import numpy as np

from calibration.data.c3d import read_c3d
from calibration.data.carried import standing_still
from calibration.data.log import read_log
from calibration.data.mapping import read_mapped
from calibration.data.recording import Recording, RecordingError
from calibration.data.trials import files_of

_LOG = logging.getLogger(__name__)


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
    .h5, .parquet or .c3d are what, see `calibration.data.mapping`; by default the file of that name
    with .map.toml in place of its ending, if it is there, which `softrod import` writes. Without
    one a .csv has this project's columns, see `read_log`, and a .c3d is read by
    `calibration.data.c3d.read_c3d`, whose options are `tip_markers`, `base_markers` and `axes`, and
    which needs the scene. `need_tip=False` accepts a CSV without tip columns, and a mapping without
    [tip]: inputs alone.

    Raises `RecordingError` (a `ValueError`) naming file, row, column, value and remedy.
    """
    found = load_recordings(path, scene, mapping=mapping, need_tip=need_tip, **c3d_options)
    if len(found) > 1:
        raise RecordingError(
            f"{path}: holds {len(found)} trials, {', '.join(r.name for r in found[:20])}: read "
            "them with load_recordings, or choose one with [trials] only"
        )
    return found[0]


def load_recordings(
    paths: str | PathLike | Sequence[str | PathLike],
    scene=None,
    *,
    mapping: str | PathLike | None = None,
    need_tip: bool = True,
    **c3d_options,
) -> list[Recording]:
    """All recordings in the files `paths`, among which may be patterns such as "run_*.csv".

    A mapping may divide a file into trials, see `calibration.data.mapping`; each of them is a
    recording. Everything else is as for `load_recording`.
    """
    given = [paths] if isinstance(paths, str | PathLike) else paths
    # A number near the largest becomes infinite on the way, and is then out of reach.
    with np.errstate(over="ignore", invalid="ignore"):
        found = [
            recording
            for path in files_of(given)
            for recording in _told(_load(path, scene, mapping, need_tip, c3d_options))
        ]
    return [replace(r, notes=(*r.notes, *standing_still(scene, r))) for r in found]


def mapping_beside(path: str | PathLike) -> Path | None:
    """The mapping of a recording that is used if no other is given; None if there is none."""
    beside = mapping_name(path)
    return beside if beside is not None and os.path.exists(beside) else None


def mapping_name(path: str | PathLike) -> Path | None:
    """What that is called; None for what is no name of a file."""
    return Path(path).with_suffix(".map.toml") if Path(path).name else None


def _told(recordings: list[Recording]) -> list[Recording]:
    for recording in recordings:
        _LOG.info("%s: %d samples", recording.name, len(recording.times))
        for assumption in recording.notes:
            _LOG.info("%s: %s", recording.name, assumption)
    return recordings


def _load(path, scene, mapping, need_tip, c3d_options) -> list[Recording]:
    suffix = Path(path).suffix.lower()
    if mapping is None and not c3d_options:
        mapping = mapping_beside(path)
    _LOG.info(
        "reading %s" if mapping is None else "reading %s by %s", *filter(None, (path, mapping))
    )
    if c3d_options and (suffix != ".c3d" or mapping is not None):
        names = ", ".join(c3d_options)
        raise RecordingError(
            f"{path}: {names}: options of .c3d files without a mapping only; leave them out"
        )
    if mapping is not None:
        return read_mapped(path, mapping, scene, need_tip)
    if suffix == ".csv":
        return [read_log(path, scene, need_tip=need_tip)]
    if suffix == ".c3d":
        return [read_c3d(path, scene, **c3d_options)]
    raise RecordingError(
        f"{path}: unknown kind of recording {suffix!r}: expected .csv or .c3d; .mat, .h5, "
        f".parquet and other tables need a mapping that says which columns are what: `softrod "
        f"import {path}` writes one"
    )
