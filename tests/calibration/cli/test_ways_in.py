"""The command line as people type it: in any order, with slips, and with patience."""

# ruff: noqa: F811 - pytest knows fixtures by their names

import argparse
import io
import re
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from command_line import asked, in_a_directory_of_its_own, run  # noqa: F401

import softrod_jax as sr
from calibration import write_log
from calibration.cli import calibrate, waiting
from calibration.cli.main import _parsers, main
from calibration.cli.order import positions_first
from calibration.parameters.catalogue import catalogue, choose
from calibration.parameters.names import NAMES
from calibration.search.progress import Bar

ORDERS = [
    ("solve", "robot.toml --tension 0.1 -0.2 0 --json", "--json --tension 0.1 -0.2 0 robot.toml"),
    (
        "calibrate",
        "robot.toml a.csv b.mat --out d --fit young_modulus --bounds young_modulus=1:2 density=1:3",
        "--out d --bounds young_modulus=1:2 density=1:3 robot.toml --fit young_modulus a.csv b.mat",
    ),
    (
        "calibrate",
        "robot.toml a.csv --held-out c.csv d.csv --resume",
        "--held-out c.csv d.csv robot.toml --resume a.csv",
    ),
    ("calibrate", "robot.toml a.csv --window 0 1", "robot.toml --window 0 1 a.csv"),
    ("calibrate", "robot.toml a.csv --axes=-y,x,z", "--axes=-y,x,z robot.toml a.csv"),
    ("plot", "robot.toml a.csv --out x.gif", "robot.toml --out x.gif a.csv"),
    ("import", "a.csv --tip X Y Z --tension F", "--tip X Y Z --tension F a.csv"),
    ("simulate", "-- robot.toml --dt", "-- robot.toml --dt"),
]


@pytest.mark.parametrize("command, usual, other", ORDERS)
def test_options_and_positions_in_any_order(command, usual, other):
    parser = _parsers()[1][command]
    if usual == other:
        assert positions_first(parser, usual.split()) == ["--", "robot.toml", "--dt"]
        return
    assert parser.parse_args(positions_first(parser, other.split())) == parser.parse_args(
        usual.split()
    )


def test_a_command_in_another_order(capsys, asked):
    argv = ["--dt", "0.1", "--duration", "0.2", "--tension", "1", "0", "0", "robot.toml"]
    status, out, err = run(capsys, "simulate", *argv)
    assert (status, err) == (0, "") and "2 steps" in out
    assert np.array_equal(asked.motion.tensions, [[1, 0, 0]] * 2)


def test_the_version_and_bare_help(capsys):
    with pytest.raises(SystemExit) as ended:
        main(["--version"])
    assert ended.value.code == 0 and re.match(r"softrod[ ,]", capsys.readouterr().out)
    status, out, err = run(capsys)
    assert (status, err) == (0, "") and "calibrate" in out and "import" in out


def test_names_that_help_lists_are_those_that_there_are():
    """Of scenes that between them have everything, both ways round."""
    servos = sr.load_scene(Path(calibrate.__file__).parents[1] / "templates" / "servos.toml")
    robot = sr.hybrid_robot(gravity=np.array([0.0, 0.0, 9.81]))
    known = set()
    for scene in (servos, robot):
        single, groups = catalogue(scene)
        known |= {name for name in single if not any(name in g for g in groups.values())}
        known |= set(groups)
    assert known <= set(NAMES)
    others = {"material_", "stiffness_", "relaxation_", "release_", "tendon_friction_each"}
    assert {n for n in set(NAMES) - known if not n.startswith(tuple(others))} == set()
    for name in NAMES:
        assert f"  {name} " in calibrate.EPILOG


@pytest.mark.parametrize(
    "name, hint",
    [
        ("young_modulos", "did you mean 'young_modulus'?"),
        ("payload", "did you mean 'payload_mass'?"),
        ("relaxation_time", "the scene has nothing of that kind"),
    ],
)
def test_a_slip_in_a_name_is_told(name, hint):
    with pytest.raises(ValueError, match=re.escape(hint)):
        choose(sr.hybrid_robot(), [name])


def test_an_interrupted_fit_says_how_to_go_on(capsys, monkeypatch):
    t = 0.1 * np.arange(9)
    tip = np.stack([1e-3 * t, 0 * t, 0.1 + 0 * t], axis=1)
    write_log("a.csv", t, np.zeros((9, 3)), np.zeros((9, 1)), tip)

    def interrupted(*_):
        Path("d/checkpoint.json").write_text("{}")
        raise KeyboardInterrupt

    monkeypatch.setattr(calibrate, "_fitted", interrupted)
    status, _, err = run(capsys, "calibrate", "robot.toml", "a.csv", "--out", "d")
    assert status == 130 and "--resume goes on from here" in err


def test_no_bar_says_0_of_0(wrong_types):
    from rich.console import Console

    out = io.StringIO()
    bar = Bar()
    bar._console = bar._live.console = Console(file=out, force_terminal=True, width=100)
    point = SimpleNamespace(ok=True, loss=1.0, rms=1e-3, x=[])
    point.problem = SimpleNamespace(space=SimpleNamespace(parameters=SimpleNamespace(items=[])))
    with bar:
        bar.stage("steps and grid", None)
        bar.stage("search", 5)
        bar.show(point)
        bar.show(point)
        bar.stage("checks", None)
    assert "2/2" in out.getvalue() and "0/0" not in out.getvalue()


def test_without_a_terminal_a_line_comes_now_and_then(capsys, monkeypatch):
    monkeypatch.setattr(waiting, "FIRST", 0.05)
    with waiting.waiting("simulating 3 steps"):
        time.sleep(0.4)
    lines = capsys.readouterr().err.splitlines()
    assert 2 <= len(lines) <= 4  # at 0.05, 0.1, 0.2 s
    assert all(line.startswith("softrod: simulating 3 steps: ") for line in lines)
    with waiting.waiting("quick"):
        pass
    assert capsys.readouterr().err == ""


def test_on_a_terminal_the_line_is_taken_away(monkeypatch):
    terminal = io.StringIO()
    terminal.isatty = lambda: True
    monkeypatch.setattr(sys, "stderr", terminal)
    monkeypatch.setattr(waiting, "AGAIN", 0.05)
    with waiting.waiting("solving"):
        time.sleep(0.2)
    assert "\rsolving: 0 s" in terminal.getvalue() and terminal.getvalue().endswith("\r\x1b[K")


def test_commands_have_help_of_their_own(capsys):
    for name, parser in _parsers()[1].items():
        assert isinstance(parser, argparse.ArgumentParser)
        with pytest.raises(SystemExit):
            main([name, "--help"])
        assert f"usage: softrod {name}" in capsys.readouterr().out
