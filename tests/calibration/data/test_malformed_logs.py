"""Logs and mappings that are broken: read right, or refused in one sentence that names the file.
Never another exception, whatever is in them."""

import json

import numpy as np
import pytest
from test_foreign_tables import INPUTS, TABLE, TIME, TIP, check, load, rod

from calibration import RecordingError, load_recording

LOG = "t_s,tau1_N,p1_Pa,tip_x_m,tip_y_m,tip_z_m\n" + "".join(
    f"{0.01 * k:.2f},{0.1 * k:.1f},0,{1e-4 * k},0,0.1\n" for k in range(8)
)
DEEP = 3000
OK = TIME + TIP

# What is wrong with a log of this project's own format.
LOGS = {
    "nothing": b"",
    "one byte": b"\x00",
    "line ends": b"\n\n\r\n",
    "commas": b",,,,,\n,,,,,\n",
    "header twice": LOG.split("\n")[0] + "\n" + LOG,
    "long cell": LOG.replace("0.1,0,", "0." + "1" * 200_000 + ",0,"),
    "long text": LOG.replace("0.1,0,", "x" * 200_000 + ",0,"),
    "long quoted cell": LOG.replace("0.1,0,", '"' + "1" * 200_000 + '",0,'),
    "open quote": LOG.replace("0.1,0,", '"0.1,0,'),
    "huge exponent": LOG.replace("0.1,0,", "1e999,0,"),
    "huge integer": LOG.replace("0.1,0,", "9" * 400 + ",0,"),
    "tiny": LOG.replace("0.1,0,", "1e-999,0,"),
    "hex": LOG.replace("0.1,0,", "0x10,0,"),
    "complex": LOG.replace("0.1,0,", "1+2j,0,"),
    "infinite time": LOG.replace("0.01,", "inf,"),
    "times all one": LOG.replace("0.0", "1.0"),
    "NA time": LOG.replace("0.01,", "NA,"),
    "NA input": LOG.replace("0.1,0,", "NA,0,"),
    "row of units": LOG.replace("\n", "\ns,N,Pa,m,m,m\n", 1),
    "ISO time": LOG.replace("0.0", "2024-01-05 10:00:00.0"),
    "semicolons": LOG.replace(",", ";"),
    "tabs": LOG.replace(",", "\t"),
    "decimal commas": LOG.replace(",", ";").replace(".", ","),
    "UTF-16": LOG.encode("utf-16"),
    "Latin-1": LOG.replace("tau1", "spannung_für").encode("latin-1"),
    "half a letter": LOG.encode() + b"\xc3",
    "zip": b"PK\x03\x04" + bytes(100),
    "random": np.random.default_rng(0).bytes(2000),
    "random letters": "".join(map(chr, np.random.default_rng(1).integers(32, 700, 3000))),
    "null in a cell": LOG.replace("0.1,0,", "0\x00,0,"),
    "form feed": LOG.replace("0.1,0,", "0\x0c.1,0,"),
    "one row": "\n".join(LOG.split("\n")[:2]),
    "tip of zeros": LOG.replace("0.1\n", "0\n").replace("0.0001,", "0,"),
    "many columns": ",".join(f"c{k}" for k in range(5000)) + "\n" + ",".join("1" * 5000),
}  # fmt: skip

# Mappings, of a plain table.
MAPPINGS = {
    "empty": "",
    "null": "\0",
    "not UTF-8": b"[time]\ncolumn = '\xff'\n",
    "UTF-16": OK.encode("utf-16"),
    "deep arrays": "a = " + "[" * DEEP + "]" * DEEP,
    "deep tables": "a = " + "{b=" * DEEP + "1" + "}" * DEEP,
    "deep keys": "[" + ".".join("a" * DEEP) + "]\nb = 1\n",
    "deep keys in a known table": OK + "[csv." + ".".join("a" * DEEP) + "]\nb = 1\n",
    "deep value of a known key": TIME + "unit." + ".".join("a" * DEEP) + " = 1\n" + TIP,
    "huge integer": OK + "missing = " + "9" * 400 + "\n",
    "integer of 5000 digits": OK + "missing = " + "9" * 5000 + "\n",
    "huge float": OK + "missing = 1e999\n",
    "nan": OK + "missing = nan\n",
    "huge offset": OK + INPUTS.replace('"F"', f'"F"\noffset = {"9" * 400}'),
    "scale of nan": OK + INPUTS.replace('"F"', '"F"\nscale = nan'),
    "huge condition": OK + "[conditions]\ndensity = " + "9" * 400 + "\n",
    "condition is a text": OK + "[conditions]\ndensity = 'heavy'\n",
    "skip inf": OK + "[csv]\nskip_rows = inf\n",
    "skip nan": OK + "[csv]\nskip_rows = nan\n",
    "skip -1": OK + "[csv]\nskip_rows = -1\n",
    "skip half": OK + "[csv]\nskip_rows = 0.5\n",
    "skip all": OK + "[csv]\nskip_rows = 4\n",
    "skip more": OK + f"[csv]\nskip_rows = {10**14}\n",
    "skip true": OK + "[csv]\nskip_rows = true\n",
    "no delimiter": OK + "[csv]\ndelimiter = ''\n",
    "two delimiters": OK + "[csv]\ndelimiter = ';;'\n",
    "digit for a delimiter": OK + "[csv]\ndelimiter = '1'\n",
    "quote for a delimiter": OK + "[csv]\ndelimiter = '\"'\n",
    "line end for a delimiter": OK + '[csv]\ndelimiter = "\\n"\n',
    "null for a delimiter": OK + '[csv]\ndelimiter = "\\u0000"\n',
    "number for a delimiter": OK + "[csv]\ndelimiter = 1\n",
    "no decimal": OK + "[csv]\ndecimal = ''\n",
    "decimal x": OK + "[csv]\ndecimal = 'x'\n",
    "decimal is thousands": OK + "[csv]\ndecimal = ','\nthousands = ','\n",
    "thousands is a digit": OK + "[csv]\nthousands = '0'\n",
    "encoding": OK + "[csv]\nencoding = 'klingon'\n",
    "encoding that is none": OK + "[csv]\nencoding = 'base64'\n",
    "encoding with a null": OK + '[csv]\nencoding = "utf\\u0000"\n',
    "header is a text": OK + "[csv]\nheader = 'yes'\n",
    "missing is a table": OK + "[csv]\nmissing = { a = 1 }\n",
    "missing is true": OK + "missing = true\n",
    "time is a number": "time = 1\n" + TIP,
    "time twice": TIME + TIME + TIP,
    "time is a list": "[[time]]\ncolumn = 't'\n" + TIP,
    "column is a list": TIME.replace('"t"', "['t']") + TIP,
    "column is empty": TIME.replace('"t"', "''") + TIP,
    "format": TIME + "format = '%Q'\n" + TIP,
    "rate nan": "[time]\nrate = nan\n" + TIP,
    "rate inf": "[time]\nrate = inf\n" + TIP,
    "rate 0": "[time]\nrate = 0\n" + TIP,
    "rate huge": "[time]\nrate = 1e300\n" + TIP,
    "rate tiny": "[time]\nrate = 1e-300\n" + TIP,
    "tip is a list": TIME + "tip = ['X', 'Y', 'Z']\n",
    "columns of numbers": TIME + "[tip]\ncolumns = [1, 2, 3]\n",
    "columns of two": TIME + "[tip]\ncolumns = ['X', 'Y']\n",
    "columns empty": TIME + "[tip]\ncolumns = ['', '', '']\n",
    "columns and markers": OK + "markers = [['X', 'Y', 'Z']]\n",
    "markers empty": TIME + "[tip]\nmarkers = []\n",
    "markers of nothing": TIME + "[tip]\nmarkers = [[]]\n",
    "markers of numbers": TIME + "[tip]\nmarkers = [[1, 2, 3]]\n",
    "markers nested": TIME + "[tip]\nmarkers = [[['X'], ['Y'], ['Z']]]\n",
    "axes empty": OK + "axes = ''\n",
    "axes nested": OK + "axes = 'x,y,z,x,y,z'\n",
    "unit": OK.replace("mm", "mile"),
    "unit is a number": OK.replace('"mm"', "1000"),
    "origin huge": OK + "origin = [1e308, 1e308, 1e308]\n",
    "origin nan": OK + "origin = [nan, 0, 0]\n",
    "origin of flags": OK + "origin = [true, false, true]\n",
    "origin and rest": OK + "origin = [0, 0, 0]\nrest = true\n",
    "rest is a number": OK + "rest = 1\n",
    "rest of three samples": OK + "rest = true\n",
    "tensions is a table": OK + "[tensions]\ncolumn = 'X'\n",
    "tensions of numbers": OK + "tensions = [1]\n",
    "tensions empty": OK + "[[tensions]]\n",
    "base markers empty": OK + "[[base_markers]]\n",
    "base markers in one place": OK
    + "[[base_markers]]\ncolumns = ['X', 'Y', 'Z']\nposition = [0, 0, 0]\n" * 3,
    "base markers nan": OK
    + "[[base_markers]]\ncolumns = ['X', 'Y', 'Z']\nposition = [0, 0, nan]\n",
    "time of a tension is a text": OK + "[[tensions]]\ncolumn = 'X'\ntime = 't'\n",
}  # fmt: skip

# Tables, of a mapping that is right.
TABLES = {
    "empty": "",
    "header only": "t,X,Y,Z\n",
    "header cut": TABLE.replace(",Z", ""),
    "long cell": TABLE.replace("0.1,", "1" * 200_000 + ","),
    "long text": TABLE.replace("0.1,", '"' + "x" * 200_000 + '",'),
    "long header": TABLE.replace("X", "X" * 200_000),
    "huge number": TABLE.replace("0.1,", "1e999,"),
    "infinite": TABLE.replace("0.1,", "-inf,"),
    "texts": TABLE.replace("0,", "a,"),
    "texts later": TABLE.replace("0.2,", "a,"),
    "open quote": TABLE.replace("0.1,", '"0.1,'),
    "no times": TABLE.replace("\n0.0", "\nNA,0.0").replace("t,X", "t,u,X"),
    "a row more": TABLE + "0.03,1,2,3,4,5\n",
    "a row less": TABLE + "0.03\n",
    "all missing": "t,X,Y,Z\n0.00,,,\n0.01,NA,NA,\n0.02,-,,nan\n",
    "dates of the year 0": TABLE.replace("0.0", "0000-01-01 00:00:00.0"),
    "dates of the year 9999": TABLE.replace("0.0", "9999-01-01 00:00:00.0"),
    "dates without end": TABLE.replace("0.0", "2024-01-05 99:99:99.0"),
    "dates and numbers": TABLE.replace("0.01,", "2024-01-05,"),
    "numbers and dates": TABLE.replace("0.00,", "2024-01-05,"),
    "Motive without rows": "Format Version,1.23\n\nFrame,Time (Seconds),X\n",
    "Motive of one line": "Format Version,1.23",
    "Motive cut": "Format Version,1.23\n,,Marker\n,,tip\n,,1\n,,Position\nFrame,Time (Seconds),X\n",
    "Vicon of one line": "Trajectories\n",
    "Vicon cut": "Trajectories\n100\n,,tip,,\nFrame,Sub Frame,X,Y,Z\n",
    "Qualisys of one line": "NO_OF_FRAMES\t3",
    "Qualisys cut": "NO_OF_FRAMES\t3\nMARKER_NAMES\ttip\n",
    "TRC of one line": "PathFileType\t4",
    "LabVIEW of one line": "LabVIEW Measurement\t",
    "LabVIEW cut": "LabVIEW Measurement\t\n***End_of_Header***\t\n",
    "only spaces": "   \n   \n",
    "only separators": ",,,\n,,,\n",
}


def one_sentence(error, *names):
    message = str(error)
    assert any(name in message for name in names)
    assert "\n" not in message
    assert len(message) < 2500


def refused_or_read(loading, *names):
    """The recording, or None if it was refused as it should be."""
    try:
        recording = loading()
    except RecordingError as error:
        return one_sentence(error, *names)
    assert np.all(np.diff(recording.times) > 0)
    assert not np.any(np.isinf(recording.tip_positions))
    return recording


@pytest.mark.parametrize("name", LOGS)
def test_logs(tmp_path, name):
    content = LOGS[name]
    path = tmp_path / "a.csv"
    path.write_bytes(content if isinstance(content, bytes) else content.encode("utf-8"))
    recording = refused_or_read(lambda: load_recording(path, rod()), "a.csv")
    readable = {"UTF-16", "one row", "tiny"}
    assert (recording is not None) == (name in readable) or name == "tip of zeros"


@pytest.mark.parametrize("name", MAPPINGS)
def test_mappings(tmp_path, name):
    content = MAPPINGS[name]
    (tmp_path / "a.csv").write_text(TABLE.replace("\n", ",1,1\n").replace("Z,1,1", "Z,F,P"))
    mapping = tmp_path / "m.toml"
    mapping.write_bytes(content if isinstance(content, bytes) else content.encode("utf-8"))
    loading = lambda: load_recording(tmp_path / "a.csv", rod(), mapping=mapping)
    assert refused_or_read(loading, "a.csv", "m.toml") is None


@pytest.mark.parametrize("name", TABLES)
def test_tables(tmp_path, name):
    recording = refused_or_read(lambda: load(tmp_path, TABLES[name], OK), "log.csv")
    assert recording is None


def test_the_table_and_the_mapping_without_a_fault_are_read(tmp_path):
    check(load(tmp_path, TABLE, OK))


@pytest.mark.parametrize("name", ["", "\0", "a" * 5000, "."])
def test_paths_that_are_none(tmp_path, name):
    (tmp_path / "m.toml").write_text(OK)
    for path, mapping in ((f"{name}.csv", None), (f"{name}.csv", "m"), ("a.csv", f"{name}m.toml")):
        mapping = tmp_path / "m.toml" if mapping == "m" else mapping
        with pytest.raises(RecordingError):
            load_recording(path, rod(), mapping=mapping)


@pytest.mark.parametrize(
    "content",
    [
        "[" * DEEP + "]" * DEEP,
        "{}",
        "[]",
        "nan",
        '{"fit": 1, "done": 1, "x": 1, "loss": 1e999}',
        "\0",
    ],
)
def test_checkpoints_that_are_none(tmp_path, content):
    from calibration.search.checkpoint import Checkpoint, CheckpointError

    (tmp_path / "c.json").write_text(content)
    saved = object.__new__(Checkpoint)
    saved.path, saved._of = tmp_path / "c.json", "this fit"
    with pytest.raises(CheckpointError, match="c.json"):
        saved._read()


@pytest.mark.parametrize("done, x", [([{"x": "a"}], None), ([], ["a"]), (7, None), ([], [[1e400]])])
def test_checkpoints_of_this_fit_with_other_content(tmp_path, done, x):
    from calibration.search.checkpoint import Checkpoint, CheckpointError

    content = {"fit": "this fit", "done": done, "x": x, "loss": 10**400}
    (tmp_path / "c.json").write_text(json.dumps(content))
    saved = object.__new__(Checkpoint)
    saved.path, saved._of = tmp_path / "c.json", "this fit"
    with pytest.raises(CheckpointError, match="c.json"):
        saved._read()
