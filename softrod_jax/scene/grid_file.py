"""Files of distances on a grid: the arrays `values`, `origin` and `spacing` in a .npz of numpy."""

import zipfile
from os import PathLike

import jax.numpy as jnp
import numpy as np

from softrod_jax.foundation.precision import require_float64
from softrod_jax.foundation.whole_files import whole_file
from softrod_jax.scene.distance_grid import DistanceGrid
from softrod_jax.scene.ranges import numbers_of

_NAMES = ("values", "origin", "spacing")


def load_grid(path: str | PathLike) -> DistanceGrid:
    """The distances in the file `path`, as a scene file has them under `file`.

    Raises `ValueError`, which names the file, for one that cannot be read, an array that is not in
    it, and a wrong shape or number; also if JAX is not set to float64.
    """
    require_float64("load_grid")
    try:
        with np.load(path, allow_pickle=False) as file:
            found = {name: file[name] for name in _NAMES if name in file}
    except (OSError, ValueError, EOFError, TypeError, zipfile.BadZipFile) as e:
        reason = getattr(e, "strerror", None) or "it is no .npz file of numbers"
        raise ValueError(f"{path}: cannot read the grid: {reason}") from None
    for name, number in numbers_of(DistanceGrid).items():
        if name not in found:
            raise ValueError(f"{path}: {name} is missing: expected {', '.join(_NAMES)}")
        array = found[name]
        if array.dtype.kind not in "iuf" or not number.has_shape(array.shape):
            shown = f"of shape {array.shape} and type {array.dtype}"
            raise ValueError(f"{path}: {name} {shown}: expected {number}")
        if not np.all(number.fits(array, np)):
            raise ValueError(f"{path}: {name} has numbers that cannot be: expected {number}")
    return DistanceGrid(*(jnp.asarray(found[name], dtype=float) for name in _NAMES))


def save_grid(grid: DistanceGrid, path: str | PathLike) -> None:
    """Write `grid` to `path`, a .npz, so that `load_grid(path)` gives the same numbers.

    Raises `OSError` if the file cannot be written.
    """
    values, origin, spacing = (np.asarray(getattr(grid, name), dtype=float) for name in _NAMES)
    with whole_file(path, "wb") as file:
        np.savez(file, values=values, origin=origin, spacing=spacing)
