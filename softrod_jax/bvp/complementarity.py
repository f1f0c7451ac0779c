"""Linear complementarity problems: which of a few one-sided conditions hold, and how hard."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

# A gap below zero by this part of the largest one is a rounding error.
_ROUNDING = 1e-13
# What is added to the diagonal, as a part of its largest entry: two tendons on one path share.
_SHARED = 1e-12
# Exchanges at most, for each condition; only problems without a solution take so many.
_EXCHANGES = 8


def shared(S: Float[Array, "m m"]) -> Float[Array, "m m"]:
    """S, in which conditions that are the same share what holds them."""
    return S + _SHARED * jnp.max(jnp.abs(jnp.diagonal(S))) * jnp.eye(S.shape[0])


def complementary(
    S: Float[Array, "m m"], q: Float[Array, "m"], start: Float[Array, "m"]
) -> Float[Array, "m"]:
    """x >= 0 with gaps S x + q >= 0, where for each one of the two is zero. NaN if none is found.

    By exchanges between those that are zero and those that are not: all that have a wrong sign at
    once while that makes them fewer, and else the last of them only (Judice & Pires, Computers and
    Operations Research 21, 1994), which for a positive definite S always ends. It begins with those
    of `start` that are above zero: near a solution the first guess is right.
    """
    m = q.shape[0]
    S = shared(S)
    index = jnp.arange(m)

    def solved(active):
        both = active[:, None] & active[None, :]
        x = jnp.linalg.solve(jnp.where(both, S, jnp.eye(m)), jnp.where(active, -q, 0.0))
        x = jnp.where(active, x, 0.0)
        gap = q + S @ x
        # What is not a number is wrong, too.
        return x, ~jnp.where(active, x >= 0, gap >= -_ROUNDING * jnp.max(jnp.abs(q)))

    def exchange(state):
        active, _, wrong, fewest, patience, tries = state
        count = jnp.sum(wrong)
        fewer = count < fewest
        patience = jnp.where(fewer, 3, patience - 1)
        last = index == jnp.max(jnp.where(wrong, index, -1))
        active = active ^ jnp.where(fewer | (patience > 0), wrong, last)
        x, wrong = solved(active)
        return active, x, wrong, jnp.minimum(fewest, count), patience, tries + 1

    def unsolved(state):
        _, _, wrong, _, _, tries = state
        return jnp.any(wrong) & (tries < _EXCHANGES * m)

    active = start > 0
    first = (active, *solved(active), jnp.array(m + 1), jnp.array(3), jnp.array(0))
    _, x, wrong, *_ = jax.lax.while_loop(unsolved, exchange, first)
    return jnp.where(jnp.any(wrong), jnp.nan, x)
