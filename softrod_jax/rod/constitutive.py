"""Strains from the total wrench: one small convex problem at each point of the rod.

With the total wrench (N, M) in the body frame, the strains (v, u) minimise

    1/2 (v - v*).K_se (v - v*) + 1/2 (u - u*).K_bt (u - u*) + W_act(v, u) - N.v - M.u

plus, in a step of the time stepping, the Kelvin-Voigt terms with v_t = c0 v + v_h. This is
strictly convex: at most one solution. There is none (no smooth
equilibrium) when the minimiser sits where a tendon's path has no length left. In a rod that is
inextensible v is v*, and u alone is sought: N does no work there and holds the constraint.

Without terms that are not quadratic the answer is explicit. With them: Newton's method,
differentiated through the optimality condition and not through its iterations.

Which energies there are it does not know: each is a term of `energies.py`.
"""

import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from softrod_jax.foundation.products import product
from softrod_jax.rod.constants import Rod, Scalar, joined
from softrod_jax.rod.energies import AbstractTerm, Density, Dissipated, TendonPull
from softrod_jax.rod.fibres import FibreEnergy, Fibres
from softrod_jax.rod.own_conditions import Held
from softrod_jax.rod.relaxation import Crept
from softrod_jax.rod.rotations import cross

# (v, u), or u where v is given: 6, 3, or in a plane 3 and 1 numbers.
Strain = Float[Array, "*points strain"]
_MAX_ITERATIONS = 40
# Size of the last step, relative; convergence is quadratic, so the error is far below it.
_CONVERGED = 1e-9


class LocalProblem(NamedTuple):
    """minimise 1/2 x.diag(k) x + sum of terms(x) - b.x over x = (v, u).

    `k` (6,), `b` (*points, 6). Where v is given, x = u: `k` (3,), `b` (*points, 3). `rest`: the
    strains of the unloaded rod; `sizes`: those of strains that matter. Both (6,), with terms only.
    """

    k: Float[Array, "... strain"]
    b: Strain
    terms: tuple[AbstractTerm, ...] = ()
    rest: Float[Array, "... strain"] | None = None
    sizes: Float[Array, "strain"] | None = None

    @property
    def explicit(self) -> bool:
        """Whether the solution is b / k."""
        return not self.terms


def local_problem(
    rod: Rod,
    wrench: Strain,
    c0: Scalar | None = None,
    strain_history: Strain | None = None,
    crept_history: Crept | None = None,
) -> LocalProblem:
    """The problem for the body-frame wrench (N, M), (*points, 6).

    `c0` and `strain_history` (v_h, u_h), (*points, 6), as in `schemes.py`; `None` in statics.
    Of a rod that is inextensible: M and u_h, (*points, 3). `crept_history`: that of what relaxes.
    """
    elastic = rod.relaxed
    k_se, k_bt, b = elastic.K_se, elastic.K_bt, wrench
    stretch = slice(None, 0 if k_se is None else k_se.shape[-1])
    bend = slice(stretch.stop, None)
    if rod.material is not None:
        # All of the elasticity is in the material's own term.
        k_se, k_bt = None if k_se is None else jnp.zeros_like(k_se), jnp.zeros_like(k_bt)
    elif k_se is None:
        b = b + k_bt * rod.u_star
    else:
        b = b + joined(k_se * rod.v_star, k_bt * rod.u_star)
    if rod.m_ch is not None:
        b = b + (rod.m_ch if rod.n_ch is None else jnp.concatenate([rod.n_ch, rod.m_ch], -1))
    if c0 is not None and rod.relaxation is not None and crept_history is not None:
        at_once = rod.relaxation.at_once(c0)[..., None]
        memory = rod.stiffness * rod.relaxation.memory(c0, crept_history)
        b = b + at_once * rod.stiffness * rod.rest_strain - memory
        k_bt = k_bt + at_once * rod.K_bt
        k_se = None if k_se is None or rod.K_se is None else k_se + at_once * rod.K_se
    if c0 is not None and rod.B_se is not None and strain_history is not None:
        assert k_se is not None, "what is damped has a stiffness"
        k_se = k_se + c0 * rod.B_se
        b = b.at[..., stretch].add(-rod.B_se * strain_history[..., stretch])
    if c0 is not None and rod.B_bt is not None and strain_history is not None:
        k_bt = k_bt + c0 * rod.B_bt
        b = b.at[..., bend].add(-rod.B_bt * strain_history[..., bend])
    k = k_bt if k_se is None else joined(k_se, k_bt)
    terms = _terms(rod, c0, strain_history)
    if not terms:
        return LocalProblem(k, b)
    # v against 1, u against the curvature at which u r compares with 1.
    reach = functools.reduce(jnp.maximum, [term.reach for term in terms])
    sizes = jnp.ones(k_bt.shape[-1]) / (1e-30 + reach)
    rest = rod.u_star
    if k_se is not None:
        rest = joined(rod.v_star, rest)
        sizes = jnp.concatenate([jnp.ones(k_se.shape[-1]), sizes])
    return LocalProblem(k, b, terms, rest, sizes)


def _terms(rod: Rod, c0: Scalar | None, strain_history: Strain | None) -> tuple[AbstractTerm, ...]:
    """The energies that are not quadratic."""
    v = rod.v_star if rod.K_se is None else None
    terms = []
    if rod.tau is not None and rod.r is not None:
        pull = TendonPull(rod.tau, rod.r, rod.r_s, v)
        if c0 is not None and strain_history is not None and rod.front_viscosity is not None:
            l_h = pull.linear_paths(strain_history)
            pull = TendonPull(rod.tau, rod.r, rod.r_s, v, rod.front_viscosity * rod.tau, c0, l_h)
        terms.append(pull)
    if rod.fibres is not None:
        terms.append(_fibre_energy(rod, rod.fibres))
    if rod.s is None:
        return tuple(terms)
    if rod.material is not None:
        terms.append(Density(rod.material, rod.s, rod.reach, None, v, rod.plane))
    for energy in rod.energies or ():
        # What holds the rod is as large as it must be, and no load.
        factor = None if isinstance(energy, Held) else rod.load_factor
        terms.append(Density(energy, rod.s, rod.reach, factor, v, rod.plane))
    if c0 is not None and strain_history is not None:
        moving = c0, strain_history, v is None, rod.plane
        terms += [Dissipated(x, rod.s, rod.reach, *moving) for x in rod.dissipations or ()]
    return tuple(terms)


def _fibre_energy(rod: Rod, fibres: Fibres) -> FibreEnergy:
    return FibreEnergy(fibres, rod.rest_strain, rod.reach, rod.K_se is not None, rod.plane)


def recover_strain(
    problem: LocalProblem, guess: Float[Array, "*#points strain"] | None
) -> tuple[Strain, Bool[Array, ""]]:
    """Strains (v, u), (*points, 6), and whether every point has a solution.

    `guess`: where the search starts; it may be `None` where the answer is explicit.
    """
    if problem.explicit:
        return problem.b / problem.k, jnp.array(True)
    assert guess is not None, "a problem with terms needs a start"
    x, converged = _minimise(problem, jax.lax.stop_gradient(guess))
    return x, jnp.all(converged)


def nearby_strain(problem: LocalProblem, strain: Strain) -> Strain:
    """Strains by one step of Newton's method from `strain`, which solves a nearby problem."""
    if problem.explicit:
        return problem.b / problem.k
    g = imbalance(problem, strain)
    return strain - jnp.sum(_inverse(_hessian(problem, strain)) * g[..., None, :], -1)


def compliance(problem: LocalProblem, strain: Strain):
    """d(v, u)/d(N, M) at the solution: (*points, 6, 6), symmetric positive definite.

    du/dM, (*points, 3, 3), where u alone is sought.
    """
    if problem.explicit:
        n = problem.k.shape[-1]
        return jnp.broadcast_to(_diagonal(1 / problem.k), (*strain.shape[:-1], n, n))
    return _inverse(_hessian(problem, strain))


def shortest_path(rod: Rod, strain: Strain):
    """The least |v + u x r_i| of any tendon anywhere: 0 where it has no length left."""
    v = rod.v_star if rod.K_se is None else None
    assert rod.tau is not None and rod.r is not None, "a rod with tendons"
    _, length = TendonPull(rod.tau, rod.r, rod.r_s, v).paths(strain)
    # A tendon that is not there may have any.
    return jnp.min(length if rod.tau.ndim == 1 else jnp.where(rod.tau > 0.0, length, jnp.inf))


def least_fibre_stretch(rod: Rod, strain: Strain) -> Float[Array, "*points"] | None:
    """The least stretch of a fibre of rubber at each point; `None` where there are none."""
    return None if rod.fibres is None else _fibre_energy(rod, rod.fibres).least_stretch(strain)


def imbalance(problem: LocalProblem, x: Strain) -> Strain:
    """The gradient of the energy in x = (v, u), zero at the solution: [N] and [N m]."""
    return sum((term.gradient(x) for term in problem.terms), problem.k * x) - problem.b


def _hessian(problem: LocalProblem, x):
    """(*points, 6, 6)."""
    return sum((term.hessian(x) for term in problem.terms), _diagonal(problem.k))


def potential(problem: LocalProblem, x: Strain) -> Float[Array, "*points"]:
    """What is least at the solution, per unit of rod [N]."""
    quadratic = jnp.sum((0.5 * problem.k * x - problem.b) * x, -1)
    return sum((term.value(x) for term in problem.terms), quadratic)


def _diagonal(k):
    """Matrices with these numbers on the diagonal: (*points, n) to (*points, n, n)."""
    return k[..., None, :] * np.eye(k.shape[-1])


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
    AB = product(A_inv, B)
    lower = _inverse_3(D - product(transposed(B), AB))
    right = product(-AB, lower)
    upper = A_inv - product(right, transposed(AB))
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
    scale = problem.sizes
    assert scale is not None, "a problem with terms"

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
        drop = potential(problem, trial) - potential(problem, x)
        wanted = 1e-4 * _STEP_LENGTHS.reshape(-1, *[1] * slope.ndim) * slope
        # Near the solution energies differ by rounding only: take the full step there.
        good = (drop <= wanted) | (size < 1e-3)
        a = jnp.max(jnp.where(good, _STEP_LENGTHS.reshape(-1, *[1] * slope.ndim), 1e-4), 0)
        return x + a[..., None] * step, size, i + 1

    start = jnp.broadcast_to(guess, problem.b.shape)
    x, size, _ = jax.lax.while_loop(cond, body, (start, jnp.full(start.shape[:-1], jnp.inf), 0))
    return x, size <= _CONVERGED


@_minimise.defjvp  # pyright: ignore[reportArgumentType]  # JAX takes float0 from numpy only
def _minimise_jvp(primals, tangents):
    problem, guess = primals
    x, converged = _minimise(problem, guess)
    _, g_dot = jax.jvp(lambda p: imbalance(p, x), (problem,), (tangents[0],))
    # A point without a solution has no derivative: zero keeps the rest of the batch clean.
    safe = jnp.where(converged[..., None], x, problem.rest)
    g_dot = jnp.where(converged[..., None], g_dot, 0.0)
    x_dot = -jnp.sum(_inverse(_hessian(problem, safe)) * g_dot[..., None, :], -1)
    return (x, converged), (x_dot, np.zeros(converged.shape, dtype=jax.dtypes.float0))
