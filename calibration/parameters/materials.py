"""Ranges of materials, to notice values that cannot be those of the material.

A value outside is a sign and not a verdict: of a wrong section, length or unit, or of a model that
leaves something out. Each material says where its range is from; "typical" ones are wide, and from
no single source.
"""

from dataclasses import dataclass

_PSI = 6894.757  # Pa


@dataclass(frozen=True)
class Material:
    """Ranges (low, high) of Young's modulus [Pa], density [kg/m^3] and Poisson's ratio.

    `source`: where they are from, for a reader of a report.
    """

    young_modulus: tuple[float, float]
    density: tuple[float, float]
    source: str
    poisson_ratio: tuple[float, float] = (0.45, 0.5)  # of elastomers; below 0.5 mostly by bubbles


def _smooth_on(modulus_psi: float, specific_gravity: float) -> Material:
    """A rubber, by the manufacturer's 100 % modulus [psi] and specific gravity.

    The 100 % modulus is the nominal stress at twice the length, sigma. A neo-Hookean solid with
    that stress has E = 3 sigma / (2 - 1/4) = 1.7 sigma at small strain. Half to three times sigma
    is 30 to 175 % of it: cure, batch, rate and the Mullins effect (Case, White and Kramer, Soft
    Robotics 2 (2015) 80) account for so much. Density: 5 % either way.
    """
    sigma, density = modulus_psi * _PSI, 1000 * specific_gravity
    source = f"half to three times the manufacturer's 100 % modulus, {modulus_psi:g} psi"
    return Material((0.5 * sigma, 3 * sigma), (0.95 * density, 1.05 * density), source)


# Any soft robot's: wide.
SOFT = Material((1e3, 1e8), (100.0, 3000.0), "typical of soft robots", (0.2, 0.5))

MATERIALS = {
    # Smooth-On, technical bulletins "Ecoflex Series" and "Dragon Skin Series": 69, 83, 152, 338
    # and 593 kPa.
    "ecoflex-00-30": _smooth_on(10, 1.07),
    "ecoflex-00-50": _smooth_on(12, 1.07),
    "dragon-skin-10": _smooth_on(22, 1.07),
    "dragon-skin-20": _smooth_on(49, 1.08),
    "dragon-skin-30": _smooth_on(86, 1.08),
    # 1.32 to 2.97 MPa by curing temperature: Johnston et al., J. Micromech. Microeng. 24 (2014)
    # 035017; 0.57 to 3.7 MPa from 33:1 to 5:1 of base to curing agent: Wang, Volinsky and Gallant,
    # J. Appl. Polym. Sci. 131 (2014) 41050. Methods of measurement alone differ by as much: Varner
    # and Cohen, Soft Matter 20 (2024). Density: about 1030 kg/m^3, 5 % either way.
    "sylgard-184": Material(
        (0.5e6, 4e6), (980.0, 1090.0), "measured over curing temperatures and mixing ratios"
    ),
    "silicone": Material((2e4, 1e7), (900.0, 1400.0), "typical"),
    "natural-rubber": Material((0.5e6, 1e7), (900.0, 1200.0), "typical, with and without filler"),
    # Pellethane 2363 and Elasthane, 80A to 75D: flexural moduli of 5,220 to 289,000 psi, specific
    # gravities of 1.12 to 1.21 (makers' tables); softer ones exist.
    "tpu": Material((3e6, 2e9), (1050.0, 1300.0), "typical, from 60A to 75D", (0.35, 0.5)),
}


def check_material(name: str | None) -> None:
    """Raises `ValueError` for a name that is not in `MATERIALS`; None is no material."""
    if name is not None and name not in MATERIALS:
        raise ValueError(f"material={name!r}: choose from {', '.join(MATERIALS)}")
