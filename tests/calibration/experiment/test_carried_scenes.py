"""Recordings that say where the base and obstacles are carried: simulated, logged, read, fitted."""

# ruff: noqa: F811 - pytest knows fixtures by their names

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from command_line import in_a_directory_of_its_own, run  # noqa: F401

import softrod_jax as sr
from calibration import Recording, calibrate, load_recording
from calibration.data.carried import poses_at
from calibration.data.recording import RecordingError
from calibration.postures.data import Postures
from calibration.postures.fitting import calibrate_postures
from softrod_jax.scene.inputs import Inputs
from softrod_jax.scene.logs import pose_columns, write_log

L, DT, STEPS = 0.1, 0.01, 60
# A wall beside the tip of the straight rod, and room for its surface.
WALL = sr.Contact(
    sr.Plane([-7e-3, 0.0, 0.0], [1.0, 0.0, 0.0]), 2e3, damping=1.0, name="wall", moves=True
)
SCENE = sr.Scene(
    length=L,
    section=sr.Circle(6e-3),
    young_modulus=2e5,
    poisson_ratio=0.45,
    density=1000.0,
    bending_damping=2e-5,
    base_position=[0.02, 0.0, -0.01],
    inextensible=True,
    plane="xz",
)
AT = DT * np.arange(STEPS + 1)
TURN = 0.15 * np.sin(9 * AT) ** 2


def moved():
    """By name: the scene, and where it is carried, (rows, 7)."""
    shift = np.stack([8e-3 * np.sin(7 * AT) ** 2, 0 * AT, 4e-3 * np.sin(5 * AT) ** 2], 1)
    h = np.stack([np.cos(TURN / 2), 0 * AT, np.sin(TURN / 2), 0 * AT], 1)
    base = np.concatenate([np.asarray(SCENE.base_position) + shift, h], 1)
    pushed = np.stack([6e-3 * np.sin(6 * AT) ** 2, 0 * AT, 0 * AT], 1)
    wall = np.concatenate([pushed, np.tile([1.0, 0, 0, 0], (STEPS + 1, 1))], 1)
    beside = dataclasses.replace(SCENE, base_position=None, contacts=(WALL,))
    return {
        "base": (dataclasses.replace(SCENE, base_moves=True), base),
        "wall": (beside, wall),
    }


def simulated(scene, name, poses, **options):
    own = {"base": poses[1:]} if name == "base" else {"contacts": {name: poses[1:]}}
    return sr.simulate(scene, DT, **own, **options)


@pytest.fixture(params=["base", "wall"])
def case(request):
    return request.param, *moved()[request.param]


def test_the_log_says_what_moved_and_the_command_moves_it(case, capsys):
    name, scene, poses = case
    sr.save_scene(scene, "scene.toml")
    assert "moves = true" in Path("scene.toml").read_text()
    write_log("in.csv", AT, carried={name: poses})
    argv = ["simulate", "scene.toml", "--log", "in.csv", "--dt", str(DT), "--out", "out.csv"]
    status, _, err = run(capsys, *argv)
    assert status == 0, err
    read = load_recording("out.csv", scene)
    np.testing.assert_allclose(read.carried[name], poses, atol=1e-15)
    right = simulated(scene, name, poses).tip_positions
    assert np.ptp(right[:, 0]) > 2e-3  # it does move
    np.testing.assert_allclose(read.tip_positions, right, atol=1e-12)


def test_a_fit_finds_the_modulus_from_how_it_was_moved(case):
    name, scene, poses = case
    method = sr.Collocation(6, order=6)
    tip = np.asarray(simulated(scene, name, poses, method=method, substeps=1).tip_positions)
    recording = Recording(AT, None, None, tip, carried={name: poses})
    start = dataclasses.replace(scene, young_modulus=2.6e5)
    options = dict(checks=False, progress=False, time_offset=False, dt=DT, method=method)
    fit = calibrate(start, [recording], fit=("young_modulus",), **options)
    found = fit.parameters["young_modulus"]
    assert found.value == pytest.approx(2e5, rel=1e-4) and found.verdict == "identified"
    # As if it stood still, nothing explains how the tip moved.
    unmoved = dataclasses.replace(recording, carried={}, starts_hanging=False)
    blind = calibrate(start, [unmoved], fit=("young_modulus",), **options)
    rms = lambda fit: next(iter(fit.rmse_m.values()))
    assert rms(fit) < 1e-6 and rms(blind) > 1e-3


def test_a_film_shows_where_the_wall_was(tmp_path):
    from calibration.report.films import filmed, read_motions, write_films

    scene, poses = moved()["wall"]
    method = sr.Collocation(6, order=6)
    tip = np.asarray(simulated(scene, "wall", poses, method=method, substeps=1).tip_positions)
    recording = Recording(AT, None, None, tip, carried={"wall": poses})
    options = dict(checks=False, progress=False, time_offset=False, dt=DT, method=method)
    fit = calibrate(scene, [recording], fit=("young_modulus",), **options)
    (drawn,) = filmed(fit)
    np.testing.assert_allclose(drawn.motion.carried["wall"], poses[: len(drawn.motion.ts)])
    sr.save_scene(scene, tmp_path / "scene.toml")
    write_films(fit, tmp_path)
    _, (stored,) = read_motions(tmp_path)
    np.testing.assert_array_equal(stored.motion.carried["wall"], drawn.motion.carried["wall"])


def test_between_rows_poses_are_smooth():
    t = np.sort(np.random.default_rng(3).uniform(0, 1, 60))
    t[0], t[-1] = 0.0, 1.0
    wave = lambda t: np.stack([np.sin(4 * t), t**2, 0 * t], 1)
    turned = lambda t: np.stack([np.cos(t), 0 * t, np.sin(t), 0 * t], 1)
    pose = lambda t: np.concatenate([wave(t), turned(t)], 1)
    at = np.linspace(0, 1, 500)
    found = poses_at(at, t, pose(t))
    # Straight pieces between these rows are off by 3e-3.
    assert np.max(np.abs(found - pose(at))) < 2e-4
    np.testing.assert_allclose(np.linalg.norm(found[:, 3:], axis=1), 1.0, rtol=1e-14)
    np.testing.assert_array_equal(poses_at(np.array([-1.0, 2.0]), t, pose(t)), pose(t[[0, -1]]))


COLUMNS = pose_columns("base")
STILL = [0.02, 0.0, -0.01, 1.0, 0.0, 0.0, 0.0]
BAD = {
    "a column that is missing": (COLUMNS[:-1], STILL[:-1], "column base_qz is missing"),
    "a cell that is empty": (COLUMNS, [*STILL[:-1], ""], r"row 2, column base_qz: missing"),
    "no quaternion": (COLUMNS, [*STILL[:3], 0.5, 0, 0, 0], "norm 0.5; expected 1"),
    "twice": ([*COLUMNS, "base_qz"], [*STILL, 0.0], "base_qz is there twice"),
    "what stands still": (pose_columns("wall"), [0.0, 0, 0, 1, 0, 0, 0], r"has wall stand still"),
}


@pytest.mark.parametrize("what", BAD)
def test_refused_in_a_log(what):
    columns, row, message = BAD[what]
    scene = dataclasses.replace(
        SCENE, base_moves=True, contacts=(dataclasses.replace(WALL, moves=False),)
    )
    lines = [",".join(map(str, x)) for x in (["t_s", *columns], *([t, *row] for t in (0, 1)))]
    lines = [f"{x},{y}" for x, y in zip(lines, ["tip_x_m,tip_y_m,tip_z_m"] + ["0.02,0,0.09"] * 2)]
    Path("a.csv").write_text("\n".join(lines))
    with pytest.raises(RecordingError, match=message):
        load_recording("a.csv", scene)


def test_an_obstacle_begins_where_the_scene_has_it():
    scene, poses = moved()["wall"]
    tip = np.tile([0.0, 0.0, L], (STEPS + 1, 1))
    write_log("a.csv", AT + 0.1, tip_positions=tip, carried={"wall": poses[::-1]})
    with pytest.raises(RecordingError, match="wall begins at .* begin with 0, 0, 0, 1, 0, 0, 0"):
        load_recording("a.csv", scene)
    with pytest.raises(RecordingError, match="an obstacle begins where the scene has it"):
        recording = Recording(AT, None, None, tip, carried={"wall": poses[::-1]})
        calibrate(scene, [recording], progress=False)


def test_what_nobody_says_is_told():
    scene, poses = moved()["base"]
    write_log("a.csv", AT, tip_positions=np.tile([0.02, 0.0, 0.09], (STEPS + 1, 1)))
    assert "nothing says where base is carried" in " ".join(load_recording("a.csv", scene).notes)
    write_log("b.csv", AT, carried={"base": poses})
    assert not load_recording("b.csv", scene, need_tip=False).notes
    # Without a scene nobody knows what it is, and the rest is read.
    assert not load_recording("b.csv", need_tip=False).carried


def test_names_that_the_scene_does_not_carry():
    recording = Recording(
        AT,
        None,
        None,
        np.tile([0.02, 0.0, 0.09], (STEPS + 1, 1)),
        carried={"base": moved()["base"][1]},
    )
    with pytest.raises(RecordingError, match="the scene has nothing with moves = true"):
        calibrate(SCENE, [recording], progress=False)


@pytest.mark.parametrize("name", ["base", "wall"])
def test_postures_do_not_say_it(name):
    rows = Postures(Inputs(), {"tip": np.zeros((2, 3))})
    with pytest.raises(ValueError, match=f"{name} is carried .* postures do not say where"):
        calibrate_postures(moved()[name][0], rows, fit=("young_modulus",))
