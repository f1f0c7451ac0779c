"""Motion captures (C3D): units, markers that were not seen, labels, and what is no position."""

import struct

import numpy as np
import pytest
from test_recording import beam, captured, released, write_c3d

from calibration import RecordingError, load_recording

ezc3d = pytest.importorskip("ezc3d")

MAPPING = '[tip]\ncolumns = ["tip.x", "tip.y", "tip.z"]\n'


def mapped(tmp_path, mapping, points=None, labels=("tip",), units="mm"):
    points = 1e3 * released().tip_positions[:, None] if points is None else points
    path = write_c3d(tmp_path / "a.c3d", points, list(labels), units)
    (tmp_path / "m.toml").write_text(mapping)
    return load_recording(path, beam(), mapping=tmp_path / "m.toml")


@pytest.mark.parametrize("unit", ["", 'unit = "mm"\n', 'unit = "millimeters"\n'])
def test_the_unit_of_the_file_is_applied_once(tmp_path, unit):
    recording = mapped(tmp_path, MAPPING + unit)
    np.testing.assert_allclose(recording.tip_positions, released().tip_positions, atol=1e-8)


def test_a_unit_that_contradicts_the_file(tmp_path):
    with pytest.raises(RecordingError, match=r"the file says 'mm', and .*tip.unit = 'm'"):
        mapped(tmp_path, MAPPING + 'unit = "m"\n')
    with pytest.raises(RecordingError, match="'inches' it would fit|unit"):
        mapped(tmp_path, MAPPING + 'unit = "m"\nignore_file_unit = true\n')
    points = released().tip_positions[:, None]
    right = mapped(tmp_path, MAPPING + 'unit = "m"\nignore_file_unit = true\n', points)
    np.testing.assert_allclose(right.tip_positions, released().tip_positions, atol=1e-8)


@pytest.mark.parametrize("units", ["", "furlong"])
def test_a_unit_that_only_the_mapping_knows(tmp_path, units):
    recording = mapped(tmp_path, MAPPING + 'unit = "mm"\n', units=units)
    np.testing.assert_allclose(recording.tip_positions, released().tip_positions, atol=1e-8)


def test_the_origin_is_in_the_unit_of_the_file(tmp_path):
    points = 1e3 * released().tip_positions[:, None] + [10, 20, 30]
    recording = mapped(tmp_path, MAPPING + "origin = [10, 20, 30]\n", points)
    np.testing.assert_allclose(recording.tip_positions, released().tip_positions, atol=1e-8)


@pytest.mark.parametrize("mapping", [None, MAPPING, MAPPING + "rest = true\n"])
def test_frames_at_zero_are_missing(tmp_path, mapping):
    points = 1e3 * released().tip_positions[:, None]
    points[60:72] = 0
    if mapping is None:
        recording = load_recording(write_c3d(tmp_path / "a.c3d", points, ["tip"]), beam())
    else:
        recording = mapped(tmp_path, mapping, points)
    assert np.sum(~recording.has_tip) == 12
    assert any("12 frames of tip at exactly (0, 0, 0)" in note for note in recording.notes)


def test_a_base_that_marks_the_origin_is_no_missing_marker(tmp_path):
    points = 1e3 * np.stack([released().tip_positions, 0 * released().tip_positions], axis=1)
    recording = load_recording(write_c3d(tmp_path / "a.c3d", points, ["tip", "base"]), beam())
    assert recording.has_tip.all()


@pytest.mark.parametrize("count", [255, 256, 262, 520])
def test_more_labels_than_a_parameter_holds(tmp_path, count):
    points = np.zeros((200, count, 3))
    points[:, -1] = 1e3 * released().tip_positions
    labels = [*(f"m{k}" for k in range(count - 1)), "tip"]
    path = write_c3d(tmp_path / "a.c3d", points, labels)
    recording = load_recording(path, beam())
    np.testing.assert_allclose(recording.tip_positions, released().tip_positions, atol=1e-7)


def doubled(second):
    """A tip, and another marker 2 mm beside it or wherever `second` puts it [mm]."""
    tip = 1e3 * released().tip_positions
    return np.stack([tip, tip + second if np.ndim(second) == 1 else second], axis=1)


def test_two_markers_of_one_name(tmp_path):
    points = doubled(np.array([2.0, 0, 0]))
    path = write_c3d(tmp_path / "a.c3d", points, ["tip", "tip"])
    with pytest.raises(RecordingError, match="two markers are called 'tip'"):
        load_recording(path, beam())
    with pytest.raises(RecordingError, match="a label that two markers have"):
        mapped(tmp_path, MAPPING, points, ["tip", "tip"])


def test_of_two_markers_of_one_name_one_was_never_seen(tmp_path):
    points = doubled(np.full((200, 3), np.nan))
    path = write_c3d(tmp_path / "a.c3d", points, ["tip", "tip"])
    assert load_recording(path, beam()).has_tip.all()


def test_markers_of_two_subjects(tmp_path):
    points = doubled(np.array([2.0, 0, 0]))
    path = write_c3d(tmp_path / "a.c3d", points, ["Left:tip", "Right:tip"])
    with pytest.raises(RecordingError, match="Left:tip, Right:tip are of 2 subjects"):
        load_recording(path, beam())
    recording = load_recording(path, beam(), tip_markers="left:tip")
    np.testing.assert_allclose(recording.tip_positions, released().tip_positions, atol=1e-7)


ANGLES = 20 + 10 * np.sin(np.arange(600)).reshape(200, 3)


@pytest.mark.parametrize(
    "label", ["TipAngles", "tip_angle", "tip.force", "TipMoment", "tip velocity"]
)
def test_what_is_named_as_no_position_is_left_out(tmp_path, label):
    path = write_c3d(tmp_path / "a.c3d", doubled(ANGLES), ["tip", label])
    recording = load_recording(path, beam())
    np.testing.assert_allclose(recording.tip_positions, released().tip_positions, atol=1e-7)
    assert any(f"{label}: no positions, left out" in note for note in recording.notes)


def test_what_the_file_lists_as_angles_is_left_out(tmp_path):
    path = write_c3d(tmp_path / "a.c3d", doubled(ANGLES), ["tip", "tip2"])
    file = ezc3d.c3d(str(path))
    file.add_parameter("POINT", "ANGLES", ["tip2"])
    file.write(str(path))
    recording = load_recording(path, beam())
    np.testing.assert_allclose(recording.tip_positions, released().tip_positions, atol=1e-7)


def test_what_cannot_be_on_one_body_is_refused(tmp_path):
    path = write_c3d(tmp_path / "a.c3d", doubled(ANGLES * [1, 1, 8]), ["tip1", "tip2"])
    with pytest.raises(RecordingError, match="tip1 and tip2 are .* apart.*not on one body"):
        load_recording(path, beam())
    markers = '[tip]\nmarkers = [["tip1.x", "tip1.y", "tip1.z"], ["tip2.x", "tip2.y", "tip2.z"]]\n'
    with pytest.raises(RecordingError, match="not on one body"):
        mapped(tmp_path, markers, doubled(ANGLES * [1, 1, 8]), ["tip1", "tip2"])


def test_an_angle_is_no_tip(tmp_path):
    mapping = MAPPING.replace("tip.", "TipAngles.")
    with pytest.raises(RecordingError, match="the file says 'deg', an angle, where a length"):
        mapped(tmp_path, mapping, doubled(ANGLES), ["tip", "TipAngles"])


def test_a_rate_that_only_the_mapping_knows(tmp_path):
    path = write_c3d(tmp_path / "a.c3d", 1e3 * released().tip_positions[:, None], ["tip"])
    content, rate = path.read_bytes(), struct.pack("<f", 100.0)
    # The header and the parameters say it; 100 is among the coordinates, too.
    path.write_bytes(content[:1536].replace(rate, bytes(4)) + content[1536:])
    (tmp_path / "m.toml").write_text(MAPPING)
    with pytest.raises(RecordingError, match="time is missing"):
        load_recording(path, beam(), mapping=tmp_path / "m.toml")
    with pytest.raises(RecordingError, match="POINT:RATE is missing"):
        load_recording(path, beam())
    (tmp_path / "m.toml").write_text(MAPPING + "[time]\nrate = 100.0\n")
    assert load_recording(path, beam(), mapping=tmp_path / "m.toml").times[1] == 0.01


@pytest.mark.parametrize("seed", range(8))
def test_damaged_files_are_read_or_refused(tmp_path, seed):
    path = write_c3d(tmp_path / "a.c3d", captured()[:60], ["tip1", "tip2", "base"])
    content = bytearray(path.read_bytes())
    random = np.random.default_rng(seed)
    for at in random.integers(0, 1500, 12):
        content[at] = random.integers(256)
    path.write_bytes(content)
    try:
        load_recording(path, beam())
    except RecordingError as error:
        assert "a.c3d" in str(error)
