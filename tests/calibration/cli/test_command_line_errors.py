"""The command line given what it cannot use: one line that says so, status 2, no traceback."""

# ruff: noqa: F811 - pytest knows fixtures by their names

import os
import subprocess
import sys
from pathlib import Path

import pytest
from command_line import asked, in_a_directory_of_its_own, run  # noqa: F401

ROOT = Path(__file__).parents[3]

LOG = "t_s,tau1_N,tau2_N,tau3_N,p1_Pa\n0,0,0,0,0\n1,1,1,1,1\n"

STEP = ["--dt", "0.1", "--duration", "1"]

# The command line, files that it needs, and what the message must say.
BAD = [
    (["--colour"], {}, ["COMMAND", "softrod --help"]),
    (["solv", "robot.toml"], {}, ["'solv'", "did you mean 'solve'?", "simulate"]),
    (["solve"], {}, ["SCENE.toml"]),
    (["solve", "absent.toml"], {}, ["absent.toml", "No such file"]),
    (["solve", "."], {}, ["cannot read"]),
    (["solve", "bad.toml"], {"bad.toml": "[rod"}, ["bad.toml", "not a TOML file"]),
    (["solve", "bad.toml"], {"bad.toml": "[rod]\nlenght=1"}, ["bad.toml: rod.lenght", "length"]),
    (["solve", "robot.toml", "--tension", "1", "2"], {}, ["--tension: 2 given", "3 tendons"]),
    (["solve", "robot.toml", "--tension", "1", "-2", "3"], {}, ["--tension 1 -2 3", "only pull"]),
    (["solve", "robot.toml", "--tension", "1", "x", "3"], {}, ["--tension", "'x'", "number"]),
    (["solve", "robot.toml", "--tension", "1", "nan", "3"], {}, ["--tension", "'nan'", "finite"]),
    (["solve", "robot.toml", "--pressure", "1e999"], {}, ["--pressure", "'1e999'", "finite"]),
    (["solve", "robot.toml", "--tension"], {}, ["--tension"]),
    (["solve", "robot.toml", "--pressure", "1", "2"], {}, ["--pressure: 2 given", "1 chamber;"]),
    (["solve", "chamber.toml", "--tension", "1"], {}, ["--tension", "no tendons", "[[tend"]),
    (["solve", "robot.toml", "--colour"], {}, ["--colour"]),
    (["solve", "robot.toml", "--tensoin", "1"], {}, ["--tensoin; did you mean '--tension'?"]),
    (["simulate", "robot.toml", "--duration", "1"], {}, ["--dt"]),
    (["simulate", "robot.toml", "--dt", "0.1"], {}, ["--duration is needed"]),
    (["simulate", "robot.toml", "--dt", "0", "--duration", "1"], {}, ["--dt", "above 0"]),
    (["simulate", "robot.toml", "--dt", "-1", "--duration", "1"], {}, ["--dt", "above 0"]),
    (["simulate", "robot.toml", "--dt", "x", "--duration", "1"], {}, ["--dt", "'x'"]),
    (["simulate", "robot.toml", "--dt", "1", "--duration", "0.1"], {}, ["0.1 is shorter"]),
    (["simulate", "robot.toml", "--dt", "1", "--duration", "-1"], {}, ["--duration", "above 0"]),
    (["simulate", "robot.toml", "--dt", "1e-9", "--duration", "9"], {}, ["9e+09 steps"]),
    (["simulate", "robot.toml", *STEP, "--out", "no/a.csv"], {}, ["--out no/a.csv", "not exist"]),
    (["simulate", "robot.toml", *STEP, "--out", "."], {}, ["--out .", "directory"]),
    (["simulate", "robot.toml", *STEP, "--log", "absent.csv"], {}, ["absent.csv", "No such"]),
    (["simulate", "robot.toml", *STEP, "--log", "a.txt"], {"a.txt": LOG}, ["a.txt", ".csv"]),
    (
        ["simulate", "robot.toml", *STEP, "--log", "a.csv"],
        {"a.csv": LOG.replace("1,1,1,1,1", "1,1,?,1,1")},
        ["a.csv: row 3, column tau2_N", "'?'"],
    ),
    (
        ["simulate", "robot.toml", *STEP, "--log", "a.csv", "--tension", "1", "1", "1"],
        {"a.csv": LOG},
        ["--log", "leave --tension"],
    ),
    (
        ["simulate", "robot.toml", "--dt", "1", "--log", "a.csv"],
        {"a.csv": LOG.replace("1,1,1,1,1\n", "")},
        ["one row", "--duration"],
    ),
    (["film", "robot.toml"], {}, ["robot.toml", "SCENE.toml and LOG"]),
    (["film", "a.csv", "robot.toml", "--out", "a.png"], {}, ["--out a.png", ".mp4"]),
    (["film", "."], {}, ["motions.npz", "No such file", "softrod calibrate"]),
    (["film", ".", "--dt", "1"], {}, ["--dt: for a scene and a log only"]),
    (["film", ".", "--out", "a.html", "--fps", "9"], {}, ["--fps", "leave it out"]),
    (["import", "a.csv", "b.csv"], {}, ["a.csv b.csv", "one table"]),
    (["import", "absent.csv"], {}, ["absent.csv", "No such file"]),
    (["import", "a.csv", "--tip", "X", "Y", "Z"], {"a.csv": LOG}, ["no column 'X' (--tip)"]),
    (["view", "absent.toml"], {}, ["absent.toml", "No such file"]),
    (["view", "robot.toml", "--log", "no/a.csv"], {}, ["--log no/a.csv", "not exist"]),
    (["simulate", "robot.toml", *STEP, "--mapping", "m.toml"], {}, ["--mapping", "--log"]),
    (["plot", "robot.toml", "--mapping", "m.toml"], {}, ["--mapping: for a log only"]),
    (["plot"], {}, ["FILE"]),
    (["plot", "absent.csv"], {}, ["absent.csv", "No such file"]),
    (["plot", "a.csv"], {"a.csv": LOG}, ["a.csv: row 1", "tip_x_m is missing"]),
    (["plot", "a.csv", "b.csv"], {}, ["a.csv b.csv: 2 logs", "one LOG.csv"]),
    (["plot", "robot.toml", "chamber.toml"], {}, ["2 scenes"]),
    (["plot", "a.csv", "--out", "a.bmp"], {}, ["--out a.bmp", "'.bmp'", ".png", ".gif"]),
    (["plot", "a.csv", "--out", "a.gif"], {}, ["--out a.gif", "SCENE.toml LOG.csv", "a.png"]),
    (["plot", "robot.toml", "--out", "a.html"], {}, ["--out a.html", "SCENE.toml LOG.csv"]),
    (["plot", "a.csv", "--out", "no/a.png"], {}, ["--out no/a.png", "not exist"]),
    (["plot", "a.csv", "--tension", "1"], {}, ["--tension", "the log gives the inputs"]),
    (["plot", "robot.toml", "--dt", "1"], {}, ["--dt: for a scene and a log only"]),
    (["plot", "robot.toml", "a.csv", "--speed", "2"], {}, ["--speed: for films only"]),
    (["plot", "robot.toml", "a.csv", "--out", "a.gif", "--fps", "99"], {}, ["--fps 99"]),
    (["plot", "robot.toml", "--tension", "1"], {}, ["--tension: 1 given", "3 tendons"]),
    (
        ["plot", "robot.toml", "a.csv"],
        {"a.csv": LOG.replace("1,1,1,1,1\n", "")},
        ["a.csv: one row is no motion"],
    ),
    (["calibrate", "robot.toml"], {}, ["no recordings", "LOG"]),
    (["calibrate", "robot.toml", "a.csv", "--out", "a.csv"], {"a.csv": LOG}, ["--out a.csv"]),
    (["calibrate", "robot.toml", "a.csv", "--window", "0"], {}, ["--window"]),
]


@pytest.mark.parametrize("argv, files, fragments", BAD, ids=[" ".join(x[0])[:60] for x in BAD])
def test_bad_input(capsys, argv, files, fragments):
    for name, content in files.items():
        Path(name).write_text(content)
    status, out, err = run(capsys, *argv)
    assert status == 2
    assert out == ""
    lines = err.strip().split("\n")
    assert lines[-1].startswith("softrod: error: ")
    assert "Traceback" not in err
    for fragment in fragments:
        assert fragment in lines[-1]


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write anywhere")
def test_directory_without_permission(capsys):
    Path("locked").mkdir(mode=0o500)
    status, _, err = run(capsys, "simulate", "robot.toml", *STEP, "--out", "locked/a.csv")
    assert status == 2
    assert "no permission" in err


def test_errors_while_writing(capsys, asked, monkeypatch):
    def full(*_, **__):
        raise OSError(28, "No space left on device", "out.csv")

    monkeypatch.setattr("softrod_jax.scene.logs.write_log", full)
    status, _, err = run(capsys, "simulate", "robot.toml", *STEP, "--out", "out.csv")
    assert status == 2
    assert err == "softrod: error: out.csv: No space left on device\n"


def test_as_a_process_that_cannot_keep_a_cache(tmp_path):
    """The one test with everything real: float64, an unusable cache, bad input, no traceback."""

    # ruff: noqa: F811 - pytest knows fixtures by their names
    (tmp_path / "file").write_text("")
    environment = {
        **{k: v for k, v in os.environ.items() if not k.startswith("JAX_")},
        "XDG_CACHE_HOME": str(tmp_path / "file"),
        "PYTHONPATH": str(ROOT),
    }
    argv = ["solve", "robot.toml", "--tension", "1", "-1", "0"]
    done = subprocess.run(
        [sys.executable, "-m", "calibration.cli", *argv],
        env=environment,
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert done.returncode == 2
    assert done.stdout == ""
    assert done.stderr.startswith("softrod: error: --tension 1 -1 0")
    assert "Traceback" not in done.stderr
