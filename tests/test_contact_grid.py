"""Distances on a grid: against the obstacles that they are of, derivatives, files and meshes."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from test_contact import METHOD, R, rod, wall

import softrod_jax as sr
from softrod_jax.scene.scene import as_arrays

BALL = sr.Sphere(jnp.array([0.023, 0.004, 0.07]), 0.02)
BOX = [-0.003, -0.02, 0.045], [0.012, 0.03, 0.1]
PLANE = sr.Plane(jnp.array([0.01, 0.0, 0.05]), jnp.array([-3.0, 1.0, 0.5]))
TUBE = sr.Tube(jnp.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.1]]), 0.012)
RNG = np.random.default_rng(0)


def places(count, margin=0.0):
    return RNG.uniform(np.array(BOX[0]) - margin, np.array(BOX[1]) + margin, (count, 3))


def both(obstacle, p):
    return jax.jit(jax.vmap(jax.value_and_grad(obstacle.distance)))(p)


def sampled(obstacle, spacing, box=BOX):
    return sr.sample_distance(obstacle, *box, spacing)


@pytest.mark.parametrize("obstacle", [BALL, TUBE], ids=["ball", "tube"])
def test_distance_and_slope_are_of_fourth_and_third_order(obstacle):
    p = places(300)
    # Close to the axis of a tube, and to the middle of a ball, no distance is smooth.
    p = p[np.abs(jax.vmap(obstacle.distance)(p)) < 5e-3]
    exact = both(obstacle, p)
    errors = []
    for spacing in (2e-3, 1e-3):
        found = both(sampled(obstacle, spacing), p)
        errors.append([np.abs(a - b).max() for a, b in zip(found, exact, strict=True)])
    assert errors[1][0] < 2e-6 and errors[1][1] < 1e-3
    ratio = np.divide(*errors)
    assert ratio[0] > 0.8 * 2**4 and ratio[1] > 0.8 * 2**3


def test_a_plane_is_exact_also_outside_of_the_grid():
    p = places(100, margin=0.05)
    found, exact = (both(x, p) for x in (sampled(PLANE, 5e-3), PLANE))
    for a, b in zip(found, exact, strict=True):
        np.testing.assert_allclose(a, b, rtol=0, atol=1e-12)


def test_it_goes_on_outside_without_a_jump():
    """The slope is continuous at faces, edges and corners, and beside a body nothing is inside."""
    grid = sampled(BALL, 2e-3, ([0.0, -0.02, 0.045], [0.046, 0.028, 0.095]))
    middle, half = np.array([0.023, 0.004, 0.07]), np.array([0.023, 0.024, 0.025])
    for direction in ([1, 0.3, 0.2], [1, 1, 0.3], [1, 1, 1], [-1, 1, -1.0]):
        edge = middle + half * np.array(direction)
        outwards = 1e-7 * np.sign(direction)
        within, beyond = both(grid, np.stack([edge - outwards, edge + outwards]))[1]
        np.testing.assert_allclose(within, beyond, rtol=0, atol=1e-4)
        far = middle + np.outer([1.5, 3.0, 10.0], half * np.array(direction))
        distance, exact = both(grid, far)[0], both(BALL, far)[0]
        assert np.all(distance > 0.01) and np.all(distance < 1.5 * exact)


def test_curvature_does_not_jump_within():
    """From cell to cell: what Newton's method takes."""
    grid = sampled(BALL, 2e-3)
    between = np.asarray(grid.origin) + 2e-3 * np.array([5.0, 7.0, 9.0])
    bend = jax.vmap(jax.hessian(grid.distance))(between + 1e-9 * np.array([[-1.0], [1.0]]))
    np.testing.assert_allclose(bend[0], bend[1], rtol=0, atol=1e-4)
    assert np.abs(bend[0]).max() > 10


def pressed(obstacle, **changes):
    """Between a wall and it."""
    load = sr.TipLoad(force=np.array([0.0, 0.002, -0.001]))
    contact = sr.Contact(obstacle, 5e3, name="ball")
    return rod(wall(-0.004), contact, tip_load=load, **changes)


def test_equilibrium_and_force_are_those_of_the_obstacle():
    exact = sr.solve_static(pressed(BALL), method=METHOD)
    assert np.linalg.norm(exact.contact_force["ball"]) > 5e-3
    errors = []
    for spacing in (4e-3, 2e-3):
        solution = sr.solve_static(pressed(sampled(BALL, spacing)), method=METHOD)
        parts = lambda s: np.concatenate([s.tip_position / 0.1, s.contact_force["ball"] / 0.01])
        errors.append(np.abs(parts(solution) - parts(exact)).max())
    assert errors[1] < 1e-4 and errors[0] / errors[1] > 8


@pytest.mark.long
def test_derivatives():
    """By its values and its place: forward, reverse and central differences."""
    scene = pressed(sampled(BALL, 4e-3))
    grid = scene.contacts[1].obstacle

    def found(x):
        origin = grid.origin + 1e-3 * jnp.stack([x[0], x[1], 0.0 * x[0]])
        values, spacing = grid.values + 1e-3 * x[2], grid.spacing * (1 + 1e-2 * x[3])
        changed = eqx.tree_at(
            lambda s: s.contacts[1].obstacle, scene, sr.DistanceGrid(values, origin, spacing)
        )
        solution = sr.solve_static(changed, method=METHOD, throw=False)
        return jnp.concatenate([solution.tip_position, solution.contact_force["ball"]])

    at, d = jnp.zeros(4), 1e-3
    forward, reverse = jax.jit(jax.jacfwd(found))(at), jax.jit(jax.jacrev(found))(at)
    size = np.abs(forward).max()
    assert np.all(np.abs(forward).max(axis=0) > 1e-3 * size)
    np.testing.assert_allclose(forward, reverse, rtol=0, atol=1e-9 * size)
    points = jnp.stack([at + s * d * e for e in jnp.eye(4) for s in (1.0, -1.0)])
    values = jax.jit(jax.vmap(found))(points)
    slopes = (values[::2] - values[1::2]).T / (2 * d)
    np.testing.assert_allclose(forward, slopes, rtol=0, atol=1e-4 * size)


def test_a_motion_with_a_grid_that_is_carried():
    """It is that of the ball, which comes, pushes the rod aside and holds it."""
    ball = sr.Sphere([0.032, 0.0, 0.08], 0.02)
    grid = sampled(ball, 2e-3, ([0.002, -0.014, 0.064], [0.024, 0.014, 0.096]))
    poses = np.tile([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0], (8, 1))
    poses[:, 0] = -1e-3 * np.arange(1, 9)
    forces = []
    for obstacle in (ball, grid):
        scene = rod(
            sr.Contact(obstacle, 2e3, damping=1.0, name="ball"), plane="xz", bending_damping=1e-4
        )
        carried = {"ball": (poses[:, :3], poses[:, 3:])}
        motion = sr.simulate(scene, 0.01, contacts=carried, method=METHOD, substeps=1)
        forces.append(motion.contact_forces["ball"])
    assert forces[0][-1, 0] < -1e-3
    np.testing.assert_allclose(forces[1], forces[0], rtol=0, atol=1e-4 * np.abs(forces[0]).max())


def test_what_a_plane_asks_of_it():
    even = sampled(TUBE, 2e-3, ([-0.02, -0.02, 0.0], [0.02, 0.02, 0.1]))
    sr.solve_static(rod(sr.Contact(even, 2e3), plane="xz"), method=METHOD)
    for grid in (
        dataclasses.replace(even, origin=even.origin + jnp.array([0.0, 1e-4, 0.0])),
        dataclasses.replace(even, values=even.values.at[3, 4, 5].add(1e-4)),
    ):
        with pytest.raises(ValueError, match=r"contacts\[0\].values = .* both sides"):
            sr.solve_static(rod(sr.Contact(grid, 2e3), plane="xz"), method=METHOD)


def test_files_and_scenes_with_it(tmp_path):
    scene = as_arrays(sr.Scene(0.1, sr.Circle(R), 5e4, 0.49, 1070.0, contacts=(
        wall(-0.1), sr.Contact(sampled(BALL, 4e-3), 2e3, friction=0.2, name="heart"))))  # fmt: skip
    (tmp_path / "own").mkdir()
    sr.save_scene(scene, tmp_path / "own" / "a.toml")
    assert 'shape = "grid"' in (tmp_path / "own" / "a.toml").read_text()
    again = sr.load_scene(tmp_path / "own" / "a.toml")
    assert jax.tree.structure(scene) == jax.tree.structure(again)
    assert all(map(np.array_equal, jax.tree.leaves(scene), jax.tree.leaves(again)))
    grid = sr.load_grid(tmp_path / "own" / "a_heart.npz")
    np.testing.assert_array_equal(grid.values, scene.contacts[1].obstacle.values)
    assert "DistanceGrid(values = -" in repr(scene) and "shape (9, 18, 19)" in repr(scene)


@pytest.mark.parametrize(
    "arrays, expected",
    [
        (None, "No such file"),
        ({"values": np.ones((6, 6, 6)), "origin": np.zeros(3)}, "spacing is missing"),
        ({"values": np.ones((6, 5, 6)), "origin": np.zeros(3), "spacing": 1.0}, "6 x 6 x 6"),
        ({"values": np.ones((6, 6, 6)), "origin": np.zeros(2), "spacing": 1.0}, "3 numbers"),
        ({"values": np.ones((6, 6, 6)), "origin": np.zeros(3), "spacing": 0.0}, "above 0"),
        ({"values": np.full((6, 6, 6), np.nan), "origin": np.zeros(3), "spacing": 1.0}, "cannot"),
        ({"values": np.full((6, 6, 6), {}), "origin": np.zeros(3), "spacing": 1.0}, "no .npz"),
        (
            {"values": 10.0 * np.arange(216).reshape(6, 6, 6), "origin": [0, 0, 0], "spacing": 1.0},
            "contacts[0].spacing = 1.0: along x values change by more than 2 of it",
        ),
    ],
)
def test_files_that_are_refused(tmp_path, arrays, expected):
    text = '[rod]\nlength = 0.1\nsection = { shape = "circle", radius = 6e-3 }\n'
    text += "young_modulus = 5e4\npoisson_ratio = 0.49\ndensity = 1070.0\n"
    text += '[[contacts]]\nshape = "grid"\nfile = "g.npz"\nstiffness = 1e3\n'
    (tmp_path / "a.toml").write_text(text)
    if arrays is not None:
        np.savez(tmp_path / "g.npz", **arrays)
    with pytest.raises(sr.SceneError) as error:
        sr.load_scene(tmp_path / "a.toml")
    assert expected in str(error.value) and "contacts[0]" in str(error.value)


def test_boxes_that_are_refused():
    with pytest.raises(ValueError, match="a box from"):
        sr.sample_distance(BALL, BOX[1], BOX[0], 1e-3)
    with pytest.raises(ValueError, match="larger spacing"):
        sr.sample_distance(BALL, *BOX, 1e-6)
    with pytest.raises(ValueError, match="above 0"):
        sr.sample_distance(BALL, *BOX, 0.0)
