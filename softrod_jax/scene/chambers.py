"""Air chambers, capped at their end."""

import equinox as eqx
import jax.numpy as jnp

from softrod_jax.foundation.numbers import Given, ManyLike, RowsLike
from softrod_jax.scene.ranges import number
from softrod_jax.scene.tendons import Each, check_each, part_of


class Chambers(eqx.Module):
    """Air chambers along the rod, closed at both ends.

    - `areas` [m^2], (chambers,): the cross-section of each.
    - `offsets` [m], (chambers, 2): x and y of each in the section.
    - `starts_at`, `ends_at` [m]: for each the arc lengths between which it runs; `None` for the
      base and for the tip.
    """

    areas: Given[ManyLike] = number(
        "m^2", above=0, per_actuator=True, harmless=0.01, converter=jnp.asarray
    )
    offsets: Given[RowsLike] = number(
        "m", sizes=(2,), per_actuator=True, harmless=0.01, converter=jnp.asarray
    )
    starts_at: Each | None = number("m", each=True, at_least=0)
    ends_at: Each | None = number("m", each=True, above=0, harmless=1.0)

    def __check_init__(self):
        for name in ("starts_at", "ends_at"):
            check_each("Chambers", name, getattr(self, name), self.count, "chamber")

    @property
    def count(self) -> int:
        return self.areas.shape[0] if hasattr(self.areas, "shape") else len(self.areas)

    def part(self, i: int, length):
        """Where chamber `i` of a rod of this `length` begins and ends [m]."""
        return part_of(self, i, length)
