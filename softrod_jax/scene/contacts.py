"""Obstacles that a rod may touch: their shapes, and how hard they are.

An obstacle is a signed distance: how far a point is from its surface, above zero where the rod may
be. The surface of the rod is a capsule around its axis, so that the gap is the distance of the axis
less the radius of the rod there; what follows from it is in `rod/contact.py`.
"""

import abc

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from softrod_jax.foundation.numbers import Given, Maybe, RowsLike, ScalarLike, VectorLike
from softrod_jax.scene.ranges import number

# Closer to a centre or to an axis than this [m] no direction leads away from it.
_NOWHERE = 1e-12
_OPTIONAL = {"optional": True, "at_least": 0, "zero_is_absent": True}


class AbstractObstacle(eqx.Module):
    """A shape, as a signed distance written with JAX, of which the gradient is taken.

    The rod is pushed along the gradient, which is of length one where the distance is exact.
    """

    @abc.abstractmethod
    def distance(self, p: Float[Array, "3"]) -> Float[Array, ""]:
        """How far `p` [m] is outside of the obstacle [m]; below zero within it."""


class Plane(AbstractObstacle):
    """A wall through `point` [m]; the rod is where `normal` points to, a vector of any length."""

    point: Given[VectorLike] = number("m", sizes=(3,))
    normal: Given[VectorLike] = number(sizes=(3,), harmless=(0.0, 0.0, 1.0))

    def relations(self):
        """What must hold between the numbers: a field, whether it does, and what is expected."""
        yield "normal", abs(self.normal).max() > 0, lambda: "expected a direction, not zero"

    def distance(self, p):
        # Its largest component first: squares of tiny numbers are zero.
        n = self.normal / jnp.max(jnp.abs(self.normal))
        return (p - self.point) @ n / jnp.sqrt(n @ n)


class Sphere(AbstractObstacle):
    """A ball around `center` [m] of this `radius` [m]; the rod is outside."""

    center: Given[VectorLike] = number("m", sizes=(3,))
    radius: Given[ScalarLike] = number("m", above=0, harmless=1.0)

    def distance(self, p):
        return _length(p - self.center) - self.radius


class Tube(AbstractObstacle):
    """A tube of this `radius` [m] around the line through the points `axis` [m], (points, 3).

    The rod is inside. A tube has no ends: its first and its last piece go straight on. Where two
    pieces meet it is round outside and has an edge inside; many points make a smooth bend.
    """

    axis: Given[RowsLike] = number(
        "m", sizes=(3,), rows=2, harmless=((0.0, 0.0, 0.0), (0.0, 0.0, 1.0))
    )
    radius: Given[ScalarLike] = number("m", above=0, harmless=1.0)

    def relations(self):
        """What must hold between the numbers: a field, whether it does, and what is expected."""
        apart = (abs(self.axis[1:] - self.axis[:-1]).max(-1) > 0).all()
        yield "axis", apart, lambda: "expected each point at another place than the one before"

    def distance(self, p):
        start, along = self.axis[:-1], self.axis[1:] - self.axis[:-1]
        part = jnp.sum((p - start) * along, -1) / jnp.sum(along * along, -1)
        lower = jnp.zeros_like(part).at[0].set(-jnp.inf)
        upper = jnp.ones_like(part).at[-1].set(jnp.inf)
        away = p - start - jnp.clip(part, lower, upper)[:, None] * along
        nearest = jnp.argmin(jnp.sum(away * away, -1))
        return self.radius - _length(away[nearest])


class Contact(eqx.Module):
    """An obstacle, and the force per length with which it pushes what comes into it.

    - `obstacle`: a `Plane`, `Sphere`, `Tube`, or a shape of one's own.
    - `stiffness` k [N/m^2]: a depth d [m] of the rod's surface is pushed out by f = k d per length.
    - `damping` b [s/m]: f = k d (1 + b d_t), and never below zero (Hunt & Crossley, J. Appl. Mech.
      42, 1975). It begins from zero with the depth, so that no force jumps at a touch.
    - `friction` [-]: Coulomb's coefficient, in motions. A surface that slides at a velocity w is
      held back by friction * f * w / sqrt(w^2 + slip_speed^2); nothing sticks for ever, and
      equilibria are without friction.
    - `slip_speed` [m/s]: 1e-3 if `None`.
    - `name`: of its force in solutions; "contact1" for the first without one, and so on.
    - `moves`: whether recordings have columns for where it is carried.
    """

    obstacle: AbstractObstacle
    stiffness: Given[ScalarLike] = number("N/m^2", above=0, harmless=1.0)
    damping: Maybe[ScalarLike] = number("s/m", **_OPTIONAL)
    friction: Maybe[ScalarLike] = number(**_OPTIONAL)
    slip_speed: Maybe[ScalarLike] = number("m/s", optional=True, above=0, harmless=1.0)
    name: str | None = eqx.field(static=True, default=None)
    moves: bool = eqx.field(static=True, default=False)


def contact_names(contacts) -> tuple[str, ...]:
    """The names of all of them, those that are not given made by their number."""
    return tuple(x.name or f"contact{i + 1}" for i, x in enumerate(contacts or ()))


def _length(a):
    """Of a vector; zero with derivative zero where it is shorter than what has a direction."""
    square = a @ a
    somewhere = square > _NOWHERE**2
    return jnp.where(somewhere, jnp.sqrt(jnp.where(somewhere, square, 1.0)), 0.0)
