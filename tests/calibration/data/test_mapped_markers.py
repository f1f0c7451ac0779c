"""Markers and attitudes of a motion capture, and inputs in another file, as a mapping says."""

import jax.numpy as jnp
import numpy as np
import pytest

import softrod_jax as sr
from calibration import RecordingError, load_recording
from calibration.data.frames import quaternion_of_turn
from softrod_jax.rod.rotations import rotation_matrix
from softrod_jax.scene.scene import as_arrays

SCENE = as_arrays(
    sr.Scene(
        0.3, sr.Circle(6e-3), 2e5, 0.49, 1070.0, gravity=[0.0, 0.0, 9.81],
        tendons=sr.Tendons(np.array([[4e-3, 0.0], [-4e-3, 0.0]]), control="length"),
        markers=(sr.Marker("middle", 0.15),),
    )
)  # fmt: skip
# The camera's y is up, the rod hangs: the scene's z is down.
TURN = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])
ORIGIN = np.array([0.1, 0.02, 0.11])
MAPPING = """
[time]
rate = 100.0
[tip]
columns = ["x3", "y3", "z3"]
unit = "mm"
axes = "x,z,-y"
origin = [100.0, 20.0, 110.0]
[[measured]]
key = "middle_position"
columns = ["x2", "", "z2"]
noise = 2e-3
[[measured]]
key = "tip_attitude"
columns = ["qw", "qx", "qy", "qz"]
body_axes = "x,z,-y"
"""


def camera(scene_points):
    return 1e3 * (np.asarray(scene_points) @ TURN + ORIGIN)


def capture(tmp_path, text=MAPPING, change=lambda table: table):
    """A log of a camera, and in the scene's frame the tip, the middle and how the tip turned."""
    rng = np.random.default_rng(1)
    tip = [0.0, 0.0, 0.3] + 0.01 * rng.normal(size=(6, 3))
    middle = [0.0, 0.0, 0.15] + 0.01 * rng.normal(size=(6, 3))
    h = [1.0, 0, 0, 0] + 0.2 * rng.normal(size=(6, 4))
    h /= np.linalg.norm(h, axis=1, keepdims=True)
    # The section's axes, named as the camera's when the rod is straight, as the camera sees them.
    seen = np.stack([quaternion_of_turn(TURN.T @ m @ TURN) for m in map(matrix, h)])
    table = change(np.column_stack([camera(tip), camera(middle), seen]))
    log, mapping = tmp_path / "log.csv", tmp_path / "log.map.toml"
    header = "x3,y3,z3,x2,y2,z2,qw,qx,qy,qz"
    np.savetxt(log, table, delimiter=",", header=header, comments="", fmt="%.17g")
    mapping.write_text(text)
    return log, tip, middle, h


def matrix(h):
    return np.asarray(rotation_matrix(jnp.asarray(h)))


def test_quaternions_of_turns():
    for h in np.eye(4):
        np.testing.assert_allclose(np.abs(quaternion_of_turn(matrix(h))), h, atol=1e-12)
    h = np.array([0.1, -0.5, 0.7, 0.5]) / 1.0
    h /= np.linalg.norm(h)
    np.testing.assert_allclose(matrix(quaternion_of_turn(matrix(h))), matrix(h), atol=1e-12)


def test_markers_are_seen_as_the_tip_is(tmp_path):
    log, tip, middle, h = capture(tmp_path)
    read = load_recording(log, SCENE)
    np.testing.assert_allclose(read.tip_positions, tip, atol=1e-12)
    there = read.others["middle_position"]
    # The camera's y, which nobody measured, is the scene's -z.
    np.testing.assert_allclose(there[:, :2], middle[:, :2], atol=1e-12)
    assert np.isnan(there[:, 2]).all()
    turned = read.others["tip_attitude"]
    for a, b in zip(turned, h):
        np.testing.assert_allclose(matrix(a), matrix(b), atol=1e-9)
    assert read.noise == {"middle_position": 2e-3}


def test_an_own_unit_and_an_attitude_that_is_none(tmp_path):
    own = MAPPING.replace('"middle_position"', '"middle_position"\nunit = "m"')
    log, _, middle, _ = capture(tmp_path, own, lambda t: t * np.r_[[1] * 3, [1e-3] * 3, [1] * 4])
    there = load_recording(log, SCENE).others["middle_position"]
    np.testing.assert_allclose(there[:, 0], middle[:, 0], atol=1e-12)
    log, *_ = capture(tmp_path, change=lambda t: t * np.r_[[1] * 9, 3])
    with pytest.raises(RecordingError, match="tip_attitude|quaternion of length"):
        load_recording(log, SCENE)
    without = MAPPING[: MAPPING.index("[tip]")] + MAPPING[MAPPING.index("[[measured]]") :]
    log, *_ = capture(tmp_path, without + '[[pulls]]\ncolumn = "x3"\n[[pulls]]\ncolumn = "y3"\n')
    with pytest.raises(RecordingError, match="there is no \\[tip\\]"):
        load_recording(log, SCENE, need_tip=False)


INPUTS = """
[[pulls]]
file = "commands.csv"
column = "u1"
scale = {scale}
time = {{ rate = 50.0 }}
[[pulls]]
file = "commands.csv"
column = "u1"
scale = -{scale}
time = {{ rate = 50.0 }}
"""


def test_inputs_from_a_file_of_their_own_clock(tmp_path):
    scale = 0.01 * np.pi / 180  # a pulley of 1 cm, turned by degrees
    log, tip, *_ = capture(tmp_path, MAPPING + INPUTS.format(scale=scale))
    degrees = np.array([0.0, 10.0, 30.0])
    (tmp_path / "commands.csv").write_text("ID,u1\n" + "".join(f"0,{u}\n" for u in degrees))
    read = load_recording(log, SCENE)
    expected = scale * np.interp(0.01 * np.arange(6), 0.02 * np.arange(3), degrees)
    np.testing.assert_allclose(read.pulls, np.stack([expected, -expected], 1), atol=1e-15)
    np.testing.assert_allclose(read.tip_positions, tip, atol=1e-12)
    # Commanded from the first row on, at which it jumps.
    jumps = MAPPING + INPUTS.format(scale=scale)
    log, *_ = capture(tmp_path, jumps.replace("rate = 50.0 }", "rate = 50.0 }\nbefore = -20.0"))
    read = load_recording(log, SCENE)
    at = lambda t: np.interp(t, read.times, read.pulls[:, 0])
    then = [at(-0.01), at(-1e-4), at(0.0)]
    np.testing.assert_allclose(then, scale * np.array([-20.0, -20.0, 0.0]), atol=1e-12)
    assert np.isnan(read.tip_positions[read.times < 0]).all()
    trials = '[trials]\ncolumn = "qw"\n'
    log, *_ = capture(tmp_path, MAPPING + INPUTS.format(scale=scale) + trials, _two_trials)
    with pytest.raises(RecordingError, match="trials of a file have inputs in columns"):
        load_recording(log, SCENE)


def _two_trials(table):
    table[:, 6] = [0, 0, 0, 1, 1, 1]
    return table
