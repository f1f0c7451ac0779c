"""An obstacle whose signed distance is given on a regular grid, and the sampling of others.

Between its points stands a cubic B-spline. Newton's method along the rod takes the derivative of
the force, and so the second derivative of the distance: a spline of this kind has one without
jumps, which neither linear interpolation nor the cubics of Catmull and Rom have. Its coefficients
are those of the quasi-interpolant c = v - v''/6, with differences for v'': exact for cubics, with
an error of fourth order in the spacing, and local, so that an edge is not heard of further away
than three points, and no system of equations has to be solved for them.
"""

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from softrod_jax.foundation.numbers import DiagonalLike, Given, RowsLike, VectorLike
from softrod_jax.foundation.precision import require_float64
from softrod_jax.scene.contacts import AbstractObstacle
from softrod_jax.scene.ranges import number
from softrod_jax.scene.scene import map_numbers

# A value at a point of the spline is made of so many along each axis, this many before its cell.
_POINTS, _BEFORE = 6, 2
# A distance changes by one spacing from point to point at most; what does so by more is none.
_STEEPEST = 2.0
_MOST_POINTS = 50_000_000


class DistanceGrid(AbstractObstacle):
    """An obstacle by its signed distance on a regular grid of points.

    - `values` [m], (nx, ny, nz), at least 6 along each axis: the distance from the surface, above
      zero where the rod may be.
    - `origin` [m]: the place of `values[0, 0, 0]`.
    - `spacing` [m]: between points, one number or one for each axis.

    The two outermost layers of points on each side only serve the spline within them. Outside of
    them the distance goes on straight, with the slope that it has at the nearest place of the box:
    the force has no jump there, a body that lies within the grid pushes nothing outside of it, and
    a wall that runs out of it goes on.
    """

    values: Given[RowsLike] = number("m", least=(_POINTS,) * 3, harmless=1.0)
    origin: Given[VectorLike] = number("m", sizes=(3,))
    spacing: Given[DiagonalLike] = number("m", sizes=(0, 3), above=0, harmless=1.0)

    def relations(self):
        """What must hold between the numbers: a field, whether it does, and what is expected."""
        spacing = (jnp if isinstance(self.spacing, jax.Array) else np).broadcast_to(
            self.spacing, (3,)
        )
        for axis in range(3):
            ahead, behind = [slice(None)] * 3, [slice(None)] * 3
            ahead[axis], behind[axis] = slice(1, None), slice(None, -1)
            steps = abs(self.values[tuple(ahead)] - self.values[tuple(behind)])
            expected = lambda axis=axis: (
                f"along {'xyz'[axis]} values change by more than {_STEEPEST:g} of it from point "
                "to point, as no distance does; expected both in metres"
            )
            yield "spacing", steps.max() <= _STEEPEST * spacing[axis], expected

    def distance(self, p):
        x = (p - self.origin) / self.spacing
        last = np.array(self.values.shape, dtype=float) - 1 - _BEFORE
        within = jnp.clip(x, float(_BEFORE), last)
        distance, beyond = jax.jvp(self._spline, (within,), (x - within,))
        return distance + beyond

    def _spline(self, x: Float[Array, "3"]) -> Float[Array, ""]:
        """The spline at `x`, in spacings from the first point."""
        last = np.array(self.values.shape) - _POINTS
        first = jnp.clip(jax.lax.stop_gradient(x).astype(int) - _BEFORE, 0, last)
        c = jax.lax.dynamic_slice(self.values, first, (_POINTS,) * 3)
        # The coefficients of the polynomial in this cell first: its derivatives cost little then.
        for _ in range(3):
            c = jnp.tensordot(c, _POLYNOMIALS, ((0,), (1,)))
        for t in x - _BEFORE - first:
            c = c[0] + t * (c[1] + t * (c[2] + t * c[3]))
        return c


def _polynomials() -> np.ndarray:
    """The spline within a cell: of each power of t, what each of six values has in it, (4, 6)."""
    spline = np.array([[1, 4, 1, 0], [-3, 0, 3, 0], [3, -6, 3, 0], [-1, 3, -3, 1]]) / 6
    return np.stack([np.convolve(row, [-1 / 6, 8 / 6, -1 / 6]) for row in spline])


_POLYNOMIALS = _polynomials()


def sample_distance(
    distance: AbstractObstacle | Callable[[Array], Array],
    lower: VectorLike,
    upper: VectorLike,
    spacing: float,
) -> DistanceGrid:
    """The distance of another obstacle on a grid.

    - `distance`: an obstacle or a function written with JAX, of a place (3,) [m].
    - `lower`, `upper` [m], (3,): opposite corners of the box in which it is to hold. Two layers of
      points more are added on each side.
    - `spacing` [m] between points.

    Raises `ValueError` for corners that are no box, and for more than fifty million points.
    """
    require_float64("sample_distance")
    origin, counts = box_of_points("sample_distance", lower, upper, spacing)
    if isinstance(distance, AbstractObstacle):
        function = map_numbers(lambda x: jnp.asarray(x, dtype=float), distance).distance
    else:
        function = distance
    # A layer at a time: all points at once may be more than fits.
    layer = jax.jit(lambda x: jax.vmap(jax.vmap(function))(x))
    axes = [start + spacing * np.arange(n) for start, n in zip(origin, counts, strict=True)]
    rows = np.stack(np.meshgrid(*axes[1:], indexing="ij"), -1)
    around = lambda x: np.concatenate([np.full((*rows.shape[:2], 1), x), rows], -1)
    values = np.stack([np.asarray(layer(around(x))) for x in axes[0]])
    return DistanceGrid(jnp.asarray(values), jnp.asarray(origin), jnp.asarray(float(spacing)))


def box_of_points(who: str, lower, upper, spacing) -> tuple[np.ndarray, np.ndarray]:
    """The first point [m], (3,), and the numbers of points for a box from `lower` to `upper`.

    Raises `ValueError` for what is no box, or has too many points.
    """
    lower, upper = np.asarray(lower, dtype=float), np.asarray(upper, dtype=float)
    if lower.shape != (3,) or upper.shape != (3,) or not np.all(upper > lower):
        raise ValueError(
            f"{who}: a box from {lower.tolist()} to {upper.tolist()}; expected three numbers each, "
            "the second ones larger"
        )
    if not spacing > 0 or not np.isfinite(spacing):
        raise ValueError(f"{who}: spacing = {spacing}; expected a number above 0 [m]")
    # A box that is a whole number of spacings wide up to rounding has no point more.
    cells = np.ceil((upper - lower) / spacing - 1e-9)
    if np.prod(cells + 1 + 2 * _BEFORE) > _MOST_POINTS:
        raise ValueError(
            f"{who}: {np.prod(cells + 5):.3g} points at a spacing of {spacing} m; expected "
            f"{_MOST_POINTS} at most: give a larger spacing"
        )
    middle = 0.5 * (lower + upper)
    return middle - spacing * (0.5 * cells + _BEFORE), cells.astype(int) + 1 + 2 * _BEFORE
