"""The scene: everything that is known about a robot before any load is applied.

A scene is a pytree of float64 arrays: every number in it can be traced, batched and
differentiated. A part that is `None` is not in the scene, and nothing of it is computed.
SI units. The rod lies along z of the base frame when it is straight.
"""

import dataclasses
from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp

from softrod_jax.foundation.numbers import (
    DiagonalLike,
    Given,
    Maybe,
    QuaternionLike,
    RowsLike,
    ScalarLike,
    VectorLike,
)
from softrod_jax.scene.acting import (
    AbstractCondition,
    AbstractDissipation,
    AbstractDistributedLoad,
    AbstractEnergy,
)
from softrod_jax.scene.chambers import Chambers
from softrod_jax.scene.contacts import Contact
from softrod_jax.scene.loads import DEAD_LOAD, Load, Marker, Mass, Payload, TipLoad
from softrod_jax.scene.materials import AbstractRubber
from softrod_jax.scene.printing import described
from softrod_jax.scene.ranges import number, numbers_of
from softrod_jax.scene.sections import Section
from softrod_jax.scene.segments import (
    DAMPING,
    DAMPING_TIME,
    RELAXATION,
    Segment,
    Stiffness,
    stays_stiff,
)
from softrod_jax.scene.tendons import Tendons

# The planes that a scene may be in: across the rod, and along it.
PLANES = ("xz", "yz")

# By how much the norm of a unit quaternion may differ from one.
_UNIT = 1e-6


class Scene(eqx.Module):
    """A clamped rod with its actuators and its surroundings.

    - `length` [m], `section`, `young_modulus` [Pa], `poisson_ratio` [-], `density` [kg/m^3].
    - `segments`: parts of the rod, from base to tip, each with a length and a section of its own,
      and whatever else is not as this scene says. `length` is then their sum, and `section` None.
    - `section_at_end`: the section at the tip, to which its dimensions change linearly.
    - `material` instead of the moduli: `NeoHookean` or `MooneyRivlin` for rubber and silicone, or a
      law of one's own, see `AbstractEnergy`. `energies`, `dissipations` and `distributed_loads`:
      whatever else acts, see these classes' interfaces. `conditions`: what the whole rod keeps to,
      see `AbstractCondition`.
    - `contacts`: obstacles that the rod may touch, whose sections must then be round.
    - `stiffness` instead of the moduli and `linear_density` [kg/m] instead of the density.
    - `bending_damping` B_bt [N m^2 s] and `shear_damping` B_se [N s]: Kelvin-Voigt, a number
      or (3,) for x, y, z of the body frame.
    - `damping_time` t [s]: Kelvin-Voigt as well, t times the stiffness, added to these. A loss
      factor that was measured at a frequency f is 2 pi f t there.
    - `relaxation`: branches (g, tau) of a Prony series, rows of a part of the stiffness, which all
      else says as it is at once, and a time [s] in which that part relaxes. Equilibria are relaxed.
    - `gravity` [m/s^2], (3,), base frame.
    - `drag_coefficient` C [kg/m^2]: square-law drag per unit length, a number or (3,).
    - `shear_correction` [-] scales GA; 1 as in Roshanfar et al. (2024).
    - `rest_curvature` u* [1/m] and `rest_stretch` v* [-], (3,): the strains of the unloaded
      rod; straight (0, 0, 0) and (0, 0, 1) where `None`.
    - `base_position` [m], (3,), and `base_quaternion` (w, x, y, z): pose of the clamp, in motions
      where it begins. `base_moves`: whether recordings have columns for where it is carried.

    Restrictions, with fewer unknowns. They are part of the program and not numbers in it:

    - `inextensible`: the rod bends and twists only, v = v* everywhere. N is then what holds it
      so. `shear_damping` and `shear_correction` have no meaning and are refused.
    - `plane`: "xz" or "yz", the plane in which the rod stays; everything in the scene must be in
      it, forces and offsets along its axes, moments and curvatures about its normal.

    Raises `ValueError` for any other plane, and where `inextensible` is not True or False. Whether
    the numbers can be is checked by the calls that use them: see `checks.py`.
    """

    # None where there are segments, until their sum is known.
    length: Given[ScalarLike | None] = number("m", optional=True, above=0, harmless=1.0)
    section: Section | None = None
    young_modulus: Maybe[ScalarLike] = number("Pa", optional=True, above=0, harmless=1.0)
    poisson_ratio: Maybe[ScalarLike] = number(optional=True, above=-1, below=0.5)
    density: Maybe[ScalarLike] = number("kg/m^3", optional=True, above=0, harmless=1.0)
    bending_damping: Maybe[DiagonalLike] = number("N m^2 s", **DAMPING)
    shear_damping: Maybe[DiagonalLike] = number("N s", **DAMPING)
    damping_time: Maybe[ScalarLike] = number("s", **DAMPING_TIME)
    gravity: Maybe[VectorLike] = number("m/s^2", **DEAD_LOAD)
    drag_coefficient: Maybe[DiagonalLike] = number("kg/m^2", **DAMPING)
    tendons: Tendons | None = None
    chambers: Chambers | None = None
    payload: Payload | None = None
    tip_load: TipLoad | None = None
    shear_correction: Maybe[ScalarLike] = number(optional=True, above=0, harmless=1.0)
    rest_curvature: Maybe[VectorLike] = number("1/m", optional=True, sizes=(3,))
    rest_stretch: Maybe[VectorLike] = number(optional=True, sizes=(3,), harmless=(0.0, 0.0, 1.0))
    base_position: Maybe[VectorLike] = number("m", optional=True, sizes=(3,))
    base_quaternion: Maybe[QuaternionLike] = number(
        optional=True, sizes=(4,), harmless=(1.0, 0.0, 0.0, 0.0)
    )
    segments: Sequence[Segment] | None = None
    section_at_end: Section | None = None
    stiffness: Stiffness | None = None
    linear_density: Maybe[ScalarLike] = number("kg/m", optional=True, above=0, harmless=1.0)
    loads: Sequence[Load] | None = None
    masses: Sequence[Mass] | None = None
    markers: Sequence[Marker] | None = None
    material: AbstractEnergy | AbstractRubber | None = None
    relaxation: Maybe[RowsLike] = number(**RELAXATION)
    energies: Sequence[AbstractEnergy] | None = None
    dissipations: Sequence[AbstractDissipation] | None = None
    distributed_loads: Sequence[AbstractDistributedLoad] | None = None
    conditions: Sequence[AbstractCondition] | None = None
    contacts: Sequence[Contact] | None = None
    base_moves: bool = eqx.field(static=True, default=False)
    inextensible: bool = eqx.field(static=True, default=False)
    plane: str | None = eqx.field(static=True, default=None)

    def __post_init__(self):
        if self.segments is not None:
            self.segments = tuple(self.segments)
            self.length = total_length(self.segments)
        several = ("energies", "dissipations", "distributed_loads", "conditions", "contacts")
        for name in ("loads", "masses", "markers", *several):
            parts = getattr(self, name)
            setattr(self, name, tuple(parts) if parts else None)

    def __check_init__(self):
        for name in ("inextensible", "base_moves"):
            value = getattr(self, name)
            if not isinstance(value, bool):
                raise ValueError(f"Scene: {name}={value!r}; use True or False")
        if self.plane is not None and self.plane not in PLANES:
            raise ValueError(f'Scene: plane={self.plane!r} is not offered; use "xz", "yz" or None')
        if self.segments == ():
            raise ValueError("Scene: segments=(); give at least one, or leave segments out")

    def __repr__(self):
        return described(self)

    def relations(self):
        """What must hold besides the ranges: a field, whether it does, and what is expected."""
        v, h = self.rest_stretch, self.base_quaternion
        yield from stays_stiff(self.relaxation)
        if v is not None:
            yield "rest_stretch", v[2] > 0, lambda: "the third number, along the rod, is above 0"
        if h is not None:
            norm = (h**2).sum(-1) ** 0.5
            expected = lambda: f"its norm is {norm:.6g}; expected 1 to {_UNIT:g}"
            yield "base_quaternion", abs(norm - 1) <= _UNIT, expected

    @property
    def parts(self) -> tuple[Segment, ...]:
        """Its segments with all that they share; one where there are none."""
        if self.segments is None:
            own = {name: getattr(self, name) for name in ("length", "section", "section_at_end")}
            return (Segment(**own, **{name: getattr(self, name) for name in SHARED}),)
        return tuple(map(self._completed, self.segments))

    def _completed(self, segment: Segment) -> Segment:
        given = {name: getattr(segment, name) for name in SHARED}
        shared = {n: getattr(self, n) if x is None else x for n, x in given.items()}
        # What is measured stands instead of what it follows from, and the other way round.
        if segment.stiffness is None and segment.young_modulus is not None:
            shared["stiffness"] = None
        if segment.material is not None:
            shared |= dict.fromkeys(("stiffness", "young_modulus", "poisson_ratio"))
        elif isinstance(self.material, AbstractRubber):
            if segment.stiffness is not None or segment.young_modulus is not None:
                shared["material"] = None
        if segment.linear_density is None and segment.density is not None:
            shared["linear_density"] = None
        return dataclasses.replace(segment, **shared)

    @property
    def shear_modulus(self) -> ScalarLike:
        """G = E / (2 (1 + nu)) [Pa]."""
        E, nu = self.young_modulus, self.poisson_ratio
        if E is None or nu is None:
            raise ValueError("Scene: shear_modulus needs young_modulus and poisson_ratio")
        return E / (2 * (1 + nu))


# What segments have in common unless they say otherwise.
SHARED = (
    "young_modulus",
    "poisson_ratio",
    "density",
    "stiffness",
    "material",
    "linear_density",
    "relaxation",
    "bending_damping",
    "shear_damping",
    "damping_time",
    "drag_coefficient",
    "shear_correction",
    "rest_curvature",
    "rest_stretch",
)


def total_length(segments: Sequence[Segment]) -> ScalarLike | None:
    """The sum of their lengths [m]; `None` where one is no number, which `checks.py` refuses."""
    try:
        return sum(segment.length for segment in segments)
    except TypeError:
        return None


def as_arrays(scene: Scene) -> Scene:
    """The scene with every number a float array, so that none is compiled in as a constant.

    Lists of numbers become arrays, too.
    """
    return with_total_length(map_numbers(lambda x: jnp.asarray(x, dtype=float), scene))


def with_total_length(scene: Scene) -> Scene:
    """The scene with the length that its segments have, which may have been replaced."""
    if scene.segments is None:
        return scene
    length = jnp.asarray(total_length(scene.segments), dtype=float)
    return eqx.tree_at(lambda s: s.length, scene, length)


def map_numbers(function, module: eqx.Module):
    """The scene, or a part of it, with `function` of every number or list of numbers in it."""
    each = {id(values) for values in _of_each(module)}
    return jax.tree.map(function, module, is_leaf=lambda x: is_list(x) and id(x) not in each)


def _of_each(module: eqx.Module):
    """The tuples that hold a number for each actuator, which are no lists of numbers."""
    ranges = numbers_of(type(module))
    for name, value in vars(module).items():
        if isinstance(value, eqx.Module):
            yield from _of_each(value)
        elif value is not None and name in ranges and ranges[name].each:
            yield value


def is_list(x) -> bool:
    """Whether it is a list of numbers, as Python writes an array."""
    if type(x) not in (list, tuple):
        return False
    known = lambda y: is_list(y) or not (y is None or isinstance(y, eqx.Module))
    return all(map(known, x))
