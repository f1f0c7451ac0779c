"""Linear complementarity problems: which of a few one-sided conditions hold, and how hard."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from softrod_jax.bvp.block_sweep import inverse

# A gap below zero by this part of the largest one is a rounding error.
_ROUNDING = 1e-10
# What is added to the diagonal where S is inverted, as a part of each entry. Several tendons
# may hold the same (two on one path, four in one section): they share then. Newton's method, whose
# gaps are exact, converges with it at this rate, or this over how much softer a direction is.
_SHARED = 1e-9
# The least entry of the diagonal that units are made of, as a part of its largest one.
_LEAST = 1e-15
# A gap that is left, as a part of the largest one that there would be without multipliers.
_CONTRADICTION = 1e-4
# Exchanges of all at once that are tried in vain.
_PATIENCE = 3
# Exchanges at most, for each condition; only problems without a solution take so many.
_EXCHANGES = 8


class Conditions(NamedTuple):
    """How gaps follow multipliers x to first order, as S x + q.

    `tight`: those that are not zero in the first try; `inverse`: of S in their rows and columns.
    """

    S: Float[Array, "m m"]
    tight: Bool[Array, "m"]
    inverse: Float[Array, "m m"]

    def multipliers(self, q: Float[Array, "m"]) -> Float[Array, "m"]:
        """x >= 0 with gaps S x + q >= 0, one of the two zero for each. NaN if none is found.

        By exchanges between those that are zero and those that are not: all that have a wrong sign
        at once while that makes them fewer, and else the last of them only (Judice & Pires,
        Computers and Operations Research 21, 1994), which for a positive definite S always ends.
        """
        m = q.shape[0]
        index = jnp.arange(m)
        # Gaps of different kinds are compared in units of their own.
        unit = _units(self.S)
        largest = jnp.max(jnp.abs(q) / unit)

        def judged(x, tight):
            x = jnp.where(tight, x, 0.0)
            gap = q + self.S @ x
            # What is not a number is wrong, too.
            return x, ~jnp.where(tight, x >= 0, gap / unit >= -_ROUNDING * largest)

        def exchange(state):
            tight, _, wrong, fewest, patience, tries = state
            count = jnp.sum(wrong)
            fewer = count < fewest
            patience = jnp.where(fewer, _PATIENCE, patience - 1)
            last = index == jnp.max(jnp.where(wrong, index, -1))
            tight = tight ^ jnp.where(patience > 0, wrong, last)
            x = self._solved(_inverse_of(self.S, tight), q, tight)
            return tight, *judged(x, tight), jnp.minimum(fewest, count), patience, tries + 1

        def unsolved(state):
            _, _, wrong, _, _, tries = state
            return jnp.any(wrong) & (tries < _EXCHANGES * m)

        first = judged(self._solved(self.inverse, q, self.tight), self.tight)
        start = (self.tight, *first, jnp.array(m + 1), jnp.array(_PATIENCE), jnp.array(0))
        tight, x, wrong, *_ = jax.lax.while_loop(unsolved, exchange, start)
        # Conditions that contradict each other leave a gap, however large the multipliers.
        left = jnp.where(tight, jnp.abs(q + self.S @ x), 0.0)
        contradiction = jnp.max(left / unit) > _CONTRADICTION * largest
        return jnp.where(jnp.any(wrong) | contradiction, jnp.nan, x)

    def _solved(self, inverse, q, tight):
        x = inverse @ jnp.where(tight, -q, 0.0)
        # Once more, for what the inverse has on its diagonal.
        return x + inverse @ jnp.where(tight, -q - self.S @ x, 0.0)


def conditions(S: Float[Array, "m m"], tight: Bool[Array, "m"]) -> Conditions:
    """What the search for multipliers needs."""
    return Conditions(S, tight, _inverse_of(S, tight))


def _inverse_of(S, tight):
    """Of S in the rows and columns that are tight; those of the others are a unit matrix's."""
    eye = jnp.eye(S.shape[0])
    unit = jnp.where(tight, _units(S), 1.0)
    both = unit[:, None] * unit[None, :]
    own = S / both + _SHARED * eye
    return inverse(jnp.where(tight[:, None] & tight[None, :], own, eye)) / both


def _units(S):
    """Of gaps, (m,): with gaps in these and multipliers in their inverse, S has ones on its
    diagonal."""
    diagonal = jnp.abs(jnp.diagonal(S))
    return jnp.sqrt(jnp.maximum(jnp.maximum(diagonal, _LEAST * jnp.max(diagonal)), 1e-300))
