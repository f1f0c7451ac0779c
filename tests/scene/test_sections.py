"""Sections with holes: their moments, their torsion against a solution, and what cannot be."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from test_scene_file import assert_same, write
from test_scene_language import OF_ONE, UNIFORM

import softrod_jax as sr
from softrod_jax.scene.scene import as_arrays

RADIUS = 6e-3


def ring(offset, radius, count=3, start=0.0):
    angle = start + 2 * np.pi * np.arange(count) / count
    row = [offset * np.cos(angle), offset * np.sin(angle), np.full(count, radius)]
    return np.stack(row, -1)


ROBOT = np.concatenate([[[0.0, 0.0, 1.5e-3]], ring(4e-3, 0.75e-3)])


def with_holes(holes, **own):
    section = sr.Circle(RADIUS, holes=holes)
    moduli = {} if "material" in own else dict(young_modulus=1e5, poisson_ratio=0.4)
    return as_arrays(sr.Scene(length=0.1, section=section, density=1e3, **(moduli | own)))


def torsion_constant(radius, holes, powers=24, poles=10, count=400):
    """By a series that is harmonic around the holes, its coefficients fitted on all edges.

    The conjugate of warping is r^2/2 on the outer edge, and that and a constant on each hole's.
    """
    turns = np.exp(2j * np.pi * np.arange(count) / count)
    centres = [0j, *(x + 1j * y for x, y, _ in holes)]
    radii = [radius, *(a for _, _, a in holes)]
    edges = [c + a * turns for c, a in zip(centres, radii, strict=True)]

    def series(z):
        terms = [(z / radius) ** n for n in range(powers)]
        beside = list(zip(centres, radii, strict=True))[1:]
        return np.stack(terms + [(a / (z - c)) ** n for c, a in beside for n in range(1, poles)], 1)

    rows = []
    for k, z in enumerate(edges):
        terms, own = series(z), np.zeros((count, len(holes)))
        if k:
            own[:, k - 1] = -1.0
        rows.append(np.hstack([terms.real, -terms.imag[:, 1:], own]))
    right = np.concatenate([np.abs(z) ** 2 / 2 for z in edges])
    found = np.linalg.lstsq(np.vstack(rows), right, rcond=1e-14)[0]
    size = series(edges[0]).shape[1]
    a = found[:size] + 1j * np.append(0.0, found[size : 2 * size - 1])
    # Of Prandtl's function: twice its integral, and that of what it is on the holes.
    total = 0.0
    for sign, z, c in zip([1, *[-1] * len(holes)], edges, centres, strict=True):
        dz = 2j * np.pi / count * (z - c)
        total += sign * (np.sum(np.conj(z) * (series(z) @ a) * dz) / 2j).real
    areas = np.pi * np.array(radii[1:]) ** 2
    polar = np.pi * radius**4 / 2 - areas @ [
        r**2 / 2 + abs(c) ** 2 for c, r in zip(centres[1:], radii[1:], strict=True)
    ]
    return 2 * total - polar + 2 * found[2 * size - 1 :] @ areas


@pytest.mark.parametrize(
    "holes, most",
    [
        (ROBOT, 1.2e-3),
        (ROBOT[:1], 1e-12),
        (ring(4e-3, 0.75e-3, 4), 2.6e-3),
        (ring(3e-3, 1e-3, 3, 0.4), 8e-3),
    ],
)
def test_torsion(holes, most):
    """As of small holes; how far that is off is what the class says."""
    section = with_holes(holes).section
    known = torsion_constant(RADIUS, holes)
    solid = np.pi * RADIUS**4 / 2
    assert abs(section.torsion_constant - known) < most * known
    # By the polar moment alone, a ring would take away about half of what it does.
    if len(holes) > 1:
        polar = float(section.second_moments.sum())
        assert abs(section.torsion_constant - known) < 0.3 * abs(polar - known) < 0.1 * solid


def test_moments():
    """By sums over a fine grid."""
    section = with_holes(ROBOT).section
    x = (np.arange(2000) + 0.5) / 1000 * RADIUS - RADIUS
    x, y = np.meshgrid(x, x, indexing="ij")
    left = x**2 + y**2 < RADIUS**2
    for a, b, r in ROBOT:
        left &= (x - a) ** 2 + (y - b) ** 2 > r**2
    dA = (RADIUS / 1000) ** 2
    np.testing.assert_allclose(section.area, left.sum() * dA, rtol=1e-4)
    known = np.array([(y**2)[left].sum(), (x**2)[left].sum()]) * dA
    np.testing.assert_allclose(section.second_moments, known, rtol=1e-4)


def test_a_hole_in_the_middle_makes_a_tube():
    hole, tube = with_holes([[0.0, 0.0, 2e-3]]).section, sr.Annulus(RADIUS, 2e-3)
    for name in ("area", "second_moments", "torsion_constant"):
        np.testing.assert_allclose(getattr(hole, name), getattr(tube, name), rtol=1e-14)


@pytest.mark.parametrize("law", ["linear", "rubber"])
def test_a_robot_with_holes(law, tmp_path):
    """Turned by a third, it does the same; and a taper has holes that change as well."""
    own = {} if law == "linear" else dict(material=sr.MooneyRivlin(1e4, 6e3))
    tendons = sr.Tendons(ROBOT[1:, :2])
    scene = with_holes(ROBOT, tendons=tendons, **own)
    method = sr.Collocation(6)
    solve = lambda scene, tensions: sr.solve_static(scene, tensions, method=method).tip_position
    first, second = solve(scene, [0.2, 0.0, 0.0]), solve(scene, [0.0, 0.2, 0.0])
    c, s = -0.5, np.sqrt(0.75)
    turned = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]) @ np.asarray(first)
    assert abs(first[0]) > 5e-3
    np.testing.assert_allclose(second, turned, rtol=0, atol=1e-10)
    sr.save_scene(scene, tmp_path / "a.toml")
    assert_same(scene, sr.load_scene(tmp_path / "a.toml"))
    smaller = sr.Circle(0.9 * RADIUS, holes=0.9 * ROBOT)
    tapered = with_holes(ROBOT, section_at_end=smaller, tendons=tendons, **own)
    assert abs(solve(tapered, [0.2, 0.0, 0.0])[0]) > abs(first[0])


@pytest.mark.parametrize(
    "holes, expected",
    [
        ("[0.0, 0.0, 1e-3]", "1 or more lists of 3 numbers"),
        ("[[0.0, 0.0, 0.0]]", "radius above 0"),
        ("[[0.0, 0.0, 6e-3]]", "within radius = 0.006"),
        ("[[0.0, 0.0, 2e-3], [0.0, 0.0, 1e-3]]", "run into each other"),
        ("[[3e-3, 0.0, 1e-3]]", "the same around the axis"),
        ("[[3e-3, 0.0, 1e-3], [-3e-3, 0.0, 1e-3]]", "a ring of three"),
    ],
)
def test_holes_that_cannot_be(tmp_path, holes, expected):
    text = UNIFORM.replace("radius = 6e-3", f"radius = 6e-3, holes = {holes}")
    with pytest.raises(sr.SceneError, match=f"rod.section.holes = .*{expected}"):
        sr.load_scene(write(tmp_path, text))


def test_a_taper_has_as_many_holes_at_its_end(tmp_path):
    text = UNIFORM + 'section_at_end = { shape = "circle", radius = 5e-3, holes = [[0, 0, 1e-3]] }'
    with pytest.raises(sr.SceneError, match=r"section_at_end.holes = 1: expected 0 holes"):
        sr.load_scene(write(tmp_path, text))


@pytest.mark.parametrize("plane, fits", [("xz", True), ("yz", False)])
def test_rubber_that_bends_in_a_plane_has_holes_on_both_sides(tmp_path, plane, fits):
    """The ring's first hole is on the x axis. Of a linear rod it does not matter."""
    rows = ROBOT[1:].tolist()
    text = OF_ONE.replace("radius = 6e-3", f"radius = 6e-3, holes = {rows}")
    text += f'plane = "{plane}"\nmaterial = {{ law = "neo_hookean", mu = 1e4 }}\n'
    if fits:
        sr.load_scene(write(tmp_path, text))
    else:
        with pytest.raises(sr.SceneError, match="rod.section.holes = .* both sides of the plane"):
            sr.load_scene(write(tmp_path, text))
    law = sr.NeoHookean(1e4)
    traced = lambda holes: (
        sr.solve_static(
            with_holes(holes, plane=plane, material=law), method=sr.Collocation(2), throw=False
        ).result
    )
    assert int(jax.jit(traced)(jnp.array(rows))) == (0 if fits else sr.RESULTS.bad_input)
    assert with_holes(rows, plane=plane).plane == plane
