"""Tables as people in several countries and with several programs write them: read, or the key
named."""

import jax.numpy as jnp
import numpy as np
import pytest

from calibration import RecordingError, load_recording
from softrod_jax.scene.chambers import Chambers
from softrod_jax.scene.scene import Scene, as_arrays
from softrod_jax.scene.sections import Circle
from softrod_jax.scene.tendons import Tendons


def rod():
    """0.1 m long, with a tendon and a chamber."""
    tendons, chambers = Tendons(jnp.array([[4e-3, 0]])), Chambers([7e-6], [[0.0, 0.0]])
    parts = {"tendons": tendons, "chambers": chambers}
    return as_arrays(Scene(0.1, Circle(5e-3), 3e5, 0.45, 1070.0, **parts))


TIP = '[tip]\ncolumns = ["X", "Y", "Z"]\nunit = "mm"\n'
TIME = '[time]\ncolumn = "t"\n'
INPUTS = '[[tensions]]\ncolumn = "F"\n[[pressures]]\ncolumn = "P"\n'
TABLE = "t,X,Y,Z\n0.00,0,0,100\n0.01,0.1,0,100\n0.02,0.2,0,100\n"


def load(tmp_path, text, mapping, name="log.csv", encoding="utf-8"):
    path = tmp_path / name
    path.write_bytes(text if isinstance(text, bytes) else text.encode(encoding))
    (tmp_path / "log.map.toml").write_text(mapping, encoding="utf-8")
    return load_recording(path, rod(), mapping=tmp_path / "log.map.toml")


def check(recording, rows=3):
    """The tip of `TABLE`."""
    np.testing.assert_allclose(recording.times, 0.01 * np.arange(rows), atol=1e-9)
    expected = np.array([[1e-4 * k, 0, 0.1] for k in range(rows)])
    np.testing.assert_allclose(recording.tip_positions, expected, atol=1e-12)


GERMAN = "t;F;P;X;Y;Z\n0,00;0,5;20.000;0,0;0,0;100,0\n0,01;0,5;1.020.000,5;0,1;0,0;100,0\n"


def test_points_separate_thousands_where_the_decimal_sign_is_a_comma(tmp_path):
    mapping = TIME + TIP + INPUTS + "[csv]\ndelimiter = ';'\ndecimal = ','\n"
    recording = load(tmp_path, GERMAN, mapping)
    check(recording, 2)
    np.testing.assert_array_equal(recording.pressures[:, 0], [20000, 1020000.5])
    np.testing.assert_array_equal(recording.tensions[:, 0], [0.5, 0.5])


@pytest.mark.parametrize(
    "cell, decimal, value",
    [
        ("20.000", ",", 20000.0),
        ("1.5E+03", ".", 1500.0),
        ("1,5E+03", ",", 1500.0),
        ("20'000.5", ".", 20000.5),
        ("20\u2019000,5", ",", 20000.5),
        ("20 000,5", ",", 20000.5),
        ("20\u202f000,5", ",", 20000.5),
        ("20\u00a0000,5", ",", 20000.5),
        ("20,000", ".", 20000.0),
        ("20,000.5", None, 20000.5),
        ("\u22121.5", ".", -1.5),
        ("+1.5", None, 1.5),
    ],
)
def test_numbers_of_several_countries(tmp_path, cell, decimal, value):
    comma = decimal == ","
    text = f"t;X;Y;Z;F;P\n0;0;0;100;1;{cell}\n1;0;0;100;1;{cell}\n"
    csv = "[csv]\n" + ("" if decimal is None else f"decimal = '{decimal}'\n")
    recording = load(tmp_path, text, TIME + TIP + INPUTS + csv)
    assert recording.pressures[0, 0] == value
    if comma:
        assert "," in cell or cell == "20.000"


@pytest.mark.parametrize(
    "cell, decimal, key",
    [
        ("0,01", "", "decimal = ','"),
        ("1,234", "", "decimal = '.' if the comma separates"),
        ("1.234,5", "", "decimal = ','"),
        ("0.010", ",", "decimal = '.'"),
        ("0.5", ",", "decimal = '.'"),
        ("20.00", ",", "decimal = '.'"),
        ("1.2.3", ".", "'1.2.3'"),
        ("1_0", "", "'1_0'"),
        ("#WERT!", "", "spreadsheet"),
        ("1e999", "", "64 bits"),
        ("12:30", "", "date or time"),
    ],
)
def test_numbers_that_could_be_another_name_the_key(tmp_path, cell, decimal, key):
    text = f"t;X;Y;Z;F;P\n0;0;0;100;1;20\n1;0;0;100;1;{cell}\n"
    csv = f"[csv]\ndecimal = '{decimal}'\n" if decimal else ""
    with pytest.raises(RecordingError) as error:
        load(tmp_path, text, TIME + TIP + INPUTS + csv)
    message = str(error.value)
    assert key in message
    for part in ("log.csv: row 3, column P", repr(cell)):
        assert part in message


@pytest.mark.parametrize("mark", ["", "NA", "n/a", "#N/A", "#NV", "NaN", "null", "-", "NaN(Ind)"])
def test_marks_of_samples_that_are_missing(tmp_path, mark):
    recording = load(tmp_path, TABLE.replace("0.1,0", f"{mark},0"), TIME + TIP)
    assert np.array_equal(recording.has_tip, [True, False, True])


def test_marks_that_the_mapping_names(tmp_path):
    text = TABLE.replace("0.1,0", "weg,0").replace("0.2,0", "-9999,0")
    recording = load(tmp_path, text, TIME + TIP + "missing = [-9999]\n[csv]\nmissing = 'weg'\n")
    assert np.array_equal(recording.has_tip, [True, False, False])


@pytest.mark.parametrize("encoding", ["cp1252", "utf-16", "utf-16-le", "utf-16-be", "utf-8-sig"])
def test_letters_of_several_encodings(tmp_path, encoding):
    text = TABLE.replace("t,X", "Zeit für alles,X")
    check(load(tmp_path, text, '[time]\ncolumn = "Zeit für alles"\n' + TIP, encoding=encoding))


@pytest.mark.parametrize(
    "first, second, form",
    [
        ("2024-01-05 10:00:00.000", "2024-01-05 10:00:00.010", None),
        ("2024-01-05T10:00:00,000Z", "2024-01-05T10:00:00,010Z", None),
        ("2024-01-05T23:59:59.995+01:00", "2024-01-06T00:00:00.005+01:00", None),
        ("05.01.2024 10:00:00,000", "05.01.2024 10:00:00,010", None),
        ("05-Jan-2024 10:00:00.000", "05-Jan-2024 10:00:00.010", None),
        ("2024/01/05 10:00:00.000000000", "2024/01/05 10:00:00.010000000", None),
        ("1/5/2024 10:00:00.000 PM", "1/5/2024 10:00:00.010 PM", "%m/%d/%Y %I:%M:%S.%f %p"),
    ],
)
def test_dates(tmp_path, first, second, form):
    text = f"t;X;Y;Z\n{first};0;0;100\n{second};0.1;0;100\n"
    mapping = TIME + (f'format = "{form}"\n' if form else "") + TIP
    recording = load(tmp_path, text, mapping)
    check(recording, 2)
    assert any("time 0 is 2024-01-05T" in note for note in recording.notes)


def test_durations_say_their_unit(tmp_path):
    text = "Time,X,Y,Z\n0 sec,0,0,100\n0.01 sec,0.1,0,100\n20 ms,0.2,0,100\n"
    mapping = '[time]\ncolumn = "Time"\n'
    check(load(tmp_path, text, mapping + TIP))
    with pytest.raises(RecordingError, match="time.unit = 'ms'.*leave it out"):
        load(tmp_path, text, mapping + 'unit = "ms"\n' + TIP)


def test_times_of_day_are_seconds(tmp_path):
    text = TABLE.replace("0.0", "10:00:00.0")
    np.testing.assert_allclose(load(tmp_path, text, TIME + TIP).times, 36000 + np.arange(3) / 100)
    late = "t,X,Y,Z\n23:59:59.99,0,0,100\n00:00:00.00,0,0,100\n"
    with pytest.raises(RecordingError, match="midnight"):
        load(tmp_path, late, TIME + TIP)


@pytest.mark.parametrize(
    "change, fragments",
    [
        (("0.01", "1/5/2024 10:00"), ["row 3, column t", "1/5/2024"]),
        (("0.0", "1/5/2024 10:0"), ["row 2, column t", "[time] format"]),
        (("0.00,0", "noon,0"), ["row 2, column t", "'noon'", "format"]),
    ],
)
def test_dates_that_mean_several_days_name_the_key(tmp_path, change, fragments):
    with pytest.raises(RecordingError) as error:
        load(tmp_path, TABLE.replace(*change), TIME + TIP)
    for fragment in fragments:
        assert fragment in str(error.value)


UNITS_ROW = "t,X,Y,Z,F,P\ns,mm,mm,mm,mN,kPa\n0.00,0,0,100,500,20\n0.01,0.1,0,100,500,20\n"


@pytest.mark.parametrize("unit", ["", 'unit = "mm"\n'])
def test_a_row_of_units_is_believed(tmp_path, unit):
    recording = load(tmp_path, UNITS_ROW, TIME + TIP.replace('unit = "mm"\n', unit) + INPUTS)
    check(recording, 2)
    assert recording.tensions[0, 0] == 0.5
    assert recording.pressures[0, 0] == 20000


def test_units_in_names_are_believed(tmp_path):
    text = UNITS_ROW.replace("s,mm,mm,mm,mN,kPa\n", "")
    text = text.replace("t,X,Y,Z,F,P", "Time (ms),X [mm],Y [mm],Z [mm],F in mN,P_kPa")
    text = text.replace("0.01,", "10,")
    mapping = TIME.replace('"t"', '"Time"') + TIP.replace('unit = "mm"\n', "") + INPUTS
    recording = load(tmp_path, text, mapping)
    check(recording, 2)
    assert (recording.tensions[0, 0], recording.pressures[0, 0]) == (0.5, 20000)


@pytest.mark.parametrize(
    "mapping, fragments",
    [
        (TIME + TIP.replace("mm", "m"), ["column X", "'mm'", "unit = 'm'", "ignore_file_unit"]),
        (TIME + TIP + INPUTS.replace('"P"', '"P"\nunit = "bar"'), ["column P", "'kPa'", "'bar'"]),
        (TIME + TIP + INPUTS.replace('"F"', '"P"'), ["column P", "'kPa'", "a pressure", "a force"]),
        (TIME + 'unit = "ms"\n' + TIP, ["column t", "'s'", "'ms'"]),
    ],
)
def test_units_that_contradict_the_mapping(tmp_path, mapping, fragments):
    with pytest.raises(RecordingError) as error:
        load(tmp_path, UNITS_ROW, mapping)
    for fragment in ["log.csv", *fragments]:
        assert fragment in str(error.value)


def test_a_voltage_is_a_force_only_with_a_scale(tmp_path):
    text = UNITS_ROW.replace("mN", "V")
    with pytest.raises(RecordingError, match="a voltage, where a force is needed"):
        load(tmp_path, text, TIME + TIP + INPUTS)
    scaled = INPUTS.replace('"F"', '"F"\nscale = 2e-3')
    assert load(tmp_path, text, TIME + TIP + scaled).tensions[0, 0] == 1.0


def test_a_file_that_names_the_wrong_unit_can_be_overruled(tmp_path):
    text = UNITS_ROW.replace("s,mm,mm,mm", "s,m,m,m")
    check(load(tmp_path, text, TIME + TIP + "ignore_file_unit = true\n"), 2)


MOTIVE = """\
Format Version,1.23,Capture Frame Rate,100,Rotation Type,Quaternion,Length Units,Meters

,,Marker,Marker,Marker,Rigid Body,Rigid Body,Rigid Body,Rigid Body,Marker,Marker,Marker
,,tip,tip,tip,tip body,tip body,tip body,tip body,base,base,base
,,1:A,1:A,1:A,3:C,3:C,3:C,3:C,2:B,2:B,2:B
,,Position,Position,Position,Rotation,Rotation,Rotation,Rotation,Position,Position,Position
Frame,Time (Seconds),X,Y,Z,X,Y,Z,W,X,Y,Z
0,0.000,0.0,0.0,0.1,0,0,0,1,9,0,0
1,0.010,1e-4,0.0,0.1,0,0,0,1,9,0,0
2,0.020,,,,0,0,0,1,9,0,0
"""
VICON = """\
Devices
1000
,,Cell - Force,
Frame,Sub Frame,F,P
,,N,kPa
1,0,0.5,20
1,1,0.5,20
,,,
Trajectories
100
,,robot:tip,,,robot:base,,
Frame,Sub Frame,X,Y,Z,X,Y,Z
,,mm,mm,mm,mm,mm,mm
1,0,0.0,0.0,100,0,9,0
2,0,0.1,0.0,100,0,9,0
3,0,,,,0,9,0
"""
QUALISYS = """\
NO_OF_FRAMES\t3
NO_OF_MARKERS\t2
FREQUENCY\t100
DATA_INCLUDED\t3D
MARKER_NAMES\ttip\tbase
0.0\t0.0\t100\t9\t0\t0
0.1\t0.0\t100\t9\t0\t0
0.000\t0.000\t0.000\t9\t0\t0
"""
TRC = """\
PathFileType\t4\t(X/Y/Z)\tone.trc
DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits
100\t100\t3\t2\tmm
Frame#\tTime\ttip\t\t\tbase\t\t
\t\tX1\tY1\tZ1\tX2\tY2\tZ2

1\t0.00\t0.0\t0.0\t100\t9\t0\t0
2\t0.01\t0.1\t0.0\t100\t9\t0\t0
3\t0.02\t\t\t\t9\t0\t0
"""
NAMED = '[tip]\ncolumns = ["tip.x", "tip.y", "tip.z"]\n'


@pytest.mark.parametrize(
    "text, name", [(MOTIVE, "a.csv"), (VICON, "a.csv"), (QUALISYS, "a.tsv"), (TRC, "a.trc")]
)
@pytest.mark.parametrize("tip", [NAMED, '[tip]\ncolumns = ["X", "Y", "Z"]\n'])
def test_exports_of_motion_capture(tmp_path, text, name, tip):
    recording = load(tmp_path, text, tip.replace("robot:", ""), name) if text != VICON else load(
        tmp_path, text, tip.replace("tip.", "robot:tip."), name
    )  # fmt: skip
    np.testing.assert_allclose(recording.times, [0, 0.01, 0.02])
    assert np.array_equal(recording.has_tip, [True, True, False])
    np.testing.assert_allclose(recording.tip_positions[1], [1e-4, 0, 0.1])


def test_motive_as_the_mapping_of_a_plain_table_reads_it(tmp_path):
    mapping = '[time]\ncolumn = "Time (Seconds)"\n[tip]\ncolumns = ["X", "Y", "Z"]\n'
    recording = load(tmp_path, MOTIVE, mapping + 'unit = "m"\n[csv]\nskip_rows = 6\n')
    np.testing.assert_allclose(recording.tip_positions[1], [1e-4, 0, 0.1])


@pytest.mark.parametrize(
    "change, mapping, fragments",
    [
        (("", ""), NAMED + 'unit = "mm"\n', ["'Meters'", "'mm'"]),
        (("tip,tip,tip,", "end,end,end,"), NAMED, ["no column 'tip.x'", "end.X"]),
        (("tip,tip,tip,", "a,a,a,"), NAMED.replace("tip.", ""), ["columns are called 'x'", "a.X"]),
        (("base,base,base", "tip,tip,tip"), NAMED, ["2 columns are called 'tip.x'"]),
        (("", ""), NAMED.replace("tip.", "tip body.Rotation."), ["'quaternion'", "an angle"]),
    ],
)
def test_exports_of_motion_capture_that_are_refused(tmp_path, change, mapping, fragments):
    with pytest.raises(RecordingError) as error:
        load(tmp_path, MOTIVE.replace(*change), mapping)
    for fragment in fragments:
        assert fragment in str(error.value)


def test_vicon_devices_have_a_rate_of_their_own(tmp_path):
    inputs = INPUTS.replace('"F"', '"Cell - Force.F"').replace('"P"', '"Cell - Force.P"')
    inputs = inputs.replace("\n[[pr", "\ntime = { rate = 100.0 }\n[[pr")
    recording = load(
        tmp_path,
        VICON.replace("1000\n", "100\n"),
        NAMED.replace("tip.", "robot:tip.") + inputs + "time = { rate = 100.0 }\n",
    )
    assert recording.tensions[0, 0] == 0.5
    assert recording.pressures[0, 0] == 20000


def test_labview_measurement_file(tmp_path):
    text = (
        "LabVIEW "
        "Measurement\t\nWriter_Version\t2\nSeparator\tTab\n***End_of_Header***\t\nChannels\t4\n"
        "***End_of_Header***\t\nX_Value\tX\tY\tZ\tComment\n0.00\t0\t0\t100\tstart\n0.01\t0.1\t0\t100\n"
    )
    check(load(tmp_path, text, '[time]\ncolumn = "X_Value"\n' + TIP, "a.lvm"), 2)


@pytest.mark.parametrize(
    "text, csv",
    [
        (TABLE.replace(",", ";"), ""),
        (TABLE.replace(",", "\t"), ""),
        (TABLE.replace(",", "   "), ""),
        (TABLE.replace(",", "|"), "delimiter = '|'"),
        (TABLE.replace(",", " "), "delimiter = 'space'"),
        (TABLE.replace("\n", ",\n"), ""),
        (TABLE.replace("\n", "\r\n"), ""),
        (TABLE.replace("\n", "\r"), ""),
        ("Lab 3\nRate,100\n\n" + TABLE, ""),
        ("Lab 3\nRate,100\n\n" + TABLE, "skip_rows = 3"),
        ("Range,1,2\n" + TABLE, "skip_rows = 1"),
        (TABLE.replace("0,0,100", '"0","0","100"'), ""),
        ('t,X,Y,Z,note\n0,0,0,100,"a, b"\n0.01,0.1,0,100,\n0.02,0.2,0,100,c\n', ""),
        ("t,X,Y,Z\n\n0,0,0,100\n0.01,0.1,0,100\n\n0.02,0.2,0,100\n", ""),
    ],
)
def test_separators_and_lines_before_the_header(tmp_path, text, csv):
    check(load(tmp_path, text, TIME + TIP + (f"[csv]\n{csv}\n" if csv else "")))


def test_a_table_without_a_header(tmp_path):
    text = TABLE.split("\n", 1)[1]
    mapping = '[time]\ncolumn = "1"\n[tip]\ncolumns = ["2", "3", "4"]\nunit = "mm"\n'
    check(load(tmp_path, text, mapping + "[csv]\nheader = false\n"))
    with pytest.raises(RecordingError, match=r"\[csv\] header = false"):
        load(tmp_path, text, TIME + TIP)


def test_two_columns_of_one_name(tmp_path):
    text = TABLE.replace("t,X", "t,Y")
    with pytest.raises(RecordingError, match=r"2 columns are called 'Y'.*Y \(column 2\)"):
        load(tmp_path, text, TIME + TIP.replace('"X", ', '"Y", '))
    check(load(tmp_path, text, TIME + TIP.replace('"X", "Y"', '"Y (column 2)", "Y (column 3)"')))


@pytest.mark.parametrize(
    "content, name, fragment",
    [
        (b"PK\x03\x04" + bytes(50), "a.csv", "Excel"),
        (b"\xd0\xcf\x11\xe0" + bytes(50), "a.txt", "Excel"),
        (b"PK\x03\x04" + bytes(50), "a.xlsx", "save the sheet as CSV"),
        (b"\x89HDF\r\n\x1a\n", "a.csv", ".h5"),
        (b"t,X\n\x00\x01\x02\xff\xfe", "a.csv", "no text"),
    ],
)
def test_files_that_are_no_text(tmp_path, content, name, fragment):
    with pytest.raises(RecordingError, match=fragment):
        load(tmp_path, content, TIME + TIP, name)


@pytest.mark.parametrize("kind", ["duration", "time", "timestamp", "unused", "decimal"])
def test_types_of_parquet(tmp_path, kind):
    pa = pytest.importorskip("pyarrow")
    parquet = pytest.importorskip("pyarrow.parquet")
    nanoseconds = [0, 10_000_000, 20_000_000]
    times = {
        "duration": pa.array(nanoseconds, pa.duration("ns")),
        "time": pa.array([0, 10_000, 20_000], pa.time64("us")),
        "timestamp": pa.array(nanoseconds, pa.timestamp("ns", tz="Europe/Berlin")),
        "unused": pa.array([0.0, 0.01, 0.02]),
        "decimal": pa.array(["0.00", "0.01", "0.02"]).cast(pa.decimal128(10, 3)),
    }[kind]
    columns = {"t": times, "X": [0, 0.1, 0.2], "Y": [0, 0, 0], "Z": [100, 100, 100]}
    odd = {"dur": pa.array(nanoseconds, pa.duration("us")), "list": [[1.0]] * 3, "s": ["a"] * 3}
    parquet.write_table(pa.table({**columns, **odd}), tmp_path / "a.parquet")
    (tmp_path / "a.map.toml").write_text(TIME + TIP)
    check(load_recording(tmp_path / "a.parquet", rod(), mapping=tmp_path / "a.map.toml"))
    (tmp_path / "a.map.toml").write_text(TIME + TIP.replace('"X"', '"list"'))
    with pytest.raises(RecordingError, match="column 'list' is of type list"):
        load_recording(tmp_path / "a.parquet", rod(), mapping=tmp_path / "a.map.toml")


def test_coordinates_in_rows_of_an_array(tmp_path):
    io = pytest.importorskip("scipy.io")
    tip = np.array([[1e-4 * k, 0, 0.1] for k in range(90)])
    io.savemat(tmp_path / "a.mat", {"tip": tip.T})
    mapping = '[time]\nrate = 100.0\n[tip]\ncolumns = ["tip[1]", "tip[2]", "tip[3]"]\n'
    (tmp_path / "a.map.toml").write_text(mapping)
    check(load_recording(tmp_path / "a.mat", rod(), mapping=tmp_path / "a.map.toml"), 90)
