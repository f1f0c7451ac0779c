"""Damped Newton's method with a natural monotonicity test and reuse of the Jacobian.

After Deuflhard, "Newton Methods for Nonlinear Problems" (2011), algorithm NLEQ-ERR: a step is
judged by the next correction, computed with the same factors. That measure does not depend on
how the equations are scaled, says directly how far the solution still is, and costs no new
Jacobian: while it falls fast, the same factors serve on.
"""

from typing import Any, Callable, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from softrod_jax.results import RESULTS


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
_REUSE = 0.1
# A correction this small that no longer falls is rounding error.
_ROUNDING = 1e-6


class NewtonResult(NamedTuple):
    """`factors`: the last that were made, at the solution or near it.

    `contraction`: the largest ratio of corrections; below 1/2 throughout and undamped means
    that the start was well inside the basin of this solution.
    """

    y: Array
    aux: Any
    factors: Any
    result: Int[Array, ""]
    iterations: Int[Array, ""]
    correction: Float[Array, ""]
    contraction: Float[Array, ""]


class _State(NamedTuple):
    y: Array
    aux: Any
    factors: Any
    step: Array
    size: Float[Array, ""]
    damping: Float[Array, ""]
    contraction: Float[Array, ""]
    result: Int[Array, ""]
    iterations: Int[Array, ""]
    running: Array


def newton(
    evaluate: Callable, factorise: Callable, solve: Callable, y, strain, scale, options
) -> NewtonResult:
    """Solve `evaluate(y, strain) = (F, aux, valid)` for F = 0 from `y`.

    - `evaluate(y, strain)`: equations F (a pytree), what comes along with them (with the field
      `strain`, the guess for the next evaluation), and whether they could be evaluated at all.
    - `factorise(y, aux)`: factors of the Jacobian there.
    - `solve(factors, F)`: the correction -J^-1 F, of y's shape.
    - `scale`: of y's shape or broadcast to it; corrections are measured by max |dy / scale|.
    """

    def size_of(step):
        size = jnp.max(jnp.abs(step) / scale)
        return jnp.where(jnp.isfinite(size), size, jnp.inf)

    def cond(state):
        return state.running & (state.iterations < options.max_iterations)

    def body(state):
        # The first pass has no correction yet: it evaluates the start and factorises there.
        first = state.iterations == 0
        y = state.y + state.damping * state.step
        F, aux, valid = evaluate(y, state.aux.strain)
        step = solve(state.factors, F)
        size = size_of(step)
        full = state.damping == 1.0
        falls = size <= (1 - state.damping / 4) * state.size
        small = size <= options.tolerance
        at_rounding = full & (state.size <= _ROUNDING) & (size <= 10 * _ROUNDING)
        accept = valid & (first | falls | small | at_rounding)
        converged = accept & ~first & full & (small | (at_rounding & ~falls))
        ratio = size / state.size

        factors, next_step = jax.lax.cond(
            first | (accept & ~converged & ~(full & (ratio < _REUSE))),
            lambda: renewed(y, aux, F),
            lambda: (state.factors, step),
        )
        next_size = size_of(next_step)
        damping = jnp.where(accept, jnp.minimum(1.0, 4 * state.damping), state.damping / 4)
        stuck = ~accept & (first | (damping < options.smallest_damping))
        failed = stuck | (accept & ~jnp.isfinite(next_size))
        reason = jnp.where(valid, RESULTS.diverged, RESULTS.no_equilibrium)
        result = jnp.where(failed, reason, RESULTS.max_iterations)
        pick = lambda new, old: jax.tree.map(lambda a, b: jnp.where(accept, a, b), new, old)
        judged = accept & ~first & (size > _ROUNDING)
        return _State(
            # A correction at rounding level is noise: it is not added.
            y=pick(jnp.where(converged & small, y + step, y), state.y),
            aux=pick(aux, state.aux),
            factors=pick(factors, state.factors),
            step=pick(next_step, state.step),
            size=pick(next_size, state.size),
            damping=damping,
            contraction=jnp.where(
                full, jnp.where(judged, jnp.maximum(state.contraction, ratio), state.contraction),
                jnp.inf,
            ),
            result=jnp.where(converged, RESULTS.successful, result).astype(jnp.int32),
            iterations=state.iterations + 1,
            running=~converged & ~failed,
        )

    def renewed(y, aux, F):
        factors = factorise(y, aux)
        return factors, solve(factors, F)

    # One copy of the equations in the compiled program: their shapes come from abstract values.
    like = lambda f, *args: jax.tree.map(
        lambda x: jnp.zeros(x.shape, x.dtype), jax.eval_shape(f, *args)
    )
    _, aux, _ = like(evaluate, y, strain)
    aux = aux._replace(strain=strain)
    start = _State(
        y=y,
        aux=aux,
        factors=like(factorise, y, aux),
        step=jnp.zeros_like(y),
        size=jnp.array(jnp.inf),
        damping=jnp.ones(()),
        contraction=jnp.zeros(()),
        result=jnp.array(RESULTS.max_iterations, jnp.int32),
        iterations=jnp.zeros((), jnp.int32),
        running=jnp.array(True),
    )
    end = jax.lax.while_loop(cond, body, start)
    return NewtonResult(
        end.y, end.aux, end.factors, end.result, end.iterations, end.size, end.contraction
    )
