"""Time schemes: how `y_t = c0 y + y_h` follows from earlier steps.

A scheme turns one time step into one or more solves along the rod, each with its own `c0` and
history `y_h`. What it advances is a pytree of fields (strains and velocities at the points of
the method along the rod), so that the history is kept at the order of that method.
"""

import abc
from typing import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float


def _combine(*terms):
    """sum of coefficient * tree."""
    first, *rest = [jax.tree.map(lambda x, c=c: c * x, tree) for c, tree in terms]
    for term in rest:
        first = jax.tree.map(jnp.add, first, term)
    return first


class TimeScheme(eqx.Module):
    """`start` makes a memory from the initial fields, `step` advances it."""

    stages: eqx.AbstractVar[int]
    order: eqx.AbstractVar[int]

    @abc.abstractmethod
    def coefficients(self, dt, restart: Bool[Array, "steps"]):
        """Coefficients of every step, (steps, ...): what `step` gets row by row.

        `restart`: whether an input jumps at the beginning of the step.
        """

    @abc.abstractmethod
    def start(self, y):
        """Memory of a rod at rest with the fields `y`."""

    @abc.abstractmethod
    def step(self, memory, coefficients, solve: Callable, carry):
        """One step: `solve(c0, y_h, carry) -> (y, carry)` for each stage in turn.

        Returns the memory and the carry after the step.
        """


class BDFAlpha(TimeScheme):
    """BDF-alpha (paper eq. 14 and 15): alpha = 0 is BDF2, alpha = -0.5 the trapezoidal rule.

    Second order. The step after a jump of an input is one of backward Euler: with the history
    of before the jump, the scheme is of first order from there on, for every alpha.
    Raises `ValueError` unless -0.5 <= alpha <= 0.
    """

    alpha: float = eqx.field(static=True, default=-0.45)
    stages: int = eqx.field(static=True, default=1, init=False)
    order: int = eqx.field(static=True, default=2, init=False)

    def __check_init__(self):
        if not -0.5 <= self.alpha <= 0:
            raise ValueError(f"BDFAlpha: alpha={self.alpha!r} is outside [-0.5, 0]")

    def coefficients(self, dt, restart):
        a = self.alpha
        c0 = (1.5 + a) / (dt * (1 + a))
        c2 = (0.5 + a) / (dt * (1 + a))
        regular = jnp.stack([c0, -2 / dt, c2, a / (1 + a) * jnp.ones_like(c0)])
        euler = jnp.stack([1 / dt, -1 / dt, 0 * dt, 0 * dt])
        return jnp.where(restart[:, None], euler, regular)

    def start(self, y):
        return y, y, jax.tree.map(jnp.zeros_like, y)

    def step(self, memory, coefficients, solve, carry):
        y1, y2, y1_t = memory
        c0, c1, c2, d1 = coefficients
        history = _combine((c1, y1), (c2, y2), (d1, y1_t))
        y, carry = solve(c0, history, carry)
        return (y, y1, _combine((c0, y), (1.0, history))), carry


_GAMMA_3 = 0.43586652150845899942  # root of x^3 - 3 x^2 + 3/2 x - 1/6 between 1/6 and 1/2
_SDIRK = {
    2: [[1 - 0.5**0.5], [0.5**0.5, 1 - 0.5**0.5]],
    3: [
        [_GAMMA_3],
        [(1 - _GAMMA_3) / 2, _GAMMA_3],
        [
            -(6 * _GAMMA_3**2 - 16 * _GAMMA_3 + 1) / 4,
            (6 * _GAMMA_3**2 - 20 * _GAMMA_3 + 5) / 4,
            _GAMMA_3,
        ],
    ],
    4: [
        [1 / 4],
        [1 / 2, 1 / 4],
        [17 / 50, -1 / 25, 1 / 4],
        [371 / 1360, -137 / 2720, 15 / 544, 1 / 4],
        [25 / 24, -49 / 48, 125 / 16, -85 / 12, 1 / 4],
    ],
}


class SDIRK(TimeScheme):
    """Stiffly accurate, L-stable SDIRK of order 2, 3 (Alexander 1977) or 4 (Hairer & Wanner,
    Solving ODEs II, table IV.6.5); 2, 3 and 5 solves along the rod a step.

    One-step: a jump of an input costs no accuracy. All stages share c0 = 1/(gamma dt).
    Raises `ValueError` for another order.
    """

    order: int = eqx.field(static=True, default=4)

    def __check_init__(self):
        if self.order not in _SDIRK:
            raise ValueError(f"SDIRK: order={self.order!r} is not offered; use 2, 3 or 4")

    @property
    def stages(self) -> int:
        return len(_SDIRK[self.order])

    def coefficients(self, dt, restart):
        return jnp.broadcast_to(dt, restart.shape)

    def start(self, y):
        return (y,)

    def step(self, memory, coefficients, solve, carry):
        (y0,), dt, rows = memory, coefficients, _SDIRK[self.order]
        stages, gamma = len(rows), rows[0][0]
        table = np.zeros((stages, stages))
        for i, row in enumerate(rows):
            table[i, : len(row) - 1] = row[:-1]
        c0 = 1 / (gamma * dt)

        # A scan and not a Python loop: the solve along the rod is compiled once.
        def stage(state, row):
            y, rates, carry, i = state
            past = jax.tree.map(lambda k: jnp.tensordot(row, k, 1), rates)
            history = _combine((-c0, y0), (-1 / gamma, past))
            y, carry = solve(c0, history, carry)
            y_t = _combine((c0, y), (1.0, history))
            rates = jax.tree.map(lambda k, new: k.at[i].set(new), rates, y_t)
            return (y, rates, carry, i + 1), None

        none = jax.tree.map(lambda x: jnp.zeros((stages, *x.shape)), y0)
        (y, _, carry, _), _ = jax.lax.scan(stage, (y0, none, carry, 0), jnp.array(table))
        return (y,), carry


def jumps(inputs: Float[Array, "steps channels"]) -> Bool[Array, "steps"]:
    """Whether an input jumps at the beginning of each step; the first step always counts.

    A jump changes an input by over 2 % of its range, and by over three times as much as the
    steps before and after it do: samples of a ramp, however steep, are not jumps.
    """
    if inputs.shape[0] == 1:
        return jnp.ones(1, dtype=bool)
    change = jnp.abs(jnp.diff(inputs, axis=0))
    range_ = jnp.max(inputs, axis=0) - jnp.min(inputs, axis=0)
    edge = jnp.zeros_like(change[:1])
    before, after = jnp.concatenate([edge, change[:-1]]), jnp.concatenate([change[1:], edge])
    jump = (change > 3 * jnp.maximum(before, after)) & (change > 0.02 * range_)
    return jnp.concatenate([jnp.ones(1, dtype=bool), jnp.any(jump, axis=1)])
