"""Newton's method for few equations, with an inverse that serves many solves.

Equations of few unknowns cost little more than their overhead, and their Jacobian costs several
times as much. So one inverse serves all solves of a step, and those of the next steps while
corrections fall fast with it. Only where they fall slowly are there Jacobians of their own.
Derivatives are those of the solution, with its own Jacobian.
"""

from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

# Corrections with the inverse of another solve, and in all; what one may change at most.
_SIMPLE, _MOST, _LARGEST = 8, 30, 1.0
# By how much each has to fall with that inverse; how slowly they may have fallen where the next
# step goes on with it; and how fast they are taken to fall at most, before more is known.
_FALLS, _REUSE, _CAUTION = 0.3, 0.1, 0.02
_ROUNDING = 1e-13


class Search(NamedTuple):
    """What solves share: an `inverse`, and how they went.

    `fresh`: whether the next needs an inverse of its own; `slow`: by how much corrections fell in
    the slowest; `solved`: whether all have a solution; `iterations` of all.
    """

    inverse: Float[Array, "n n"]
    fresh: Bool[Array, ""]
    slow: Float[Array, ""]
    solved: Bool[Array, ""]
    iterations: Int[Array, ""]

    @staticmethod
    def new(size: int, solved) -> "Search":
        """Before the first solve; where `solved` is not so, none is tried."""
        none = jnp.zeros((), jnp.int32)
        begun = jnp.asarray(solved)
        return Search(jnp.zeros((size, size)), jnp.array(True), jnp.zeros(()), begun, none)

    def next(self, solved, restart) -> "Search":
        """Before the solves of the next step."""
        slow = self.fresh | (self.slow > _REUSE) | restart | ~self.solved
        none = jnp.zeros((), jnp.int32)
        expected = jnp.where(slow, 0.0, 0.5 * self.slow)
        return Search(self.inverse, slow, expected, jnp.asarray(solved), none)


class _At(NamedTuple):
    """Corrections so far: the size of the last one, and by how much the slowest fell."""

    x: Float[Array, "n"]
    size: Float[Array, ""]
    ratio: Float[Array, ""]
    slow: Float[Array, ""]
    count: Int[Array, ""]

    @property
    def left(self):
        """The size of the corrections that would follow, as these fall."""
        return self.size * self.ratio / jnp.maximum(1 - self.ratio, 1e-3)

    def large(self, small):
        """Whether more than `small` is left."""
        return self.left > small * jnp.maximum(1.0, jnp.max(jnp.abs(self.x)))

    def corrected(self, step) -> "_At":
        size = jnp.max(jnp.abs(step))
        known = jnp.isfinite(self.size)
        ratio = jnp.where(known, size / jnp.maximum(self.size, 1e-300), self.ratio)
        # Rounding does not fall.
        ratio = jnp.where(size < _ROUNDING, 0.0, jnp.minimum(ratio, 1.0))
        slow = jnp.where(known, jnp.maximum(self.slow, ratio), self.slow)
        return _At(self.x - step, size, ratio, slow, self.count + 1)


def solve_few(
    residual: Callable, given, guess: Float[Array, "n"], search: Search, small
) -> tuple[Float[Array, "n"], Search]:
    """x with residual(given, x) = 0, near `guess`, and the search after it.

    All that the residual depends on with a derivative is in `given`. `small`: the size of the error
    that may be left.
    """
    held = jax.tree.map(lambda a: jax.lax.stop_gradient(a) if eqx.is_array(a) else a, given)
    own = lambda x: residual(held, x)
    fresh = lambda: jnp.linalg.inv(jax.jacfwd(own)(guess))
    inverse = jax.lax.cond(search.fresh, fresh, lambda: search.inverse)
    x, solved, count, slow = _search(own, guess, inverse, search, jax.lax.stop_gradient(small))
    x = jax.lax.stop_gradient(x)

    def at_solution(f, _):
        return x

    def tangent(linear, y):
        return jnp.linalg.solve(jax.jacfwd(linear)(y), y)

    x = jax.lax.custom_root(lambda x: residual(given, x), x, at_solution, tangent)
    iterations = search.iterations + count
    slow = jnp.maximum(search.slow, slow)
    return x, Search(inverse, jnp.array(False), slow, search.solved & solved, iterations)


def _search(residual: Callable, guess, inverse, search: Search, small):
    """Where corrections become small, whether they do, their number, and how slowly they fall."""
    one, none = jnp.ones(()), jnp.zeros((), jnp.int32)
    tried = search.solved
    # As fast as with this inverse before.
    ratio = jnp.where(search.fresh, 1.0, jnp.maximum(search.slow, _CAUTION))
    start = _At(guess, jnp.where(tried, jnp.inf, 0.0), ratio, jnp.zeros(()), none)
    falls = lambda at: jnp.isfinite(at.size) & (at.slow < _FALLS) & (at.size < _LARGEST)
    simple = jax.lax.while_loop(
        lambda at: (at.count == 0) & tried | (at.large(small) & falls(at) & (at.count < _SIMPLE)),
        lambda at: at.corrected(inverse @ residual(at.x)),
        start,
    )
    failed = simple.large(small)
    x = jnp.where(failed, guess, simple.x)
    size = jnp.where(failed, jnp.inf, simple.size)
    again = _At(x, size, jnp.where(failed, 1.0, simple.ratio), one, simple.count)

    def newton(at: _At) -> _At:
        step = jnp.linalg.solve(jax.jacfwd(residual)(at.x), residual(at.x))
        size = jnp.max(jnp.abs(step))
        cut = jnp.minimum(1.0, _LARGEST / jnp.maximum(size, 1e-300))
        return at.corrected(step * cut)

    goes_on = lambda at: at.large(small) & ~jnp.isnan(at.size) & (at.count < _MOST)
    found = jax.lax.while_loop(goes_on, newton, again)
    solved = ~found.large(small) & jnp.all(jnp.isfinite(found.x))
    slow = jnp.where(failed, 1.0, simple.slow)
    return jnp.where(solved, found.x, guess), solved, found.count, slow
