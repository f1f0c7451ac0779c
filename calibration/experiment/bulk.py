"""A uniform cantilever in place of a scene's rod: its mass and its stiffness, for estimates.

Segments and tapers are summed up. The stiffness is that of a rod which bends, or stretches, as far
under a force at its tip. A uniform rod is its own.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

import softrod_jax as sr
from softrod_jax.foundation.numbers import ScalarLike
from softrod_jax.rod.body import INCOMPLETE
from softrod_jax.rod.energies import stiffness_at_rest

# Of Gauss, on [0, 1]: exact for what a uniform segment needs.
_PLACES, _WEIGHTS = np.polynomial.legendre.leggauss(4)
_PLACES, _WEIGHTS = (1 + _PLACES) / 2, _WEIGHTS / 2


class Bulk(NamedTuple):
    """`mass` [kg]; `area` [m^2], the mean one; `EI` [N m^2], (2,), about x and y; `EA` [N]."""

    mass: ScalarLike
    area: ScalarLike
    EI: Float[Array, "2"]
    EA: ScalarLike


def bulk(scene: sr.Scene) -> Bulk:
    """The numbers of a scene's rod as a whole; they may be traced."""
    length, start = scene.length, 0.0
    mass, volume, bending, stretch = 0.0, 0.0, 0.0, 0.0
    for segment in scene.parts:
        for place, weight in zip(_PLACES, _WEIGHTS, strict=True):
            section, measured = segment.section_at(place), segment.stiffness
            ds = weight * segment.length
            lever = (length - start - place * segment.length) / length
            if isinstance(segment.material, sr.AbstractEnergy):
                K_se, K_bt = stiffness_at_rest(segment.material, *segment.rest_strain)
                EI, EA = K_bt[:2], K_se[2]
            elif measured is None:
                rubber = segment.material
                E = segment.young_modulus if rubber is None else rubber.young_modulus
                assert E is not None, INCOMPLETE
                EI, EA = E * section.second_moments, E * section.area
            else:
                # An inextensible rod need not say how far it stretches.
                EI, EA = measured.bending, jnp.inf if measured.axial is None else measured.axial
            density = segment.linear_density
            if density is None:
                assert segment.density is not None, INCOMPLETE
                density = segment.density * section.area
            mass, volume = mass + density * ds, volume + section.area * ds
            bending, stretch = bending + lever**2 * ds / EI, stretch + ds / EA
        start = start + segment.length
    return Bulk(mass, volume / length, length / (3 * bending), length / stretch)


def ring_frequency(scene: sr.Scene) -> float:
    """The frequency [Hz] at which a cantilever with a weight at its tip rings in its first mode."""
    rod = bulk(scene)
    mass = 0.2427 * float(rod.mass)
    mass += 0.0 if scene.payload is None else float(scene.payload.mass)
    stiffness = 3 * float(np.min(np.asarray(rod.EI))) / float(scene.length) ** 3
    return float(np.sqrt(stiffness / mass) / (2 * np.pi))
