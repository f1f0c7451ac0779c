"""Conditions on the whole rod, each held by a multiplier that is an unknown of its own."""

import abc
from typing import Any

import equinox as eqx
from jaxtyping import Array, Float


class AbstractConstraint(eqx.Module):
    """One-sided conditions on the strains of the whole rod.

    Each has a multiplier, such as a tension, and a gap, such as how much longer a tendon is than
    its path: neither is negative, and one of the two is zero. The multipliers act on the rod, and
    the gaps follow from its strains; `bvp/` finds them together.
    """

    @property
    @abc.abstractmethod
    def count(self) -> int:
        """How many conditions there are."""

    @property
    @abc.abstractmethod
    def loads(self) -> list[Any]:
        """The fields that rise from zero in a continuation; `None` for one that is absent."""

    @abc.abstractmethod
    def applied(self, rod: Any, multipliers: Float[Array, "conditions"]) -> Any:
        """The rod on which the multipliers act."""

    @abc.abstractmethod
    def gaps(
        self,
        rod: Any,
        strain: Float[Array, "points strain"],
        multipliers: Float[Array, "conditions"],
        weights: Float[Array, "points"],
    ) -> Float[Array, "conditions"]:
        """The gaps of a rod with these strains at the points of its grid.

        `weights` [m]: of the integral along the rod.
        """

    @abc.abstractmethod
    def gaps_by_strain(
        self,
        rod: Any,
        strain: Float[Array, "points strain"],
        weights: Float[Array, "points"],
    ) -> Float[Array, "conditions points strain"]:
        """The derivative of the gaps by the strains, whatever the multipliers are."""
