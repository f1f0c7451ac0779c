"""The rod's shape: positions and attitudes from the strains, by exponentials of twists.

Sixth-order Magnus expansion on SE(3) (Blanes, Casas, Oteo & Ros, Phys. Rep. 470, 2009, eq. 253
to 257), with the quadrature of the method that gave the strains. A rod of constant strain, at
any number of turns, comes out exactly.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from softrod_jax.rod.rotations import cross, quaternion_product, rigid_motion_exp, to_base

# The pose of a clamp at the origin.
ORIGIN = np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0])
# Boole's rule: exact for the moments that the sixth-order Magnus expansion needs.
BOOLE = np.array([7, 32, 12, 32, 7]) / 90


def integrate_shape(
    strain: Float[Array, "points 6"],
    h: Float[Array, "..."],
    base_position: Float[Array | np.ndarray, "3"],
    base_quaternion: Float[Array | np.ndarray, "4"],
    inner_points: np.ndarray,
    weights: np.ndarray,
):
    """Positions (nodes, 3) [m] and quaternions (nodes, 4) from the strains (v, u).

    `h` [m]: the length of the intervals, one for all or one for each. `inner_points` and `weights`:
    points of one interval, in [0, 1], both ends included, and their quadrature weights.
    """
    stride = len(inner_points) - 1
    intervals = (strain.shape[0] - 1) // stride
    index = np.arange(intervals)[:, None] * stride + np.arange(stride + 1)
    local = strain[index]  # (intervals, stride + 1, 6)
    h = jnp.reshape(h, (-1, 1))
    moment = [
        h * jnp.einsum("j,kj...->k...", weights * (inner_points - 0.5) ** i, local)
        for i in range(3)
    ]
    twist = _magnus(*moment)
    steps, turns = rigid_motion_exp(twist[:, :3], twist[:, 3:])

    def move(pose, step):
        p, r = pose
        p, r = p + to_base(r, step[0]), quaternion_product(r, step[1])
        return (p, r), (p, r)

    base = (base_position, base_quaternion)
    _, (p, r) = jax.lax.scan(move, base, (steps, turns))
    return (
        jnp.concatenate([base_position[None], p]),
        jnp.concatenate([base_quaternion[None], r]),
    )


class Pose(eqx.Module):
    """Where a section is: `position` [m], (3,), and `quaternion` (w, x, y, z), (4,)."""

    position: Float[Array, "*batch 3"]
    quaternion: Float[Array, "*batch 4"]

    def moved(self, offset: Float[Array, "3"] | None) -> "Pose":
        """That of a point that is `offset` [m] away, in the frame of the section."""
        if offset is None:
            return self
        return Pose(self.position + to_base(self.quaternion, offset), self.quaternion)


def pose_between(
    strain: Float[Array, "intervals k 6"],
    nodes: Float[Array, "nodes"],
    positions: Float[Array, "nodes 3"],
    quaternions: Float[Array, "nodes 4"],
    s,
) -> Pose:
    """The pose at arc length `s` [m], between nodes at `nodes` [m] with known poses.

    `strain`: (v, u) at k equally spaced points of each interval, both ends included. From the node
    before `s` on, as `integrate_shape` does over whole intervals.
    """
    k, h, part = _within(nodes, s)
    local = _interpolated(strain[k], part * np.arange(5) / 4)
    p, q = integrate_shape(local, part * h, positions[k], quaternions[k], np.arange(5) / 4, BOOLE)
    return Pose(p[-1], q[-1])


def strain_between(
    strain: Float[Array, "intervals k 6"], nodes: Float[Array, "nodes"], s
) -> Float[Array, "6"]:
    """(v, u) at arc length `s` [m]; arguments as of `pose_between`. Where it jumps, that beyond."""
    k, _, part = _within(nodes, s)
    return _interpolated(strain[k], part[None])[0]


def _within(nodes, s):
    """The interval that `s` is in, its length, and which part of it comes before `s`."""
    k = jnp.clip(jnp.searchsorted(nodes, s, side="right") - 1, 0, nodes.shape[0] - 2)
    h = nodes[k + 1] - nodes[k]
    return k, h, (s - nodes[k]) / jnp.where(h > 0, h, 1.0)


def _interpolated(strain: Float[Array, "k 6"], at: Float[Array, "places"]):
    """The polynomial through values at equally spaced points of an interval, at parts of it."""
    points = np.linspace(0.0, 1.0, strain.shape[0])
    others = ~np.eye(len(points), dtype=bool)
    numerator = jnp.prod(jnp.where(others, at[:, None, None] - points, 1.0), -1)
    return (numerator / np.prod(np.where(others, points[:, None] - points, 1.0), -1)) @ strain


def _magnus(A0, A1, A2):
    """The twist of one interval, from the moments of the strains about its middle."""
    a1, a2, a3 = 9 / 4 * A0 - 15 * A2, 12 * A1, -15 * A0 + 180 * A2
    c1 = _bracket(a1, a2)
    c2 = -_bracket(a1, 2 * a3 + c1) / 60
    return a1 + a3 / 12 + _bracket(-20 * a1 - a3 + c1, a2 + c2) / 240


def _bracket(a, b):
    """The commutator of twists (v, u), with the sign of R_s = R u^ (rates act on the right)."""
    va, ua, vb, ub = a[..., :3], a[..., 3:], b[..., :3], b[..., 3:]
    return -jnp.concatenate([cross(ua, vb) - cross(ub, va), cross(ua, ub)], -1)
