"""Strains from the total wrench: one small convex problem at each point of the rod.

Per unit of rod, tendons store `tau_i |v + u x r_i + r_i,s|`. With the total wrench (N, M) in
the body frame, the strains (v, u) minimise

    1/2 (v - v*).K_se (v - v*) + 1/2 (u - u*).K_bt (u - u*) + W_act(v, u) - N.v - M.u

plus, in a step of the time stepping, the Kelvin-Voigt terms with v_t = c0 v + v_h. For
tensions >= 0 this is strictly convex: at most one solution. There is none (no smooth
equilibrium) when the minimiser sits where a tendon's path has no length left. In a rod that is
inextensible v is v*, and u alone is sought: N does no work there and holds the constraint.

Without tendons the answer is explicit. With them: Newton's method, differentiated through the
optimality condition and not through its iterations.

A tension that jumps sends a front along the rod, in theory of no width. Where the grid has
nothing between two points, the strains behind a front ring, and a ringing tendon path may shrink
to nothing though the true one does not. So in motions each tendon has an artificial viscosity,
`viscosity_i |l_t| l_t` for the rate of its path (von Neumann & Richtmyer, J. Appl. Phys. 21, 1950):
it spreads a front over a few points, and vanishes with the square of their distance elsewhere.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from softrod_jax.rod.constants import Rod
from softrod_jax.rod.rotations import cross, hats

Strain = Float[Array, "*points 6"]
_MAX_ITERATIONS = 40
# Size of the last step, relative; convergence is quadratic, so the error is far below it.
_CONVERGED = 1e-9


class LocalProblem(NamedTuple):
    """minimise 1/2 x.diag(k) x + sum_i tau_i |v + u x r_i + r_i,s| - b.x over x = (v, u).

    `k` (6,), `b` (*points, 6), `tau` (tendons,), `r` (tendons, 3), `r_s` (tendons, 3) or None; both
    (*points, tendons, 3) for paths that vary along the rod.
    With artificial viscosity: plus sum_i viscosity_i |l_t|^3 / (3 c0), l_t = c0 l_i + l_h.
    Where `v` (3,) is given, x = u: `k` (3,), `b` (*points, 3).
    """

    k: Float[Array, "6"]
    b: Float[Array, "*points 6"]
    v: Float[Array, "3"] | None = None
    tau: Float[Array, "tendons"] | None = None
    r: Float[Array, "... tendons 3"] | None = None
    r_s: Float[Array, "... tendons 3"] | None = None
    viscosity: Float[Array, "tendons"] | None = None
    c0: Float[Array, ""] | None = None
    l_h: Float[Array, "*points tendons 3"] | None = None


def local_problem(rod: Rod, wrench, c0=None, strain_history=None) -> LocalProblem:
    """The problem for the body-frame wrench (N, M), (*points, 6).

    `c0` and `strain_history` (v_h, u_h), (*points, 6), as in `schemes.py`; `None` in statics.
    Of a rod that is inextensible: M and u_h, (*points, 3).
    """
    k_se, k_bt = rod.K_se, rod.K_bt
    if k_se is None:
        b = wrench + rod.K_bt * rod.u_star
        bend = slice(None)
    else:
        b = wrench + joined(rod.K_se * rod.v_star, rod.K_bt * rod.u_star)
        n = k_se.shape[-1]
        stretch, bend = slice(None, n), slice(n, None)
    if rod.m_ch is not None:
        b = b + (rod.m_ch if rod.n_ch is None else jnp.concatenate([rod.n_ch, rod.m_ch], -1))
    if c0 is not None and rod.B_se is not None:
        k_se = k_se + c0 * rod.B_se
        b = b.at[..., stretch].add(-rod.B_se * strain_history[..., stretch])
    if c0 is not None and rod.B_bt is not None:
        k_bt = k_bt + c0 * rod.B_bt
        b = b.at[..., bend].add(-rod.B_bt * strain_history[..., bend])
    k = k_bt if k_se is None else joined(k_se, k_bt)
    v = rod.v_star if k_se is None else None
    if rod.tau is None:
        return LocalProblem(k, b, v)
    problem = LocalProblem(k, b, v, rod.tau, rod.r, rod.r_s)
    if c0 is None or rod.front_viscosity is None:
        return problem
    l_h = _linear_paths(problem.r, strain_history)
    return problem._replace(viscosity=rod.front_viscosity * rod.tau, c0=c0, l_h=l_h)


def joined(a, b):
    """Side by side; what is the same along the rod beside what varies along it, too."""
    points = jnp.broadcast_shapes(a.shape[:-1], b.shape[:-1])
    return jnp.concatenate([jnp.broadcast_to(x, (*points, x.shape[-1])) for x in (a, b)], -1)


def recover_strain(problem: LocalProblem, guess: Strain) -> tuple[Strain, Bool[Array, ""]]:
    """Strains (v, u), (*points, 6), and whether every point has a solution."""
    if problem.tau is None:
        return problem.b / problem.k, jnp.array(True)
    x, converged = _minimise(problem, jax.lax.stop_gradient(guess))
    return x, jnp.all(converged)


def nearby_strain(problem: LocalProblem, strain: Strain) -> Strain:
    """Strains by one step of Newton's method from `strain`, which solves a nearby problem."""
    if problem.tau is None:
        return problem.b / problem.k
    g = imbalance(problem, strain)
    return strain - jnp.sum(_inverse(_hessian(problem, strain)) * g[..., None, :], -1)


def compliance(problem: LocalProblem, strain: Strain):
    """d(v, u)/d(N, M) at the solution: (*points, 6, 6), symmetric positive definite.

    du/dM, (*points, 3, 3), where u alone is sought.
    """
    if problem.tau is None:
        n = problem.k.shape[-1]
        return jnp.broadcast_to(_diagonal(1 / problem.k), (*strain.shape[:-1], n, n))
    return _inverse(_hessian(problem, strain))


def _linear_paths(r, x, v=None):
    """v + u x r_i, (*points, tendons, 3)."""
    if v is None:
        n = r.shape[-1]
        v, u = x[..., None, :n], x[..., None, n:]
    else:
        v, u = v[..., None, :], x[..., None, :]
    return v + cross(u, jnp.broadcast_to(r, (*x.shape[:-1], *r.shape[-2:])))


def _paths(problem: LocalProblem, x):
    """l_i = v + u x r_i + r_i,s, (*points, tendons, 3), and |l_i|."""
    l = _linear_paths(problem.r, x, problem.v)
    if problem.r_s is not None:
        l = l + problem.r_s
    # The floor keeps derivatives finite on the kink; no converged answer sits there.
    return l, jnp.sqrt(jnp.sum(l * l, -1) + 1e-30)


def shortest_path(rod: Rod, strain: Float[Array, "points 6"]):
    """The least |v + u x r_i| of any tendon anywhere: 0 where it has no length left."""
    v = rod.v_star if rod.K_se is None else None
    problem = LocalProblem(None, None, v, rod.tau, rod.r, rod.r_s)
    length = _paths(problem, strain)[1]
    # A tendon that is not there, or slack, may have any.
    return jnp.min(jnp.where(rod.tau > 0.0, length, jnp.inf))


def imbalance(problem: LocalProblem, x: Strain) -> Strain:
    """The gradient of the energy in x = (v, u), zero at the solution: [N] and [N m]."""
    l, length = _paths(problem, x)
    pull = (problem.tau / length)[..., None] * l
    if problem.viscosity is not None:
        l_t, rate = _path_rates(problem, l)
        pull = pull + (problem.viscosity * rate)[..., None] * l_t
    moment = cross(jnp.broadcast_to(problem.r, pull.shape), pull)
    total = jnp.sum(moment, -2)
    if problem.v is None:
        total = jnp.concatenate([jnp.sum(pull, -2), total], -1)
    return problem.k * x + total - problem.b


def _path_rates(problem: LocalProblem, l):
    """l_t and |l_t| from the paths l_i."""
    # A path that varies with s does not vary with time: r_i,s is not in the rate.
    change = l if problem.r_s is None else l - problem.r_s
    l_t = problem.c0 * change + problem.l_h
    return l_t, jnp.sqrt(jnp.sum(l_t * l_t, -1) + 1e-30)


def _hessian(problem: LocalProblem, x):
    """(*points, 6, 6): diag(k) + sum_i B_i^T M_i B_i, with l_i = B_i x and B_i = [1, -r_i^]."""
    l, length = _paths(problem, x)
    eye, outer = jnp.eye(l.shape[-1]), lambda a: a[..., :, None] * a[..., None, :]
    t = l / length[..., None]
    M = (problem.tau / length)[..., None, None] * (eye - outer(t))
    if problem.viscosity is not None:
        l_t, rate = _path_rates(problem, l)
        rate = rate[..., None, None]
        drag = problem.c0 * problem.viscosity[..., None, None]
        M = M + drag * (rate * eye + outer(l_t) / rate)
    turn = -hats(problem.r)[1]
    turn = jnp.broadcast_to(turn, (*M.shape[:-1], turn.shape[-1]))
    M_turn = _product(M, turn)
    if problem.v is not None:
        by_turn = _product(jnp.swapaxes(turn, -1, -2), M_turn)
        return _diagonal(problem.k) + jnp.sum(by_turn, -3)
    upper = jnp.concatenate([M, M_turn], -1)
    lower = [jnp.swapaxes(M_turn, -1, -2), _product(jnp.swapaxes(turn, -1, -2), M_turn)]
    sum_i = jnp.sum(jnp.concatenate([upper, jnp.concatenate(lower, -1)], -2), -3)
    return _diagonal(problem.k) + sum_i


def _diagonal(k):
    """Matrices with these numbers on the diagonal: (*points, n) to (*points, n, n)."""
    return k[..., None, :] * np.eye(k.shape[-1])


def _product(A, B):
    """A @ B of (*batch, 3, 3), in components."""
    return sum(A[..., :, j, None] * B[..., j, None, :] for j in range(A.shape[-1]))


def _energy(problem: LocalProblem, x):
    l, length = _paths(problem, x)
    quadratic = jnp.sum((0.5 * problem.k * x - problem.b) * x, -1)
    energy = quadratic + jnp.sum(problem.tau * length, -1)
    if problem.viscosity is None:
        return energy
    _, rate = _path_rates(problem, l)
    return energy + jnp.sum(problem.viscosity * rate**3, -1) / (3 * problem.c0)


def _inverse(H):
    """Inverse of symmetric positive definite matrices (*batch, 6, 6), by blocks of 3.

    Of smaller ones, too: (*batch, 3, 3) and (*batch, 1, 1). A few vector operations for all
    points, where a batched LAPACK call spends its time on overhead. Such matrices need no pivoting.
    """
    if H.shape[-1] == 1:
        return 1 / H
    if H.shape[-1] == 3:
        return _inverse_3(H)
    A, B, D = H[..., :3, :3], H[..., :3, 3:], H[..., 3:, 3:]
    transposed = lambda X: jnp.swapaxes(X, -1, -2)
    A_inv = _inverse_3(A)
    AB = A_inv @ B
    lower = _inverse_3(D - transposed(B) @ AB)
    right = -AB @ lower
    upper = A_inv - right @ transposed(AB)
    top = jnp.concatenate([upper, right], -1)
    return jnp.concatenate([top, jnp.concatenate([transposed(right), lower], -1)], -2)


def _inverse_3(A):
    """Inverse of (*batch, 3, 3): cross products of the rows over the determinant."""
    a, b, c = A[..., 0, :], A[..., 1, :], A[..., 2, :]
    columns = jnp.stack([cross(b, c), cross(c, a), cross(a, b)], -1)
    return columns / jnp.sum(a * columns[..., 0], -1)[..., None, None]


# Step lengths that are tried at once; the longest that lowers the energy enough is taken.
_STEP_LENGTHS = np.array([1.0, 0.25, 0.0625, 0.015625, 1e-3])


@jax.custom_jvp
def _minimise(problem: LocalProblem, guess):
    """Damped Newton from `guess`: strains and, per point, whether they solve the problem."""
    # Strains that matter: v against 1, u against the curvature at which u r compares with 1.
    r, n = problem.r, problem.k.shape[-1]
    turns = n if problem.v is not None else n - r.shape[-1]
    scale = jnp.ones(turns) / (1e-30 + jnp.max(jnp.abs(r)))
    if problem.v is None:
        scale = jnp.concatenate([jnp.ones(r.shape[-1]), scale])

    def cond(state):
        _, size, i = state
        return jnp.any(size > _CONVERGED) & (i < _MAX_ITERATIONS)

    def body(state):
        x, _, i = state
        g = imbalance(problem, x)
        step = -jnp.sum(_inverse(_hessian(problem, x)) * g[..., None, :], -1)
        size = jnp.max(jnp.abs(step) / scale, -1)
        slope = jnp.sum(step * g, -1)
        trial = x + _STEP_LENGTHS.reshape(-1, *[1] * x.ndim) * step
        drop = _energy(problem, trial) - _energy(problem, x)
        wanted = 1e-4 * _STEP_LENGTHS.reshape(-1, *[1] * slope.ndim) * slope
        # Near the solution energies differ by rounding only: take the full step there.
        good = (drop <= wanted) | (size < 1e-3)
        a = jnp.max(jnp.where(good, _STEP_LENGTHS.reshape(-1, *[1] * slope.ndim), 1e-4), 0)
        return x + a[..., None] * step, size, i + 1

    start = jnp.broadcast_to(guess, problem.b.shape)
    x, size, _ = jax.lax.while_loop(cond, body, (start, jnp.full(start.shape[:-1], jnp.inf), 0))
    return x, size <= _CONVERGED


@_minimise.defjvp
def _minimise_jvp(primals, tangents):
    problem, guess = primals
    x, converged = _minimise(problem, guess)
    _, g_dot = jax.jvp(lambda p: imbalance(p, x), (problem,), (tangents[0],))
    # A point without a solution has no derivative: zero keeps the rest of the batch clean.
    straight = np.zeros(problem.k.shape[-1])
    if problem.v is None:
        straight[problem.r.shape[-1] - 1] = 1.0
    safe = jnp.where(converged[..., None], x, straight)
    g_dot = jnp.where(converged[..., None], g_dot, 0.0)
    x_dot = -jnp.sum(_inverse(_hessian(problem, safe)) * g_dot[..., None, :], -1)
    return (x, converged), (x_dot, np.zeros(converged.shape, dtype=jax.dtypes.float0))
