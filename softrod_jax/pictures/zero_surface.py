"""The surface of an obstacle that is a distance on a grid: faces where the distance is zero.

A coarse grid of cubes is laid about the rod. A cube through which the surface goes has one corner
of it, and four cubes around an edge whose ends have different signs make a face (dual contouring).
"""

import jax
import numpy as np

from softrod_jax.scene.distance_grid import DistanceGrid

# So many cubes along the longest side: more are not seen, and make a film slow.
_CUBES = 24
# Steps along the slope onto the surface.
_STEPS = 4


def zero_faces(grid: DistanceGrid, places: np.ndarray, size: float) -> np.ndarray:
    """The quadrangles [m], (faces, 4, 3), of the surface up to `size` [m] around `places`, (n, 3).

    None where the surface does not come that near, or is not within the grid.
    """
    first = np.asarray(grid.origin) + 2 * np.asarray(grid.spacing)
    last = first + (np.array(grid.values.shape) - 5) * np.asarray(grid.spacing)
    low, high = np.maximum(first, places.min(0) - size), np.minimum(last, places.max(0) + size)
    if np.any(high <= low):
        return np.zeros((0, 4, 3))
    step = np.max(high - low) / _CUBES
    counts = np.maximum(np.round((high - low) / step).astype(int), 1)
    axes = [np.linspace(a, b, n + 1) for a, b, n in zip(low, high, counts, strict=True)]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), -1)
    distance = jax.jit(jax.vmap(grid.distance))(points.reshape(-1, 3))
    inside = np.asarray(distance).reshape(points.shape[:3]) < 0
    faces = np.concatenate([_around_edges(inside, axis) for axis in range(3)])
    middles = points[:-1, :-1, :-1] + (high - low) / counts / 2
    used, numbers = np.unique(faces, return_inverse=True)
    return _onto(grid, middles.reshape(-1, 3)[used], low, high)[numbers.reshape(-1, 4)]


def is_around(grid: DistanceGrid) -> bool:
    """Whether the obstacle is at most of the grid's edge, so that the rod is within it."""
    values = np.asarray(grid.values)
    sides = [np.take(values, k, axis).ravel() for axis in range(3) for k in (0, -1)]
    return bool(np.median(np.concatenate(sides)) < 0)


def _around_edges(inside: np.ndarray, axis: int) -> np.ndarray:
    """The four cubes, by their numbers, around each edge along `axis` that the surface cuts."""
    cubes = np.arange(np.prod(np.array(inside.shape) - 1)).reshape(np.array(inside.shape) - 1)
    turned = np.moveaxis(inside, axis, 0)
    # Edges on a side of the box have no four cubes.
    cut = (turned[1:] != turned[:-1])[:, 1:-1, 1:-1]
    c = np.moveaxis(cubes, axis, 0)
    around = c[:, :-1, :-1], c[:, 1:, :-1], c[:, 1:, 1:], c[:, :-1, 1:]
    return np.stack([x[cut] for x in around], -1)


def _onto(grid: DistanceGrid, points: np.ndarray, low, high) -> np.ndarray:
    """Points moved along the slope of the distance until that is zero, within the box."""
    both = jax.jit(jax.vmap(jax.value_and_grad(grid.distance)))
    for _ in range(_STEPS if len(points) else 0):
        distance, slope = map(np.asarray, both(points))
        square = np.maximum(np.sum(slope**2, -1), 0.1)
        points = np.clip(points - (distance / square)[:, None] * slope, low, high)
    return points
