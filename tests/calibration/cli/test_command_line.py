"""The command line: results as JSON, and exit statuses."""

# ruff: noqa: F811 - pytest knows fixtures by their names

import json
import re
import sys
from pathlib import Path
from types import SimpleNamespace

import jax
import numpy as np
import pytest
from command_line import asked, in_a_directory_of_its_own, run  # noqa: F401
from PIL import Image

import softrod_jax as sr
from calibration import load_recording, write_log
from calibration.cli import common
from calibration.cli.main import main


def circle(u, v3):
    """Tip and attitude of a rod 0.1 m long, bent to a circle about y, and stretched."""
    tip = v3 / u * np.array([1 - np.cos(0.1 * u), 0, np.sin(0.1 * u)])
    return tip, [np.cos(0.05 * u), 0, np.sin(0.05 * u), 0]


def test_solve(capsys):
    status, out, err = run(capsys, "solve", "chamber.toml", "--pressure", "3e4", "--json")
    content = json.loads(out)
    assert (status, err) == (0, "")
    assert list(content) == [
        "result",
        "tip_position",
        "tip_quaternion",
        "tensions",
        "markers",
        "contact_force",
        "stable",
        "error",
        "intervals",
        "residual",
        "iterations",
    ]
    assert content["result"] == "successful"
    # The cap's thrust P A, r off the axis: u = -P A r / (E I), v3 = 1 + P A / (E A).
    thrust = 3e4 * 7e-6
    tip, turn = circle(
        u=-thrust * 3e-3 / (5e4 * np.pi * 6e-3**4 / 4), v3=1 + thrust / (5e4 * np.pi * 6e-3**2)
    )
    assert np.allclose(content["tip_position"], tip, rtol=0, atol=1e-10)
    assert np.allclose(content["tip_quaternion"], turn, rtol=0, atol=1e-10)
    seen = {"position": content["tip_position"], "quaternion": content["tip_quaternion"]}
    assert content["markers"] == {"tip": seen}
    assert content["stable"] is True and 0 <= content["error"] < 1e-6


def test_solve_says_that_an_equilibrium_is_unstable(capsys):
    """A wire under 3 EI / L^2 along its axis, beyond Euler's load of pi^2 / 4."""
    force = 3 * 5e4 * np.pi * 6e-3**4 / 4 / 0.1**2
    load = f"[tip_load]\nforce = [0.0, 0.0, {-force}]\n"
    Path("column.toml").write_text(Path("chamber.toml").read_text() + load)
    status, out, err = run(capsys, "solve", "column.toml", "--intervals", "6")
    content = json.loads(out)
    assert status == 0 and content["result"] == "successful"
    assert content["stable"] is False and content["intervals"] == 6
    assert "note: this equilibrium is unstable" in err


def test_grid_of_a_solve(capsys, asked):
    argv = ["solve", "robot.toml", "--intervals", "30", "--tolerance", "1e-5"]
    _, out, _ = run(capsys, *argv)
    assert (asked.static.method, asked.static.tolerance) == (sr.Collocation(30), 1e-5)
    assert json.loads(out)["intervals"] == 30
    asked.static_result = int(sr.RESULTS.inaccurate)
    status, out, _ = run(capsys, "solve", "robot.toml")
    assert status == 1
    assert "--intervals" in json.loads(out)["result"] and "--tolerance" in json.loads(out)["result"]
    # Whatever a message names is an option of the command.
    for moving in (False, True):
        for code in sr.RESULTS:
            named = set(re.findall(r"--[a-z-]+", common.reason(code, moving)))
            known = {"--intervals", "--tolerance"} | ({"--dt"} if moving else set())
            assert named <= known
            assert "max_iterations" not in common.reason(code, moving)


def test_grid_of_a_motion(capsys, asked):
    argv = ["simulate", "robot.toml", "--dt", "0.1", "--duration", "0.2", "--from-static"]
    run(capsys, *argv, "--intervals", "7")
    assert asked.static.method == asked.motion.method == sr.Collocation(7)


@pytest.mark.long
def test_solve_with_tendons(capsys):
    status, out, _ = run(capsys, "solve", "robot.toml", "--tension", "0.1", "0", "0")
    assert status == 0
    tip, _ = circle(
        u=0.1 * 4e-3 / (5e4 * np.pi * 6e-3**4 / 4), v3=1 - 0.1 / (5e4 * np.pi * 6e-3**2)
    )
    assert np.allclose(json.loads(out)["tip_position"], tip, rtol=0, atol=1e-10)

    status, out, _ = run(capsys, "solve", "robot.toml", "--tension", "3", "0", "0")
    assert status == 1
    assert "no smooth equilibrium" in json.loads(out)["result"]


def test_solve_without_equilibrium(capsys, asked):
    asked.static_result = 1
    status, out, _ = run(capsys, "solve", "robot.toml", "--tension", "3", "0", "0")
    content = json.loads(out)
    assert status == 1
    assert "no smooth equilibrium" in content["result"]
    assert content["tip_position"] is None
    assert content["tip_quaternion"] is None
    assert content["residual"] is None


def test_simulate_writes_a_log_that_it_reads_back(capsys):
    argv = ["simulate", "chamber.toml", "--dt", "0.01", "--json"]
    status, out, err = run(
        capsys, *argv, "--pressure", "1e4", "--duration", "0.03", "--out", "a.csv"
    )
    first = json.loads(out)
    assert (status, err) == (0, "")
    assert (first["result"], first["steps"], first["failed_step"]) == ("successful", 3, None)
    assert np.allclose(first["t_s"], [0, 0.01, 0.02, 0.03])
    assert np.allclose(first["tip_position"][0], [0, 0, 0.1])
    log = load_recording("a.csv", sr.load_scene("chamber.toml"))
    assert np.array_equal(log.tip_positions, first["tip_position"])
    assert np.array_equal(log.pressures, 1e4 * np.ones((4, 1)))

    status, out, _ = run(capsys, *argv, "--log", "a.csv")
    assert status == 0
    assert json.loads(out) == first


def test_simulate_resamples_the_log(capsys, asked):
    tau = np.array([[1.0, 0, 0], [2.0, 0, 0], [2.0, 0, 4.0]])
    write_log("in.csv", [5.0, 5.1, 5.2], tau, 1e4 * np.ones((3, 1)))
    argv = ["simulate", "robot.toml", "--log", "in.csv", "--dt", "0.05"]
    status, out, err = run(capsys, *argv, "--from-static", "--out", "out.csv")
    assert (status, err) == (0, "")
    assert "4 steps of 0.05 s: successful" in out
    # A step takes the value at its end, and the static start the value at t = 0.
    assert asked.motion.steps == 4
    assert np.allclose(asked.motion.tensions[:, 0], [1.5, 2, 2, 2])
    assert np.allclose(asked.motion.tensions[:, 2], [0, 0, 2, 4])
    assert np.allclose(asked.motion.pressures, 1e4)
    assert np.allclose(asked.static.tensions, [1, 0, 0])
    assert asked.motion.initial is not None
    written = load_recording("out.csv", sr.hybrid_robot())
    assert np.allclose(written.tensions[:, 0], [1, 1.5, 2, 2, 2])

    _, _, err = run(capsys, *argv, "--duration", "1")
    assert "note: the log ends after 0.2 s" in err
    assert np.allclose(asked.motion.tensions[4:], [2, 0, 4])


def test_simulate_without_inputs_leaves_the_actuators_out(capsys, asked):
    argv = ["simulate", "robot.toml", "--dt", "0.1", "--duration", "0.5", "--out", "out.csv"]
    assert run(capsys, *argv)[0] == 0
    assert asked.motion.tensions is None
    assert asked.motion.pressures is None
    assert asked.motion.initial is None
    written = load_recording("out.csv", sr.hybrid_robot())
    assert not written.tensions.any()
    assert not written.pressures.any()


def test_simulate_rounds_to_whole_steps(capsys, asked):
    _, _, err = run(capsys, "simulate", "robot.toml", "--dt", "0.03", "--duration", "0.1")
    assert asked.motion.steps == 3
    assert "note: 0.1 s are not a whole number of steps" in err
    _, _, err = run(capsys, "simulate", "robot.toml", "--dt", "0.1", "--duration", "0.3")
    assert asked.motion.steps == 3
    assert err == ""


def test_simulate_reports_a_failed_step(capsys, asked):
    asked.failed_step = 2
    argv = ["simulate", "robot.toml", "--dt", "0.1", "--duration", "0.5", "--out", "out.csv"]
    status, out, _ = run(capsys, *argv, "--json")
    content = json.loads(out)
    assert status == 1
    assert (content["failed_step"], content["steps"]) == (2, 5)
    assert content["result"] == common.reason(2, moving=True)
    assert [tip is None for tip in content["tip_position"]] == [False] * 3 + [True] * 3
    has_tip = load_recording("out.csv", sr.hybrid_robot()).has_tip
    assert has_tip.tolist() == [True] * 3 + [False] * 3

    status, out, err = run(capsys, *argv)
    assert (status, out) == (1, "")
    assert "failed: step 2, from 0.2 s" in err


def test_simulate_without_a_static_start(capsys, asked):
    asked.static_result = 1
    argv = ["simulate", "robot.toml", "--dt", "0.1", "--duration", "0.5", "--from-static"]
    status, out, _ = run(capsys, *argv, "--json")
    content = json.loads(out)
    assert status == 1
    assert content["result"].startswith("--from-static: no smooth equilibrium")
    assert asked.motion is None
    assert run(capsys, *argv)[0] == 1


def test_plot_draws_what_simulate_wrote(capsys):
    """The rod with a chamber, and its three steps, as above: no more programs."""
    argv = ["--pressure", "1e4", "--dt", "0.01", "--duration", "0.03", "--out", "a.csv"]
    assert run(capsys, "simulate", "chamber.toml", *argv)[0] == 0
    status, out, err = run(capsys, "plot", "a.csv")
    assert (status, out, err) == (0, "written to a.png\n", "")
    with Image.open("a.png") as picture:
        assert picture.width > picture.height > 500

    status, out, err = run(capsys, "plot", "chamber.toml", "a.csv", "--out", "film.gif")
    assert (status, err) == (0, "")
    match = re.fullmatch(r"the simulated tip is (.*) mm rms from .*\nwritten to film.gif\n", out)
    assert float(match[1]) < 1e-9
    with Image.open("film.gif") as film:
        assert film.n_frames == 1  # 0.03 s at 25 frames a second

    argv = ["--out", "film.html", "--speed", "0.25", "--fps", "25"]
    assert run(capsys, "plot", "chamber.toml", "a.csv", *argv)[0] == 0
    assert Path("film.html").read_text().count("data:image/png") == 4
    assert run(capsys, "plot", "chamber.toml", "a.csv", "--out", "both.png")[0] == 0

    status, out, _ = run(capsys, "plot", "chamber.toml", "--pressure", "3e4")
    assert (status, out) == (0, "written to chamber.png\n")
    assert Path("chamber.png").exists()


def test_plot_asks_for_the_motion_of_the_log(capsys, asked):
    tau = np.array([[1.0, 0, 0], [2.0, 0, 0], [2.0, 0, 4.0]])
    tip = np.array([[0.0, 0, 0.1], [np.nan] * 3, [0.01, 0, 0.1]])
    write_log("in.csv", [5.0, 5.1, 5.2], tau, 1e4 * np.ones((3, 1)), tip)
    asked.failed_step = 1
    argv = ["plot", "robot.toml", "in.csv", "--out", "film.gif"]
    status, out, err = run(capsys, *argv, "--dt", "0.05", "--tolerance", "1e-3")
    assert (status, out) == (1, "")
    assert err == f"softrod: failed: step 1, from 0.05 s: {common.reason(2, moving=True)}\n"
    assert not Path("film.gif").exists()
    assert asked.motion.dt == 0.05 and asked.motion.tolerance == 1e-3
    assert np.allclose(asked.motion.tensions[:, 0], [1.5, 2, 2, 2])
    assert asked.motion.initial is None

    assert run(capsys, *argv, "--from-static")[0] == 1
    assert asked.motion.steps == 2  # the log's own
    assert np.allclose(asked.static.tensions, [1, 0, 0])
    assert asked.motion.initial is not None

    asked.static_result = 1
    for line in ([*argv, "--from-static"], ["plot", "robot.toml"]):
        status, out, err = run(capsys, *line)
        assert (status, out) == (1, "")
        assert "no smooth equilibrium" in err


def test_plot_tells_of_another_start(capsys, asked, monkeypatch):
    monkeypatch.setattr("softrod_jax.pictures.animate", lambda *args, **options: None)
    tip = np.array([[0.03, 0, 0.1], [0.03, 0, 0.1]])
    write_log("in.csv", [0.0, 0.1], np.zeros((2, 3)), np.zeros((2, 1)), tip)
    argv = ["plot", "robot.toml", "in.csv", "--out", "film.gif"]
    status, out, err = run(capsys, *argv)
    assert status == 0
    assert out.startswith("the simulated tip is 29.5 mm rms from the log's")
    assert "starts 30 mm from where the rod does" in err and "--from-static" in err
    assert run(capsys, *argv, "--from-static")[2] == ""


def test_plot_without_matplotlib(capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    status, _, err = run(capsys, "plot", "a.csv")
    assert status == 2
    assert "pip install 'softrod_jax[plots]'" in err


def test_negative_pressure_in_any_notation(capsys, asked):
    for text in ("-10000", "-1e4", "-1.0E+4"):
        argv = ["simulate", "robot.toml", "--dt", "0.1", "--duration", "0.1", "--pressure", text]
        assert run(capsys, *argv)[0] == 0
        assert np.array_equal(asked.motion.pressures, [[-1e4]])


@pytest.mark.long
def test_doctor(capsys):
    status, out, _ = run(capsys, "doctor", "--json")
    content = json.loads(out)
    assert status == 0
    assert content["healthy"]
    assert content["float64"]
    assert content["solve_error_m"] < 1e-10
    assert content["jax"] == jax.__version__


def test_doctor_finds_a_wrong_solver(capsys, monkeypatch):
    wrong = SimpleNamespace(result=np.array(0), tip_position=np.array([0, 0, 0.1]))
    monkeypatch.setattr(sr, "solve_static", lambda *args, **options: wrong)
    status, out, _ = run(capsys, "doctor")
    assert status == 1
    assert "healthy        False" in out


@pytest.mark.parametrize("command", ["solve", "simulate", "plot", "calibrate", "doctor"])
def test_help(capsys, command):
    with pytest.raises(SystemExit) as stop:
        main([command, "--help"])
    assert stop.value.code == 0
    assert "usage: softrod" in capsys.readouterr().out


def test_cache_directory(tmp_path, monkeypatch):
    monkeypatch.setenv("JAX_COMPILATION_CACHE_DIR", "/a")
    assert common.cache_directory() == Path("/a")
    monkeypatch.delenv("JAX_COMPILATION_CACHE_DIR")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert common.cache_directory() == tmp_path / "softrod_jax"


def test_simulate_to_a_tolerance_or_by_bdf_alpha(capsys, asked):
    argv = ["simulate", "robot.toml", "--dt", "0.01", "--duration", "0.05"]
    status, _, _ = run(capsys, *argv, "--tolerance", "1e-4", "--alpha", "-0.2")
    assert status == 0
    assert asked.motion.tolerance == 1e-4 and asked.motion.scheme == sr.BDFAlpha(-0.2)
    for option, value in (("--tolerance", "2"), ("--alpha", "0.3")):
        status, _, err = run(capsys, *argv, option, value)
        assert status == 2 and option in err and value in err
