"""Scene files and arguments that make no sense: one line that says where and what, status 2.

None of them is solved: what is slow or large is refused as well.
"""

# ruff: noqa: F811 - pytest knows fixtures by their names

from pathlib import Path

import pytest
from command_line import in_a_directory_of_its_own, run  # noqa: F401

BARE = """[rod]
length = 0.1
section = { shape = "circle", radius = 6e-3 }
young_modulus = 5.0e4
poisson_ratio = 0.49
density = 1070.0
"""


def with_(old, new):
    assert old in BARE
    return BARE.replace(old, new)


def nested(opening, closing, depth, inner=""):
    return opening * depth + inner + closing * depth


def dotted(depth):
    return ".".join(["a"] * depth)


# The scene, and what the message must hold besides the name of the file.
SCENES = {
    "nothing": ("", ["rod is missing", "[rod]"]),
    "a number for a table": ("rod = 1\n", ["rod = 1", "[rod]"]),
    "brackets that never close": (BARE + f"gravity = {'[' * 5000}", ["nested too deep"]),
    "arrays in arrays": (BARE + f"gravity = {nested('[', ']', 5000)}\n", ["nested too deep"]),
    "fewer of them": (BARE + f"gravity = {nested('[', ']', 200)}\n", ["gravity", "3 numbers"]),
    "tables in tables": (
        BARE + f"gravity = {nested('{a = ', '}', 3000, '1')}\n",
        ["nested too deep"],
    ),
    "a key of many dots": (BARE + f"{dotted(2000)} = 1\n", ["rod.a", "unknown key"]),
    "a known one": (BARE + f"gravity.{dotted(2000)} = 1\n", ["rod.gravity", "3 numbers"]),
    "a header of many dots": (BARE + f"[payload.{dotted(2000)}]\n", ["payload.a", "unknown key"]),
    "actuators of many dots": (BARE + f"[[tendons.{dotted(2000)}]]\n", ["tendons", "[[tendons]]"]),
    "400 digits": (with_("0.1", "1" + "0" * 400), ["rod.length = 1000", "[m], above 0"]),
    "5000 digits": (with_("0.1", "1" + "0" * 5000), ["digits", "1e9"]),
    "6000 hexadecimal digits": (with_("0.1", "0x1" + "0" * 6000), ["rod.length", "[m], above 0"]),
    "too large for a float": (with_("0.1", "1e999"), ["rod.length = inf", "above 0"]),
    "not a number": (with_("0.1", "nan"), ["rod.length = nan", "above 0"]),
    "infinity": (with_("5.0e4", "inf"), ["rod.young_modulus = inf", "[Pa]"]),
    "true": (with_("0.1", "true"), ["rod.length = True", "a number"]),
    "a date": (with_("0.1", "2020-01-01"), ["rod.length", "a number"]),
    "a word": (with_("0.1", '"0.1"'), ["rod.length = '0.1'", "a number"]),
    "a list": (with_("0.1", "[0.1]"), ["rod.length = [0.1]", "a number"]),
    "an incompressible rod": (with_("0.49", "0.5"), ["rod.poisson_ratio = 0.5", "below 0.5"]),
    "a section that is a word": (
        with_('{ shape = "circle", radius = 6e-3 }', '"circle"'),
        ["rod.section = 'circle'", "one table"],
    ),
    "a shape that is a list": (with_('"circle"', '["circle"]'), ["rod.section.shape", '"circle"']),
    "no shape": (with_('shape = "circle",', ""), ["rod.section.shape is missing", "annulus"]),
    "a tube inside out": (
        with_('"circle", radius = 6e-3', '"annulus", outer_radius = 1e-3, inner_radius = 2e-3'),
        ["rod.section.inner_radius = 0.002", "outer_radius = 0.001"],
    ),
    "a negative moment": (
        with_(
            '"circle", radius = 6e-3',
            '"general", area = 1e-3, second_moments = [1, -1], torsion_constant = 1',
        ),
        ["second_moments = [1, -1]", "above 0"],
    ),
    "a key of a million letters": (BARE + "a" * 1_000_000 + " = 1\n", ["rod.aaa", "unknown"]),
    "a word of a million letters": (BARE + f'plane = "{"x" * 10**6}"\n', ["rod.plane", '"xz"']),
    "20,000 keys": (
        BARE + "".join(f"k{i} = 1\n" for i in range(20_000)),
        ["rod.k0 = 1", "unknown key"],
    ),
    "a key with a line break": (BARE + '"a\\nb" = 1\n', ["rod.'a\\nb' = 1", "unknown key"]),
    "a key that colours": (BARE + '"\\u001b[31m" = 1\n', ["rod.'\\x1b[31m' = 1", "unknown key"]),
    "a plane that is a list": (BARE + "plane = [1]\n", ["rod.plane = [1]", '"xz"']),
    "no flag": (BARE + "inextensible = 1\n", ["rod.inextensible = 1", "true or false"]),
    "one bracket": (BARE + "[tendons]\noffset = [0, 0]\n", ["tendons", "[[tendons]]"]),
    "tendons that are numbers": ("tendons = [1, 2]\n" + BARE, ["tendons = [1, 2]", "[[tendons]]"]),
    "no offset": (BARE + "[[tendons]]\n", ["tendons[0].offset is missing", "2 numbers"]),
    "three offsets": (BARE + "[[tendons]]\noffset = [1, 2, 3]\n", ["tendons[0].offset", "2 num"]),
    "a word for an offset": (BARE + '[[tendons]]\noffset = "0,0"\n', ["tendons[0].offset = '0,0'"]),
    "outside the section": (
        BARE + "[[tendons]]\noffset = [1e308, 1e308]\n",
        ["tendons[0].offset", "outside the section"],
    ),
    "no area": (BARE + "[[chambers]]\narea = 0\noffset = [0, 0]\n", ["chambers[0].area = 0"]),
    "too much of it": (
        BARE + "[[chambers]]\narea = 1e300\noffset = [0, 0]\n",
        ["chambers[0].area = 1e+300", "larger than the section"],
    ),
    "two payloads": (BARE + "[[payload]]\nmass = 1\n", ["payload", "one table"]),
    "a payload without a mass": (BARE + "[payload]\n", ["payload.mass is missing", "[kg]"]),
    "a force that is a number": (BARE + "[tip_load]\nforce = 1\n", ["tip_load.force = 1", "3 num"]),
    "an infinite force": (BARE + "[tip_load]\nforce = [inf, 0, 0]\n", ["tip_load.force = [inf"]),
    "no turn": (BARE + "base_quaternion = [0, 0, 0, 0]\n", ["base_quaternion", "norm is 0"]),
    "a huge turn": (BARE + "base_quaternion = [1e200, 0, 0, 0]\n", ["base_quaternion", "norm is"]),
    "a rest without length": (BARE + "rest_stretch = [0, 0, 0]\n", ["rest_stretch", "above 0"]),
    "twice the same": (BARE + "length = 1\n", ["not a TOML file", "line 7"]),
    "JSON": ('{"rod": {"length": 1}}', ["not a TOML file", "line 1"]),
    "a control character": ("\x00", ["not a TOML file"]),
    "bytes": (b"\xff\xfe\x00", ["not UTF-8"]),
}

MOTION = ["simulate", "robot.toml", "--dt", "0.1", "--duration", "0.2"]
LARGE = ["GB of memory", "steps", "are allowed", "larger --dt"]
ARGUMENTS = [
    (["solve", "robot.toml", "--tension", "1", "-1e400", "0"], ["--tension", "-1e400", "finite"]),
    (["solve", "robot.toml", "--pressure", "-1e999999999"], ["--pressure", "-1e999999999"]),
    (["solve", "robot.toml", "--pressure", "-inf"], ["--pressure", "'-inf'", "finite"]),
    (["solve", "robot.toml", "--pressure", "1_0"], ["--pressure", "'1_0'"]),
    (["solve", "robot.toml", "--pressure", ""], ["--pressure", "''", "finite"]),
    *(
        (["solve", "robot.toml", "--intervals", n], ["--intervals", n])
        for n in ("0", "-3", "2.5", "nan", "inf", "1e30", "x")
    ),
    *(
        (["solve", "robot.toml", "--tolerance", x], ["--tolerance", x])
        for x in ("0", "1", "nan", "-1e-4", "x")
    ),
    (["solve", "robot.toml\0"], ["robot.toml", "null byte"]),
    (["solve", "robot.toml/x"], ["robot.toml/x", "Not a directory"]),
    (["simulate", "robot.toml", "--dt", "1e-3", "--duration", "3000"], ["3e+06 steps", *LARGE]),
    (["simulate", "robot.toml", "--dt", "1e-308", "--duration", "1e308"], ["inf steps", *LARGE]),
    (
        ["simulate", "robot.toml", "--dt", "0.1", "--duration", "200", "--intervals", "10000"],
        ["2e+03 steps", *LARGE],
    ),
    ([*MOTION, "--alpha", "nan"], ["--alpha nan", "-0.5 to 0"]),
    ([*MOTION, "--alpha", "-1e400"], ["--alpha -inf", "-0.5 to 0"]),
    ([*MOTION, "--tolerance", "2"], ["--tolerance", "below 1"]),
    ([*MOTION, "--out", "a\0b"], ["--out", "not the name of a file"]),
    ([*MOTION, "--out", ""], ["--out", "not the name of a file"]),
    ([*MOTION, "--out", "robot.toml/a.csv"], ["--out robot.toml/a.csv"]),
    (["plot", ""], ["--out .png", "for a picture"]),
    (["plot", "a.csv", "--intervals", "6"], ["--intervals", "for a scene only"]),
    (["-1"], ["COMMAND", "'-1'"]),
]


def check(capsys, argv, fragments):
    status, out, err = run(capsys, *argv)
    assert (status, out) == (2, "")
    lines = err.splitlines()
    assert len(lines) == 1 and lines[0].startswith("softrod: error: ")
    assert len(err) < 700 and err.isascii()
    for fragment in fragments:
        assert fragment in err


@pytest.mark.parametrize("name", SCENES)
def test_scene(capsys, name):
    content, fragments = SCENES[name]
    Path("bad.toml").write_bytes(content if isinstance(content, bytes) else content.encode())
    check(capsys, ["solve", "bad.toml"], ["bad.toml", *fragments])


@pytest.mark.parametrize("argv, fragments", ARGUMENTS, ids=[" ".join(x[0])[:60] for x in ARGUMENTS])
def test_arguments(capsys, argv, fragments):
    check(capsys, argv, fragments)


def test_a_mark_of_the_encoding_does_no_harm(capsys):
    import softrod_jax as sr

    Path("marked.toml").write_text("\ufeff" + BARE, encoding="utf-8")
    assert sr.load_scene("marked.toml").length == 0.1
