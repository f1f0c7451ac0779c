"""What the points of a method miss of the push of obstacles.

A touch begins and ends between points of the grid, and there the quadrature of the method is wrong.
Positions between the points are known much better, by polynomials, and so is the push at many
places between them.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from softrod_jax.bvp.method import AbstractMethod
from softrod_jax.rod.constants import Rod
from softrod_jax.rod.ode import pushes_per_length
from softrod_jax.rod.state import Layout
from softrod_jax.scene.planes import vector_in

# Parts of the way from point to point in which a push is looked at.
_PARTS = 4


class Push(NamedTuple):
    """Of obstacles on the intervals of a rod.

    - `missed` [N]: what the quadrature of the method misses, (intervals, 3).
    - `stiffness` [N/m]: how the push falls as the rod moves away, (intervals, 3, 3).
    """

    missed: Float[Array, "intervals 3"]
    stiffness: Float[Array, "intervals 3 3"]


def push_on(y: Float[Array, "points n"], rod: Rod, layout: Layout, method: AbstractMethod) -> Push:
    """That of all obstacles, base frame."""
    base_part = _refined(method.inside(y[:, : layout.base_size]))
    along = lambda x: x if jnp.ndim(x) == 0 else _refined(method.inside(x))
    s, radius = along(rod.s), along(rod.radius)

    def at(p):
        here = jnp.concatenate([p, base_part[..., layout.vector :]], -1)
        return pushes_per_length(here, rod, layout, s, radius)

    p = base_part[..., : layout.vector]
    f = at(p)
    normal = f / jnp.sqrt(jnp.maximum(jnp.sum(f * f, -1, keepdims=True), 1e-300))
    # What holds the rod is along the push; friction is beside it.
    moved = vector_in(rod.plane, normal)
    slope = -jnp.sum(normal * jax.jvp(at, (p,), (moved,))[1], -1)[..., None, None]
    held = jnp.maximum(slope, 0.0) * normal[..., :, None] * normal[..., None, :]
    h = jnp.broadcast_to(jnp.diff(method.outputs(rod.grid.s)), f.shape[:1])
    by_parts, by_points = _rules(f.shape[1])
    missed = jnp.einsum("k,p,kpi->ki", h, by_parts - by_points, f)
    return Push(missed, jnp.einsum("k,p,kpij->kij", h, by_parts, held))


def _rules(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Weights of so many places of an interval: of all, and of the points of the method."""
    by_parts, by_points = np.ones(count), np.zeros(count)
    by_parts[[0, -1]] = 0.5
    points = (count - 1) // _PARTS + 1
    at, power = np.linspace(0.0, 1.0, points), np.arange(points)[:, None]
    by_points[::_PARTS] = np.linalg.solve(at**power, 1 / (power[:, 0] + 1))
    return by_parts / np.sum(by_parts), by_points


def _refined(values: Float[Array, "intervals k *n"]) -> Float[Array, "intervals m *n"]:
    """Polynomials through points of each interval, at `_PARTS` times as many."""
    k = values.shape[1]
    at = np.linspace(0.0, k - 1.0, _PARTS * (k - 1) + 1)[:, None, None]
    points, others = np.arange(k), ~np.eye(k, dtype=bool)
    numerator = np.prod(np.where(others, at - points, 1.0), -1)
    weights = numerator / np.prod(np.where(others, points[:, None] - points, 1), -1)
    return jnp.einsum("mk,ik...->im...", weights, values)
