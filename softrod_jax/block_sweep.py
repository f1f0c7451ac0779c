"""Direct solution of the block-bidiagonal systems that both methods along the rod produce.

Each node has a = (h, q, omega), given at the base, and b = (N, M), given at the tip. For every
interval k

    left_k (da, db)_k + right_k (da, db)_{k+1} = -defect_k

with da_0 = 0 and db_n = tip_slope da_n + tip_rhs. From the tip to the base, `db_{k+1} = S_{k+1}
da_{k+1} + g_{k+1}` is put into the equations of interval k, and they are solved for what leaves
it (a outwards, b inwards) in terms of what enters it:

    (db_k, da_{k+1}) = -K_k (left_a da_k + right_b g_{k+1} + defect_k),
    K_k = [left_b, right_a + right_b S_{k+1}]^-1

which gives S_k and g_k. S is the mechanical impedance of the outboard rod, and its recursion the
discrete Riccati equation. The answer follows from the base to the tip. Unlike products of
transfer matrices, no step of this grows with exp(lambda L).
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float


class Factors(NamedTuple):
    """What the sweeps need, for any right-hand side. `S` is the impedance seen at node k + 1."""

    K: Float[Array, "m n n"]
    right: Float[Array, "m n n"]
    S: Float[Array, "m b a"]
    inwards: Float[Array, "m b b"]  # g_k by g_{k+1}
    shift: Float[Array, "m a b"]  # da_{k+1} by g_{k+1}
    outwards: Float[Array, "m a a"]  # da_{k+1} by da_k


def factorise(
    left: Float[Array, "m n n"], right: Float[Array, "m n n"], tip_slope: Float[Array, "b a"]
) -> Factors:
    """Prepare the sweeps."""
    b, a = tip_slope.shape

    def inwards(S, interval):
        left, right = interval
        K = _inverse(jnp.concatenate([left[:, a:], right[:, :a] + right[:, a:] @ S], -1))
        out = -K @ jnp.concatenate([left[:, :a], right[:, a:]], -1)
        return out[:b, :a], (S, K, out)

    _, (S, K, out) = jax.lax.scan(inwards, tip_slope, (left, right), reverse=True)
    return Factors(K, right, S, out[:, :b, a:], out[:, b:, a:], out[:, b:, :a])


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
    no disturbance of the attitude vanishes before the clamp (Jacobi's condition). With T_12 the
    da_{k+1} by db_{k+1} of one interval, disturbances of two nodes are related by
    G = (I - T_12 S)^-1; one vanishes in between where G has a negative eigenvalue. Its
    eigenvalues are real (it is similar to a symmetric matrix), so all are positive if and only
    if all their elementary symmetric polynomials are. The sign of the determinant alone would
    miss a column that buckles in two planes at once.
    """
    b, a = factors.S.shape[1:]
    if a == 0:
        return jnp.array(True)  # nothing depends on the attitude
    G = factors.K[:, b:] @ factors.right[:, :, :a]
    # Newton's identities: from the traces of powers to the elementary polynomials.
    power, traces, e = G, [], [1.0]
    for k in range(1, a + 1):
        traces.append(jnp.trace(power, axis1=-2, axis2=-1))
        e.append(sum((-1) ** i * e[k - 1 - i] * traces[i] for i in range(k)) / k)
        power = power @ G
    return jnp.all(jnp.stack(e[1:]) > 0)


def solve_sweeps(
    factors: Factors, defect: Float[Array, "m n"], tip_rhs: Float[Array, "b"]
) -> Float[Array, "nodes n"]:
    """(da, db) at every node; linear in (defect, tip_rhs)."""
    b, a = factors.S.shape[1:]
    t = -apply_each(factors.K, defect)

    # One small product a node in turn; all else for all nodes at once.
    def sweep(x, k):
        matrix, rhs = k
        return matrix @ x + rhs, x

    g0, g = jax.lax.scan(sweep, tip_rhs, (factors.inwards, t[:, :b]), reverse=True)
    shifts = t[:, b:] + apply_each(factors.shift, g)
    base = jnp.zeros(a, defect.dtype)
    da_n, da = jax.lax.scan(sweep, base, (factors.outwards, shifts))
    da = jnp.concatenate([da, da_n[None]])
    db = apply_each(factors.S, da[1:]) + g
    return jnp.concatenate([da, jnp.concatenate([g0[None], db])], -1)


def apply_each(
    matrices: Float[Array, "m i j"], vectors: Float[Array, "m j"]
) -> Float[Array, "m i"]:
    """The product of each matrix and its vector."""
    return jnp.einsum("kij,kj->ki", matrices, vectors)
