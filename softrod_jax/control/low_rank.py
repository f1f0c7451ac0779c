"""Kalman's update of a covariance that is kept as a narrow root, and differences of poses."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from softrod_jax.analysis.seen import moved
from softrod_jax.rod.rotations import turn_between
from softrod_jax.rod.shape import Pose


class Weighed(NamedTuple):
    """What a measurement says of the columns of a root.

    - `weights`: how much of each column the mean changes by; `values` and `vectors`: of M (below).
    - `surprise`: the square of what was not expected, in terms of its covariance.
    """

    weights: Float[Array, "r"]
    values: Float[Array, "r"]
    vectors: Float[Array, "r r"]
    surprise: Float[Array, ""]

    def narrowed(self, root: Float[Array, "n r"]) -> Float[Array, "n r"]:
        """The root afterwards, S M^-1/2."""
        return root @ (self.vectors / jnp.sqrt(self.values))


def weighed(
    Y: Float[Array, "p r"], beyond: Float[Array, "p"], precision: Float[Array, "p"]
) -> Weighed:
    """What is measured, taken in.

    - `Y`: what is seen along each column of the root; `beyond`: what was measured beyond what was
      expected, NaN where nothing was; `precision`: one over the standard deviations of the noise.

    With M = 1 + Y^T R^-1 Y, which is as small as the root is narrow, the gain is S M^-1 Y^T R^-1.
    """
    present = jnp.isfinite(beyond)
    r = jnp.where(present, beyond, 0.0) * precision
    Y = jnp.where(present[:, None], Y, 0.0) * precision[:, None]
    values, vectors = jnp.linalg.eigh(jnp.eye(Y.shape[1]) + Y.T @ Y)
    values = jnp.maximum(values, 1.0)
    weights = vectors @ ((vectors.T @ (Y.T @ r)) / values)
    return Weighed(weights, values, vectors, jnp.sum(r**2) - (Y.T @ r) @ weights)


def truncated(
    root: Float[Array, "n r"], sizes: Float[Array, "n"], rank: int
) -> Float[Array, "n rank"]:
    """The root with the `rank` columns that say most of it, each row in terms of its size."""
    scaled = root / sizes[:, None]
    _, vectors = jnp.linalg.eigh(scaled.T @ scaled)
    return root @ vectors[:, ::-1][:, :rank]


def moved_all(poses: Pose) -> Float[Array, "p"]:
    """As `moved`, of several markers, one after the other."""
    return jax.vmap(moved)(poses).ravel()


def beyond(poses: Pose, measured: Pose) -> Float[Array, "p"]:
    """How far, and turned by which vector [rad], what is measured is from what is expected."""
    h = measured.quaternion / jnp.linalg.norm(measured.quaternion, axis=1, keepdims=True)
    turn = turn_between(h, poses.quaternion)
    sine = jnp.linalg.norm(turn, axis=1, keepdims=True)
    small = sine < 1e-8
    angle = 2 * jnp.arcsin(jnp.minimum(jnp.where(small, 1.0, sine), 1.0))
    vector = jnp.where(small, 2.0, angle / jnp.where(small, 1.0, sine)) * turn
    return jnp.concatenate([measured.position - poses.position, vector], 1).ravel()
