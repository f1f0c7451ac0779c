"""A scene that is printed: numbers with units, parts counted; shapes of batches and traced ones."""

import jax
import jax.numpy as jnp
import pytest
from test_scene_file import write
from test_scene_language import WIDER

import softrod_jax as sr

ROBOT = """\
Scene
  rod
    length = 0.1 m
    section = Circle(radius = 0.006 m)
    young_modulus = 50000 Pa
    poisson_ratio = 0.49
    density = 1070 kg/m^3
    bending_damping = 1e-06 N m^2 s
    gravity = [0, 0, 9.81] m/s^2
    drag_coefficient = 0.03 kg/m^2
  3 tendons
    0: offset = [0.004, 0] m
    1: offset = [-0.002, 0.0034641] m
    2: offset = [-0.002, -0.0034641] m
  1 chamber
    0: area = 7.06858e-06 m^2, offset = [0, 0] m"""


def test_numbers_with_units():
    robot = sr.hybrid_robot(gravity=[0.0, 0.0, 9.81])
    assert str(robot) == repr(robot) == ROBOT


def test_a_wider_robot(tmp_path):
    text = str(sr.load_scene(write(tmp_path, WIDER)))
    for line in (
        "    length = 0.11 m",
        "  2 segments",
        "    0: length = 0.06 m, section = Circle(radius = 0.006 m), section_at_end = "
        "Circle(radius = 0.005 m), young_modulus = 200000 Pa, poisson_ratio = 0.49, "
        "bending_damping = 1e-06 N m^2 s, intervals = 6",
        "  4 tendons",
        "    0: offset = [0.004, 0] m, starts_at = 0.01 m, ends_at = 0.06 m",
        "    1: offset = [0, 0] m, path = Helix(radius = 0.004 m, angle = 1.5 rad, turns = -0.5)",
        "    2: offset = [0, 0] m, path = Line(begin = [0.009, 0] m, end = [0.001, 0] m), "
        "guided = disks",
        "  1 chamber",
        "  2 loads",
        "    0: at = 0.06 m, force = [0, 0, 0.005] N",
        "    1: at = 0.1 m, moment = [0.0001, 0, 0] N m, frame = body",
        "  1 mass",
        "    0: at = 0.06 m, mass = 0.002 kg",
        "  2 markers",
        "    1: name = elbow, at = 0.06 m",
    ):
        assert line in text.split("\n"), line


def test_restrictions_are_said():
    scene = sr.Scene(0.1, sr.Circle(1e-3), 1e5, 0.4, 1000.0, inextensible=True, plane="xz")
    assert "    inextensible = True\n    plane = xz" in str(scene)
    assert "inextensible" not in str(sr.hybrid_robot()) and "plane" not in str(sr.hybrid_robot())


def test_batches_by_range_and_shape():
    robots = jax.vmap(sr.hybrid_robot)(jnp.array([0.1, 0.2, 0.15]))
    text = str(robots)
    assert "    length = 0.1 to 0.2 m, of shape (3,)" in text.split("\n")
    assert "  tendons: offsets = -0.0034641 to 0.004 m, of shape (3, 3, 2)" in text
    assert len(text) < 1000


def test_traced_numbers_by_shape():
    seen = []

    @jax.jit
    def look(scene):
        seen.append(str(scene))
        return scene.length

    look(sr.hybrid_robot(gravity=[0.0, 0.0, 9.81]))
    assert "    gravity = traced, of shape (3,) m/s^2" in seen[0]
    assert "  tendons: offsets = traced, of shape (3, 2) m" in seen[0]


def test_many_are_counted():
    markers = [sr.Marker(f"m{i}", 0.01 * i) for i in range(30)]
    text = str(sr.Scene(0.3, sr.Circle(1e-3), 1e5, 0.4, 1000.0, markers=markers))
    assert "  30 markers" in text and "    ... and 23 more" in text and "m8" not in text


@pytest.mark.usefixtures("wrong_types")
def test_what_is_no_scene_can_be_printed_too():
    strange = sr.Scene("long", None, [1.0, [2.0]], None, object(), tendons=sr.Tendons([0.0]))
    assert "length = 'long'" in str(strange)
    assert "float64[]" not in str(jax.tree.map(lambda x: None, sr.hybrid_robot()))
    str(jax.tree.structure(sr.hybrid_robot()))
