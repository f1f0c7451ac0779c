"""Load continuation: all loads change together, in as few steps as is safe."""

import dataclasses
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array

from softrod_jax.bvp.boundary_value import Found, chosen, search_directly
from softrod_jax.bvp.equations import Equations, Unknowns, loads_of, scaled_loads, with_loads
from softrod_jax.bvp.method import Guess
from softrod_jax.bvp.newton import NewtonOptions, no_factors
from softrod_jax.foundation.results import RESULTS
from softrod_jax.rod.friction import Slid

# Continuation gives up when the next load step is a smaller part of the whole than this.
_SMALLEST_LOAD_STEP = 1e-4
_MAX_LOAD_STEPS = 1000
# How many times further tendons with friction give before they slide, to begin with.
_SOFTER = 100.0
_FIRST_BEYOND = 0.5
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


class Reached(NamedTuple):
    """An equilibrium, as far as the next one on a path of inputs depends on it.

    `loads`: as `loads_of` has them; `slid`: of tendons with friction; `pulls` [m]: how far tendons
    have followed them, where an actuator has play.
    """

    guess: Guess
    loads: list
    slid: Slid | None = None
    pulls: Array | None = None


def search_by_load(
    equations: Equations, options: NewtonOptions, U, before: list[Array] | None = None
):
    """Change all loads together from those of `before`, or none, to all, in few steps.

    A step is taken when Newton's corrections fall fast and undamped from the last answer (by a
    secant), which keeps the solution on its branch. Ordinary scenes take one.
    """
    loads, friction = loads_of(equations.rod), equations.rod.friction

    def loaded(part, rod=equations.rod):
        if before is None:
            return equations._replace(rod=scaled_loads(rod, part))
        between = [part * a + (1 - part) * b for a, b in zip(loads, before)]
        return equations._replace(rod=with_loads(rod, between))

    if friction is None:
        return _follow(loaded, options, U, goal=1)
    # What sticks gives much at first, and then ever less: sudden changes of direction in many
    # places at once leave Newton's method no way.

    def then_sticking(part):
        stick = friction.stick * _SOFTER ** (1 - jnp.maximum(part - 1, 0.0))
        own = dataclasses.replace(friction, stick=stick)
        return loaded(jnp.minimum(part, 1.0), dataclasses.replace(equations.rod, friction=own))

    return _follow(then_sticking, options, U, goal=2)


def _follow(at: Callable, options: NewtonOptions, U, goal: int):
    """The unknowns of `at(goal)`, equations that `at(0)` has the unknowns `U` of.

    Up to 1 by loads, as `search_by_load` says. Beyond, any undamped convergence counts.
    """

    def attempt(state):
        beyond = state.load >= 1.0 if goal > 1 else jnp.array(False)
        load = jnp.minimum(jnp.where(beyond, float(goal), 1.0), state.load + state.step)
        ahead = (load - state.load) / jnp.maximum(state.load - state.before_load, 1e-12)
        past = state.found
        turns = beyond & (state.before_load < 1.0)
        ahead = jnp.where((past.load_steps > 1) & ~turns, ahead, 0.0)
        start = jax.tree.map(lambda a, b: a + ahead * (a - b), state.U, state.before)
        new, found, factors = search_directly(at(load), options, start)
        converged = found.result == RESULTS.successful
        # An unstable answer means that a singular point was stepped over: the path, with its
        # imperfections, passes by its side. Only where the path itself is unstable (a column
        # that is straight for symmetry) do no smaller steps help.
        smallest = state.step / 4 < _SMALLEST_LOAD_STEP
        passes = found.stable | ~past.stable | smallest
        ok = converged & (found.contraction < jnp.where(beyond, jnp.inf, SAFE_CONTRACTION)) & passes
        # A secant is off by the square of the step, and corrections fall as fast as it is close.
        longer = jnp.minimum(2.0, 1 / jnp.sqrt(jnp.maximum(found.contraction, 1e-6)))
        step = jnp.where(ok, longer * state.step, state.step / 4)
        step = jnp.where(ok & (load == 1.0), _FIRST_BEYOND, step) if goal > 1 else step
        tries = state.tries + 1
        stuck = (~ok & (step < _SMALLEST_LOAD_STEP)) | (tries >= _MAX_LOAD_STEPS)
        finished = ok & (load >= goal)
        failure = jnp.where(converged, RESULTS.diverged, found.result).astype(jnp.int32)
        found = found._replace(
            result=jnp.where(finished, found.result, failure),
            stable=jnp.where(ok, found.stable, past.stable),
            iterations=past.iterations + found.iterations,
            load_steps=past.load_steps + (ok & ~beyond),
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
    factors = no_factors(at(1.0).factorise, U)
    start = _Load(none, jnp.ones(()), U, found, U, none, factors, zero, jnp.array(True))
    end = jax.lax.while_loop(lambda state: state.running, attempt, start)
    return end.U, end.found, end.factors
