"""Whether a rod passes through itself: against the closed form of helices."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from command_line import in_a_directory_of_its_own, run  # noqa: F401
from scipy.optimize import minimize_scalar

import softrod_jax as sr

L, R = 0.1, 2e-3
METHOD = sr.Collocation(12)


def coil(radius, pitch, **changes):
    """A rod that is a helix of this radius and pitch at rest."""
    c = pitch / (2 * np.pi)
    bend, twist = np.array([radius, c]) / (radius**2 + c**2)
    own = dict(length=L, section=sr.Circle(R), young_modulus=1e6, poisson_ratio=0.49, density=1e3)
    return sr.Scene(**(own | changes), rest_curvature=[bend, 0.0, twist])


def gap_of_a_helix(radius, pitch):
    """Between neighbouring turns: the least distance of two of its points, less two radii."""
    c = pitch / (2 * np.pi)
    far = lambda angle: np.hypot(2 * radius * np.sin(angle / 2), c * angle)
    return minimize_scalar(far, bounds=(np.pi, 3 * np.pi), method="bounded").fun - 2 * R


@pytest.mark.parametrize("pitch", [5e-3, 3e-3])
def test_turns_of_a_helix(pitch):
    scene = coil(7e-3, pitch)
    solution = sr.solve_static(scene, method=METHOD)
    found = jax.jit(sr.self_distance)(scene, solution)
    known = gap_of_a_helix(7e-3, pitch)
    assert (known < 0) == (pitch == 3e-3)
    np.testing.assert_allclose(found, known, rtol=0, atol=0.02 * R)


def test_a_straight_rod_and_a_taper():
    straight = sr.Scene(L, sr.Circle(R), 1e6, 0.49, 1e3)
    solution = sr.solve_static(straight, method=METHOD)
    found = sr.self_distance(straight, solution)
    assert 0.98 * (np.pi - 2) * R < found < 1.5 * (np.pi - 2) * R
    # Where it is thinner neighbours are compared that are nearer.
    taper = dataclasses.replace(straight, section_at_end=sr.Circle(R / 2))
    assert 0.48 * (np.pi - 2) * R < sr.self_distance(taper, solution) < 0.75 * found


def test_a_motion_and_derivatives():
    """It is that of each time; its slope by the pitch that of the helix, about."""
    scene = coil(7e-3, 3e-3)
    motion = sr.simulate(scene, 0.01, steps=2, method=METHOD)
    gaps = sr.self_distance(scene, motion)
    solution = sr.solve_static(scene, method=METHOD)
    assert gaps.shape == (3,)
    # At rest all the time, as it begins: in its rest shape.
    np.testing.assert_allclose(gaps, sr.self_distance(scene, solution), rtol=0, atol=1e-2 * R)

    def gap(pitch):
        scene = coil(7e-3, 3e-3)
        c = pitch / (2 * np.pi)
        rest = jnp.stack([7e-3, 0.0, c]) / ((7e-3) ** 2 + c**2)
        scene = dataclasses.replace(scene, rest_curvature=rest)
        return sr.self_distance(scene, sr.solve_static(scene, method=METHOD, throw=False))

    slope = jax.jit(jax.grad(gap))(4e-3)
    known = (gap_of_a_helix(7e-3, 4.1e-3) - gap_of_a_helix(7e-3, 3.9e-3)) / 2e-4
    np.testing.assert_allclose(slope, known, rtol=0.1)


def test_the_command_line_says_so(capsys):
    for pitch, said in ((3e-3, True), (8e-3, False)):
        sr.save_scene(coil(7e-3, pitch), "coil.toml")
        status, out, err = run(capsys, "solve", "coil.toml", "--intervals", "12")
        assert status == 0 and ("passes through itself" in err) == said


def test_the_command_line_does_not_look_where_it_cannot_be(capsys, monkeypatch):
    monkeypatch.setattr(sr, "self_distance", lambda *given: pytest.fail("it looks"))
    robot = sr.hybrid_robot(gravity=np.array([-3.0, 0.0, 9.81]))
    sr.save_scene(robot, "robot.toml")
    status, _, err = run(capsys, "solve", "robot.toml", "--intervals", "12")
    assert status == 0, err
