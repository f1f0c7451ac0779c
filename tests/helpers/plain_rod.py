"""The rod to which tests add physics of their own."""

import softrod_jax as sr
from softrod_jax.scene.scene import as_arrays

L, R, E = 0.1, 6e-3, 5e4


def rod(**changes):
    own = dict(
        length=L,
        section=sr.Circle(R),
        young_modulus=E,
        poisson_ratio=0.49,
        density=1070.0,
        bending_damping=1e-6,
    )
    return as_arrays(sr.Scene(**(own | changes)))
