"""Rods of rubber: closed forms, an independent equilibrium, the law written again, derivatives."""

import dataclasses
import json
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import softrod_jax as sr
from softrod_jax.scene.scene import as_arrays

KNOWN = json.loads((Path(__file__).parent / "references" / "wider_static.json").read_text("utf-8"))
METHOD = sr.Collocation(6)
L, R, C1, C2 = 0.1, 6e-3, 6e3, 2e3
ACROSS = np.array([-9.81, 0.0, 0.0])
PULL = dict(tendons=sr.Tendons([[4e-3, 0.0]]))
LAW = sr.MooneyRivlin(C1, C2)
# Closed forms are compared with to more digits than Newton's method usually leaves.
CLOSE = sr.NewtonOptions(tolerance=1e-13)
METHODS = pytest.mark.parametrize("method", [METHOD, sr.Shooting(2, 10)], ids=["colloc.", "shoot."])


def rod(**changes):
    own = dict(length=L, section=sr.Circle(R), density=1070.0, material=LAW)
    return as_arrays(sr.Scene(**(own | changes)))


def stress(l):
    """Of a fibre along itself, per area of the unloaded section [Pa]."""
    return 2 * C1 * (l - 1 / l**2) + 2 * C2 * (1 - 1 / l**3)


# Closed forms


@METHODS
@pytest.mark.parametrize("l", [0.4, 0.8, 1.5, 3.0])
def test_pure_stretch(method, l):
    N = np.pi * R**2 * stress(l)
    load = sr.TipLoad(force=np.array([0.0, 0.0, N]))
    solution = sr.solve_static(rod(tip_load=load, plane="xz"), method=method, newton=CLOSE)
    np.testing.assert_allclose(solution.strains[:, 2], l, rtol=1e-10)


def bent(section, u):
    """The moment and the stretch of the axis at this curvature about y, without a force."""
    x, w = np.polynomial.legendre.leggauss(200)
    if isinstance(section, sr.Rectangle):
        places, chords = section.width / 2 * x, section.width / 2 * w * section.height
    else:
        places, chords = [], []
        for radius, sign in ((section.outer_radius, 1.0), (section.inner_radius, -1.0)):
            places.append(radius * np.sin(np.pi / 2 * x))
            chords.append(sign * np.pi * radius**2 * w * np.cos(np.pi / 2 * x) ** 2)
        places, chords = np.concatenate(places), np.concatenate(chords)
    l = lambda v: v - u * places
    low, high = 0.5, 2.0
    for _ in range(200):
        v = 0.5 * (low + high)
        low, high = (low, v) if chords @ stress(l(v)) > 0 else (v, high)
    return -chords @ (places * stress(l(v))), v


@METHODS
@pytest.mark.parametrize("section", [sr.Annulus(R, 0.0), sr.Annulus(R, 4e-3), sr.Rectangle(R, R)])
def test_pure_moment(method, section):
    """Against quadrature over the section, at a strain of a quarter of the length and more."""
    u = 75.0
    M, v = bent(section, u)
    scene = rod(section=section, tip_load=sr.TipLoad(moment=np.array([0.0, M, 0.0])))
    solution = sr.solve_static(scene, method=method, newton=CLOSE)
    np.testing.assert_allclose(solution.strains[:, 4], u, rtol=1e-10)
    np.testing.assert_allclose(solution.strains[:, 2], v, rtol=1e-10)
    assert v > 1.0 + 1e-3


def test_a_solid_tube_is_a_rod():
    load = sr.TipLoad(force=np.array([0.02, 0.01, 0.0]))
    tips = [
        sr.solve_static(rod(section=section, tip_load=load), method=METHOD).tip_position
        for section in (sr.Circle(R), sr.Annulus(R, 0.0))
    ]
    np.testing.assert_allclose(tips[0], tips[1], rtol=0, atol=1e-12)


def test_small_loads_are_those_of_the_linear_law():
    """What differs is of the square of the strains."""
    force = 1e-7 * np.array([1.0, 1.0, 1.0])
    law = dict(material=None, young_modulus=6 * (C1 + C2), poisson_ratio=0.5 - 1e-12)
    rubber, linear = (
        sr.solve_static(rod(tip_load=sr.TipLoad(force=force), **x), method=METHOD).tip_position
        for x in ({}, law)
    )
    moved = linear - np.array([0.0, 0.0, L])
    assert np.abs(moved).max() > 1e-7
    np.testing.assert_allclose(rubber, linear, rtol=0, atol=1e-6 * np.abs(moved).max())


@pytest.mark.parametrize("plane", [None, "xz"])
def test_an_independent_equilibrium(plane):
    scene = rod(gravity=ACROSS, plane=plane, **PULL)
    known = KNOWN["equilibria"]["mooney_rivlin"]
    tip = sr.solve_static(scene, [0.3]).tip_position
    np.testing.assert_allclose(tip, known["tip"], rtol=0, atol=max(1e-7, known["error"]))


@pytest.mark.parametrize("planes", [("xz", "yz"), (None, None)])
def test_the_other_plane_is_the_same(planes):
    turned = dict(gravity=ACROSS[np.array([1, 0, 2])], tendons=sr.Tendons([[0.0, 4e-3]]))
    scenes = rod(gravity=ACROSS, plane=planes[0], **PULL), rod(plane=planes[1], **turned)
    one, other = (sr.solve_static(x, [0.3], method=METHOD).tip_position for x in scenes)
    np.testing.assert_allclose(np.asarray(one)[[1, 0, 2]], other, rtol=0, atol=1e-12)


# The law written again


class Fibred(sr.AbstractEnergy):
    """A rod of fibres, summed up point by point."""

    c1: jax.Array
    c2: jax.Array
    tip_radius: float = R

    def density(self, v, u, s):
        x, w = np.polynomial.legendre.leggauss(8)
        angle = 2 * np.pi * (np.arange(24) + 0.5) / 24
        radius = R + (self.tip_radius - R) * s / L
        r = radius * np.sqrt((1 + x) / 2)[:, None]
        dA = jnp.pi * radius**2 * w[:, None] / 48
        l = v[2] + r * (u[0] * np.sin(angle) - u[1] * np.cos(angle))
        shear = (v[0] - u[2] * r * np.sin(angle)) ** 2 + (v[1] + u[2] * r * np.cos(angle)) ** 2
        psi = self.c1 * (l**2 + 2 / l - 3) + self.c2 * (2 * l + 1 / l**2 - 3)
        return jnp.sum(dA * (psi + (self.c1 + self.c2) * shear))


CHANGES = {
    "tendons": dict(gravity=ACROSS, bending_damping=1e-6, **PULL),
    "plane": dict(gravity=ACROSS, plane="xz", **PULL),
    "inextensible": dict(gravity=ACROSS, inextensible=True),
    "taper": dict(gravity=ACROSS, section_at_end=sr.Circle(4e-3)),
}


def moved(scene, scheme=sr.SDIRK(), steps=6):
    rows = None if scene.tendons is None else 0.05 * jnp.arange(1.0, steps + 1)[:, None]
    motion = sr.simulate(
        scene, 0.01, rows, steps=steps, method=METHOD, scheme=scheme, max_time_error=1e9,
        throw=False,
    )  # fmt: skip
    return motion.tip_positions, motion.result


@pytest.mark.parametrize("name", CHANGES)
def test_the_law_written_again(name):
    """As an energy of a user, in statics and in motions."""
    taper = 4e-3 if name == "taper" else R
    own, again = (rod(material=x, **CHANGES[name]) for x in (LAW, Fibred(C1, C2, taper)))
    still = [
        sr.solve_static(x, None if x.tendons is None else [0.3], method=METHOD)
        for x in (own, again)
    ]
    np.testing.assert_allclose(still[0].positions, still[1].positions, rtol=0, atol=1e-9)
    moving = [jax.jit(moved)(x) for x in (own, again)]
    assert [int(x[1]) for x in moving] == [0, 0]
    assert np.abs(moving[0][0][-1] - moving[0][0][0]).max() > 2e-3
    np.testing.assert_allclose(moving[0][0], moving[1][0], rtol=0, atol=1e-8)


@pytest.mark.long
def test_both_methods_and_both_time_schemes():
    scene = rod(gravity=ACROSS, section_at_end=sr.Circle(5e-3))
    tips = [
        sr.solve_static(scene, method=method).tip_position
        for method in (sr.Collocation(12), sr.Shooting(3, 12))
    ]
    np.testing.assert_allclose(tips[0], tips[1], rtol=0, atol=1e-6)
    ends = [jax.jit(lambda s, x=x: moved(s, x))(scene)[0] for x in (sr.SDIRK(), sr.BDFAlpha())]
    np.testing.assert_allclose(ends[0], ends[1], rtol=0, atol=2e-3)


def test_energy_of_an_undamped_swing_is_kept():
    """What a rod gains from gravity it has as motion and in its fibres, which are asked here."""
    scene = rod(gravity=ACROSS / 3, plane="xz")
    motion = sr.simulate(scene, 2.5e-3, steps=100, method=sr.Collocation(12), scheme=sr.SDIRK(4))
    energy, A = Fibred(C1, C2), np.pi * R**2
    own = jax.vmap(jax.vmap(lambda e: energy.density(e[:3], e[3:], 0.0)))(motion.strains)
    J = R**2 / 4 * np.array([1.0, 1.0, 2.0])
    q, w = motion.velocities[..., :3], motion.velocities[..., 3:]
    moving = 0.5 * 1070.0 * A * (jnp.sum(q**2, -1) + w**2 @ J)
    height = -1070.0 * A * motion.positions @ scene.gravity
    simpson = L / 36 * np.array([1, *[4, 2] * 5, 4, 1])
    stored, total = np.asarray(own @ simpson), np.asarray((own + moving + height) @ simpson)
    assert np.ptp(stored) > 2e-4
    np.testing.assert_allclose(total, total[0], rtol=0, atol=1e-3 * np.ptp(stored))


# Segments


def segment(length, **own):
    return sr.Segment(length=length, section=sr.Circle(R), **own)


def test_segments_of_one_law_are_a_rod_of_it():
    parts = (segment(0.04), segment(0.03, material=sr.MooneyRivlin(C1, C2)), segment(0.03))
    whole = rod(gravity=ACROSS, **PULL)
    divided = rod(length=None, section=None, segments=parts, gravity=ACROSS, **PULL)
    tips = [
        sr.solve_static(x, [0.3], method=sr.Collocation(12)).tip_position for x in (whole, divided)
    ]
    np.testing.assert_allclose(tips[0], tips[1], rtol=0, atol=1e-7)


def test_segments_of_several_laws_have_each_their_own():
    """A force along the rod: the stretch of each follows by its law."""
    E, l = 5e4, 1.3
    parts = (
        segment(0.03),
        segment(0.03, young_modulus=E, poisson_ratio=0.4),
        sr.Segment(length=0.04, section=sr.Rectangle(8e-3, 9e-3), material=sr.NeoHookean(2 * C1)),
    )
    N = np.pi * R**2 * stress(l)
    load = sr.TipLoad(force=np.array([0.0, 0.0, N]))
    scene = rod(length=None, section=None, segments=parts, tip_load=load)
    solution = sr.solve_static(scene, method=METHOD, newton=CLOSE)
    strains = solution.strains
    np.testing.assert_allclose(strains[0, 2], l, rtol=1e-10)
    middle = np.searchsorted(solution.arc_lengths, 0.045)
    np.testing.assert_allclose(strains[middle, 2], 1 + N / (E * np.pi * R**2), rtol=1e-10)
    last = strains[-1, 2]
    np.testing.assert_allclose(72e-6 * 2 * C1 * (last - 1 / last**2), N, rtol=1e-10)


# Derivatives, batches and what cannot be


@pytest.mark.long
def test_derivatives_and_batches():
    """Forward, reverse and central differences agree, and a batch is a loop."""
    scene = rod(gravity=ACROSS, bending_damping=1e-6, plane="xz", **PULL)

    def tip(x):
        changed = dataclasses.replace(scene, material=sr.MooneyRivlin(C1 * x[0], C2 * x[1]))
        still = sr.solve_static(changed, [0.2], method=METHOD, throw=False)
        return jnp.concatenate([still.tip_position, moved(changed, steps=3)[0][-1]])

    at = jnp.array([1.0, 0.8])
    forward, reverse = jax.jit(jax.jacfwd(tip))(at), jax.jit(jax.jacrev(tip))(at)
    assert np.abs(forward).min(axis=1)[[0, 2]].min() > 1e-5
    np.testing.assert_allclose(forward, reverse, rtol=0, atol=1e-9 * np.abs(forward).max())
    d = 1e-3
    points = jnp.stack([at + s * d * e for e in jnp.eye(2) for s in (1.0, -1.0)])
    ends = jax.jit(jax.vmap(tip))(points)
    slopes = np.stack([ends[0] - ends[1], ends[2] - ends[3]], 1) / (2 * d)
    np.testing.assert_allclose(forward, slopes, rtol=0, atol=1e-5 * np.abs(forward).max())
    np.testing.assert_allclose(ends[1], jax.jit(tip)(points[1]), rtol=0, atol=1e-12)


def test_any_tension_has_an_equilibrium():
    """Fibres cannot be pressed to nothing, and so the path of a tendon inside cannot, either."""
    for tension in (3.0, 30.0):
        solution = sr.solve_static(rod(plane="xz", **PULL), [tension])
        v, u = solution.strains[0, 2], solution.strains[0, 4]
        assert 0 < v - R * u < v - 4e-3 * u
        same = np.broadcast_to(solution.strains[:1], solution.strains.shape)
        np.testing.assert_allclose(solution.strains, same, rtol=1e-6, atol=1e-6)


def test_what_cannot_be_is_a_code_and_leaves_its_batch_alone():
    """A constant below zero, and a load that would take all floats; the derivatives stay finite."""

    def tip(c1, force):
        load = sr.TipLoad(force=force * jnp.array([0.0, 0.0, 1.0]))
        scene = rod(material=sr.MooneyRivlin(c1, C2), tip_load=load, plane="xz")
        solution = sr.solve_static(scene, method=METHOD, throw=False)
        return solution.tip_position[2], solution.result

    batch = jnp.array([C1, -C1, C1, jnp.nan]), jnp.array([0.5, 0.5, -1e200, 0.5])
    value = lambda c1, force: jax.vmap(tip)(c1, force)
    ends, codes = jax.jit(value)(*batch)
    assert codes[0] == 0 and codes[1] == codes[3] == sr.RESULTS.bad_input and codes[2] != 0
    slopes = jax.jit(jax.grad(lambda c1: jnp.sum(value(c1, batch[1])[0])))(batch[0])
    assert np.isfinite(ends).all() and np.isfinite(slopes).all()
    assert slopes[0] < 0 and not np.any(slopes[1:])
