"""Symmetric collocation along the rod: mono-implicit Runge-Kutta formulas of order 4 and 6.

The unknowns are the states at the nodes; states inside an interval follow from them explicitly
(Cash & Singhal 1982; order 4 is Hermite-Simpson). Symmetric formulas keep both the growing and
the decaying modes of the rod equations, so that the error does not depend on the time step;
explicit integration along the rod needs intervals shorter than a wave travels in a step.
"""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from softrod_jax.method import Defects, Method
from softrod_jax.rod import Rod
from softrod_jax.rod_ode import History, Layout, rod_ode, rod_ode_jacobian
from softrod_jax.shape import integrate_shape


class _Formula:
    """Y_r = (1 - v_r) Y_k + v_r Y_{k+1} + h sum_j x_rj f_j;  Y_{k+1} = Y_k + h sum_r b_r f_r.

    The first two stages are the nodes themselves; `c` are the inner points, in [0, 1], in the
    order in which they are computed, each of a group (`groups`) independent of the others.
    """

    def __init__(self, groups, c, v, x, b):
        self.groups, self.c, self.v = groups, np.array(c), np.array(v)
        self.x, self.b = [np.array(row) for row in x], np.array(b)


_FORMULAS = {
    4: _Formula(
        groups=[(0,)], c=[1 / 2], v=[1 / 2], x=[[1 / 8, -1 / 8]], b=[1 / 6, 1 / 6, 2 / 3]
    ),
    6: _Formula(
        groups=[(0, 1), (2,)],
        c=[1 / 4, 3 / 4, 1 / 2],
        v=[5 / 32, 27 / 32, 1 / 2],
        x=[[9 / 64, -3 / 64], [3 / 64, -9 / 64], [-5 / 24, 5 / 24, 2 / 3, -2 / 3]],
        b=[7 / 90, 7 / 90, 16 / 45, 16 / 45, 2 / 15],
    ),
}


class Collocation(Method):
    """Mono-implicit Runge-Kutta collocation on `intervals` equal intervals.

    `order` 4 (Hermite-Simpson) or 6. The default, 12 intervals of order 6, was measured against
    20 of order 4: a quarter of the error or less (statics under gravity and curls of several
    turns, the paper's rod), in the same time or less. Raises `ValueError` for any other order, or fewer than
    one interval.
    """

    intervals: int = eqx.field(static=True, default=12)
    order: int = eqx.field(static=True, default=6)
    max_error: float = eqx.field(static=True, default=1e-3)

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

    def points(self, length) -> Float[Array, "points"]:
        """Arc lengths [m] where strains and velocities are kept: nodes and inner points."""
        inner = np.concatenate([[0.0], np.sort(self._formula.c)])
        grid = (np.arange(self.intervals)[:, None] + inner).ravel() / self.intervals
        return length * jnp.array(np.append(grid, 1.0))

    def nodes(self, points: Float[Array, "points *rest"]) -> Float[Array, "nodes *rest"]:
        """The entries that belong to nodes."""
        return points[:: self._stride]

    def outputs(self, points: Float[Array, "points *rest"]) -> Float[Array, "nodes *rest"]:
        """The nodes."""
        return self.nodes(points)

    def shape(self, strain, length, base_position, base_quaternion):
        """Positions (nodes, 3) and quaternions (nodes, 4), at the order of the method."""
        formula = self._formula
        at = np.concatenate([[0.0, 1.0], formula.c])
        order = np.argsort(at)
        return integrate_shape(
            strain, length, base_position, base_quaternion, at[order], formula.b[order]
        )

    def defects(
        self, Y: Float[Array, "nodes n"], rod: Rod, layout: Layout, history, guess
    ) -> Defects:
        """How far the states at the nodes, `Y`, are from solving the rod ODE."""
        formula, h = self._formula, rod.L / self.intervals
        s = self.points(rod.L)

        def ode(index, y):
            here = _at(history, index)
            return rod_ode(s[index], y, rod, layout, here, guess[index])

        nodes = self._node_index
        at_nodes = ode(nodes, Y)
        f = [at_nodes.y_s[:-1], at_nodes.y_s[1:]]
        inner = {}
        for group in formula.groups:
            y = [self._stage(r, Y, f, h) for r in group]
            index = np.concatenate([self._inner_index(r) for r in group])
            rates = ode(index, jnp.concatenate(y))
            m = self.intervals
            for j, r in enumerate(group):
                part = slice(j * m, (j + 1) * m)
                f.append(rates.y_s[part])
                inner[r] = (y[j], rates.strain[part], rates.solvable)
        increment = sum(b * f_r for b, f_r in zip(formula.b, f))
        solvable = at_nodes.solvable
        for _, _, ok in inner.values():
            solvable &= ok
        return Defects(
            defect=Y[1:] - Y[:-1] - h * increment,
            y=self._interleave(Y, [inner[r][0] for r in range(len(formula.c))]),
            strain=self._interleave(
                at_nodes.strain, [inner[r][1] for r in range(len(formula.c))]
            ),
            solvable=solvable,
        )

    def blocks(self, at: Defects, rod: Rod, layout: Layout, history):
        """d(defect_k)/dY_k and d(defect_k)/dY_{k+1}, each (intervals, n, n)."""
        formula, h = self._formula, rod.L / self.intervals
        A = rod_ode_jacobian(self.points(rod.L), at.y, at.strain, rod, layout, history)
        A_nodes, eye = A[self._node_index], jnp.eye(layout.size)
        # G_r = df_r/dY_k and df_r/dY_{k+1}, by the chain rule through the stages.
        by_left, by_right = [A_nodes[:-1], 0.0], [0.0, A_nodes[1:]]
        for r in range(len(formula.c)):
            A_r, x, v = A[self._inner_index(r)], formula.x[r], formula.v[r]
            left = (1 - v) * eye + h * sum(x_j * G for x_j, G in zip(x, by_left))
            right = v * eye + h * sum(x_j * G for x_j, G in zip(x, by_right))
            by_left.append(A_r @ left)
            by_right.append(A_r @ right)
        left = -eye - h * sum(b * G for b, G in zip(formula.b, by_left))
        right = eye - h * sum(b * G for b, G in zip(formula.b, by_right))
        return left, right

    def _stage(self, r, Y, f, h):
        v, x = self._formula.v[r], self._formula.x[r]
        return (1 - v) * Y[:-1] + v * Y[1:] + h * sum(a * f_j for a, f_j in zip(x, f))

    @property
    def _node_index(self):
        return np.arange(self.intervals + 1) * self._stride

    def _inner_index(self, r):
        rank = int(np.argsort(np.argsort(self._formula.c))[r])
        return np.arange(self.intervals) * self._stride + 1 + rank

    def _interleave(self, nodes, inner):
        order = np.argsort(self._formula.c)
        body = jnp.stack([nodes[:-1]] + [inner[r] for r in order], axis=1)
        return jnp.concatenate([body.reshape(-1, body.shape[-1]), nodes[-1:]])


def _at(history: History | None, index) -> History | None:
    if history is None:
        return None
    return History(history.c0, history.strain[index], history.velocity[index])
