"""BDF-alpha, the multistep scheme of the paper: one solve along the rod a step."""

import equinox as eqx
import jax
import jax.numpy as jnp

from softrod_jax.stepping.scheme import AbstractTimeScheme, LocalErrors, combine


class BDFAlpha(AbstractTimeScheme):
    """BDF-alpha (paper eq. 14 and 15): alpha = 0 is BDF2, alpha = -0.5 the trapezoidal rule.

    Second order. The step after a jump of an input is one of backward Euler: with the history
    of before the jump, the scheme is of first order from there on, for every alpha.
    Raises `ValueError` unless -0.5 <= alpha <= 0.
    """

    alpha: float = eqx.field(static=True, default=-0.45)
    stages: int = eqx.field(static=True, default=1, init=False)
    order: int = eqx.field(static=True, default=2, init=False)
    one_step: bool = eqx.field(static=True, default=False, init=False)

    def __check_init__(self):
        if not -0.5 <= self.alpha <= 0:
            raise ValueError(f"BDFAlpha: alpha={self.alpha!r} is outside [-0.5, 0]")

    def coefficients(self, dt, restart):
        a = self.alpha
        c0 = (1.5 + a) / (dt * (1 + a))
        c2 = (0.5 + a) / (dt * (1 + a))
        one = jnp.ones_like(c0)
        # The last one: how far Newton's guess is extrapolated, in steps.
        regular = jnp.stack([c0, -2 / dt, c2, a / (1 + a) * one, one])
        euler = jnp.stack([1 / dt, -1 / dt, 0 * one, 0 * one, 0 * one])
        return jnp.where(restart[:, None], euler, regular)

    def start(self, y, guess):
        return y, y, jax.tree.map(jnp.zeros_like, y), guess, jax.lax.stop_gradient(y)

    def step(self, memory, coefficients, solve, carry):
        y1, y2, y1_t, before, y3 = memory
        c0, c1, c2, d1, ahead = coefficients
        last = carry.guess
        guess = jax.tree.map(lambda a, b: a + ahead * (a - b), last, before)
        history = combine((c1, y1), (c2, y2), (d1, y1_t))
        y, carry = solve(c0, history, 1.0, carry._replace(guess=guess))
        # C dt^3 y_ttt, with the C of a rate: d1 takes over the error of the rate before.
        C = 1 / 3 + self.alpha / 2
        third = combine((C, y), (-3 * C, y1), (3 * C, y2), (-C, y3))
        # That of backward Euler, dt^2 y_tt / 2; its c1 is -1 / dt.
        second = combine((0.5, y), (-0.5, y1), (0.5 / c1, y1_t))
        local = jax.tree.map(lambda a, b: jnp.where(ahead == 0, a, b), second, third)
        older = jax.lax.stop_gradient(y2)
        memory = (y, y1, combine((c0, y), (1.0, history)), last, older)
        return memory, carry, LocalErrors(difference=local)
