"""Random equilibria far beyond the ordinary, for the stress test.

Length 0.02 to 1 m, slenderness L/r 9 to 1000, Young's modulus 1e4 to 2e11 Pa, density 900 to
8000 kg/m^3; solid, hollow and rectangular sections, any clamp, in space and in a plane, with
stretch and without. Of seven kinds, each has one large load, others now and then: weight
rho A g L^3/EI or a payload's to 1e4, tip forces to P L^2/EI = 1e4, tip moments to 80 EI/L with any
axis, rest curvature and twist of ten turns, tensions up to 90 % of where a path vanishes and
pressures; "mixed" has several. Strains of stretch stay below about 0.3 and those of bending below a
half, as in real rods.
"""

import judge_rod
import numpy as np

import softrod_jax as sr
from softrod_jax.scene.scene import as_arrays

KINDS = "heavy", "payload", "force", "moment", "coil", "robot", "mixed"
STRUCTURES = "circle", "annulus", "rectangle", "plane", "inextensible"
LARGEST, STRAIN, MOMENT, TURNS, CURLS = 1e4, 0.3, 80.0, 10.0, 3.0


class Draw:
    """Random numbers of one scene; those of a scene in a plane are in that plane."""

    def __init__(self, rng, planar):
        self.rng, self.planar = rng, planar

    def log(self, low, high):
        return float(np.exp(self.rng.uniform(np.log(low), np.log(max(low, high)))))

    def maybe(self, part, value):
        return value if self.rng.random() < part else 0.0

    def direction(self):
        x = self.rng.normal(size=3) * np.array([1.0, not self.planar, 1.0])
        return x / np.linalg.norm(x)

    def axis(self):
        """Of a turn: any, or nearly the rod's own, which twists it."""
        if self.planar:
            return np.array([0.0, self.rng.choice([-1.0, 1.0]), 0.0])
        slant = np.array([1.0, 1.0, 1.0]) if self.rng.random() < 0.5 else np.array([0.1, 0.1, 1.0])
        x = self.rng.normal(size=3) * slant
        return x / np.linalg.norm(x)

    def offsets(self, count, low, high):
        size = self.rng.uniform(low, high)
        if self.planar:
            return size * np.stack([np.array([1, -1, 0.5])[:count], np.zeros(count)], 1)
        angle = self.rng.uniform(0, 2 * np.pi) + 2 * np.pi / 3 * np.arange(count)
        return size * np.stack([np.cos(angle), np.sin(angle)], 1)


def random_section(draw, structure, r):
    if structure == "annulus":
        return sr.Annulus(r, draw.rng.uniform(0.3, 0.9) * r)
    if structure == "rectangle":
        return sr.Rectangle(*(2 * r * draw.rng.uniform(0.3, 1.0, 2)))
    return sr.Circle(r)


def random_loads(draw, kind, slenderness, limit):
    """Sizes in units of EI and L. What the kind is about is large, other loads are now and then."""
    often, weight = (0.9, 50.0) if kind in ("coil", "robot") else (0.3, 10.0)
    size = {
        "heavy": draw.maybe(often, draw.log(1e-2, weight)),
        "payload": draw.maybe(0.2, draw.log(1e-2, 10)),
        "force": draw.maybe(0.3, draw.log(1e-2, 10)),
        "moment": draw.maybe(0.3, draw.log(1e-2, 5)),
        "coil": draw.maybe(0.2, draw.log(1e-2, np.pi)),
    }
    bend, pull = 0.5 * slenderness, limit / (3 if kind == "mixed" else 1)
    largest = {
        "heavy": min(LARGEST, pull),
        "payload": min(LARGEST, pull),
        "force": min(LARGEST, pull),
        "moment": min(MOMENT, bend),
        "coil": min(2 * np.pi * TURNS, bend),
    }
    for name, high in largest.items():
        if kind == name or (kind == "mixed" and draw.rng.random() < 0.4):
            size[name] = draw.log(1.0, high)
        size[name] = min(size[name], high)
    return size


def random_actuation(draw, kind, r, L, EI, EA, area):
    """Parts of the scene, tensions, pressures, and the part of the largest tension; or none."""
    if kind != "robot" and not (kind == "mixed" and draw.rng.random() < 0.4):
        return {}, None, None, 0.0
    offsets = draw.offsets(3, 0.1 * r, 0.5 * r)
    offset = np.max(np.linalg.norm(offsets, axis=1))
    most = 1 / (1 / EA + offset**2 / EI)
    part = draw.maybe(0.9, draw.rng.uniform(0, 0.9))
    part = min(part, CURLS * 2 * np.pi * EI / (L * offset) / most)
    tensions = part * most * draw.rng.dirichlet(np.ones(3) * 0.5)
    pressures = np.array([draw.maybe(0.5, draw.log(1e-3, 0.1)) * EA / (0.1 * area)])
    chambers = sr.Chambers(np.array([0.1 * area]), draw.offsets(1, 0.0, 0.2 * r))
    tendons = sr.Tendons(offsets, guided="disks")  # a flat section may not hold them
    return {"tendons": tendons, "chambers": chambers}, tensions, pressures, part


def random_equilibrium(rng):
    """A scene, its tensions and pressures (or None), and the numbers that it was drawn with."""
    kind = str(rng.choice(KINDS))
    structure = str(rng.choice(STRUCTURES, p=[0.35, 0.15, 0.15, 0.175, 0.175]))
    draw = Draw(rng, structure == "plane")
    L, slenderness = draw.log(0.02, 1.0), draw.log(9, 1000)
    E, density, nu = draw.log(1e4, 2e11), draw.log(900, 8000), rng.uniform(0.0, 0.49)
    r = L / slenderness
    section = random_section(draw, structure, r)
    area, I, _ = judge_rod.section_numbers(section)
    EI, EA = E * np.min(I), E * area
    size = random_loads(draw, kind, slenderness, STRAIN * EA * L**2 / EI)
    # A payload needs gravity; its mass is what its weight asks for.
    weight = max(size["heavy"], 1e-2 if size["payload"] else 0.0)
    gravity = weight * EI / (density * area * L**3)
    mass = size["payload"] * EI / L**2 / gravity if size["payload"] else 0.0
    parts, *inputs, part = random_actuation(draw, kind, r, L, EI, EA, area)
    pose = np.array([1.0, 0, 0, 0]) if draw.planar else rng.normal(size=4)
    force = size["force"] * draw.direction()
    moment = size["moment"] * judge_rod.matrix(pose) @ draw.axis()
    scene = as_arrays(
        sr.Scene(
            length=L,
            section=section,
            young_modulus=E,
            poisson_ratio=nu,
            density=density,
            gravity=gravity * draw.direction(),
            payload=sr.Payload(mass),
            tip_load=sr.TipLoad(force * EI / L**2, moment * EI / L),
            rest_curvature=size["coil"] / L * draw.axis(),
            base_quaternion=pose / np.linalg.norm(pose),
            inextensible=structure == "inextensible",
            plane="xz" if draw.planar else None,
            **parts,
        )
    )
    numbers = {"kind": kind, "structure": structure, "slenderness": slenderness, "E": E}
    return scene, *inputs, {**numbers, **size, "tension": part}
