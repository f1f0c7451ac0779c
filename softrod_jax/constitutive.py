"""Strains from the total wrench: one small convex problem at each point of the rod.

Per unit of rod, tendons store `tau_i |v + u x r_i + r_i,s|`. With the total wrench (N, M) in
the body frame, the strains (v, u) minimise

    1/2 (v - v*).K_se (v - v*) + 1/2 (u - u*).K_bt (u - u*) + W_act(v, u) - N.v - M.u

plus, in a step of the time stepping, the Kelvin-Voigt terms with v_t = c0 v + v_h. For
tensions >= 0 this is strictly convex: at most one solution. There is none (no smooth
equilibrium) when the minimiser sits where a tendon's path has no length left.

Without tendons the answer is explicit. With them: Newton's method, differentiated through the
optimality condition and not through its iterations.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from softrod_jax.rod import Rod
from softrod_jax.rotations import cross, hat

Strain = Float[Array, "*points 6"]
_MAX_ITERATIONS = 40


class LocalProblem(NamedTuple):
    """minimise 1/2 x.diag(k) x + sum_i tau_i |v + u x r_i + r_i,s| - b.x over x = (v, u).

    `k` (6,), `b` (*points, 6), `tau` (tendons,), `r` (tendons, 3), `r_s` (tendons, 3) or None.
    """

    k: Float[Array, "6"]
    b: Float[Array, "*points 6"]
    tau: Float[Array, "tendons"] | None = None
    r: Float[Array, "tendons 3"] | None = None
    r_s: Float[Array, "tendons 3"] | None = None


def local_problem(rod: Rod, s, wrench, c0=None, strain_history=None) -> LocalProblem:
    """The problem for the body-frame wrench (N, M), (*points, 6), at arc length `s`.

    `c0` and `strain_history` (v_h, u_h), (*points, 6), as in `time_schemes`; `None` in statics.
    """
    k_se, k_bt = rod.K_se, rod.K_bt
    b = wrench + jnp.concatenate([rod.K_se * rod.v_star, rod.K_bt * rod.u_star])
    if rod.n_ch is not None:
        b = b + jnp.concatenate([rod.n_ch, rod.m_ch])
    if c0 is not None and rod.B_se is not None:
        k_se = k_se + c0 * rod.B_se
        b = b.at[..., :3].add(-rod.B_se * strain_history[..., :3])
    if c0 is not None and rod.B_bt is not None:
        k_bt = k_bt + c0 * rod.B_bt
        b = b.at[..., 3:].add(-rod.B_bt * strain_history[..., 3:])
    k = jnp.concatenate([k_se, k_bt])
    if rod.tau is None:
        return LocalProblem(k, b)
    return LocalProblem(k, b, rod.tau, *rod.tendons.routing(s))


def recover_strain(problem: LocalProblem, guess: Strain) -> tuple[Strain, Bool[Array, ""]]:
    """Strains (v, u), (*points, 6), and whether every point has a solution."""
    if problem.tau is None:
        return problem.b / problem.k, jnp.array(True)
    x, converged = _minimise(problem, jax.lax.stop_gradient(guess))
    return x, jnp.all(converged)


def compliance(problem: LocalProblem, strain: Strain):
    """d(v, u)/d(N, M) at the solution: (*points, 6, 6), symmetric positive definite."""
    if problem.tau is None:
        return jnp.broadcast_to(jnp.diag(1 / problem.k), (*strain.shape[:-1], 6, 6))
    return _inverse_6x6(*_hessian(problem, strain))


def _paths(problem: LocalProblem, x):
    """l_i = v + u x r_i + r_i,s, (*points, tendons, 3), and |l_i|."""
    v, u = x[..., None, :3], x[..., None, 3:]
    l = v + cross(u, problem.r)
    if problem.r_s is not None:
        l = l + problem.r_s
    # The floor keeps derivatives finite on the kink; no converged answer sits there.
    return l, jnp.sqrt(jnp.sum(l * l, -1) + 1e-30)


def _gradient(problem: LocalProblem, x):
    l, length = _paths(problem, x)
    pull = problem.tau[:, None] * l / length[..., None]
    act = jnp.concatenate([pull, cross(problem.r, pull)], -1)
    return problem.k * x + jnp.sum(act, -2) - problem.b


def _energy(problem: LocalProblem, x):
    _, length = _paths(problem, x)
    quadratic = jnp.sum((0.5 * problem.k * x - problem.b) * x, -1)
    return quadratic + jnp.sum(problem.tau * length, -1)


def _hessian(problem: LocalProblem, x):
    """The 3x3 blocks vv, vu and uu of the Hessian."""
    l, length = _paths(problem, x)
    t = l / length[..., None]
    P = (jnp.eye(3) - t[..., :, None] * t[..., None, :]) * (problem.tau / length)[..., None, None]
    r = hat(problem.r)
    Pr = P @ r
    eye = jnp.eye(3)
    vv = jnp.sum(P, -3) + problem.k[:3] * eye
    vu = -jnp.sum(Pr, -3)
    uu = -jnp.sum(r @ Pr, -3) + problem.k[3:] * eye
    return vv, vu, uu


def _inverse_3x3(A):
    """By cross products of the columns: no LAPACK call for nine numbers."""
    a, b, c = A[..., :, 0], A[..., :, 1], A[..., :, 2]
    bc = cross(b, c)
    det = jnp.sum(a * bc, -1)[..., None, None]
    return jnp.stack([bc, cross(c, a), cross(a, b)], -2) / det


def _inverse_6x6(vv, vu, uu):
    """Inverse of a symmetric positive definite 6x6 by its Schur complement."""
    vv_inv = _inverse_3x3(vv)
    W = vv_inv @ vu
    S_inv = _inverse_3x3(uu - jnp.swapaxes(vu, -1, -2) @ W)
    WS = W @ S_inv
    top = jnp.concatenate([vv_inv + WS @ jnp.swapaxes(W, -1, -2), -WS], -1)
    return jnp.concatenate([top, jnp.concatenate([-jnp.swapaxes(WS, -1, -2), S_inv], -1)], -2)


def _newton_step(problem, x, rhs):
    """H(x)^-1 rhs."""
    vv, vu, uu = _hessian(problem, x)
    vv_inv = _inverse_3x3(vv)
    W = vv_inv @ vu
    S_inv = _inverse_3x3(uu - jnp.swapaxes(vu, -1, -2) @ W)
    a, b = rhs[..., :3], rhs[..., 3:]
    y = jnp.einsum("...ij,...j->...i", S_inv, b - jnp.einsum("...ji,...j->...i", W, a))
    z = jnp.einsum("...ij,...j->...i", vv_inv, a) - jnp.einsum("...ij,...j->...i", W, y)
    return jnp.concatenate([z, y], -1)


@jax.custom_jvp
def _minimise(problem: LocalProblem, guess):
    """Damped Newton from `guess`: strains and, per point, whether they solve the problem."""
    # Strains that matter: v against 1, u against the curvature at which u r compares with 1.
    scale = jnp.concatenate([jnp.ones(3), jnp.ones(3) / (1e-30 + jnp.max(jnp.abs(problem.r)))])
    guess = jnp.broadcast_to(guess, problem.b.shape)

    def cond(state):
        x, step, size, i = state
        return jnp.any(size > 1e-9) & (i < _MAX_ITERATIONS)

    def body(state):
        x, step, _, i = state
        slope = jnp.sum(step * _gradient(problem, x), -1)
        E0 = _energy(problem, x)

        def too_long(carry):
            a, j = carry
            # Energies differ by rounding only near the solution: accept there.
            worse = _energy(problem, x + a[..., None] * step) > (
                E0 + 1e-4 * a * slope + 1e-13 * jnp.abs(E0)
            )
            return worse & (a > 1e-6), worse

        def shrink(carry):
            a, j = carry
            bad, _ = too_long(carry)
            return jnp.where(bad, 0.5 * a, a), j + 1

        a, _ = jax.lax.while_loop(
            lambda c: jnp.any(too_long(c)[0]), shrink, (jnp.ones(x.shape[:-1]), 0)
        )
        x = x + a[..., None] * step
        step = -_newton_step(problem, x, _gradient(problem, x))
        return x, step, jnp.max(jnp.abs(step) / scale, -1), i + 1

    step = -_newton_step(problem, guess, _gradient(problem, guess))
    size = jnp.max(jnp.abs(step) / scale, -1)
    x, step, size, _ = jax.lax.while_loop(cond, body, (guess, step, size, 0))
    # Convergence is quadratic: the pending step brings the error from 1e-9 to rounding.
    converged = size <= 1e-9
    return jnp.where(converged[..., None], x + step, x), converged


@_minimise.defjvp
def _minimise_jvp(primals, tangents):
    problem, guess = primals
    x, converged = _minimise(problem, guess)
    _, g_dot = jax.jvp(lambda p: _gradient(p, x), (problem,), (tangents[0],))
    # A point without a solution has no derivative: zero keeps the rest of the batch clean.
    safe = jnp.where(converged[..., None], x, jnp.array([0.0, 0, 1, 0, 0, 0]))
    g_dot = jnp.where(converged[..., None], g_dot, 0.0)
    x_dot = -_newton_step(problem, safe, g_dot)
    return (x, converged), (x_dot, jnp.zeros(converged.shape, dtype=jax.dtypes.float0))
