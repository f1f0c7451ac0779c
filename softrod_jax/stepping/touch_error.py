"""How far the grid along the rod moves a rod that touches, by what it misses of a push.

The strains may be smooth, and the push still not what it should be: what is missed of it, where a
touch begins and ends, shakes the rod. It acts on the first bending mode, which the obstacle holds
as long as it pushes, and lets go then with the speed that it has by mistake.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from softrod_jax.bvp.method import AbstractMethod
from softrod_jax.bvp.missed_push import Push, push_on
from softrod_jax.rod.constants import Rod
from softrod_jax.rod.rotations import cross, half_angle, rotation_matrix
from softrod_jax.rod.state import Layout
from softrod_jax.scene.planes import quaternion_in
from softrod_jax.stepping.first_mode import Swing, first_swing

# On 76 given grids (`benchmarks/contact_stress.py --given`) the estimate with this factor was 0.85
# times the error at least, and in the median 10 times; for number 211 in steps of 2.5 ms 0.5 times.
_CAUTION = 1.5


class Shaken(NamedTuple):
    """By what was missed of pushes: how far the tip is off [m], (3,), and its speed [m/s], (3,).

    `most`: the estimate, in lengths: how far it was off at most, or would go at such a speed.
    """

    place: Float[Array, "3"]
    speed: Float[Array, "3"]
    most: Float[Array, ""]


def unshaken() -> Shaken:
    """As a motion begins."""
    return Shaken(jnp.zeros(3), jnp.zeros(3), jnp.zeros(()))


def shaken_on(shaken: Shaken, y, dt, tangent, rod: Rod, layout: Layout, method: AbstractMethod):
    """After another `dt` [s], at whose end all points have the states `y`; see `Axis`."""
    swing = first_swing(tangent, rod, method)
    if rod.plane is not None:  # as seen from its clamp
        R = rotation_matrix(quaternion_in(rod.plane, half_angle(rod.h_base)))
        swing = swing._replace(across=R @ swing.across @ R.T)
    return swung(shaken, swing, push_on(y, rod, layout, method), dt, rod.L)


def swung(shaken: Shaken, swing: Swing, push: Push, dt, length) -> Shaken:
    """The first mode after `dt`, by one step of backward Euler, which damps what is too fast."""
    force, held = swing.force_at_tip(push.missed), swing.stiffness_at_tip(push.stiffness)
    K, mass = swing.stiffness * jnp.eye(3) + held, swing.stiffness / swing.frequency**2
    inertia = mass * (1 + 2 * swing.decay * dt) * jnp.eye(3)
    pull = mass * shaken.speed + dt * (force - K @ shaken.place)
    speed = _inverse(inertia + dt**2 * K) @ pull
    place = shaken.place + dt * speed
    ahead = mass * speed @ _inverse(K) @ speed
    off = _CAUTION * jnp.sqrt(place @ place + ahead) / length
    return Shaken(place, speed, jnp.maximum(shaken.most, off))


def _inverse(A: Float[Array, "3 3"]) -> Float[Array, "3 3"]:
    """Written out, which compiles faster than a library's."""
    a, b, c = A[0], A[1], A[2]
    columns = jnp.stack([cross(b, c), cross(c, a), cross(a, b)], -1)
    return columns / (a @ columns[:, 0])
