"""The boundary value problem along the rod: base pose given, tip wrench given.

`solve_boundary_value` is Newton's method on a method's defects and the tip condition. Its
derivative, forward and reverse, comes from the implicit function theorem: one more linear solve
with the Jacobian at the solution, never a differentiated iteration.
"""

from typing import Callable, NamedTuple, Optional

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from softrod_jax.block_sweep import factorise, has_no_conjugate_point, solve_sweeps
from softrod_jax.method import Defects, Method
from softrod_jax.newton import NewtonOptions, newton
from softrod_jax.results import RESULTS
from softrod_jax.rod import Rod
from softrod_jax.rod_ode import History, Layout, tip_condition


class Guess(NamedTuple):
    """Where Newton starts: states and strains at the points of the method."""

    y: Float[Array, "points n"]
    strain: Float[Array, "points 6"]


class Found(NamedTuple):
    """How a search for the solution ended.

    - `correction`: Newton's last, relative to the scales of the problem.
    - `contraction`: the largest ratio of corrections; see `newton.py`.
    - `load_steps`: how many the search took; 1 where it went straight for the answer.
    - `stable`: in statics, whether the equilibrium is stable; see `block_sweep.py`.
    - `error`: the method's estimate of its own error (`Defects.error`); NaN if it has none.
    """

    result: Int[Array, ""]
    iterations: Int[Array, ""]
    correction: Float[Array, ""]
    contraction: Float[Array, ""]
    load_steps: Int[Array, ""]
    stable: Bool[Array, ""]
    error: Float[Array, ""]


class Solved(NamedTuple):
    """States `Y` at the nodes, `y` and `strain` at all points, and how they were found."""

    Y: Float[Array, "nodes n"]
    y: Float[Array, "points n"]
    strain: Float[Array, "points 6"]
    found: Found


def search_directly(method, layout, options, rod, history, guess: Guess) -> Solved:
    """Newton's method from `guess`."""
    equations = _Equations(method, layout, rod, history)
    Y = equations.with_base(method.nodes(guess.y))
    at = jax.tree.map(
        lambda x: jnp.zeros(x.shape, x.dtype),
        jax.eval_shape(equations.evaluate, Y, guess.strain)[1],
    )
    end = newton(
        equations.evaluate,
        equations.factorise,
        equations.solve,
        Y,
        at._replace(y=guess.y, strain=guess.strain),
        equations.scale(Y),
        options,
        exact_factors=not layout.dynamic,
    )
    one = jnp.ones((), jnp.int32)
    stable = jnp.array(True) if layout.dynamic else has_no_conjugate_point(end.factors[0])
    error = jnp.array(jnp.nan) if end.aux.error is None else end.aux.error
    found = Found(
        end.result, end.iterations, end.correction, end.contraction, one, stable, error
    )
    return Solved(end.y, end.aux.y, end.aux.strain, found)


def solve_boundary_value(
    method: Method,
    layout: Layout,
    options: NewtonOptions,
    rod: Rod,
    history: Optional[History],
    guess: Guess,
    search: Callable[..., Solved] = search_directly,
) -> Solved:
    """Solve along the rod. Differentiable in `rod` and `history`.

    A sample that fails keeps its last iterate, and its derivative is zero.
    """
    solved = _solve(
        (rod, history), guess, method=method, layout=layout, options=options, search=search
    )
    # Where there is no estimate, NaN is not above the limit.
    inaccurate = (solved.found.result == RESULTS.successful) & (
        solved.found.error > method.max_error
    )
    result = jnp.where(inaccurate, RESULTS.inaccurate, solved.found.result).astype(jnp.int32)
    return solved._replace(found=solved.found._replace(result=result))


@eqx.filter_custom_jvp
def _solve(inputs, guess, *, method, layout, options, search) -> Solved:
    return search(method, layout, options, *inputs, guess)


@_solve.def_jvp
def _solve_jvp(primals, tangents, *, method, layout, options, search):
    inputs, guess = primals
    solved = _solve(
        inputs, guess, method=method, layout=layout, options=options, search=search
    )
    ok = solved.found.result == RESULTS.successful
    dynamic, static = eqx.partition(inputs, eqx.is_inexact_array)
    dot = jax.tree.map(
        lambda t, x: jnp.zeros_like(x) if t is None and x is not None else t,
        tangents[0],
        dynamic,
        is_leaf=lambda t: t is None,
    )

    # A failed sample is linearised at rest and slowly: where its iterates are, derivatives may
    # overflow, and 0 * inf is NaN in the reverse pass.
    unless_failed = lambda x, instead: jnp.where(ok, x, instead)
    strain = unless_failed(solved.strain, guess.strain)

    def equations_at(dynamic, Y):
        rod, history = eqx.combine(dynamic, static)
        if history is not None:
            history = jax.tree.map(unless_failed, history, History(1.0, 0.0, 0.0))
        equations = _Equations(method, layout, rod, history)
        # The base pose may depend on the inputs, too.
        Y = equations.with_base(unless_failed(Y, method.nodes(guess.y)))
        F, at, _ = equations.evaluate(Y, strain)
        return F, (at.y, at.strain), equations.base()

    _, along = jax.linearize(equations_at, dynamic, solved.Y)
    F_dot, _, base_dot = along(dot, jnp.zeros_like(solved.Y))
    equations = _Equations(method, layout, *inputs)
    at = Defects(None, solved.y, solved.strain, None)
    factors = equations.factorise(solved.Y, at, safe=ok)
    # A failed sample has no derivative: zero keeps the rest of its batch clean.
    cut = lambda tree: jax.tree.map(lambda x: jnp.where(ok, x, 0.0), tree)
    Y_dot = equations.solve(factors, cut(F_dot))
    Y_dot = Y_dot.at[0, : layout.base_size].add(cut(base_dot))
    _, (y_dot, strain_dot), _ = along(dot, Y_dot)
    none = jax.tree.map(lambda x: None, solved.found)
    return solved, Solved(Y_dot, cut(y_dot), cut(strain_dot), none)


class _Equations(NamedTuple):
    """The equations, their Jacobian's factors and the correction, as Newton asks for them."""

    method: Method
    layout: Layout
    rod: Rod
    history: Optional[History]

    def base(self):
        """(h, q, omega) at the clamp (paper eq. 13)."""
        h = self.rod.h_base if self.layout.attitude else None
        q = w = jnp.zeros(3) if self.layout.dynamic else None
        parts = [x for x in (h, q, w) if x is not None]
        return jnp.concatenate(parts) if parts else jnp.zeros(0)

    def with_base(self, Y):
        return Y.at[0, : self.layout.base_size].set(self.base())

    def evaluate(self, Y, strain_guess):
        at = self.method.defects(Y, self.rod, self.layout, self.history, strain_guess)
        # The residual at the tip, in the sense db = S da + g of the sweep.
        tip = self._tip(Y)
        return (at.defect, tip.wrench - Y[-1, -6:]), at, at.solvable

    def factorise(self, Y, at: Defects, safe=None):
        left, right = self.method.blocks(at, self.rod, self.layout, self.history)
        slope = self._tip(Y).by_base_part
        units = self.scale(Y)
        a = self.layout.base_size
        left, right = (B * units / units[:, None] for B in (left, right))
        slope = slope * units[:a] / units[a:, None]
        if safe is not None:
            # A failed sample has no derivative: a solvable system with nothing in it.
            eye = jnp.eye(self.layout.size)
            left, right = jnp.where(safe, left, -eye), jnp.where(safe, right, eye)
            slope = jnp.where(safe, slope, 0.0)
        return factorise(left, right, slope), units

    def solve(self, factors, F):
        (factors, units), (defect, tip) = factors, F
        return solve_sweeps(factors, defect / units, tip / units[-6:]) * units

    def scale(self, Y):
        """Sizes of the state's components: a bent rod's, and those of the answer so far."""
        rod, c0 = self.rod, None if self.history is None else self.history.c0
        EI = jnp.max(rod.K_bt[:2])
        if c0 is not None and rod.B_bt is not None:
            EI = EI + c0 * jnp.max(rod.B_bt[:2])
        one = jnp.ones(3)
        N, M = jnp.max(jnp.abs(Y[:, -6:-3])), jnp.max(jnp.abs(Y[:, -3:]))
        return self.layout.join(
            jnp.ones(4) if self.layout.attitude else None,
            c0 * rod.L * one if self.layout.dynamic else None,
            c0 * one if self.layout.dynamic else None,
            (EI / rod.L**2 + N) * one,
            (EI / rod.L + M) * one,
        )

    def _tip(self, Y):
        history = self.history
        if history is not None:
            history = History(history.c0, history.strain[-1], history.velocity[-1])
        return tip_condition(Y[-1], self.rod, self.layout, history)

