"""Whether there can be a rod with traced numbers; a harmless one where there cannot.

A traced scene with a number that cannot be is replaced as a whole before anything is computed with
it: the numbers of a failed sample stay finite, and so do the derivatives of its batch.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from softrod_jax.rod.reduction import make_rod
from softrod_jax.scene.checks import can_be, harmless_unless
from softrod_jax.scene.inputs import Inputs
from softrod_jax.scene.scene import Scene


def usable(
    scene: Scene, good: Bool[Array, ""] | bool = True, inputs: Inputs = Inputs()
) -> tuple[Scene, Bool[Array, ""]]:
    """The scene, and whether all its numbers can be; where one cannot, a harmless scene.

    `good`: whether all else can be. `inputs`: constant ones. A rod whose
    stiffness or mass overflows, or is lost in rounding, cannot be either.
    """
    good = jnp.asarray(good) & can_be(scene)
    rod = make_rod(scene, inputs)
    for x in jax.tree.leaves(rod):
        good &= jnp.all(jnp.isfinite(x))
    # The size of forces tells of lengths whose square is none.
    for x in (rod.K_se, rod.K_bt, rod.K_bt / rod.L**2, rod.rho_A, rod.rho_J):
        good &= True if x is None else jnp.all((x > 0) & (x < jnp.inf))
    return harmless_unless(good, scene), good


def usable_in_time(scene: Scene, dt) -> tuple[Scene, Float[Array, ""], Bool[Array, ""]]:
    """As `usable`, with the time step `dt` [s]."""
    # Errors in time are by its powers.
    scene, good = usable(scene, jnp.isfinite(dt**4) & (dt > 0) & (dt**4 > 0))
    return scene, jnp.where(good, dt, 1.0), good
