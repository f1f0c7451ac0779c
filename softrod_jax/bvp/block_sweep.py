"""Direct solution of the block-bidiagonal systems that both methods along the rod produce.

Each node has a = (h, q, omega), given at the base, and b = (N, M), given at the tip. For every
interval k

    left_k (da, db)_k + right_k (da, db)_{k+1} = -defect_k

with da_0 = 0 and db_n = tip_slope da_n + tip_rhs. From the tip to the base, `db_{k+1} = S_{k+1}
da_{k+1} + g_{k+1}` is put into the equations of interval k, and they are solved for what leaves
it (a outwards, b inwards) in terms of what enters it:

    (da_{k+1}, db_k) = -K_k (left_a da_k + right_b g_{k+1} + defect_k),
    K_k = [right_a + right_b S_{k+1}, left_b]^-1

which gives S_k and g_k. S is the mechanical impedance of the outboard rod, and its recursion the
discrete Riccati equation. The answer follows from the base to the tip. Unlike products of
transfer matrices, no step of this grows with exp(lambda L).
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from softrod_jax.foundation.compiling import on_cpu
from softrod_jax.foundation.products import precision, product


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
    known = jnp.concatenate([left[..., :a], right[..., a:]], -1)

    def inwards(S, interval):
        right_a, right_b, left_b, known = interval
        K = inverse(jnp.concatenate([right_a + product(right_b, S), left_b], -1))
        out = product(-K, known)
        return out[a:, :a], (S, K, out)

    intervals = right[..., :a], right[..., a:], left[..., a:], known
    _, (S, K, out) = jax.lax.scan(inwards, tip_slope, intervals, reverse=True)
    return Factors(K, right, S, out[:, a:, a:], out[:, :a, a:], out[:, :a, :a])


def inverse(A: Float[Array, "n n"]):
    """By elimination, two rows and columns at a time, without a search for pivots.

    Where an interval is short its matrix is diag(1, -1), and no pivot is small; what units the rows
    and columns have makes no difference without that search. One loop of vector
    operations: for n = 16 in 2 us, where a LAPACK factorisation and two solves take 5.
    """
    n = A.shape[-1]
    if n % 2:
        A = jnp.pad(A, (0, 1)).at[n, n].set(1.0)
    index = np.arange(A.shape[-1])

    def eliminate(k, A):
        i, j = 2 * k, 2 * k + 1
        at_i, at_j = index == i, index == j
        (a, b), (c, d) = (A[i, i], A[i, j]), (A[j, i], A[j, j])
        row_i = jnp.where(at_i, 1.0, jnp.where(at_j, 0.0, A[i]))
        row_j = jnp.where(at_j, 1.0, jnp.where(at_i, 0.0, A[j]))
        q = 1 / (a * d - b * c)
        row_i, row_j = (d * row_i - b * row_j) * q, (a * row_j - c * row_i) * q
        others = jnp.where(at_i | at_j, 0.0, A) - A[:, i, None] * row_i - A[:, j, None] * row_j
        return jnp.where(at_i[:, None], row_i, jnp.where(at_j[:, None], row_j, others))

    if on_cpu():
        return jax.lax.fori_loop(0, A.shape[-1] // 2, eliminate, A)[:n, :n]
    # A kernel each, and not several that look up where in the loop they are. Barriers keep XLA from
    # making several into one, which would compute what it reads again and again.
    for k in range(A.shape[-1] // 2):
        A = jax.lax.optimization_barrier(eliminate(k, A))
    return A[:n, :n]


def count_conjugate_points(factors: Factors) -> Int[Array, ""]:
    """How many there are of an equilibrium: none if and only if it is stable under dead loads.

    They are those of the second variation. Swept from the free tip, no disturbance of the attitude
    vanishes before the clamp where it is positive (Jacobi's condition), and as many do as there
    are directions in which it is not (Morse's index theorem). With T_12 the da_{k+1} by db_{k+1} of
    one interval, disturbances of two nodes are related by G = (I - T_12 S)^-1; one vanishes in
    between for each negative eigenvalue of G. Its eigenvalues are real (it is similar to a
    symmetric matrix): as many are negative as the elementary symmetric polynomials change their
    sign (Descartes). The sign of the determinant alone would miss a column that buckles in two
    planes at once.
    """
    b, a = factors.S.shape[1:]
    if a == 0:
        return jnp.zeros((), int)  # nothing depends on the attitude
    G = factors.K[:, :a] @ factors.right[:, :, :a]
    # Newton's identities: from the traces of powers to the elementary polynomials.
    power, traces, e = G, [], [1.0]
    for k in range(1, a + 1):
        traces.append(jnp.trace(power, axis1=-2, axis2=-1))
        e.append(sum((-1) ** i * e[k - 1 - i] * traces[i] for i in range(k)) / k)
        power = power @ G
    positive = jnp.stack([jnp.full(G.shape[0], True), *(x > 0 for x in e[1:])])
    return jnp.sum(positive[1:] != positive[:-1])


def solve_sweeps(
    factors: Factors, defect: Float[Array, "m n"], tip_rhs: Float[Array, "b"]
) -> Float[Array, "nodes n"]:
    """(da, db) at every node; linear in (defect, tip_rhs)."""
    b, a = factors.S.shape[1:]
    t = -apply_each(factors.K, defect)

    # One small product a node in turn; all else for all nodes at once.
    def sweep(x, k):
        matrix, rhs = k
        return jnp.matmul(matrix, x, precision=precision()) + rhs, x

    g0, g = jax.lax.scan(sweep, tip_rhs, (factors.inwards, t[:, a:]), reverse=True)
    shifts = t[:, :a] + apply_each(factors.shift, g)
    base = jnp.zeros(a, defect.dtype)
    da_n, da = jax.lax.scan(sweep, base, (factors.outwards, shifts))
    da = jnp.concatenate([da, da_n[None]])
    db = apply_each(factors.S, da[1:]) + g
    return jnp.concatenate([da, jnp.concatenate([g0[None], db])], -1)


def apply_each(
    matrices: Float[Array, "m i j"], vectors: Float[Array, "m j"]
) -> Float[Array, "m i"]:
    """The product of each matrix and its vector."""
    return jnp.einsum("kij,kj->ki", matrices, vectors, precision=precision())
