"""The rod without any load: where every search begins."""

import jax.numpy as jnp

from softrod_jax.bvp.method import Guess, Method
from softrod_jax.rod.constants import Rod
from softrod_jax.rod.ode import Layout
from softrod_jax.rod.rotations import quaternion_exp, quaternion_product


def unloaded_guess(method: Method, layout: Layout, rod: Rod) -> Guess:
    """The rod without any load: strains v*, u*, no wrench, at rest."""
    s = method.points(rod.L)
    strain = rod.u_star
    if not layout.inextensible:
        strain = jnp.concatenate([rod.v_star, strain])
    strain = jnp.broadcast_to(strain, (s.shape[0], layout.strain_size))
    h = None
    if layout.attitude:
        turn = s[:, None] * rod.u_star
        h = rod.h_base + turn if layout.planar else quaternion_exp(turn)
        if not layout.planar:
            h = quaternion_product(jnp.broadcast_to(rod.h_base, h.shape), h)
    rest = jnp.zeros((s.shape[0], layout.size - layout.attitude_size))
    return Guess(layout.join(h, rest), strain)
