"""The rod ODE: dy/ds of a Cosserat rod at one instant, a pure function.

Total-wrench form of Roshanfar et al. (2024), eq. 4 to 12, in the body frame. With the energy
of tendons and chambers inside the constitutive law (`constitutive.py`), every distributed
actuation term of the paper's form vanishes, and N, M are continuous along the rod.

Time derivatives are replaced by `y_t = c0 y + y_h` (paper eq. 14), with `y_h` from earlier
steps; in statics there are none, and q, omega are not part of the state.

State, in this order, absent parts left out:

    h      4   attitude quaternion (w, x, y, z), body to base; only if a load is fixed in the
               base frame (gravity, dead tip loads): nothing else depends on it
    q      3   linear velocity R^T p_t [m/s], dynamics only
    omega  3   angular velocity [rad/s], dynamics only
    N      3   total force R^T N [N]
    M      3   total moment R^T M [N m]

The position p is in no right-hand side: `shape.py` integrates it afterwards.
"""

from typing import NamedTuple, Optional

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from softrod_jax.constitutive import compliance, local_problem, recover_strain
from softrod_jax.rod import Rod
from softrod_jax.rotations import cross, hat, to_body

Points = Float[Array, "*points n"]


class History(NamedTuple):
    """y_t = c0 y + y_h for y = v, u, q, omega, at each point of the grid.

    - `c0` [1/s].
    - `strain` (v_h, u_h), (*points, 6); `velocity` (q_h, omega_h), (*points, 6).
    """

    c0: Float[Array, ""]
    strain: Float[Array, "*points 6"]
    velocity: Float[Array, "*points 6"]


class Layout(eqx.Module):
    """Which parts the state has, and where. Static: known before tracing."""

    attitude: bool = eqx.field(static=True)
    dynamic: bool = eqx.field(static=True)

    @property
    def base_size(self) -> int:
        """How many components are given at the base (h, q, omega); N and M follow."""
        return 4 * self.attitude + 6 * self.dynamic

    @property
    def size(self) -> int:
        return self.base_size + 6

    def split(self, y: Points):
        """(h, q, omega, N, M); None for a part that is absent."""
        h = y[..., :4] if self.attitude else None
        i = 4 * self.attitude
        q, w = (y[..., i : i + 3], y[..., i + 3 : i + 6]) if self.dynamic else (None, None)
        return h, q, w, y[..., -6:-3], y[..., -3:]

    def join(self, *parts) -> Points:
        return jnp.concatenate([p for p in parts if p is not None], axis=-1)


class Rates(NamedTuple):
    """What the ODE gives at a point: dy/ds, the strains (v, u), and if those exist."""

    y_s: Points
    strain: Float[Array, "*points 6"]
    solvable: Bool[Array, ""]


def rod_ode(
    s, y: Points, rod: Rod, layout: Layout, history: Optional[History], guess: Points
) -> Rates:
    """dy/ds at arc length `s` [m], for one point or for many.

    `guess` (*points, 6): strains from which the pointwise solve starts (tendons only); the
    answer does not depend on it.
    """
    problem = pointwise_problem(s, y, rod, history)
    strain, solvable = recover_strain(problem, guess)
    return Rates(rates(y, strain, rod, layout, history), strain, solvable)


class Jacobian(NamedTuple):
    """Derivatives with the strains at the solution of their pointwise problem.

    - `state`: d(dy/ds)/dy, (*points, n, n), the strains following.
    - `compliance`: d(v, u)/d(N, M), (*points, 6, 6); `wrench`: what follows from it alone for
      dy/ds, (*points, n, 6).
    """

    state: Float[Array, "*points n n"]
    compliance: Float[Array, "*points 6 6"]
    wrench: Float[Array, "*points n 6"]


def rod_ode_jacobian(
    s, y: Points, strain, rod: Rod, layout: Layout, history: Optional[History]
) -> Jacobian:
    """The derivative of `rod_ode` by y.

    Written out, because 16 forward tangents of `rod_ode` cost several times as much.
    """
    f_y, f_strain = _partial_derivatives(y, strain, rod, layout, history)
    problem = pointwise_problem(s, y, rod, history)
    C = compliance(problem, strain)
    by_wrench = f_strain / problem.k if problem.tau is None else f_strain @ C
    return Jacobian(f_y.at[..., -6:].add(by_wrench), C, by_wrench)


def pointwise_problem(s, y, rod, history):
    c0, strain_history = (None, None) if history is None else (history.c0, history.strain)
    return local_problem(rod, s, y[..., -6:], c0, strain_history)


def rates(y, strain, rod, layout, history):
    h, q, w, N, M = layout.split(y)
    v, u = strain[..., :3], strain[..., 3:]
    h_s = q_s = w_s = None
    if layout.attitude:
        a, r = h[..., :1], h[..., 1:]  # R_s = R u^ (eq. 4), as h_s = 1/2 h o (0, u)
        h_s = 0.5 * jnp.concatenate(
            [-jnp.sum(r * u, -1, keepdims=True), a * u + cross(r, u)], -1
        )
    N_s = -cross(u, N)  # R^T (R N)_s = N_s + u^ N
    M_s = -cross(u, M) - cross(v, N)  # eq. 4: m_s = ... - p_s^ n
    if layout.dynamic:
        c0 = history.c0
        v_t, u_t = c0 * v + history.strain[..., :3], c0 * u + history.strain[..., 3:]
        q_t, w_t = c0 * q + history.velocity[..., :3], c0 * w + history.velocity[..., 3:]
        q_s = v_t - cross(u, q) + cross(w, v)  # eq. 4
        w_s = u_t - cross(u, w)  # eq. 4
        N_s = N_s + rod.rho_A * (cross(w, q) + q_t)  # eq. 4: n_s = rho A R (w^ q + q_t) - f
        M_s = M_s + cross(w, rod.rho_J * w) + rod.rho_J * w_t  # eq. 4
        if rod.C is not None:
            N_s = N_s + rod.C * q * jnp.abs(q)  # eq. 10: f_d = -R C (q o |q|)
    if rod.weight is not None:
        N_s = N_s - to_body(h, rod.weight)  # eq. 10: f_g = rho A g
    return layout.join(h_s, q_s, w_s, N_s, M_s)


def _partial_derivatives(y, strain, rod, layout, history):
    """Of `rates`: by y at fixed strain, (*points, n, n), and by the strain, (*points, n, 6)."""
    h, q, w, N, M = layout.split(y)
    v, u = strain[..., :3], strain[..., 3:]
    zero = jnp.zeros((*y.shape[:-1], 3, 3))
    eye = jnp.broadcast_to(jnp.eye(3), zero.shape)
    u_hat, v_hat, N_hat, M_hat = hat(u), hat(v), hat(N), hat(M)

    # Rows N and M; columns (h), (q, omega), N, M and then v, u.
    N_row, M_row = [-u_hat, zero], [-v_hat, -u_hat]
    N_strain, M_strain = [zero, N_hat], [N_hat, M_hat]
    rows, strains = [], []
    if layout.dynamic:
        c0, q_hat, w_hat = history.c0, hat(q), hat(w)
        drive = c0 * eye + w_hat
        N_q = rod.rho_A * drive
        if rod.C is not None:
            N_q = N_q + 2 * (rod.C * jnp.abs(q))[..., None] * eye
        # w_hat J: scale columns by J. J-weighted omega: (J omega)^.
        M_w = w_hat * rod.rho_J - hat(rod.rho_J * w) + c0 * rod.rho_J * eye
        N_row = [N_q, -rod.rho_A * q_hat] + N_row
        M_row = [zero, M_w] + M_row
        rows = [[-u_hat, -v_hat, zero, zero], [zero, -u_hat, zero, zero]]
        strains = [[drive, q_hat], [zero, drive]]
    rows, strains = rows + [N_row, M_row], strains + [N_strain, M_strain]
    f_y = _blocks(rows)
    f_strain = _blocks(strains)
    if layout.attitude:
        f_y, f_strain = _with_attitude(f_y, f_strain, h, u, rod, layout)
    return f_y, f_strain


def _with_attitude(f_y, f_strain, h, u, rod, layout):
    """Prepend the rows and columns of the quaternion."""
    a, r = h[..., 0, None, None], h[..., 1:]
    top = jnp.concatenate([-r[..., None, :], a * jnp.eye(3) + hat(r)], -2)  # dh_s/du, times 2
    o = jnp.zeros_like(u[..., :1])
    h_row = jnp.concatenate([o, -u], -1)[..., None, :]
    spin = jnp.concatenate([h_row, jnp.concatenate([u[..., :, None], -hat(u)], -1)], -2)
    columns = jnp.zeros((*f_y.shape[:-1], 4))
    if rod.weight is not None:
        columns = columns.at[..., -6:-3, :].set(-to_body_by_attitude(h, rod.weight))
    right = jnp.concatenate([columns, f_y], -1)
    left = jnp.concatenate([0.5 * spin, jnp.zeros((*f_y.shape[:-2], 4, f_y.shape[-1]))], -1)
    strain_top = jnp.concatenate([jnp.zeros((*f_y.shape[:-2], 4, 3)), 0.5 * top], -1)
    return jnp.concatenate([left, right], -2), jnp.concatenate([strain_top, f_strain], -2)


def to_body_by_attitude(h, a):
    """d(R(h)^T a)/dh, (*points, 3, 4)."""
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


class Tip(NamedTuple):
    """The wrench (N, M) that the tip's surroundings ask for, (6,), and its derivative."""

    wrench: Float[Array, "6"]
    by_base_part: Float[Array, "6 a"]


def tip_condition(y: Float[Array, "n"], rod: Rod, layout: Layout, history) -> Tip:
    """(N, M) at s = L as a function of h, q and omega there (paper eq. 13, total wrench).

    Zero for a free tip, whatever the actuators do. `history` is the one at s = L.
    """

    def wrench(base_part):
        h, q, w, _, _ = layout.split(jnp.concatenate([base_part, jnp.zeros(6)]))
        N, M = jnp.zeros(3), jnp.zeros(3)
        if rod.F_tip is not None:
            N = N + to_body(h, rod.F_tip)
        if rod.M_tip is not None:
            M = M + to_body(h, rod.M_tip)
        if rod.payload is not None:
            if rod.gravity is not None:
                N = N + rod.payload * to_body(h, rod.gravity)
            if layout.dynamic:
                q_t = history.c0 * q + history.velocity[:3]
                N = N - rod.payload * (q_t + cross(w, q))
        return jnp.concatenate([N, M])

    base_part = y[: layout.base_size]
    if all(x is None for x in (rod.F_tip, rod.M_tip, rod.payload)):
        return Tip(jnp.zeros(6), jnp.zeros((6, layout.base_size)))
    return Tip(wrench(base_part), jax.jacfwd(wrench)(base_part))
