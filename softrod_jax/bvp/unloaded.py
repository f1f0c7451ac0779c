"""The rod without any load: where every search begins."""

import jax
import jax.numpy as jnp

from softrod_jax.bvp.method import Guess
from softrod_jax.rod.constants import Rod
from softrod_jax.rod.rotations import quaternion_exp, quaternion_product, to_base
from softrod_jax.rod.state import Layout
from softrod_jax.scene.planes import vector_in


def unloaded_guess(layout: Layout, rod: Rod) -> Guess:
    """The rod without any load: strains v*, u*, no wrench, at rest."""
    s = rod.grid.s
    strain = jnp.broadcast_to(rod.rest_strain, (s.shape[0], layout.strain_size))
    h = _attitudes(rod, layout) if layout.attitude else None
    p = _positions(rod, h) if layout.position else None
    rest = jnp.zeros((s.shape[0], layout.size - layout.pose_size))
    multipliers = None if rod.constraint is None else jnp.zeros(rod.constraint.count)
    return Guess(layout.join(p, h, rest), strain, multipliers)


def _positions(rod: Rod, h):
    """That of every point, about; (points, 3), or (points, 2) in a plane."""
    tangent = to_base(h, jnp.broadcast_to(rod.v_star, (h.shape[0], rod.v_star.shape[-1])))
    steps = jnp.diff(rod.grid.s)[:, None] * 0.5 * (tangent[1:] + tangent[:-1])
    assert rod.p_base is not None, "a rod whose loads depend on the position"
    start = vector_in(rod.plane, rod.p_base)
    return start + jnp.concatenate([jnp.zeros_like(steps[:1]), jnp.cumsum(steps, axis=0)])


def _attitudes(rod: Rod, layout: Layout):
    """That of every point."""
    s = rod.grid.s
    if rod.u_star.ndim == 1:
        turn = s[:, None] * rod.u_star
        if layout.planar:
            return rod.h_base + turn
        h = quaternion_exp(turn)
        return quaternion_product(jnp.broadcast_to(rod.h_base, h.shape), h)
    steps = jnp.diff(s)[:, None] * 0.5 * (rod.u_star[1:] + rod.u_star[:-1])
    if layout.planar:
        turn = jnp.concatenate([jnp.zeros_like(steps[:1]), jnp.cumsum(steps, axis=0)])
        return rod.h_base + turn

    def turned(h, step):
        h = quaternion_product(h, quaternion_exp(step))
        return h, h

    _, h = jax.lax.scan(turned, rod.h_base, steps)
    return jnp.concatenate([rod.h_base[None], h])
