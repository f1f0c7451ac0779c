"""Ready-made robots."""

import numpy as np

from softrod_jax.foundation.numbers import ScalarLike, VectorLike
from softrod_jax.scene.chambers import Chambers
from softrod_jax.scene.scene import Scene, as_arrays
from softrod_jax.scene.sections import Circle
from softrod_jax.scene.tendons import Tendons


def hybrid_robot(length: ScalarLike = 0.1, gravity: VectorLike | None = None) -> Scene:
    """The robot of Roshanfar et al., Actuators 2024, 13(1):8, Table 1.

    Three tendons 4 mm off the axis at 0, 120 and 240 degrees, one central chamber of 3 mm
    diameter, a solid circle of radius 6 mm. The table gives no length: 0.1 m is an
    assumption. `gravity` [m/s^2], (3,), is absent unless given.
    """
    angle = np.deg2rad([0.0, 120.0, 240.0])
    radius = 6e-3
    return as_arrays(
        Scene(
            length=length,
            section=Circle(radius),
            young_modulus=0.05e6,
            poisson_ratio=0.49,
            density=1070.0,
            bending_damping=1e-6,
            gravity=gravity,
            drag_coefficient=0.03,
            tendons=Tendons(4e-3 * np.stack([np.cos(angle), np.sin(angle)], axis=1)),
            chambers=Chambers(np.array([np.pi * 1.5e-3**2]), np.zeros((1, 2))),
        )
    )
