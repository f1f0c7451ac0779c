"""Recordings: CSV logs and motion capture, good and bad."""

from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest

from calibration import (
    Recording,
    RecordingError,
    detect_onset,
    load_recording,
    write_log,
)
from softrod_jax.scene.robots import hybrid_robot
from softrod_jax.scene.scene import Scene, as_arrays
from softrod_jax.scene.sections import Rectangle

BEAM = Path(__file__).parents[4] / "shared" / "data" / "beam"

HEADER = "t_s,tau1_N,tau2_N,tau3_N,p1_Pa,tip_x_m,tip_y_m,tip_z_m\n"
ROW = "0.0,0,0,0,1e3,0.0,0.0,0.1\n"
LOG = HEADER + ROW + "0.1,1,0,0,1e3,0.01,0.0,0.09\n" + "0.2,1.5,0,0,1e3,0.02,0.0,0.08\n"


def beam():
    section = Rectangle(0.03, 0.03)
    return as_arrays(Scene(0.1, section, 2.9e5, 0.49, 1070.0, gravity=jnp.array([-9.81, 0, 0])))


def write(tmp_path, text):
    path = tmp_path / "log.csv"
    path.write_text(text, encoding="utf-8")
    return path


def test_reads_a_log(tmp_path):
    recording = load_recording(write(tmp_path, LOG), hybrid_robot())
    assert np.array_equal(recording.times, [0, 0.1, 0.2])
    assert np.array_equal(recording.tensions[:, 0], [0, 1, 1.5])
    assert np.array_equal(recording.pressures, [[1e3], [1e3], [1e3]])
    assert np.array_equal(recording.tip_positions[2], [0.02, 0, 0.08])
    assert (recording.name, recording.origin_known) == ("log", True)
    assert recording.source.endswith("log.csv")


def test_reads_a_log_without_scene_and_actuators(tmp_path):
    recording = load_recording(write(tmp_path, "t_s,tip_x_m,tip_y_m,tip_z_m\n0,0,0,0.1\n"))
    assert recording.tensions is None
    assert recording.pressures is None


def test_spaces_blank_lines_byte_order_mark_and_windows_line_ends(tmp_path):
    text = "\ufeff" + LOG.replace(",", " , ").replace("\n", "\r\n") + "\r\n\r\n"
    plain = load_recording(write(tmp_path, LOG))
    other = load_recording(write(tmp_path, text))
    assert np.array_equal(plain.tip_positions, other.tip_positions)


@pytest.mark.parametrize("missing", ["", "nan", "NaN", " "])
def test_missing_samples(tmp_path, missing):
    text = LOG.replace("0.01,0.0,0.09", f"{missing},0.0,{missing}")
    recording = load_recording(write(tmp_path, text), hybrid_robot())
    assert np.array_equal(np.isnan(recording.tip_positions[1]), [True, False, True])
    assert np.array_equal(recording.has_tip, [True, False, True])


def test_inputs_alone(tmp_path):
    path = write(tmp_path, "t_s,tau1_N,tau2_N,tau3_N,p1_Pa\n0,0,0,0,0\n1,1,1,1,1\n")
    recording = load_recording(path, hybrid_robot(), need_tip=False)
    assert recording.tip_positions.shape == (2, 3)
    assert not recording.has_tip.any()
    with pytest.raises(RecordingError, match="tip_x_m is missing"):
        load_recording(path, hybrid_robot())


def test_log_round_trip_is_exact(tmp_path):
    rng = np.random.default_rng(0)
    times = np.cumsum(rng.uniform(0.1, 1, 50))
    tensions, pressures = rng.uniform(0, 3, (50, 2)), rng.normal(0, 1e4, (50, 1))
    tips = rng.normal(0, 0.1, (50, 3))
    tips[rng.uniform(size=(50, 3)) < 0.3] = np.nan
    write_log(tmp_path / "a.csv", times, tensions, pressures, tips)
    back = load_recording(tmp_path / "a.csv")
    assert np.array_equal(back.times, times)
    assert np.array_equal(back.tensions, tensions)
    assert np.array_equal(back.pressures, pressures)
    assert np.array_equal(back.tip_positions, tips, equal_nan=True)


def edited(old, new):
    assert old in LOG
    return LOG.replace(old, new, 1)


# What is wrong, the file, and what the message must say besides the file's name.
BAD = [
    ("empty", "", ["empty", "t_s"]),
    ("header only", HEADER, ["no rows"]),
    ("no header", ROW, ["row 1", "column 1 is '0.0'", "'t_s'"]),
    ("semicolons", LOG.replace(",", ";"), ["row 1", "';'", "commas"]),
    ("too few tendons", edited("tau3_N,", ""), ["3 tendons", "column 4", "'tau3_N'"]),
    ("too many tendons", edited("tau3_N,", "tau3_N,tau4_N,"), ["column 5 is 'tau4_N'", "3 tend"]),
    ("numbering", edited("tau2_N", "tau4_N"), ["column 3 is 'tau4_N'", "'tau2_N'"]),
    ("unit", edited("tip_x_m", "tip_x_mm"), ["'tip_x_mm'", "convert it to m"]),
    ("unit of p", edited("p1_Pa", "p1_kPa"), ["'p1_kPa'", "convert it to Pa"]),
    ("extra", edited("tip_z_m", "tip_z_m,note"), ["column 9 is 'note'", "one too many"]),
    ("tip cut off", LOG.replace(",tip_z_m", ""), ["column tip_z_m is missing"]),
    ("word", edited("0.01", "fast"), ["row 3, column tip_x_m", "'fast'", "leave the cell empty"]),
    ("word input", edited("1.5", "x"), ["row 4, column tau1_N", "'x'"]),
    ("underscore", edited("1.5", "1_5"), ["row 4, column tau1_N", "'1_5'"]),
    ("decimal comma", edited("1.5,", "1,5,"), ["row 4", "9 cells", "8 columns"]),
    ("inf", edited("0.09", "inf"), ["row 3, column tip_z_m", "'inf'", "finite"]),
    ("short row", LOG + "0.3,1\n", ["row 5", "2 cells"]),
    ("missing input", edited("0.1,1,", "0.1,,"), ["row 3, column tau1_N", "missing"]),
    ("missing time", edited("0.1,1,", "nan,1,"), ["row 3, column t_s", "missing"]),
    ("time back", edited("0.2,", "0.05,"), ["row 4, column t_s", "0.05 follows 0.1", "sort"]),
    ("time twice", edited("0.2,", "0.1,"), ["row 4, column t_s", "0.1 is repeated"]),
    ("push", edited("1.5", "-1.5"), ["row 4, column tau1_N", "-1.5", "only pull"]),
    ("no tip", HEADER + "0,0,0,0,0,,,\n", ["tip_x_m", "every sample is missing"]),
    ("out of reach", edited("0.02", "0.2"), ["row 4", "0.2", "0.1 m long", "check the unit"]),
    (
        "millimetres",
        HEADER + "0,0,0,0,0,0,0,100\n1,0,0,0,0,10,0,90\n",
        ["row 2", "millimetres", "1000"],
    ),
    ("quote", edited("1.5", '"1.5'), ["row", "not a CSV file"]),
    ("row after blank lines", edited("0.2,", "\n\n0.2,x"), ["row 6"]),
]


@pytest.mark.parametrize("name, text, fragments", BAD, ids=[name for name, _, _ in BAD])
def test_refuses(tmp_path, name, text, fragments):
    with pytest.raises(RecordingError) as error:
        load_recording(write(tmp_path, text), hybrid_robot())
    message = str(error.value)
    assert "log.csv" in message
    assert "\n" not in message
    for fragment in fragments:
        assert fragment in message


def test_refuses_unreadable_files(tmp_path):
    binary = tmp_path / "binary.csv"
    binary.write_bytes(b"t_s\xff\xfe")
    for path, fragment in [
        (tmp_path / "absent.csv", "No such file"),
        (tmp_path / "absent.c3d", "No such file"),
        (tmp_path / "log.txt", "expected .csv or .c3d"),
        (binary, "UTF-8"),
    ]:
        with pytest.raises(RecordingError, match=fragment):
            load_recording(path, hybrid_robot())


def test_c3d_options_are_refused_for_csv(tmp_path):
    with pytest.raises(RecordingError, match="tip_markers"):
        load_recording(write(tmp_path, LOG), tip_markers="end")


def test_window(tmp_path):
    recording = load_recording(write(tmp_path, LOG)).window(0.05, 0.2)
    assert np.array_equal(recording.times, [0.1, 0.2])
    assert recording.tensions.shape == (2, 3)
    with pytest.raises(RecordingError, match="0.1 to 0.2 s"):
        recording.window(1.0, 2.0)


def released(noise=0.0, release=0.5, dt=0.01, seed=0):
    """A tip that is let go at `release` [s] and rings."""
    t = np.arange(0, 2, dt)
    fall = np.maximum(t - release, 0)
    x = -0.01 * (1 - np.exp(-2 * fall) * np.cos(49 * fall))
    tip = np.stack([x, 0 * x, 0.1 + 0 * x], axis=1)
    tip += noise * np.random.default_rng(seed).normal(size=tip.shape)
    return Recording(t, None, None, tip)


@pytest.mark.parametrize("noise, late", [(0.0, 0.0), (1e-5, 0.01), (1e-4, 0.01), (1e-3, 0.03)])
@pytest.mark.parametrize("seed", range(5))
def test_onset(noise, late, seed):
    assert -1e-9 <= detect_onset(released(noise, seed=seed)) - 0.5 <= late + 1e-9


def test_onset_passes_over_outliers_and_gaps():
    recording = released(noise=1e-5)
    recording.tip_positions[10] += 0.02
    recording.tip_positions[20:25] = np.nan
    assert abs(detect_onset(recording) - 0.5) < 0.011


def test_onset_of_a_tip_that_moves_at_once_or_never():
    assert detect_onset(released(release=0.0)) == 0.0
    still = released(noise=1e-4, release=5.0)
    with pytest.raises(RecordingError, match="never moves"):
        detect_onset(still)


def write_c3d(path, points, labels, units="mm", rate=100.0):
    """`points`, (frames, markers, 3), NaN where missing."""
    ezc3d = pytest.importorskip("ezc3d")
    file = ezc3d.c3d()
    file["parameters"]["POINT"]["RATE"]["value"] = [rate]
    file["parameters"]["POINT"]["LABELS"]["value"] = labels
    file["parameters"]["POINT"]["UNITS"]["value"] = [units]
    ones = np.ones((1, points.shape[1], len(points)))
    file["data"]["points"] = np.concatenate([points.transpose(2, 1, 0), ones])
    file.write(str(path))
    return path


def captured(shift=(5.0, 6.0, 700.0)):
    """Two tip markers and one on a clamp that slides 1 mm along x, in millimetres."""
    tip = 1e3 * released().tip_positions
    clamp = np.linspace(0, 1, len(tip))[:, None] * [1.0, 0, 0]
    markers = [tip + clamp + [0, 3, 0], tip + clamp - [0, 3, 0], clamp - [0, 0, 5]]
    return np.stack(markers, axis=1) + np.array(shift)


LABELS = ["Beam:Tip_1", "Beam:tip_2", "Beam:BASE"]


def test_c3d(tmp_path):
    points = captured()
    points[7, 1] = np.nan
    recording = load_recording(write_c3d(tmp_path / "a.c3d", points, LABELS), beam())
    expected = released().tip_positions
    expected[7] = np.nan
    assert np.allclose(recording.tip_positions, expected, atol=2e-5, equal_nan=True)
    assert np.allclose(recording.times, 0.01 * np.arange(200))
    assert not recording.origin_known
    assert recording.tensions is None
    assert any("clamp, up to 0.8" in note for note in recording.notes)
    assert abs(detect_onset(recording) - 0.5) < 0.011


def test_c3d_without_base_markers_keeps_the_clamp_in(tmp_path):
    path = write_c3d(tmp_path / "a.c3d", captured(), LABELS)
    tip = load_recording(path, beam(), base_markers=None).tip_positions
    assert tip[-1, 0] - released().tip_positions[-1, 0] > 5e-4


def test_c3d_axes_and_clamp_pose(tmp_path):
    # The file's (x, y, z) are the scene's (z, x, y).
    points = np.roll(captured(), -2, axis=2)[:, :2]
    path = write_c3d(tmp_path / "a.c3d", points, LABELS[:2])
    half = np.sqrt(0.5)  # a quarter turn about x: the rod lies along -y
    scene = Scene(
        0.1,
        Rectangle(0.03, 0.03),
        1e5,
        0.49,
        1e3,
        base_position=jnp.array([0.0, 0.0, 1.0]),
        base_quaternion=jnp.array([half, half, 0.0, 0.0]),
    )
    tip = load_recording(path, as_arrays(scene), axes="y,z,x").tip_positions
    assert np.allclose(tip[:40], [0, -0.1, 1.0], atol=3e-4)
    x = tip[:, 0] - released().tip_positions[:, 0]
    assert np.all(np.abs(x) < 1.1e-3)


@pytest.mark.parametrize(
    "change, options, fragments",
    [
        ({}, {"tip_markers": "end"}, ["'end'", "Beam:Tip_1"]),
        ({}, {"axes": "x,y"}, ["axes = 'x,y'", "-y,x,z"]),
        ({}, {"axes": "x,x,z"}, ["axes"]),
        ({}, {"axes": "-x,y,z"}, ["mirrors"]),
        ({"units": "inch"}, {}, ["POINT:UNITS is 'inch'", "m, cm, mm"]),
        ({"units": "cm"}, {}, ["frame", "m from the base"]),
        ({"points": captured()[52:]}, {}, ["at least 5 frames"]),
        ({"points": np.full((9, 3, 3), np.nan)}, {}, ["no frame has all the markers"]),
    ],
)
def test_c3d_refuses(tmp_path, change, options, fragments):
    content = {"points": captured(), "labels": LABELS, **change}
    path = write_c3d(tmp_path / "a.c3d", **content)
    with pytest.raises(RecordingError) as error:
        load_recording(path, beam(), **options)
    for fragment in ["a.c3d", *fragments]:
        assert fragment in str(error.value)


def test_c3d_refuses_other_files(tmp_path):
    path = tmp_path / "a.c3d"
    for content in [b"", b"plain text, and long enough", b"\x02\x50" + bytes(600)]:
        path.write_bytes(content)
        with pytest.raises(RecordingError, match="C3D"):
            load_recording(path, beam())
    with pytest.raises(RecordingError, match="give the scene"):
        load_recording(path)


def test_c3d_that_crashes_its_reader(tmp_path):
    path = write_c3d(tmp_path / "a.c3d", captured(), LABELS)
    content = bytearray(path.read_bytes())
    content[content.index(b"FRAMES") + 9] = 250  # how many dimensions the parameter has
    path.write_bytes(content)
    with pytest.raises(RecordingError, match="a.c3d: ezc3d crashes on it.*corrupted"):
        load_recording(path, beam())


def test_c3d_says_that_a_file_was_cut_short(tmp_path):
    path = write_c3d(tmp_path / "a.c3d", captured(), LABELS)
    path.write_bytes(path.read_bytes()[:-2000])
    notes = load_recording(path, beam()).notes
    assert any("ends early" in note and "of 200 frames" in note for note in notes)


def test_c3d_without_the_package(tmp_path, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "ezc3d", None)
    with pytest.raises(RecordingError, match=r"pip install 'softrod_jax\[c3d\]'"):
        load_recording(tmp_path / "a.c3d", beam())


@pytest.mark.skipif(not BEAM.is_dir(), reason="the recorded beam is not here (shared/data/beam)")
@pytest.mark.parametrize(
    "name, release, lowest", [("gravity_V2_a", 0.70, -0.0101), ("load52_V2_a", 0.43, -0.0247)]
)
def test_recorded_beam(name, release, lowest):
    pytest.importorskip("ezc3d")
    recording = load_recording(BEAM / f"beam_{name}.c3d", beam())
    assert abs(detect_onset(recording) - release) < 0.011
    assert np.allclose(np.median(recording.tip_positions[:40], axis=0), [0, 0, 0.1], atol=1e-5)
    assert abs(recording.tip_positions[:, 0].min() - lowest) < 3e-4
    assert recording.has_tip.all()
