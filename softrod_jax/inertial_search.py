"""Newton's method for a step of the motion, behind it a continuation in the time step.

A step that Newton's method cannot take at once is taken shorter, from where inertia holds the
rod, and then longer and longer. What is found in the end solves the whole step: neither the
time scheme nor the derivative knows how.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array

from softrod_jax.boundary_value import Equations, Found, search_directly
from softrod_jax.newton import NewtonOptions
from softrod_jax.results import RESULTS
from softrod_jax.rod_ode import History

# The shortest first try, and the shortest advance, as parts of the step.
_FIRST_RETRY, _SMALLEST = 1 / 8, 1e-3
_MAX_TRIES = 20


class _Part(NamedTuple):
    """Solved for the part `done` of the step; the next try is `advance` longer."""

    done: Array
    advance: Array
    U: Array
    found: Found
    tries: Array
    running: Array


def search_by_inertia(equations: Equations, options: NewtonOptions, U):
    """The unknowns of a step from the guess `U`, and how they were found.

    `Found.load_steps` counts the parts of the step; ordinary steps take one.
    """
    c0, strain_h, velocity_h = equations.history
    held = equations.fields(U)
    _, q, w, _, _ = equations.layout.split(held.y)
    velocity = jnp.concatenate([q, w], -1)

    def part_of_step(part):
        # c (y - held) + the rate at `held`: with c = c0 the step itself.
        c = c0 / part
        history = History(
            c, strain_h + (c0 - c) * held.strain, velocity_h + (c0 - c) * velocity
        )
        return equations._replace(history=history)

    def attempt(state):
        part = jnp.minimum(1.0, state.done + state.advance)
        new, found = search_directly(part_of_step(part), options, state.U)
        ok = found.result == RESULTS.successful
        shorter = jnp.where(state.advance == 1.0, _FIRST_RETRY, state.advance / 4)
        advance = jnp.where(ok, 2 * state.advance, shorter)
        past = state.found
        return _Part(
            done=jnp.where(ok, part, state.done),
            advance=advance,
            U=jnp.where(ok, new, state.U),
            found=found._replace(
                iterations=past.iterations + found.iterations,
                load_steps=past.load_steps + ok,
            ),
            tries=state.tries + 1,
            running=~(ok & (part >= 1.0))
            & (ok | (advance >= _SMALLEST))
            & (state.tries < _MAX_TRIES),
        )

    zero, none = jnp.zeros((), jnp.int32), jnp.zeros(())
    found = Found(zero, zero, none, none, zero, jnp.array(True))
    start = _Part(none, jnp.ones(()), U, found, zero, jnp.array(True))
    end = jax.lax.while_loop(lambda state: state.running, attempt, start)
    whole = (end.found.result != RESULTS.successful) | (end.done >= 1.0)
    result = jnp.where(whole, end.found.result, RESULTS.diverged).astype(jnp.int32)
    return end.U, end.found._replace(result=result)
