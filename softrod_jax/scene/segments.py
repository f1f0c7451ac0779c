"""Segments: parts of the rod with a section, a material and a shape of their own."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from softrod_jax.foundation.numbers import (
    DiagonalLike,
    Given,
    Maybe,
    PairLike,
    RowsLike,
    ScalarLike,
    VectorLike,
)
from softrod_jax.scene.acting import AbstractEnergy
from softrod_jax.scene.materials import AbstractRubber
from softrod_jax.scene.ranges import number
from softrod_jax.scene.sections import Section

# Parts of the stiffness and times [s], and a stand-in that leaves most of it.
RELAXATION: dict[str, Any] = {
    **{"optional": True, "sizes": (2,), "rows": 1, "above": 0},
    "harmless": ((1e-3, 1.0), (1e-3, 1.0)),
}
DAMPING = {"optional": True, "sizes": (0, 3), "at_least": 0, "zero_is_absent": True}
DAMPING_TIME: dict[str, Any] = DAMPING | {"sizes": (0,)}


class Stiffness(eqx.Module):
    """Stiffness as it was measured, instead of moduli: of fibres, of what is built up.

    - `bending` [N m^2], (2,): EI about x and about y; `torsion` GJ [N m^2].
    - `axial` EA [N] and `shear` [N], (2,): GA along x and along y. Of a rod that is inextensible
      they are not needed.
    """

    bending: Given[PairLike] = number("N m^2", sizes=(2,), above=0, harmless=1.0)
    torsion: Given[ScalarLike] = number("N m^2", above=0, harmless=1.0)
    axial: Maybe[ScalarLike] = number("N", optional=True, above=0, harmless=1.0)
    shear: Maybe[PairLike] = number("N", optional=True, sizes=(2,), above=0, harmless=1.0)


class Segment(eqx.Module):
    """A part of the rod, from base to tip.

    - `length` [m]; `section`: at its beginning, and throughout where there is no `section_at_end`,
      to which the dimensions change linearly (the same shape).
    - The others as in `Scene`, for this segment. What is `None` here is as the scene says.
    - `material`: `NeoHookean` or `MooneyRivlin`; a law of one's own is the scene's.
    - `intervals` of the grid; chosen where `None`.
    """

    length: Given[ScalarLike] = number("m", above=0, harmless=1.0)
    section: Section  # pyright: ignore[reportGeneralTypeIssues]  # `number` gives no default
    section_at_end: Section | None = None
    young_modulus: Maybe[ScalarLike] = number("Pa", optional=True, above=0, harmless=1.0)
    poisson_ratio: Maybe[ScalarLike] = number(optional=True, above=-1, below=0.5)
    density: Maybe[ScalarLike] = number("kg/m^3", optional=True, above=0, harmless=1.0)
    stiffness: Stiffness | None = None
    material: AbstractEnergy | AbstractRubber | None = None
    relaxation: Maybe[RowsLike] = number(**RELAXATION)
    linear_density: Maybe[ScalarLike] = number("kg/m", optional=True, above=0, harmless=1.0)
    bending_damping: Maybe[DiagonalLike] = number("N m^2 s", **DAMPING)
    shear_damping: Maybe[DiagonalLike] = number("N s", **DAMPING)
    damping_time: Maybe[ScalarLike] = number("s", **DAMPING_TIME)
    drag_coefficient: Maybe[DiagonalLike] = number("kg/m^2", **DAMPING)
    shear_correction: Maybe[ScalarLike] = number(optional=True, above=0, harmless=1.0)
    rest_curvature: Maybe[VectorLike] = number("1/m", optional=True, sizes=(3,))
    rest_stretch: Maybe[VectorLike] = number(optional=True, sizes=(3,), harmless=(0.0, 0.0, 1.0))
    intervals: int | None = eqx.field(static=True, default=None)

    def __check_init__(self):
        if self.section_at_end is not None and type(self.section_at_end) is not type(self.section):
            kinds = [type(x).__name__ for x in (self.section, self.section_at_end)]
            raise ValueError(f"Segment: a taper from {kinds[0]} to {kinds[1]}; use the same shape")
        count = self.intervals
        if count is not None and (
            isinstance(count, bool) or not isinstance(count, int) or count < 1
        ):
            raise ValueError(f"Segment: intervals={count!r}; a whole number from 1 is needed")

    @property
    def rest_strain(self) -> tuple[Float[Array, "3"], Float[Array, "3"]]:
        """Stretch v* and curvature u* of the unloaded segment."""
        v, u = self.rest_stretch, self.rest_curvature
        straight = jnp.array([0.0, 0.0, 1.0])
        return straight if v is None else v, jnp.zeros(3) if u is None else u

    def section_at(self, x):
        """The section at the part `x` of its length, or at several; dimensions change linearly."""
        return section_between(self.section, self.section_at_end, x)

    def relations(self):
        """What must hold besides the ranges: a field, whether it does, and what is expected."""
        v = self.rest_stretch
        yield from stays_stiff(self.relaxation)
        if v is not None:
            yield "rest_stretch", v[2] > 0, lambda: "the third number, along the rod, is above 0"


def stays_stiff(relaxation):
    """The rule that branches leave some stiffness for ever, as `relations` yield it."""
    if relaxation is not None:
        left = 1 - relaxation[..., 0].sum(-1)
        expected = "parts of the stiffness, [[g, tau [s]], ...], whose sum is below 1"
        yield "relaxation", left > 0, lambda: expected


def section_between(section: Section, at_end: Section | None, x):
    """The section at the part `x` of the way to where it is `at_end`."""
    if at_end is None:
        return section
    return jax.tree.map(lambda a, b: (1 - x) * a + x * b, section, at_end)
