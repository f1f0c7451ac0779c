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

from softrod_jax.bvp.block_sweep import factorise, has_no_conjugate_point, solve_sweeps
from softrod_jax.bvp.method import AbstractMethod, Guess
from softrod_jax.bvp.newton import NewtonOptions, ReusedFactors, newton
from softrod_jax.foundation.results import RESULTS
from softrod_jax.rod.boundary_conditions import tip_condition
from softrod_jax.rod.constants import Rod
from softrod_jax.rod.constitutive import shortest_path
from softrod_jax.rod.ode import History, Layout, sizes
from softrod_jax.scene.planes import vector_in

# Where a solve fails with less than this left of the rod's length anywhere, or of a tendon's path,
# that is why.
_VANISHING = 0.02


def loads_of(rod: Rod) -> list:
    """Those that there are of tensions, pressures, gravity and tip loads."""
    every = [rod.tau, rod.n_ch, rod.m_ch, rod.gravity, rod.weight, rod.F_tip, rod.M_tip]
    every.append(rod.load_factor)
    if rod.at_gaps is not None:
        every += [x for load in rod.at_gaps for x in (load.F, load.M)]
    return [x for x in every if x is not None]


def with_loads(rod: Rod, loads: list) -> Rod:
    """The rod under other loads, as `loads_of` has them."""
    return eqx.tree_at(loads_of, rod, loads)


def scaled_loads(rod: Rod, factor) -> Rod:
    """The rod with all its loads times `factor`."""
    return with_loads(rod, [factor * x for x in loads_of(rod)])


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


class Equations(NamedTuple):
    """The equations of one problem, their Jacobian's factors and the correction.

    `guess`: strains (points, 6) for pointwise solves, where the method has any.
    """

    method: AbstractMethod
    layout: Layout
    rod: Rod
    history: History | None
    guess: Float[Array, "points strain"]

    @property
    def _problem(self):
        return self.rod, self.layout, self.history, self.guess

    def base(self):
        """(p, h, q, omega) at the clamp (paper eq. 13)."""
        p = vector_in(self.rod.plane, self.rod.p_base)
        h = self.rod.h_base if self.layout.attitude else None
        still = jnp.zeros(self.layout.pair) if self.layout.dynamic else None
        parts = [x for x in (p, h, still) if x is not None]
        return jnp.concatenate(parts) if parts else jnp.zeros(0)

    def start(self, guess: Guess):
        """The unknowns at a guess, with the state of the clamp at the base."""
        U = self.method.unknowns(guess, self.rod)
        return U.at[0, : self.layout.base_size].set(self.base())

    def residual(self, U):
        """What is zero at the solution: along the rod, and at the tip as db = S da + g there."""
        Y = self.method.states(U, self.layout)
        tip = self._tip(Y).value - Y[-1, self.layout.base_size :]
        return self.method.residual(U, *self._problem), tip

    def factorise(self, U, safe=None):
        """What `correct` needs."""
        linear = self.method.linearise(U, *self._problem)
        Y = self.method.states(U, self.layout)
        slope = self._tip(Y).by_base_part
        left, right = linear.left, linear.right
        if safe is not None:
            # A failed sample has no derivative: a solvable system with nothing in it.
            eye = jnp.eye(self.layout.size)
            left, right = jnp.where(safe, left, -eye), jnp.where(safe, right, eye)
            slope = jnp.where(safe, slope, 0.0)
        return factorise(left, right, slope), linear.inner

    def correct(self, factors, F):
        """The correction -J^-1 F of the unknowns."""
        (sweeps, inner), (residual, tip) = factors, F
        defect, condensed = self.method.condense(inner, residual)
        return self.method.expand(inner, condensed, solve_sweeps(sweeps, defect, tip))

    def scale(self, U):
        """Sizes of the unknowns, (columns,): a bent rod's, and those of the answer so far."""
        layout, n = self.layout, self.layout.size
        states = sizes(U[:, :n], self.rod, layout, self.history)
        if U.shape[-1] == n:
            return states
        stretch, bend = layout.split_strain(U[:, n:])
        curvature = 1 / self.rod.L + jnp.max(jnp.abs(bend))
        stretch = None if stretch is None else jnp.ones(layout.vector)
        return layout.join(states, stretch, curvature * jnp.ones(layout.turn))

    def fields(self, U) -> Guess:
        """The rod at all points."""
        return self.method.fields(U, *self._problem)

    def error(self, U, factors) -> Float[Array, ""]:
        """The estimated error of an equilibrium's tip from the grid, in lengths of the rod."""
        tip = jnp.zeros(self.layout.pair)
        correct = lambda residual: self.correct(factors, (residual, tip))
        return self.method.error(U, self.rod, self.layout, self.guess, correct)

    def _tip(self, Y):
        history = self.history
        if history is not None:
            history = History(history.c0, history.strain[-1], history.velocity[-1])
        return tip_condition(Y[-1], self.rod, self.layout, history)


def search_directly(
    equations: Equations, options: NewtonOptions, U, reused: ReusedFactors | None = None
):
    """Newton's method from `U`: the unknowns, how they were found, and the last factors."""
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
    )
    one, stable = jnp.ones((), jnp.int32), jnp.array(True)
    if not layout.dynamic:
        stable = has_no_conjugate_point(end.factors[0])
    found = Found(end.result, end.iterations, end.correction, end.contraction, one, stable)
    return end.y, found, end.factors


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
        U = jnp.where(ok, U, equations.start(jax.lax.stop_gradient(guess)))
    fields = equations.fields(U)
    failed = (result == RESULTS.diverged) | (result == RESULTS.max_iterations)
    gone = jnp.array(False)
    if rod.K_se is not None:
        left = _least_stretch(rod, layout, fields.strain)
        # Below nothing, the linear law of the material knows sections that have changed sides.
        gone = (failed & (left < _VANISHING)) | ~(left > 0.0)
    if rod.tau is not None:
        gone |= failed & (shortest_path(rod, fields.strain) < _VANISHING)
    result = jnp.where(gone, RESULTS.no_equilibrium, result)
    if not layout.dynamic:
        inaccurate = (result == RESULTS.successful) & ~(found.error <= method.max_error)
        result = jnp.where(inaccurate, RESULTS.inaccurate, result)
    result = result.astype(jnp.int32)
    return Solved(fields, found._replace(result=result), factors)


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
    rest = History(1.0, 0.0, 0.0)  # pyright: ignore[reportArgumentType]  # in the place of arrays
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
    at = jnp.where(ok, U, begin)

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
            return here.residual(at.at[0, : base.size].set(base)), base

        _, along = jax.linearize(by_inputs, dynamic)
        F_dot, base_dot = along(dot)
        here = equations(dynamic)
        # A failed sample has no derivative: zero keeps the rest of its batch clean.
        F_dot = jax.tree.map(lambda x: jnp.where(ok, x, 0.0), F_dot)
        factors = here.factorise(at, safe=ok)
        base_dot = jnp.where(ok, base_dot, 0.0)
        return _follow(here, at, factors, F_dot, base_dot), factors

    # In reverse mode a motion keeps the unknowns of each solve, and not their Jacobian's
    # factors, which are 20 times as much.
    U_dot, exact = jax.checkpoint(tangent, prevent_cse=False)(dynamic, at, dot)
    if settings["reuse_exact"]:
        factors = jax.lax.stop_gradient(exact)
        # 0, and in a batch one for each sample, as the contraction is.
        found = found._replace(contraction=jnp.minimum(found.contraction, 0.0))
    none = jax.tree.map(lambda x: None, (found, factors))
    return (U, found, factors), (jnp.where(ok, U_dot, 0.0), *none)


def _follow(equations: Equations, U, factors, F_dot, base_dot):
    """How the unknowns follow a change of the equations, and of the state of the clamp."""
    rhs, as_residual = ravel_pytree(F_dot)
    # The state of the clamp, the first entries of U, is given.
    a = equations.layout.base_size

    def linear(x):
        dU = jnp.concatenate([jnp.zeros(a), x]).reshape(U.shape)
        return ravel_pytree(jax.jvp(equations.residual, (U,), (dU,))[1])[0]

    def solve(factors, b):
        return equations.correct(factors, as_residual(-b)).ravel()[a:]

    def transposed(factors, b):
        return jax.linear_transpose(lambda x: solve(factors, x), b)(b)[0]

    # Several right-hand sides in lockstep take longer than in turn on a CPU.
    x = jax.lax.custom_linear_solve(
        linear,
        -rhs,
        solve=lambda _, b: _in_turn(solve)(factors, b),
        transpose_solve=lambda _, b: _in_turn(transposed)(factors, b),
    )
    return jnp.concatenate([base_dot, x]).reshape(U.shape)


def _in_turn(function: Callable) -> Callable:
    """`function` which, on a CPU, takes the samples of a batch one after the other."""
    on_cpu = jax.default_backend() == "cpu"
    return jax.custom_batching.sequential_vmap(function) if on_cpu else function
