"""SDIRK: one-step schemes of order 2 to 4, with several solves along the rod a step."""

import itertools
import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from softrod_jax.foundation.products import weighted_sum
from softrod_jax.stepping.scheme import AbstractTimeScheme, LocalErrors, combine


def _four_stages(gamma, c2, c3) -> list[list[float]]:
    """The SDIRK table of order 3 with these times of its inner stages, stiffly accurate."""
    c = np.array([gamma, c2, c3])
    b1, b2, b3 = np.linalg.solve(np.vander(c, 3, increasing=True).T, 1 / np.arange(1, 4) - gamma)
    # What is left of sum_i b_i (A c)_i = 1/6 for a_32.
    rest = gamma * c @ [b1, b2, b3] * 2 + gamma**2
    rest += gamma * (b2 * (c2 - gamma) + b3 * (c3 - gamma))
    a32 = (1 / 6 - rest) / (b3 * (c2 - gamma))
    return [
        [gamma],
        [c2 - gamma, gamma],
        [c3 - gamma - a32, a32, gamma],
        [b1, b2, b3, gamma],
    ]


# By order and stages.
_SDIRK = {
    (2, 2): [[1 - 0.5**0.5], [0.5**0.5, 1 - 0.5**0.5]],
    # L-stable from gamma = 0.22364780 on, where its error is least. Inner stages close to each
    # other cost little: one is the next one's guess.
    (3, 4): _four_stages(0.22365, 0.7, 0.74),
    # Fitted: of those that are L-stable the least error a solve on a rod that gravity swings.
    (3, 6): [
        [0.18761325743538215],
        [0.34766277384698197, 0.18761325743538215],
        [0.1332067842133751, 0.4365125713192045, 0.18761325743538215],
        [0.44154700310358447, 0.24828561204410332, -0.1695694739382076, 0.18761325743538215],
        [
            0.43747733917359516, 0.18535316390463213, -0.20219307160012945,
            0.16502706644991894, 0.18761325743538215,
        ],
        [
            0.3819108022222655, 0.27581270101298955, -0.02191426857529328,
            0.41050805505264076, -0.23393054714798464, 0.18761325743538215,
        ],
    ],
    (4, 5): [
        [1 / 4],
        [1 / 2, 1 / 4],
        [17 / 50, -1 / 25, 1 / 4],
        [371 / 1360, -137 / 2720, 15 / 544, 1 / 4],
        [25 / 24, -49 / 48, 125 / 16, -85 / 12, 1 / 4],
    ],
}  # fmt: skip


# Weights w_0, w_i of the rates at the beginning of a step and in its stages: dt sum_i w_i k_i is a
# difference of high order, for it vanishes with sum w = w c = w A c = 0 (of order 2 without the
# last, of order 4 with w A A c = 0, too). Where an oscillation turns by x in a step, it is |E(ix)|,
# E(z) = z (w_0 + w (1 - z A)^-1 1), times the amplitude. The error is that of the stability
# function, |R(ix) - exp(ix)|, the whole amplitude at most. What freedom is left was used to bring E
# close to it: 0.4 to 1.7 times, for x up to 5; beyond, the difference to a lower order is near 1.
_DIFFERENCE = {
    (2, 2): (-0.47141430298417336, 0.6666805007768773, -0.195266197792704),
    (3, 4): (
        -0.25176320428344423, 0.4429084790518536, -0.3570878696986099, 0.057836798004311206,
        0.10810579692588937,
    ),
    (3, 6): (
        0.0, -0.02052638261582311, -0.0047693427133023575, 0.05113239517150859,
        0.005953274474261432, 0.02092662889418806, -0.052716573210832646,
    ),
    (4, 5): (
        0.28956089390661494, -0.606394593470524, -0.016911034654919242, 1.0918007640600536,
        -0.6436950679340316, -0.11436096190719308,
    ),
}  # fmt: skip


class SDIRK(AbstractTimeScheme):
    """Stiffly accurate, L-stable SDIRK of order 2 (Alexander 1977), 3, or 4 (Hairer & Wanner,
    Solving ODEs II, table IV.6.5); 2, 4 and 5 solves along the rod a step.

    Order 3, the default, has one stage more than it needs, and its error is then that of order 4
    at the same step: where steps resolve a motion, what counts is the error of high order. With
    `stages=6` steps can be longer by more than half, with less error at almost the same cost in
    motions that swing: at 1/33 s a tenth of that of `BDFAlpha(-0.45)` at 5 ms.
    One-step: a jump of an input costs no accuracy. All stages share c0 = 1/(gamma dt). The local
    error is the difference to the scheme of one order less with the same stages but the last.
    Newton's method starts from a polynomial through up to three earlier stages.
    Raises `ValueError` for another order, or number of stages.
    """

    order: int = eqx.field(static=True)
    stages: int = eqx.field(static=True)
    one_step: bool = eqx.field(static=True, default=True, init=False)

    def __init__(self, order: int = 3, stages: int | None = None):
        offered = [s for o, s in _SDIRK if o == order]
        if not offered:
            raise ValueError(f"SDIRK: order={order!r} is not offered; use 2, 3 or 4")
        if stages is not None and stages not in offered:
            raise ValueError(f"SDIRK: stages={stages!r}; of order {order} there are {offered}")
        self.order = order
        self.stages = offered[0] if stages is None else stages

    def _table(self, diagonal: bool) -> np.ndarray:
        rows = _SDIRK[self.order, self.stages]
        table = np.zeros((len(rows), len(rows)))
        for i, row in enumerate(rows):
            count = len(row) - (not diagonal)
            table[i, :count] = row[:count]
        return table

    def coefficients(self, dt, restart):
        """The length of each step, and whether its first guess may be extrapolated."""
        smooth = jnp.where(restart, 0.0, 1.0)
        return jnp.stack([jnp.broadcast_to(dt, restart.shape), smooth], axis=-1)

    def start(self, y, guess):
        before = jax.tree.map(lambda x: jnp.stack([x] * (self.stages + 1)), guess)
        return y, before, jnp.ones(()), jax.tree.map(jnp.zeros_like, y)

    def step(self, memory, coefficients, solve, carry):
        (y0, before, dt_before, first_rate), (dt, smooth) = memory, coefficients
        table, at = self._table(diagonal=False), self._table(diagonal=True).sum(1)
        c0 = 1 / (_SDIRK[self.order, self.stages][0][0] * dt)
        weighted = lambda w, tree: jax.tree.map(lambda k: weighted_sum(w, k), tree)
        keep = lambda tree, i, new: jax.tree.map(lambda k, x: k.at[i].set(x), tree, new)

        # A scan and not a Python loop: the solve along the rod is compiled once.
        def stage(state, row):
            y, rates, guesses, carry, i = state
            weights, c, predictor = row
            history = combine((-c0, y0), (-c0 * dt, weighted(weights, rates)))
            guess = weighted(predictor, guesses)
            y, carry = solve(c0, history, c, carry._replace(guess=guess))
            rates = keep(rates, i, combine((c0, y), (1.0, history)))
            guesses = keep(guesses, i + 1, carry.guess)
            return (y, rates, guesses, carry, i + 1), None

        none = lambda tree, n: jax.tree.map(lambda x: jnp.zeros((n, *x.shape)), tree)
        # The first stage starts where the stages of the step before lead to, no further ahead
        # than one of that step's; after a jump of an input, where that step ended.
        ahead = at[0] * smooth * jnp.minimum(dt / dt_before, 1.0)
        first = weighted(_extrapolate(at, ahead), before)
        guesses = keep(keep(none(first, self.stages + 2), 0, carry.guess), -1, first)
        rows = jnp.array(table), jnp.array(at), jnp.array(_predictors(at))
        start = (y0, none(y0, self.stages), guesses, carry, 0)
        (y, rates, guesses, carry, _), _ = jax.lax.scan(stage, start, rows)
        before = jax.tree.map(lambda k: k[:-1], guesses)
        # What estimates need has no derivative.
        rates = jax.lax.stop_gradient(rates)
        errors = self._local_errors(dt, first_rate, rates)
        return (y, before, dt, jax.tree.map(lambda k: k[-1], rates)), carry, errors

    def _local_errors(self, dt, first_rate, rates) -> LocalErrors:
        times = lambda w: jax.tree.map(lambda k: dt * weighted_sum(w, k), rates)
        lower, (w_0, *w) = self._error_weights(), _DIFFERENCE[self.order, self.stages]
        return LocalErrors(
            times(lower),
            # A stage's value is y0 + dt sum_j a_ij k_j, and the weights' sum is zero.
            times(dt * (lower @ self._table(diagonal=True))),
            combine((dt * w_0, first_rate), (1.0, times(np.array(w)))),
        )

    def _error_weights(self) -> np.ndarray:
        """b minus weights of one order less, which leave the last stage out."""
        A = self._table(diagonal=True)
        c = A.sum(1)
        conditions = {2: 1, 3: 2, 4: 4}[self.order]
        left = np.stack([np.ones_like(c), c, c**2, A @ c])[:conditions, : self.stages - 1]
        right = np.array([1, 1 / 2, 1 / 3, 1 / 6])[:conditions]
        return A[-1] - np.append(np.linalg.lstsq(left, right, rcond=None)[0], 0.0)


def _predictors(at) -> np.ndarray:
    """Weights (stages, stages + 2) of the start, the stages before each, and the first guess.

    The first stage has only the last; the others a polynomial through up to three earlier times.
    """
    times = np.concatenate([[0.0], at])
    rows = np.zeros((len(at), len(at) + 2))
    rows[0, -1] = 1.0
    for i, c in enumerate(at[1:], 1):
        chosen = _steadiest(times, itertools.combinations(range(i + 1), min(3, i + 1)), c)
        rows[i, chosen] = _lagrange(times[chosen], c)
    return rows


def _extrapolate(at, ahead):
    """Weights (stages + 1,) of a step's start and stages, `ahead` of its end, in such steps."""
    times = np.concatenate([[0.0], at]) - 1
    end = len(at)
    pairs = itertools.combinations(range(end), min(2, end))
    chosen = _steadiest(times, [(*pair, end) for pair in pairs], at[0])
    weights = jnp.stack(_lagrange(times[chosen], ahead))
    return jnp.zeros(end + 1).at[np.array(chosen)].set(weights)


def _steadiest(times, choices, t) -> list[int]:
    """Of these choices of times the one with the smallest weights at `t`."""
    return min(map(list, choices), key=lambda k: sum(map(abs, _lagrange(times[k], t))))


def _lagrange(times, t) -> list:
    """Weights of values at `times` for the value at `t` of the polynomial through them."""
    return [
        math.prod((t - other) / (time - other) for other in times if other != time)
        for time in times
    ]
