"""Damped Newton's method with a natural monotonicity test and reuse of the Jacobian.

After Deuflhard, "Newton Methods for Nonlinear Problems" (2011), algorithm NLEQ-ERR: a step is
judged by the next correction, computed with the same factors. That measure does not depend on
how the equations are scaled, says directly how far the solution still is, and costs no new
Jacobian: while it falls fast, the same factors serve on, also from one problem to the next.
"""

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from softrod_jax.foundation.results import RESULTS


class NewtonOptions(eqx.Module):
    """When to stop. Corrections are relative to the scales given to `newton`.

    - `tolerance`: on the last correction; the error left is smaller still.
    - `max_iterations`: evaluations of the equations.
    - `smallest_damping`: below it the answer is `RESULTS.diverged`.
    """

    tolerance: float = eqx.field(static=True, default=1e-10)
    max_iterations: int = eqx.field(static=True, default=60)
    smallest_damping: float = eqx.field(static=True, default=1e-3)


# Keep the factors while each correction is at most this fraction of the one before.
_REUSE = 0.25
# With factors that are given, go on while each correction is at most this fraction of the one
# before; what no longer falls is rounding error where it is as small as that.
_SLOWEST, _STALLED = 0.7, 1e-8
# A correction this small that no longer falls is rounding error.
_ROUNDING = 1e-6


class NewtonResult(NamedTuple):
    """`factors`: the last that were made, at the solution or near it.

    `contraction`: the largest ratio of corrections; below 1/2 throughout and undamped means
    that the start was well inside the basin of this solution.
    """

    y: Any
    factors: Any
    result: Int[Array, ""]
    iterations: Int[Array, ""]
    correction: Float[Array, ""]
    contraction: Float[Array, ""]


class ReusedFactors(NamedTuple):
    """Factors of a Jacobian like the one wanted.

    `usable`: whether they may serve; `alike`: whether they are near enough to keep parts of them.
    Where they are neither, only their shape counts.
    """

    factors: Any
    usable: Bool[Array, ""]
    alike: Bool[Array, ""] | bool = False


class _State(NamedTuple):
    y: Any
    step: Any
    size: Float[Array, ""]
    damping: Float[Array, ""]
    contraction: Float[Array, ""]
    result: Int[Array, ""]
    iterations: Int[Array, ""]
    running: Bool[Array, ""]
    fresh: Bool[Array, ""]  # the factors are new: `step` and `size` are not known yet
    stale: Bool[Array, ""]  # the factors serve no longer
    reused: Bool[Array, ""]  # the factors are of another problem
    kept: Bool[Array, ""]  # parts of new ones may be


class _Problem(NamedTuple):
    """What one search by Newton's method is about; see `newton`."""

    evaluate: Callable
    factorise: Callable
    solve: Callable
    scale: Any
    options: NewtonOptions
    keeping: bool

    def goes_on(self, state: _State) -> Bool[Array, ""]:
        """Whether there is a correction to come."""
        return state.running & (state.iterations < self.options.max_iterations)

    def with_factors(self, state: _State, factors, given: bool):
        """Corrections with one set of factors, as long as these serve, and the factors.

        `given`: the factors are those of another problem where `state.reused`, else made here.
        """
        if given:
            # At most once, as a branch would; but in a batch only if any of its samples needs it.
            kept = lambda old: (ReusedFactors(old, state.kept, state.kept),) if self.keeping else ()
            _, factors = jax.lax.while_loop(
                lambda carry: carry[0],
                lambda carry: (jnp.array(False), self.factorise(state.y, *kept(carry[1]))),
                (~state.reused, factors),
            )
        else:
            factors = self.factorise(state.y)
        state = state._replace(
            step=jax.tree.map(jnp.zeros_like, state.step),
            fresh=jnp.array(True),
            stale=jnp.array(False),
        )
        state = jax.lax.while_loop(
            lambda s: self.goes_on(s) & ~s.stale, lambda s: self.one_pass(s, factors), state
        )
        return state._replace(reused=jnp.array(False)), factors

    def one_pass(self, state: _State, factors) -> _State:
        """One correction, with all that is judged by its size."""
        options = self.options
        y = _moved(state.y, state.step, state.damping)
        step = self.solve(factors, self.evaluate(y))
        size = size_of(step, self.scale)
        full = state.fresh | (state.damping == 1.0)
        foreign = (state.reused | state.kept) if self.keeping else state.reused
        falls = size <= (1 - state.damping / 4) * state.size
        ratio = size / state.size
        # What the corrections to come sum up to while each is this fraction of the last one.
        falling = full & ~state.fresh & (ratio < 0.5)
        left = jnp.where(falling, size * ratio / (1 - ratio), size)
        small = left <= options.tolerance
        at_rounding = full & (state.size <= _ROUNDING) & (size <= 10 * _ROUNDING)
        accept = jnp.isfinite(size) & (state.fresh | falls | small | at_rounding)
        converged = accept & full & (small | (at_rounding & ~falls & ~state.fresh))
        # Reused factors have to show that they serve, and if not it is no fault of the problem;
        # those with parts of others, too, but all that counts is there.
        converged &= ~state.reused | (~state.fresh & (ratio < _REUSE))
        converged &= ~foreign | ~state.fresh
        useless = foreign & ~accept
        damping = jnp.where(accept, jnp.minimum(1.0, 4 * state.damping), state.damping / 4)
        failed = ~accept & ~useless & (state.fresh | (damping < options.smallest_damping))
        result = jnp.where(failed, RESULTS.diverged, RESULTS.max_iterations)
        judged = accept & ~state.fresh & (size > _ROUNDING)
        worst = jnp.where(judged, jnp.maximum(state.contraction, ratio), state.contraction)
        pick = lambda new, old: jax.tree.map(lambda a, b: jnp.where(accept, a, b), new, old)
        return _State(
            # A correction at rounding level is noise: it is not added.
            y=pick(_moved(y, step, jnp.where(converged & small, 1.0, 0.0)), state.y),
            step=pick(step, state.step),
            size=pick(size, state.size),
            damping=jnp.where(state.fresh | useless, state.damping, damping),
            contraction=jnp.where(full, worst, jnp.inf),
            result=jnp.where(converged, RESULTS.successful, result).astype(jnp.int32),
            iterations=state.iterations + 1,
            running=~converged & ~failed,
            fresh=jnp.array(False),
            stale=useless | (accept & ~state.fresh & ~(full & (ratio < _REUSE))),
            reused=state.reused,
            # Where those with parts of others do not serve, the next ones are all new.
            kept=state.kept & (~useless | state.reused),
        )


def _moved(y, step, damping):
    return jax.tree.map(lambda a, b: a + damping * b, y, step)


def newton(
    evaluate: Callable,
    factorise: Callable,
    solve: Callable,
    y,
    scale,
    options: NewtonOptions,
    exact_factors: bool = False,
    reused: ReusedFactors | None = None,
    keep_factors: bool = True,
    keeping: bool = False,
) -> NewtonResult:
    """Solve `evaluate(y) = F = 0` from `y`.

    - `evaluate(y)`: the equations F, a pytree; not finite where they cannot be evaluated.
    - `factorise(y)`: factors of the Jacobian there.
    - `y`: an array, or a pytree of several.
    - `solve(factors, F)`: the correction -J^-1 F, like y.
    - `scale`: like y, or broadcast to it; corrections are measured by max |dy / scale|.
    - `exact_factors`: return the factors at the solution itself.
    - `reused`: factors to begin with; new ones are made as soon as these do not serve.
    - `keeping`: new ones are then `factorise(y, kept)`, which may keep parts of `kept`, the last
      ones, where these are alike.
    - `keep_factors`: without, none are returned, and the loops carry none: in a batch in lockstep
      whatever a loop carries is copied in each pass.
    """

    problem = _Problem(evaluate, factorise, solve, scale, options, keeping and reused is not None)
    start = _State(
        y=y,
        step=jax.tree.map(jnp.zeros_like, y),
        size=jnp.array(jnp.inf),
        damping=jnp.ones(()),
        contraction=jnp.zeros(()),
        result=jnp.array(RESULTS.max_iterations, jnp.int32),
        iterations=jnp.zeros((), jnp.int32),
        running=jnp.array(True),
        fresh=jnp.array(True),
        stale=jnp.array(False),
        reused=jnp.array(False) if reused is None else reused.usable,
        kept=jnp.asarray(reused is not None and reused.alike),
    )
    if not keep_factors:
        factors = None
    else:
        factors = no_factors(factorise, y) if reused is None else reused.factors

    def unfinished(carry):
        state, _, last = carry
        return problem.goes_on(state) | ~last if exact_factors else problem.goes_on(state)

    # Two nested loops and no branch but one: in a batch, a branch costs every pass a Jacobian.
    def go_on(carry):
        state, factors, _ = carry
        last = ~problem.goes_on(state)
        state, factors = problem.with_factors(state, factors, given=reused is not None)
        return state, factors if keep_factors else None, last

    end, factors, _ = jax.lax.while_loop(unfinished, go_on, (start, factors, jnp.array(False)))
    return NewtonResult(end.y, factors, end.result, end.iterations, end.size, end.contraction)


class _Chord(NamedTuple):
    y: Any
    size: Float[Array, ""]
    contraction: Float[Array, ""]
    iterations: Int[Array, ""]
    running: Bool[Array, ""]
    converged: Bool[Array, ""]


def newton_with(
    factors, evaluate: Callable, solve: Callable, y, scale, options: NewtonOptions
) -> NewtonResult:
    """Newton's method with these factors only, for as long as corrections fall.

    They are of a Jacobian like this problem's: where two corrections are small, so is the error.
    The code is `RESULTS.diverged` if they no longer do: that is no fault of the problem, and `y` is
    then of no use. In a batch in lockstep a pass reads the factors, and copies nothing but `y`.
    """

    def one_pass(state):
        step = solve(factors, evaluate(state.y))
        size = size_of(step, scale)
        first, ratio = state.iterations == 0, size / state.size
        falls = ~first & (ratio <= _SLOWEST)
        left = jnp.where(falls & (ratio < 0.5), size * ratio / (1 - ratio), size)
        # One small correction alone does not show that the factors serve.
        small = (left <= options.tolerance) & (falls | (~first & (size <= state.size)))
        at_rounding = ~first & (state.size <= _STALLED) & (size <= 10 * _STALLED) & ~falls
        converged = small | at_rounding
        goes_on = ~converged & jnp.isfinite(size) & (first | falls)
        judged = ~first & (size > _ROUNDING)
        return _Chord(
            y=jax.tree.map(lambda a, b: a + jnp.where(goes_on | small, b, 0.0), state.y, step),
            size=size,
            contraction=jnp.where(judged, jnp.maximum(state.contraction, ratio), state.contraction),
            iterations=state.iterations + 1,
            running=goes_on & (state.iterations + 1 < options.max_iterations),
            converged=converged,
        )

    none = jnp.zeros(())
    start = _Chord(
        y, jnp.array(jnp.inf), none, jnp.zeros((), jnp.int32), jnp.array(True), jnp.array(False)
    )
    end = jax.lax.while_loop(lambda state: state.running, one_pass, start)
    result = jnp.where(end.converged, RESULTS.successful, RESULTS.diverged).astype(jnp.int32)
    return NewtonResult(end.y, None, result, end.iterations, end.size, end.contraction)


def size_of(step, scale) -> Float[Array, ""]:
    """Of a correction, in scales: infinite if it has no numbers."""
    sizes = jax.tree.map(lambda dy, s: jnp.max(jnp.abs(dy) / s), step, scale)
    size = functools.reduce(jnp.maximum, jax.tree.leaves(sizes))
    return jnp.where(jnp.isfinite(size), size, jnp.inf)


def no_factors(factorise: Callable, y):
    """Zeros of the shape of `factorise(y)`."""
    return jax.tree.map(lambda x: jnp.zeros(x.shape, x.dtype), jax.eval_shape(factorise, y))
