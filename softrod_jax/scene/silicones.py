"""Silicones by their names: values to start from, before anything is measured.

The laws are fitted to the tension tests of Marechal, Balland, Lindenroth, Petrou, Kontovounisios
and Bello, Soft Robotics (2020), https://doi.org/10.1089/soro.2019.0115, whose records are open: a
dumbbell (ASTM D412) that is pulled for the first time, at 450 mm/min. By least squares of the
nominal stress over stretches from 1.02 to 2, evenly; it ends 4 to 11 % (rms) beside the record. No
second constant of Mooney and Rivlin's fits better, unless it is below zero: the law is neo-Hookean
for all. Densities are the maker's (Smooth-On, technical bulletins).

Other tests differ by much: with the maker's 100 % moduli mu would be 1.2 to 2.5 times as large.
Cure, batch, rate and the first pull itself account for a part of that (Case, White and Kramer, Soft
Robotics 2 (2015) 80, https://doi.org/10.1089/soro.2015.0002). The ranges that a calibration warns
of are in `calibration/parameters/materials.py`.
"""

from difflib import get_close_matches
from typing import NamedTuple

from softrod_jax.scene.materials import NeoHookean


class Silicone(NamedTuple):
    """`law`, of which `mu` is in Pa, and `density` [kg/m^3]."""

    law: NeoHookean
    density: float


SILICONES = {
    "ecoflex-00-30": Silicone(NeoHookean(16.1e3), 1070.0),
    "ecoflex-00-50": Silicone(NeoHookean(22.4e3), 1070.0),
    "dragon-skin-10": Silicone(NeoHookean(56.3e3), 1070.0),
    "dragon-skin-20": Silicone(NeoHookean(160.2e3), 1080.0),
    "dragon-skin-30": Silicone(NeoHookean(222.4e3), 1080.0),
}


def silicone(name: str) -> Silicone:
    """The law and the density of a silicone, such as "ecoflex-00-50", to start from.

    Raises `ValueError` for a name that is not known, with those that are.
    """
    if name not in SILICONES:
        raise ValueError(f"silicone: {name!r} is not known; {known_silicones(name)}")
    return SILICONES[name]


def known_silicones(name: str) -> str:
    """What to use instead of a name that is not known."""
    close = get_close_matches(name, SILICONES, n=1)
    hint = f'did you mean "{close[0]}"? ' if close else ""
    return f"{hint}known: {', '.join(SILICONES)}"
