"""The command line with scenes of segments, loads and markers along the rod."""

# ruff: noqa: F811 - pytest knows fixtures by their names

import json
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest
from command_line import in_a_directory_of_its_own, run  # noqa: F401

import softrod_jax as sr
from calibration import load_recording, write_log
from calibration.data.recording import Recording, RecordingError
from calibration.experiment.beginning import _linear_deflection
from calibration.experiment.bulk import bulk
from calibration.parameters.catalogue import catalogue

# A force at 60 mm bends the rod up to there, and what follows is straight.
LOADED = """
[rod]
young_modulus = 1.0e5
poisson_ratio = 0.45
density = 1000.0
inextensible = true
plane = "xz"
[[segments]]
length = 0.06
section = { shape = "circle", radius = 5e-3 }
intervals = 4
[[segments]]
length = 0.04
section = { shape = "circle", radius = 3e-3 }
intervals = 2
[[loads]]
at = 0.06
force = [1e-4, 0.0, 0.0]
[[markers]]
name = "elbow"
at = 0.06
[[markers]]
name = "side"
at = 0.03
offset = [5e-3, 0.0, 0.0]
"""


def test_markers_of_an_equilibrium(capsys):
    Path("loaded.toml").write_text(LOADED)
    status, out, _ = run(capsys, "solve", "loaded.toml")
    content = json.loads(out)
    assert status == 0 and list(content["markers"]) == ["tip", "elbow", "side"]
    elbow, side, tip = (content["markers"][name] for name in ("elbow", "side", "tip"))
    # F L^3 / 3 EI, F L^2 / 2 EI, and x^2 (3 L - x) F / 6 EI between.
    F, EI, L = 1e-4, 1e5 * np.pi * 5e-3**4 / 4, 0.06
    small = dict(rtol=2e-3, atol=0)
    np.testing.assert_allclose(elbow["position"][0], F * L**3 / (3 * EI), **small)
    np.testing.assert_allclose(2 * elbow["quaternion"][2], F * L**2 / (2 * EI), **small)
    np.testing.assert_allclose(side["position"][0] - 5e-3, F * 0.03**2 * 0.15 / (6 * EI), **small)
    np.testing.assert_allclose(tip["quaternion"], elbow["quaternion"], rtol=0, atol=1e-9)
    slope = F * L**2 / (2 * EI)
    np.testing.assert_allclose(
        tip["position"][0] - elbow["position"][0], 0.04 * np.sin(slope), **small
    )


def test_markers_of_a_motion_are_columns_of_its_log(capsys):
    Path("loaded.toml").write_text(LOADED)
    argv = ["simulate", "loaded.toml", "--dt", "1e-3", "--duration", "3e-3", "--out", "a.csv"]
    status, _, err = run(capsys, *argv)
    assert status == 0, err
    header, *rows = Path("a.csv").read_text().splitlines()
    names = [f"{name}_{axis}_m" for name in ("tip", "elbow", "side") for axis in "xyz"]
    assert header.split(",") == ["t_s", *names] and len(rows) == 4
    first = [float(x) for x in rows[0].split(",")[4:]]
    np.testing.assert_allclose(first, [0, 0, 0.06, 5e-3, 0, 0.03], rtol=0, atol=1e-15)
    scene = sr.load_scene("loaded.toml")
    moved = np.asarray(load_recording("a.csv", scene, need_tip=False).tip_positions)
    written = [[float(x) for x in row.split(",")[1:4]] for row in rows]
    np.testing.assert_array_equal(moved, written)
    np.testing.assert_array_equal(load_recording("a.csv").tip_positions, moved)


def test_columns_of_markers_that_the_scene_lacks_are_refused():
    times, tip = np.arange(9) * 0.01, np.tile([0.0, 0.0, 0.1], (9, 1))
    tip[:, 0] = 1e-3 * np.arange(9)
    write_log("a.csv", times, tip_positions=tip, markers={"p1": tip, "tau": tip})
    np.testing.assert_array_equal(load_recording("a.csv").tip_positions, tip)
    robot = sr.Scene(0.1, sr.Circle(5e-3), 1e5, 0.45, 1e3)
    with pytest.raises(RecordingError, match="column 5 is 'p1_x_m', one too many"):
        load_recording("a.csv", robot)


def test_a_picture_of_a_wider_scene(capsys):
    pytest.importorskip("matplotlib")
    Path("loaded.toml").write_text(LOADED)
    status, out, _ = run(capsys, "plot", "loaded.toml", "--intervals", "6")
    assert status == 0 and Path("loaded.png").stat().st_size > 1e4


# What estimates go by


def test_a_uniform_rod_is_its_own_bulk():
    robot = sr.hybrid_robot()
    area, I = np.pi * 6e-3**2, np.pi * 6e-3**4 / 4
    found = bulk(robot)
    np.testing.assert_allclose(found.mass, 1070 * area * 0.1, rtol=1e-14)
    np.testing.assert_allclose(found.EI, [5e4 * I] * 2, rtol=1e-14)
    np.testing.assert_allclose([found.EA, found.area], [5e4 * area, area], rtol=1e-14)
    halves = [sr.Segment(x, robot.section) for x in (0.03, 0.07)]
    parts = dict(young_modulus=5e4, poisson_ratio=0.49, density=1070.0)
    for one, other in zip(bulk(sr.Scene(segments=halves, **parts)), found, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-13)


def test_bulk_of_segments():
    """Two segments, the second measured; a cone's mass and stretch."""
    stiffness = sr.Stiffness([2e-5, 4e-5], 1e-5, 5.0, [2.0, 2.0])
    second = sr.Segment(0.05, sr.Circle(4e-3), stiffness=stiffness, linear_density=0.1)
    first = sr.Segment(0.05, sr.Circle(6e-3))
    scene = sr.Scene(segments=[first, second], young_modulus=1e5, poisson_ratio=0.4, density=1000.0)
    found, EI = bulk(scene), 1e5 * np.pi * 6e-3**4 / 4
    np.testing.assert_allclose(found.mass, 0.05 * (1000 * np.pi * 36e-6 + 0.1), rtol=1e-12)
    # The first half has 7/8 of the bending.
    np.testing.assert_allclose(1 / found.EI, 7 / 8 / EI + 1 / 8 / np.array([2e-5, 4e-5]))
    np.testing.assert_allclose(1 / found.EA, 0.5 / (1e5 * np.pi * 36e-6) + 0.5 / 5.0)
    cone = sr.Scene(0.1, sr.Circle(6e-3), 1e5, 0.4, 1e3, section_at_end=sr.Circle(3e-3))
    np.testing.assert_allclose(bulk(cone).area, np.pi * (36 + 18 + 9) / 3 * 1e-6, rtol=1e-12)
    np.testing.assert_allclose(bulk(cone).EA, 1e5 * np.pi * 18e-6, rtol=2e-4)


def test_linear_deflection_of_a_segmented_rod(wrong_types):
    """As of the same rod in one piece."""
    robot = sr.hybrid_robot(gravity=jnp.array([1.0, 0.0, 9.81]))
    segments = [sr.Segment(jnp.array(x), robot.section) for x in (0.04, 0.06)]
    parts = {
        name: getattr(robot, name)
        for name in ("young_modulus", "poisson_ratio", "density", "gravity", "tendons")
    }
    whole, both = sr.Scene(0.1, robot.section, **parts), sr.Scene(segments=segments, **parts)
    recording = Recording(np.zeros(1), np.array([[0.1, 0.0, 0.0]]), None, np.zeros((1, 3)))
    np.testing.assert_allclose(
        _linear_deflection(both, recording), _linear_deflection(whole, recording), rtol=1e-12
    )
    known, _ = catalogue(both)
    assert known["tendon_offset"].allowed(type("S", (), {"scene": both}))
    far = sr.Scene(segments=segments, **{**parts, "tendons": sr.Tendons([[7e-3, 0.0]])})
    assert not known["tendon_offset"].allowed(type("S", (), {"scene": far}))


def test_the_force_of_an_obstacle(capsys):
    """A soft wall that reaches the thick segment only: stiffness times depth times its length."""
    wall = '[[contacts]]\nname = "wall"\nshape = "plane"\npoint = [-4.9e-3, 0.0, 0.0]\n'
    wall += "normal = [1.0, 0.0, 0.0]\nstiffness = 1e-2\n"
    ball = (
        '[[contacts]]\nshape = "sphere"\ncenter = [1.0, 0.0, 0.0]\nradius = 0.5\nstiffness = 1.0\n'
    )
    Path("touched.toml").write_text(LOADED.replace("1e-4, 0.0", "0.0, 0.0") + wall + ball)
    status, out, _ = run(capsys, "solve", "touched.toml")
    forces = json.loads(out)["contact_force"]
    assert status == 0 and set(forces) == {"wall", "contact2"}
    np.testing.assert_allclose(forces["wall"], [1e-2 * 1e-4 * 0.06, 0, 0], rtol=1e-3, atol=1e-15)
    assert forces["contact2"] == [0.0, 0.0, 0.0]
