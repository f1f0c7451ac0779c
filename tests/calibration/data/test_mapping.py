"""Other people's files: MAT, HDF5, Parquet, C3D and CSV with other columns, units and axes."""

from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest

from calibration import RecordingError, load_recording
from calibration.data.tables import read_table
from softrod_jax.scene.scene import Scene, as_arrays
from softrod_jax.scene.sections import Circle
from softrod_jax.scene.tendons import Tendons

TIMES = np.arange(40) / 50
# A tip that rests, then moves along x and sinks: in m, in the scene's frame.
FALL = np.clip(TIMES - 0.3, 0, None)
TIP = np.stack([0.02 * FALL, 0 * FALL, 0.1 - 0.01 * FALL], axis=1)
TENSION = 1.0 + TIMES


def rod():
    tendons = Tendons(jnp.array([[4e-3, 0.0]]))
    return as_arrays(Scene(0.1, Circle(6e-3), 2e5, 0.49, 1070.0, tendons=tendons))


MAPPING = """
[time]
column = "{time}"
unit = "ms"
[tip]
columns = ["{x}", "{y}", "{z}"]
unit = "mm"
axes = "z,x,y"
origin = [10.0, 20.0, 30.0]
[[tensions]]
column = "{force}"
unit = "mN"
offset = -5.0
"""


def columns():
    """The recording in ms, mm, mN, with the file's axes: the scene's x, y, z are its z, x, y."""
    y, z, x = (1e3 * TIP[:, [1, 2, 0]] + [10.0, 20.0, 30.0]).T
    return 1e3 * TIMES, np.stack([y, z, x], axis=1), 1e3 * TENSION + 5.0


def write_mapping(tmp_path, text):
    path = tmp_path / "any.map.toml"
    path.write_text(text)
    return path


def check(recording):
    np.testing.assert_allclose(recording.times, TIMES, atol=1e-12)
    np.testing.assert_allclose(recording.tip_positions, TIP, atol=1e-12)
    np.testing.assert_allclose(recording.tensions[:, 0], TENSION, atol=1e-12)


def test_mat(tmp_path):
    io = pytest.importorskip("scipy.io")
    t, tip, force = columns()
    content = {"log": {"t": t, "tip": tip}, "F": force[:, None], "note": "by hand"}
    io.savemat(tmp_path / "a.mat", content)
    text = MAPPING.format(time="log/t", x="log/tip[1]", y="log/tip[2]", z="log/tip[3]", force="F")
    check(load_recording(tmp_path / "a.mat", rod(), mapping=write_mapping(tmp_path, text)))


def test_hdf5(tmp_path):
    h5py = pytest.importorskip("h5py")
    t, tip, force = columns()
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["daq/t"], file["daq/F"], file["tip"] = t, force, tip
    text = MAPPING.format(time="daq/t", x="tip[1]", y="tip[2]", z="tip[3]", force="daq/F")
    check(load_recording(tmp_path / "a.h5", rod(), mapping=write_mapping(tmp_path, text)))


def test_parquet(tmp_path):
    pyarrow = pytest.importorskip("pyarrow")
    parquet = pytest.importorskip("pyarrow.parquet")
    t, tip, force = columns()
    table = {"t": t, "x": tip[:, 0], "y": tip[:, 1], "z": tip[:, 2], "F": force, "who": ["me"] * 40}
    parquet.write_table(pyarrow.table(table), tmp_path / "a.parquet")
    text = MAPPING.format(time="t", x="x", y="y", z="z", force="F")
    check(load_recording(tmp_path / "a.parquet", rod(), mapping=write_mapping(tmp_path, text)))


def test_csv_with_semicolons_decimal_commas_and_lines_before_the_header(tmp_path):
    t, tip, force = columns()
    rows = [";".join(repr(float(v)) for v in row) for row in np.column_stack([t, tip, force])]
    text = "made by a lab\n\nt;x;y;z;F\n" + "\n".join(rows).replace(".", ",") + "\n"
    (tmp_path / "a.csv").write_text(text)
    mapping = MAPPING.format(time="t", x="x", y="y", z="z", force="F")
    mapping += "[csv]\ndecimal = ','\nskip_rows = 2\n[conditions]\ndensity = 0.9\n"
    recording = load_recording(tmp_path / "a.csv", rod(), mapping=write_mapping(tmp_path, mapping))
    check(recording)
    assert recording.conditions == {"density": 0.9}


def test_several_rates_share_one_clock(tmp_path):
    h5py = pytest.importorskip("h5py")
    fast = np.arange(0, 0.8, 1e-3)
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["tip"], file["t"] = TIP, TIMES
        file["daq/t"], file["daq/F"] = fast, 1 + fast
    text = """
    [time]
    column = "t"
    [tip]
    columns = ["tip[1]", "tip[2]", "tip[3]"]
    missing = -1.0
    [[tensions]]
    column = "daq/F"
    time = { column = "daq/t" }
    """
    recording = load_recording(tmp_path / "a.h5", rod(), mapping=write_mapping(tmp_path, text))
    assert np.sum(recording.has_tip) == len(TIMES)
    np.testing.assert_allclose(recording.times[recording.has_tip], TIMES)
    np.testing.assert_allclose(recording.tip_positions[recording.has_tip], TIP)
    np.testing.assert_allclose(
        recording.tensions[:, 0], 1 + np.minimum(recording.times, 0.799), atol=1e-9
    )


def turned(points):
    """Seen by a camera somewhere else."""
    a, b = np.deg2rad(25), np.deg2rad(-40)
    about_x = np.array([[1, 0, 0], [0, np.cos(a), -np.sin(a)], [0, np.sin(a), np.cos(a)]])
    about_z = np.array([[np.cos(b), -np.sin(b), 0], [np.sin(b), np.cos(b), 0], [0, 0, 1]])
    return points @ (about_z @ about_x).T + [1.0, -2.0, 0.5]


BASE = np.array([[0.03, 0.0, 0.0], [-0.02, 0.02, 0.0], [0.0, -0.03, -0.01]])
FRAME = """
[time]
rate = 50.0
[tip]
columns = ["tip[1]", "tip[2]", "tip[3]"]
""" + "".join(
    f"[[base_markers]]\ncolumns = ['b{i}[1]', 'b{i}[2]', 'b{i}[3]']\nposition = {p.tolist()}\n"
    for i, p in enumerate(BASE)
)


def framed(tmp_path, mapping, move=0.0):
    h5py = pytest.importorskip("h5py")
    drift = move * np.linspace(0, 1, len(TIMES))[:, None] * [1.0, 0, 0]
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["tip"] = turned(TIP + drift)
        for i, place in enumerate(BASE):
            file[f"b{i}"] = turned(place + drift)
    return load_recording(tmp_path / "a.h5", rod(), mapping=write_mapping(tmp_path, mapping))


@pytest.mark.parametrize("move", [0.0, 2e-3])
def test_the_frame_is_fitted_to_base_markers(tmp_path, move):
    recording = framed(tmp_path, FRAME, move)
    np.testing.assert_allclose(recording.tip_positions, TIP, atol=1e-9)
    assert recording.origin_known
    assert "3 base markers" in recording.notes[0]


def test_rest_puts_the_tip_in_place(tmp_path):
    text = FRAME.split("[[base_markers]]")[0] + "rest = true\naxes = 'x,y,z'\n"
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["tip"] = TIP + [0.3, 0.2, 0.1]
    recording = load_recording(tmp_path / "a.h5", rod(), mapping=write_mapping(tmp_path, text))
    np.testing.assert_allclose(recording.tip_positions, TIP, atol=1e-9)
    assert not recording.origin_known


# What is wrong with a mapping for a file of t, x, y, z, F; and what the message must say.
GOOD = """
[time]
column = "t"
[tip]
columns = ["x", "y", "z"]
[[tensions]]
column = "F"
"""
BAD = [
    ("unknown key", GOOD + "[weather]\n", ["weather", "unknown key"]),
    ("unknown key in a table", GOOD + "colour = 'red'\n", ["tensions[0].colour", "unknown key"]),
    ("no tip", GOOD.replace("[tip]", "[top]"), ["tip is missing"]),
    ("not TOML", "[time\n", ["not a TOML file"]),
    ("no column", GOOD.replace('"t"', '"time"'), ["no column 'time'", "t, x, y, z, F"]),
    ("unit", GOOD.replace('"t"', '"t"\nunit = "fortnight"'), ["time.unit = 'fortnight'", "ms"]),
    ("two columns", GOOD.replace('"y", ', ""), ["tip.columns", "list of 3"]),
    ("number", GOOD.replace('"F"', "7"), ["tensions[0].column = 7", "a text"]),
    ("rate", GOOD.replace('column = "t"', "rate = 0"), ["time.rate = 0", "above 0"]),
    ("axes", GOOD.replace("[[ten", 'axes = "x,y,y"\n[[ten'), ["axes = 'x,y,y'"]),
    ("mirror", GOOD.replace("[[ten", 'axes = "-x,y,z"\n[[ten'), ["mirrors"]),
    ("too many", GOOD + '[[tensions]]\ncolumn = "F"\n', ["tensions: 2 given", "1 tendons"]),
    ("pressures", GOOD + '[[pressures]]\ncolumn = "F"\n', ["pressures: 1 given", "0 chambers"]),
    ("push", GOOD + "scale = -1\n", ["row 2", "column F", "negative", "offset"]),
    ("one marker", GOOD + FRAME[FRAME.index("[[base") :].split("[[base_markers]]\n")[1].join(
        ["[[base_markers]]\n", ""]).replace("b0[1]", "x").replace("b0[2]", "y").replace(
        "b0[3]", "z"), ["base_markers: 1 given", "at least 3"]),
    ("millimetres", GOOD.replace("[[ten", 'unit = "cm"\n[[ten'), ["row", "millimetres|check"]),
    ("seconds", GOOD.replace('"t"', '"t"\nunit = "min"'), ["s apart", "unit"]),
]  # fmt: skip


@pytest.mark.parametrize("name, text, fragments", BAD, ids=[name for name, _, _ in BAD])
def test_bad_mappings(tmp_path, name, text, fragments):
    log = tmp_path / "a.csv"
    step = 0.2 if name == "seconds" else 0.02
    tip = 0.1 if name != "millimetres" else 100.0
    log.write_text("t,x,y,z,F\n" + "".join(f"{step * k},0,0,{tip},1\n" for k in range(9)))
    with pytest.raises(RecordingError) as error:
        load_recording(log, rod(), mapping=write_mapping(tmp_path, text))
    message = str(error.value)
    assert "a.csv" in message or "any.map.toml" in message
    assert "\n" not in message
    for fragment in fragments:
        assert any(part in message for part in fragment.split("|")), message


def test_base_markers_that_are_elsewhere(tmp_path):
    swapped = FRAME.replace(repr(BASE[0].tolist()), "[0.3, 0.0, 0.0]")
    with pytest.raises(RecordingError, match="after the best rigid fit"):
        framed(tmp_path, swapped)


@pytest.mark.parametrize("suffix", [".mat", ".h5", ".parquet", ".c3d", ".tsv"])
def test_files_that_are_not_what_they_are_called(tmp_path, suffix):
    path = tmp_path / f"a{suffix}"
    path.write_bytes(b"\x00\xff nothing of the kind" * 40)
    with pytest.raises(RecordingError, match="a" + suffix):
        read_table(path)
    with pytest.raises(RecordingError, match="No such file"):
        read_table(Path("absent" + suffix))


@pytest.mark.parametrize(
    "package, suffix, extra",
    [("scipy.io", ".mat", "mat"), ("h5py", ".h5", "hdf5"), ("pyarrow", ".parquet", "parquet")],
)
def test_without_the_package(tmp_path, monkeypatch, package, suffix, extra):
    (tmp_path / f"a{suffix}").write_bytes(b"anything")
    monkeypatch.setitem(__import__("sys").modules, package, None)
    with pytest.raises(RecordingError, match=rf"pip install 'softrod_jax\[{extra}\]'"):
        read_table(tmp_path / f"a{suffix}")
