"""Elastic laws of rubber and silicone, for which the linear one holds at small strain only.

A rod is made of fibres along it. The fibre at r in the section has the deformation v + u x r, that
is, the stretch l along the rod and a shear across it. Its energy per volume [Pa], incompressible
and under tension or compression along it, is

    C1 (l^2 + 2/l - 3) + C2 (2 l + 1/l^2 - 3)  and  (C1 + C2) (shear squared)

(Mooney, J. Appl. Phys. 11, 1940; Rivlin, Phil. Trans. R. Soc. A 241, 1948). At small strain this is
the linear law with E = 6 (C1 + C2) and Poisson's ratio 1/2, to which shear and torsion keep at any
strain. The constants say all: what a section makes of them is in `rod/fibres.py`.

Sections keep their dimensions, though what is stretched gets thinner: forces across the rod and
the places of tendons are those of the unloaded section.
"""

import abc

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from softrod_jax.foundation.numbers import Given, ScalarLike
from softrod_jax.scene.ranges import number


class AbstractRubber(eqx.Module):
    """An incompressible law, as the constants of Mooney and Rivlin's."""

    @property
    @abc.abstractmethod
    def constants(self) -> Float[Array, "2"]:
        """C1 and C2 [Pa]."""

    @property
    def young_modulus(self) -> ScalarLike:
        """E [Pa] at small strain."""
        return 6 * jnp.sum(self.constants)


class NeoHookean(AbstractRubber):
    """The law of an ideal rubber; `mu` [Pa] is its shear modulus, a third of Young's."""

    mu: Given[ScalarLike] = number("Pa", above=0, harmless=1.0)

    @property
    def constants(self) -> Float[Array, "2"]:
        return jnp.stack([0.5 * self.mu, jnp.zeros_like(self.mu)])


class MooneyRivlin(AbstractRubber):
    """The law with two terms: `c1` and `c2` [Pa].

    The second one takes away stiffness under tension and adds some under compression. A law with
    c2 below zero would not be convex, and is refused.
    """

    c1: Given[ScalarLike] = number("Pa", above=0, harmless=1.0)
    c2: Given[ScalarLike] = number("Pa", at_least=0, harmless=1.0)

    @property
    def constants(self) -> Float[Array, "2"]:
        return jnp.stack([self.c1, self.c2])
