"""The state of the rod ODE: its parts, their order and their sizes.

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

from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from softrod_jax.rod.constants import Rod
from softrod_jax.rod.relaxation import Crept

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
