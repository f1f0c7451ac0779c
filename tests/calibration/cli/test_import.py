"""`softrod import`: tables of other people become mappings that the readers understand."""

# ruff: noqa: F811 - pytest knows fixtures by their names

import json
import tomllib
from pathlib import Path

import numpy as np
import pytest
from beams import FIT, RELEASE, TRUTH, beam, release
from command_line import asked, in_a_directory_of_its_own, run  # noqa: F401

import softrod_jax as sr
from calibration import load_recording
from calibration.cli import importing

# A German data logger: Latin-1, semicolons, decimal commas, a line before the header.
HEAD = "Versuch vom 3. März\nZeit (ms);Kräft 1 [N];Kräft 2 [N];Kräft 3 [N];Druck;{tip}"


def comma(x):
    return f"{x:.5f}".replace(".", ",")


def german(path, rows, head=HEAD, tip="Spitze X;Spitze Y;Spitze Z"):
    lines = [head.format(tip=tip), *(";".join(map(comma, row)) for row in rows)]
    Path(path).write_bytes("\r\n".join(lines).encode("latin-1"))


def driven(rows=40, size=1e3, turn=np.eye(3)):
    """Time [ms], tensions [N], pressure [kPa], and a tip that swings from the straight rod."""
    t = 0.01 * np.arange(rows)
    ramp = np.clip(4 * (t - 0.1), 0, 1)
    tip = np.stack([0.02 * ramp, 0 * t, 0.1 - 3e-3 * ramp], axis=1) @ turn.T
    return np.column_stack([1e3 * t, 0.1 * ramp, 0 * t, 0 * t, 20 * ramp, size * tip])


def test_an_own_file_goes_through_import_a_fit_and_a_film(capsys):
    """In mm, with decimal commas and semicolons, in Latin-1; each command names what follows."""
    truth = release(beam())
    sr.save_scene(beam(young_modulus=2.3e5, bending_damping=1e-4), "beam.toml")
    rows = np.column_stack([1e3 * truth.times, 1e3 * truth.tip_positions])
    german("größe.csv", rows, "Zeit (ms);{tip}", tip="Höhe X;Höhe Y;Höhe Z")
    status, out, err = run(capsys, "import", "beam.toml", "größe.csv", "--yes")
    assert (status, err) == (0, "")
    for word in ("comma is the decimal", "cp1252", "in ms", "in mm"):
        assert out.count(word) == 1
    assert out.splitlines()[-1] == "next: softrod calibrate beam.toml 'größe.csv'"
    assert Path("größe.png").stat().st_size > 10_000
    scene = sr.load_scene("beam.toml")
    log = load_recording("größe.csv", scene)  # by the mapping beside it
    np.testing.assert_allclose(log.times, truth.times, atol=1e-8)
    np.testing.assert_allclose(log.tip_positions, truth.tip_positions, atol=1e-8)
    fit = f"--fit {','.join(TRUTH)} --dt {FIT['dt']} --intervals 4 --no-checks --out fitted"
    status, out, _ = run(capsys, "calibrate", "beam.toml", "größe.csv", *fit.split())
    assert status == 0 and "softrod film fitted" in out
    found = json.loads(Path("fitted/parameters.json").read_text("utf-8"))
    assert found["parameters"]["young_modulus"]["value"] == pytest.approx(2.9e5, rel=0.01)
    assert found["time_offset_s"]["größe"] == pytest.approx(RELEASE, abs=2e-3)
    status, out, err = run(capsys, "film", "fitted", "--out", "film.html")
    assert (status, err) == (0, "") and Path("film.html").stat().st_size > 30_000


def test_what_it_reads_is_what_plot_and_simulate_read(capsys, asked):
    german("a.csv", driven())
    status, out, _ = run(capsys, "import", "a.csv", "robot.toml", "--no-plot", "--out", "m.toml")
    assert status == 0 and "next: softrod calibrate robot.toml a.csv --mapping m.toml" in out
    assert "'Druck', in kPa, which is assumed" in out
    scene = sr.load_scene("robot.toml")
    log = load_recording("a.csv", scene, mapping="m.toml")
    np.testing.assert_allclose(log.tip_positions[-1], [0.02, 0, 0.097], atol=1e-9)
    np.testing.assert_allclose(log.tensions[-1], [0.1, 0, 0], atol=1e-9)
    np.testing.assert_allclose(log.pressures[-1], [2e4], atol=1e-6)
    argv = ["--mapping", "m.toml", "--dt", "0.01"]
    status, _, _ = run(capsys, "simulate", "robot.toml", "--log", "a.csv", *argv)
    assert status == 0
    np.testing.assert_allclose(asked.motion.pressures, log.pressures[1:], rtol=1e-12)
    status, _, err = run(capsys, "plot", "a.csv", "--mapping", "m.toml", "--out", "a.png")
    assert (status, err) == (0, "") and Path("a.png").exists()
    # Without a tip it is inputs alone.
    text = Path("m.toml").read_text()
    Path("m.toml").write_text(text[: text.index("[tip]")] + text[text.index("[[tensions]]") :])
    status, _, _ = run(capsys, "simulate", "robot.toml", "--log", "a.csv", *argv)
    assert status == 0
    np.testing.assert_allclose(asked.motion.tensions, log.tensions[1:], rtol=1e-12)


@pytest.mark.parametrize(
    "size, turn, axes, unit",
    [
        (1.0, np.eye(3), None, "m"),
        (100.0, np.eye(3), None, "cm"),
        # The file's -y runs along the rod.
        (1e3, np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]]), "x,z,-y", "mm"),
    ],
)
def test_unit_and_axes_follow_from_the_rod(capsys, size, turn, axes, unit):
    german("a.csv", driven(size=size, turn=turn))
    status, _, _ = run(capsys, "import", "robot.toml", "a.csv", "--no-plot")
    tip = tomllib.loads(Path("a.map.toml").read_text())["tip"]
    assert status == 0 and tip["unit"] == unit and tip.get("axes") == axes
    log = load_recording("a.csv", sr.load_scene("robot.toml"))
    np.testing.assert_allclose(log.tip_positions[0], [0, 0, 0.1], atol=1e-6)


def test_where_the_clamp_is_not_known_the_rest_tells(capsys):
    rows = driven()
    rows[:, 5:] += [700.0, -300.0, 1200.0]
    german("a.csv", rows)
    status, out, _ = run(capsys, "import", "robot.toml", "a.csv", "--no-plot")
    assert status == 0 and "only displacements are measurements" in out
    log = load_recording("a.csv", sr.load_scene("robot.toml"))
    np.testing.assert_allclose(log.tip_positions[-1], [0.02, 0, 0.097], atol=1e-6)


def test_options_say_what_columns_are(capsys):
    """Names that mean nothing, servos that say angles, and a frame number."""
    lines = ["n,a,b,c,d,e,g"]
    lines += [f"{k},{0.1 * k},{0.2 * k},{k},0,{100 - k},7" for k in range(20)]
    Path("a.csv").write_text("\n".join(lines))
    argv = ["--rate", "50", "--tip", "c", "d", "e", "--unit", "mm", "--no-plot"]
    status, _, err = run(capsys, "import", "a.csv")
    assert status == 2 and "--time" in err and "'a', 'b'" in err
    status, out, err = run(
        capsys,
        "import",
        "a.csv",
        *argv,
        "--pull",
        "a",
        "b",
        "--pull-unit",
        "deg",
        "--pulley",
        "5e-3",
    )
    assert (status, err) == (0, "") and "not used: 'n', 'g'" in out
    log = load_recording("a.csv")
    np.testing.assert_allclose(log.times, 0.02 * np.arange(20), atol=1e-12)
    np.testing.assert_allclose(log.pulls[-1], np.deg2rad([1.9, 3.8]) * 5e-3, rtol=1e-12)
    np.testing.assert_allclose(log.tip_positions[-1], [0.019, 0, 0.081], rtol=1e-12)


def test_a_table_without_a_header(capsys):
    rows = "\n".join(f"{10 * k} {k} 0 {100 - k}" for k in range(20))
    Path("a.txt").write_text(rows)
    argv = ["robot.toml", "a.txt", "--tip", "2", "3", "4", "--time-unit", "ms", "--no-plot"]
    status, out, err = run(capsys, "import", *argv)
    assert (status, err) == (0, "") and "no header" in out
    log = load_recording("a.txt", sr.load_scene("robot.toml"))
    np.testing.assert_allclose(log.times[-1], 0.19)
    np.testing.assert_allclose(log.tip_positions[-1], [0.019, 0, 0.081], rtol=1e-12)


def test_an_export_of_a_camera_system_with_a_marker_on_the_clamp(capsys):
    """Motive, in which the rod lies along the file's -y, from the clamp at (1, 2, 0.5) m."""
    head = [
        "Format Version,1.23,Export Frame Rate,50.0,Rotation Type,XYZ,Length Units,Meters",
        ",,Marker,Marker,Marker,Marker,Marker,Marker",
        ",,base:1,base:1,base:1,tip:1,tip:1,tip:1",
        ",,Position,Position,Position,Position,Position,Position",
        "Frame,Time (Seconds),X,Y,Z,X,Y,Z",
    ]
    moved = np.clip(0.02 * (0.02 * np.arange(50) - 0.3), 0, None)
    rows = [f"{k},{0.02 * k:.2f},1,2,0.5,{1 + x},1.9,0.5" for k, x in enumerate(moved)]
    Path("a.csv").write_text("\n".join([*head, *rows]))
    status, out, err = run(capsys, "import", "robot.toml", "a.csv", "--no-plot")
    assert (status, err) == (0, "") and "the clamp is where 'base:1.X'" in out
    log = load_recording("a.csv", sr.load_scene("robot.toml"))
    np.testing.assert_allclose(log.tip_positions[-1], [moved[-1], 0, 0.1], atol=1e-9)


def test_on_a_terminal_it_asks(capsys, monkeypatch):
    Path("a.csv").write_text(
        "k,x,y,z,load\n" + "\n".join(f"{10 * k},{k},0,{90 - k},{k}" for k in range(20))
    )
    answers = iter(["k", "ms", "gf", ""])
    asked_for = []

    def answer(question):
        asked_for.append(question)
        return next(answers)

    monkeypatch.setattr("builtins.input", answer)
    monkeypatch.setattr(
        importing.sys, "stdin", type("Terminal", (), {"isatty": lambda self: True})()
    )
    status, _, err = run(capsys, "import", "a.csv", "--no-plot")
    assert (status, err) == (0, "")
    assert [q.split(",")[0].split(" [")[0] for q in asked_for] == [
        "column of the time", "unit of the time (s", "unit of load", "unit of the tip",
    ]  # fmt: skip
    log = load_recording("a.csv")
    np.testing.assert_allclose(log.times[-1], 0.19)
    np.testing.assert_allclose(log.tensions[-1], 19 * 9.80665e-3)


def test_a_mapping_is_not_overwritten_silently(capsys):
    german("a.csv", driven())
    Path("a.map.toml").write_text("mine")
    status, _, err = run(capsys, "import", "a.csv")
    assert status == 2 and "a.map.toml: is there already" in err
    assert Path("a.map.toml").read_text() == "mine"


@pytest.mark.parametrize(
    "change, key",
    [
        (("Spitze X", "Spitze Q"), "tip.columns"),
        (('"Zeit (ms)"', '"Zait"'), "time.column"),
        (('"Druck"', '"Drück"'), "pressures[0].column"),
        (('unit = "mm"', 'unit = "m"'), "[tip] unit = 'mm'"),
        (('unit = "ms"', 'unit = "s"'), "time.unit"),
        (('decimal = ","', 'decimal = "."'), "[csv] decimal = ','"),
        (("[csv]", "[csv]\nskip_rows = 0"), "[csv] skip_rows"),
    ],
)
def test_messages_name_the_key_that_helps(capsys, change, key):
    german("a.csv", driven())
    run(capsys, "import", "robot.toml", "a.csv", "--no-plot")
    text = Path("a.map.toml").read_text()
    was, becomes = change
    head, _, body = text.partition("[time]")  # the comments stay
    assert was in body or "[csv]" in was
    Path("a.map.toml").write_text(head + "[time]" + body.replace(was, becomes))
    status, _, err = run(capsys, "plot", "robot.toml", "a.csv")
    assert status == 2 and key in err
