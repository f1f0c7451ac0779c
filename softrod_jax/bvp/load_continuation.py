"""Load continuation: all loads rise together, in as few steps as is safe."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array

from softrod_jax.bvp.boundary_value import Found, chosen, search_directly
from softrod_jax.bvp.equations import Equations, Unknowns, scaled_loads
from softrod_jax.bvp.newton import NewtonOptions, no_factors
from softrod_jax.foundation.results import RESULTS

# Continuation gives up when the next load step is a smaller part of the whole than this.
_SMALLEST_LOAD_STEP = 1e-4
_MAX_LOAD_STEPS = 1000
# Corrections that fall at least this fast, undamped, from one load to the next: the answer is
# on the branch that the last one was on.
SAFE_CONTRACTION = 0.5


class _Load(NamedTuple):
    """Continuation: solved at `load`; `before` and `before_load` are one step earlier."""

    load: Array
    step: Array
    U: Unknowns
    found: Found
    before: Unknowns
    before_load: Array
    factors: Any
    tries: Array
    running: Array


def search_by_load(equations: Equations, options: NewtonOptions, U, before=None):
    """Raise all loads together from zero to one, in as few steps as is safe.

    A step is taken when Newton's corrections fall fast and undamped from the last answer (by a
    secant), which keeps the solution on its branch. Ordinary scenes take one.
    """
    del before

    def attempt(state):
        load = jnp.minimum(1.0, state.load + state.step)
        ahead = (load - state.load) / jnp.maximum(state.load - state.before_load, 1e-12)
        past = state.found
        ahead = jnp.where(past.load_steps > 1, ahead, 0.0)
        start = jax.tree.map(lambda a, b: a + ahead * (a - b), state.U, state.before)
        loaded = equations._replace(rod=scaled_loads(equations.rod, load))
        new, found, factors = search_directly(loaded, options, start)
        converged = found.result == RESULTS.successful
        # An unstable answer means that a singular point was stepped over: the path, with its
        # imperfections, passes by its side. Only where the path itself is unstable (a column
        # that is straight for symmetry) do no smaller steps help.
        smallest = state.step / 4 < _SMALLEST_LOAD_STEP
        passes = found.stable | ~past.stable | smallest
        ok = converged & (found.contraction < SAFE_CONTRACTION) & passes
        # A secant is off by the square of the step, and corrections fall as fast as it is close.
        longer = jnp.minimum(2.0, 1 / jnp.sqrt(jnp.maximum(found.contraction, 1e-6)))
        step = jnp.where(ok, longer * state.step, state.step / 4)
        tries = state.tries + 1
        stuck = (~ok & (step < _SMALLEST_LOAD_STEP)) | (tries >= _MAX_LOAD_STEPS)
        finished = ok & (load >= 1.0)
        failure = jnp.where(converged, RESULTS.diverged, found.result).astype(jnp.int32)
        found = found._replace(
            result=jnp.where(finished, found.result, failure),
            stable=jnp.where(ok, found.stable, past.stable),
            iterations=past.iterations + found.iterations,
            load_steps=past.load_steps + ok,
        )
        return _Load(
            load=jnp.where(ok, load, state.load),
            step=step,
            U=chosen(ok, new, state.U),
            found=found,
            before=chosen(ok, state.U, state.before),
            before_load=jnp.where(ok, state.load, state.before_load),
            factors=factors,
            tries=tries,
            running=~stuck & ~finished,
        )

    zero, none = jnp.zeros((), jnp.int32), jnp.zeros(())
    found = Found(zero, zero, none, none, zero, jnp.array(True))
    factors = no_factors(equations.factorise, U)
    start = _Load(none, jnp.ones(()), U, found, U, none, factors, zero, jnp.array(True))
    end = jax.lax.while_loop(lambda state: state.running, attempt, start)
    return end.U, end.found, end.factors
