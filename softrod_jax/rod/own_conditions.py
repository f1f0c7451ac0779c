"""Conditions of users on the whole rod: what each integrates along it never exceeds its limit.

Where it would, a multiplier x >= 0 holds it: the rod then has the energy x W(v, u) beside all
others, with the condition's density W. Where the limit is not reached, x is zero.
"""

import dataclasses
from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from softrod_jax.rod.constants import Rod, full_strain
from softrod_jax.rod.constraint import AbstractConstraint
from softrod_jax.scene.acting import AbstractCondition, AbstractEnergy


class Held(AbstractEnergy):
    """What a condition does to the rod."""

    condition: AbstractCondition
    multiplier: Float[Array, ""]

    def density(self, v, u, s):
        """As the interface has it."""
        return self.multiplier * self.condition.density(v, u, s)


class OwnConditions(AbstractConstraint):
    """Those of a scene.

    `room`, (conditions,): how much less than its limit each integral is in the unloaded rod.
    `missing`: how much more, as a negative number; it rises from zero in a continuation.
    `unloaded`: the integrals in the unloaded rod.
    """

    own: tuple[AbstractCondition, ...]
    room: Float[Array, "conditions"]
    missing: Float[Array, "conditions"]
    unloaded: Float[Array, "conditions"]

    @property
    def count(self) -> int:
        return len(self.own)

    @property
    def loads(self) -> list[Any]:
        return [self.missing]

    def applied(self, rod: Rod, multipliers: Float[Array, "conditions"]) -> Rod:
        """With the energies that hold the conditions in the place of those that hold nothing."""
        held = tuple(Held(c, multipliers[i]) for i, c in enumerate(self.own))
        others = tuple(x for x in rod.energies or () if not isinstance(x, Held))
        return dataclasses.replace(rod, energies=(*others, *held))

    def gaps(
        self,
        rod: Rod,
        strain: Float[Array, "points strain"],
        multipliers: Float[Array, "conditions"],
        weights: Float[Array, "points"],
    ):
        """How far each integral is below its limit."""
        return (
            self.room + self.missing + self.unloaded - weights @ _densities(self.own, rod, strain)
        )

    def gaps_by_strain(
        self, rod: Rod, strain: Float[Array, "points strain"], weights: Float[Array, "points"]
    ):
        """As the interface has it: densities are pointwise."""
        ones = jnp.ones(strain.shape[0])

        def of_one(k):
            total = lambda strain: ones @ _densities(self.own, rod, strain)[:, k]
            return -weights[:, None] * jax.grad(total)(strain)

        return jnp.stack([of_one(k) for k in range(self.count)])


def with_conditions(rod: Rod, own: Sequence[AbstractCondition]) -> Rod:
    """The rod on which they hold, beside a constraint that it has."""
    own = tuple(own)
    strain = jnp.broadcast_to(rod.rest_strain, (rod.grid.s.shape[0], rod.strain_size))
    unloaded = rod.grid.weights @ _densities(own, rod, strain)
    limits = jnp.stack([jnp.asarray(x.limit, dtype=float) for x in own])
    left = limits - unloaded
    conditions = OwnConditions(own, jnp.maximum(left, 0.0), jnp.minimum(left, 0.0), unloaded)
    rod = conditions.applied(rod, jnp.zeros(len(own)))
    both = conditions if rod.constraint is None else Several((rod.constraint, conditions))
    return dataclasses.replace(rod, constraint=both)


class Several(AbstractConstraint):
    """Constraints that hold beside each other, with the multipliers of one after the other."""

    parts: tuple[AbstractConstraint, ...]

    @property
    def count(self) -> int:
        return sum(x.count for x in self.parts)

    @property
    def loads(self) -> list[Any]:
        return [load for x in self.parts for load in x.loads]

    def _each(self, multipliers):
        start = 0
        for part in self.parts:
            yield part, multipliers[start : start + part.count]
            start += part.count

    def applied(self, rod: Rod, multipliers: Float[Array, "conditions"]) -> Rod:
        """The rod on which all multipliers act."""
        for part, own in self._each(multipliers):
            rod = part.applied(rod, own)
        return rod

    def gaps(self, rod, strain, multipliers, weights):
        """Those of one part after the other."""
        each = [part.gaps(rod, strain, own, weights) for part, own in self._each(multipliers)]
        return jnp.concatenate(each)

    def gaps_by_strain(self, rod, strain, weights):
        """As the interface has it."""
        return jnp.concatenate([x.gaps_by_strain(rod, strain, weights) for x in self.parts])


def _densities(own, rod: Rod, strain: Float[Array, "points strain"]):
    """(points, conditions)."""
    full = full_strain(strain, rod)
    s = jnp.broadcast_to(rod.grid.s, full.shape[:1])
    of = lambda x: jax.vmap(lambda e, s: x.density(e[:3], e[3:], s))(full, s)
    return jnp.stack([of(x) for x in own], -1)
