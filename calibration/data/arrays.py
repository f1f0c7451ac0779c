"""Arrays of trials as columns: what a MAT or an HDF5 file holds of an experiment made many times.

An array of three dimensions has one for the trials, which a mapping names, one for the samples, the
longer of the two others, and one for the coordinates. Beside it are arrays of two, (trials,
samples) in either order, such as an input, and of one, the samples, such as a clock that all trials
share.
"""

from collections.abc import Mapping

import numpy as np

from calibration.data.recording import RecordingError

TRIAL = "trial"  # the column that numbers them, from 1


def stacked(path, arrays: Mapping[str, np.ndarray], axis: int) -> dict[str, np.ndarray]:
    """One column for each coordinate, all trials one after the other, and `TRIAL`.

    `axis`: that of the trials, counted from 1. Arrays that do not belong to them are left out.
    Raises `RecordingError` if there is no array of three dimensions, or if two differ.
    """
    whole = {name: a for name, a in arrays.items() if a.ndim == 3}
    if not whole:
        raise RecordingError(
            f"{path}: [trials] axis = {axis}: there is no array of three dimensions; name a column "
            "that numbers trials instead"
        )
    cubes = {name: _ordered(a, axis - 1) for name, a in whole.items()}
    sizes = {name: cube.shape[:2] for name, cube in cubes.items()}
    if len(set(sizes.values())) > 1:
        listed = ", ".join(f"{name} {n} trials of {m} samples" for name, (n, m) in sizes.items())
        raise RecordingError(f"{path}: [trials] axis = {axis}: arrays differ: {listed}")
    trials, samples = next(iter(sizes.values()))
    columns = {TRIAL: np.repeat(np.arange(1.0, trials + 1), samples)}
    for name, cube in cubes.items():
        for j in range(cube.shape[2]):
            columns[f"{name}[{j + 1}]"] = cube[:, :, j].ravel()
    for name, a in arrays.items():
        if a.ndim == 2 and a.shape in ((trials, samples), (samples, trials)):
            columns[name] = (a if a.shape == (trials, samples) else a.T).ravel()
        elif a.ndim == 1 and a.size == samples:
            columns[name] = np.tile(a, trials)
    return columns


def _ordered(array: np.ndarray, axis: int) -> np.ndarray:
    """The array as (trials, samples, coordinates)."""
    cube = np.moveaxis(array, axis, 0)
    return cube if cube.shape[1] >= cube.shape[2] else np.swapaxes(cube, 1, 2)
