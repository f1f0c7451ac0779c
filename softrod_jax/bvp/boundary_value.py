"""The boundary value problem along the rod: base pose given, tip wrench given.

`solve_boundary_value` is Newton's method on a method's equations and the tip condition. Its
derivative, forward and reverse, comes from the implicit function theorem: one more linear solve
with the Jacobian at the solution, never a differentiated iteration.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Bool, Float, Int

from softrod_jax.bvp.equations import Equations, Residual, Unknowns
from softrod_jax.bvp.method import AbstractMethod, Guess
from softrod_jax.bvp.newton import NewtonOptions, NewtonResult, ReusedFactors, newton, size_of
from softrod_jax.foundation.compiling import on_cpu
from softrod_jax.foundation.results import RESULTS
from softrod_jax.rod.constants import Rod
from softrod_jax.rod.constitutive import least_fibre_stretch, shortest_path
from softrod_jax.rod.state import History, Layout

# Where a solve fails with less than this left of the rod's length anywhere, or of a tendon's path
# or a fibre, that is why.
_VANISHING = 0.02
# A correction this small, in scales, leaves its square.
_CLOSE = 1e-6


class Found(NamedTuple):
    """How a search for the solution ended.

    - `correction`: Newton's last, relative to the scales of the problem.
    - `contraction`: the largest ratio of corrections; see `newton.py`.
    - `load_steps`: how many the search took; 1 where it went straight for the answer.
    - `stable`: in statics, whether the equilibrium is stable; see `block_sweep.py`.
    - `error`: in statics, of the tip from the grid, estimated, in lengths of the rod.
    """

    result: Int[Array, ""]
    iterations: Int[Array, ""]
    correction: Float[Array, ""]
    contraction: Float[Array, ""]
    load_steps: Int[Array, ""]
    stable: Bool[Array, ""]
    error: Float[Array, ""] | None = None


class Solved(NamedTuple):
    """States and strains at all points, how they were found, and the last factors in a motion."""

    fields: Guess
    found: Found
    factors: Any


def search_directly(
    equations: Equations,
    options: NewtonOptions,
    U: Unknowns,
    reused: ReusedFactors | None = None,
    *,
    keep_factors: bool = True,
):
    """Newton's method from `U`: the unknowns, how they were found, and the last factors.

    `keep_factors`: without, `None` is returned in their place.
    """
    layout = equations.layout
    end = newton(
        equations.residual,
        equations.factorise,
        equations.correct,
        U,
        equations.scale(U),
        options,
        exact_factors=not layout.dynamic,
        reused=reused,
        keep_factors=keep_factors,
        keeping=U.multipliers is not None,
    )
    one, stable = jnp.ones((), jnp.int32), jnp.array(True)
    if not layout.dynamic:
        end = _once_more(equations, end)
        stable = equations.is_stable(end.y, end.factors)
    found = Found(end.result, end.iterations, end.correction, end.contraction, one, stable)
    return end.y, found, end.factors


def _once_more(equations: Equations, end: NewtonResult) -> NewtonResult:
    """An equilibrium with one more correction by the factors at it, which are there anyway.

    Multipliers may be small beside the forces of a bent rod, by which Newton's tolerance goes.
    """
    if end.y.multipliers is None:
        return end
    step = equations.correct(end.factors, equations.residual(end.y))
    good = size_of(step, equations.scale(end.y)) <= _CLOSE
    good &= end.result == RESULTS.successful
    moved = jax.tree.map(lambda y, dy: y + jnp.where(good, dy, 0.0), end.y, step)
    return end._replace(y=moved)


def solve_boundary_value(
    method: AbstractMethod,
    layout: Layout,
    options: NewtonOptions,
    rod: Rod,
    history: History | None,
    guess: Guess,
    search: Callable = search_directly,
    before: Any = None,
    reuse_exact: bool = False,
) -> Solved:
    """Solve along the rod. Differentiable in `rod` and `history`.

    `search(equations, options, U, before)` finds the unknowns from their guess `U`, and returns
    what `search_directly` does; `before` is whatever else it needs.

    `reuse_exact`: where a derivative is taken, hand on the factors at the solution, which it needs.
    The next solve then makes none, but in reverse mode they are made twice.

    A sample that fails has the derivative zero. In statics it keeps its last iterate, in a
    motion it falls back to `guess`.
    """
    U, found, factors = _solve(
        (rod, history),
        (guess, before),
        method=method,
        layout=layout,
        options=options,
        search=search,
        reuse_exact=reuse_exact,
    )
    result, strain = found.result, jax.lax.stop_gradient(guess.strain)
    equations = Equations(method, layout, rod, history, strain)
    if history is not None:
        ok = result == RESULTS.successful
        equations = equations._replace(history=slow_unless(ok, history))
        U = chosen(ok, U, equations.start(jax.lax.stop_gradient(guess)))
    fields, rod = equations.fields(U), rod.under(U.multipliers)
    failed = (result == RESULTS.diverged) | (result == RESULTS.max_iterations)
    gone = jnp.array(False)
    if rod.K_se is not None:
        left = _least_stretch(rod, layout, fields.strain)
        # Below nothing, the linear law of the material knows sections that have changed sides.
        gone = (failed & (left < _VANISHING)) | ~(left > 0.0)
    fibres = least_fibre_stretch(rod, fields.strain)
    if fibres is not None:
        gone |= failed & ~(jnp.min(fibres) > _VANISHING)
    if rod.tau is not None:
        gone |= failed & (shortest_path(rod, fields.strain) < _VANISHING)
    result = jnp.where(gone, RESULTS.no_equilibrium, result)
    if not layout.dynamic:
        inaccurate = (result == RESULTS.successful) & ~(found.error <= method.max_error)
        result = jnp.where(inaccurate, RESULTS.inaccurate, result)
    result = result.astype(jnp.int32)
    return Solved(fields, found._replace(result=result), factors)


def chosen(condition, if_true, if_false):
    """One of two pytrees."""
    return jax.tree.map(lambda a, b: jnp.where(condition, a, b), if_true, if_false)


def _least_stretch(rod: Rod, layout: Layout, strain: Float[Array, "points strain"]):
    """The least stretch v3 along the rod; in a motion, of means between nodes.

    There, without damping, a front lets strains ring from point to point about what they are.
    """
    stretch = layout.split_strain(strain)[0][:, -1]
    if not layout.dynamic:
        return jnp.min(stretch)
    middle = 0.5 * (stretch[1:] + stretch[:-1])
    return jnp.min(jnp.mean(middle.reshape(-1, rod.grid.stride), axis=1))


def slow_unless(ok, history: History) -> History:
    """The history, or that of a rod almost at rest.

    Where a sample has failed, derivatives may overflow, and 0 * inf is NaN in the reverse pass.
    """
    none = None if history.crept is None else 0.0
    # In the place of arrays.
    rest = History(1.0, 0.0, 0.0, none)  # pyright: ignore[reportArgumentType]
    return jax.tree.map(lambda x, slow: jnp.where(ok, x, slow), history, rest)


@eqx.filter_custom_jvp
def _solve(inputs, start, *, method, layout, options, search, reuse_exact):
    def one(arrays):
        (rod, history), (guess, before) = eqx.combine(arrays, static)
        equations = Equations(method, layout, rod, history, guess.strain)
        U, found, factors = search(equations, options, equations.start(guess), before)
        if not layout.dynamic:
            found, factors = found._replace(error=equations.error(U, factors)), None
        return U, found, factors

    arrays, static = eqx.partition((inputs, start), eqx.is_array)
    # In lockstep a batch iterates as often as its worst sample, and its factors outgrow the
    # cache: on a CPU, one sample after the other takes a third of the time.
    return _in_turn(one)(arrays)


@_solve.def_jvp
def _solve_jvp(primals, tangents, **settings):
    inputs, (guess, _) = primals
    rod, history = inputs
    U, found, factors = _solve(*primals, **settings)
    method, layout = settings["method"], settings["layout"]
    ok = found.result == RESULTS.successful
    # By what does not change there is no derivative, and no code for one.
    dot, absent = tangents[0], lambda t: t is None
    dynamic = jax.tree.map(lambda t, x: None if t is None else x, dot, inputs, is_leaf=absent)
    static = jax.tree.map(lambda t, x: x if t is None else None, dot, inputs, is_leaf=absent)
    begin = Equations(method, layout, rod, history, guess.strain).start(guess)
    at = chosen(ok, U, begin)
    tight = None if U.multipliers is None else ok & (U.multipliers > 0)

    def tangent(dynamic, at, dot):
        def equations(dynamic):
            rod, history = eqx.combine(dynamic, static)
            if history is not None:
                history = slow_unless(ok, history)
            return Equations(method, layout, rod, history, guess.strain)

        def by_inputs(dynamic):
            # The pose of the clamp may depend on the inputs, too.
            here = equations(dynamic)
            base = here.base()
            clamped = at._replace(along=at.along.at[0, : base.size].set(base))
            return here.equalities(clamped, tight), base

        _, along = jax.linearize(by_inputs, dynamic)
        F_dot, base_dot = along(dot)
        here = equations(dynamic)
        # A failed sample has no derivative: zero keeps the rest of its batch clean.
        F_dot = jax.tree.map(lambda x: jnp.where(ok, x, 0.0), F_dot)
        factors = here.factorise(at, safe=ok)
        base_dot = jnp.where(ok, base_dot, 0.0)
        return _follow(here, at, factors, F_dot, base_dot, tight), factors

    # In reverse mode a motion keeps the unknowns of each solve, and not their Jacobian's
    # factors, which are 20 times as much.
    U_dot, exact = jax.checkpoint(tangent, prevent_cse=False)(dynamic, at, dot)
    if settings["reuse_exact"]:
        factors = jax.lax.stop_gradient(exact)
        # 0, and in a batch one for each sample, as the contraction is.
        found = found._replace(contraction=jnp.minimum(found.contraction, 0.0))
    none = jax.tree.map(lambda x: None, (found, factors))
    U_dot = jax.tree.map(lambda x: jnp.where(ok, x, 0.0), U_dot)
    return (U, found, factors), (U_dot, *none)


def _follow(equations: Equations, U: Unknowns, factors, F_dot: Residual, base_dot, tight):
    """How the unknowns follow a change of the equations, and of the state of the clamp.

    `tight`: which conditions of a constraint stay without a gap; where one is about to become so,
    or to open, the derivative is that of the side on which it has no multiplier.
    """
    rhs, as_residual = ravel_pytree(F_dot)
    _, as_unknowns = ravel_pytree(U)
    # The state of the clamp, the first entries of U, is given.
    a = equations.layout.base_size

    def linear(x):
        dU = as_unknowns(jnp.concatenate([jnp.zeros(a), x]))
        return ravel_pytree(jax.jvp(lambda U: equations.equalities(U, tight), (U,), (dU,))[1])[0]

    def solve(known, b):
        factors, tight = known
        correction = equations.correct_equalities(factors, as_residual(-b), tight)
        return ravel_pytree(correction)[0][a:]

    def transposed(known, b):
        return jax.linear_transpose(lambda x: solve(known, x), b)(b)[0]

    # Several right-hand sides in lockstep take longer than in turn on a CPU.
    x = jax.lax.custom_linear_solve(
        linear,
        -rhs,
        solve=lambda _, b: _in_turn(solve)((factors, tight), b),
        transpose_solve=lambda _, b: _in_turn(transposed)((factors, tight), b),
    )
    return as_unknowns(jnp.concatenate([base_dot, x]))


def _in_turn(function: Callable) -> Callable:
    """`function` which, on a CPU, takes the samples of a batch one after the other."""
    return jax.custom_batching.sequential_vmap(function) if on_cpu() else function
