"""The error of the tip from the steps in time, estimated while a motion is marched.

Every step makes a local error, in modes of the rod that it resolves and in those that it does not.
An oscillation turns a local error about but does not undo it: local errors are added up by
their size, and not as vectors. What damping makes a rod forget is forgotten, and what a force that
presses the rod together or a moment in space makes grow has grown. The estimate is thus a cautious
one, and costs a few operations along the rod a step.

Errors of the speed are not counted beside those of the place: a motion that swings has both, of
about the same size, and to add them made the estimate six times as large in the median, and the
least ratios to the error no larger. Where a constraint acts, they are: a rod whose tendons are
pulled begins to move at once, with a speed that a long step gets wrong in the first mode, while
places are hardly wrong yet.
"""

import jax.numpy as jnp
from jaxtyping import Array, Float

from softrod_jax.bvp.method import AbstractMethod
from softrod_jax.rod.constants import Rod
from softrod_jax.rod.rotations import cross, to_base
from softrod_jax.scene.planes import in_space
from softrod_jax.stepping.first_mode import Axis, moved_by_speed, rate_of_change
from softrod_jax.stepping.scheme import LocalErrors

# An error of this many lengths doubles: it changes the motion in which later errors are made. The
# estimate without that and the true error had ratios from 0.38 on, in the median 2.8, below 1 where
# errors were large (motions of `benchmarks/judge_motion.py`, judged by an independent code).
_DOUBLES = 0.1
# Of 144 judged motions the least estimate without this factor was 0.32 of the error.
_CAUTION = 1.3
# The part of an estimated error of speed that counts. Of 150 motions by given lengths
# (`benchmarks/tendon_lengths.py`), with none of it 5 estimates were below a third of the error, the
# least 0.1; with 0.1, 0.2, 0.5 and 1 of it the least are 0.43, 0.68, 0.79 and 1.4, and those in the
# median 3.3, 4.7, 9.7 and 22.
_OF_SPEED = 0.15


def accumulated(total, errors: LocalErrors, dt, axis: Axis, rod: Rod, method: AbstractMethod):
    """The estimate after a step of `dt`, in lengths, from the one before it, `total`.

    `axis`: at the end of the step; `errors`: local ones of (strains, velocities).
    Of the estimates of one local error the smallest is taken: each is about as large as the
    error, or larger. Of those of place and speed the larger one is.
    """
    tangent, attitude = axis
    each = [error for error in (errors.lower, errors.difference) if error is not None]
    moved = _least(largest_displacement(x[0], tangent, attitude, rod, method) for x in each)
    if rod.constraint is not None:
        speeds = (method.outputs(in_space(x[1], rod.plane))[:, :3] for x in each)
        later = _least(
            moved_by_speed(to_base(attitude, speed), tangent, rod, method) for speed in speeds
        )
        moved = jnp.maximum(moved, _OF_SPEED * later)
    # What grows by more in a step is an oscillation that the scheme damps out.
    changed = jnp.exp(jnp.minimum(rate_of_change(rod, tangent, method) * dt, 1.0))
    return changed * total + moved


def _least(estimates) -> Float[Array, ""]:
    return jnp.min(jnp.stack(list(estimates)), axis=0)


def grown(total) -> Float[Array, ""]:
    """The estimate with what the local errors of `accumulated` have become since they were made."""
    return _CAUTION * total * (1 + total / _DOUBLES)


def largest_displacement(
    change, tangent, attitude, rod: Rod, method: AbstractMethod
) -> Float[Array, ""]:
    """How far a small `change` of the strains (points, n) moves a point of the rod, in lengths.

    `tangent` (nodes, 3) and `attitude` (nodes, 4) of the rod are in the base frame.

    The maximum along the rod and not the tip's: modes whose displacements of the tip cancel now
    do not cancel later.
    """
    if rod.K_se is None:
        stretch = jnp.zeros((change.shape[0], rod.v_star.shape[-1]))
        change = jnp.concatenate([stretch, change], -1)
    change = method.outputs(in_space(change, rod.plane))
    grid = rod.grid
    spacing = rod.L / (change.shape[0] - 1)
    if grid.division is not None:
        spacing = jnp.diff(method.outputs(grid.s))[:, None]
    turned = _integral(to_base(attitude, change[:, 3:]), spacing)
    moved = _integral(to_base(attitude, change[:, :3]) + cross(turned, tangent), spacing)
    return jnp.sqrt(jnp.max(jnp.sum(moved * moved, -1))) / rod.L


def _integral(f: Float[Array, "nodes 3"], spacing) -> Float[Array, "nodes 3"]:
    """From the clamp to every node, by the trapezoidal rule."""
    parts = 0.5 * spacing * (f[1:] + f[:-1])
    return jnp.concatenate([jnp.zeros_like(f[:1]), jnp.cumsum(parts, axis=0)])
