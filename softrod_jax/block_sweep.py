"""Direct solution of the block-bidiagonal systems that both methods along the rod produce.

Each node has a = (h, q, omega), given at the base, and b = (N, M), given at the tip. For every
interval k

    left_k (da, db)_k + right_k (da, db)_{k+1} = -defect_k

with da_0 = 0 and db_n = tip_slope da_n + tip_rhs. First every interval is solved, all at once,
for what leaves it (a outwards, b inwards) in terms of what enters it:

    da_{k+1} = T11 da_k + T12 db_{k+1} + t1        db_k = T21 da_k + T22 db_{k+1} + t2

Then `db = S da + g` is swept from the tip to the base (S is the mechanical impedance of the
outboard rod: the discrete Riccati equation), and the answer from the base to the tip.
Unlike products of transfer matrices, no step of this grows with exp(lambda L).
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float


class Factors(NamedTuple):
    """What the sweeps need, for any right-hand side. `S` is the impedance seen at node k + 1."""

    inverse: Float[Array, "m n n"]  # of [right_a, left_b]
    T11: Float[Array, "m a a"]
    T12: Float[Array, "m a b"]
    S: Float[Array, "m b a"]
    W: Float[Array, "m b b"]  # (I - S T12)^-1
    inwards: Float[Array, "m b b"]  # T22 W: g_k by g_{k+1}
    V: Float[Array, "m b a"]  # W S T11: db_{k+1} by da_k
    outwards: Float[Array, "m a a"]  # T11 + T12 V: da_{k+1} by da_k


def factorise(
    left: Float[Array, "m n n"], right: Float[Array, "m n n"], tip_slope: Float[Array, "b a"]
) -> Factors:
    """Prepare the sweeps. `tip_slope`: (b, a)."""
    b, a = tip_slope.shape
    inverse = _inverse(jnp.concatenate([right[..., :a], left[..., a:]], -1))
    T = -inverse @ jnp.concatenate([left[..., :a], right[..., a:]], -1)
    T11, T12, T21, T22 = T[:, :a, :a], T[:, :a, a:], T[:, a:, :a], T[:, a:, a:]

    def inwards(S, T):
        T11, T12, T21, T22 = T
        W = _inverse(jnp.eye(b) - S @ T12)
        V = W @ (S @ T11)
        return T21 + T22 @ V, (S, W, V)

    _, (S, W, V) = jax.lax.scan(inwards, tip_slope, (T11, T12, T21, T22), reverse=True)
    return Factors(inverse, T11, T12, S, W, T22 @ W, V, T11 + T12 @ V)


def _inverse(A: Float[Array, "*batch n n"]):
    """By LU with partial pivoting; jnp.linalg.inv compiles to three times as much."""
    lu, _, order = jax.lax.linalg.lu(A)
    permutation = (order[..., :, None] == jnp.arange(A.shape[-1])).astype(A.dtype)
    y = jax.lax.linalg.triangular_solve(
        lu, permutation, left_side=True, lower=True, unit_diagonal=True
    )
    return jax.lax.linalg.triangular_solve(lu, y, left_side=True, lower=False)


def has_no_conjugate_point(factors: Factors):
    """Whether a static equilibrium under dead loads is stable.

    It is if and only if the second variation has no conjugate point: swept from the free tip,
    no disturbance of the attitude vanishes before the clamp (Jacobi's condition). Disturbances
    of two nodes are related by (I - T12 S)^-1 T11; one vanishes in between where I - T12 S has
    a negative eigenvalue. Its eigenvalues are real (it is similar to a symmetric matrix), so
    all are positive if and only if all their elementary symmetric polynomials are. The sign of
    the determinant alone would miss a column that buckles in two planes at once.
    """
    if factors.T11.shape[-1] == 0:
        return jnp.array(True)  # nothing depends on the attitude
    G = jnp.eye(factors.T11.shape[-1]) - factors.T12 @ factors.S
    # Newton's identities: from the traces of powers to the elementary polynomials.
    power, traces, e = G, [], [1.0]
    for k in range(1, G.shape[-1] + 1):
        traces.append(jnp.trace(power, axis1=-2, axis2=-1))
        e.append(sum((-1) ** i * e[k - 1 - i] * traces[i] for i in range(k)) / k)
        power = power @ G
    return jnp.all(jnp.stack(e[1:]) > 0)


def solve_sweeps(
    factors: Factors, defect: Float[Array, "m n"], tip_rhs: Float[Array, "b"]
) -> Float[Array, "nodes n"]:
    """(da, db) at every node; linear in (defect, tip_rhs)."""
    a = factors.T11.shape[-1]
    t = -apply_each(factors.inverse, defect)
    t1, t2 = t[:, :a], t[:, a:]

    # One small product a node in turn; all else for all nodes at once.
    def sweep(x, k):
        matrix, rhs = k
        return matrix @ x + rhs, x

    loads = t2 + apply_each(factors.inwards, apply_each(factors.S, t1))
    g0, g = jax.lax.scan(sweep, tip_rhs, (factors.inwards, loads), reverse=True)
    V0 = apply_each(factors.W, apply_each(factors.S, t1) + g)
    shifts = t1 + apply_each(factors.T12, V0)
    base = jnp.zeros(a, defect.dtype)
    da_n, da = jax.lax.scan(sweep, base, (factors.outwards, shifts))
    db = apply_each(factors.V, da) + V0
    return jnp.concatenate(
        [jnp.concatenate([da, da_n[None]]), jnp.concatenate([g0[None], db])], -1
    )


def apply_each(
    matrices: Float[Array, "m i j"], vectors: Float[Array, "m j"]
) -> Float[Array, "m i"]:
    """The product of each matrix and its vector."""
    return jnp.einsum("kij,kj->ki", matrices, vectors)
