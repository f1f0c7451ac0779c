"""Newton's method for a step of the motion, behind it a continuation in the step and its loads.

A step that Newton's method cannot take at once is first taken under the loads of before, shorter,
from where inertia holds the rod, and then longer and longer. Then the loads change bit by bit to
what they are now; a load that jumps does so however short the step is. What is found in the end
solves the whole step: neither the time scheme nor the derivative knows how.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from softrod_jax.bvp.boundary_value import Found, chosen, search_directly
from softrod_jax.bvp.equations import Equations, Unknowns, loads_of, with_loads
from softrod_jax.bvp.newton import NewtonOptions, ReusedFactors, newton_with
from softrod_jax.foundation.results import RESULTS
from softrod_jax.rod.relaxation import Crept
from softrod_jax.rod.state import History

# The way: up to 1 the part of the step, from there to 2 the part of the change of the loads.
_GOAL = 2.0
# The shortest advance, and how many tries there are.
_SMALLEST, _MAX_TRIES = 1e-4, 30


# How far the strains are extrapolated at most: stretches by this, a section's edge alike.
_AHEAD = 0.1


class SharedFactors(NamedTuple):
    """In float32, for all stages of a step; `new`: whether this is the first, which makes them.

    `usable`: whether they are of such a Jacobian as is wanted.
    """

    factors: Any
    new: Bool[Array, ""]
    usable: Bool[Array, ""]


class Before(NamedTuple):
    """The loads that a step comes from, the strains' rates there, and the last factors if kept.

    `crept`: what dashpots had crept, (points, branches, strain), or `None`.
    """

    loads: list
    rate: Float[Array, "points strain"]
    reused: ReusedFactors | None
    shared: SharedFactors | None = None
    crept: Crept | None = None


class _Way(NamedTuple):
    """Solved up to `done`; the next try is `advance` further."""

    done: Array
    advance: Array
    U: Unknowns
    found: Found
    factors: Any
    tries: Array
    running: Array


def search_by_inertia(equations: Equations, options: NewtonOptions, U, before: Before):
    """The unknowns of a step from the guess `U`, and how they were found.

    `Found.load_steps` counts the parts; ordinary steps take one.
    """

    loads, keep_factors = loads_of(equations.rod), before.reused is not None

    at_once = lambda state: (equations.history, loads, state.U)
    on_the_way = lambda state: _on_the_way(equations, U, before, state)

    def attempt(state):
        at = jnp.minimum(_GOAL, state.done + state.advance)
        # Nothing is computed for what an ordinary step does not need.
        history, now, start = jax.lax.cond(state.tries == 0, at_once, on_the_way, state)
        problem = equations._replace(history=history, rod=with_loads(equations.rod, now))
        reused = None
        if before.reused is not None:
            first = state.tries == 0
            reused = ReusedFactors(
                state.factors, before.reused.usable & first, before.reused.alike & first
            )
        new, found, factors = search_directly(
            problem, options, start, reused, keep_factors=keep_factors
        )
        ok = found.result == RESULTS.successful
        # After the whole way the whole step under the loads of before, then ever less.
        first = (state.advance > 1.0) & (state.done == 0.0)
        shorter = jnp.where(first, 1.0, jnp.minimum(1.0, state.advance) / 4)
        advance = jnp.where(ok, 2 * (at - state.done), shorter)
        past = state.found
        return _Way(
            done=jnp.where(ok, at, state.done),
            advance=advance,
            U=chosen(ok, new, state.U),
            found=found._replace(
                iterations=past.iterations + found.iterations,
                load_steps=past.load_steps + ok,
            ),
            factors=factors,
            tries=state.tries + 1,
            running=~(ok & (at >= _GOAL))
            & (ok | (advance >= _SMALLEST))
            & (state.tries < _MAX_TRIES),
        )

    zero, none = jnp.zeros((), jnp.int32), jnp.zeros(())
    found = Found(zero, zero, none, none, zero, jnp.array(True))
    factors = None if before.reused is None else before.reused.factors
    start = _Way(none, jnp.array(_GOAL), U, found, factors, zero, jnp.array(True))
    shared = None
    if before.shared is not None:
        start, shared = _in_single(equations, options, start, before.shared)
    end = jax.lax.while_loop(lambda state: state.running, attempt, start)
    whole = (end.found.result != RESULTS.successful) | (end.done >= _GOAL)
    result = jnp.where(whole, end.found.result, RESULTS.diverged).astype(jnp.int32)
    factors = end.factors if shared is None else shared
    return end.U, end.found._replace(result=result), factors


def _on_the_way(equations: Equations, U, before: Before, state: _Way):
    """The history, the loads and the guess of the step as far as the next try goes."""
    assert equations.history is not None, "a step of a motion"
    c0, strain_h, velocity_h, crept_h = equations.history
    start = equations.fields(U)
    _, q, w, _, _ = equations.layout.split(start.y)
    velocity = jnp.concatenate([q, w], -1)
    strain = start.strain
    if equations.rod.front_viscosity is not None:
        # That of fronts has no slope where nothing moves, and Newton's method no start.
        ahead = (before.rate - strain_h) / c0 - strain
        strain = strain + ahead / jnp.maximum(jnp.max(jnp.abs(ahead)) / _AHEAD, 1.0)
    at = jnp.minimum(_GOAL, state.done + state.advance)
    part, change = jnp.minimum(at, 1.0), jnp.maximum(at - 1.0, 0.0)
    # c (y - start) + the rate at `start`: with c = c0 the step itself.
    c = c0 / part
    if crept_h is not None and before.crept is not None:
        crept_h = crept_h + (c0 - c) * before.crept
    history = History(c, strain_h + (c0 - c) * strain, velocity_h + (c0 - c) * velocity, crept_h)
    between = [change * a + (1 - change) * b for a, b in zip(loads_of(equations.rod), before.loads)]
    moving = equations.start(start._replace(strain=strain))
    return history, between, chosen(state.done == 0.0, moving, state.U)


def _in_single(equations: Equations, options: NewtonOptions, start: _Way, shared: SharedFactors):
    """The whole step at once with factors in float32: half the bytes, and bytes are the time.

    The equations are in float64, and so is the answer. In a batch in lockstep nothing else is run
    where this finds every sample; who is not found starts from the beginning.
    """
    U = start.U
    # As a branch; a loop leaves the factors in their place where there is nothing to do.
    _, factors = jax.lax.while_loop(
        lambda carry: carry[0],
        lambda carry: (jnp.array(False), equations.factorise(U, single=True)),
        (shared.new, shared.factors),
    )
    end = newton_with(
        factors, equations.residual, equations.correct, U, equations.scale(U), options
    )
    ok = (end.result == RESULTS.successful) & shared.usable
    found = Found(
        end.result,
        end.iterations,
        end.correction,
        end.contraction,
        ok.astype(jnp.int32),
        jnp.array(True),
    )
    way = start._replace(
        done=jnp.where(ok, _GOAL, start.done),
        U=chosen(ok, end.y, U),
        found=found,
        running=~ok,
    )
    return way, factors
