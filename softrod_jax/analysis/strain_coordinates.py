"""A rod whose strains are combinations of few given ones: its equations of motion.

The strains are x = x* + sum_i q_i phi_i(s), with x* those of the unloaded rod. Velocities follow
from the strains' rates,

    omega = integral of R u_t,    p_t = integral of R v_t + omega x R v,

and accelerations likewise. That the equations of the rod hold along each phi_i is d'Alembert's
principle (Boyer & Renda, J. Nonlinear Sci. 27, 2017; Renda et al., IEEE RA-L 5, 2020): with f, l
all forces and moments per length, those of inertia among them,

    sum_k w_k phi_i.sigma(x, x_t) = integral of phi_i,v.R^T N + phi_i,u.R^T M,
    N(s) = integral of f from s on,    M(s) = integral of l + R v x N from s on,

where sigma is what energies and damping have to say. No Jacobian of positions is needed. All
integrals are sums with one matrix S, and those from s on have its transpose: so the work of loads
is that along the velocities, to rounding. Attitudes are Magnus' expansion of order six.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from softrod_jax.rod.constants import PointLoad, Rod, full_strain, inner_strain
from softrod_jax.rod.constitutive import LocalProblem, imbalance, local_problem, potential
from softrod_jax.rod.given_lengths import GivenLengths
from softrod_jax.rod.grid import Grid
from softrod_jax.rod.relaxation import Crept
from softrod_jax.rod.rotations import (
    cross,
    quaternion_exp,
    quaternion_product,
    rotation_matrix,
)
from softrod_jax.scene.acting import Here

Coordinates = Float[Array, "n"]
Vectors = Float[Array, "points 3"]


class Motion(NamedTuple):
    """Coordinates, their rates and accelerations, at one instant."""

    q: Coordinates
    q_t: Coordinates
    q_tt: Coordinates


class Past(NamedTuple):
    """How rates follow in a stage: y_t = c0 y + y_h, of coordinates and of what has crept."""

    c0: Float[Array, ""]
    q_h: Coordinates
    crept: Crept | None = None


class Moving(NamedTuple):
    """A rod that moves, at all points, base frame: tangents R v, velocities and accelerations."""

    strain: Float[Array, "points 6"]
    attitude: Float[Array, "points 4"]
    R: Float[Array, "points 3 3"]
    tangent: Vectors
    velocity: Vectors
    turning: Vectors
    acceleration: Vectors
    turning_t: Vectors


class StrainBasis(eqx.Module):
    """Strains phi_i, (n, points, 6), at the points of a grid, with the sums along that grid."""

    shapes: Float[Array, "n points 6"]
    S: Float[Array, "points points"]
    weights: Float[Array, "points"]
    stride: int = eqx.field(static=True)

    def strain(self, q: Coordinates) -> Float[Array, "points 6"]:
        """sum_i q_i phi_i."""
        return self.strains(q[None])[0]

    def strains(self, q: Float[Array, "several n"]) -> Float[Array, "several points 6"]:
        """The same, of several at once."""
        n, points, _ = self.shapes.shape
        return jnp.reshape(q @ self.shapes.reshape(n, -1), (q.shape[0], points, 6))

    def along(self, forces: Float[Array, "points 6"]) -> Coordinates:
        """sum of phi_i.forces over the points."""
        return self.shapes.reshape(self.shapes.shape[0], -1) @ forces.ravel()


def strain_basis(shapes: Float[Array, "n points 6"], grid: Grid) -> StrainBasis:
    """With the sums along `grid`, in each interval the integrals of polynomials."""
    stride, within = grid.stride, _integrals(grid.stride)
    h = jnp.broadcast_to(grid.h, (grid.intervals,))
    whole = np.zeros((grid.intervals, *(grid.s.shape[0],) * 2))
    for k in range(grid.intervals):
        own = slice(k * stride, (k + 1) * stride + 1)
        whole[k, own, own] = within
        whole[k, (k + 1) * stride :, own] = within[-1]
    S = jnp.tensordot(h, jnp.asarray(whole), 1)
    return StrainBasis(shapes, S, S[-1], stride)


def _polynomials(stride: int) -> np.ndarray:
    """Coefficients, (power, point), of polynomials that are 1 at one of an interval's points."""
    return np.linalg.inv(np.vander(np.linspace(0, 1, stride + 1), increasing=True))


def _integrals(stride: int) -> np.ndarray:
    """Of what is known at the points of an interval of length 1, from 0 to each of them."""
    power, at = np.arange(stride + 1), np.linspace(0, 1, stride + 1)
    return (at[:, None] ** (power + 1) / (power + 1)) @ _polynomials(stride)


def _moments(stride: int) -> np.ndarray:
    """Integrals of (x - 1/2)^i over an interval that ends at each point but the first, (3, ..)."""
    power, at = np.arange(stride + 1), np.linspace(0, 1, stride + 1)[1:]
    x, w = np.polynomial.legendre.leggauss(stride + 2)
    x, w = 0.5 + 0.5 * x, 0.5 * w
    values = (at[:, None, None] * x[:, None]) ** power @ _polynomials(stride)
    return np.stack([np.einsum("x,axp->ap", w * (x - 0.5) ** i, values) for i in range(3)])


def attitudes(u: Vectors, h, first: Float[Array, "4"], stride: int) -> Float[Array, "points 4"]:
    """Quaternions at all points, from the curvatures there."""
    intervals = (u.shape[0] - 1) // stride
    local = u[np.arange(intervals)[:, None] * stride + np.arange(stride + 1)]
    parts = np.linspace(0, 1, stride + 1)[1:, None]
    A = jnp.sum(_moments(stride)[:, None, :, :, None] * local[:, None], 3)
    a = jnp.reshape(h, (-1, 1, 1)) * parts * A
    turns = quaternion_exp(_magnus(*a))
    at, found = first, [first[None]]
    for k in range(intervals):
        found.append(quaternion_product(at, turns[k]))
        at = found[-1][-1]
    return jnp.concatenate(found)


def _magnus(A0, A1, A2):
    """The rotation vector of an interval: as in `rod/shape.py`, of turns alone."""
    bracket = lambda a, b: -cross(a, b)
    a1, a2, a3 = 9 / 4 * A0 - 15 * A2, 12 * A1, -15 * A0 + 180 * A2
    c1 = bracket(a1, a2)
    c2 = -bracket(a1, 2 * a3 + c1) / 60
    return a1 + a3 / 12 + bracket(-20 * a1 - a3 + c1, a2 + c2) / 240


def moving(basis: StrainBasis, rod: Rod, motion: Motion) -> Moving:
    """Where everything is, and how it moves."""
    beyond, rate, second = basis.strains(jnp.stack(motion))
    strain = full_strain(rod.rest_strain, rod) + beyond
    h = attitudes(strain[:, 3:], rod.grid.h, rod.h_base, basis.stride)
    R = rotation_matrix(h)
    v, (v_t, u_t), (v_tt, u_tt) = strain[:, :3], _halves(rate), _halves(second)
    tangent, v_t, u_t, v_tt, u_tt = turned(R, v, v_t, u_t, v_tt, u_tt)
    w = basis.S @ u_t
    sideways = cross(w, tangent)
    both = basis.S @ jnp.concatenate([u_tt + cross(w, u_t), v_t + sideways], -1)
    w_t, p_t = _halves(both)
    p_tt = basis.S @ (v_tt + cross(w, 2 * v_t + sideways) + cross(w_t, tangent))
    return Moving(strain, h, R, tangent, p_t, w, p_tt, w_t)


def turned(R: Float[Array, "points 3 3"], *vectors: Vectors) -> Float[Array, "vectors points 3"]:
    """R a of each of the vectors. In components: a library's product of small matrices is slow."""
    return jnp.sum(R * jnp.stack(vectors)[:, :, None, :], -1)


def back(R: Float[Array, "points 3 3"], *vectors: Vectors) -> Float[Array, "vectors points 3"]:
    """R^T a of each of the vectors."""
    return jnp.sum(R * jnp.stack(vectors)[:, :, :, None], -2)


def _halves(pair: Float[Array, "points 6"]) -> tuple[Vectors, Vectors]:
    return pair[:, :3], pair[:, 3:]


class Laws(NamedTuple):
    """What strains do work on, at one instant: what does not change while they are sought.

    `rod` and `past`: there where the tensions follow from the strains, `problem` where not.
    """

    problem: LocalProblem | None
    rod: Rod
    past: Past | None


def laws(basis: StrainBasis, rod: Rod, past: Past | None) -> Laws:
    """Those of a rod under its inputs; `past` is `None` at rest."""
    if rod.constraint is not None:
        return Laws(None, rod, past)
    return Laws(_problem(basis, rod, past), rod, past)


def imbalances(basis: StrainBasis, laws: Laws, motion: Motion) -> Coordinates:
    """What is zero in a motion, [N m] for each coordinate."""
    problem, rod, past = laws
    here = moving(basis, rod, motion)
    if problem is None:
        rod = rod.under(tensions_by_length(basis, rod, here.strain))
        problem = _problem(basis, rod, past)
    stress = imbalance(problem, inner_strain(here.strain, rod))
    if rod.K_se is None:
        stress = jnp.concatenate([jnp.zeros_like(stress), stress], -1)
    f, l = _loads(basis, rod, here)
    N = basis.S.T @ f
    M = basis.S.T @ (l + cross(here.tangent, N))
    carried = jnp.concatenate([*back(here.R, N, M)], -1)
    return basis.along(basis.weights[:, None] * stress - carried)


def tensions_by_length(basis: StrainBasis, rod: Rod, strain: Float[Array, "points 6"]):
    """Of tendons whose lengths are given and which stretch [N]."""
    lengths = rod.constraint
    assert isinstance(lengths, GivenLengths), "conditions of one's own are refused"
    assert lengths.compliance is not None, "tendons that stretch"
    slack = jnp.zeros(lengths.count)
    gaps = lengths.gaps(rod, inner_strain(strain, rod), slack, basis.weights)
    return jnp.maximum(-gaps / lengths.compliance, 0.0)


def _problem(basis: StrainBasis, rod: Rod, past: Past | None) -> LocalProblem:
    """What strains do work on at the points, with damping."""
    none = jnp.zeros((rod.grid.s.shape[0], rod.strain_size))
    if past is None:
        return local_problem(rod, none)
    # x_t = c0 x + x_h, where the strains of the unloaded rod do not change.
    change = inner_strain(basis.strain(past.q_h), rod)
    history = change - past.c0 * jnp.broadcast_to(rod.rest_strain, none.shape)
    return local_problem(rod, none, past.c0, history, past.crept)


def _loads(basis: StrainBasis, rod: Rod, here: Moving) -> tuple[Vectors, Vectors]:
    """Forces [N] and moments [N m] at the points, base frame, those of inertia among them."""
    w, w_t, q = back(here.R, here.turning, here.turning_t, here.velocity)
    f = -rod.rho_A * here.acceleration
    if rod.weight is not None:
        f = f + rod.weight
    body = jnp.zeros_like(f)
    if rod.C is not None:
        body = -rod.C * q * jnp.abs(q)  # eq. 10
    l = -(rod.rho_J * w_t + cross(w, rod.rho_J * w))
    if rod.distributed_loads is not None:
        own = _distributed(basis, rod, here, q, w)
        body, l = body + own[:, :3], l + own[:, 3:]
    body, l = turned(here.R, body, l)
    f, l = basis.weights[:, None] * (f + body), basis.weights[:, None] * l
    tip = PointLoad(jnp.ones(1), rod.F_tip, rod.M_tip, rod.payload)
    f, l = _added(tip, rod, here, -1, 1.0, f, l)
    for load in rod.at_gaps or ():
        for number, gap in enumerate(rod.grid.gaps):
            f, l = _added(load, rod, here, gap * basis.stride, load.here[number], f, l)
    return f, l


def _added(load: PointLoad, rod: Rod, here: Moving, k: int, factor, f, l):
    """With what a load does that is at point k."""
    own = lambda a: here.R[k] @ a if load.frame == "body" else a
    if load.F is not None:
        f = f.at[k].add(factor * own(load.F))
    if load.M is not None:
        l = l.at[k].add(factor * own(load.M))
    if load.mass is not None:
        a = here.acceleration[k]
        a = a if rod.gravity is None else a - rod.gravity
        f = f.at[k].add(-factor * load.mass * a)
    return f, l


def _distributed(basis: StrainBasis, rod: Rod, here: Moving, q, w) -> Float[Array, "points 6"]:
    """The loads of users and of obstacles per unit of rod, body frame."""
    p = None if rod.p_base is None else rod.p_base + basis.S @ here.tangent
    s = rod.grid.s

    def at_point(s, h, q, w, p, radius):
        place = Here(s, h, q, w, p, radius)
        parts = [load.wrench(place) for load in rod.distributed_loads or ()]
        return jnp.concatenate([sum(x, jnp.zeros(3)) for x in zip(*parts)])

    radius = None if rod.radius is None else jnp.broadcast_to(rod.radius, s.shape)
    return jax.vmap(at_point)(s, here.attitude, q, w, p, radius)


def kinetic_energy(basis: StrainBasis, rod: Rod, here: Moving) -> Float[Array, ""]:
    """Of the rod and of all masses on it [J]."""
    w = back(here.R, here.turning)[0]
    v = here.velocity
    squares = jnp.sum(rod.rho_A * v**2, -1) + jnp.sum(rod.rho_J * w**2, -1)
    total = 0.5 * basis.weights @ squares
    if rod.payload is not None:
        total = total + 0.5 * rod.payload * (v[-1] @ v[-1])
    for load in rod.at_gaps or ():
        if load.mass is not None:
            at = v[rod.grid.gaps * basis.stride]
            total = total + 0.5 * load.mass * jnp.sum(load.here * jnp.sum(at**2, -1))
    return total


def strain_energy(basis: StrainBasis, rod: Rod, strain: Float[Array, "points 6"]):
    """Of sections, tendons under given tensions and chambers [J], and that of the unloaded rod."""
    x = inner_strain(strain, rod)
    return basis.weights @ potential(local_problem(rod, jnp.zeros(x.shape)), x)
