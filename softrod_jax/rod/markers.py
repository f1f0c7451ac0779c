"""Markers: points of the rod that are seen, by name; the tip is one of them."""

import jax
from jaxtyping import Array, Float

from softrod_jax.rod.shape import Pose, pose_between
from softrod_jax.scene.scene import Scene


def seen(
    scene: Scene,
    strain: Float[Array, "*times intervals k 6"],
    nodes: Float[Array, "nodes"],
    positions: Float[Array, "*times nodes 3"],
    quaternions: Float[Array, "*times nodes 4"],
) -> dict[str, Pose]:
    """The poses of all markers and of the tip; arguments as of `pose_between`, or one a time."""
    poses = {"tip": Pose(positions[..., -1, :], quaternions[..., -1, :])}
    for marker in scene.markers or ():
        at = lambda strain, p, q, at=marker.at: pose_between(strain, nodes, p, q, at)
        if positions.ndim > 2:
            at = jax.vmap(at)
        pose = at(strain, positions, quaternions)
        poses[marker.name] = pose.moved(marker.offset)
    return poses
