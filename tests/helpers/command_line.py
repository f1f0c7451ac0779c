"""What the tests of the command line share: a directory with scenes, and a solver to ask."""

from types import SimpleNamespace

import numpy as np
import pytest

import softrod_jax as sr
from calibration.cli import common
from calibration.cli.main import main

CHAMBER = """
[rod]
length = 0.1
section = { shape = "circle", radius = 6e-3 }
young_modulus = 5.0e4
poisson_ratio = 0.49
density = 1070.0
bending_damping = 1e-6
[[chambers]]
area = 7e-6
offset = [3e-3, 0.0]
"""


@pytest.fixture(autouse=True)
def in_a_directory_of_its_own(tmp_path, monkeypatch):
    """Commands run in `tmp_path`; JAX's cache stays as the tests have it."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(common, "prepare_jax", lambda: None)
    computing = (
        "solve",
        "simulate",
        "modes",
        "plot",
        "film",
        "view",
        "grid",
        "calibrate",
        "doctor",
    )
    for command in computing:
        monkeypatch.setattr(f"calibration.cli.{command}.prepare_jax", lambda: None)
    monkeypatch.setattr("calibration.cli.waiting.FIRST", 1e6)  # however busy the machine is
    (tmp_path / "chamber.toml").write_text(CHAMBER)
    sr.save_scene(sr.hybrid_robot(), tmp_path / "robot.toml")


@pytest.fixture
def asked(monkeypatch):
    """A solver that moves nothing, and what it was asked: tests of the command, not of the rod."""
    asked = SimpleNamespace(static=None, motion=None, static_result=0, failed_step=-1)

    def solve_static(scene, tensions=None, pressures=None, pulls=None, *, throw, **options):
        asked.static = SimpleNamespace(
            tensions=tensions, pressures=pressures, pulls=pulls, **options
        )
        stats = {
            "residual": np.array(np.nan),
            "iterations": np.array(3),
            "stable": np.array(True),
            "error": np.array(1e-6),
        }
        method = options.get("method", sr.Collocation())
        tip = SimpleNamespace(
            position=np.array([0.0, 0.0, 0.1]), quaternion=np.array([1.0, 0.0, 0.0, 0.0])
        )
        return SimpleNamespace(
            result=np.array(asked.static_result),
            tip_position=tip.position,
            tip_quaternion=tip.quaternion,
            tensions=np.zeros(0 if scene.tendons is None else scene.tendons.count),
            markers={"tip": tip},
            contact_force={},
            stats=stats,
            method=method,
        )

    def simulate(scene, *, throw, **inputs):
        asked.motion = SimpleNamespace(**inputs)
        ts = inputs["dt"] * np.arange(inputs["steps"] + 1)
        count = 0 if scene.tendons is None else scene.tendons.count
        return SimpleNamespace(
            ts=ts,
            tip_positions=np.stack([0.01 * ts, 0 * ts, 0.1 + 0 * ts], axis=1),
            tensions=np.zeros((len(ts), count)),
            result=np.array(0 if asked.failed_step < 0 else 2),
            failed_step=np.array(asked.failed_step),
            stats={"time_error": np.full(inputs["steps"], 1e-5)},
        )

    monkeypatch.setattr(sr, "solve_static", solve_static)
    monkeypatch.setattr(sr, "simulate", simulate)
    for command in ("solve", "simulate"):  # there is no rod to meet itself
        monkeypatch.setattr(f"calibration.cli.{command}.note_self_contact", lambda *found: None)
    return asked


def run(capsys, *argv):
    """Exit status, stdout and stderr of `softrod *argv`."""
    capsys.readouterr()
    status = main([str(x) for x in argv])
    captured = capsys.readouterr()
    return status, captured.out, captured.err
