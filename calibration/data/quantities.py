"""What is measured besides the places of markers: tensions, the wrench at the base, curvatures.

- `tensionK`: of tendon K, counted from 1 over all tendons, at its actuator's end, as a load cell
  between actuator and robot has it; columns `tensionK_N`.
- `base_force`, `base_moment`: with which the robot, its actuators mounted on its base, pushes what
  carries the base, about the clamp and along its axes; columns `base_fx_N`, .., `base_mz_Nm`.
- `NAME_curvature`: of the rod at the place of a marker, along the axes of its section, as fibre
  gratings have it; columns `NAME_ux_per_m`, .. Any of the three components may be missing.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import softrod_jax as sr

# The noise of a marker where nothing is said [m], against which all others are weighed.
NOISE = 1e-3
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


def unit_noise(scene: sr.Scene, keys, said: Mapping[str, float]) -> list[float]:
    """The standard deviation of each number of the quantities `keys`, as `said` by key or usual.

    Raises `ValueError` for a key that the scene does not have.
    """
    known, found = quantities_of(scene), []
    for key in keys:
        if key not in known:
            raise ValueError(f"{key!r} is no measurement; known: {', '.join(known)}")
        found += [said.get(key, known[key].noise)] * len(known[key].columns)
    return found
