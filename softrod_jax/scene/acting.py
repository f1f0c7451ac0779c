"""What acts on a rod, as objects: the interfaces for materials, actuators and loads of one's own.

Physics enters a rod as an energy per unit of rod or as a load per unit of rod. A class that says
what one of them is, as a function written with JAX, is all that the solver needs: derivatives,
continuation, motions, gradients and batches follow from it.
"""

import abc
from typing import Any, ClassVar, NamedTuple

import equinox as eqx
from jaxtyping import Array, Float

Scalar = Float[Array, ""]


class AbstractEnergy(eqx.Module):
    """An energy per unit of rod, W(v, u): of a material, or of an actuator.

    Its derivatives by v and u are the force [N] and the moment [N m] of a section in the body
    frame. It must be convex, or strains are not unique. As `Scene.material` it stands instead of
    the linear law; those in `Scene.energies` add to it, and rise from zero in a continuation.
    """

    @abc.abstractmethod
    def density(self, v: Float[Array, "3"], u: Float[Array, "3"], s: Scalar) -> Scalar:
        """W [N] for the strains v [-] and u [1/m] at arc length `s` [m]."""


class AbstractDissipation(eqx.Module):
    """A potential of dissipation per unit of rod, Psi(v_t, u_t): of internal damping.

    Its derivatives by the rates are a force [N] and a moment [N m] of a section, body frame, which
    add to those of the energies in a motion; in an equilibrium there are none. It must be convex
    and least at rest, or the rod gains energy.
    """

    @abc.abstractmethod
    def potential(self, v_t: Float[Array, "3"], u_t: Float[Array, "3"], s: Scalar) -> Scalar:
        """Psi [N/s] for the rates v_t [1/s] and u_t [1/(m s)] at arc length `s` [m]."""


class AbstractCondition(eqx.Module):
    """A condition on the whole rod: the integral of W(v, u) along it never exceeds `limit`.

    Where it would, the rod is held: by x times the derivatives of W, a force [N] and a moment [N m]
    of each section in the body frame, with the smallest x >= 0 that does, which is an unknown of
    the whole rod. W must be convex. A cord along the rod that may not become longer is one, as is
    a stop for the rod's whole bend. x is in `StaticSolution.held` and `Trajectory.held`, in N m
    per unit of what W integrates to.
    """

    limit: eqx.AbstractVar[Any]

    @abc.abstractmethod
    def density(self, v: Float[Array, "3"], u: Float[Array, "3"], s: Scalar) -> Scalar:
        """W, per unit of rod, for the strains v [-] and u [1/m] at arc length `s` [m]."""


class Here(NamedTuple):
    """A place along the rod at one instant.

    - `s` [m]; `quaternion` (w, x, y, z): the attitude of the section, body to base.
    - `position` [m], (3,), base frame; `None` where no load of the scene says `needs_position`.
    - `velocity` [m/s] and `angular_velocity` [rad/s], (3,) each, body frame; zero in statics.
    - `radius` [m]: of the section; `None` where the scene has no contacts.
    """

    s: Scalar
    quaternion: Float[Array, "4"]
    velocity: Float[Array, "3"]
    angular_velocity: Float[Array, "3"]
    position: Float[Array, "3"] | None = None
    radius: Scalar | None = None


class AbstractDistributedLoad(eqx.Module):
    """A force and a moment per unit of rod, by attitude and velocity, and by position if it asks.

    `needs_position`: whether `wrench` reads `here.position`. The position is then an unknown along
    the rod, which costs about a fifth more; no scene without such a load has it.
    """

    needs_position: ClassVar[bool] = False

    @abc.abstractmethod
    def wrench(self, here: Here) -> tuple[Float[Array, "3"], Float[Array, "3"]]:
        """The force [N/m] and the moment [N], (3,) each, in the body frame."""
