"""The rod's numbers: a scene with its actuation, reduced to what the rod equations use.

Everything that does not change during a solve is computed here, once. What is the same along the
rod is there once; what varies has a value for every point of the grid, as the first axis.
Absent parts are `None`, so the equations never see them. Of a scene in a plane only what is in the
plane is left: two numbers for a vector and one for a turn (`scene/planes.py`).
"""

import dataclasses
from collections.abc import Sequence

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from softrod_jax.rod.constraint import AbstractConstraint
from softrod_jax.rod.fibres import Fibres
from softrod_jax.rod.friction import Friction, Slid, sliding_throughout
from softrod_jax.rod.grid import Grid
from softrod_jax.rod.relaxation import Relaxation
from softrod_jax.scene.acting import AbstractDissipation, AbstractDistributedLoad, AbstractEnergy
from softrod_jax.scene.planes import in_space, turn_in, vector_in

Scalar = Float[Array, ""]


class PointLoad(eqx.Module):
    """A load or a mass at one place along the rod.

    `F` [N] and `M` [N m]: in the base frame or, with `frame` "body", in that of the section.
    `mass` [kg]. `here`, (gaps,): 1 at the gap between parts where it is, else 0.
    """

    here: Float[Array, "gaps"]
    F: Float[Array, "vector"] | None = None
    M: Float[Array, "turn"] | None = None
    mass: Scalar | None = None
    frame: str = eqx.field(static=True, default="base")


class Rod(eqx.Module):
    """Constants of the rod equations (paper eq. 4 to 12; letters as there).

    Those marked * may vary along the rod, and have then a first axis for the points of the `grid`.

    - `K_se`* [N] and `K_bt`* [N m^2]: (3,) diagonals; `v_star`*, `u_star`*: (3,).
    - `B_se`* [N s], `B_bt`* [N m^2 s]: (3,) or None. `C`* [kg/m^2]: (3,) or None.
    - `rho_A`* [kg/m], (1,); `rho_J`* [kg m]: (3,), rho diag(Ixx, Iyy, Ixx + Iyy).
    - `weight`* = rho A g [N/m], (3,), base frame, or None.
    - `tau`* [N]: tensions, (tendons,), or None, of tendons at `r`* [m], (tendons, 3), with the
      slopes `r_s`*, or None where they are straight. `front_viscosity`* [s^2], (1,): that of the
      tendons' paths per tension, in a motion; see `constitutive.py`.
    - `n_ch`* [N], `m_ch`* [N m]: (3,), body frame: -dW_act/d(v, u) of the chambers, or None.
    - `payload` [kg] or None; `gravity` [m/s^2] or None; `F_tip` [N], `M_tip` [N m] or None.
    - `at_gaps`: loads and masses along the rod.
    - `fibres`*: of rubber, or None; `K_se` and `K_bt` are then their stiffness at small strain.
    - `relaxation`*: of a rod in motion, or None; `K_se` and `K_bt` are then its stiffness at once.
    - `material`, `dissipations` (of a rod in motion), `energies`, `distributed_loads`: those of
      users, at arc lengths `s`* [m]; the last
      two times `load_factor`.
    - `constraint`: conditions on the whole rod, whose multipliers act on it. `friction`: of
      tendons in their channels; `tau` is then what acts at their actuators.
    - `radius`* [m]: of the sections, or None where nothing touches the rod.
    - `h_base`: quaternion of the clamp, (4,). `p_base` [m], (3,): its position, or None where no
      load depends on the position. `base_velocity`: (q, omega) of the clamp, (6,), or None where
      it stands still.

    `K_se` is None for an inextensible rod. In a `plane`, a vector (v, q, N) has two components
    instead of three and a turn (u, omega, M) one; `h_base` is an angle, (1,).
    """

    grid: Grid
    K_se: Float[Array, "... vector"] | None
    K_bt: Float[Array, "... turn"]
    v_star: Float[Array, "... vector"]
    u_star: Float[Array, "... turn"]
    rho_A: Float[Array, "... 1"]
    rho_J: Float[Array, "... turn"]
    h_base: Float[Array, "attitude"]
    p_base: Float[Array, "3"] | None = None
    base_velocity: Float[Array, "pair"] | None = None
    B_se: Float[Array, "... vector"] | None = None
    B_bt: Float[Array, "... turn"] | None = None
    C: Float[Array, "... vector"] | None = None
    gravity: Float[Array, "vector"] | None = None
    weight: Float[Array, "... vector"] | None = None
    tau: Float[Array, "... tendons"] | None = None
    r: Float[Array, "... tendons vector"] | None = None
    r_s: Float[Array, "... tendons vector"] | None = None
    front_viscosity: Float[Array, "... 1"] | None = None
    n_ch: Float[Array, "... vector"] | None = None
    m_ch: Float[Array, "... turn"] | None = None
    payload: Scalar | None = None
    F_tip: Float[Array, "vector"] | None = None
    M_tip: Float[Array, "turn"] | None = None
    at_gaps: tuple[PointLoad, ...] | None = None
    fibres: Fibres | None = None
    relaxation: Relaxation | None = None
    material: AbstractEnergy | None = None
    dissipations: Sequence[AbstractDissipation] | None = None
    energies: Sequence[AbstractEnergy] | None = None
    distributed_loads: Sequence[AbstractDistributedLoad] | None = None
    load_factor: Scalar | None = None
    constraint: AbstractConstraint | None = None
    friction: Friction | None = None
    s: Float[Array, "points"] | None = None
    radius: Float[Array, "..."] | None = None
    plane: str | None = eqx.field(static=True, default=None)

    @property
    def L(self) -> Scalar:
        """The length [m]."""
        return self.grid.length

    @property
    def mass(self) -> Scalar:
        """That of the rod itself [kg]."""
        if self.rho_A.ndim == 1:
            return self.rho_A[0] * self.L
        return self.grid.weights @ self.rho_A[:, 0]

    @property
    def strain_size(self) -> int:
        """Components of the strains: of (v, u), or of u alone."""
        return self.K_bt.shape[-1] + (0 if self.K_se is None else self.K_se.shape[-1])

    @property
    def explicit_strains(self) -> bool:
        """Whether the energy is quadratic: strains then follow without iterations."""
        own = (self.tau, self.fibres, self.material, self.energies, self.dissipations)
        return all(x is None for x in own)

    @property
    def reach(self) -> Scalar:
        """The radius [m] of a round section that is as stiff."""
        if self.K_se is None:
            return self.L
        return 2 * jnp.sqrt(jnp.max(self.K_bt[..., 0]) / jnp.max(self.K_se[..., -1]))

    @property
    def has_dead_load(self) -> bool:
        """Whether a load is fixed in the base frame, so that the attitude matters."""
        if self.distributed_loads is not None:
            return True
        gaps = self.at_gaps or ()
        along = [x.F if x.F is not None else x.M for x in gaps if x.frame == "base"]
        return any(x is not None for x in (self.gravity, self.F_tip, self.M_tip, *along))

    def rubbing(self, psi: Float[Array, "*points rubbing"]) -> "Rod":
        """The rod whose tendons with friction have lost the part 1 - exp(-psi) of their tension."""
        assert self.friction is not None and self.tau is not None, "a rod with friction"
        tau = jnp.broadcast_to(self.tau, (*psi.shape[:-1], self.tau.shape[-1]))
        own = jnp.array(self.friction.which)
        tau = tau.at[..., own].set(tau[..., own] * jnp.exp(-psi))
        return dataclasses.replace(self, tau=tau)

    def having_slid(self, slid: Slid | None, directions=None) -> "Rod":
        """The rod whose tendons with friction have slid so before, or not at all.

        `directions`: in which they slide whatever was before, see `sliding_throughout`.
        """
        if self.friction is None:
            return self
        slid = self.friction.slid if slid is None else slid
        if directions is not None:
            slid = sliding_throughout(slid, directions)
        return dataclasses.replace(self, friction=dataclasses.replace(self.friction, slid=slid))

    @property
    def relaxed(self) -> "Rod":
        """The rod as stiff as it is for ever."""
        if self.relaxation is None:
            return self
        left = self.relaxation.left[..., None]
        K_se = None if self.K_se is None else left * self.K_se
        return eqx.tree_at(
            lambda r: (r.K_se, r.K_bt, r.relaxation),
            self,
            (K_se, left * self.K_bt, None),
            is_leaf=lambda x: x is None,
        )

    @property
    def stiffness(self) -> Float[Array, "... strain"]:
        """That of the strains that are unknown."""
        return self.K_bt if self.K_se is None else joined(self.K_se, self.K_bt)

    @property
    def rest_strain(self) -> Float[Array, "... strain"]:
        """Those strains of the unloaded rod that are unknown in others."""
        if self.K_se is None:
            return self.u_star
        return joined(self.v_star, self.u_star)

    def under(self, multipliers: Float[Array, "conditions"] | None) -> "Rod":
        """The rod on which the multipliers of its constraint act."""
        if self.constraint is None or multipliers is None:
            return self
        return self.constraint.applied(self, multipliers)

    def map_points(self, function) -> "Rod":
        """The rod with `function` of everything that varies along it: (points, ...) to (m, ...)."""
        own = {name: _find(self, name) for name in _AXES}
        names = [n for n, x in own.items() if x is not None and x.ndim > _AXES[n]]
        pick = lambda rod: [_find(rod, name) for name in names]
        rod = self
        if names:
            rod = eqx.tree_at(pick, self, [function(x) for x in pick(self)])
        if rod.friction is None:
            return rod
        return dataclasses.replace(rod, friction=rod.friction.map_points(function))


def _find(rod: Rod, name: str):
    """A number of the rod, or of a part of it; `None` where there is none."""
    owner, _, part = name.rpartition(".")
    owner = getattr(rod, owner) if owner else rod
    return None if owner is None else getattr(owner, part)


# How many axes what may vary has where it does not.
_AXES = {
    **dict.fromkeys(("K_se", "K_bt", "v_star", "u_star", "rho_A", "rho_J", "B_se", "B_bt", "C"), 1),
    **dict.fromkeys(("weight", "tau", "front_viscosity", "n_ch", "m_ch"), 1),
    **dict.fromkeys(("r", "r_s"), 2),
    **{"relaxation.parts": 1, "relaxation.times": 1},
    **{"fibres.constants": 1, "fibres.disks": 2, "fibres.boxes": 2},
    **{"s": 0, "radius": 0},
}


def joined(a, b):
    """Side by side; what is the same along the rod beside what varies along it, too."""
    points = jnp.broadcast_shapes(a.shape[:-1], b.shape[:-1])
    return jnp.concatenate([jnp.broadcast_to(x, (*points, x.shape[-1])) for x in (a, b)], -1)


def fastest_wave(rod: Rod) -> Scalar:
    """The speed [m/s] of the fastest wave along the rod: sqrt(E / rho).

    Of stretch or, in an inextensible rod, of short waves of bending, which the inertia of the
    sections holds back.
    """
    if rod.K_se is None:
        return jnp.sqrt(jnp.max(rod.K_bt[..., 0] / rod.rho_J[..., 0]))
    return jnp.sqrt(jnp.max(rod.K_se[..., -1] / rod.rho_A[..., 0]))


def full_strain(strain: Float[Array, "*points unknown"], rod: Rod) -> Float[Array, "*points 6"]:
    """(v, u) with all components, of the strains that are unknown in this rod."""
    if rod.K_se is None:
        v = jnp.broadcast_to(rod.v_star, (*strain.shape[:-1], rod.v_star.shape[-1]))
        strain = jnp.concatenate([v, strain], -1)
    return in_space(strain, rod.plane)


def inner_strain(strain: Float[Array, "*points 6"], rod: Rod) -> Float[Array, "*points unknown"]:
    """The strains that are unknown in this rod, of (v, u)."""
    u = turn_in(rod.plane, strain[..., 3:])
    if rod.K_se is None:
        return u
    return (
        strain
        if rod.plane is None
        else jnp.concatenate([vector_in(rod.plane, strain[..., :3]), u], -1)
    )
