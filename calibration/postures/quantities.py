"""What is measured of an equilibrium besides markers: tensions, the wrench at the base, curvatures.

- `tensionK`: of tendon K, counted from 1 over all tendons, at its actuator's end, as a load cell
  between actuator and robot has it; columns `tensionK_N`.
- `base_force`, `base_moment`: with which the robot, its actuators mounted on its base, pushes what
  carries the base, about the clamp and along its axes; columns `base_fx_N`, .., `base_mz_Nm`.
- `NAME_curvature`: of the rod at the place of a marker, along the axes of its section, as fibre
  gratings have it; columns `NAME_ux_per_m`, .. Any of the three components may be missing.
"""

from dataclasses import dataclass

import jax.numpy as jnp
from jaxtyping import Array, Float

import softrod_jax as sr

_XYZ = ("x", "y", "z")


@dataclass(frozen=True)
class Quantity:
    """A measured quantity: `columns` of a log, of which the numbers have the unit `unit`; `noise`,
    their standard deviation where nothing says it, and the column that does."""

    key: str
    columns: tuple[str, ...]
    unit: str
    noise: float
    noise_column: str


def quantities_of(scene: sr.Scene) -> dict[str, Quantity]:
    """Everything that can be measured of a scene's equilibria besides markers, by key."""
    found = []
    for k in range(0 if scene.tendons is None else scene.tendons.count):
        key = f"tension{k + 1}"
        found.append(Quantity(key, (f"{key}_N",), "N", 0.05, f"{key}_noise_N"))
    force, moment = (tuple(f"base_{q}{a}" for a in _XYZ) for q in "fm")
    found.append(
        Quantity("base_force", _all(force, "N"), "N", 0.02, "base_force_noise_N"),
    )
    found.append(
        Quantity("base_moment", _all(moment, "Nm"), "N m", 1e-3, "base_moment_noise_Nm"),
    )
    for name in ("tip", *(marker.name for marker in scene.markers or ())):
        columns = tuple(f"{name}_u{a}_per_m" for a in _XYZ)
        key = f"{name}_curvature"
        found.append(Quantity(key, columns, "1/m", 0.1, f"{key}_noise_per_m"))
    return {q.key: q for q in found}


def _all(names, unit: str) -> tuple[str, ...]:
    return tuple(f"{name}_{unit}" for name in names)


def simulated(scene: sr.Scene, solution: sr.StaticSolution, key: str) -> Float[Array, "numbers"]:
    """The quantity `key` of an equilibrium of `scene`."""
    if key == "base_force":
        return solution.wrenches[0, :3]
    if key == "base_moment":
        return solution.wrenches[0, 3:]
    if key.startswith("tension") and key[7:].isdigit():
        return solution.tensions[int(key[7:]) - 1][None]
    name = key.removesuffix("_curvature")
    places = {marker.name: marker.at for marker in scene.markers or ()}
    at = jnp.asarray(places.get(name, scene.length))
    return solution.strain_at(at)[3:]
