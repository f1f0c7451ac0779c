"""Logs of tendons that are driven by their length."""

import numpy as np
import pytest

import softrod_jax as sr
from calibration import RecordingError, load_recording, write_log
from calibration.data.recording import Recording
from calibration.data.selection import input_onset

TIMES = np.arange(20) / 50
TIP = np.stack([0.01 * TIMES, 0 * TIMES, 0.1 - 0.01 * TIMES], axis=1)
TENSION, PULLS = 1.0 + TIMES[:, None], 1e-3 * np.stack([TIMES, -TIMES], axis=1)
HEADER = "t_s,tau1_N,tip_x_m,tip_y_m,tip_z_m,pull1_m,pull2_m"


def rod(control=("length", "tension", "length")):
    tendons = sr.Tendons([[4e-3, 0.0], [0.0, 4e-3], [-4e-3, 0.0]], control=control)
    return sr.Scene(0.1, sr.Circle(6e-3), 2e5, 0.49, 1070.0, tendons=tendons)


def written(tmp_path, header):
    """A log of `header` whose numbers are right where their column is known."""
    known = dict(
        zip(HEADER.split(","), np.hstack([TIMES[:, None], TENSION, TIP, PULLS]).T, strict=True)
    )
    columns = [known.get(name, TIMES) for name in header.split(",")]
    path = tmp_path / "a.csv"
    lines = [",".join(repr(float(x)) for x in row) for row in zip(*columns, strict=True)]
    path.write_text("\n".join([header, *lines]))
    return path


def test_what_is_written_is_read_bit_by_bit(tmp_path):
    write_log(tmp_path / "a.csv", TIMES, TENSION, None, TIP, pulls=PULLS)
    header = (tmp_path / "a.csv").read_text().splitlines()[0]
    assert header == "t_s,tau1_N,pull1_m,pull2_m,tip_x_m,tip_y_m,tip_z_m"
    for scene in (rod(), None):
        recording = load_recording(tmp_path / "a.csv", scene)
        assert np.array_equal(recording.tensions, TENSION) and recording.pressures is None
        assert np.array_equal(recording.pulls, PULLS)
        assert np.array_equal(recording.tip_positions, TIP)
    assert np.array_equal(recording.window(0.1, 0.2).pulls, PULLS[5:11])


@pytest.mark.parametrize(
    "header",
    [
        HEADER,
        "t_s,pull2_m,tau1_N,pull1_m,tip_x_m,tip_y_m,tip_z_m",
        "t_s,tau1_N,tip_x_m,pull1_m,tip_y_m,pull2_m,tip_z_m",
    ],
)
def test_pulls_stand_anywhere_after_the_time(tmp_path, header):
    recording = load_recording(written(tmp_path, header), rod())
    for name, values in (("tensions", TENSION), ("pulls", PULLS), ("tip_positions", TIP)):
        assert np.array_equal(getattr(recording, name), values)


@pytest.mark.parametrize(
    "header, control, words",
    [
        ("t_s,tau1_N,tip_x_m,tip_y_m,tip_z_m,pull1_m", None, "column pull2_m is missing"),
        (HEADER.replace("pull2_m", "pull2_mm"), None, "missing; convert it to m and rename it"),
        (HEADER + ",pull3_m", None, "column 8 is 'pull3_m', one too many"),
        (HEADER + ",pull2_m", None, "column 8 is 'pull2_m', one too many"),
        (HEADER, "length", "column 2 is 'tau1_N', expected 'tip_x_m'"),
        (HEADER, "tension", r"column 3 is 'tip_x_m', expected 'tau2_N' \(the scene has 3 tendons"),
        ("pull1_m," + HEADER, None, "column 1 is 'pull1_m', expected 't_s'"),
        (
            "t_s,pull1_m,pull2_m,tip_x_m,tip_y_m,tip_z_m",
            None,
            r"expected 'tau1_N' \(the scene has 1 tendons driven by tension, 0 chambers and 2 "
            r"tendons driven by length, so expected t_s, tau1_N, pull1_m, pull2_m, tip_x_m",
        ),
    ],
)
def test_columns_that_the_scene_has_not(tmp_path, header, control, words):
    path, scene = written(tmp_path, header), rod() if control is None else rod(control)
    with pytest.raises(RecordingError, match=words):
        load_recording(path, scene)


def test_pulls_are_needed_in_every_row(tmp_path):
    path = written(tmp_path, HEADER)
    lines = path.read_text().splitlines()
    lines[3] = lines[3].rsplit(",", 1)[0] + ","
    path.write_text("\n".join(lines))
    with pytest.raises(RecordingError, match="row 4, column pull2_m: missing"):
        load_recording(path, rod())


def test_millimetres_in_a_column_of_metres(tmp_path):
    write_log(tmp_path / "a.csv", TIMES, TENSION, None, TIP, pulls=1e3 * PULLS)
    with pytest.raises(RecordingError, match="pull 1 is up to 0.38 m.*is it in millimetres?"):
        load_recording(tmp_path / "a.csv", rod())


MAPPING = """
[time]
column = "t_s"
[tip]
columns = ["tip_x_m", "tip_y_m", "tip_z_m"]
[[tensions]]
column = "tau1_N"
[[pulls]]
column = "mm"
unit = "mm"
[[pulls]]
column = "angle [rad]"
offset = -0.5
scale = 0.01
"""


def test_a_mapping_of_pulls(tmp_path):
    """In mm, and as the angle of a motor with a pulley."""
    table = np.hstack([TIMES[:, None], TENSION, TIP, 1e3 * PULLS[:, :1], 100 * PULLS[:, 1:] + 0.5])
    header = "t_s,tau1_N,tip_x_m,tip_y_m,tip_z_m,mm,angle [rad]"
    np.savetxt(tmp_path / "b.csv", table, delimiter=",", header=header, comments="", fmt="%.17g")
    mapping = tmp_path / "b.map.toml"
    mapping.write_text(MAPPING)
    recording = load_recording(tmp_path / "b.csv", rod(), mapping=mapping)
    np.testing.assert_allclose(recording.pulls, PULLS, rtol=0, atol=1e-15)
    np.testing.assert_array_equal(recording.tensions, TENSION)
    for scene, words in (
        (rod("length"), "tensions: 1 given, and the scene has 0 tendons driven by tension"),
        (rod("tension"), "tensions: 1 given, and the scene has 3 tendons; one"),
        (rod(("length", "tension", "tension")), "tensions: 1 given, and the scene has 2 tendons d"),
    ):
        with pytest.raises(RecordingError, match=words):
            load_recording(tmp_path / "b.csv", scene, mapping=mapping)
    mapping.write_text(MAPPING.replace('unit = "mm"', 'unit = "m"'))
    with pytest.raises(RecordingError, match=r"check \[\[pulls\]\] unit, scale and offset"):
        load_recording(tmp_path / "b.csv", rod(), mapping=mapping)


def test_a_pull_is_an_input_that_begins_and_has_gaps(tmp_path):
    pulls = 1e-3 * np.clip(TIMES - 0.2, 0, None)[:, None]
    recording = Recording(TIMES, None, None, TIP, pulls=pulls)
    assert recording.has_inputs and input_onset(recording) == pytest.approx(0.2)
    keep = (TIMES < 0.24) | (TIMES > 0.34)
    write_log(tmp_path / "a.csv", TIMES[keep], None, None, TIP[keep], pulls=pulls[keep])
    notes = load_recording(tmp_path / "a.csv").notes
    assert any("no samples of pull1_m from" in note for note in notes)
