"""Columns of a log that are measured besides the tip: tensions, the base wrench, curvatures, and
markers."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from calibration.data.quantities import quantities_in_motion
from calibration.data.recording import RecordingError

_TIP_NOISE = "tip_noise_m"


class Measured(NamedTuple):
    """`others` and `noise`, as of a `calibration.data.recording.Recording`."""

    others: dict[str, np.ndarray]
    noise: dict[str, float]


def beside_the_tip(header: list[str], scene, path) -> set[int]:
    """Which columns are of such quantities of the scene, or say how good they or the tip are; none
    without a scene, which says what there is. Raises `RecordingError` for one that is there twice.
    """
    if scene is None:
        return set()
    known = {_TIP_NOISE}
    for quantity in quantities_in_motion(scene).values():
        known |= {*quantity.columns, quantity.noise_column}
    found = {j for j, name in enumerate(header) if j > 0 and name in known}
    for j in found:
        if header.count(header[j]) > 1:
            raise RecordingError(f"{path}: row 1: column {header[j]} is there twice; delete one")
    return found


def measured_beside(columns: Mapping[str, np.ndarray], scene, path) -> Measured:
    """What is in those columns. Raises `RecordingError` for a noise that is not above 0, or not the
    same in all rows."""
    found = Measured({}, {})
    if not columns:
        return found
    for key, quantity in quantities_in_motion(scene).items():
        there = [c for c in quantity.columns if c in columns]
        if there:
            rows = len(columns[there[0]])
            values = [columns.get(c, np.full(rows, np.nan)) for c in quantity.columns]
            found.others[key] = np.stack(values, axis=1)
        if quantity.noise_column in columns:
            found.noise[key] = _noise(columns[quantity.noise_column], quantity.noise_column, path)
    if _TIP_NOISE in columns:
        found.noise["tip"] = _noise(columns[_TIP_NOISE], _TIP_NOISE, path)
    return found


def _noise(values: np.ndarray, column: str, path) -> float:
    first = float(values[0])
    if not (first > 0 and np.all(values == first)):
        raise RecordingError(
            f"{path}: column {column}: {first:g} in the first row; one number above 0, the same in "
            "all rows, is needed"
        )
    return first
