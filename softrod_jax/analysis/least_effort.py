"""Inputs within bounds that bring a residual to zero with the least effort, or as near as they can.

In parts x of the bounds, in [0, 1], the search minimises

    1/2 |r(x)|^2 + 1/2 weight |x - x_rest|^2

for a falling weight, by Gauss and Newton's method with a trust region. Each step is the solution of
a quadratic problem within the bounds and within a box around x, which grows and shrinks by how well
that problem tells what comes. A heavy weight leads along the valley of small residuals to where
effort is least. In the end the residual alone counts, and the nearest x where it vanishes.

Where a rod is curled up, that valley is narrow and bent: a step along it is stopped by its side. A
step that fails is tried once more with what it has shown of the bend (a second-order correction).
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

# Weights of the effort, and the step of x or the iterations after which a search goes on to the
# next one. With the last of them effort is how far x moves.
_WEIGHTS = np.array([1e-2, 1e-4, 1e-6, 1e-8, 1e-12])
_ENOUGH = np.array([3e-2, 1e-2, 1e-3, 1e-4, 1e-6])
_PATIENCE = np.array([12, 8, 8, 8, 100])
_FIRST_REACH, _LEAST_REACH = 0.3, 1e-9
# Changes of what is held in the quadratic problem, for each component.
_MOST_CHANGES = 6


class Evaluated(NamedTuple):
    """The residual at a point, its derivative, whether there is one, and whatever else."""

    r: Float[Array, "r"]
    J: Float[Array, "r m"]
    solved: Bool[Array, ""]
    past: Any


class Search(NamedTuple):
    """The best point so far.

    `stage`: the number of the weight, and `tries` with it; `reach`: how far x may go in one step.
    `bend`: what the residual has been found to do beyond its derivative. `iterations`: all of them.
    """

    x: Float[Array, "m"]
    at: Evaluated
    stage: Int[Array, ""]
    tries: Int[Array, ""]
    reach: Float[Array, ""]
    bend: Float[Array, "r"]
    iterations: Int[Array, ""]
    running: Bool[Array, ""]


def least_effort(
    evaluate: Callable, x: Float[Array, "m"], past, rest: Float[Array, "m"], size: int, at_once
) -> Search:
    """Search from `x` for a residual of this `size`.

    - `evaluate(x, past)` gives an `Evaluated`; `past` is that of a point nearby.
    - `rest`: where effort is zero.
    - `at_once`: whether to look for a residual of zero only, whatever the effort. What asks for
      much effort lies beside the valley that a heavy weight leads along.
    """
    weights, enough, patience = map(jnp.array, (_WEIGHTS, _ENOUGH, _PATIENCE))
    last = len(_WEIGHTS) - 1

    def one(state: Search) -> Search:
        x, at, weight, final = state.x, state.at, weights[state.stage], state.stage == last
        from_rest = lambda y: y - jnp.where(final, x, rest)

        def cost(at: Evaluated, y):
            value = 0.5 * jnp.sum(at.r**2) + 0.5 * weight * jnp.sum(from_rest(y) ** 2)
            return jnp.where(at.solved & jnp.isfinite(value), value, jnp.inf)

        H = at.J.T @ at.J + weight * jnp.eye(x.shape[0])
        bent = at.r + state.bend
        g = at.J.T @ bent + weight * from_rest(x)
        low, high = jnp.maximum(-x, -state.reach), jnp.minimum(1 - x, state.reach)
        # The first evaluation is of the start itself.
        step = jnp.where(at.solved, bounded_minimum(H, g, low, high), 0.0)
        trial = jnp.clip(x + step, 0.0, 1.0)
        new = evaluate(trial, at.past)
        before, linear = cost(at, x), bent + at.J @ step
        there = 0.5 * jnp.sum(linear**2) + 0.5 * weight * jnp.sum(from_rest(trial) ** 2)
        told, falls = before - there, before - cost(new, trial)
        # Near the end costs differ by rounding only.
        at_rounding = jnp.abs(told) <= 1e-10 * before
        better = (falls > jnp.maximum(0.05 * told, 0.0)) | ~at.solved
        better = better | (at_rounding & (falls > -1e-10 * before))
        straight = jnp.all(state.bend == 0.0)
        again = ~better & straight & new.solved
        bend = jnp.where(again, new.r - linear, 0.0)
        good, length = falls > 0.7 * told, jnp.max(jnp.abs(step))
        reach = jnp.where(better | again, state.reach, 0.3 * length)
        reach = jnp.where(good, jnp.clip(2.5 * length, state.reach, 1.0), reach)
        inside = length < 0.99 * state.reach
        tries = state.tries + 1
        done = better & inside & (length <= enough[state.stage]) | (reach < _LEAST_REACH)
        done = at.solved & done | (tries >= patience[state.stage])
        chosen = lambda a, b: jnp.where(better, a, b)
        return Search(
            x=chosen(trial, x),
            at=jax.tree.map(chosen, new, at),
            stage=jnp.minimum(state.stage + done, last),
            tries=jnp.where(done, 0, tries),
            bend=jnp.where(done, 0.0, bend),
            reach=jnp.where(done | ~at.solved, _FIRST_REACH, reach),
            iterations=state.iterations + 1,
            running=~(done & final),
        )

    none, first = jnp.zeros((), jnp.int32), jnp.array(_FIRST_REACH)
    nothing = Evaluated(jnp.zeros(size), jnp.zeros((size, x.shape[0])), jnp.array(False), past)
    stage = jnp.where(at_once, last, 0).astype(jnp.int32)
    start = Search(x, nothing, stage, none, first, jnp.zeros(size), none, jnp.array(True))
    return jax.lax.while_loop(lambda state: state.running, one, start)


def bounded_minimum(
    H: Float[Array, "m m"], g: Float[Array, "m"], low: Float[Array, "m"], high: Float[Array, "m"]
) -> Float[Array, "m"]:
    """The minimum of 1/2 d.H d + g.d with low <= d <= high, for a positive definite H.

    By active sets (Nocedal & Wright, Numerical Optimization, 16.5): to the minimum with some
    components held at their bounds, or to the next bound on the way there, which is then held;
    where nothing moves any more, the one that pulls away from its bound most is let go.
    """
    m, eye = g.shape[0], jnp.eye(g.shape[0])
    index = jnp.arange(m)

    def one(state):
        d, held, _, i = state
        free = ~held[:, None] & ~held[None, :]
        slope = jnp.where(held, 0.0, H @ d + g)
        way = -jnp.linalg.solve(jnp.where(free, H, eye), slope)
        room = jnp.where(way > 0, high - d, low - d) / jnp.where(way == 0, 1.0, way)
        room = jnp.where(held | (way == 0), jnp.inf, room)
        k, part = jnp.argmin(room), jnp.clip(jnp.min(room), 0.0, 1.0)
        stopped = part < 1.0
        d = jnp.clip(d + part * way, low, high)
        d = jnp.where(stopped & (index == k), jnp.where(way > 0, high, low), d)
        # At the minimum of what is free: which bounds push the wrong way.
        slope = H @ d + g
        pull = jnp.where(held, jnp.where(d <= low, -slope, slope), 0.0)
        worst, wrong = jnp.argmax(pull), jnp.max(pull) > 1e-14 * jnp.max(jnp.abs(g))
        held = jnp.where(stopped, held | (index == k), held & ~(wrong & (index == worst)))
        return d, held, stopped | wrong, i + 1

    def goes_on(state):
        *_, changes, i = state
        return changes & (i < _MOST_CHANGES * m)

    start = jnp.clip(jnp.zeros_like(g), low, high)
    held = (start <= low) | (start >= high)
    return jax.lax.while_loop(goes_on, one, (start, held, jnp.array(True), 0))[0]
