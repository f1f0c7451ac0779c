"""The force of an obstacle on a rod: a penalty on the depth of its surface, per unit of rod."""

import jax
import jax.numpy as jnp

from softrod_jax.rod.carried import Carried
from softrod_jax.rod.rotations import cross, to_base, to_body
from softrod_jax.scene.acting import AbstractDistributedLoad, Here
from softrod_jax.scene.contacts import Contact

# Below this speed [m/s] friction fades, where a scene does not say.
_SLIP_SPEED = 1e-3


class ContactForce(AbstractDistributedLoad):
    """What one obstacle does to the rod, where its surface is inside of it.

    At rest it has the potential k d^2 / 2 per length, with d the depth of the surface; damping and
    friction take work from the rod at any velocity, and give none.
    """

    contact: Contact
    carried: Carried | None = None
    needs_position = True

    def wrench(self, here: Here):
        contact, (p, radius) = self.contact, (here.position, here.radius)
        assert p is not None and radius is not None, "a rod in contact"
        distance, normal = jax.value_and_grad(self._distance)(p)
        depth = radius - distance
        touches = depth > 0
        n = to_body(here.quaternion, normal)
        q, w = here.velocity, here.angular_velocity
        if self.carried is not None:
            # Against an obstacle that moves counts how the rod moves relative to it.
            surface = self.carried.velocity_at(p - radius * normal)
            q = q - to_body(here.quaternion, surface)
        push = jnp.where(touches, contact.stiffness * depth, 0.0)
        if contact.damping is not None:
            # The point that touches moves as the axis does, along the normal: it is above it.
            push = push * jnp.maximum(1 - contact.damping * (n @ q), 0.0)
        if contact.friction is None:
            return push * n, jnp.zeros(3)
        slow = _SLIP_SPEED if contact.slip_speed is None else contact.slip_speed
        arm = -radius * n
        slides = q + cross(w, arm)
        slides = slides - (slides @ n) * n
        rub = -contact.friction * push * slides / jnp.sqrt(slides @ slides + slow**2)
        return push * n + rub, cross(arm, rub)

    def _distance(self, p):
        inside = p if self.carried is None else self.carried.inside(p)
        return self.contact.obstacle.distance(inside)


def force_on_rod(load: ContactForce, here: Here):
    """The force per length [N/m], (3,), base frame."""
    return to_base(here.quaternion, load.wrench(here)[0])
