"""Obstacles in pictures and films: their surfaces, and how they are carried."""

import json
import re
from dataclasses import replace
from types import SimpleNamespace

import jax
import numpy as np
import pytest

import softrod_jax as sr

pytest.importorskip("matplotlib")

from test_pictures import LENGTH, motion  # noqa: E402

from softrod_jax import pictures  # noqa: E402
from softrod_jax.pictures.obstacles import carried, surfaces_of  # noqa: E402
from softrod_jax.scene.scene import as_arrays  # noqa: E402

PLACES = np.linspace([0.0, 0.0, 0.0], [0.02, 0.0, LENGTH], 7)
SHAPES = {
    "plane": sr.Plane([0.05, 0.0, 0.0], [-2.0, 0.3, 0.1]),
    "ball": sr.Sphere([0.03, 0.01, 0.0], 0.02),
    "large": sr.Sphere([5.0, 0.0, 0.0], 4.9),
    "tube": sr.Tube([[0.0, 0.0, 0.0], [0.0, 0.0, 0.03], [0.01, 0.0, 0.06]], 0.04),
    "grid": sr.sample_distance(
        sr.Sphere([0.03, 0.01, 0.0], 0.02), [0.0, -0.02, -0.03], [0.06, 0.04, 0.03], 5e-3
    ),
}


class Own(sr.AbstractObstacle):
    def distance(self, p):
        return p[0] + 1.0


def touched(*shapes):
    contacts = [sr.Contact(x, 1e3, name=f"c{i}") for i, x in enumerate(shapes)]
    return replace(sr.hybrid_robot(LENGTH), contacts=contacts)


def moving():
    """An arc of known shape, and forces beside it."""
    known = vars(motion())
    forces = {"c1": np.zeros((5, 3)), "c0": np.full((5, 3), [3.0, 4.0, 0.0])}
    return SimpleNamespace(**known, contact_forces=forces)


@pytest.mark.parametrize("name", SHAPES)
def test_a_surface_is_where_the_distance_is_zero(name):
    scene = as_arrays(touched(SHAPES[name]))
    (surface,) = surfaces_of(scene, PLACES).values()
    points = surface.faces.reshape(-1, 3)
    distance = jax.vmap(scene.contacts[0].obstacle.distance)(points)
    # A circle where two pieces of a tube meet, halfway across both of them, is inside of either.
    half = np.arctan2(0.01, 0.03) / 2
    tolerance = {"tube": 0.04 * (1 - np.cos(half)) + 1e-12, "grid": 1e-9}.get(name, 1e-12)
    np.testing.assert_allclose(distance, 0.0, rtol=0, atol=tolerance)
    away = np.linalg.norm(points[:, None] - PLACES, axis=-1).min()
    assert away < 0.1 and np.ptp(points, axis=0).max() < 2.5 * LENGTH
    assert surface.inside == (name == "tube")


def test_a_tube_goes_on_as_far_as_the_rod():
    (surface,) = surfaces_of(touched(SHAPES["tube"]), PLACES + [0, 0, 0.02]).values()
    assert surface.faces[..., 2].max() > LENGTH


def test_what_has_no_known_surface_is_not_drawn():
    assert list(surfaces_of(touched(Own(), SHAPES["ball"]), PLACES)) == [1]
    assert surfaces_of(sr.hybrid_robot(LENGTH), PLACES) == {}


def test_it_is_carried_as_a_rigid_body():
    (surface,) = surfaces_of(touched(SHAPES["ball"]), PLACES).values()
    half = np.sqrt(0.5)
    turned = carried(surface.faces, np.array([0.0, 0.0, 1.0, half, 0.0, 0.0, half]))
    x, y, z = np.moveaxis(surface.faces, -1, 0)
    np.testing.assert_allclose(turned, np.stack([-y, x, z + 1], -1), atol=1e-15)
    assert surface.faces.shape == (8 * 24, 4, 3)


def test_a_film_has_obstacles_their_courses_and_forces(tmp_path):
    rows = np.tile([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0], (4, 1))
    rows[:, 0] = 1e-3 * np.arange(1, 5)
    scene = touched(SHAPES["plane"], SHAPES["tube"])
    path = pictures.film(scene, moving(), tmp_path / "a.html", contacts={"c0": rows})
    text = path.read_text("utf-8")
    found = json.loads(re.search(r'<script id="content".*?>(.*?)</script>', text, re.DOTALL)[1])
    wall, tube = found["obstacles"]
    assert wall["name"] == "c0" and not wall["inside"] and tube["inside"]
    # Before the first step it is where the scene has it; millimetres.
    assert [x[0] for x in wall["moved"]["by"]] == [0, 1, 2, 3, 4] and tube["moved"] is None
    assert np.shape(wall["faces"]) == (8 * 8, 4) and np.shape(wall["corners"]) == (9 * 9, 3)
    # Squares of 2 * 0.3 lengths by eight.
    corners = np.array(wall["corners"])[np.array(wall["faces"])]
    edges = np.linalg.norm(np.roll(corners, 1, 1) - corners, axis=-1)
    np.testing.assert_allclose(edges, 1e3 * 0.6 * LENGTH / 8, rtol=1e-4)
    push, none = found["inputs"]
    assert none["name"] == "force of c1" and none["curves"] == [[0.0] * 5]
    assert push["name"] == "force of c0" and push["unit"] == "N" and push["curves"] == [[5.0] * 5]


def test_pictures_and_moving_pictures_are_drawn(tmp_path):
    rows = np.tile([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0], (4, 1))
    scene, bare = touched(SHAPES["plane"]), sr.hybrid_robot(LENGTH)
    drawn = [len(pictures.stills(x, motion(), 1).axes[0].collections) for x in (scene, bare)]
    assert drawn[0] == drawn[1] + 1
    for name, change in (("still", 0.0), ("away", 0.03)):
        rows[:, 0] = change
        pictures.animate(scene, motion(), tmp_path / f"{name}.gif", fps=10, contacts={"c0": rows})
    assert (tmp_path / "still.gif").read_bytes() != (tmp_path / "away.gif").read_bytes()


def test_courses_of_another_length_are_refused(tmp_path):
    rows = np.tile([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0], (3, 1))
    with pytest.raises(ValueError, match="film: contacts of 3 steps; the motion has 4"):
        pictures.film(
            touched(SHAPES["plane"]), motion(), tmp_path / "a.html", contacts={"c0": rows}
        )
