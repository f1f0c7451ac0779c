"""Published ranges of materials, to notice values that cannot be those of the material.

A value outside is a sign and not a verdict: of a wrong section, length or unit, or of a model that
leaves something out. Moduli of silicones: from half to three times the manufacturer's 100 %
modulus (a secant, measured slowly and at large strain: the tangent at small strain, and in quick
motion, is higher). Densities: the manufacturer's specific gravity, 5 % either way. Poisson's
ratio of elastomers: from 0.45, mostly for trapped air, to 0.5.

Sources: Smooth-On technical bulletins of Ecoflex and Dragon Skin (100 % moduli of 10, 12, 22, 49
and 86 psi); Johnston et al., J. Micromech. Microeng. 24 (2014) 035017 for Sylgard 184; Marechal et
al., Soft Robotics 8 (2021) 284 for the spread between laboratories.
"""

from dataclasses import dataclass

_PSI = 6894.757  # Pa


@dataclass(frozen=True)
class Material:
    """Ranges (low, high) of Young's modulus [Pa], density [kg/m^3] and Poisson's ratio."""

    young_modulus: tuple[float, float]
    density: tuple[float, float]
    poisson_ratio: tuple[float, float] = (0.45, 0.5)


def _silicone(modulus_psi: float, density: float) -> Material:
    modulus = modulus_psi * _PSI
    return Material((0.5 * modulus, 3 * modulus), (0.95 * density, 1.05 * density))


# Any soft robot's: wide.
SOFT = Material((1e3, 1e8), (100.0, 3000.0), (0.2, 0.5))

MATERIALS = {
    "ecoflex-00-30": _silicone(10, 1070.0),
    "ecoflex-00-50": _silicone(12, 1070.0),
    "dragon-skin-10": _silicone(22, 1070.0),
    "dragon-skin-20": _silicone(49, 1080.0),
    "dragon-skin-30": _silicone(86, 1080.0),
    "sylgard-184": Material((0.5e6, 4.0e6), (980.0, 1090.0)),
    "silicone": Material((2e4, 1e7), (900.0, 1400.0)),
    "natural-rubber": Material((0.5e6, 5e6), (900.0, 1100.0)),
    "tpu": Material((5e6, 5e8), (1050.0, 1300.0), (0.35, 0.5)),
}
