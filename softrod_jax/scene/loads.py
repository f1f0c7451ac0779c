"""Loads and masses at the tip and along the rod, and markers that are seen there."""

import equinox as eqx
import jax.numpy as jnp

from softrod_jax.foundation.numbers import Given, Maybe, ScalarLike, VectorLike
from softrod_jax.scene.ranges import number

FRAMES = ("base", "body")
# Zero of these means that there are none.
DEAD_LOAD = {"optional": True, "sizes": (3,), "zero_is_absent": True}


class Payload(eqx.Module):
    """A point mass [kg] on the axis at the tip: weight (if there is gravity) and inertia."""

    mass: Given[ScalarLike] = number("kg", at_least=0, zero_is_absent=True, converter=jnp.asarray)


class TipLoad(eqx.Module):
    """Dead loads at the tip, in the base frame: `force` [N] and `moment` [N m], (3,) each."""

    force: Maybe[VectorLike] = number("N", **DEAD_LOAD)
    moment: Maybe[VectorLike] = number("N m", **DEAD_LOAD)


class Load(eqx.Module):
    """A force [N] and a moment [N m], (3,) each, on the axis at arc length `at` [m].

    `frame`: "base", dead loads, or "body", loads that turn with the section. Raises `ValueError`
    for any other.
    """

    at: Given[ScalarLike] = number("m", at_least=0, harmless=0.5)
    force: Maybe[VectorLike] = number("N", **DEAD_LOAD)
    moment: Maybe[VectorLike] = number("N m", **DEAD_LOAD)
    frame: str = eqx.field(static=True, default="base")

    def __check_init__(self):
        if self.frame not in FRAMES:
            raise ValueError(f'Load: frame={self.frame!r} is not offered; use "base" or "body"')


class Mass(eqx.Module):
    """A point mass [kg] on the axis at arc length `at` [m]: weight and inertia."""

    at: Given[ScalarLike] = number("m", at_least=0, harmless=0.5)
    mass: Given[ScalarLike] = number("kg", at_least=0)


class Marker(eqx.Module):
    """A point that is seen: at arc length `at` [m], `offset` [m] in the frame of the section."""

    name: str = eqx.field(static=True)
    at: Given[ScalarLike] = number("m", at_least=0, harmless=0.5)
    offset: Maybe[VectorLike] = number("m", optional=True, sizes=(3,))
