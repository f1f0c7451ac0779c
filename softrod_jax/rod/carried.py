"""What is carried while a rod moves: its base, and obstacles; where it is and how it moves."""

from typing import NamedTuple

from jaxtyping import Array, Float

from softrod_jax.rod.rotations import cross, to_base, to_body


class Carried(NamedTuple):
    """A frame at one instant.

    - `position` [m] of its origin, (3,), and `quaternion` (w, x, y, z) to the base frame, (4,).
    - `velocity` [m/s] of its origin, (3,), base frame; `angular_velocity` [rad/s], (3,), its own.
    """

    position: Float[Array, "*steps 3"]
    quaternion: Float[Array, "*steps 4"]
    velocity: Float[Array, "*steps 3"]
    angular_velocity: Float[Array, "*steps 3"]

    def inside(self, p: Float[Array, "3"]) -> Float[Array, "3"]:
        """A place `p` [m] of the base frame, as the frame sees it."""
        return to_body(self.quaternion, p - self.position)

    def velocity_at(self, p: Float[Array, "3"]) -> Float[Array, "3"]:
        """The velocity [m/s] of what the frame carries at `p` [m], both in the base frame."""
        turned = cross(self.angular_velocity, self.inside(p))
        return self.velocity + to_base(self.quaternion, turned)


class Surroundings(NamedTuple):
    """What carries the rod, and the obstacles in their order; `None` for what stands still."""

    base: Carried | None = None
    obstacles: tuple[Carried | None, ...] = ()
