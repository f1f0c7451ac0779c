"""Fewer states for a linear model: those that matter to its outputs, or the slowest.

The model is E x_t = x + B u, y = C x + D u with a singular E. Its finite poles are 1 / mu, with the
eigenvalues mu of E that are not zero; all that is left of the others is what follows u at once.
"""

from typing import Any, NamedTuple

import numpy as np
import scipy.linalg
from jaxtyping import Float

# Poles that are this many times faster than the slowest one are taken to follow at once, from where
# between these bounds the gap between two is largest. E is nilpotent in what follows at once, so
# that rounding makes eigenvalues of 1e-8 of the largest there.
_FAST = 1e4, 1e7
# Of Hankel singular values, relative to the largest: below is rounding.
_NOTHING = 1e-13
# Of the sizes of outputs, or inputs, in the static gain, relative to the largest: likewise.
_NO_GAIN = 1e-10
# What decays more slowly than this part of the slowest motion is not damped.
_UNDAMPED = 1e-3
# Poles that grow and are this many times faster than the slowest one are the grid's.
_GRID = 100.0

Matrix = Float[np.ndarray, "_ _"]


class StateSpace(NamedTuple):
    """x_t = A x + B u, y = C x + D u."""

    A: Matrix
    B: Matrix
    C: Matrix
    D: Matrix


def slowest(E: Matrix, B: Matrix, C: Matrix, D: Matrix, states: int) -> StateSpace:
    """The part with the slowest poles: `states` of them, or one less, for pairs stay together.

    What is faster follows at once, so that the static gain stays. Raises `ValueError` where there
    are not so many poles, or where the slowest are a pair and one is asked for.
    """
    size = _sizes(E)
    if states >= len(size):
        raise ValueError(f"states={states}; the model has {len(size)} poles, take fewer")
    for k in range(states, 0, -1):
        if size[k] < size[k - 1] * (1 - 1e-9):
            return _part(E, B, C, D, np.sqrt(size[k] * size[k - 1]))
    raise ValueError(f"states={states}; the slowest poles come together, take more")


def balanced(E: Matrix, B: Matrix, C: Matrix, D: Matrix, states: int) -> StateSpace:
    """The part that inputs reach and outputs see most, by balanced residualisation.

    Moore (IEEE Trans. Autom. Control 26, 1981) for the states; those that are left out follow at
    once (Liu & Anderson, Int. J. Control 50, 1989), so that the static gain stays. Inputs and
    outputs count by their sizes in the static gain. What does not decay is seen through a window
    that does, of the length of the slowest motion.
    """
    whole = _part(E, B, C, D, _limit(E))
    poles = np.linalg.eigvals(whole.A)
    slow, worst = np.min(np.abs(poles)), np.max(poles.real)
    window = max(0.0, worst + 0.1 * slow) if worst > -_UNDAMPED * slow else 0.0
    A = whole.A - window * np.eye(len(whole.A))
    gain = np.abs(D - C @ B)
    # What does not follow by symmetry does not count: its size is that of rounding.
    nonzero = lambda x: np.where(x > _NO_GAIN * np.max(x), x, np.max(x) or 1.0)
    of_outputs = nonzero(gain.max(1))
    of_inputs = nonzero((gain / of_outputs[:, None]).max(0))
    inputs, outputs = whole.B / of_inputs, whole.C / of_outputs[:, None]
    P = scipy.linalg.solve_continuous_lyapunov(A, -inputs @ inputs.T)
    Q = scipy.linalg.solve_continuous_lyapunov(A.T, -outputs.T @ outputs)
    reach, sight = _root(P), _root(Q)
    U, hankel, Vt = np.linalg.svd(sight.T @ reach)
    count = int(np.sum(hankel > _NOTHING * hankel[0]))
    root = np.sqrt(hankel[:count])
    V, W = reach @ Vt[:count].T / root, sight @ U[:, :count] / root
    A, B, C = W.T @ whole.A @ V, W.T @ whole.B, whole.C @ V
    r = min(states, count)
    if r == count:
        return StateSpace(A, B, C, whole.D)
    fast = np.linalg.solve(A[r:, r:], np.concatenate([A[r:, :r], B[r:]], 1))
    by_slow, by_input = fast[:, :r], fast[:, r:]
    return StateSpace(
        A[:r, :r] - A[:r, r:] @ by_slow,
        B[:r] - A[:r, r:] @ by_input,
        C[:, :r] - C[:, r:] @ by_slow,
        whole.D - C[:, r:] @ by_input,
    )


def _limit(E: Matrix) -> float:
    """How large an eigenvalue is at least of what is not taken to follow at once."""
    size = _sizes(E)
    gaps = np.where(size[1:] < size[0] / _FAST[0], size[:-1] / size[1:], 0.0)
    # A grid holds no wave that is shorter than its points are apart: such ones may grow.
    poles = 1 / (mu := np.linalg.eigvals(E))[np.abs(mu) >= size[-1]]
    grown = np.abs(poles)[(poles.real > 0) & (np.abs(poles) > _GRID * np.min(np.abs(poles)))]
    if len(grown):
        allowed = size[1:] > (1 + 1e-9) / np.min(grown)
        gaps = np.where(allowed & (size[:-1] > (1 + 1e-9) * size[1:]), 1.0, 0.0)
        gaps = gaps * np.arange(1, len(size))  # the fastest of these
    k = 1 + int(np.argmax(gaps)) if np.any(gaps) else len(size)
    return np.sqrt(size[k] * size[k - 1]) if k < len(size) else 0.5 * size[-1]


def _sizes(E: Matrix):
    """Those of the eigenvalues that are not zero, from the largest."""
    size = np.sort(np.abs(np.linalg.eigvals(E)))[::-1]
    return size[size > size[0] / _FAST[1]]


def _part(E, B, C, D, limit: float) -> StateSpace:
    """The part with eigenvalues above `limit`, from an ordered Schur form.

    It does not mind eigenvalues that coincide. All else follows at once.
    """
    form: Any = scipy.linalg.schur(E, sort=lambda x, y: np.hypot(x, y) > limit)
    T, Z, k = form
    V = Z[:, :k]
    # x = V z + what is fast; W leaves that out.
    W = V.T - scipy.linalg.solve_sylvester(T[:k, :k], -T[k:, k:], -T[:k, k:]) @ Z[:, k:].T
    A, of_slow = np.linalg.inv(T[:k, :k]), W @ B
    return StateSpace(A, A @ of_slow, C @ V, D - C @ (B - V @ of_slow))


def _root(P: Matrix) -> Matrix:
    """L with L L^T = P, which is symmetric and, up to rounding, not negative."""
    values, vectors = np.linalg.eigh(0.5 * (P + P.T))
    return vectors * np.sqrt(np.maximum(values, 0.0))
