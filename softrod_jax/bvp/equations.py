"""The equations of one problem along the rod, their Jacobian's factors and the correction.

A rod with a constraint has more unknowns than those along it, the multipliers, and as many more
conditions. The Jacobian is then that of the rod with a border,

    [ A  B ] [dU]     [F]         U: unknowns along the rod, x: multipliers >= 0,
    [ C  D ] [dx] = - [g]         g: gaps >= 0, each zero where its multiplier is not.

The sweeps that solve with A give A^-1 B, one right-hand side for each multiplier, and so the gaps
as a function of the multipliers alone, to first order: g + C dU with dU = -A^-1 (F + B dx). Which
multipliers are zero is decided there, in a small linear complementarity problem (the method of
Josephy and Newton), and not by trial in Newton's iterations: tendons go slack and taut without a
change of the factors.
"""

import dataclasses
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from softrod_jax.bvp.block_sweep import count_conjugate_points, factorise, solve_sweeps
from softrod_jax.bvp.complementarity import Conditions, conditions
from softrod_jax.bvp.grid_error import wide_weights
from softrod_jax.bvp.method import AbstractMethod, Guess
from softrod_jax.bvp.newton import ReusedFactors
from softrod_jax.foundation.compiling import on_cpu
from softrod_jax.rod.boundary_conditions import tip_condition
from softrod_jax.rod.constants import Rod
from softrod_jax.rod.state import History, Layout, sizes
from softrod_jax.scene.planes import vector_in

# A gap counts as nearly closed where this part of the largest multiplier would close it.
_NEARLY = 0.3
# Eigenvalues are zero if they are this part of the largest one, or less.
_ZERO = 1e-9


def loads_of(rod: Rod) -> list:
    """Those that there are of tensions, pressures, gravity and tip loads."""
    every = [rod.tau, rod.n_ch, rod.m_ch, rod.gravity, rod.weight, rod.F_tip, rod.M_tip]
    every.append(rod.load_factor)
    if rod.constraint is not None:
        every += rod.constraint.loads
    if rod.at_gaps is not None:
        every += [x for load in rod.at_gaps for x in (load.F, load.M)]
    return [x for x in every if x is not None]


def with_loads(rod: Rod, loads: list) -> Rod:
    """The rod under other loads, as `loads_of` has them."""
    return eqx.tree_at(loads_of, rod, loads)


def scaled_loads(rod: Rod, factor) -> Rod:
    """The rod with all its loads times `factor`."""
    return with_loads(rod, [factor * x for x in loads_of(rod)])


class Unknowns(NamedTuple):
    """Those along the rod, as its method has them, and multipliers where the rod has any."""

    along: Float[Array, "rows columns"]
    multipliers: Float[Array, "conditions"] | None = None


class Residual(NamedTuple):
    """What is zero at the solution, along the rod and at the tip; gaps beside multipliers."""

    along: Any
    tip: Float[Array, "pair"]
    gaps: Float[Array, "conditions"] | None = None
    multipliers: Float[Array, "conditions"] | None = None


class Border(NamedTuple):
    """How unknowns and gaps follow the multipliers, and gaps the unknowns.

    `along`: -A^-1 B; `gaps_by_along`: C, for the last columns of the unknowns, as many as it has;
    `conditions`: with S = D - C A^-1 B; `exact`: where `along` is that of these factors, and not
    of others before them.
    """

    along: Float[Array, "conditions rows columns"]
    gaps_by_along: Float[Array, "conditions rows last"]
    conditions: Conditions
    exact: Bool[Array, "conditions"]

    def following(self, x: Float[Array, "conditions"]):
        """How the unknowns along the rod follow the multipliers."""
        return (x @ _rows(self.along)).reshape(self.along.shape[1:])

    def gaps_following(self, along: Float[Array, "rows columns"]):
        """How the gaps follow the unknowns along the rod."""
        last = along[:, -self.gaps_by_along.shape[-1] :]
        return _rows(self.gaps_by_along) @ last.ravel()


class Factors(NamedTuple):
    """Of the sweeps, of what a method eliminates in its intervals, and of the border."""

    sweeps: Any
    inner: Any
    border: Border | None


class Equations(NamedTuple):
    """The equations of one problem.

    `guess`: strains (points, 6) for pointwise solves, where the method has any.
    """

    method: AbstractMethod
    layout: Layout
    rod: Rod
    history: History | None
    guess: Float[Array, "points strain"]

    def _problem(self, U: Unknowns):
        return self.rod.under(U.multipliers), self.layout, self.history, self.guess

    def base(self):
        """(p, h, q, omega) at the clamp (paper eq. 13), and losses of tendons, none there."""
        p = vector_in(self.rod.plane, self.rod.p_base)
        h = self.rod.h_base if self.layout.attitude else None
        moving = None
        if self.layout.dynamic:
            still = self.rod.base_velocity is None
            moving = jnp.zeros(self.layout.pair) if still else self.rod.base_velocity
        lossless = jnp.zeros(self.layout.rubbing) if self.layout.rubbing else None
        parts = [x for x in (p, h, moving, lossless) if x is not None]
        return jnp.concatenate(parts) if parts else jnp.zeros(0)

    def start(self, guess: Guess) -> Unknowns:
        """The unknowns at a guess, with the state of the clamp at the base."""
        along = self.method.unknowns(guess, self.rod)
        multipliers = guess.multipliers
        return Unknowns(
            along.at[0, : self.layout.base_size].set(self.base()),
            # A guess that is extrapolated may be below what can be.
            None if multipliers is None else jnp.maximum(multipliers, 0.0),
        )

    def residual(self, U: Unknowns) -> Residual:
        """Along the rod, and at the tip as db = S da + g there."""
        Y = self.method.states(U.along, self.layout)
        tip = self._tip(Y).value - Y[-1, self.layout.base_size :]
        gaps = None if U.multipliers is None else self.gaps(U)
        return Residual(self.method.residual(U.along, *self._problem(U)), tip, gaps, U.multipliers)

    def gaps(self, U: Unknowns) -> Float[Array, "conditions"]:
        """Those of the constraint."""
        constraint = self.rod.constraint
        assert constraint is not None and U.multipliers is not None, "a rod with a constraint"
        strain, weights = self.fields(U).strain, self.rod.grid.weights
        return constraint.gaps(self.rod, strain, U.multipliers, weights)

    def factorise(
        self,
        U: Unknowns,
        kept: ReusedFactors | None = None,
        *,
        safe: Bool[Array, ""] | None = None,
        single: bool = False,
    ) -> Factors:
        """What `correct` needs.

        `kept`: factors of which it may keep what hardly counts, where they are alike; `safe`:
        whether the unknowns can be used; `single`: in float32.
        """
        linear = self.method.linearise(U.along, *self._problem(U), single)
        Y = self.method.states(U.along, self.layout)
        slope = self._tip(Y).by_base_part
        if single:
            slope = slope.astype(jnp.float32)
        left, right = linear.left, linear.right
        if safe is not None:
            # A failed sample has no derivative: a solvable system with nothing in it.
            eye = jnp.eye(self.layout.size)
            left, right = jnp.where(safe, left, -eye), jnp.where(safe, right, eye)
            slope = jnp.where(safe, slope, 0.0)
        factors = Factors(factorise(left, right, slope), linear.inner, None)
        if U.multipliers is None:
            return factors
        return factors._replace(border=self._border(U, factors, kept, safe))

    def _border(self, U: Unknowns, factors: Factors, kept, safe) -> Border:
        """Of the multipliers `U.multipliers`, once the rod's own factors are there.

        How the rod follows a multiplier only counts where it is not zero, or does not stay so. To
        see that it does, what is `kept` is good enough; where it does not, there is no correction.
        """
        x = U.multipliers
        assert x is not None, "a rod with a constraint"

        def follow(direction):
            change = lambda x: self.residual(U._replace(multipliers=x))._replace(gaps=None)
            return self._correct_along(factors, jax.jvp(change, (x,), (direction,))[1])

        eye, exact = jnp.eye(x.shape[0]), jnp.full(x.shape, True)
        # Several right-hand sides in lockstep take longer than in turn on a CPU.
        if not on_cpu():
            along = jax.vmap(follow)(eye)
        elif kept is None:
            along = jax.lax.map(follow, eye)
        else:
            exact = self._counting(U, kept)
            which = jnp.argsort(~exact)
            one = lambda k, along: along.at[which[k]].set(follow(eye[which[k]]))
            along = jax.lax.fori_loop(0, jnp.sum(exact), one, kept.factors.border.along)
        by_along = self._gaps_by_along(U)
        direct = jax.jacfwd(lambda x: self.gaps(U._replace(multipliers=x)))(x)
        if safe is not None:
            along, by_along = jnp.where(safe, along, 0.0), jnp.where(safe, by_along, 0.0)
            direct = jnp.where(safe, direct, eye)
        S = direct + _rows(by_along) @ _rows(along[..., -by_along.shape[-1] :]).T
        return Border(along, by_along, conditions(S, x > 0), exact)

    def _counting(self, U: Unknowns, kept: ReusedFactors) -> Bool[Array, "conditions"]:
        """Which multipliers are not zero, or may soon not be."""
        border, x = kept.factors.border, U.multipliers
        assert x is not None, "a rod with a constraint"
        closed = jnp.diagonal(border.conditions.S) * jnp.max(x)
        return (x > 0) | (self.gaps(U) < _NEARLY * closed) | ~kept.alike

    def _gaps_by_along(self, U: Unknowns) -> Float[Array, "conditions rows last"]:
        constraint, n = self.rod.constraint, self.layout.size
        assert constraint is not None, "a rod with a constraint"
        if U.along.shape[-1] == n:
            return jax.jacrev(lambda along: self.gaps(U._replace(along=along)))(U.along)
        # Strains are unknowns beside the states.
        return constraint.gaps_by_strain(self.rod, U.along[:, n:], self.rod.grid.weights)

    def _correct_along(self, factors: Factors, F: Residual):
        """The correction along the rod where the multipliers stay."""
        kind = factors.sweeps.K.dtype
        rhs = jax.tree.map(lambda x: x.astype(kind), F.along)
        defect, condensed = self.method.condense(factors.inner, rhs)
        sweeps = solve_sweeps(factors.sweeps, defect, F.tip.astype(kind))
        along = self.method.expand(factors.inner, condensed, sweeps)
        return along.astype(F.tip.dtype)

    def correct(self, factors: Factors, F: Residual) -> Unknowns:
        """The correction -J^-1 F of the unknowns; NaN where no multipliers can be, or no factors
        are there for those that are."""
        along, border = self._correct_along(factors, F), factors.border
        if border is None:
            return Unknowns(along)
        assert F.gaps is not None and F.multipliers is not None, "those of the border"
        x, gaps = F.multipliers, F.gaps + border.gaps_following(along)
        dx = border.conditions.multipliers(gaps - border.conditions.S @ x) - x
        dx = jnp.where(border.exact | (dx == 0), dx, jnp.nan)
        return Unknowns(along + border.following(dx), dx)

    def equalities(self, U: Unknowns, tight: Bool[Array, "conditions"] | None) -> Residual:
        """What is zero where it is settled which conditions are `tight`: those have no gap.

        The last entry, in the place of the gaps, has the multipliers of the others.
        """
        F = self.residual(U)
        if tight is None or F.gaps is None or F.multipliers is None:
            return F
        return F._replace(gaps=jnp.where(tight, F.gaps, F.multipliers), multipliers=None)

    def correct_equalities(self, factors: Factors, F: Residual, tight) -> Unknowns:
        """As `correct`, for `equalities`; linear in F."""
        along, border = self._correct_along(factors, F), factors.border
        if border is None:
            return Unknowns(along)
        assert F.gaps is not None, "those of the border"
        held = border.gaps_following(along)
        rhs = -F.gaps - jnp.where(tight, held, 0.0)
        S, inverse = border.conditions.S, border.conditions.inverse
        # Of those that are tight; the second step takes away what the inverse has for safety.
        dx = inverse @ rhs
        dx = dx + inverse @ jnp.where(tight, rhs - S @ dx, 0.0)
        return Unknowns(along + border.following(dx), dx)

    def is_stable(self, U: Unknowns, factors: Factors) -> Bool[Array, ""]:
        """Whether an equilibrium is, with the `factors` at it; see `block_sweep.py`.

        A constraint takes unstable directions away: as many as there are where the rod yields
        to its multipliers with the wrong sign (the inertia of a matrix with a border).
        """
        sweeps = factors.sweeps
        if self.layout.rubbing:
            sticking, same = self._sticking(U)
            sweeps = sticking.factorise(same).sweeps
        unstable = count_conjugate_points(sweeps)
        if factors.border is None or U.multipliers is None:
            return unstable == 0
        tight = U.multipliers > 0
        both = tight[:, None] & tight[None, :]
        S = factors.border.conditions.S
        own = jnp.linalg.eigvalsh(jnp.where(both, 0.5 * (S + S.T), 0.0))
        # What several tendons hold together has zeros, up to rounding.
        return unstable == jnp.sum(own < -_ZERO * jnp.max(jnp.abs(own)))

    def _sticking(self, U: Unknowns) -> tuple["Equations", Unknowns]:
        """The rod with the tensions along its tendons as they are, and what is unknown of it.

        A disturbance that is small enough lets no tendon slide.
        """
        layout, rod = self.layout, self.rod.under(U.multipliers)
        losses, _ = layout.losses_and_slips(self.fields(U).y)
        rod = dataclasses.replace(rod.rubbing(losses), friction=None, constraint=None)
        k, n = layout.base_size, layout.rubbing
        along = jnp.concatenate([U.along[:, : k - n], U.along[:, k + n :]], 1)
        layout = dataclasses.replace(layout, rubbing=0)
        return self._replace(rod=rod, layout=layout), Unknowns(along)

    def scale(self, U: Unknowns) -> Unknowns:
        """Sizes of the unknowns, (columns,): a bent rod's, and those of the answer so far."""
        layout, n = self.layout, self.layout.size
        along = sizes(U.along[:, :n], self.rod, layout, self.history)
        # Multipliers are forces: of the size of those in a bent rod.
        force, x = along[-layout.pair], U.multipliers
        if U.along.shape[-1] > n:
            stretch, bend = layout.split_strain(U.along[:, n:])
            curvature = 1 / self.rod.L + jnp.max(jnp.abs(bend))
            stretch = None if stretch is None else jnp.ones(layout.vector)
            along = layout.join(along, stretch, curvature * jnp.ones(layout.turn))
        return Unknowns(along, None if x is None else jnp.full_like(x, force + jnp.max(jnp.abs(x))))

    def fields(self, U: Unknowns) -> Guess:
        """The rod at all points."""
        fields = self.method.fields(U.along, *self._problem(U))
        return fields._replace(multipliers=U.multipliers)

    def error(self, U: Unknowns, factors: Factors) -> Float[Array, ""]:
        """The estimated error of an equilibrium's tip from the grid, in lengths of the rod."""
        tip, gaps, tight = jnp.zeros(self.layout.tip_size), None, None
        rod, constraint = self.rod.under(U.multipliers), self.rod.constraint
        if constraint is not None and U.multipliers is not None:
            # What a wider quadrature says of the conditions.
            strain, tight = self.fields(U).strain, U.multipliers > 0
            wide = constraint.gaps(self.rod, strain, U.multipliers, wide_weights(self.rod.grid))
            gaps = jnp.where(tight, wide, 0.0)

        def correct(residual):
            return self.correct_equalities(factors, Residual(residual, tip, gaps), tight).along

        return self.method.error(U.along, rod, self.layout, self.guess, correct)

    def _tip(self, Y):
        history = self.history
        if history is not None:
            history = History(history.c0, history.strain[-1], history.velocity[-1])
        return tip_condition(Y[-1], self.rod, self.layout, history)


def _rows(a):
    return a.reshape(a.shape[0], -1)
