"""Whether a rod passes through itself: the smallest gap between parts of its own surface.

The rod does not touch itself: no force keeps its parts from each other. What has been solved can be
asked whether they would have met.
"""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from softrod_jax.foundation.precision import require_float64
from softrod_jax.rod.rotations import to_base
from softrod_jax.scene.scene import Scene, as_arrays
from softrod_jax.scene.sections import Annulus, Circle, Rectangle

# Pieces between two outputs of a solution.
_PIECES = 6
# The surface of a rod is not apart from that of its neighbours. Nearer along the rod than half a
# turn around its own radius, parts of it cannot touch unless its sections meet in the inside of a
# bend.
_HALF_TURN = np.pi


def self_distance(scene: Scene, found: Any) -> Float[Array, "*times"]:
    """The gap [m] between the parts of a rod that come nearest to each other, () or (times,).

    Below zero the rod passes through itself, by so much, and what was solved is no state that a
    rod can be in.

    - `found`: a `StaticSolution`, or a `Trajectory` of `scene`.

    The surface is round about the axis, with the smallest radius of the section: of a rectangle
    half its smaller side, of a `GeneralSection` that of the circle with its smaller second moment.
    Compared are parts that are farther apart along the rod than half a turn of that radius, so
    that of a straight rod the gap is pi - 2 radii. The axis is followed by cubics between the
    outputs. Works under `jit`, `vmap` and `grad`.
    """
    require_float64("self_distance")
    scene = as_arrays(scene)
    fine = lambda p, h, strains: _between(found.arc_lengths, p, to_base(h, strains[..., :3]))
    arc = _between(found.arc_lengths, found.arc_lengths[:, None], jnp.ones((1, 1)))[:, 0]
    radius = _radius_at(scene, arc)
    gap = lambda shape: _gap(fine(*shape), arc, radius)
    shapes = found.positions, found.quaternions, found.strains
    # One time after the other: all pairs of all times are too many.
    return gap(shapes) if found.positions.ndim == 2 else jax.lax.map(gap, shapes)


def _between(arc: Float[Array, "n"], p: Float[Array, "n k"], slope) -> Float[Array, "m k"]:
    """Hermite's cubics through `p` with these slopes by the arc length, at more places."""
    slope = jnp.broadcast_to(slope, p.shape)
    step = jnp.diff(arc)[:, None, None]
    t = jnp.arange(_PIECES)[:, None] / _PIECES
    a, b, m, n = p[:-1, None], p[1:, None], step * slope[:-1, None], step * slope[1:, None]
    inner = a + t * (m + t * (3 * (b - a) - 2 * m - n + t * (m + n - 2 * (b - a))))
    return jnp.concatenate([inner.reshape(-1, p.shape[1]), p[-1:]])


def _gap(p: Float[Array, "m 3"], arc: Float[Array, "m"], radius: Float[Array, "m"]):
    """The smallest one, of points against the straight pieces between them."""
    start, along = p[:-1], jnp.diff(p, axis=0)
    square = jnp.sum(along**2, -1)
    square = jnp.where(square > 0, square, 1.0)
    part = jnp.clip(jnp.sum((p[:, None] - start) * along, -1) / square, 0, 1)
    away = p[:, None] - start - part[..., None] * along
    far = jnp.sum(away**2, -1)
    at = arc[:-1] + part * jnp.diff(arc)
    own = jnp.maximum(radius[:-1], radius[1:])
    apart = jnp.abs(arc[:, None] - at) >= 0.5 * _HALF_TURN * (radius[:, None] + own)
    # A square root has no derivative at zero.
    here = apart & (far > 0)
    distance = jnp.where(here, jnp.sqrt(jnp.where(here, far, 1.0)), 0.0) - radius[:, None] - own
    return jnp.min(jnp.where(apart, distance, jnp.inf))


def _radius_at(scene: Scene, arc: Float[Array, "m"]) -> Float[Array, "m"]:
    """The smallest radius of the sections along the rod."""
    start, found = 0.0, jnp.full(arc.shape, jnp.inf)
    for part in scene.parts:
        x = jnp.clip((arc - start) / part.length, 0, 1)
        first = _smallest(part.section)
        last = first if part.section_at_end is None else _smallest(part.section_at_end)
        inside = (arc >= start) & (arc <= start + part.length * (1 + 1e-12))
        found = jnp.where(inside, jnp.minimum(found, (1 - x) * first + x * last), found)
        start = start + part.length
    return found


def _smallest(section):
    match section:
        case Circle(radius=radius) | Annulus(outer_radius=radius):
            return radius
        case Rectangle(width=width, height=height):
            return jnp.minimum(width, height) / 2
    return 2 * jnp.sqrt(jnp.min(section.second_moments, -1) / section.area)
