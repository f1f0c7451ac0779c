"""Motions as logs: CSV files with SI units in the names of their columns."""

import csv
import math
from os import PathLike

import numpy as np

from softrod_jax.foundation.whole_files import whole_file
from softrod_jax.scene.inputs import KINDS

# The columns of the tip in a log.
TIP_COLUMNS = ["tip_x_m", "tip_y_m", "tip_z_m"]


def force_columns(contact: str) -> list[str]:
    """The columns of the force with which the obstacle of this name pushes the rod."""
    return [f"{contact}_f{axis}_N" for axis in "xyz"]


def pose_columns(name: str) -> list[str]:
    """The columns of where the base ("base") or the obstacle of this name is carried: position and
    quaternion (w, x, y, z)."""
    return [f"{name}_{axis}_m" for axis in "xyz"] + [f"{name}_q{axis}" for axis in "wxyz"]


def write_log(
    path: str | PathLike,
    times,
    tensions=None,
    pressures=None,
    tip_positions=None,
    markers: dict | None = None,
    pulls=None,
    contact_forces: dict | None = None,
    carried: dict | None = None,
) -> None:
    """Write a CSV log that `calibration.load_recording` reads back bit by bit.

    `times` [s] (T,), `tensions` [N] (T, tendons driven by tension), `pressures` [Pa] (T, chambers),
    `pulls` [m] (T, tendons driven by length) and `tip_positions` [m] (T, 3), NaN where missing;
    columns of what is `None` are left out. `markers` [m] and `contact_forces` [N]: by name, (T, 3)
    each, the columns `force_columns` of them. `carried`: where the base and obstacles are, by name,
    (T, 7) each, position [m] and quaternion (w, x, y, z), in the columns `pose_columns`.
    Raises `OSError` if the file cannot be written, which then stays as it was.
    """
    header, columns = ["t_s"], [np.reshape(times, (-1, 1))]
    for kind, values in zip(KINDS, (tensions, pressures, pulls), strict=True):
        if values is not None:
            header += [kind.column.format(i + 1) for i in range(np.shape(values)[1])]
            columns.append(values)
    if tip_positions is not None:
        header += TIP_COLUMNS
        columns.append(tip_positions)
    for name, poses in (carried or {}).items():
        header += pose_columns(name)
        columns.append(poses)
    for name, positions in (markers or {}).items():
        header += [f"{name}_{axis}_m" for axis in "xyz"]
        columns.append(positions)
    for name, forces in (contact_forces or {}).items():
        header += force_columns(name)
        columns.append(forces)
    table = np.hstack([np.asarray(c, dtype=np.float64) for c in columns]).tolist()
    with whole_file(path, newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(header)
        writer.writerows([["" if math.isnan(x) else repr(x) for x in row] for row in table])
