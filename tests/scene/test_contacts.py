"""Obstacles in scene files: what is read and written, and what is refused of them."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from test_scene_file import BARE, assert_same, write

import softrod_jax as sr
from softrod_jax.scene.checks import can_be, checked_scene, harmless_unless, parts_of

WALL = """
[[contacts]]
shape = "plane"
point = [-0.03, 0.0, 0.0]
normal = [1.0, 0.0, 0.0]
stiffness = 2000.0
damping = 5.0
friction = 0.3
slip_speed = 2e-3
name = "wall"
"""
BALL = """
[[contacts]]
shape = "sphere"
center = [0.05, 0.0, 0.05]
radius = 0.02
stiffness = 1e3
"""
TUBE = """
[[contacts]]
shape = "tube"
axis = [[0.0, 0.0, 0.0], [0.0, 0.0, 0.05], [0.01, 0.0, 0.1]]
radius = 0.012
stiffness = 2e3
damping = 0.0
friction = 0.0
"""
MARKER = '[[markers]]\nname = "wall"\nat = 0.05\n'


def test_reads_every_key(tmp_path):
    scene = sr.load_scene(write(tmp_path, BARE + WALL + BALL + TUBE))
    wall, ball, tube = scene.contacts
    assert isinstance(wall.obstacle, sr.Plane) and wall.obstacle.point.tolist() == [-0.03, 0, 0]
    assert wall.obstacle.normal.tolist() == [1, 0, 0] and wall.name == "wall"
    assert (wall.stiffness, wall.damping, wall.friction, wall.slip_speed) == (2e3, 5, 0.3, 2e-3)
    assert isinstance(ball.obstacle, sr.Sphere) and ball.obstacle.center[2] == 0.05
    assert ball.obstacle.radius == 0.02 and ball.name is None
    assert isinstance(tube.obstacle, sr.Tube) and tube.obstacle.axis.shape == (3, 3)
    # Zero of these is absent.
    assert tube.damping is None and tube.friction is None and tube.slip_speed is None
    assert all(isinstance(x, jax.Array) and x.dtype == float for x in jax.tree.leaves(scene))
    keys = [part.key for part in parts_of(scene)]
    for key in ("contacts[0].normal", "contacts[0].stiffness", "contacts[2].axis"):
        assert key in keys
    for part, leaf in zip(parts_of(scene), jax.tree.leaves(scene), strict=True):
        assert part.value is leaf and part.number.has_shape(leaf.shape), part.key
    text = repr(scene)
    assert "3 contacts" in text and "Plane(point = [-0.03, 0, 0] m" in text
    assert sr.load_scene(write(tmp_path, BARE)).contacts is None


def test_round_trip_is_exact(tmp_path):
    scene = sr.load_scene(write(tmp_path, BARE + WALL + BALL + TUBE))
    sr.save_scene(scene, tmp_path / "a.toml")
    once = sr.load_scene(tmp_path / "a.toml")
    assert_same(scene, once)
    assert [x.name for x in once.contacts] == ["wall", None, None]


@pytest.mark.parametrize(
    "text, expected",
    [
        (WALL.replace("[[contacts]]", "[contacts]"), ["contacts = ", "[[contacts]]"]),
        (WALL.replace('shape = "plane"\n', ""), ["contacts[0].shape is missing", "sphere"]),
        (WALL.replace('"plane"', '"cube"'), ["contacts[0].shape = 'cube'", '"tube"']),
        (WALL.replace("stiffness", "stifness"), ["contacts[0].stifness", '"stiffness"']),
        (WALL.replace("stiffness = 2000.0", ""), ["contacts[0].stiffness is missing", "N/m^2"]),
        (WALL.replace("2000.0", "0.0"), ["contacts[0].stiffness = 0.0", "above 0"]),
        (WALL.replace("5.0", "-5.0"), ["contacts[0].damping = -5.0", "[s/m], at least 0"]),
        (WALL.replace("0.3\n", "-0.3\n"), ["contacts[0].friction = -0.3", "at least 0"]),
        (WALL.replace("2e-3", "0.0"), ["contacts[0].slip_speed = 0.0", "above 0"]),
        (WALL.replace("[1.0, 0.0, 0.0]", "[0, 0, 0]"), ["contacts[0].normal", "a direction"]),
        (WALL.replace("[1.0, 0.0, 0.0]", "1.0"), ["contacts[0].normal = 1.0", "3 numbers"]),
        (WALL + "radius = 1.0", ["contacts[0].radius = 1.0", "unknown key"]),
        (BALL.replace("0.02", "-0.02"), ["contacts[0].radius = -0.02", "above 0"]),
        (BALL.replace("center = [0.05, 0.0, 0.05]", ""), ["contacts[0].center is missing", "[m]"]),
        (WALL + TUBE.replace("0.012", "0.0"), ["contacts[1].radius = 0.0", "above 0"]),
        (
            TUBE.replace("[[0.0, 0.0, 0.0], [0.0, 0.0, 0.05], [0.01, 0.0, 0.1]]", "[[0, 0, 0]]"),
            ["contacts[0].axis = [[0, 0, 0]]", "2 or more lists of 3 numbers"],
        ),
        (TUBE.replace("[0.0, 0.0, 0.05]", "[0, 0, 0]"), ["contacts[0].axis", "another place"]),
        (
            WALL + TUBE.replace("0.012", "5e-3"),
            ["contacts[1].radius = 0.005: thinner than the rod, whose radius is 0.006 [m]"],
        ),
        (WALL.replace('"wall"', '"a wall"'), ["contacts[0].name = 'a wall'", "letters"]),
        (WALL.replace('"wall"', '"tip"'), ["contacts[0].name = 'tip'", "taken"]),
        (WALL + MARKER, ["contacts[0].name = 'wall'", "a marker has this name"]),
        (
            BALL + WALL.replace('"wall"', '"contact1"'),
            ["contacts[1].name = 'contact1'", "another contact"],
        ),
    ],
)
def test_what_is_refused(tmp_path, text, expected):
    with pytest.raises(sr.SceneError) as error:
        sr.load_scene(write(tmp_path, BARE + text))
    assert all(x in str(error.value) for x in expected), error.value


def test_sections_must_be_round(tmp_path):
    square = BARE.replace('"circle", radius = 6e-3', '"rectangle", width = 1e-2, height = 1e-2')
    sr.load_scene(write(tmp_path, square))
    with pytest.raises(sr.SceneError, match="rod.section = 'Rectangle': .* round"):
        sr.load_scene(write(tmp_path, square + WALL))


@pytest.mark.parametrize(
    "text, key",
    [
        (WALL.replace("[1.0, 0.0, 0.0]", "[1.0, 0.1, 0.0]"), "normal"),
        (BALL.replace("[0.05, 0.0, 0.05]", "[0.05, 0.01, 0.05]"), "center"),
        (TUBE.replace("[0.0, 0.0, 0.05]", "[0.0, 0.01, 0.05]"), "axis"),
    ],
)
def test_a_plane_that_an_obstacle_pushes_out_of(tmp_path, text, key):
    planar = BARE + 'plane = "xz"\n'
    sr.load_scene(write(tmp_path, planar + WALL + BALL + TUBE))
    with pytest.raises(sr.SceneError, match=rf"contacts\[0\].{key} = .* not in the plane"):
        sr.load_scene(write(tmp_path, planar + text))
    # It is the plane through the clamp.
    beside = planar + "base_position = [0.0, 0.01, 0.0]\n"
    with pytest.raises(sr.SceneError, match=r"contacts\[0\].center = .* not in the plane"):
        sr.load_scene(write(tmp_path, beside + BALL))


def test_numbers_that_cannot_be(tmp_path):
    """At once where they are known; a code and a harmless scene where they are traced."""
    scene = sr.load_scene(write(tmp_path, BARE + WALL + BALL + TUBE))
    changed = lambda i, **x: dataclasses.replace(scene.contacts[i], **x)
    bad = dataclasses.replace(scene, contacts=(changed(0, stiffness=jnp.array(np.nan)),))
    with pytest.raises(ValueError, match=r"contacts\[0\].stiffness = nan"):
        checked_scene("here", bad)
    tube = scene.contacts[2].obstacle
    flat = dataclasses.replace(tube, axis=jnp.zeros((3, 3)))
    thin = changed(2, obstacle=dataclasses.replace(tube, radius=5.9e-3))
    run = jax.jit(lambda s: (good := can_be(s), harmless_unless(good, s)))
    for contact in (bad.contacts[0], changed(2, obstacle=flat), thin, changed(1, stiffness=-1.0)):
        fits, kept = run(jax.tree.map(jnp.asarray, dataclasses.replace(scene, contacts=(contact,))))
        assert not fits
        checked_scene("here", jax.tree.map(jnp.asarray, kept))


def test_a_tube_holds_the_rod_where_that_is_thickest():
    """At an end of a taper, in any segment, and as a hollow rod's outside."""
    tube = sr.Contact(sr.Tube([[0.0, 0.0, 0.0], [0.0, 0.0, 0.1]], 6e-3), 1e3)
    own = dict(young_modulus=5e4, poisson_ratio=0.49, density=1070.0, contacts=(tube,))
    thin, thick, hollow = sr.Circle(6e-3), sr.Circle(6.1e-3), sr.Annulus(6.1e-3, 5e-3)
    checked_scene("here", sr.Scene(0.1, thin, **own))
    for scene in (
        sr.Scene(0.1, thin, section_at_end=thick, **own),
        sr.Scene(0.1, hollow, **own),
        sr.Scene(segments=(sr.Segment(0.05, thin), sr.Segment(0.05, thick)), **own),
    ):
        with pytest.raises(ValueError, match=r"contacts\[0\].radius = 0.006: .* 0.0061 \[m\]"):
            checked_scene("here", scene)


def test_an_obstacle_of_ones_own_has_no_form_in_a_file(tmp_path):
    class Floor(sr.AbstractObstacle):
        height: float = -0.1

        def distance(self, p):
            return p[0] - self.height

    scene = dataclasses.replace(sr.hybrid_robot(), contacts=(sr.Contact(Floor(), 1e3),))
    checked_scene("here", scene)
    with pytest.raises(sr.SceneError, match=r"contacts\[0\]: a Floor has no form"):
        sr.save_scene(scene, tmp_path / "a.toml")
