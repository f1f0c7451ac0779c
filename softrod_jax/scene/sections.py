"""Cross-sections: area, second moments of area and torsion constant.

Lengths in metres. `x` and `y` are the directions of the body frame that span the section.
Every section offers

- `area` [m^2],
- `second_moments` [m^4]: (Ixx, Iyy), about the x and the y axis,
- `torsion_constant` [m^4]: `G * torsion_constant` is the torsional stiffness. It equals
  Ixx + Iyy for round sections only,
- `contains(offset)`: whether a point of the section plane lies inside,

and round ones the `outline_radius` [m].

What numbers a section can have it says where they are declared, and in `relations` what must hold
between them.
"""

import math

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from softrod_jax.foundation.numbers import Given, Maybe, PairLike, RowsLike, ScalarLike
from softrod_jax.scene.ranges import number

# Rounding of holes that touch, and of what holes in a ring take away, in terms of the radius.
_APART, _MIDDLE = 1 - 1e-9, 1e-6


class Circle(eqx.Module):
    """A circle, solid but for its `holes`: rows of x, y and radius, (holes, 3).

    Holes must leave the axis in the middle of what is left, and it as stiff in bending one way as
    another: one in the centre, and others in a ring. In torsion, a hole beside the axis takes away
    twice its polar moment there, for shear stress runs around it. That is so of small holes far
    from each other and from the edge: of the robot of Roshanfar et al. (2024), radius 6 mm with
    holes of 1.5 mm in the middle and 0.75 mm 4 mm off, the constant is 0.1 % too large.
    """

    radius: Given[ScalarLike] = number("m", above=0, harmless=0.1)
    holes: Maybe[RowsLike] = number(
        "m", optional=True, sizes=(3,), rows=1, harmless=((0.0, 0.0, 1e-3), (0.0, 0.0, 1e-3))
    )

    @property
    def area(self) -> ScalarLike:
        solid = jnp.pi * self.radius**2
        return solid if self.holes is None else solid - jnp.sum(self._hole_areas)

    @property
    def second_moments(self) -> Float[Array, "2"]:
        solid = jnp.pi * self.radius**4 / 4 * jnp.ones(2)
        if self.holes is None:
            return solid
        x, y, a = self.holes.T
        square = jnp.stack([y, x]) ** 2 + a**2 / 4
        return solid - square @ self._hole_areas

    @property
    def torsion_constant(self) -> ScalarLike:
        solid = jnp.pi * self.radius**4 / 2
        if self.holes is None:
            return solid
        x, y, a = self.holes.T
        return solid - self._hole_areas @ (a**2 / 2 + 2 * (x**2 + y**2))

    @property
    def outline_radius(self) -> ScalarLike:
        return self.radius

    @property
    def _hole_areas(self) -> Float[Array, "holes"]:
        assert self.holes is not None, "a circle with holes"
        return jnp.pi * self.holes[:, 2] ** 2

    def relations(self):
        """What must hold between the numbers: a field, whether it does, and what is expected."""
        holes, R = self.holes, self.radius
        if holes is None:
            return
        x, y, a = holes.T
        r = _distance(holes)
        inside = ((a > 0) & (r + a < R)).all()
        apart = abs((x + 1j * y)[:, None] - (x + 1j * y)) >= (a[:, None] + a) * _APART
        apart = (apart | np.eye(len(x), dtype=bool)).all()
        size = _MIDDLE * R**4
        middle = (abs(R * (a**2 @ x)) <= size) & (abs(R * (a**2 @ y)) <= size)
        middle &= (abs(a**2 @ (x * y)) <= size) & (abs(a**2 @ (x**2 - y**2)) <= size)
        expected = f"expected rows of x, y and a radius above 0, [m], within radius = {R}"
        yield "holes", inside, lambda: expected
        yield "holes", apart, lambda: "expected holes that do not run into each other"
        yield "holes", middle, lambda: "expected the same around the axis: a ring of three or more"

    def contains(self, offset):
        # A hole counts as inside: a chamber or a tendon may run through it.
        return _distance(offset) <= self.radius


class Annulus(eqx.Module):
    """A tube."""

    outer_radius: Given[ScalarLike] = number("m", above=0, harmless=0.1)
    inner_radius: Given[ScalarLike] = number("m", at_least=0, harmless=0.05)

    @property
    def area(self) -> ScalarLike:
        return jnp.pi * (self.outer_radius**2 - self.inner_radius**2)

    @property
    def second_moments(self) -> Float[Array, "2"]:
        return jnp.pi * (self.outer_radius**4 - self.inner_radius**4) / 4 * jnp.ones(2)

    @property
    def torsion_constant(self) -> ScalarLike:
        return jnp.pi * (self.outer_radius**4 - self.inner_radius**4) / 2

    @property
    def outline_radius(self) -> ScalarLike:
        return self.outer_radius

    def relations(self):
        """What must hold between the numbers: a field, whether it does, and what is expected."""
        outer = self.outer_radius
        expected = lambda: f"expected less than outer_radius = {float(outer)} [m]"
        yield "inner_radius", self.inner_radius < outer, expected

    def contains(self, offset):
        # The bore counts as inside: a chamber or a tendon may run through it.
        return _distance(offset) <= self.outer_radius


class Rectangle(eqx.Module):
    """A rectangle, `width` along x and `height` along y."""

    width: Given[ScalarLike] = number("m", above=0, harmless=0.1)
    height: Given[ScalarLike] = number("m", above=0, harmless=0.1)

    @property
    def area(self) -> ScalarLike:
        return self.width * self.height

    @property
    def second_moments(self) -> Float[Array, "2"]:
        w, h = self.width, self.height
        return jnp.stack([w * h**3, h * w**3]) / 12

    @property
    def torsion_constant(self) -> ScalarLike:
        """Saint-Venant's series (Timoshenko & Goodier, Theory of Elasticity, art. 109)."""
        a = jnp.maximum(self.width, self.height)
        b = jnp.minimum(self.width, self.height)
        # Terms fall as n^-5 and tanh is 1 to rounding after the first few: nine odd terms
        # leave 1e-7 of the sum at worst, removed by the closed form of the tail with tanh = 1.
        n = jnp.arange(1, 19, 2)
        tail = 31 * _ZETA_5 / 32 - jnp.sum(1.0 / n**5)
        series = jnp.sum(jnp.tanh(n * jnp.pi * a / (2 * b)) / n**5) + tail
        return a * b**3 * (1 / 3 - 64 / jnp.pi**5 * (b / a) * series)

    def contains(self, offset):
        x, y = abs(offset[..., 0]), abs(offset[..., 1])
        return (x <= self.width / 2) & (y <= self.height / 2)


def _distance(offset):
    """From the axis, of arrays of numpy and of JAX alike; squares would overflow."""
    return abs(offset[..., 0] + 1j * offset[..., 1])


_ZETA_5 = 1.036927755143369926  # Riemann zeta(5): sum over odd n of n^-5 is 31/32 of it


class GeneralSection(eqx.Module):
    """A section given by its numbers, for shapes that are not listed here."""

    area: Given[ScalarLike] = number("m^2", above=0, harmless=0.03)
    second_moments: Given[PairLike] = number("m^4", sizes=(2,), above=0, harmless=1e-4)
    torsion_constant: Given[ScalarLike] = number("m^4", above=0, harmless=1e-4)

    def contains(self, offset):
        # The outline is unknown: the radius of gyration bounds nothing, so accept.
        return abs(offset[..., 0]) < math.inf


Section = Circle | Annulus | Rectangle | GeneralSection
