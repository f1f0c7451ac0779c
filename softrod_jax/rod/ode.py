"""The rod ODE: dy/ds of a Cosserat rod at one instant, a pure function.

Total-wrench form of Roshanfar et al. (2024), eq. 4 to 12, in the body frame. With the energy
of tendons and chambers inside the constitutive law (`constitutive.py`), every distributed
actuation term of the paper's form vanishes, and N, M are continuous along the rod.

Time derivatives are replaced by `y_t = c0 y + y_h` (paper eq. 14), with `y_h` from earlier
steps; in statics there are none, and q, omega are not part of the state.

State, in this order, absent parts left out:

    p      3   position [m], base frame; only if a distributed load depends on it
    h      4   attitude quaternion (w, x, y, z), body to base; only if a load is fixed in the
               base frame (gravity, dead tip loads): nothing else depends on it
    q      3   linear velocity R^T p_t [m/s], dynamics only
    omega  3   angular velocity [rad/s], dynamics only
    psi    -   loss of tension of each tendon with friction, and
    d      -   its slip [m]; see `friction.py`
    N      3   total force R^T N [N]
    M      3   total moment R^T M [N m]

Where the position p is in no right-hand side, `shape.py` integrates it afterwards.

Of a rod that stays in a plane, `rod` has the components in the plane only, and so have states and
strains: two of q and N, one of omega and M, and an angle for the attitude; see `scene/planes.py`.
The equations are the same, with the products of `rotations.py` that fit. The strains of a rod that
is inextensible are u alone; v is v*.
"""

import functools
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from softrod_jax.foundation.products import product
from softrod_jax.rod.constants import Rod
from softrod_jax.rod.constitutive import compliance, imbalance, local_problem, recover_strain
from softrod_jax.rod.contact import ContactForce, force_on_rod
from softrod_jax.rod.friction import Slid, by_each_point
from softrod_jax.rod.relaxation import Crept
from softrod_jax.rod.rotations import cross, hat, hats, to_base, to_body
from softrod_jax.scene.acting import Here
from softrod_jax.scene.planes import in_space, quaternion_in, turn_in, vector_in

Points = Float[Array, "*points n"]


class History(NamedTuple):
    """y_t = c0 y + y_h for y = v, u, q, omega, at each point of the grid.

    - `c0` [1/s].
    - `strain` (v_h, u_h), (*points, 6); `velocity` (q_h, omega_h), (*points, 6).
    - `crept`: that of dashpots, (*points, branches, 6); `None` where nothing relaxes.
    """

    c0: Float[Array, ""]
    strain: Float[Array, "*points strain"]
    velocity: Float[Array, "*points pair"]
    crept: Crept | None = None


class Layout(eqx.Module):
    """Which parts the state has, and where. Static: known before tracing."""

    attitude: bool = eqx.field(static=True)
    dynamic: bool = eqx.field(static=True)
    inextensible: bool = eqx.field(static=True, default=False)
    planar: bool = eqx.field(static=True, default=False)
    position: bool = eqx.field(static=True, default=False)
    rubbing: int = eqx.field(static=True, default=0)

    @property
    def vector(self) -> int:
        """Components of a vector: v, q, N."""
        return 2 if self.planar else 3

    @property
    def turn(self) -> int:
        """Components of a turn: u, omega, M."""
        return 1 if self.planar else 3

    @property
    def pair(self) -> int:
        """Components of a vector and a turn: (q, omega), (N, M)."""
        return self.vector + self.turn

    @property
    def strain_size(self) -> int:
        """Components of the strains: (v, u), or u alone."""
        return self.turn if self.inextensible else self.pair

    @property
    def attitude_size(self) -> int:
        """Components of the attitude: a quaternion's, or an angle."""
        return (1 if self.planar else 4) * self.attitude

    @property
    def pose_size(self) -> int:
        """Components of (p, h), as far as they are there."""
        return self.vector * self.position + self.attitude_size

    @property
    def base_size(self) -> int:
        """How many components are given at the base: p, h, q, omega, psi."""
        return self.pose_size + self.pair * self.dynamic + self.rubbing

    @property
    def tip_size(self) -> int:
        """How many are given at the tip: d, N, M."""
        return self.rubbing + self.pair

    @property
    def size(self) -> int:
        return self.base_size + self.tip_size

    def split(self, y: Points) -> tuple[Any, Any, Any, Array, Array]:
        """(h, q, omega, N, M); None for one of the first three that is absent."""
        i = self.pose_size
        h = y[..., i - self.attitude_size : i] if self.attitude else None
        j, k = i + self.vector, i + self.pair
        q, w = (y[..., i:j], y[..., j:k]) if self.dynamic else (None, None)
        return h, q, w, y[..., -self.pair : -self.turn], y[..., -self.turn :]

    def losses_and_slips(self, y: Points) -> tuple[Array, Array]:
        """(psi, d), (*points, rubbing) each."""
        k = self.base_size
        return y[..., k - self.rubbing : k], y[..., k : k + self.rubbing]

    def with_losses_and_slips(self, y: Points, psi, d) -> Points:
        """The states with others."""
        k = self.base_size - self.rubbing
        return y.at[..., k : k + 2 * self.rubbing].set(jnp.concatenate([psi, d], -1))

    def split_strain(self, strain: Float[Array, "*points strain"]) -> tuple[Any, Array]:
        """(v, u); None for v where the rod is inextensible."""
        if self.inextensible:
            return None, strain
        return strain[..., : self.vector], strain[..., self.vector :]

    def join(self, *parts) -> Points:
        return jnp.concatenate([p for p in parts if p is not None], axis=-1)


def layout_of(rod: Rod, dynamic: bool) -> Layout:
    """The state that `rod` needs at rest or, `dynamic`, in motion."""
    return Layout(
        attitude=rod.has_dead_load,
        dynamic=dynamic,
        inextensible=rod.K_se is None,
        planar=rod.plane is not None,
        position=rod.p_base is not None,
        rubbing=0 if rod.friction is None else rod.friction.count,
    )


class Rates(NamedTuple):
    """What the ODE gives at a point: dy/ds, the strains (v, u), and if those exist."""

    y_s: Points
    strain: Float[Array, "*points strain"]
    solvable: Bool[Array, ""]


def rod_ode(
    y: Points,
    rod: Rod,
    layout: Layout,
    history: History | None,
    guess: Float[Array, "*#points strain"],
) -> Rates:
    """dy/ds, for one point or for many: where numbers of the rod vary, for those of its points.

    `guess` (*points, 6): strains from which the pointwise solve starts (tendons only); the
    answer does not depend on it.
    """
    problem = pointwise_problem(y, rod, layout, history)
    strain, solvable = recover_strain(problem, guess)
    return Rates(rates(y, strain, rod, layout, history), strain, solvable)


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


def pointwise_problem(y, rod, layout, history):
    """That of the strains, for these states."""
    if layout.rubbing:
        rod = rod.rubbing(layout.losses_and_slips(y)[0])
    wrench = y[..., -rod.strain_size :]
    if history is None:
        return local_problem(rod, wrench)
    return local_problem(rod, wrench, history.c0, history.strain, history.crept)


def _pull_by_loss(y, strain, rod, layout, history):
    """See `Jacobian.pull`."""
    k = layout.base_size
    own = slice(k - layout.rubbing, k)
    pull = lambda psi: (
        -imbalance(pointwise_problem(y.at[..., own].set(psi), rod, layout, history), strain)
    )
    return by_each_point(pull, y[..., own])


def rates(y, strain, rod, layout, history):
    h, q, w, N, M = layout.split(y)
    v, u = _strains(strain, rod, layout)
    p_s = h_s = q_s = w_s = None
    if layout.position:
        p_s = to_base(h, v)  # eq. 4
    if layout.attitude and layout.planar:
        h_s = u
    elif layout.attitude:
        a, r = h[..., :1], h[..., 1:]  # R_s = R u^ (eq. 4), as h_s = 1/2 h o (0, u)
        h_s = 0.5 * jnp.concatenate([-jnp.sum(r * u, -1, keepdims=True), a * u + cross(r, u)], -1)
    N_s = -cross(u, N)  # R^T (R N)_s = N_s + u^ N
    M_s = -cross(u, M) - cross(v, N)  # eq. 4: m_s = ... - p_s^ n
    if layout.dynamic:
        c0 = history.c0
        v_h, u_h = layout.split_strain(history.strain)
        q_h, w_h = history.velocity[..., : layout.vector], history.velocity[..., layout.vector :]
        u_t, q_t, w_t = c0 * u + u_h, c0 * q + q_h, c0 * w + w_h
        if layout.inextensible:
            q_s = cross(w, v) - cross(u, q)
        else:
            q_s = c0 * v + v_h - cross(u, q) + cross(w, v)  # eq. 4
        w_s = u_t - cross(u, w)  # eq. 4
        N_s = N_s + rod.rho_A * (cross(w, q) + q_t)  # eq. 4: n_s = rho A R (w^ q + q_t) - f
        M_s = M_s + cross(w, rod.rho_J * w) + rod.rho_J * w_t  # eq. 4
        if rod.C is not None:
            N_s = N_s + rod.C * q * jnp.abs(q)  # eq. 10: f_d = -R C (q o |q|)
    if rod.weight is not None:
        N_s = N_s - to_body(h, rod.weight)  # eq. 10: f_g = rho A g
    if rod.distributed_loads is not None:
        applied = distributed(y[..., : layout.base_size], rod, layout)
        N_s, M_s = N_s - applied[..., : layout.vector], M_s - applied[..., layout.vector :]
    psi_s = d_s = None
    if layout.rubbing:
        psi_s, d_s = rod.friction.rates(v, u, layout.losses_and_slips(y)[1])
    return layout.join(p_s, h_s, q_s, w_s, psi_s, d_s, N_s, M_s)


def slid_after(fields, rod: Rod, layout: Layout) -> Slid | None:
    """How tendons with friction have slid where states and strains at all points are `fields`."""
    if rod.friction is None:
        return None
    own = layout.losses_and_slips(fields.y)
    return rod.friction.after(*_strains(fields.strain, rod, layout), *own)


def _strains(strain, rod, layout):
    """(v, u)."""
    v, u = layout.split_strain(strain)
    if v is None:
        v = jnp.broadcast_to(rod.v_star, (*strain.shape[:-1], layout.vector))
    return v, u


def _partial_derivatives(y, strain, rod, layout, history):
    """Of `rates`: by y at fixed strain, (*points, n, n), and by the strain, (*points, n, 6)."""
    h, q, w, N, M = layout.split(y)
    v, u = _strains(strain, rod, layout)
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
        return jnp.concatenate(rod.friction.rates(*_strains(strain, rod, layout), slip), -1)

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


def distributed(base_part, rod: Rod, layout: Layout, of=lambda f: f, shape="(i)"):
    """The loads of users per unit of rod in the body frame, (*points, 6), or their derivative."""
    loads, factor = rod.distributed_loads or (), rod.load_factor
    assert loads and factor is not None, "a rod with such loads"

    def at_point(base_part, *numbers):
        here = _here(base_part, rod, layout, *numbers)
        wrenches = [load.wrench(here) for load in loads]
        f, l = (sum(parts, jnp.zeros(3)) for parts in zip(*wrenches))
        applied = jnp.concatenate([vector_in(rod.plane, f), turn_in(rod.plane, l)])
        return factor * applied

    return _at_points(of(at_point), shape, base_part, rod)


def contact_forces(y: Points, rod: Rod, layout: Layout) -> Float[Array, "contacts 3"]:
    """The force of each obstacle on the whole rod [N], base frame."""
    contacts = [x for x in rod.distributed_loads or () if isinstance(x, ContactForce)]
    if not contacts:
        return jnp.zeros((0, 3))
    factor = rod.load_factor
    assert factor is not None, "a rod with such loads"

    def at_point(base_part, *numbers):
        here = _here(base_part, rod, layout, *numbers)
        return jnp.stack([force_on_rod(contact, here) for contact in contacts])

    f = _at_points(at_point, "(i,k)", y[..., : layout.base_size], rod)
    return factor * jnp.einsum("n,nik->ik", rod.grid.weights, f)


def _at_points(function, shape, base_part, rod: Rod):
    """Of each point: its state's components from the base, and what varies along the rod."""
    numbers = [x for x in (rod.s, rod.radius) if x is not None]
    signature = f"(n){',()' * len(numbers)}->{shape}"
    return jnp.vectorize(function, signature=signature)(base_part, *numbers)


def _here(base_part, rod: Rod, layout: Layout, s, radius=None) -> Here:
    h, q, w, _, _ = layout.split(jnp.concatenate([base_part, jnp.zeros(layout.pair)]))
    still = jnp.zeros(layout.pair)
    moving = jnp.concatenate([q, w]) if layout.dynamic else still
    moving = in_space(moving, rod.plane)
    p = _position_in_space(base_part, rod, layout) if layout.position else None
    return Here(s, quaternion_in(rod.plane, h), moving[:3], moving[3:], p, radius)


def _position_in_space(base_part, rod, layout):
    """With what the clamp is off the plane, if there is one."""
    across = lambda p: in_space(jnp.append(p, jnp.zeros(layout.turn)), rod.plane)[:3]
    return rod.p_base + across(base_part[: layout.vector] - vector_in(rod.plane, rod.p_base))


def sizes(Y: Points, rod: Rod, layout: Layout, history: History | None) -> Float[Array, "n"]:
    """Sizes of the state's components: a bent rod's, or those of `Y` if larger."""
    rate = 1.0 if history is None else history.c0
    EI = jnp.max(rod.K_bt[..., :2])
    if history is not None and rod.B_bt is not None:
        EI = EI + rate * jnp.max(rod.B_bt[..., :2])
    N = jnp.max(jnp.abs(Y[:, -layout.pair : -layout.turn]))
    M = jnp.max(jnp.abs(Y[:, -layout.turn :]))
    vector = turn = jnp.ones(layout.vector)
    if layout.planar:
        turn = jnp.ones(layout.turn)
    return layout.join(
        rod.L * vector if layout.position else None,
        jnp.ones(layout.attitude_size) if layout.attitude else None,
        rate * rod.L * vector if layout.dynamic else None,
        rate * turn if layout.dynamic else None,
        # Losses follow turns: what a first, frictionless correction leaves of them is no sign that
        # Newton's method is far away.
        10.0 * jnp.ones(layout.rubbing),
        rod.L * jnp.ones(layout.rubbing),
        (EI / rod.L**2 + N) * vector,
        (EI / rod.L + M) * turn,
    )
