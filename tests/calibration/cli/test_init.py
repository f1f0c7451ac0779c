"""`softrod init`: every template loads, solves, and says what to do next."""

# ruff: noqa: F811 - pytest knows fixtures by their names

from pathlib import Path

import numpy as np
import pytest
from command_line import in_a_directory_of_its_own, run  # noqa: F401

import softrod_jax as sr
from calibration.cli.init import TEMPLATES
from softrod_jax.scene.inputs import KINDS


@pytest.mark.parametrize("name", TEMPLATES)
def test_a_template_loads_and_solves(capsys, name):
    status, out, err = run(capsys, "init", name, "--out", "own.toml")
    assert (status, err) == (0, "")
    assert out.splitlines()[-1] == "next: softrod plot own.toml"
    scene = sr.load_scene("own.toml")
    inputs = {kind.name: np.zeros(kind.count(scene)) for kind in KINDS if kind.count(scene)}
    solution = sr.solve_static(scene, **inputs, method=sr.Collocation(4))
    assert float(solution.stats["error"]) < 1e-4 and bool(solution.stats["stable"])
    assert 0.5 < np.linalg.norm(solution.tip_position) / float(scene.length) < 1.05
    # Whoever reads the file finds out what each number is.
    lines = {x for x in Path("own.toml").read_text().splitlines() if "=" in x}
    assert sum("#" in line for line in lines) > 0.5 * len(lines)


def test_a_needle_without_its_force_is_the_arc_that_it_was_bent_to(capsys):
    """Straight for 0.12 m, then 0.03 m with 8 / m about y."""
    run(capsys, "init", "needle")
    text = Path("needle.toml").read_text().replace("[-0.1, 0.0, 0.0]", "[0.0, 0.0, 1e-12]")
    Path("needle.toml").write_text(text)
    tip = sr.solve_static(sr.load_scene("needle.toml"), method=sr.Collocation(4)).tip_position
    angle = 8 * 0.03
    expected = np.array([1 - np.cos(angle), 0, 0.96 + np.sin(angle)]) / 8
    np.testing.assert_allclose(tip, expected, rtol=0, atol=1e-7)


def test_a_finger_is_the_arc_that_its_pressure_bends(capsys):
    """By P A x / E I, away from the chamber, as far as that goes; and straight beyond."""
    run(capsys, "init", "finger")
    text = Path("finger.toml").read_text().replace("9.81]", "0.0]")
    Path("finger.toml").write_text(text)
    scene, P = sr.load_scene("finger.toml"), 3e4
    tip = sr.solve_static(scene, pressures=[P], method=sr.Collocation(4)).tip_position
    u = P * 6e-5 * 4e-3 / (3e5 * np.pi * 8e-3**4 / 4)
    angle = 0.09 * u
    expected = [-(1 - np.cos(angle)) / u - 0.01 * np.sin(angle), 0.0]
    expected += [np.sin(angle) / u + 0.01 * np.cos(angle)]
    np.testing.assert_allclose(tip, expected, rtol=0, atol=1e-7)


def test_nothing_is_overwritten_silently(capsys):
    Path("robot.toml").write_text("mine")
    status, out, err = run(capsys, "init")
    assert (status, out) == (2, "") and "robot.toml: is there already" in err and "--force" in err
    assert Path("robot.toml").read_text() == "mine"
    status, _, _ = run(capsys, "init", "--force")
    assert status == 0 and sr.load_scene("robot.toml").chambers is not None


def test_an_unknown_template_is_told_with_those_that_there_are(capsys):
    status, _, err = run(capsys, "init", "tentakle")
    assert status == 2 and "tentakle" in err and "tentacle" in err
