"""The equilibrium in which a heavily damped rod comes to rest: statics where no path leads.

Where the path of equilibria ends under rising loads (a rod that snaps, a column that buckles)
the rod moves on to another one. Here it does: loads rise, inertia and damping carry the rod, in
steps of backward Euler. They stay short: long ones would damp an instability, too, and come to
rest on its top.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from softrod_jax.bvp.boundary_value import search_directly
from softrod_jax.bvp.equations import Equations, scaled_loads
from softrod_jax.bvp.method import AbstractMethod, Guess
from softrod_jax.bvp.newton import NewtonOptions
from softrod_jax.foundation.results import RESULTS
from softrod_jax.rod.constants import PointLoad, Rod
from softrod_jax.rod.state import History, Layout, layout_of

# In units of the rod's own time, L^2 sqrt(rho A / EI): the damping B / K and the time step.
_DAMPING, _STEP = 0.3, 0.1
# Steps in which the loads rise, and at most. They rise by the same factor in each, from a part so
# small that any rod bears it: one that is soon over its first critical load would buckle in a
# higher mode, and wind up.
_RISE, _LOWEST, _MAX_STEPS = 60, 1e-4, 1500
# Rest: curvatures that change by less than this many 1/L per unit of time. A disturbance of
# 1e-6 must have the time to grow.
_REST = 1e-9


class Rest(NamedTuple):
    """States and strains at the end, and the steps it took.

    `loaded`: whether all loads act there in full; `at_rest`: whether the rod has come to rest.
    """

    guess: Guess
    loaded: Array
    at_rest: Array
    steps: Int[Array, ""]


class _State(NamedTuple):
    guess: Guess
    h: Float[Array, ""]
    rate: Float[Array, ""]
    steps: Int[Array, ""]
    loaded: Int[Array, ""]


def dynamic_relaxation(
    method: AbstractMethod, layout: Layout, options: NewtonOptions, rod: Rod, guess: Guess
) -> Rest:
    """Let `rod` move from `guess`, a static one, under loads that rise from zero."""
    rod = _weights_without_mass(rod)
    unit = rod.L**2 * jnp.sqrt(jnp.max(rod.rho_A) / jnp.max(rod.K_bt[..., :2]))
    rod = eqx.tree_at(
        lambda r: (r.B_se, r.B_bt, r.C),
        rod,
        (
            None if rod.K_se is None else _DAMPING * unit * rod.K_se,
            _DAMPING * unit * rod.K_bt,
            None,
        ),
        is_leaf=lambda x: x is None,
    )
    moving = layout_of(rod, dynamic=True)

    def at_rest(guess):
        still = jnp.zeros((*guess.y.shape[:-1], layout.pair))
        pose, wrench = jnp.split(guess.y, [layout.pose_size], axis=-1)
        return guess._replace(y=moving.join(pose, still, wrench))

    def step(state):
        load = jnp.minimum(1.0, _LOWEST ** (1 - (state.loaded + 1) / _RISE))
        _, q, w, _, _ = moving.split(state.guess.y)
        velocity = jnp.concatenate([q, w], -1)
        c0 = 1 / state.h
        history = History(c0, -c0 * state.guess.strain, -c0 * velocity)
        here = Equations(method, moving, scaled_loads(rod, load), history, state.guess.strain)
        U, found, _ = search_directly(here, options, here.start(state.guess))
        new = here.fields(U)
        ok = found.result == RESULTS.successful
        _, bend = layout.split_strain(new.strain - state.guess.strain)
        change = jnp.max(jnp.abs(bend)) * rod.L
        return _State(
            jax.tree.map(lambda a, b: jnp.where(ok, a, b), new, state.guess),
            jnp.where(ok, jnp.minimum(1.5 * state.h, _STEP * unit), 0.25 * state.h),
            jnp.where(ok & (load >= 1.0), change / (state.h / unit), jnp.inf),
            state.steps + 1,
            state.loaded + ok,
        )

    def goes_on(state):
        return (state.rate > _REST) & (state.steps < _MAX_STEPS) & (state.h > 1e-6 * unit)

    zero = jnp.zeros((), jnp.int32)
    start = _State(at_rest(guess), _STEP * unit, jnp.array(jnp.inf), zero, zero)
    end = jax.lax.while_loop(goes_on, step, start)
    pose, rest = end.guess.y[..., : layout.pose_size], end.guess.y[..., layout.pose_size :]
    last = end.guess._replace(y=layout.join(pose, rest[..., layout.pair :]))
    # The rate is known from the moment on at which all loads act.
    return Rest(last, jnp.isfinite(end.rate), end.rate <= _REST, end.steps)


def _weights_without_mass(rod: Rod) -> Rod:
    """The rod with forces in place of its payload and masses, whose inertia would keep it moving.

    Where it comes to rest is the same.
    """
    none = jnp.zeros(rod.v_star.shape[-1])
    weight = lambda mass: none if rod.gravity is None else mass * rod.gravity
    if rod.payload is not None:
        force = weight(rod.payload) + (none if rod.F_tip is None else rod.F_tip)
        rod = eqx.tree_at(
            lambda r: (r.payload, r.F_tip), rod, (None, force), is_leaf=lambda x: x is None
        )
    if rod.at_gaps is None:
        return rod
    loads = tuple(x if x.mass is None else PointLoad(x.here, weight(x.mass)) for x in rod.at_gaps)
    return eqx.tree_at(lambda r: r.at_gaps, rod, loads)
