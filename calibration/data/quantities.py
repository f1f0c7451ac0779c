"""What is measured besides the places of markers: tensions, the wrench at the base, curvatures.

- `tensionK`: of tendon K, counted from 1 over all tendons, at its actuator's end, as a load cell
  between actuator and robot has it; columns `tensionK_N`.
- `base_force`, `base_moment`: with which the robot, its actuators mounted on its base, pushes what
  carries the base, about the clamp and along its axes; columns `base_fx_N`, .., `base_mz_Nm`.
- `NAME_curvature`: of the rod at the place of a marker, along the axes of its section, as fibre
  gratings have it; columns `NAME_ux_per_m`, .. Any of the three components may be missing.
- `NAME_position`, of motions, as postures have them by the marker's name: where a marker other than
  the tip is; columns `NAME_x_m`, .. `NAME_attitude`, likewise: its quaternion (w, x, y, z), or the
  tip's; columns `NAME_qw`, ..
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import softrod_jax as sr

# The noise of a marker where nothing is said [m], against which all others are weighed.
NOISE = 1e-3
# How keys of motions end.
PLACE, TURN = "_position", "_attitude"
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


def quantities_in_motion(scene: sr.Scene) -> dict[str, Quantity]:
    """Everything that can be measured of a scene's motions besides the place of the tip, by key:
    what can be of equilibria, and markers."""
    found = list(quantities_of(scene).values())
    for name in ("tip", *(marker.name for marker in scene.markers or ())):
        if name != "tip":
            place = _all([f"{name}_{a}" for a in _XYZ], "m")
            found.append(Quantity(f"{name}{PLACE}", place, "m", NOISE, f"{name}_noise_m"))
        turn = tuple(f"{name}_q{a}" for a in ("w", *_XYZ))
        found.append(Quantity(f"{name}{TURN}", turn, "rad", 0.01, f"{name}_noise_rad"))
    return {q.key: q for q in found}


def numbers_of(keys: Sequence[str]) -> dict[str, slice]:
    """Which numbers are of which key, where they stand one after the other."""
    found, at = {}, 0
    for key in keys:
        count = 4 if key.endswith(TURN) else 1 if is_tension(key) else 3
        found[key] = slice(at, at + count)
        at += count
    return found


def is_tension(key: str) -> bool:
    return key.startswith("tension") and key[7:].isdigit()


def unit_noise(
    known: Mapping[str, Quantity], keys: Sequence[str], said: Mapping[str, float]
) -> list[float]:
    """The standard deviation of each number of the quantities `keys`, as `said` by key or usual.

    The numbers of a quaternion change by half an angle. Raises `ValueError` for a key that is not
    `known`.
    """
    found = []
    for key in keys:
        if key not in known:
            raise ValueError(f"{key!r} is no measurement; known: {', '.join(known)}")
        noise = said.get(key, known[key].noise)
        found += [noise / 2 if key.endswith(TURN) else noise] * len(known[key].columns)
    return found
