"""A hand that lets go: how a release really begins.

A rod that is held straight and let go is not free at once. Fingers follow it for some hundredths of
a second, take energy out of the first swing, and a fit that does not know of them takes that for
a damping that grows with amplitude. The support is modelled as a couple along the rod that balances
the weight of rod and payload at the tip, and fades smoothly within the release's duration.

The couple acts through a tendon that the scene does not have, on the side away from gravity: its
tension may change in time, which a tip load's force cannot.
"""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

import softrod_jax as sr
from calibration.experiment.bulk import bulk
from softrod_jax.rod.rotations import conjugate, to_base

# Distance of the tendon from the axis, in lengths of the rod: far, so that it hardly compresses
# the rod, and near enough not to matter for a curvature of 1 / length.
_OFFSET = 0.5


def with_supporting_hand(
    scene: sr.Scene, duration: Float[Array, ""], dt: Float[Array, ""], steps: int
) -> tuple[sr.Scene, Float[Array, "steps 1"]]:
    """The scene with the supporting tendon, and its tension [N] in each step.

    The scene has gravity and no tendons; the release begins at t = 0 and takes `duration` [s].
    """
    gravity = scene.gravity
    assert gravity is not None, "a release is one under gravity"
    if scene.base_quaternion is not None:
        inverse = conjugate(scene.base_quaternion)
        gravity = to_base(inverse, gravity)
    across = gravity[:2]
    size = jnp.sqrt(jnp.sum(across**2) + 1e-12)
    L = scene.length
    # M L^2 / 2 = rho A g L^4 / 8 + m g L^3 / 3: the tip stays where it is.
    moment = jnp.asarray(bulk(scene).mass) * size * L / 4
    if scene.payload is not None:
        moment = moment + 2 / 3 * scene.payload.mass * size * L
    offset = _OFFSET * L
    # The mean of the fading 1 - 3 u^2 + 2 u^3 over each step: its impulse is right, and changes
    # with the duration, however short that is against the step.
    u = jnp.clip(dt * jnp.arange(steps + 1) / duration, 0.0, 1.0)
    impulse = duration * u * (1 - u * u * (1 - u / 2))
    tension = moment / offset * jnp.diff(impulse) / dt
    # A hand is outside the rod.
    hand = sr.Tendons((-offset * across / size)[None], guided="disks")
    supported = eqx.tree_at(lambda s: s.tendons, scene, hand, is_leaf=lambda x: x is None)
    return supported, tension[:, None]
