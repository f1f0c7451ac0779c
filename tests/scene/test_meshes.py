"""Distances from meshes: against closed forms of a box and a ball, and what is refused."""

import json
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from command_line import CHAMBER, in_a_directory_of_its_own, run  # noqa: F401

import softrod_jax as sr
from softrod_jax.scene.triangles import Triangles, signed_distances

trimesh = pytest.importorskip("trimesh")
HALF = np.array([0.02, 0.03, 0.01])


def of_a_box(p):
    """Its signed distance."""
    q = np.abs(p) - HALF
    return np.linalg.norm(np.maximum(q, 0), axis=-1) + np.minimum(q.max(-1), 0)


@pytest.mark.parametrize("refined", [0, 3])
def test_signed_distances_of_a_box(refined):
    """Faces, edges and corners, inside and outside; and a notch, where edges are hollow."""
    box = trimesh.creation.box(2 * HALF)
    for _ in range(refined):
        box = box.subdivide()
    points = np.random.default_rng(0).uniform(-0.06, 0.06, (500, 3))
    found = signed_distances(Triangles(box.vertices, box.faces), points)
    np.testing.assert_allclose(found, of_a_box(points), rtol=0, atol=1e-15)


@pytest.mark.parametrize("inside", [False, True])
def test_a_ball(inside):
    """Its triangles are within the ball by their sagitta, and the grid rounds their edges."""
    ball = trimesh.creation.icosphere(subdivisions=4, radius=20.0)
    ball.apply_translation([30.0, 5.0, 70.0])
    grid = sr.grid_of_mesh(ball, 3e-3, margin=7e-3, scale=1e-3, inside=inside)
    exact = sr.Sphere(jnp.array([0.03, 0.005, 0.07]), 0.02)
    direction = np.random.default_rng(0).normal(size=(200, 3))
    direction /= np.linalg.norm(direction, axis=-1, keepdims=True)
    for radius in (0.014, 0.02, 0.026):
        p = np.array([0.03, 0.005, 0.07]) + radius * direction
        found = jax.vmap(grid.distance)(p) * (-1 if inside else 1)
        np.testing.assert_allclose(found, jax.vmap(exact.distance)(p), rtol=0, atol=1.5e-4)


def test_what_is_refused(tmp_path):
    ball = trimesh.creation.icosphere(subdivisions=1)
    open_one = trimesh.Trimesh(ball.vertices, ball.faces[:-1])
    with pytest.raises(ValueError, match="not a closed surface"):
        sr.grid_of_mesh(open_one, 0.1, margin=0.1)
    with pytest.raises(ValueError, match="margin = -1"):
        sr.grid_of_mesh(ball, 0.1, margin=-1)
    (tmp_path / "a.stl").write_text("no mesh")
    with pytest.raises(ValueError, match=r"a.stl: "):
        sr.grid_of_mesh(tmp_path / "a.stl", 0.1, margin=0.1)
    # Faces that are seen from inside are turned round.
    turned = trimesh.Trimesh(ball.vertices, ball.faces[:, ::-1])
    assert sr.grid_of_mesh(turned, 0.3, margin=0.1).values[0, 0, 0] > 0


def test_the_command(capsys):
    ball = trimesh.creation.icosphere(subdivisions=3, radius=20.0)
    ball.apply_translation([50.0, 0.0, 60.0])
    ball.export("ball.stl")
    argv = ("--spacing", "4e-3", "--margin", "8e-3", "--scale", "1e-3")
    status, out, err = run(capsys, "grid", "ball.stl", *argv)
    assert status == 0, err
    assert "ball.npz is written: 19 x 19 x 19 points, x 14 to 86" in out
    text = '[[contacts]]\nshape = "grid"\nfile = "ball.npz"\nstiffness = 2e3\nname = "ball"\n'
    rod = CHAMBER.split("[[chambers]]")[0] + "gravity = [9.0, 0.0, 0.0]\n"
    Path("a.toml").write_text(rod + text)
    status, out, err = run(capsys, "solve", "a.toml", "--json", "--intervals", "6")
    assert status == 0, err
    assert json.loads(out)["contact_force"]["ball"][0] < -1e-4
    assert run(capsys, "grid", "ball.stl", *argv, "--out", "a.txt")[0] == 2
