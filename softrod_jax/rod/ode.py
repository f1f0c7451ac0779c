"""The rod ODE: dy/ds of a Cosserat rod at one instant, a pure function.

Total-wrench form of Roshanfar et al. (2024), eq. 4 to 12, in the body frame. With the energy
of tendons and chambers inside the constitutive law (`constitutive.py`), every distributed
actuation term of the paper's form vanishes, and N, M are continuous along the rod.

Time derivatives are replaced by `y_t = c0 y + y_h` (paper eq. 14), with `y_h` from earlier
steps; in statics there are none, and q, omega are not part of the state.
The parts of the state are in `state.py`, the derivative by them in `jacobian.py`.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from softrod_jax.rod.constants import Rod
from softrod_jax.rod.constitutive import local_problem, recover_strain
from softrod_jax.rod.contact import ContactForce, force_on_rod
from softrod_jax.rod.friction import Slid
from softrod_jax.rod.rotations import cross, half_angle, to_base, to_body
from softrod_jax.rod.state import History, Layout, Points
from softrod_jax.scene.acting import Here
from softrod_jax.scene.planes import in_space, quaternion_in, turn_in, vector_in


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


def pointwise_problem(y, rod, layout, history):
    """That of the strains, for these states."""
    if layout.rubbing:
        rod = rod.rubbing(layout.losses_and_slips(y)[0])
    wrench = y[..., -rod.strain_size :]
    if history is None:
        return local_problem(rod, wrench)
    return local_problem(rod, wrench, history.c0, history.strain, history.crept)


def rates(y, strain, rod, layout, history):
    h, q, w, N, M = layout.split(y)
    v, u = strains_of(strain, rod, layout)
    p_s = h_s = q_s = w_s = None
    turned = half_angle(h) if layout.position else h  # without, there is one use of it
    if layout.position:
        p_s = to_base(turned, v)  # eq. 4
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
        N_s = N_s - to_body(turned, rod.weight)  # eq. 10: f_g = rho A g
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
    return rod.friction.after(*strains_of(fields.strain, rod, layout), *own)


def strains_of(strain, rod, layout):
    """(v, u)."""
    v, u = layout.split_strain(strain)
    if v is None:
        v = jnp.broadcast_to(rod.v_star, (*strain.shape[:-1], layout.vector))
    return v, u


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
    contacts = _contacts(rod)
    if not contacts:
        return jnp.zeros((0, 3))
    assert rod.s is not None and rod.radius is not None, "a rod in contact"
    f = _pushes(contacts, y[..., : layout.base_size], rod, layout, rod.s, rod.radius)
    return jnp.einsum("n,nik->ik", rod.grid.weights, f)


def pushes_per_length(
    base_part: Float[Array, "*points base"], rod: Rod, layout: Layout, s, radius
) -> Float[Array, "*points 3"]:
    """The force of all obstacles together [N/m], base frame, at any points along the rod."""
    return jnp.sum(_pushes(_contacts(rod), base_part, rod, layout, s, radius), -2)


def _contacts(rod: Rod) -> list[ContactForce]:
    return [x for x in rod.distributed_loads or () if isinstance(x, ContactForce)]


def _pushes(contacts, base_part, rod: Rod, layout: Layout, s, radius):
    """Of each obstacle, (*points, contacts, 3)."""
    factor = rod.load_factor
    assert factor is not None, "a rod with such loads"

    def at_point(base_part, s, radius):
        here = _here(base_part, rod, layout, s, radius)
        return jnp.stack([force_on_rod(contact, here) for contact in contacts])

    return factor * jnp.vectorize(at_point, signature="(n),(),()->(i,k)")(base_part, s, radius)


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
    return Here(s, quaternion_in(rod.plane, half_angle(h)), moving[:3], moving[3:], p, radius)


def _position_in_space(base_part, rod, layout):
    """With what the clamp is off the plane, if there is one."""
    across = lambda p: in_space(jnp.append(p, jnp.zeros(layout.turn)), rod.plane)[:3]
    return rod.p_base + across(base_part[: layout.vector] - vector_in(rod.plane, rod.p_base))
