"""The scene: everything that is known about a robot before any load is applied.

A scene is a pytree of float64 arrays: every number in it can be traced, batched and
differentiated. A part that is `None` is not in the scene, and nothing of it is computed.
SI units. The rod lies along z of the base frame when it is straight.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from softrod_jax.scene.ranges import number
from softrod_jax.scene.sections import Circle, Section

Scalar = Float[Array, ""]

# The planes that a scene may be in: across the rod, and along it.
PLANES = ("xz", "yz")

# By how much the norm of a unit quaternion may differ from one.
_UNIT = 1e-6
# Zero of these means that there are none.
_LOAD = {"optional": True, "sizes": (3,), "zero_is_absent": True}
_DAMPING = {"optional": True, "sizes": (0, 3), "at_least": 0, "zero_is_absent": True}


class Tendons(eqx.Module):
    """Frictionless tendons, parallel to the rod, that end at the tip.

    - `offsets` [m], (tendons, 2): x and y of each tendon in the section.
    """

    offsets: Float[Array, "tendons 2"] = number(
        "m", sizes=(2,), per_actuator=True, harmless=0.01, converter=jnp.asarray
    )

    @property
    def count(self) -> int:
        return self.offsets.shape[0]

    def routing(self, s):
        """Tendon positions r_i [m] and slopes r_i,s [-] in the section at arc length `s`.

        Both (tendons, 3), or (*points, tendons, 3) for `s` (*points,) if they vary along the rod.
        The slope is `None` for a straight tendon: its terms vanish.
        """
        del s
        r = jnp.concatenate([self.offsets, jnp.zeros_like(self.offsets[:, :1])], axis=1)
        return r, None


class Chambers(eqx.Module):
    """Air chambers that run along the whole rod, capped at the tip.

    - `areas` [m^2], (chambers,): the cross-section of each.
    - `offsets` [m], (chambers, 2): x and y of each in the section.
    """

    areas: Float[Array, "chambers"] = number(
        "m^2", above=0, per_actuator=True, harmless=0.01, converter=jnp.asarray
    )
    offsets: Float[Array, "chambers 2"] = number(
        "m", sizes=(2,), per_actuator=True, harmless=0.01, converter=jnp.asarray
    )

    @property
    def count(self) -> int:
        return self.areas.shape[0]


class Payload(eqx.Module):
    """A point mass [kg] on the axis at the tip: weight (if there is gravity) and inertia."""

    mass: Scalar = number("kg", at_least=0, zero_is_absent=True, converter=jnp.asarray)


class TipLoad(eqx.Module):
    """Dead loads at the tip, in the base frame: `force` [N] and `moment` [N m], (3,) each."""

    force: Float[Array, "3"] | None = number("N", **_LOAD)
    moment: Float[Array, "3"] | None = number("N m", **_LOAD)


class Scene(eqx.Module):
    """A clamped rod with its actuators and its surroundings.

    - `length` [m], `section`, `young_modulus` [Pa], `poisson_ratio` [-], `density` [kg/m^3].
    - `bending_damping` B_bt [N m^2 s] and `shear_damping` B_se [N s]: Kelvin-Voigt, a number
      or (3,) for x, y, z of the body frame.
    - `gravity` [m/s^2], (3,), base frame.
    - `drag_coefficient` C [kg/m^2]: square-law drag per unit length, a number or (3,).
    - `shear_correction` [-] scales GA; 1 as in Roshanfar et al. (2024).
    - `rest_curvature` u* [1/m] and `rest_stretch` v* [-], (3,): the strains of the unloaded
      rod; straight (0, 0, 0) and (0, 0, 1) where `None`.
    - `base_position` [m], (3,), and `base_quaternion` (w, x, y, z): pose of the clamp.

    Restrictions, with fewer unknowns. They are part of the program and not numbers in it:

    - `inextensible`: the rod bends and twists only, v = v* everywhere. N is then what holds it
      so. `shear_damping` and `shear_correction` have no meaning and are refused.
    - `plane`: "xz" or "yz", the plane in which the rod stays; everything in the scene must be in
      it, forces and offsets along its axes, moments and curvatures about its normal.

    Raises `ValueError` for any other plane, and where `inextensible` is not True or False. Whether
    the numbers can be is checked by the calls that use them: see `checks.py`.
    """

    length: Scalar = number("m", above=0, harmless=1.0)
    section: Section
    young_modulus: Scalar = number("Pa", above=0, harmless=1.0)
    poisson_ratio: Scalar = number(above=-1, below=0.5)
    density: Scalar = number("kg/m^3", above=0, harmless=1.0)
    bending_damping: Float[Array, "..."] | None = number("N m^2 s", **_DAMPING)
    shear_damping: Float[Array, "..."] | None = number("N s", **_DAMPING)
    gravity: Float[Array, "3"] | None = number("m/s^2", **_LOAD)
    drag_coefficient: Float[Array, "..."] | None = number("kg/m^2", **_DAMPING)
    tendons: Tendons | None = None
    chambers: Chambers | None = None
    payload: Payload | None = None
    tip_load: TipLoad | None = None
    shear_correction: Scalar | None = number(optional=True, above=0, harmless=1.0)
    rest_curvature: Float[Array, "3"] | None = number("1/m", optional=True, sizes=(3,))
    rest_stretch: Float[Array, "3"] | None = number(
        optional=True, sizes=(3,), harmless=(0.0, 0.0, 1.0)
    )
    base_position: Float[Array, "3"] | None = number("m", optional=True, sizes=(3,))
    base_quaternion: Float[Array, "4"] | None = number(
        optional=True, sizes=(4,), harmless=(1.0, 0.0, 0.0, 0.0)
    )
    inextensible: bool = eqx.field(static=True, default=False)
    plane: str | None = eqx.field(static=True, default=None)

    def __check_init__(self):
        if not isinstance(self.inextensible, bool):
            raise ValueError(f"Scene: inextensible={self.inextensible!r}; use True or False")
        if self.plane is not None and self.plane not in PLANES:
            raise ValueError(f'Scene: plane={self.plane!r} is not offered; use "xz", "yz" or None')

    def relations(self):
        """What must hold besides the ranges: a field, whether it does, and what is expected."""
        v, h = self.rest_stretch, self.base_quaternion
        if v is not None:
            yield "rest_stretch", v[2] > 0, lambda: "the third number, along the rod, is above 0"
        if h is not None:
            norm = (h**2).sum(-1) ** 0.5
            expected = lambda: f"its norm is {norm:.6g}; expected 1 to {_UNIT:g}"
            yield "base_quaternion", abs(norm - 1) <= _UNIT, expected

    @property
    def shear_modulus(self) -> Scalar:
        """G = E / (2 (1 + nu)) [Pa]."""
        return self.young_modulus / (2 * (1 + self.poisson_ratio))


def as_arrays(scene: Scene) -> Scene:
    """The scene with every number a float array, so that none is compiled in as a constant.

    Lists of numbers become arrays, too.
    """
    return jax.tree.map(lambda x: jnp.asarray(x, dtype=float), scene, is_leaf=is_list)


def is_list(x) -> bool:
    """Whether it is a list of numbers, as Python writes an array."""
    return type(x) in (list, tuple)


def hybrid_robot(length: float = 0.1, gravity=None) -> Scene:
    """The robot of Roshanfar et al., Actuators 2024, 13(1):8, Table 1.

    Three tendons 4 mm off the axis at 0, 120 and 240 degrees, one central chamber of 3 mm
    diameter, a solid circle of radius 6 mm. The table gives no length: 0.1 m is an
    assumption. `gravity` [m/s^2], (3,), is absent unless given.
    """
    angle = jnp.deg2rad(jnp.array([0.0, 120.0, 240.0]))
    radius = 6e-3
    return as_arrays(
        Scene(
            length=length,
            section=Circle(radius),
            young_modulus=0.05e6,
            poisson_ratio=0.49,
            density=1070.0,
            bending_damping=1e-6,
            gravity=gravity,
            drag_coefficient=0.03,
            tendons=Tendons(4e-3 * jnp.stack([jnp.cos(angle), jnp.sin(angle)], axis=1)),
            chambers=Chambers(jnp.array([jnp.pi * 1.5e-3**2]), jnp.zeros((1, 2))),
        )
    )
