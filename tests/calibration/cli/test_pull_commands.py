"""The command line with tendons that are driven by their length."""

# ruff: noqa: F811 - pytest knows fixtures by their names

import json
from pathlib import Path

import numpy as np
import pytest
from command_line import asked, in_a_directory_of_its_own, run  # noqa: F401

import softrod_jax as sr
from calibration import Recording, load_recording, write_log

OFFSET, LENGTH, E = 4e-3, 0.1, 1e5
EI = E * np.pi * 5e-3**4 / 4
# The second of three has a load cell.
PULLED = f"""
[rod]
length = {LENGTH}
section = {{ shape = "circle", radius = 5e-3 }}
young_modulus = {E}
poisson_ratio = 0.45
density = 1000.0
bending_damping = 1e-5
inextensible = true
plane = "xz"
[[tendons]]
offset = [{OFFSET}, 0.0]
control = "length"
[[tendons]]
offset = [{-OFFSET}, 0.0]
[[tendons]]
offset = [{-OFFSET}, 0.0]
control = "length"
"""


@pytest.fixture(autouse=True)
def pulled(in_a_directory_of_its_own):
    Path("pulled.toml").write_text(PULLED)


def circle(pull):
    """The tip of a rod that an inextensible tendon bends to a circle."""
    angle = pull / OFFSET
    return LENGTH / angle * np.array([1 - np.cos(angle), 0.0, np.sin(angle)])


def test_solve(capsys):
    """One pulls, the load cell says what the next adds, and the last is slack."""
    argv = ["solve", "pulled.toml", "--tension", "0.1", "--pull", "2e-3", "-3e-3", "--json"]
    status, out, err = run(capsys, *argv)
    content = json.loads(out)
    assert (status, err, content["result"]) == (0, "", "successful")
    np.testing.assert_allclose(content["tip_position"], circle(2e-3), rtol=0, atol=1e-9)
    first = EI * 2e-3 / OFFSET**2 / LENGTH + 0.1
    np.testing.assert_allclose(content["tensions"], [first, 0.1, 0.0], rtol=1e-6, atol=1e-12)


def test_a_tendon_that_is_not_pulled_holds(capsys):
    """Without --pull it is there, and keeps its length against the other one."""
    status, out, _ = run(capsys, "solve", "pulled.toml", "--tension", "0.1")
    content = json.loads(out)
    assert status == 0
    np.testing.assert_allclose(content["tip_position"], [0, 0, LENGTH], rtol=0, atol=1e-9)
    # The third is as long as the second, and they share what holds.
    first, second, third = content["tensions"]
    np.testing.assert_allclose([first - third, second], 0.1, rtol=1e-6)
    assert third >= 0


@pytest.mark.parametrize(
    "argv, words",
    [
        ("--pull 1e-3", "--pull: 1 given, and the scene has 2 tendons driven by length; give one"),
        ("--tension 1 2", "--tension: 2 given, and the scene has 1 tendon driven by tension; give"),
        ("--tension -1 --pull 0 0", "--tension -1: a tendon can only pull; every tension is"),
        ("--pull x 0", "'x' is not a finite number"),
    ],
)
def test_wrong_counts(capsys, asked, argv, words):
    status, out, err = run(capsys, "solve", "pulled.toml", *argv.split())
    assert (status, out) == (2, "") and words in err


def test_a_scene_without_such_tendons(capsys, asked):
    status, _, err = run(capsys, "solve", "robot.toml", "--pull", "1e-3")
    assert status == 2
    assert "--pull: the scene has no tendons driven by length; leave it out, or add [[tend" in err
    assert 'control = "length"' in err
    run(capsys, "solve", "robot.toml")
    assert asked.static.pulls is None


def test_inputs_of_a_log_or_of_the_command_line(capsys, asked):
    times = np.array([0.0, 0.1, 0.2])
    pulls = np.stack([1e-2 * times, 0 * times], axis=1)
    write_log("in.csv", times, 0.1 + 0 * times[:, None], pulls=pulls)
    argv = ["simulate", "pulled.toml", "--dt", "0.05", "--log", "in.csv"]
    status, _, err = run(capsys, *argv, "--pull", "0", "0", "--tension", "0")
    assert status == 2 and "leave --tension and --pull out" in err
    status, _, err = run(capsys, *argv, "--out", "out.csv", "--from-static")
    assert status == 0, err
    np.testing.assert_allclose(asked.motion.pulls[:, 0], [5e-4, 1e-3, 1.5e-3, 2e-3], atol=1e-15)
    np.testing.assert_allclose(asked.motion.tensions, 0.1)
    np.testing.assert_array_equal(asked.static.pulls, [0.0, 0.0])
    written = load_recording("out.csv", sr.load_scene("pulled.toml"))
    np.testing.assert_allclose(written.pulls[:, 0], 1e-2 * written.times, atol=1e-15)
    run(capsys, "simulate", "pulled.toml", "--dt", "0.1", "--duration", "0.2", "--out", "out.csv")
    assert asked.motion.tensions is None and not asked.motion.pulls.any()
    header = Path("out.csv").read_text().splitlines()[0]
    assert header == "t_s,tau1_N,pull1_m,pull2_m,tip_x_m,tip_y_m,tip_z_m"


def test_simulate_writes_a_log_that_it_reads_back(capsys):
    argv = ["simulate", "pulled.toml", "--dt", "0.02", "--json", "--intervals", "4"]
    more = ["--duration", "0.06", "--pull", "1e-3", "-2e-3", "--from-static"]
    status, out, err = run(capsys, *argv, *more, "--out", "a.csv")
    content = json.loads(out)
    assert status == 0, err
    # It is in equilibrium, and stays there.
    np.testing.assert_allclose(content["tip_position"][-1], circle(1e-3), rtol=0, atol=1e-7)
    tension = EI * 1e-3 / OFFSET**2 / LENGTH
    np.testing.assert_allclose(content["tensions"], [[tension, 0, 0]] * 4, rtol=1e-4, atol=1e-9)
    status, again, err = run(capsys, *argv, "--log", "a.csv", "--from-static")
    again = json.loads(again)
    assert status == 0 and again.keys() == content.keys()
    for name in ("tip_position", "tensions"):
        np.testing.assert_allclose(again[name], content[name], rtol=1e-9, atol=1e-11)


def test_pictures_of_pulls(capsys):
    pytest.importorskip("matplotlib")
    status, _, err = run(capsys, "plot", "pulled.toml", "--pull", "2e-3", "-3e-3")
    assert status == 0 and Path("pulled.png").stat().st_size > 1e4, err
    from calibration.report.log_plot import log_figure
    from calibration.report.plots import data_axes

    times = np.arange(20) / 50
    tip = np.stack([0.01 * times, 0 * times, 0.1 - 0.01 * times], axis=1)
    pulls = 1e-3 * np.stack([times, -times], axis=1)
    recording = Recording(times, None, None, tip, pulls=pulls)
    row = log_figure(recording).axes[3]
    assert row.get_ylabel() == "pull [mm]"
    np.testing.assert_allclose(row.lines[1].get_ydata(), -times, atol=1e-15)
    from matplotlib.figure import Figure

    inputs, seen = Figure().subplots(1, 2)
    data_axes(inputs, seen, recording, (0.0, 0.4))
    assert [line.get_label() for line in inputs.lines] == ["pull 1 [mm]", "pull 2 [mm]"]
