"""What is refused of wider robots, in files and in Python alike."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from test_scene_file import write
from test_scene_language import UNIFORM, WIDER

import softrod_jax as sr
from softrod_jax.scene.checks import can_be, checked_scene, harmless_unless
from softrod_jax.scene.scene import as_arrays


def wider(old, new):
    assert WIDER.count(old) == 1, old
    return WIDER.replace(old, new)


def uniform(*lines):
    return UNIFORM + "\n".join(lines) + "\n"


TENDON = "[[tendons]]\noffset = [1e-3, 0]"
HELIX = 'path = { shape = "helix", radius = 4e-3, angle = 1.5, turns = -0.5 }'
LINE = 'path = { shape = "line", from = [9e-3, 0.0], to = [1e-3, 0.0] }'
POINTS = "points = [[0.0, 3e-3, 0.0], [0.05, 0.0, 3e-3], [0.11, -3e-3, 0.0]]"
STIFFNESS = "bending = [2e-5, 3e-5], torsion = 1e-5, axial = 6.0, shear = [2.0, 2.0]"
TAPER = 'section_at_end = { shape = "circle", radius = 5e-3 }'

# What is wrong, the file, and what the message must say besides the file's name.
BAD = [
    ("no segments", "segments = []\n[rod]\ndensity = 1", ["segments = []", "one at least"]),
    ("one bracket", "[segments]\nlength = 1\n[rod]", ["segments", "[[segments]]"]),
    (
        "length beside segments",
        wider("[rod]", "[rod]\nlength = 0.1"),
        ["rod.length = 0.1", "leave length out"],
    ),
    (
        "section beside segments",
        wider("[rod]", '[rod]\nsection = { shape = "circle", radius = 1e-3 }'),
        ["rod.section = {", "leave section out"],
    ),
    ("taper beside segments", wider("[rod]", f"[rod]\n{TAPER}"), ["rod.section_at_end", "leave"]),
    (
        "a segment without length",
        wider("length = 0.05\n", ""),
        ["segments[1].length is missing", "[m], above 0"],
    ),
    (
        "a segment of length 0",
        wider("length = 0.05\n", "length = 0\n"),
        ["segments[1].length = 0", "above 0"],
    ),
    (
        "a segment without section",
        wider('section = { shape = "circle", radius = 5e-3 }\ns', "s"),
        ["segments[1].section is missing", "a table"],
    ),
    (
        "a key of a segment",
        wider("intervals = 6", "interval = 6"),
        ["segments[0].interval = 6", '"intervals"'],
    ),
    (
        "a section of a segment",
        wider("radius = 6e-3 }", "radius = -6e-3 }"),
        ["segments[0].section.radius = -0.006", "above 0"],
    ),
    (
        "a taper to another shape",
        wider(TAPER, 'section_at_end = { shape = "annulus", outer_radius = 1, inner_radius = 0 }'),
        ["segments[0].section_at_end.shape = 'annulus'", '"circle"'],
    ),
    (
        "a taper to nothing",
        wider(TAPER, TAPER.replace("5e-3", "0")),
        ["segments[0].section_at_end.radius = 0", "above 0"],
    ),
    (
        "a taper of the rod",
        uniform('section_at_end = { shape = "rectangle", width = 1, height = 1 }'),
        ["rod.section_at_end.shape = 'rectangle'", '"circle"'],
    ),
    (
        "a tube inside out",
        wider(TAPER, "").replace(
            'shape = "circle", radius = 6e-3',
            'shape = "annulus", outer_radius = 1e-3, inner_radius = 2e-3',
        ),
        ["segments[0].section.inner_radius = 0.002", "less than outer_radius"],
    ),
    (
        "intervals",
        wider("intervals = 6", "intervals = 0"),
        ["segments[0].intervals = 0", "at least 1"],
    ),
    ("half an interval", wider("intervals = 6", "intervals = 2.5"), ["intervals = 2.5", "whole"]),
    (
        "no modulus",
        wider("young_modulus = 8.0e4\n", "").replace("young_modulus = 2.0e5\n", ""),
        ["segments[0].young_modulus is missing", "[Pa]", "in [rod]", "or stiffness"],
    ),
    (
        "no modulus of the rod",
        UNIFORM.replace("young_modulus = 5.0e4\n", ""),
        ["rod.young_modulus is missing", "above 0; or stiffness"],
    ),
    (
        "no ratio",
        UNIFORM.replace("poisson_ratio = 0.49\n", ""),
        ["rod.poisson_ratio is missing", "below 0.5"],
    ),
    (
        "no density",
        wider("density = 1000.0\n", ""),
        ["segments[0].density is missing", "or linear_density"],
    ),
    (
        "a modulus twice",
        uniform("stiffness = { bending = [1, 1], torsion = 1 }"),
        ["rod.young_modulus = 50000.0", "stiffness stands for it"],
    ),
    (
        "a modulus of a segment twice",
        wider("linear_density", "young_modulus = 1e5\nlinear_density"),
        ["segments[1].young_modulus = 100000.0", "stiffness stands for it"],
    ),
    (
        "a correction of stiffness",
        wider("linear_density", "shear_correction = 1\nlinear_density"),
        ["segments[1].shear_correction = 1.0", "stiffness"],
    ),
    (
        "a density twice",
        uniform("linear_density = 0.1"),
        ["rod.density = 1070.0", "linear_density stands for it"],
    ),
    (
        "no axial stiffness",
        wider(", axial = 6.0", ""),
        ["segments[1].stiffness.axial is missing", "[N], above 0", "inextensible"],
    ),
    (
        "no shear stiffness",
        wider(", shear = [2.0, 2.0]", ""),
        ["segments[1].stiffness.shear is missing", "list of 2 numbers"],
    ),
    (
        "no torsion",
        wider("torsion = 1e-5, ", ""),
        ["segments[1].stiffness.torsion is missing", "N m^2"],
    ),
    (
        "bending for one axis",
        wider("bending = [2e-5, 3e-5]", "bending = 2e-5"),
        ["segments[1].stiffness.bending = 2e-05", "list of 2 numbers"],
    ),
    (
        "a negative stiffness",
        wider("axial = 6.0", "axial = -6.0"),
        ["segments[1].stiffness.axial = -6.0", "above 0"],
    ),
    ("a key of stiffness", wider("axial =", "axil ="), ["stiffness.axil = 6.0", '"axial"']),
    (
        "stiffness that is a number",
        wider(f"{{ {STIFFNESS} }}", "3"),
        ["segments[1].stiffness = 3", "one table"],
    ),
    (
        "a negative mass per length",
        wider("linear_density = 0.08", "linear_density = -1"),
        ["segments[1].linear_density = -1", "[kg/m]"],
    ),
    (
        "a rest of no length",
        wider("rest_curvature = [1.0, 0.0, 0.0]", "rest_stretch = [0, 0, 0]"),
        ["segments[1].rest_stretch = [0.0, 0.0, 0.0]", "above 0"],
    ),
    (
        "neither offset nor path",
        uniform("[[tendons]]", "ends_at = 0.05"),
        ["tendons[0].offset is missing", "or a path"],
    ),
    (
        "an end beyond the tip",
        wider("ends_at = 0.06", "ends_at = 0.2"),
        ["tendons[0].ends_at = 0.2", "its length 0.11 [m]"],
    ),
    (
        "an end at the base",
        wider("ends_at = 0.06", "ends_at = 0"),
        ["tendons[0].ends_at = 0", "above 0"],
    ),
    (
        "a beginning before the base",
        wider("starts_at = 0.01", "starts_at = -0.01"),
        ["tendons[0].starts_at = -0.01", "at least 0"],
    ),
    (
        "a beginning after the end",
        wider("starts_at = 0.01", "starts_at = 0.06"),
        ["tendons[0].starts_at = 0.06", "where it ends, 0.06 [m]"],
    ),
    (
        "a beginning at the tip",
        uniform(TENDON, "starts_at = 0.1"),
        ["tendons[0].starts_at = 0.1", "less than where it ends"],
    ),
    (
        "a chamber that ends beyond the tip",
        wider("ends_at = 0.055", "ends_at = 0.12"),
        ["chambers[0].ends_at = 0.12", "its length 0.11 [m]"],
    ),
    (
        "a chamber backwards",
        wider("ends_at = 0.055", "ends_at = 0.055\nstarts_at = 0.08"),
        ["chambers[0].starts_at = 0.08", "where it ends, 0.055"],
    ),
    (
        "guided by hope",
        wider('"disks"', '"hope"'),
        ["tendons[2].guided = 'hope'", '"rod", "disks"'],
    ),
    (
        "a path that is a word",
        wider(HELIX, 'path = "helix"'),
        ["tendons[1].path = 'helix'", "table"],
    ),
    (
        "a path without shape",
        wider('{ shape = "helix", ', "{ "),
        ["tendons[1].path.shape is missing", "helix, line, points"],
    ),
    (
        "an unknown path",
        wider('"helix"', '"spiral"'),
        ["tendons[1].path.shape = 'spiral'", '"helix"'],
    ),
    (
        "a helix without radius",
        wider("radius = 4e-3, ", ""),
        ["tendons[1].path.radius is missing", "[m], at least 0"],
    ),
    (
        "a helix of a negative radius",
        wider("radius = 4e-3, ", "radius = -4e-3, "),
        ["tendons[1].path.radius = -0.004", "at least 0"],
    ),
    (
        "a key of a helix",
        wider("turns = -0.5", "turn = 1"),
        ["tendons[1].path.turn = 1", '"turns"'],
    ),
    (
        "turns that are endless",
        wider("turns = -0.5", "turns = inf"),
        ["path.turns = inf", "finite"],
    ),
    (
        "a line to nowhere",
        wider(", to = [1e-3, 0.0]", ""),
        ["tendons[2].path.to is missing", "2 num"],
    ),
    (
        "a line in space",
        wider("from = [9e-3, 0.0]", "from = [9e-3, 0.0, 0.0]"),
        ["tendons[2].path.from", "list of 2 numbers"],
    ),
    (
        "one point",
        wider(POINTS, "points = [[0, 0, 0]]"),
        ["tendons[3].path.points = [[0, 0, 0]]", "2 or more lists of 3 numbers"],
    ),
    (
        "points in the section",
        wider(POINTS, "points = [[0, 0], [1, 1]]"),
        ["tendons[3].path.points", "lists of 3 numbers"],
    ),
    (
        "points that go back",
        wider("[0.05, 0.0, 3e-3]", "[0.12, 0.0, 3e-3]"),
        ["tendons[3].path.points", "s to rise"],
    ),
    (
        "points of words",
        wider("[0.05, 0.0, 3e-3]", '"x"'),
        ["tendons[3].path.points", "lists of 3"],
    ),
    (
        "a helix outside",
        wider("radius = 4e-3, ", "radius = 5.2e-3, "),
        [
            "tendons[1].path = [",
            "outside the section at s = 0.0",
            "radius 0.00",
            'guided = "disks"',
        ],
    ),
    (
        "a line outside",
        wider('guided = "disks"\n', ""),
        ["tendons[2].path = [0.009, 0.0]", "at s = 0 m", "radius 0.006 m", '"disks"'],
    ),
    (
        "points outside",
        wider("[0.05, 0.0, 3e-3]", "[0.05, 0.0, 3e-2]"),
        ["tendons[3].path = [", "outside the section at s = 0.0"],
    ),
    (
        "an offset and a path outside",
        wider("offset = [1e-3, 0.0]", "offset = [4e-3, 0.0]"),
        ["tendons[3].path = [0.007", "outside the section at s ="],
    ),
    (
        "outside where it tapers",
        wider("offset = [4e-3, 0.0]", "offset = [5.5e-3, 0.0]"),
        ["tendons[0].offset = [0.0055, 0.0]", "at s = 0.06 m", "radius 0.005 m", '"disks"'],
    ),
    (
        "outside the second segment",
        wider(
            "offset = [4e-3, 0.0]\nstarts_at = 0.01\nends_at = 0.06", "offset = [0, 5.5e-3]"
        ).replace(TAPER, ""),
        ["tendons[0].offset = [0.0, 0.0055]", "at s = 0.06 m", "radius 0.005 m"],
    ),
    (
        "a chamber outside",
        wider("offset = [2e-3, 1e-3]", "offset = [5.5e-3, 0.0]"),
        ["chambers[0].offset = [0.0055, 0.0]", "outside the section at s = 0.055 m"],
    ),
    (
        "a chamber too large",
        wider("area = 7e-6", "area = 9e-5"),
        ["chambers[0].area = 9e-05", "larger than the section", "at most 8.1"],
    ),
    ("a load nowhere", wider("at = 0.1\n", ""), ["loads[1].at is missing", "[m], at least 0"]),
    (
        "a load beyond the tip",
        wider("at = 0.1\n", "at = 0.12\n"),
        ["loads[1].at = 0.12", "0 to its length 0.11 [m]"],
    ),
    (
        "a load of nothing",
        uniform("[[loads]]", "at = 0.05"),
        ["loads[0].force is missing", "or a moment"],
    ),
    (
        "a load in another frame",
        wider('"body"', '"world"'),
        ["loads[1].frame = 'world'", '"base", "body"'],
    ),
    (
        "a force of two numbers",
        wider("force = [0.0, 0.0, 5e-3]", "force = [1, 2]"),
        ["loads[0].force = [1, 2]", "list of 3 numbers [N]"],
    ),
    (
        "a mass before the base",
        wider("at = 0.06\nmass", "at = -0.06\nmass"),
        ["masses[0].at = -0.06", "at least 0"],
    ),
    ("a mass without mass", wider("mass = 2e-3\n", ""), ["masses[0].mass is missing", "[kg]"]),
    ("a negative mass", wider("mass = 2e-3", "mass = -1"), ["masses[0].mass = -1", "at least 0"]),
    ("a marker without a name", wider('name = "m1"\n', ""), ["markers[0].name is missing", "word"]),
    ("a marker that is the tip", wider('"m1"', '"tip"'), ["markers[0].name = 'tip'", "taken"]),
    ("a marker that is the base", wider('"m1"', '"base"'), ["markers[0].name = 'base'", "taken"]),
    (
        "a marker named twice",
        wider('"m1"', '"elbow"'),
        ["markers[1].name = 'elbow'", "another marker has this name"],
    ),
    ("a name with a blank", wider('"m1"', '"m 1"'), ["markers[0].name = 'm 1'", "letters, digits"]),
    ("a name that is a number", wider('"m1"', "1"), ["markers[0].name = 1", "a word in quotes"]),
    (
        "a marker beyond the tip",
        wider("at = 0.05\n", "at = 0.5\n"),
        ["markers[0].at = 0.5", "its length 0.11 [m]"],
    ),
    (
        "a marker in the section only",
        wider("offset = [5e-3, 0.0, 0.0]", "offset = [5e-3, 0.0]"),
        ["markers[0].offset", "list of 3 numbers [m]"],
    ),
    (
        "a path off the plane",
        uniform('plane = "xz"', "[[tendons]]", HELIX),
        ["tendons[0].path = [", 'not in the plane "xz"', "expected 0 for y"],
    ),
    (
        "a load off the plane",
        uniform('plane = "xz"', "[[loads]]", "at = 0.05", "force = [0, 1, 0]"),
        ["loads[0].force = [0.0, 1.0, 0.0]", "expected 0 for y"],
    ),
    (
        "a moment off the plane",
        uniform('plane = "xz"', "[[loads]]", "at = 0.05", "moment = [1, 0, 0]", 'frame = "body"'),
        ["loads[0].moment = [1.0, 0.0, 0.0]", "expected 0 for x and z"],
    ),
    (
        "a rest off the plane",
        wider("[rod]", '[rod]\nplane = "yz"').replace(
            "rest_curvature = [1.0, 0.0, 0.0]", "rest_curvature = [1.0, 0.0, 2.0]"
        ),
        ["segments[1].rest_curvature = [1.0, 0.0, 2.0]", "expected 0 for y and z"],
    ),
    (
        "shear damping of a segment",
        wider("[rod]", "[rod]\ninextensible = true").replace(
            "intervals = 6", "shear_damping = 1.0"
        ),
        ["segments[0].shear_damping = 1.0", "does not stretch", "leave shear_damping out"],
    ),
]


@pytest.mark.parametrize("name, text, fragments", BAD, ids=[name for name, _, _ in BAD])
def test_refuses(tmp_path, name, text, fragments):
    with pytest.raises(sr.SceneError) as error:
        sr.load_scene(write(tmp_path, text))
    message = str(error.value)
    assert "robot.toml: " in message and "\n" not in message and len(message) < 600
    for fragment in fragments:
        assert fragment in message


def test_there_are_sixty_of_them():
    assert len({name for name, _, _ in BAD}) >= 60


PYTHON = {
    "rod.length is missing": dict(length=None),
    "rod.section is missing": dict(section=None),
    "rod.young_modulus is missing": dict(young_modulus=None),
    "rod.density is missing": dict(density=None),
    "rod.section_at_end = Annulus: expected Circle": dict(section_at_end=sr.Annulus(2e-3, 1e-3)),
    "rod.section = Circle: each of the seg": dict(segments=[sr.Segment(0.1, sr.Circle(6e-3))]),
    r"segments\[0\].section.radius = -1.0": dict(
        section=None, segments=[sr.Segment(0.1, sr.Circle(-1.0))]
    ),
    r"segments\[0\].length = '1'": dict(
        section=None,
        segments=[eqx.tree_at(lambda x: x.length, sr.Segment(1.0, sr.Circle(1.0)), "1")],
    ),
    r"loads\[0\].at = 0.2": dict(loads=[sr.Load(0.2, force=[0.0, 0.0, 1.0])]),
    r"markers\[0\].name = tip": dict(markers=[sr.Marker("tip", 0.05)]),
    r"tendons\[0\].ends_at = 0.2": dict(tendons=sr.Tendons([[0.0, 0.0]], ends_at=[0.2])),
    r"tendons\[0\].offset = \[0.01, 0.0\]: outside": dict(tendons=sr.Tendons([[0.01, 0.0]])),
    r"tendons\[0\].path.radius = -0.01": dict(
        tendons=sr.Tendons([[0.0, 0.0]], paths=[sr.Helix(-0.01)])
    ),
    r"tendons\[0\].path = \[0.01, 0.0\]: outside": dict(
        tendons=sr.Tendons([[0.0, 0.0]], paths=[sr.Helix(0.01)])
    ),
    r"chambers\[0\].area = 0.001: larger": dict(chambers=sr.Chambers([1e-3], [[0.0, 0.0]])),
}


@pytest.mark.parametrize("words", PYTHON)
@pytest.mark.usefixtures("wrong_types")
def test_refuses_in_python(words):
    """Also where something else is traced, and nothing is computed for it."""
    scene = dataclasses.replace(sr.hybrid_robot(), **PYTHON[words])
    with pytest.raises(ValueError, match=f"here: the scene's {words}"):
        checked_scene("here", scene)
    with pytest.raises(ValueError, match=words):
        jax.jit(lambda x: checked_scene("here", scene).length * x)(1.0)


@pytest.mark.parametrize(
    "make, words",
    [
        (lambda: sr.Tendons([[0.0, 0.0]], ends_at=0.05), "ends_at=0.05; expected 1 of them"),
        (lambda: sr.Tendons([[0.0, 0.0]], ends_at=[0.05, 0.06]), "2 of ends_at; expected 1"),
        (lambda: sr.Tendons([[0.0, 0.0]], paths=["helix"]), "a path 'helix'; use Helix"),
        (lambda: sr.Tendons([[0.0, 0.0]], guided="hope"), "guided='hope' is not offered"),
        (lambda: sr.Load(0.1, frame="world"), "frame='world' is not offered"),
        (lambda: sr.Segment(0.1, sr.Circle(1.0), intervals=0), "intervals=0"),
    ],
)
@pytest.mark.usefixtures("wrong_types")
def test_refuses_when_it_is_made(make, words):
    with pytest.raises(ValueError, match=words):
        make()


def test_disks_and_the_surface_are_allowed():
    robot = sr.hybrid_robot()
    for tendons in (
        sr.Tendons([[0.015, 0.0]], guided="disks"),
        sr.Tendons(6e-3 * np.stack([np.cos(x := np.linspace(0, 6, 99)), np.sin(x)], 1)),
        sr.Tendons([[0.0, 0.0]], paths=[sr.Helix(6e-3, turns=3.0)]),
    ):
        checked_scene("here", dataclasses.replace(robot, tendons=tendons))


def test_traced_numbers_have_a_code_and_a_harmless_scene():
    """What does not fit along the rod is known when the program runs; shapes stay as they are."""
    tendons = sr.Tendons(
        [[1e-3, 0.0], [0.0, 0.0]],
        paths=[
            sr.Points(np.array([[0.0, 0, 0], [0.03, 1e-3, 0], [0.05, 0, 0], [0.1, 0, 0]])),
            None,
        ],
        starts_at=[None, 0.02],
        ends_at=[0.06, None],
    )
    scene = as_arrays(
        sr.Scene(
            segments=[sr.Segment(x, sr.Circle(6e-3)) for x in (0.05, 0.06)],
            young_modulus=1e5,
            poisson_ratio=0.4,
            density=1000.0,
            tendons=tendons,
            loads=[sr.Load(0.05, force=[0.0, 0.0, 1.0])],
        )
    )

    changes = {
        "none": (lambda s: s.length, 0.11, True),
        "end": (lambda s: s.tendons.ends_at[0], 0.2, False),
        "beginning": (lambda s: s.tendons.starts_at[1], 0.11, False),
        "load": (lambda s: s.loads[0].at, 0.12, False),
        "segment": (lambda s: s.segments[0].length, -0.05, False),
        "shorter": (lambda s: s.segments[1].length, 0.005, False),
        "points": (lambda s: s.tendons.paths[0].points, np.zeros((4, 3)), False),
    }
    run = jax.jit(lambda s: (good := can_be(as_arrays(s)), harmless_unless(good, s)))
    for name, (where, value, expected) in changes.items():
        fits, kept = run(eqx.tree_at(where, scene, jnp.asarray(value)))
        assert bool(fits) == expected, name
        assert all(np.all(np.isfinite(x)) for x in jax.tree.leaves(kept)), name
        # What stands in is a scene that can be.
        checked_scene("here", jax.tree.map(jnp.asarray, kept))
