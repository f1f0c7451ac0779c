"""What would be measured besides the places of markers, of an equilibrium and of a motion.

For the keys see `calibration.data.quantities`.
"""

import jax.numpy as jnp
from jaxtyping import Array, Float

import softrod_jax as sr
from calibration.data.quantities import PLACE, TURN, is_tension
from calibration.experiment.alignment import Alignment
from calibration.experiment.setup import Setup


def simulated(scene: sr.Scene, solution: sr.StaticSolution, key: str) -> Float[Array, "numbers"]:
    """The quantity `key` of an equilibrium of `scene`."""
    if key == "base_force":
        return solution.wrenches[0, :3]
    if key == "base_moment":
        return solution.wrenches[0, 3:]
    if is_tension(key):
        return solution.tensions[int(key[7:]) - 1][None]
    places = {marker.name: marker.at for marker in scene.markers or ()}
    at = jnp.asarray(places.get(key.removesuffix("_curvature"), scene.length))
    return solution.strain_at(at)[3:]


def simulated_in_time(
    setup: Setup, trajectory: sr.Trajectory, key: str
) -> Float[Array, "times numbers"]:
    """The quantity `key` at the times of a motion of the setup, as its cameras see it."""
    if key == "base_force":
        return trajectory.base_wrenches[:, :3]
    if key == "base_moment":
        return trajectory.base_wrenches[:, 3:]
    if is_tension(key):
        return trajectory.tensions[:, int(key[7:]) - 1][:, None]
    name, _, what = key.rpartition("_")
    track = trajectory.markers[name]
    if what == "position":
        return setup.seen_position(track.positions)
    if what == "attitude":
        return setup.seen_attitude(track.quaternions)
    return track.strains[:, 3:]


def aligned(
    values: Float[Array, "samples n"], key: str, alignment: Alignment, start: Float[Array, "3"]
) -> Float[Array, "samples n"]:
    """What is simulated of `key` in a recording's own frame; `start` [m]: where its tip began."""
    if key.endswith(PLACE):
        return values + alignment.of(values - start)
    if not key.endswith(TURN):
        return values
    r, w, v = alignment.rotation, values[:, :1], values[:, 1:]
    change = jnp.concatenate([-v @ r[:, None], w * r + jnp.cross(r, v)], axis=1)
    return values + change / 2


def apart(
    simulated: Float[Array, "samples n"], measured: Float[Array, "samples n"], key: str
) -> Float[Array, "samples n"]:
    """Simulated minus measured; a quaternion and its negative are the same attitude."""
    if not key.endswith(TURN):
        return simulated - measured
    along = jnp.sum(simulated * measured, axis=1, keepdims=True)
    return simulated - jnp.where(along < 0, -measured, measured)
