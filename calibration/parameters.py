"""What can be fitted: numbers of a scene, each with its unit and a scale without bounds.

An optimiser sees, for each parameter, one coordinate theta that is 0 at the scene's own value.
A positive number is `initial * exp(theta)`: all its values are allowed, and a step means the
same for a modulus and for a damping. A vector (a damping of x, y and z) is scaled as a whole:
one recording seldom tells its components apart.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import softrod_jax as sr

# A fit does not leave these factors around the initial value: where the data say nothing of a
# parameter, its estimate would run to 0 or to infinity.
LARGEST_FACTOR = 1e6


@dataclass(frozen=True)
class Parameter:
    """A number of the scene.

    - `find`: the number in a scene (also for `eqx.tree_at`), None if the scene has none.
    - `remedy`: what to add to a scene that has none.
    - `bounds`: the open interval of allowed values; (0, inf) except for Poisson's ratio.
    """

    name: str
    unit: str
    find: Callable
    remedy: str = ""
    bounds: tuple[float, float] = (0.0, np.inf)

    @property
    def largest_theta(self) -> float:
        """How far theta may go from 0, on either side."""
        return float(np.log(LARGEST_FACTOR))

    def value(self, initial, theta):
        """The value at `theta`; `initial` is the value at 0."""
        low, high = self.bounds
        if np.isinf(high):
            return initial * jnp.exp(theta)
        start = jnp.log((initial - low) / (high - initial))
        return low + (high - low) * jax.nn.sigmoid(start + theta)


def _has(part: str, find: Callable) -> Callable:
    return lambda scene: None if getattr(scene, part) is None else find(getattr(scene, part))


_ALL = (
    Parameter("young_modulus", "Pa", lambda s: s.young_modulus),
    Parameter("bending_damping", "N m^2 s", lambda s: s.bending_damping, "rod.bending_damping"),
    Parameter("drag_coefficient", "kg/m^2", lambda s: s.drag_coefficient, "rod.drag_coefficient"),
    Parameter("shear_damping", "N s", lambda s: s.shear_damping, "rod.shear_damping"),
    Parameter("poisson_ratio", "1", lambda s: s.poisson_ratio, bounds=(-1.0, 0.5)),
    Parameter("density", "kg/m^3", lambda s: s.density),
    Parameter("length", "m", lambda s: s.length),
    Parameter("shear_correction", "1", lambda s: s.shear_correction, "rod.shear_correction"),
    Parameter("payload_mass", "kg", _has("payload", lambda p: p.mass), "[payload] mass"),
    Parameter("chamber_area", "m^2", _has("chambers", lambda c: c.areas), "[[chambers]]"),
    Parameter("tendon_offset", "m", _has("tendons", lambda t: t.offsets), "[[tendons]]"),
)
PARAMETERS = {parameter.name: parameter for parameter in _ALL}
DEFAULT = ("young_modulus", "bending_damping", "drag_coefficient")


def choose(scene: sr.Scene, fit: Iterable[str] | str | None) -> tuple[str, ...]:
    """The names of the parameters to fit; those of `DEFAULT` that the scene has if None.

    Raises `ValueError` for an unknown name, a repeated one, none at all, and for a parameter
    that the scene does not have, or that is zero in it: a factor has nothing to act on.
    """
    if fit is None:
        return tuple(n for n in DEFAULT if PARAMETERS[n].find(scene) is not None)
    names = (fit,) if isinstance(fit, str) else tuple(fit)
    if not names:
        raise ValueError("fit: no parameters; name at least one, or leave it out for the default")
    for name in names:
        if name not in PARAMETERS:
            raise ValueError(f"fit: unknown parameter {name!r}; known: {', '.join(PARAMETERS)}")
        if names.count(name) > 1:
            raise ValueError(f"fit: {name!r} is named twice; leave one out")
        parameter = PARAMETERS[name]
        value = parameter.find(scene)
        if value is None:
            raise ValueError(
                f"fit: the scene has no {name}; give it a starting value > 0 "
                f"({parameter.remedy} in the scene file), or leave it out of the fit"
            )
        if np.isinf(parameter.bounds[1]) and not np.any(np.asarray(value)):
            raise ValueError(
                f"fit: {name} is 0 in the scene and is fitted as a factor of its initial value; "
                "give it a starting value > 0, or leave it out of the fit"
            )
    return names


def with_values(scene: sr.Scene, names: tuple[str, ...], theta) -> sr.Scene:
    """The scene with the parameters `names` at `theta`, (parameters,)."""
    for name, coordinate in zip(names, theta, strict=True):
        parameter = PARAMETERS[name]
        value = parameter.value(parameter.find(scene), coordinate)
        scene = eqx.tree_at(parameter.find, scene, value)
    return scene
