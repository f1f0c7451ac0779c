"""The command line with obstacles: their forces in logs, in JSON and in plots."""

# ruff: noqa: F811 - pytest knows fixtures by their names

import json
from pathlib import Path

import numpy as np
import pytest
from command_line import in_a_directory_of_its_own, run  # noqa: F401

import softrod_jax as sr
from calibration import load_recording
from calibration.data.recording import RecordingError
from calibration.report.log_plot import log_figure

# A wall presses the rod from the beginning on.
PRESSED = """
[rod]
length = 0.1
section = { shape = "circle", radius = 6e-3 }
young_modulus = 1e5
poisson_ratio = 0.45
density = 1000.0
bending_damping = 1e-4
inextensible = true
plane = "xz"
[[contacts]]
shape = "plane"
name = "wall"
point = [-5.9e-3, 0.0, 0.0]
normal = [1.0, 0.0, 0.0]
stiffness = 1e3
[[contacts]]
shape = "sphere"
center = [0.2, 0.0, 0.0]
radius = 0.05
stiffness = 1e3
"""


@pytest.fixture
def written(capsys):
    """What `softrod simulate` says of it, and the log."""
    Path("pressed.toml").write_text(PRESSED)
    argv = ["simulate", "pressed.toml", "--dt", "0.01", "--duration", "0.03", "--intervals", "6"]
    status, out, err = run(capsys, *argv, "--json", "--out", "a.csv")
    assert status == 0, err
    header, *rows = Path("a.csv").read_text().splitlines()
    return json.loads(out), header.split(","), [[float(x) for x in row.split(",")] for row in rows]


def test_forces_are_in_the_log_and_in_json(written):
    content, header, rows = written
    forces = [f"{name}_f{axis}_N" for name in ("wall", "contact2") for axis in "xyz"]
    assert header == ["t_s", "tip_x_m", "tip_y_m", "tip_z_m", *forces]
    assert list(content["contact_force"]) == ["wall", "contact2"]
    wall = np.array(content["contact_force"]["wall"])
    np.testing.assert_array_equal(wall, np.array(rows)[:, 4:7])
    # At first all of the rod is 0.1 mm deep in the wall: k d L. Then it is pushed out.
    np.testing.assert_allclose(wall[0], [1e3 * 1e-4 * 0.1, 0, 0], rtol=1e-9, atol=1e-15)
    assert np.all(np.diff(wall[:, 0]) < 0) and not np.any(content["contact_force"]["contact2"])


def test_the_log_is_read_back_and_plotted(written, capsys):
    _, header, rows = written
    tip = np.array(rows)[:, 1:4]
    scene = sr.load_scene("pressed.toml")
    recording = load_recording("a.csv", scene)
    for log in (recording, load_recording("a.csv")):
        np.testing.assert_array_equal(log.tip_positions, tip)
    with pytest.raises(RecordingError, match="column 5 is 'wall_fx_N', one too many"):
        load_recording("a.csv", sr.Scene(0.1, sr.Circle(6e-3), 1e5, 0.45, 1e3))
    pytest.importorskip("matplotlib")
    motion = sr.simulate(scene, 0.01, steps=3, method=sr.Collocation(6))
    last = log_figure(recording, scene, motion).axes[3]
    assert last.get_ylabel() == "force [N]"
    names = {line.get_label(): np.asarray(line.get_ydata()) for line in last.lines}
    assert list(names) == ["wall", "contact2"]
    np.testing.assert_allclose(names["wall"], np.array(rows)[:, 4], rtol=0, atol=1e-6)
    assert len(log_figure(recording).axes) == 4  # without a motion: the tip, and its path
