"""A stiffness that relaxes: branches of a spring and a dashpot in a row (Prony, Maxwell, Wiechert).

At once a section is as stiff as K, and for ever as K (1 - sum_j g_j). Branch j is a spring g_j K
that ends at a dashpot. What the dashpot has crept, a_j, is a strain, and

    a_j,t = (e - a_j) / tau_j,    a force and a moment g_j K (e - a_j),

with e the strains beyond those of the unloaded rod. Whatever a_j does, g_j K (e - a_j)^2 / tau_j is
lost and nothing is gained. Where y_t = c0 y + y_h, it follows from the strains at the same time,

    a_j = (e - tau_j a_j,h) / (1 + c0 tau_j),

so that time schemes have a history of a_j, and the equations along the rod no unknown more.

An elastic law that is not linear is that of the rod at rest for ever, times 1 - sum_j g_j, and the
branches are linear, of its stiffness at small strain: so the energy stays convex, and is lost only.
"""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

Scalar = Float[Array, ""]
Strain = Float[Array, "*points strain"]
# What each dashpot has crept, or its history.
Crept = Float[Array, "*points branches strain"]


class Relaxation(eqx.Module):
    """The branches; with a first axis of points where they vary along the rod.

    `parts` g_j of the stiffness, (branches,), and `times` tau_j [s].
    """

    parts: Float[Array, "... branches"]
    times: Float[Array, "... branches"]

    @property
    def left(self) -> Float[Array, "..."]:
        """The part of the stiffness that stays."""
        return 1 - jnp.sum(self.parts, -1)

    def at_once(self, c0: Scalar) -> Float[Array, "..."]:
        """The part of the stiffness that branches have in a step, as its strains see it."""
        return jnp.sum(self.parts * (1 - self._shares(c0)), -1)

    def memory(self, c0: Scalar, history: Crept) -> Strain:
        """What of the history acts in a step: a strain, whose force is that with K."""
        weights = self.parts * self.times * self._shares(c0)
        return jnp.sum(weights[..., None] * history, -2)

    def crept(self, c0: Scalar, history: Crept, e: Strain) -> Crept:
        """What dashpots have crept at the end of a step, where the strains are e."""
        return self._shares(c0)[..., None] * (e[..., None, :] - self.times[..., None] * history)

    def at_rest(self, e: Strain) -> Crept:
        """The same, in an equilibrium."""
        return jnp.repeat(e[..., None, :], self.parts.shape[-1], axis=-2)

    def _shares(self, c0: Scalar) -> Float[Array, "... branches"]:
        return 1 / (1 + c0 * self.times)
