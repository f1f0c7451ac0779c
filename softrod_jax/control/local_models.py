"""A linear model as a predictive controller has it: its observer, and the outputs to come."""

from typing import NamedTuple

import numpy as np
import scipy.linalg
from jaxtyping import Array, Float

from softrod_jax.analysis.linear import LinearModel


class Local(NamedTuple):
    """One model, discrete in time, with its observer; stacked, all of them.

    x(k + 1) = F x(k) + G (u(k) + u(k + 1)) / 2, as inputs are ramps; y(k) = C x(k) + D u(k). The
    disturbances are the last entries of x. All are differences to the equilibrium, `u0` and `y0`.
    `gain`: of the observer. The outputs to come, (ahead p,), are `free` times x and the last input
    that is decided on, and `forced` times the corners of the polygon, (corners m,).
    `still`: the static gain.
    """

    F: Float[Array | np.ndarray, "*models n n"]
    G: Float[Array | np.ndarray, "*models n m"]
    C: Float[Array | np.ndarray, "*models p n"]
    D: Float[Array | np.ndarray, "*models p m"]
    gain: Float[Array | np.ndarray, "*models n p"]
    u0: Float[Array | np.ndarray, "*models m"]
    y0: Float[Array | np.ndarray, "*models p"]
    free: Float[Array | np.ndarray, "*models seen state"]
    forced: Float[Array | np.ndarray, "*models seen decided"]
    still: Float[Array | np.ndarray, "*models p m"]


def local_model(model: LinearModel, outputs: list[int], how, seen, between) -> Local:
    """`how`: the cycle, the noise, the drift; `seen`: which cycles of the horizon count."""
    dt, noise, drift = how
    F, G = (np.asarray(x) for x in model.discrete(dt))
    C, D = np.asarray(model.C)[outputs], np.asarray(model.D)[outputs]
    n, m, p = len(F), G.shape[1], len(outputs)
    F = np.asarray(scipy.linalg.block_diag(F, np.eye(p)), dtype=float)
    G, C = np.concatenate([G, np.zeros((p, m))]), np.concatenate([C, np.eye(p)], 1)
    # What shakes the states comes in as inputs do, as much of it as moves the outputs by `drift`.
    still = np.asarray(model.static_gain)[outputs]
    static = np.linalg.norm(still, axis=0)
    moves = static > 1e-12 * static.max()
    shaken = G[:n] * np.where(moves, drift / np.where(moves, static, 1.0), 0.0)
    Q = scipy.linalg.block_diag(
        shaken @ shaken.T + 1e-12 * noise**2 * np.eye(n), drift**2 * dt * np.eye(p)
    )
    P = scipy.linalg.solve_discrete_are(F.T, C.T, Q, noise**2 * np.eye(p))
    gain = np.linalg.solve(C @ P @ C.T + noise**2 * np.eye(p), C @ P).T
    steps, corners = between.shape
    # The state after each step, by the state, the last input and the corners.
    by = np.concatenate([np.eye(n + p), np.zeros((n + p, m + corners * m))], 1)
    inputs = np.zeros((steps + 1, m, by.shape[1]))
    inputs[0, :, n + p : n + p + m] = np.eye(m)
    inputs[1:, :, n + p + m :] = np.kron(between, np.eye(m)).reshape(steps, m, corners * m)
    rows = []
    for k in range(1, steps + 1):
        by = F @ by + G @ (0.5 * (inputs[k - 1] + inputs[k]))
        if k in seen:
            rows.append(C @ by + D @ inputs[k])
    rows = np.concatenate(rows)
    u0, y0 = np.asarray(model.u0), np.asarray(model.y0)[outputs]
    return Local(F, G, C, D, gain, u0, y0, rows[:, : n + p + m], rows[:, n + p + m :], still)


def polygon(steps: int, corners: int) -> np.ndarray:
    """(steps, corners): inputs after each step from corners, closer together at first."""
    at = 1 + (steps - 1) * (np.arange(corners) / max(corners - 1, 1)) ** 2
    k = np.arange(1, steps + 1)
    return np.stack([np.interp(k, at, row) for row in np.eye(corners)], 1)


def spacing(y0: np.ndarray) -> float:
    """How far equilibria are from their nearest neighbours, half the median."""
    apart = np.linalg.norm(y0[:, None] - y0[None], axis=2) + np.diag(np.full(len(y0), np.inf))
    return max(0.5 * float(np.median(apart.min(1))), 1e-9) if len(y0) > 1 else 1.0
