"""Where a camera stood: a constant offset and a small rotation, solved for in closed form.

A motion capture has an origin and axes of its own. Put in place by the rest of the tip and by
whole quarter turns, it is still off by some tenths of a millimetre and some degrees, and the
simulated tip, moved by d from its start, is seen at d + offset + rotation x d. Both follow from
linear least squares for any simulation, so that they are no parameters to search for; sensitivities
of the residuals include how they change.
"""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

# Believed of the rotation beforehand: +- 2 degrees, weighed against residuals of 3 % of the
# motion. It keeps rotations about the direction of the motion, of which little is seen, small.
_RIDGE = 1.0


class Alignment(eqx.Module):
    """`offset` [m], (3,), and `rotation` [rad], (3,), about the tip's starting point."""

    offset: Float[Array, "3"]
    rotation: Float[Array, "3"]

    def of(self, moved: Float[Array, "samples 3"]) -> Float[Array, "samples 3"]:
        """What is added to a tip that has moved by `moved` [m]."""
        return self.offset + jnp.cross(self.rotation, moved)


def align(
    moved: Float[Array, "samples 3"],
    missed: Float[Array, "samples 3"],
    weights: Float[Array, "samples 3"],
) -> Alignment:
    """The alignment whose `of(moved)` is nearest to `missed` [m], both weighted."""
    x, y, z = moved.T
    zero = jnp.zeros_like(x)
    # rotation x moved = cross @ rotation, with the skew matrix of -moved
    cross = jnp.stack([zero, z, -y, -z, zero, x, y, -x, zero], axis=-1).reshape(-1, 3, 3)
    size = jnp.sqrt(jnp.mean(moved**2) + 1e-18)
    columns = jnp.concatenate([jnp.broadcast_to(jnp.eye(3), cross.shape), cross / size], axis=-1)
    columns = (weights[..., None] * columns).reshape(-1, 6)
    # An axis that was never measured has no offset.
    ridge = jnp.diag(jnp.array([1e-9] * 3 + [_RIDGE] * 3))
    found = jnp.linalg.solve(columns.T @ columns + ridge, columns.T @ (weights * missed).ravel())
    return Alignment(found[:3], found[3:] / size)
