"""What would be measured besides the places of markers, of an equilibrium and of a motion.

For the keys see `calibration.data.quantities`.
"""

import jax.numpy as jnp
from jaxtyping import Array, Float

import softrod_jax as sr


def simulated(scene: sr.Scene, solution: sr.StaticSolution, key: str) -> Float[Array, "numbers"]:
    """The quantity `key` of an equilibrium of `scene`."""
    if key == "base_force":
        return solution.wrenches[0, :3]
    if key == "base_moment":
        return solution.wrenches[0, 3:]
    if _is_tension(key):
        return solution.tensions[int(key[7:]) - 1][None]
    places = {marker.name: marker.at for marker in scene.markers or ()}
    at = jnp.asarray(places.get(key.removesuffix("_curvature"), scene.length))
    return solution.strain_at(at)[3:]


def simulated_in_time(trajectory: sr.Trajectory, key: str) -> Float[Array, "times numbers"]:
    """The quantity `key` at the times of a motion."""
    if key == "base_force":
        return trajectory.base_wrenches[:, :3]
    if key == "base_moment":
        return trajectory.base_wrenches[:, 3:]
    if _is_tension(key):
        return trajectory.tensions[:, int(key[7:]) - 1][:, None]
    return trajectory.markers[key.removesuffix("_curvature")].strains[:, 3:]


def _is_tension(key: str) -> bool:
    return key.startswith("tension") and key[7:].isdigit()
