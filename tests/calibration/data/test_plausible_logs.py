"""Logs that a fit must not take at their word: clocks, gaps, units, load cells, cameras."""

import numpy as np
import pytest
from test_foreign_tables import INPUTS, TIME, TIP, load, rod

from calibration import Recording, RecordingError, load_recording, write_log
from calibration.data.clocks import gaps_of
from calibration.data.selection import select
from calibration.data.windows import split
from calibration.report.log_plot import log_figure
from softrod_jax.scene.scene import Scene, as_arrays
from softrod_jax.scene.sections import Circle

TIMES = np.arange(0, 4, 0.01)


def bare():
    return as_arrays(Scene(0.1, Circle(5e-3), 3e5, 0.45, 1070.0))


def swinging(t=TIMES):
    """A tip of a rod of 0.1 m that moves along x."""
    x = 0.02 * np.sin(3 * t)
    return np.stack([x, 0 * t, 0.1 - 4 * x**2], axis=1)


def logged(tmp_path, keep=slice(None), tension=None, tip=None, scene=None):
    tension = 1 + np.sin(3 * TIMES) if tension is None else tension
    tip = swinging() if tip is None else tip
    pressure = np.zeros((len(TIMES), 1))
    write_log(tmp_path / "a.csv", TIMES[keep], tension[keep, None], pressure[keep], tip[keep])
    return load_recording(tmp_path / "a.csv", scene or rod())


def without(start, end):
    return (TIMES < start) | (TIMES > end)


# Rows that are missing.


def test_rows_that_are_missing_end_what_a_fit_uses(tmp_path):
    recording = logged(tmp_path, without(1.995, 2.305))
    assert any("no samples of tau1_N from 1.99 to 2.31 s" in note for note in recording.notes)
    selection = select(recording, None)
    assert selection.end == pytest.approx(1.99)
    assert "gap" in selection.rule
    assert select(recording, (0.5, 4.0)).end == pytest.approx(1.99)
    # What comes after is a recording of its own.
    assert select(recording.window(2.31, 4.0), None).end == pytest.approx(3.99)


def test_too_little_before_the_gap_names_the_remedy(tmp_path):
    recording = logged(tmp_path, without(0.025, 0.405))
    with pytest.raises(RecordingError, match="from 0.02 to 0.41 s.*--window 0.41 3.99"):
        select(recording, None)


@pytest.mark.parametrize(
    "start, end, ends, said",
    [
        (1.995, 2.015, 3.99, "a straight line is drawn across"),
        (1.995, 2.005, 3.99, None),
        (0.5, 0.8, 3.99, "taken to have stayed"),
    ],
)
def test_gaps_that_do_no_harm_are_said(tmp_path, start, end, ends, said):
    tension = np.where(TIMES < 1, 0.0, 1 + np.sin(3 * TIMES))
    recording = logged(tmp_path, without(start, end), tension)
    assert select(recording, (0, 4)).end == 4
    assert gaps_of(recording) == []
    assert said is None or any(said in note for note in recording.notes)


def test_an_input_that_moves_and_comes_back_to_its_value_did_not_stay(tmp_path):
    # A gap of a whole period.
    recording = logged(tmp_path, without(1.0, 1.0 + 2 * np.pi / 3))
    assert gaps_of(recording)[0][0] == pytest.approx(0.99)


def test_a_recording_made_in_python_has_gaps_too():
    keep = without(1.995, 2.305)
    tensions = (1 + np.sin(3 * TIMES))[keep, None]
    recording = Recording(TIMES[keep], tensions, None, swinging()[keep])
    assert select(recording, None).end == pytest.approx(1.99)


def test_windows_end_at_a_gap(tmp_path):
    recording = logged(tmp_path, without(2.5, 2.8))
    parts = split(recording, 1.0, 0.2)
    ends = [select(part, None).end for part in parts]
    assert not any(2.5 < end < 2.8 for end in ends)
    assert max(ends) > 3.5


def test_irregular_logs_have_no_gaps(tmp_path):
    random = np.random.default_rng(0)
    t = np.cumsum(random.exponential(0.05, 300))
    recording = Recording(t, (1 + np.sin(t))[:, None], None, swinging(t))
    assert gaps_of(recording) == []


def test_a_gap_of_a_clock_of_its_own(tmp_path):
    rows = ["t,X,Y,Z,td,F,P"]
    slow = [f"{t},{1e3 * x},0,{1e3 * z}" for t, (x, _, z) in zip(TIMES, swinging(), strict=True)]
    own = TIMES + np.where(TIMES > 2, 0.4, 0.0)
    fast = [f"{t},{1 + np.sin(3 * t)},0" for t in own]
    rows += [f"{a},{b}" for a, b in zip(slow, fast, strict=True)]
    inputs = INPUTS.replace("\n[[pr", '\ntime = { column = "td" }\n[[pr') + (
        'time = { column = "td" }\n'
    )
    recording = load(tmp_path, "\n".join(rows), TIME + TIP + inputs)
    assert recording.gaps[0][0] == pytest.approx(2.0, abs=0.011)
    assert select(recording, None).end == pytest.approx(2.0, abs=0.011)


# Two clocks.

ROWS = [(f"{0.1 * k:.2f}", f"{0.1 * k:.2f}") for k in range(11)]


def two_clocks(tmp_path, own, inputs='time = { column = "t_daq" }', tip_time=lambda k: 0.1 * k):
    text = "t,t_daq,F,P,X,Y,Z\n" + "".join(
        f"{tip_time(k):.3f},{own(k)},{0.1 * k},2,{0.1 * k},0,100\n" for k in range(11)
    )
    mapping = TIME + TIP + INPUTS.replace('"F"\n', f'"F"\n{inputs}\n') + inputs + "\n"
    return load(tmp_path, text, mapping)


@pytest.mark.parametrize(
    "own, fragments",
    [
        (lambda k: 1704448800 + 0.1 * k, ["clock of F", "1704448800", "do not overlap", "offset"]),
        (lambda k: f"2024-01-05 10:00:00.{k:02}", ["dates", "do not overlap"]),
        (lambda k: 100 * k, ["is it in ms", "tensions[0].time.unit = 'ms'"]),
        (lambda k: 1e-4 * k, ["the tip's in ms"]),
        (lambda k: -5 + 0.1 * k, ["do not overlap"]),
        (lambda k: 0.95 + 0.1 * k, ["do not overlap but for 9%"]),
    ],
)
def test_clocks_that_do_not_overlap(tmp_path, own, fragments):
    with pytest.raises(RecordingError) as error:
        two_clocks(tmp_path, own)
    for fragment in ["log.csv", *fragments]:
        assert fragment in str(error.value)


def test_an_offset_brings_clocks_together(tmp_path):
    shifted = 'time = { column = "t_daq", offset = -1704448800 }'
    recording = two_clocks(tmp_path, lambda k: 1704448800 + 0.1 * k, shifted)
    np.testing.assert_allclose(recording.tensions[-1], 1.0, atol=1e-6)
    assert not recording.notes


def test_an_input_that_ends_early_is_said_to_be_held(tmp_path):
    recording = two_clocks(tmp_path, lambda k: 0.05 * k)
    assert any("F was not measured after 0.5 s, and is held" in note for note in recording.notes)


# Tensions below zero.


def test_the_noise_of_a_load_cell_is_set_to_zero_and_said(tmp_path):
    tension = np.maximum(np.sin(3 * TIMES), 0) + 1e-3 * np.cos(70 * TIMES)
    assert tension.min() < -9e-4
    recording = logged(tmp_path, tension=tension)
    assert recording.tensions.min() == 0
    assert np.array_equal(recording.tensions[:, 0], np.maximum(tension, 0))
    assert any("mN, taken for the noise of the load cell" in note for note in recording.notes)


def test_a_log_of_slack_tendons_may_be_noise(tmp_path):
    noise = 2e-3 * np.random.default_rng(0).normal(size=len(TIMES))
    assert logged(tmp_path, tension=noise).tensions.min() == 0


@pytest.mark.parametrize(
    "tension",
    [-np.ones(len(TIMES)), np.sin(3 * TIMES), 1 - 1.1 * (TIMES > 2), -1e-2 * (TIMES > 2)],
    ids=["sign", "both ways", "a tenth", "slack and constant"],
)
def test_tensions_that_are_really_negative(tmp_path, tension):
    with pytest.raises(RecordingError, match="a.csv: row .*, column tau1_N.*negative.*scale = -1"):
        logged(tmp_path, tension=np.asarray(tension, dtype=float))


# Units, clamps and rests: hints only where they would help.


def hint(tmp_path, tip, unit="m", keys=""):
    """The complaint about a tip (T, 3) in `unit`."""
    text = "t,X,Y,Z\n" + "".join(
        f"{t:.2f},{x!r},{y!r},{z!r}\n" for t, (x, y, z) in zip(TIMES, tip.tolist(), strict=True)
    )
    with pytest.raises(RecordingError) as error:
        load(tmp_path, text, f'{TIME}[tip]\ncolumns = ["X", "Y", "Z"]\nunit = "{unit}"\n{keys}')
    return str(error.value)


STILL = np.tile([0.0, 0.0, 0.1], (len(TIMES), 1))


@pytest.mark.parametrize(
    "tip, unit, has, has_not",
    [
        (STILL, "mm", ["stays within", "in metres it would fit: [tip] unit = 'm'"], ["rest"]),
        (swinging(), "cm", ["in metres it would fit"], ["rest"]),
        (1e3 * swinging(), "m", ["dividing it by 1000 would fit: [tip] unit = 'mm'"], ["rest"]),
        (100 * swinging(), "m", ["in centimetres? it would fit: [tip] unit = 'cm'"], ["1000"]),
        (swinging() / 0.0254, "m", ["in inches? it would fit"], ["1000"]),
        (swinging() - [0, 0, 0.1], "m", ["displacements from the rest", "rest = true"], ["unit ="]),
        (swinging() + [1, 2, 30], "m", ["about another place", "rest = true"], ["1000", "unit ="]),
        (swinging() + [0, 0, 100.0], "m", ["about another place", "rest = true"], ["1000"]),
        (1e3 * swinging() + [1e3, 2e3, 0], "m", ["in millimetres, and about another"], []),
        (STILL + [1, 2, 3], "m", ["check the unit"], ["1000", "unit =", "rest ="]),
        (1e6 * swinging() ** 2, "m", ["check the unit"], ["dividing", "unit =", "rest ="]),
    ],
)
def test_hints_are_right(tmp_path, tip, unit, has, has_not):
    message = hint(tmp_path, tip, unit)
    assert "log.csv: row " in message
    assert ", columns X, Y, Z: the tip" in message
    for text in has:
        assert text in message, message
    for text in has_not:
        assert text not in message, message


def test_one_sample_that_is_off_is_no_wrong_unit(tmp_path):
    tip = swinging()
    tip[50] = [3.0, 0, 0.1]
    message = hint(tmp_path, tip)
    assert "row 52" in message
    assert "leave its cells empty" in message


def test_zeros_in_a_table_are_missing_where_the_clamp_is_zero(tmp_path):
    tip = swinging(np.clip(TIMES - 0.3, 0, None))
    tip[50:60] = 0
    recording = logged(tmp_path, tip=np.where(tip == 0, 0.0, tip))
    text = "t,X,Y,Z\n" + "".join(f"{t:.2f},{x},{y},{z}\n" for t, (x, y, z) in zip(TIMES, tip))
    mapping = TIME + '[tip]\ncolumns = ["X", "Y", "Z"]\n'
    assert np.sum(~load(tmp_path, text, mapping).has_tip) == 10
    assert np.sum(~load(tmp_path, text, mapping + "rest = true\n").has_tip) == 10
    assert np.sum(~recording.has_tip) == 10


def test_zeros_of_displacements_are_places(tmp_path):
    fall = np.clip(TIMES - 1, 0, None)
    text = "t,X,Y,Z\n" + "".join(f"{t:.2f},{1e-3 * x},0,0\n" for t, x in zip(TIMES, fall))
    mapping = TIME + '[tip]\ncolumns = ["X", "Y", "Z"]\nrest = true\n'
    recording = load(tmp_path, text, mapping)
    assert recording.has_tip.all()
    np.testing.assert_allclose(recording.tip_positions[0], [0, 0, 0.1], atol=1e-12)


@pytest.mark.parametrize(
    "interval, unit, remedy",
    [(10.0, "s", "in ms"), (0.01 / 86400, "s", "unit = 'd'"), (1e-3, "us", "in days")],
)
def test_clocks_in_another_unit(tmp_path, interval, unit, remedy):
    text = "t,X,Y,Z\n" + "".join(f"{45296 + interval * k:.12f},0,0,0.1\n" for k in range(9))
    mapping = f'{TIME}unit = "{unit}"\n[tip]\ncolumns = ["X", "Y", "Z"]\n'
    with pytest.raises(RecordingError, match=remedy):
        load(tmp_path, text, mapping)


# Cameras that see less.


@pytest.mark.parametrize("seen", [[0, 2], [0]])
def test_coordinates_that_no_camera_saw(tmp_path, seen):
    tip = np.full_like(swinging(), np.nan)
    tip[:, seen] = swinging()[:, seen]
    tip[7] = np.nan
    recording = logged(tmp_path, tip=tip)
    assert np.sum(recording.has_tip) == len(TIMES) - 1
    assert np.array_equal(np.flatnonzero(recording.coordinates), seen)
    assert np.all(np.isfinite(recording.track[1]))
    assert select(recording, None).end > 3.9
    log_figure(recording)
    names = [name if i in seen else "" for i, name in enumerate("XYZ")]
    text = "t,X,Z\n0,0,100\n0.01,0.1,100\n"
    mapping = TIME + TIP.replace('["X", "Y", "Z"]', repr(names).replace("'", '"'))
    mapped = load(tmp_path, text, mapping)
    assert mapped.tip_positions[1, 0] == pytest.approx(1e-4)
    assert np.isnan(mapped.tip_positions[:, 1]).all()


def test_gaps_reach_the_command_line(tmp_path, capsys):
    from calibration.cli.main import main
    from softrod_jax import save_scene

    save_scene(rod(), tmp_path / "rod.toml")
    logged(tmp_path, without(1.995, 2.305))
    arguments = ["calibrate", str(tmp_path / "rod.toml"), str(tmp_path / "a.csv"), "--look"]
    assert main([*arguments, "--out", str(tmp_path / "out")]) == 0
    assert "no samples of tau1_N from 1.99 to 2.31 s" in capsys.readouterr().err


# What does not fit into memory.


def test_a_fit_that_asks_for_too_much_memory_says_how_much(monkeypatch):
    from calibration import calibrate
    from calibration.problem import memory

    recording = Recording(TIMES, (1 + np.sin(3 * TIMES))[:, None], np.zeros((400, 1)), swinging())
    options = {"fit": ("young_modulus",), "progress": False, "window": (0, 4)}
    monkeypatch.setattr(memory, "_MOST", 5e5)
    with pytest.raises(RecordingError, match=r"400 samples.*GB of memory.*0.0005 GB.*--window"):
        calibrate(rod(), [recording], **options)
    with pytest.raises(RecordingError, match="windows of drift in 4.. samples.*longer windows"):
        calibrate(rod(), [recording], **options, drift={"clock": 1e-2})


def test_a_million_rows_are_too_many_and_an_hour_is_not():
    from calibration.problem import memory

    with pytest.raises(RecordingError, match="GB"):
        memory.check_memory(memory.motion_bytes(1, 1_000_000, 4, 4), "a log", "cut it")
    memory.check_memory(memory.motion_bytes(1, 100_000, 4, 4), "a log", "cut it")
