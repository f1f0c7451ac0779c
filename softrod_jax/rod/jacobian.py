"""The derivative of the rod ODE by its state, written out.

It is what Newton's method needs most of: 16 forward tangents cost several times as much.
"""

import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from softrod_jax.foundation.products import product
from softrod_jax.rod.constants import Rod
from softrod_jax.rod.constitutive import compliance, imbalance
from softrod_jax.rod.friction import by_each_point
from softrod_jax.rod.ode import distributed, pointwise_problem, strains_of
from softrod_jax.rod.rotations import cross, hat, hats, to_base, to_body
from softrod_jax.rod.state import History, Layout, Points


class Jacobian(NamedTuple):
    """Derivatives with the strains at the solution of their pointwise problem.

    - `state`: d(dy/ds)/dy, (*points, n, n), the strains following.
    - `compliance`: d(v, u)/d(N, M), (*points, 6, 6); `wrench`: what follows from it alone for
      dy/ds, (*points, n, 6).
    - `pull`: the wrench that a loss of tension takes away, by the losses, (*points, 6, rubbing);
      `None` without friction.
    """

    state: Float[Array, "*points n n"]
    compliance: Float[Array, "*points strain strain"]
    wrench: Float[Array, "*points n strain"]
    pull: Float[Array, "*points strain rubbing"] | None = None


def rod_ode_jacobian(
    y: Points, strain, rod: Rod, layout: Layout, history: History | None
) -> Jacobian:
    """The derivative of `rod_ode` by y.

    Written out, because 16 forward tangents of `rod_ode` cost several times as much.
    """
    f_y, f_strain = _partial_derivatives(y, strain, rod, layout, history)
    problem = pointwise_problem(y, rod, layout, history)
    C = compliance(problem, strain)
    by_wrench = f_strain / problem.k[..., None, :] if problem.explicit else product(f_strain, C)
    n, pull = rod.strain_size, None
    state = jnp.concatenate([f_y[..., :-n], f_y[..., -n:] + by_wrench], -1)
    if layout.rubbing:
        pull = _pull_by_loss(y, strain, rod, layout, history)
        k = layout.base_size
        state = state.at[..., k - layout.rubbing : k].add(by_wrench @ pull)
    return Jacobian(state, C, by_wrench, pull)


def _pull_by_loss(y, strain, rod, layout, history):
    """See `Jacobian.pull`."""
    k = layout.base_size
    own = slice(k - layout.rubbing, k)
    pull = lambda psi: (
        -imbalance(pointwise_problem(y.at[..., own].set(psi), rod, layout, history), strain)
    )
    return by_each_point(pull, y[..., own])


def _partial_derivatives(y, strain, rod, layout, history):
    """Of `rates`: by y at fixed strain, (*points, n, n), and by the strain, (*points, n, 6)."""
    h, q, w, N, M = layout.split(y)
    v, u = strains_of(strain, rod, layout)
    vector, turn = layout.vector, layout.turn
    zero = functools.cache(lambda i, j: jnp.zeros((*y.shape[:-1], i, j)))
    eye = functools.cache(lambda n: jnp.broadcast_to(jnp.eye(n), (*y.shape[:-1], n, n)))
    # Hats that act on vectors like v (_v), and on turns like u (_u). In space they are the same.
    (u_v, u_u), (v_v, v_u), (N_v, N_u), (_, M_u) = hats(u), hats(v), hats(N), hats(M)

    # Rows N and M; columns (h), (q, omega), N, M and then v, u.
    N_row, M_row = [-u_v, zero(vector, turn)], [-v_v, -u_u]
    N_strain, M_strain = [zero(vector, vector), N_u], [N_v, M_u]
    rows, strains = [], []
    if layout.dynamic:
        c0, (_, q_u), (w_v, w_u) = history.c0, hats(q), hats(w)
        drive = c0 * eye(vector) + w_v
        drive_u = drive if vector == turn else c0 * eye(turn) + w_u
        N_q = rod.rho_A[..., None] * drive
        if rod.C is not None:
            N_q = N_q + 2 * (rod.C * jnp.abs(q))[..., None] * eye(vector)
        # w_hat J: scale columns by J. J-weighted omega: (J omega)^.
        rho_J = rod.rho_J[..., None, :]
        M_w = w_u * rho_J - hats(rod.rho_J * w)[1] + c0 * rho_J * eye(turn)
        N_row = [N_q, -rod.rho_A[..., None] * q_u] + N_row
        M_row = [zero(turn, vector), M_w] + M_row
        rows = [
            [-u_v, -v_u, zero(vector, vector), zero(vector, turn)],
            [zero(turn, vector), -u_u, zero(turn, vector), zero(turn, turn)],
        ]
        strains = [[drive, q_u], [zero(turn, vector), drive_u]]
    rows, strains = rows + [N_row, M_row], strains + [N_strain, M_strain]
    f_y = _blocks(rows)
    # The columns of v, if it is unknown, and of u.
    f_strain = _blocks([row[layout.inextensible :] for row in strains])
    if layout.attitude:
        f_y, f_strain = _with_attitude(f_y, f_strain, h, u, rod, layout)
    if layout.position:
        f_y, f_strain = _with_position(f_y, f_strain, h, v, layout)
    if layout.rubbing:
        f_y, f_strain = _with_friction(f_y, f_strain, y, strain, rod, layout)
    if rod.distributed_loads is not None:
        base_part = y[..., : layout.base_size]
        slope = distributed(base_part, rod, layout, jax.jacfwd, "(i,n)")
        f_y = f_y.at[..., -layout.pair :, : layout.base_size].add(-slope)
    return f_y, f_strain


def _with_attitude(f_y, f_strain, h, u, rod, layout):
    """Prepend the rows and columns of the quaternion, or of the angle."""
    points, n = f_y.shape[:-2], layout.attitude_size
    if layout.planar:
        spin, top = jnp.zeros((*points, 1, 1)), jnp.ones((*points, 1, 1))
    else:
        a, r = h[..., 0, None, None], h[..., 1:]
        top = jnp.concatenate([-r[..., None, :], a * jnp.eye(3) + hat(r)], -2)  # times 2
        o = jnp.zeros_like(u[..., :1])
        h_row = jnp.concatenate([o, -u], -1)[..., None, :]
        spin = jnp.concatenate([h_row, jnp.concatenate([u[..., :, None], -hat(u)], -1)], -2)
        spin, top = 0.5 * spin, 0.5 * top  # dh_s/dh and dh_s/du
    columns = jnp.zeros((*f_y.shape[:-1], n))
    if rod.weight is not None:
        rows = slice(-layout.pair, -layout.turn)
        columns = columns.at[..., rows, :].set(-to_body_by_attitude(h, rod.weight))
    right = jnp.concatenate([columns, f_y], -1)
    left = jnp.concatenate([spin, jnp.zeros((*points, n, f_y.shape[-1]))], -1)
    if not layout.inextensible:
        top = jnp.concatenate([jnp.zeros((*points, n, layout.vector)), top], -1)
    return jnp.concatenate([left, right], -2), jnp.concatenate([top, f_strain], -2)


def _with_position(f_y, f_strain, h, v, layout):
    """Prepend the rows and columns of the position; loads that depend on it come later."""
    points, m, n = f_y.shape[:-2], layout.vector, layout.attitude_size
    by_attitude = jnp.vectorize(jax.jacfwd(to_base), signature="(n),(m)->(m,n)")(h, v)
    R = jnp.swapaxes(to_base(h[..., None, :], jnp.eye(m)), -1, -2)
    none = lambda rows, columns: jnp.zeros((*points, rows, columns))
    top = jnp.concatenate([none(m, m), by_attitude, none(m, f_y.shape[-1] - n)], -1)
    below = jnp.concatenate([none(f_y.shape[-2], m), f_y], -1)
    stretch = [] if layout.inextensible else [R]
    by_strain = jnp.concatenate([*stretch, none(m, layout.turn)], -1)
    return jnp.concatenate([top, below], -2), jnp.concatenate([by_strain, f_strain], -2)


def _with_friction(f_y, f_strain, y, strain, rod, layout):
    """Insert the rows and columns of losses and slips before those of N and M."""
    slip = layout.losses_and_slips(y)[1]
    at = layout.base_size - layout.rubbing

    def own(strain, slip):
        return jnp.concatenate(rod.friction.rates(*strains_of(strain, rod, layout), slip), -1)

    by_slip = by_each_point(lambda slip: own(strain, slip), slip)
    by_strain = by_each_point(lambda strain: own(strain, slip), strain)
    between = lambda a, rows, axis: jnp.concatenate(
        [*jnp.split(a, [at], axis)[:1], rows, *jnp.split(a, [at], axis)[1:]], axis
    )
    m = by_slip.shape[-2]
    f_y = between(f_y, jnp.zeros((*f_y.shape[:-1], m)), -1)
    rows = jnp.zeros((*f_y.shape[:-2], m, f_y.shape[-1]))
    rows = rows.at[..., layout.base_size : layout.base_size + layout.rubbing].set(by_slip)
    return between(f_y, rows, -2), between(f_strain, by_strain, -2)


def to_body_by_attitude(h, a):
    """d(R(h)^T a)/dh, (*points, 3, 4); in a plane, of an angle h, (*points, 2, 1)."""
    if h.shape[-1] == 1:
        b = to_body(h, a)
        return jnp.stack([-b[..., 1], b[..., 0]], -1)[..., None]
    w, r = h[..., 0, None, None], h[..., 1:]
    a = jnp.broadcast_to(a, r.shape)
    k = 2 / jnp.sum(h * h, -1)[..., None, None]
    ar = jnp.sum(a * r, -1)[..., None, None]
    outer = r[..., :, None] * a[..., None, :]
    eye = jnp.eye(3)
    # R^T a = a - k (w r x a - r x (r x a)); then the norm, which k hides.
    by_w = -cross(r, a)[..., None]
    by_r = w * hat(a) + ar * eye + outer - 2 * jnp.swapaxes(outer, -1, -2)
    by_h = k * jnp.concatenate([by_w, by_r], -1)
    moved = to_body(h, a) - a
    return by_h - k * moved[..., :, None] * h[..., None, :]


def _blocks(rows):
    return jnp.concatenate([jnp.concatenate(row, -1) for row in rows], -2)
