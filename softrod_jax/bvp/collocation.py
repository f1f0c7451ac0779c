"""Symmetric collocation along the rod: mono-implicit Runge-Kutta formulas of order 4 and 6.

In each interval, states at inner points are combinations of those at its ends and of the rates
(Cash & Singhal 1982; order 4 is Hermite-Simpson). Symmetric formulas keep both the growing and
the decaying modes of the rod equations, so that the error does not depend on the time step;
explicit integration along the rod needs intervals shorter than a wave travels in a step.

States at inner points and, with tendons, the strains at all points are unknowns, too: all rates
come from one evaluation, and no iteration is nested in Newton's. From its linear equations they
are eliminated point by point.
"""

import dataclasses
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from softrod_jax.bvp.block_sweep import apply_each
from softrod_jax.bvp.grid_error import CAUTION, hidden_turns, roughness, tip_of, wide_defect
from softrod_jax.bvp.method import AbstractMethod, Guess, Linear
from softrod_jax.bvp.missed_push import push_on
from softrod_jax.foundation.products import product
from softrod_jax.rod.boundary_conditions import gap_conditions
from softrod_jax.rod.constants import Rod, full_strain
from softrod_jax.rod.constitutive import imbalance, nearby_strain, recover_strain
from softrod_jax.rod.grid import Division, Grid, divide, divided_grid, uniform_grid
from softrod_jax.rod.jacobian import rod_ode_jacobian
from softrod_jax.rod.ode import pointwise_problem, rates
from softrod_jax.rod.rotations import to_body
from softrod_jax.rod.shape import ORIGIN, integrate_shape
from softrod_jax.rod.state import History, Layout
from softrod_jax.scene.planes import vector_in
from softrod_jax.scene.scene import Scene


class _Formula:
    """Y_r = (1 - v_r) Y_k + v_r Y_{k+1} + h sum_j x_rj f_j;  Y_{k+1} = Y_k + h sum_r b_r f_r.

    The first two stages are the nodes themselves; `c` are the inner points, in [0, 1], in the
    order in which they are computed.
    """

    def __init__(self, c, v, x, b):
        self.c, self.v = np.array(c), np.array(v)
        self.x, self.b = [np.array(row) for row in x], np.array(b)

    def weights(self, kind):
        """v, x and b as precise as what they are to weigh."""
        return self.v.astype(kind), [row.astype(kind) for row in self.x], self.b.astype(kind)


_FORMULAS = {
    4: _Formula(c=[1 / 2], v=[1 / 2], x=[[1 / 8, -1 / 8]], b=[1 / 6, 1 / 6, 2 / 3]),
    6: _Formula(
        c=[1 / 4, 3 / 4, 1 / 2],
        v=[5 / 32, 27 / 32, 1 / 2],
        x=[[9 / 64, -3 / 64], [3 / 64, -9 / 64], [-5 / 24, 5 / 24, 2 / 3, -2 / 3]],
        b=[7 / 90, 7 / 90, 16 / 45, 16 / 45, 2 / 15],
    ),
}


# From differences of the strains, of the method's own order, to the error of a moving tip. The
# defect says too much there: where a front is, it is large, and the tip hardly notices. Measured on
# steps and ramps of gravity and tensions, and on rods of ten times the weight that bends them: 1 to
# 6 times the true error, for order 6 up to a hundred times where strains are smooth.
_ROUGHNESS = {4: 0.06, 6: 2e-3}


class Collocation(AbstractMethod):
    """Mono-implicit Runge-Kutta collocation on `intervals` equal intervals.

    `order` 4 (Hermite-Simpson) or 6. The default, 12 intervals of order 6, was measured against
    20 of order 4: a quarter of the error or less (statics under gravity and curls of several
    turns, the paper's rod), in the same time or less. Raises `ValueError` for any other order, or
    fewer than one interval.
    """

    intervals: int = eqx.field(static=True, default=12)
    order: int = eqx.field(static=True, default=6)
    max_error: float = eqx.field(static=True, default=1e-2)
    division: Division | None = eqx.field(static=True, default=None)

    def __check_init__(self):
        if self.order not in _FORMULAS:
            raise ValueError(f"Collocation: order={self.order!r} is not offered; use 4 or 6")
        if self.intervals < 1:
            raise ValueError(f"Collocation: intervals={self.intervals!r}; at least 1 is needed")

    @property
    def _formula(self):
        return _FORMULAS[self.order]

    @property
    def _stride(self) -> int:
        return 1 + len(self._formula.c)

    @property
    def _rule(self) -> np.ndarray:
        """Weights of the points of an interval in their order, both ends among them."""
        left, right, *inner = self._formula.b
        return np.array([left, *np.array(inner)[np.argsort(self._formula.c)], right])

    def finer(self) -> "Collocation":
        """Twice as many intervals."""
        division = None if self.division is None else self.division.finer()
        return dataclasses.replace(self, intervals=2 * self.intervals, division=division)

    def fitted(self, scene: Scene) -> "Collocation":
        """With nodes where something jumps; each part of the rod has two intervals at least."""
        division = divide(scene, self.intervals)
        own = self.division
        # One that was found on known numbers is right for the same scene with traced ones.
        if own is not None and division is not None and own.fits(division):
            return self
        return dataclasses.replace(self, division=division)

    def grid(self, scene: Scene) -> Grid:
        """Nodes and inner points."""
        inner, rule = np.concatenate([[0.0], np.sort(self._formula.c)]), self._rule
        if self.division is None:
            whole = np.zeros(self.intervals * self._stride + 1)
            for k in range(self.intervals):
                whole[k * self._stride : (k + 1) * self._stride + 1] += rule
            return uniform_grid(scene.length, self.intervals, inner, whole)
        return divided_grid(scene, self.division, inner, rule)

    def outputs(self, points: Float[Array, "points *rest"]) -> Float[Array, "nodes *rest"]:
        """The nodes."""
        return points[:: self._stride]

    def shape(self, strain, grid: Grid, base_position, base_quaternion) -> tuple[Array, Array]:
        """Positions (nodes, 3) and quaternions (nodes, 4), at the order of the method."""
        formula = self._formula
        at = np.concatenate([[0.0, 1.0], formula.c])
        order = np.argsort(at)
        return integrate_shape(
            strain, grid.h, base_position, base_quaternion, at[order], formula.b[order]
        )

    def inside(self, points: Float[Array, "points *rest"]) -> Float[Array, "intervals k *rest"]:
        """The points of each interval."""
        first = np.arange(0, points.shape[0] - 1, self._stride)
        return points[first[:, None] + np.arange(self._stride + 1)]

    def unknowns(self, guess: Guess, rod: Rod) -> Float[Array, "points columns"]:
        """States at all points, beside them the strains if there are tendons."""
        return guess.y if rod.explicit_strains else jnp.concatenate([guess.y, guess.strain], -1)

    def states(self, U, layout: Layout) -> Float[Array, "nodes n"]:
        """The states at the nodes."""
        return self.outputs(U)[:, : layout.size]

    def fields(self, U, rod: Rod, layout: Layout, history, guess) -> Guess:
        """The rod at all points."""
        y, strain, _ = self._split(U, rod, layout, history)
        return Guess(y, strain)

    def error(self, U, rod: Rod, layout: Layout, guess, correct) -> Float[Array, ""]:
        """By defect correction: see `grid_error.py`."""
        h = _column(rod.grid.h)
        y, strain, problem = self._split(U, rod, layout, None)
        nodes = self.outputs(y)
        known = self.outputs(rates(y, strain, rod, layout, None))

        def rates_at(y):
            near = self._strain_at(y, strain, rod, layout)
            return rates(y, near, rod, layout, None)

        wide = wide_defect(nodes, known, h, self._stride, rates_at, self.division)
        inner = [jnp.zeros_like(nodes[1:])] * len(self._formula.c)
        forces = None if rod.explicit_strains else jnp.zeros_like(strain)
        moved = correct(_Residual(wide.defect, inner, forces))[:, : layout.size]
        better = full_strain(self._strain_at(wide.y + moved, strain, rod, layout), rod)
        coarse = self.shape(full_strain(strain, rod), rod.grid, *ORIGIN)[0][-1]
        together = tip_of(better, rod.grid) - coarse
        # The correction of the nodes and that of what lies between them nearly cancel where a layer
        # is only just seen. What is left may be a sixth of the error; the nodes alone show it.
        at_nodes = full_strain(self._strain_at(y + moved, strain, rod, layout), rod)
        at_nodes = self.shape(at_nodes, rod.grid, *ORIGIN)[0][-1] - coarse
        size = jnp.linalg.norm
        moved = jnp.maximum(CAUTION * size(together), 0.5 * size(at_nodes)) / rod.L
        if rod.radius is not None:
            lost = _Residual(self._missed_pushes(y, rod, layout), inner, forces)
            pushed = self._strain_at(y + correct(lost)[:, : layout.size], strain, rod, layout)
            pushed = self.shape(full_strain(pushed, rod), rod.grid, *ORIGIN)[0][-1]
            moved = moved + size(pushed - coarse) / rod.L
        turning = layout.attitude
        _, bend = layout.split_strain(strain)
        return jnp.maximum(moved, hidden_turns(bend, rod.grid)) if turning else moved

    def error_in_motion(self, fields: Guess, rod: Rod, layout: Layout, history, guess):
        """By differences of the strains: see `_ROUGHNESS`."""
        if any(part.stop - part.start <= self.order for part in rod.grid.parts()):
            return jnp.array(jnp.inf)
        stretch, bend = layout.split_strain(fields.strain)
        rough = _ROUGHNESS[self.order] * roughness(bend, stretch, self.order, rod.grid)
        return jnp.maximum(rough, hidden_turns(bend, rod.grid))

    def _missed_pushes(self, y, rod: Rod, layout: Layout) -> Float[Array, "intervals n"]:
        """The defects of forces that obstacles leave between the points, where touches end."""
        h = y[self._stride // 2 :: self._stride, layout.pose_size - layout.attitude_size :]
        force = vector_in(rod.plane, push_on(y, rod, layout, self).missed)
        force = to_body(h[:, : layout.attitude_size], force)
        defect = jnp.zeros((force.shape[0], layout.size))
        return defect.at[:, -layout.pair : -layout.turn].set(force)

    def _strain_at(self, y, strain, rod, layout):
        """The strains at states near those that `strain` belongs to."""
        problem = pointwise_problem(y, rod, layout, None)
        return nearby_strain(problem, strain)

    def residual(self, U, rod: Rod, layout: Layout, history, guess) -> "_Residual":
        """How far the unknowns are from solving the rod ODE."""
        formula, h = self._formula, _column(rod.grid.h)
        states, strain, problem = self._split(U, rod, layout, history)
        f = self._by_stage(rates(states, strain, rod, layout, history))
        y = self._by_stage(states)
        increment = sum(b * f_r for b, f_r in zip(formula.b, f))
        inner = [
            y_r - (1 - v) * y[0] - v * y[1] - h * sum(a * f_j for a, f_j in zip(x, f))
            for y_r, v, x in zip(y[2:], formula.v, formula.x)
        ]
        forces = None if rod.explicit_strains else imbalance(problem, strain)
        defect = y[1] - y[0] - h * increment
        if rod.at_gaps is not None:
            applied = self._at_gaps(states, rod, layout, history).value
            defect = defect.at[rod.grid.gaps, -layout.pair :].add(applied)
        return _Residual(defect, inner, forces)

    def linearise(
        self, U, rod: Rod, layout: Layout, history, guess, single: bool = False
    ) -> Linear:
        """The derivative of `residual`, strains and inner states eliminated."""
        y, strain, _ = self._split(U, rod, layout, history)
        kind = jnp.float32 if single else y.dtype
        every_v, every_x, b = self._formula.weights(kind)
        at = rod_ode_jacobian(y, strain, rod, layout, history)
        A = [A_r.astype(kind) for A_r in self._times(rod.grid, at.state)]
        # Beside each other what multiplies Y_k and Y_{k+1}: of stages in `moves`, and of
        # G_r = h df_r/d(Y_k, Y_{k+1}), by the chain rule through the stages.
        eye, none = jnp.eye(layout.size, dtype=kind), jnp.zeros_like(A[0])
        beside = lambda a, b: jnp.concatenate([a * eye, b * eye], -1)
        G = [jnp.concatenate([A[0], none], -1), jnp.concatenate([none, A[1]], -1)]
        moves = []
        for A_r, x, v in zip(A[2:], every_x, every_v):
            moves.append(beside(1 - v, v) + sum(a * G_j for a, G_j in zip(x, G)))
            G.append(product(A_r, moves[-1]))
        ends = beside(-1, 1) - sum(b_r * G_r for b_r, G_r in zip(b, G))
        strains = None
        if not rod.explicit_strains:
            whole = rod.grid.division is None
            by_wrench = rod.grid.h * at.wrench if whole else self._times(rod.grid, at.wrench)
            force_by_state = self._force_by_state(at.pull, layout)
            strains = jax.tree.map(
                lambda x: x.astype(kind), (at.compliance, by_wrench, force_by_state)
            )
        left, right = jnp.split(ends, 2, axis=-1)
        if rod.at_gaps is not None:
            slope = self._at_gaps(y, rod, layout, history).by_base_part
            here = rod.grid.gaps, slice(-layout.pair, None), slice(layout.base_size)
            left = left.at[here].add(slope.astype(kind))
        return Linear(left, right, (A[2:], moves, strains))

    def condense(self, inner, residual: "_Residual"):
        """The defects between nodes once inner states and strains have been corrected."""
        A, _, strains = inner
        _, every_x, b = self._formula.weights(A[0].dtype)
        df: list = [0.0] * (2 + len(A))  # times h
        if strains is not None and residual.forces is not None:
            _, by_wrench, _ = strains
            if isinstance(by_wrench, list):  # of stages, where intervals have their own lengths
                forces = self._by_stage(residual.forces)
                df = [-apply_each(B, x) for B, x in zip(by_wrench, forces)]
            else:
                df = self._by_stage(-apply_each(by_wrench, residual.forces))
        dy = []
        for r, (A_r, x) in enumerate(zip(A, every_x)):
            dy.append(sum(a * df_j for a, df_j in zip(x, df)) - residual.inner[r])
            df[2 + r] = df[2 + r] + apply_each(A_r, dy[-1])
        defect = residual.defect - sum(b_r * df_r for b_r, df_r in zip(b, df))
        return defect, (dy, residual.forces)

    def expand(self, inner, condensed, dY: Float[Array, "nodes n"]):
        """The correction of all unknowns."""
        (_, moves, strains), (dy, forces) = inner, condensed
        ends = jnp.concatenate([dY[:-1], dY[1:]], -1)
        moved = [dy_r + apply_each(W, ends) for dy_r, W in zip(dy, moves)]
        order = np.argsort(self._formula.c)
        body = jnp.stack([dY[:-1]] + [moved[r] for r in order], axis=1)
        dU = jnp.concatenate([body.reshape(-1, body.shape[-1]), dY[-1:]])
        if strains is None:
            return dU
        compliance, _, force_by_state = strains
        if force_by_state is None:
            wrench = dU[:, -forces.shape[-1] :]
        else:
            wrench = apply_each(force_by_state, dU)
        return jnp.concatenate([dU, apply_each(compliance, wrench - forces)], -1)

    def _force_by_state(self, pull, layout: Layout):
        """How the forces at a point follow its whole state, where that is more than N and M."""
        if pull is None:
            return None
        n, k = pull.shape[-2], layout.base_size
        direct = jnp.broadcast_to(
            jnp.eye(n, layout.size, layout.size - n), (*pull.shape[:-1], layout.size)
        )
        return direct.at[..., k - layout.rubbing : k].set(pull)

    def _split(self, U, rod, layout, history):
        """States, strains and the pointwise problem of which they are the solution."""
        y = U[:, : layout.size]
        problem = pointwise_problem(y, rod, layout, history)
        strain = recover_strain(problem, None)[0] if rod.explicit_strains else U[:, layout.size :]
        return y, strain, problem

    def _at_gaps(self, y, rod, layout, history):
        """What loads along the rod do, at the nodes before the gaps."""
        at = rod.grid.gaps * self._stride
        if history is not None:
            history = History(history.c0, history.strain[at], history.velocity[at])
        return gap_conditions(y[at], rod, layout, history)

    def _times(self, grid: Grid, points):
        """`_by_stage` of values at points, times the lengths of the intervals."""
        if grid.division is None:
            return self._by_stage(grid.h * points)
        h = jnp.reshape(grid.h, (-1, *[1] * (points.ndim - 1)))
        return [h * x for x in self._by_stage(points)]

    def _by_stage(self, points):
        """Values at points as a list: left nodes, right nodes, and inner points in turn."""
        nodes = self.outputs(points)
        rank = np.argsort(np.argsort(self._formula.c))
        return [nodes[:-1], nodes[1:]] + [points[1 + k :: self._stride] for k in rank]


def _column(h):
    """Lengths of intervals beside values of intervals, (intervals, n)."""
    return h[:, None] if jnp.ndim(h) else h


class _Residual(NamedTuple):
    """Defects between nodes, errors of inner states, and imbalance of forces at the points."""

    defect: Float[Array, "intervals n"]
    inner: list
    forces: Float[Array, "points strain"] | None
