"""Several trials in one file, and several files by one pattern."""

from dataclasses import replace

import numpy as np
import pytest

from calibration import RecordingError, load_recording, load_recordings
from calibration.data.trials import files_of
from softrod_jax.scene.scene import Scene, as_arrays
from softrod_jax.scene.sections import Circle
from softrod_jax.scene.tendons import Tendons

SCENE = as_arrays(Scene(0.1, Circle(6e-3), 2e5, 0.49, 1070.0, gravity=[-9.81, 0.0, 0.0]))
MAPPING = """
[time]
column = "t"
[tip]
columns = ["x", "y", "z"]
[trials]
{trials}
"""
# Three runs, of which each begins its clock again, and rows between them that are none.
RUNS = {"1": 5, "2": 6, "10": 4}


def rows(run: str, n: int, sign=-1.0):
    return [(0.01 * k, sign * 1e-3 * k, 0.0, 0.1, run) for k in range(n)]


def write(path, table):
    lines = ["t,x,y,z,run", *(",".join(map(str, row)) for row in table)]
    path.write_text("\n".join(lines), encoding="utf-8")
    return path


def one_file(tmp_path):
    table = [row for run, n in RUNS.items() for row in [*rows(run, n), (7.0, 0.0, 0.0, 0.1, "")]]
    return write(tmp_path / "all.csv", table)


def mapping(tmp_path, trials):
    path = tmp_path / "any.map.toml"
    path.write_text(MAPPING.format(trials=trials), encoding="utf-8")
    return path


def test_a_column_numbers_the_trials_of_a_file(tmp_path):
    path = one_file(tmp_path)
    found = load_recordings(path, SCENE, mapping=mapping(tmp_path, 'column = "run"'))
    assert [r.name for r in found] == ["all-1", "all-2", "all-10"]
    for recording, n in zip(found, RUNS.values()):
        np.testing.assert_allclose(recording.times, 0.01 * np.arange(n))
        np.testing.assert_allclose(recording.tip_positions[:, 0], -1e-3 * np.arange(n))
        assert recording.source == str(path)
    only = mapping(tmp_path, 'column = "run"\nonly = [10]')
    assert load_recording(path, SCENE, mapping=only).name == "all-10"


def test_windows_are_trials_too(tmp_path):
    path = write(tmp_path / "long.csv", rows("1", 50))
    text = mapping(tmp_path, "windows = [[0.1, 0.2], [0.3, 0.45]]")
    first, second = load_recordings(path, SCENE, mapping=text)
    assert (first.name, second.name) == ("long-1", "long-2")
    np.testing.assert_allclose(first.times, np.arange(10, 21) / 100)
    np.testing.assert_allclose(second.times, np.arange(30, 46) / 100)
    np.testing.assert_allclose(second.tip_positions[0], [-0.03, 0.0, 0.1])


def test_an_error_names_the_row_of_the_file(tmp_path):
    table = [*rows("1", 5), *rows("2", 5)]
    table[7] = (0.02, "oops", 0.0, 0.1, "2")
    path = write(tmp_path / "bad.csv", table)
    with pytest.raises(RecordingError, match="row 9, column x: 'oops'"):
        load_recordings(path, SCENE, mapping=mapping(tmp_path, 'column = "run"'))
    # A trial is read without what is wrong in another.
    only = mapping(tmp_path, 'column = "run"\nonly = 1')
    assert len(load_recording(path, SCENE, mapping=only).times) == 5


@pytest.mark.parametrize(
    "trials, message",
    [
        ('column = "run"\nwindows = [[0, 1]]', "one of them is too much"),
        ('column = "trial"', "no column 'trial'"),
        ('column = "t"', "stands in one row only"),
        ('column = "run"\nonly = [3]', "'3' is not in column run, which has 1, 2, 10"),
        ("only = [3]", "it chooses among"),
        ("windows = [[1, 0]]", "pairs .start, end. in s, end after start"),
        ("windows = [[8, 9]]", "holds fewer than two samples"),
        ('colum = "run"', "unknown key; allowed here: axis, column, only, windows"),
    ],
)
def test_bad_trials_are_told(tmp_path, trials, message):
    path = one_file(tmp_path)
    if "8, 9" in trials:
        write(path, rows("1", 9))
    with pytest.raises(RecordingError, match=message):
        load_recordings(path, SCENE, mapping=mapping(tmp_path, trials))


def test_one_recording_is_not_several(tmp_path):
    text = mapping(tmp_path, 'column = "run"')
    with pytest.raises(RecordingError, match="holds 3 trials, all-1, all-2, all-10"):
        load_recording(one_file(tmp_path), SCENE, mapping=text)


def test_a_pattern_stands_for_files_in_the_order_of_their_numbers(tmp_path):
    for k in (1, 2, 10):
        write(tmp_path / f"run_{k}.csv", rows("1", 3 + k))
    odd = write(tmp_path / "run_[x].csv", rows("1", 4))
    pattern = str(tmp_path / "run_[0-9]*.csv")
    names = [f"run_{k}.csv" for k in (1, 2, 10)]
    assert [x.rpartition("/")[2] for x in files_of([pattern])] == names
    assert files_of([odd, "absent.csv"]) == [str(odd), "absent.csv"]
    with pytest.raises(RecordingError, match="no file is called so"):
        files_of([str(tmp_path / "walk_*.csv")])
    text = mapping(tmp_path, "windows = [[0.0, 0.02]]")
    found = load_recordings(pattern, SCENE, mapping=text)
    assert [r.name for r in found] == ["run_1-1", "run_2-1", "run_10-1"]


AXIS = """
[time]
column = "t"
[tip]
columns = ["tip[1]", "tip[2]", "tip[3]"]
[[tensions]]
column = "u"
[trials]
axis = {axis}
"""


def cube(axis: int):
    """Three trials of 9 samples: tips with the trials along an axis, a clock, an input of each."""
    t, signs = 0.01 * np.arange(9), np.array([1.0, -1.0, 2.0])
    x = signs[:, None] * 1e-3 * np.arange(9)
    tips = np.stack([x, 0 * x, 0.1 + 0 * x], axis=2)  # (trials, samples, coordinates)
    return {"t": t, "tip": np.moveaxis(tips, 0, axis - 1), "u": np.outer(np.arange(9), [1, 2, 3])}


@pytest.mark.parametrize("kind, axis", [("mat", 1), ("mat", 3), ("h5", 1), ("h5", 2)])
def test_an_array_of_trials(tmp_path, kind, axis):
    scene = replace(SCENE, tendons=Tendons(np.array([[4e-3, 0.0]])))
    path, arrays = tmp_path / f"all.{kind}", cube(axis)
    if kind == "mat":
        pytest.importorskip("scipy.io").savemat(path, arrays)
    else:
        with pytest.importorskip("h5py").File(path, "w") as file:
            for name, values in arrays.items():
                file[f"{name}"] = values
    text = tmp_path / "any.map.toml"
    text.write_text(AXIS.format(axis=axis), encoding="utf-8")
    found = load_recordings(path, scene, mapping=text)
    assert [r.name for r in found] == ["all-1", "all-2", "all-3"]
    for k, (recording, sign) in enumerate(zip(found, [1, -1, 2])):
        np.testing.assert_allclose(recording.times, 0.01 * np.arange(9))
        np.testing.assert_allclose(recording.tip_positions[:, 0], sign * 1e-3 * np.arange(9))
        np.testing.assert_allclose(recording.tensions[:, 0], (k + 1) * np.arange(9))
    text.write_text(AXIS.format(axis=axis) + "only = 2\n", encoding="utf-8")
    assert load_recording(path, scene, mapping=text).name == "all-2"
    text.write_text(AXIS.format(axis=4), encoding="utf-8")
    with pytest.raises(RecordingError, match="axis = 4: expected 1, 2 or 3"):
        load_recordings(path, scene, mapping=text)


def test_an_axis_of_trials_needs_arrays_that_agree(tmp_path):
    mat = pytest.importorskip("scipy.io")
    text = tmp_path / "any.map.toml"
    text.write_text(AXIS.format(axis=3), encoding="utf-8")
    scene = replace(SCENE, tendons=Tendons(np.array([[4e-3, 0.0]])))
    for arrays, message in (
        ({"t": np.arange(9.0), "tip": np.zeros((9, 3))}, "no array of three dimensions"),
        ({"tip": np.zeros((9, 3, 3)), "u": np.zeros((8, 2, 3))}, "tip 3 trials of 9 samples, u 3"),
    ):
        mat.savemat(tmp_path / "bad.mat", arrays)
        with pytest.raises(RecordingError, match=message):
            load_recordings(tmp_path / "bad.mat", scene, mapping=text)
    with pytest.raises(RecordingError, match="for arrays of MAT and HDF5 files"):
        load_recordings(one_file(tmp_path), scene, mapping=text)
