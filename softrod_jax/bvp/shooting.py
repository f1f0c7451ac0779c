"""Single and multiple shooting along the rod, integrated by a solver of diffrax.

The unknowns are the states at the ends of `segments`; each segment is an initial value problem.
The rod equations have modes that grow and decay along the rod as exp(+-c0 s / c), with c the
speed of a wave and c0 about 1/dt. A segment multiplies errors by exp(c0 ds / c): single
shooting is for statics and slow motions, and no explicit solver is accurate once a wave takes
longer than a time step for one of its steps, c0 ds / c > 1. `Collocation` has neither limit.
"""

import dataclasses
import functools

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from softrod_jax.bvp.grid_error import CAUTION
from softrod_jax.bvp.method import AbstractMethod, Guess, Linear
from softrod_jax.rod.constants import Rod, full_strain
from softrod_jax.rod.grid import Grid, divide, uniform_grid
from softrod_jax.rod.ode import rod_ode
from softrod_jax.rod.shape import BOOLE, ORIGIN, integrate_shape
from softrod_jax.rod.state import History, Layout, sizes
from softrod_jax.scene.scene import Scene

# Points of the Lagrange polynomials that interpolate the history.
_WINDOW = 6


class Shooting(AbstractMethod):
    """Multiple shooting; `segments=1` is single shooting.

    - `segments`, each of `steps` equal steps. Strains and velocities are kept at the ends of
      all steps; in between, a time step's history is interpolated by polynomials through the 6
      nearest ends (all of them, if there are fewer). A solver of order above 6 gains nothing.
    - `solver`: any `diffrax.AbstractSolver` of ordinary differential equations. An implicit one
      needs a root finder of optimistix: `Kvaerno3(root_finder=optimistix.Newton(1e-9, 1e-9))`.
    - `stepsize_controller`: with `diffrax.PIDController` each of the steps is divided further
      as its tolerances ask for, into at most `max_substeps`; they are relative to the sizes of
      a bent rod's forces, moments and velocities. Slow to compile.
    - `max_error`: the estimated error of the integration (`stats["error"]`) up to which a
      solution counts as one. Solvers without an embedded error estimate are not checked;
      `diffrax.HalfSolver` gives one to any solver.

    Whether an equilibrium is stable is judged from node to node: single shooting cannot tell,
    5 segments can.

    Raises `ValueError` for counts below 1 and for what is not a solver.
    """

    segments: int = eqx.field(static=True, default=1)
    steps: int = eqx.field(static=True, default=20)
    solver: diffrax.AbstractSolver = eqx.field(static=True, default=diffrax.Tsit5())
    stepsize_controller: diffrax.AbstractStepSizeController = eqx.field(
        static=True, default=diffrax.ConstantStepSize()
    )
    max_substeps: int = eqx.field(static=True, default=16)
    max_error: float = eqx.field(static=True, default=1e-3)

    def __check_init__(self):
        for name in ("segments", "steps", "max_substeps"):
            if getattr(self, name) < 1:
                raise ValueError(f"Shooting: {name}={getattr(self, name)!r}; at least 1 is needed")
        if not isinstance(self.solver, diffrax.AbstractSolver):
            raise ValueError(f"Shooting: solver={self.solver!r}; give a diffrax.AbstractSolver")

    # Equinox lets a property stand for a variable of the interface.
    @property
    def intervals(self) -> int:  # pyright: ignore[reportIncompatibleVariableOverride]
        return self.segments

    @property
    def order(self) -> int:  # pyright: ignore[reportIncompatibleVariableOverride]
        order = self.solver.order(None)
        if order is None:
            raise ValueError(f"Shooting: solver={self.solver!r} has no order; use another one")
        return order

    def finer(self) -> "Shooting":
        """Twice as many steps in each segment."""
        return dataclasses.replace(self, steps=2 * self.steps)

    def fitted(self, scene: Scene) -> "Shooting":
        """Itself. Raises `ValueError` where something jumps along the rod: no nodes are there."""
        if divide(scene, 1) is not None:
            raise ValueError(
                "Shooting: segments, tendons or chambers that end along the rod, and loads there, "
                "need nodes at these places; use Collocation"
            )
        return self

    def grid(self, scene: Scene) -> Grid:
        """The ends of all steps."""
        return _ends_of_steps(scene.length, self.segments * self.steps)

    def outputs(self, points: Float[Array, "points *rest"]) -> Float[Array, "points *rest"]:
        """All points: single shooting has no nodes but the two ends."""
        return points

    def shape(self, strain, grid: Grid, base_position, base_quaternion) -> tuple[Array, Array]:
        """Positions (points, 3) and quaternions (points, 4), at order 6."""
        x = jnp.arange(4 * (strain.shape[0] - 1) + 1) / 4
        fine = _Window(x, strain.shape[0]).interpolate(strain)
        return integrate_shape(
            fine, grid.h, base_position, base_quaternion, np.arange(5) / 4, BOOLE
        )

    def inside(self, points: Float[Array, "points *rest"]) -> Float[Array, "steps 5 *rest"]:
        """The ends of each step, and three points in between by interpolation."""
        count = points.shape[0]
        fine = _Window(jnp.arange(4 * (count - 1) + 1) / 4, count).interpolate(points)
        return fine[4 * np.arange(count - 1)[:, None] + np.arange(5)]

    def unknowns(self, guess: Guess, rod: Rod) -> Float[Array, "nodes n"]:
        """The states at the nodes."""
        return guess.y[:: self.steps]

    def states(self, U, layout: Layout) -> Float[Array, "nodes n"]:
        """The unknowns themselves."""
        return U

    def fields(self, U, rod: Rod, layout: Layout, history, guess) -> Guess:
        """The rod at the ends of all steps."""
        ends, _ = self._propagate(U[:-1], rod, layout, history, guess)
        starts = jnp.concatenate([U[None, :-1], ends[:-1]])
        y = jnp.swapaxes(starts, 0, 1).reshape(-1, layout.size)
        y = jnp.concatenate([y, U[-1:]])
        at = rod_ode(y, rod, layout, history, guess)
        return Guess(y, at.strain)

    def error(self, U, rod: Rod, layout: Layout, guess, correct) -> Float[Array, ""]:
        """By one correction for the equations of twice as many steps."""
        finer, count = self.finer(), guess.shape[0]
        halves = _Window(jnp.arange(2 * count - 1) / 2, count)
        between = halves.interpolate(guess)
        dense = rod.map_points(halves.interpolate)
        grid = _ends_of_steps(rod.L, finer.segments * finer.steps)
        dense = eqx.tree_at(lambda r: r.grid, dense, grid)
        moved = correct(finer.residual(U, dense, layout, None, between))
        better = finer.fields(U + moved, dense, layout, None, between).strain
        coarse = self.fields(U, rod, layout, None, guess).strain
        tip = lambda method, strain, rod: method.shape(full_strain(strain, rod), rod.grid, *ORIGIN)[
            0
        ][-1]
        moved = tip(finer, better, dense) - tip(self, coarse, rod)
        return CAUTION * jnp.linalg.norm(moved) / rod.L

    def error_in_motion(self, fields: Guess, rod: Rod, layout: Layout, history, guess):
        """From the solver's own estimate of every step; NaN where it has none.

        A moment that is wrong by a part of the largest one bends the rod the more wrongly, the
        more that one bends it.
        """
        nodes = self.unknowns(Guess(fields.y, fields.strain), rod)
        _, error = self._propagate(nodes[:-1], rod, layout, history, guess)
        _, bend = layout.split_strain(fields.strain)
        return error * jnp.maximum(1.0, rod.L * jnp.max(jnp.abs(bend)))

    def residual(self, U, rod: Rod, layout: Layout, history, guess) -> Float[Array, "segments n"]:
        """How far each segment ends from the next node."""
        return U[1:] - self._propagate(U[:-1], rod, layout, history, guess)[0][-1]

    def linearise(
        self, U, rod: Rod, layout: Layout, history, guess, single: bool = False
    ) -> Linear:
        """The derivative of `residual`, by forward tangents through the integration."""
        Y, eye = U[:-1], jnp.eye(layout.size)

        def column(e):
            last = lambda Y: self._propagate(Y, rod, layout, history, guess)[0][-1]
            return jax.jvp(last, (Y,), (jnp.broadcast_to(e, Y.shape),))[1]

        left = -jax.vmap(column, out_axes=-1)(eye)
        if single:
            left, eye = left.astype(jnp.float32), eye.astype(jnp.float32)
        return Linear(left, jnp.broadcast_to(eye, left.shape), None)

    def condense(self, inner, residual):
        """No inner unknowns."""
        return residual, None

    def expand(self, inner, condensed, dY):
        """No inner unknowns."""
        return dY

    def _propagate(self, Y: Float[Array, "segments n"], rod, layout, history, guess):
        """States at the ends of steps, (steps, segments, n), and the estimated error.

        All segments advance together. The independent variable counts steps, so that neither
        the grid nor the interpolation depends on the length of the rod; the state is in units
        of the rod, so that one tolerance fits all its parts.
        """
        units = _units(Y, rod, layout, history)
        step = rod.L / (self.segments * self.steps)
        count = self.segments * self.steps + 1
        offset = np.arange(self.segments) * float(self.steps)
        guess = jax.lax.stop_gradient(guess)

        def field(x, z, args):
            del args
            x = jax.lax.stop_gradient(offset + x)
            at = _Window(x, count)
            here = None
            if history is not None:
                crept = history.crept
                here = History(
                    history.c0,
                    at.interpolate(history.strain),
                    at.interpolate(history.velocity),
                    None if crept is None else at.interpolate(crept),
                )
            local = rod.map_points(at.interpolate)
            rates = rod_ode(z * units, local, layout, here, at.interpolate(guess))
            # Where the tendons allow no strains, the end of the segment is not a number.
            return jnp.where(rates.solvable, step * rates.y_s / units, jnp.nan)

        advance, state = self._stepper(diffrax.ODETerm(field), Y / units)
        _, (ends, errors) = jax.lax.scan(
            advance, (Y / units, state), jnp.arange(self.steps, dtype=float)
        )
        # Errors of the single steps add up: with both ends of the rod held, they do not grow.
        error = jnp.sum(jnp.max(errors, -1))
        return ends * units, error

    def _stepper(self, term, start):
        """`advance((z, state), x) -> ((z, state), (z, error))` from x to x + 1, and `state`."""
        solver = _differentiable(self.solver)

        if isinstance(self.stepsize_controller, diffrax.ConstantStepSize):

            def one_step(carry, x):
                z, state = carry
                z, error, _, state, result = solver.step(
                    term, x, x + 1, z, None, state, made_jump=False
                )
                z = jnp.where(result == diffrax.RESULTS.successful, z, jnp.nan)
                error = jnp.full_like(z, jnp.nan) if error is None else jnp.abs(error)
                return (z, state), (z, jax.lax.stop_gradient(error))

            return one_step, solver.init(term, 0.0, 1.0, start, None)

        def advance(carry, x):
            z, _ = carry
            solution = diffrax.diffeqsolve(
                term,
                solver,
                x,
                x + 1,
                1.0,
                z,
                stepsize_controller=self.stepsize_controller,
                max_steps=self.max_substeps,
                # The only adjoint that has both a forward and a reverse derivative.
                adjoint=diffrax.DirectAdjoint(),
                throw=False,
            )
            assert solution.ys is not None, "the state at the end is asked for"
            z = jnp.where(solution.result == diffrax.RESULTS.successful, solution.ys[-1], jnp.nan)
            # The controller keeps the error within its own tolerances.
            return (z, None), (z, jnp.full_like(z, jnp.nan))

        return advance, None


def _ends_of_steps(length, steps: int) -> Grid:
    return uniform_grid(length, steps, np.zeros(1), _rule(steps + 1))


@functools.cache
def _rule(count: int) -> np.ndarray:
    """Weights of the integral over points 0, 1, .., `count` - 1: of the interpolation below."""
    width = min(_WINDOW, count)
    at, weights = np.arange(width), np.zeros(count)
    conditions = np.vander(at, increasing=True).T
    for k in range(count - 1):
        first = np.clip(k - (width // 2 - 1), 0, count - width)
        a = float(k - first)
        moments = ((a + 1) ** (at + 1) - a ** (at + 1)) / (at + 1)
        weights[first : first + width] += np.linalg.solve(conditions, moments)
    return weights


class _Window:
    """Lagrange interpolation from points 0, 1, .., `count` - 1 to `x`, (m,), of their range."""

    def __init__(self, x: Float[Array, "m"], count: int):
        width = min(_WINDOW, count)
        at = np.arange(width)
        first = jnp.clip(jnp.floor(x).astype(int) - (width // 2 - 1), 0, count - width)
        others = ~np.eye(width, dtype=bool)
        distance = (x - first)[:, None, None] - at
        numerator = jnp.prod(jnp.where(others, distance, 1.0), -1)
        denominator = np.prod(np.where(others, at[:, None] - at, 1), -1)
        self._index, self._weights = first[:, None] + at, numerator / denominator

    def interpolate(self, values: Float[Array, "points *k"]) -> Float[Array, "m *k"]:
        return jnp.einsum("mw,mw...->m...", self._weights, values[self._index])


def _differentiable(solver: diffrax.AbstractSolver) -> diffrax.AbstractSolver:
    """The solver, with the loop over its stages one that has both derivatives."""
    is_stages = lambda x: isinstance(x, diffrax.AbstractRungeKutta)
    bounded = lambda x: eqx.tree_at(
        lambda s: s.scan_kind, x, "bounded", is_leaf=lambda leaf: leaf is None
    )
    return jax.tree.map(lambda x: bounded(x) if is_stages(x) else x, solver, is_leaf=is_stages)


def _units(Y, rod: Rod, layout: Layout, history):
    """Sizes of the state's components, (n,): a bent rod's, or those of `Y` if larger."""
    return jax.lax.stop_gradient(sizes(Y, rod, layout, history))
