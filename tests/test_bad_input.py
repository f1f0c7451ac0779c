"""Thirty and more ways to give `softrod calibrate` bad input: an error in words, never a traceback.

Each message says where (file, row, column or option), what stands there, and what to do.
"""

import pytest

import softrod_jax as sr
from calibration.cli.main import main

HEADER = "t_s,tau1_N,tau2_N,tau3_N,p1_Pa,tip_x_m,tip_y_m,tip_z_m\n"
ROWS = [f"{0.01 * k:g},{0.1 * k:g},0,0,0,{1e-3 * k:g},0,0.1\n" for k in range(12)]
LOG = HEADER + "".join(ROWS)


def row(k, old, new):
    """The log with `old` replaced in row k of the file."""
    lines = LOG.splitlines(keepends=True)
    assert old in lines[k - 1]
    lines[k - 1] = lines[k - 1].replace(old, new, 1)
    return "".join(lines)


def still():
    return HEADER + "".join(f"{0.01 * k:g},0,0,0,0,0,0,0.1\n" for k in range(40))


MAP = '[time]\ncolumn = "t"\n[tip]\ncolumns = ["x", "y", "z"]\n'
TABLE = "t,x,y,z\n" + "".join(f"{0.01 * k:g},{1e-3 * k:g},0,0.1\n" for k in range(12))

# Name, files, arguments after `calibrate`, and what the message must hold.
RUN = ["robot.toml", "a.csv"]
CASES = [
    ("no such log", {}, RUN, ["a.csv", "No such file"]),
    ("no such scene", {"a.csv": LOG}, ["absent.toml", "a.csv"], ["absent.toml"]),
    ("scene with an unknown key", {"b.toml": "[rod]\nlenght = 1\n", "a.csv": LOG},
     ["b.toml", "a.csv"], ["b.toml", "lenght", "length"]),
    ("empty log", {"a.csv": ""}, RUN, ["a.csv", "empty"]),
    ("header only", {"a.csv": HEADER}, RUN, ["a.csv", "no rows"]),
    ("no header", {"a.csv": "".join(ROWS)}, RUN, ["a.csv", "row 1", "t_s"]),
    ("semicolons", {"a.csv": LOG.replace(",", ";")}, RUN, ["a.csv", "row 1", "commas"]),
    ("millimetres in the header", {"a.csv": LOG.replace("tip_x_m", "tip_x_mm")}, RUN,
     ["row 1", "tip_x_mm", "convert it to m"]),
    ("millimetres in the cells",
     {"a.csv": HEADER + "".join(f"{k},0,0,0,0,{k},0,100\n" for k in range(9))}, RUN,
     ["row 2", "millimetres", "1000"]),
    ("a tip out of reach", {"a.csv": row(5, "0,0.1\n", "0,0.4\n")}, RUN,
     ["row 5", "tip_x_m", "0.1 m long", "unit"]),
    ("time going backward", {"a.csv": row(4, "0.02", "0.005")}, RUN,
     ["row 4", "column t_s", "0.005 follows 0.01", "sort"]),
    ("time repeated", {"a.csv": row(4, "0.02", "0.01")}, RUN, ["row 4", "column t_s", "repeated"]),
    ("time missing", {"a.csv": row(4, "0.02", "")}, RUN, ["row 4", "column t_s", "missing"]),
    ("tension missing", {"a.csv": row(4, "0.2", "nan")}, RUN, ["row 4", "tau1_N", "fill it in"]),
    ("tension negative", {"a.csv": row(4, "0.2", "-0.2")}, RUN, ["row 4", "tau1_N", "only pull"]),
    ("a word", {"a.csv": row(4, "0.2", "much")}, RUN, ["row 4", "tau1_N", "'much'"]),
    ("infinity", {"a.csv": row(4, "0.002", "inf")}, RUN, ["row 4", "tip_x_m", "'inf'"]),
    ("decimal commas", {"a.csv": row(4, "0.2", "0,2")}, RUN, ["row 4", "9 cells"]),
    ("row cut off", {"a.csv": LOG + "0.12,1\n"}, RUN, ["row 14", "2 cells"]),
    ("a tendon too few", {"a.csv": LOG.replace("tau3_N,", "")}, RUN, ["tau3_N", "3 tendons"]),
    ("no tip at all", {"a.csv": HEADER + "0,0,0,0,0,,,\n0.1,0,0,0,0,,,\n"}, RUN,
     ["tip_x_m", "every sample is missing"]),
    ("too few samples", {"a.csv": HEADER + "".join(ROWS[:3])}, RUN, ["a.csv", "at least 5"]),
    ("a tip that never moves", {"a.csv": still()}, RUN, ["a.csv", "never moves"]),
    ("not text", {"a.csv": b"\xff\xfe\x00"}, RUN, ["a.csv", "utf-16", "encoding"]),
    ("an unknown kind of file", {"a.xlsx": b"PK"}, ["robot.toml", "a.xlsx"],
     ["a.xlsx", "expected .csv"]),
    ("a C3D that is none", {"a.c3d": b"no motion capture"}, ["robot.toml", "a.c3d"], ["a.c3d"]),
    ("a MAT without a mapping", {"a.mat": b"MATLAB"}, ["robot.toml", "a.mat"],
     ["a.mat", "mapping"]),
    ("a mapping that is absent", {"a.csv": TABLE}, [*RUN, "--mapping", "m.toml"],
     ["m.toml", "No such file"]),
    ("a mapping of another file", {"a.csv": LOG, "m.toml": MAP}, [*RUN, "--mapping", "m.toml"],
     ["a.csv", "no column 't'", "t_s"]),
    ("a mapped time going backward",
     {"a.csv": TABLE.replace("0.05,", "0.01,"), "m.toml": MAP}, [*RUN, "--mapping", "m.toml"],
     ["a.csv", "row 7", "column t", "earlier than row 6"]),
    ("a mapped word", {"a.csv": TABLE.replace("0.05,", "0.05s,"), "m.toml": MAP},
     [*RUN, "--mapping", "m.toml"], ["a.csv", "row 7", "column t", "not a number"]),
    ("mapped milliseconds taken for seconds",
     {"a.csv": "t,x,y,z\n" + "".join(f"{10 * k},0,0,0.1\n" for k in range(9)), "m.toml": MAP},
     [*RUN, "--mapping", "m.toml"], ["a.csv", "10 s apart", "ms"]),
    ("an unknown condition", {"a.csv": TABLE, "m.toml": MAP + "[conditions]\nwind = 3\n"},
     [*RUN, "--mapping", "m.toml"], ["a.csv", "'wind'", "known:"]),
    ("a condition too many", {"a.csv": LOG}, [*RUN, "--condition", "payload_mass=0,1"],
     ["--condition payload_mass=0,1", "1 number"]),
    ("an unknown parameter", {"a.csv": LOG}, [*RUN, "--fit", "stiffness"],
     ["'stiffness'", "young_modulus"]),
    ("a parameter that is not there", {"a.csv": LOG}, [*RUN, "--fit", "payload_mass"],
     ["payload_mass", "starting value"]),
    ("a parameter named twice", {"a.csv": LOG}, [*RUN, "--fit", "density,density"], ["twice"]),
    ("bounds that are none", {"a.csv": LOG}, [*RUN, "--bounds", "young_modulus=1e5"],
     ["--bounds", "LOW:HIGH"]),
    ("bounds beside the start", {"a.csv": LOG}, [*RUN, "--bounds", "young_modulus=1:2"],
     ["young_modulus", "between"]),
    ("an unknown optimiser", {"a.csv": LOG}, [*RUN, "--optimiser", "luck"], ["'luck'", "adam"]),
    ("an unknown material", {"a.csv": LOG}, [*RUN, "--material", "jelly"],
     ["'jelly'", "ecoflex-00-30"]),
    ("no starts", {"a.csv": LOG}, [*RUN, "--starts", "0"], ["--starts", "from 1"]),
    ("nothing to resume", {"a.csv": LOG}, [*RUN, "--resume"], ["checkpoint.json", "without"]),
    ("an empty window", {"a.csv": LOG}, [*RUN, "--window", "5", "6"],
     ["a.csv", "5 to 6 s", "0.11"]),
    ("a release cut into windows", {"a.csv": TABLE, "m.toml": MAP},
     [*RUN, "--mapping", "m.toml", "--split", "1", "0.1"], ["a.csv", "release"]),
    ("a drift of nothing known", {"a.csv": LOG}, [*RUN, "--drift", "weather=1"],
     ["'weather'", "clock, tip, inputs"]),
    ("a drift without a duration", {"a.csv": LOG}, [*RUN, "--drift", "tip"],
     ["--drift tip", "WHAT=DURATION"]),
    ("a held-out log that is absent", {"a.csv": LOG}, [*RUN, "--held-out", "b.csv"],
     ["b.csv", "No such file"]),
]  # fmt: skip


@pytest.mark.parametrize("name, files, argv, fragments", CASES, ids=[case[0] for case in CASES])
def test_says_what_is_wrong(tmp_path, monkeypatch, capsys, name, files, argv, fragments):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("calibration.cli.calibrate.prepare_jax", lambda: None)
    # Whatever gets past the checks must not cost a simulation.
    monkeypatch.setattr("calibration.problem.problem.evaluate", _unexpected)
    sr.save_scene(sr.hybrid_robot(), tmp_path / "robot.toml")
    for path, content in files.items():
        raw = content if isinstance(content, bytes) else content.encode()
        (tmp_path / path).write_bytes(raw)
    status = main(["calibrate", *argv])
    shown = capsys.readouterr()
    assert status == 2, shown
    # Notes may stand before it; the error is one line, and the last.
    message = shown.err.splitlines()[-1]
    assert message.startswith("softrod: error: ")
    assert "Traceback" not in shown.err
    for fragment in fragments:
        assert fragment in message


def _unexpected(*args):
    raise AssertionError("simulated in spite of bad input")


def test_there_are_thirty_of_them():
    assert len({case[0] for case in CASES}) >= 30
