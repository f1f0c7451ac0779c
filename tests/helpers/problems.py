"""Static problems with known answers: each carries its scene, its loads and its tip."""

from dataclasses import dataclass, field

import jax.numpy as jnp
import numpy as np

import softrod_jax as sr
from softrod_jax.scene.scene import as_arrays


@dataclass(frozen=True)
class Problem:
    """`tip`: the answer [m]; `tolerance` [m]: how well the answer itself is known."""

    name: str
    scene: sr.Scene
    tip: tuple
    tolerance: float
    tensions: tuple | None = None
    pressures: tuple | None = None
    source: str = field(default="", compare=False)

    def __repr__(self):
        return self.name


def beam(area=1e9, I=1.0, E=1.0, length=1.0, **parts):
    """EI = 1, L = 1; a huge area makes it inextensible and unshearable."""
    section = sr.GeneralSection(area, jnp.array([I, I]), 2 * I)
    return as_arrays(sr.Scene(length, section, E, 0.3, 1.0, **parts))


def roll_up():
    """A moment 2 pi EI / L bends a straight rod into a full circle."""
    load = sr.TipLoad(moment=jnp.array([0.0, 2 * np.pi, 0.0]))
    return Problem("roll_up", beam(tip_load=load), (0.0, 0.0, 0.0), 1e-12)


def elastica(alpha, w, u):
    """Dead transverse tip force P = alpha EI / L^2: w/L across, u/L along (elliptic integrals)."""
    load = sr.TipLoad(force=jnp.array([alpha, 0.0, 0.0]))
    return Problem(f"elastica_{alpha:g}", beam(tip_load=load), (w, 0.0, 1 - u), 2e-7)


def timoshenko():
    """A small tip force: P L^3 / 3 EI + P L / kGA. The answer is exact to O(P^3)."""
    P, area, k = 1e-4, 50.0, 5 / 6
    scene = beam(area, tip_load=sr.TipLoad(force=jnp.array([P, 0.0, 0.0])), shear_correction=k)
    across = P / 3 + P / (k * area / 2.6)
    return Problem("timoshenko", scene, (across, 0.0, 1.0), 1e-8)


def self_weight():
    """A small distributed load: q L^4 / 8 EI + q L^2 / 2 kGA."""
    q, area = 1e-4, 50.0
    scene = beam(area, gravity=jnp.array([-q / area, 0.0, 0.0]))
    across = -(q / 8 + q / 2 / (area / 2.6))
    return Problem("self_weight", scene, (across, 0.0, 1.0), 1e-8)


def bathe_bolourchi():
    """45 degree bend of radius 100, out-of-plane tip force 600 (Bathe & Bolourchi 1979).

    The bend lies in the x-z plane, the force is along y. The tip moves by 13.60463 toward the
    centre, 23.56058 back along the bend and 53.47548 out of its plane.
    """
    section = sr.GeneralSection(1.0, jnp.ones(2) / 12, 1 / 6)
    scene = as_arrays(
        sr.Scene(
            100 * np.pi / 4,
            section,
            1e7,
            0.0,
            1.0,
            tip_load=sr.TipLoad(force=jnp.array([0.0, 600.0, 0.0])),
            rest_curvature=jnp.array([0.0, 0.01, 0.0]),
            shear_correction=5 / 6,
        )
    )
    x, z = 100 * (1 - np.cos(np.pi / 4)), 100 * np.sin(np.pi / 4)
    tip = (x - 13.60463, 53.47548, z - 23.56058)
    return Problem("bathe_bolourchi", scene, tip, 2e-5)


def straight_tendon(tension):
    """Constant curvature u = tau r / EI and stretch v3 = 1 - tau / EA."""
    scene = sr.hybrid_robot()
    E, r, offset, L = 0.05e6, 6e-3, 4e-3, 0.1
    u = tension * offset / (E * np.pi * r**4 / 4)
    v = 1 - tension / (E * np.pi * r**2)
    tip = (v / u * (1 - np.cos(u * L)), 0.0, v / u * np.sin(u * L))
    return Problem(f"straight_tendon_{tension:g}", scene, tip, 1e-14, tensions=(tension, 0.0, 0.0))


def offset_chamber():
    """A chamber off the axis bends the rod away from itself: u = -P A e / EI, v3 = 1 + P A / EA."""
    P, area, e = 3e4, 7e-6, 2e-3
    scene = as_arrays(
        sr.Scene(
            0.1,
            sr.Circle(6e-3),
            0.05e6,
            0.49,
            1070.0,
            chambers=sr.Chambers(jnp.array([area]), jnp.array([[e, 0.0]])),
        )
    )
    EI, EA = 0.05e6 * np.pi * 6e-3**4 / 4, 0.05e6 * np.pi * 6e-3**2
    u, v = -P * area * e / EI, 1 + P * area / EA
    tip = (v / u * (1 - np.cos(u * 0.1)), 0.0, v / u * np.sin(u * 0.1))
    return Problem("offset_chamber", scene, tip, 1e-14, pressures=(P,))


def hanging_payload():
    """A rod that hangs down with a weight at its tip: stretched by it and by its own weight."""
    mass, L, E, r, rho, g = 0.05, 0.1, 1e6, 6e-3, 1070.0, 9.81
    scene = as_arrays(
        sr.Scene(
            L,
            sr.Circle(r),
            E,
            0.49,
            rho,
            gravity=jnp.array([0.0, 0.0, g]),
            payload=sr.Payload(mass),
        )
    )
    area = np.pi * r**2
    stretch = mass * g * L / (E * area) + rho * g * L**2 / (2 * E)
    return Problem("hanging_payload", scene, (0.0, 0.0, L + stretch), 1e-14)


CLOSED_FORMS = [
    roll_up(),
    elastica(1.0, 0.3017207738, 0.0564332363),
    elastica(2.0, 0.4934574805, 0.1606417208),
    elastica(5.0, 0.7137915236, 0.3876283607),
    elastica(10.0, 0.8106090249, 0.5549955978),
    timoshenko(),
    self_weight(),
    straight_tendon(0.1),
    straight_tendon(1.0),
    straight_tendon(2.0),
    offset_chamber(),
    hanging_payload(),
    bathe_bolourchi(),
]
