"""Scene files: what is read, what is refused and how the refusal is worded."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from softrod_jax.scene.chambers import Chambers
from softrod_jax.scene.file import load_scene, save_scene
from softrod_jax.scene.loads import Payload, TipLoad
from softrod_jax.scene.robots import hybrid_robot
from softrod_jax.scene.scene import Scene, as_arrays
from softrod_jax.scene.schema import SceneError
from softrod_jax.scene.sections import Annulus, Circle, GeneralSection, Rectangle
from softrod_jax.scene.tendons import Tendons

ROBOT = """
[rod]
length = 0.1
section = { shape = "circle", radius = 6e-3 }
young_modulus = 5.0e4
poisson_ratio = 0.49
density = 1070
bending_damping = 1e-6
shear_damping = 0.0
gravity = [-9.81, 0.0, 0.0]
drag_coefficient = [0.03, 0.03, 0.0]

[[tendons]]
offset = [4e-3, 0.0]
[[tendons]]
offset = [0.0, -4e-3]

[[chambers]]
area = 7.0685835e-6
offset = [0.0, 0.0]

[payload]
mass = 0.052

[tip_load]
force = [0.0, 0.0, 0.0]
moment = [0.0, 1e-3, 0.0]
"""

BARE = """
[rod]
length = 0.1
section = { shape = "circle", radius = 6e-3 }
young_modulus = 5.0e4
poisson_ratio = 0.49
density = 1070.0
"""


def write(tmp_path, text):
    path = tmp_path / "robot.toml"
    path.write_text(text, encoding="utf-8")
    return path


def assert_same(a, b):
    """Equal as pytrees: structure, dtype and every bit."""
    assert jax.tree.structure(a) == jax.tree.structure(b)
    for x, y in zip(jax.tree.leaves(a), jax.tree.leaves(b), strict=True):
        assert x.dtype == y.dtype == jnp.float64
        assert x.shape == y.shape
        assert np.array_equal(x, y)


def test_reads_every_key(tmp_path):
    scene = load_scene(write(tmp_path, ROBOT))
    assert scene.length == 0.1
    assert isinstance(scene.section, Circle)
    assert scene.section.radius == 6e-3
    assert scene.density == 1070.0
    assert scene.bending_damping == 1e-6
    assert np.array_equal(scene.gravity, [-9.81, 0, 0])
    assert np.array_equal(scene.drag_coefficient, [0.03, 0.03, 0])
    assert np.array_equal(scene.tendons.offsets, [[4e-3, 0], [0, -4e-3]])
    assert np.array_equal(scene.chambers.areas, [7.0685835e-6])
    assert scene.payload.mass == 0.052
    assert scene.tip_load.force is None
    assert np.array_equal(scene.tip_load.moment, [0, 1e-3, 0])
    for leaf in jax.tree.leaves(scene):
        assert isinstance(leaf, jax.Array)
        assert leaf.dtype == jnp.float64
        assert not leaf.weak_type


def test_absent_is_none(tmp_path):
    scene = load_scene(write(tmp_path, BARE))
    present = {"length", "section", "young_modulus", "poisson_ratio", "density"}
    for name in Scene.__dataclass_fields__:
        value = getattr(scene, name)
        assert (value is not None and value is not False) == (name in present), name


@pytest.mark.parametrize(
    "line",
    [
        "bending_damping = 0",
        "shear_damping = [0, 0, 0.0]",
        "drag_coefficient = 0.0",
        "gravity = [0, 0, 0]",
        "[payload]\nmass = 0",
        "[tip_load]\nforce = [0, 0, 0]",
        "[tip_load]",
    ],
)
def test_zero_is_absent(tmp_path, line):
    assert_same(load_scene(write(tmp_path, BARE + line)), load_scene(write(tmp_path, BARE)))


SCENES = {
    "paper": lambda: hybrid_robot(gravity=jnp.array([0.0, 0.0, -9.81])),
    "third": lambda: hybrid_robot(length=1 / 3),
    "everything": lambda: as_arrays(
        Scene(
            length=0.1,
            section=Rectangle(0.03, 0.01),
            young_modulus=1e5 / 3,
            poisson_ratio=0.0,
            density=1070.0,
            bending_damping=jnp.array([1e-6, 2e-6, 1e-300]),
            shear_damping=0.1,
            gravity=jnp.array([-9.81, 1e-17, 0.0]),
            drag_coefficient=0.03,
            tendons=Tendons(jnp.array([[0.015, -0.005]])),
            chambers=Chambers(jnp.array([1e-6, 2e-6]), jnp.array([[0.0, 0.001], [0.01, 0.0]])),
            payload=Payload(0.052),
            tip_load=TipLoad(force=jnp.array([0.1, 0.0, 1 / 7])),
            shear_correction=5 / 6,
            rest_curvature=jnp.array([0.0, 0.0, 0.0]),
            rest_stretch=jnp.array([0.0, 0.1, 1.1]),
            base_position=jnp.array([0.0, 1.0, 2.0]),
            base_quaternion=jnp.array([1.0, 2.0, 3.0, 4.0]) / jnp.sqrt(30.0),
        )
    ),
    "annulus": lambda: as_arrays(Scene(0.2, Annulus(6e-3, 2e-3), 1e5, 0.49, 1000.0)),
    "restricted": lambda: as_arrays(
        Scene(0.2, Circle(6e-3), 1e5, 0.49, 1000.0, inextensible=True, plane="yz")
    ),
    "general": lambda: as_arrays(
        Scene(0.2, GeneralSection(1e-4, jnp.array([1e-9, 2e-9]), 1.5e-9), 1e5, -0.5, 1.0)
    ),
}


@pytest.mark.parametrize("name", SCENES)
def test_round_trip_is_exact(tmp_path, name):
    scene = SCENES[name]()
    save_scene(scene, tmp_path / "a.toml")
    once = load_scene(tmp_path / "a.toml")
    save_scene(once, tmp_path / "b.toml")
    assert (tmp_path / "a.toml").read_text() == (tmp_path / "b.toml").read_text()
    assert_same(once, load_scene(tmp_path / "b.toml"))
    assert_same(scene, once)


def test_quaternion_is_normalised(tmp_path):
    text = BARE + "base_quaternion = [0.6, 0.0, 0.8000004, 0.0]"
    norm = jnp.linalg.norm(load_scene(write(tmp_path, text)).base_quaternion)
    assert abs(norm - 1) < 1e-15


def replaced(old, new):
    assert ROBOT.count(old) == 1
    return ROBOT.replace(old, new)


# What is wrong, the file, and what the message must say besides the file's name.
BAD = [
    ("not TOML", "[rod\nlength = 1", ["not a TOML file", "line 1"]),
    ("empty", "", ["rod is missing", "a table"]),
    ("unknown table", ROBOT + "[tendon]\n", ["tendon ", "unknown key", '"tendons"']),
    ("unknown key", replaced("young_m", "youngs_m"), ["rod.youngs_modulus", '"young_modulus"']),
    ("unknown in section", replaced("radius", "radios"), ["rod.section.radios", '"radius"']),
    ("unknown in tendon", ROBOT + "[[tendons]]\nofset = [0, 0]", ["tendons[2].ofset", '"offset"']),
    ("unknown far off", ROBOT + "[zebra]", ["zebra", "allowed here: rod, segments, tendons"]),
    ("missing key", replaced("length = 0.1", ""), ["rod.length is missing", "above 0"]),
    ("missing section", replaced("section =", "# section ="), ["rod.section is missing"]),
    ("missing shape", replaced('shape = "circle", ', ""), ["rod.section.shape", "annulus"]),
    ("missing radius", replaced(", radius = 6e-3", ""), ["rod.section.radius is missing", "[m]"]),
    ("missing mass", replaced("mass = 0.052", ""), ["payload.mass is missing", "[kg]"]),
    ("missing area", replaced("area =", "# area ="), ["chambers[0].area is missing"]),
    ("string", replaced("length = 0.1", 'length = "0.1"'), ["rod.length = '0.1'", "a number [m]"]),
    ("bool", replaced("length = 0.1", "length = true"), ["rod.length = True", "a number"]),
    ("list", replaced("length = 0.1", "length = [0.1]"), ["rod.length = [0.1]", "a number"]),
    ("date", replaced("length = 0.1", "length = 1979-05-27"), ["rod.length", "a number"]),
    ("nan", replaced("length = 0.1", "length = nan"), ["rod.length = nan", "a number"]),
    ("inf", replaced("length = 0.1", "length = inf"), ["rod.length = inf", "a number"]),
    ("huge", replaced("length = 0.1", f"length = 1{400 * '0'}"), ["rod.length", "..."]),
    ("endless", replaced("length = 0.1", f"length = 1{9999 * '0'}"), ["not a TOML file"]),
    ("rod not table", "rod = 3", ["rod = 3", "[rod]"]),
    ("section word", replaced('{ shape = "circle", radius = 6e-3 }', '"circle"'), ["rod.section"]),
    ("shape", replaced('"circle"', '"cirle"'), ["rod.section.shape = 'cirle'", '"circle"']),
    ("shape type", replaced('"circle"', "[1]"), ["rod.section.shape = [1]"]),
    ("one bracket", BARE + "[tendons]\noffset = [0, 0]", ["tendons", "[[tendons]]"]),
    ("two brackets", BARE + "[[payload]]\nmass = 1", ["payload", "[payload]"]),
    ("length zero", replaced("length = 0.1", "length = 0"), ["rod.length = 0", "above 0"]),
    ("radius", replaced("radius = 6e-3", "radius = -6e-3"), ["rod.section.radius = -0.006"]),
    ("modulus", replaced("5.0e4", "0.0"), ["rod.young_modulus = 0.0", "[Pa]", "above 0"]),
    ("nu", replaced("0.49", "0.5"), ["rod.poisson_ratio = 0.5", "above -1 and below 0.5"]),
    ("nu low", replaced("0.49", "-1"), ["rod.poisson_ratio = -1", "above -1"]),
    ("density", replaced("1070", "-1"), ["rod.density = -1", "kg/m^3"]),
    ("damping", replaced("1e-6", "-1e-6"), ["rod.bending_damping = -1e-06", "at least 0"]),
    ("drag", replaced("[0.03, 0.03, 0.0]", "[0.03, -1, 0]"), ["rod.drag_coefficient", "-1"]),
    ("drag size", replaced("[0.03, 0.03, 0.0]", "[1, 1]"), ["a number or a list of 3 numbers"]),
    ("gravity number", replaced("[-9.81, 0.0, 0.0]", "9.81"), ["rod.gravity", "list of 3"]),
    ("gravity bool", replaced("[-9.81, 0.0, 0.0]", "[true, 0, 0]"), ["rod.gravity", "list of 3"]),
    ("gravity nested", replaced("[-9.81, 0.0, 0.0]", "[[1], 0, 0]"), ["rod.gravity"]),
    ("mass", replaced("0.052", "-0.1"), ["payload.mass = -0.1", "at least 0"]),
    ("force size", replaced("force = [0.0, 0.0, 0.0]", "force = [0]"), ["tip_load.force = [0]"]),
    ("tendon out", replaced("[0.0, -4e-3]", "[5e-3, 5e-3]"), ["tendons[1].offset", "0.006 m"]),
    ("area zero", replaced("7.0685835e-6", "0"), ["chambers[0].area = 0", "above 0"]),
    ("area large", replaced("7.0685835e-6", "1e-3"), ["chambers[0].area = 0.001", "0.000113097"]),
    (
        "chamber out",
        BARE + "[[chambers]]\narea = 1e-6\noffset = [0.0, 7e-3]",
        ["chambers[0].offset = [0.0, 0.007]", "outside the section"],
    ),
    (
        "tube",
        BARE.replace('"circle", radius = 6e-3', '"annulus", outer_radius = 1, inner_radius = 1'),
        ["rod.section.inner_radius = 1", "outer_radius"],
    ),
    (
        "tendon beside rectangle",
        BARE.replace('"circle", radius = 6e-3', '"rectangle", width = 0.02, height = 0.01')
        + "[[tendons]]\noffset = [0.004, 0.006]",
        ["tendons[0].offset", "0.01 m of the axis in x", "0.005 m in y"],
    ),
    ("quaternion", BARE + "base_quaternion = [1, 0, 0, 1]", ["base_quaternion", "norm is 1.414"]),
    ("stretch", BARE + "rest_stretch = [0, 0, 0]", ["rod.rest_stretch", "above 0"]),
    ("correction", BARE + "shear_correction = 0", ["rod.shear_correction = 0", "above 0"]),
    ("flag", BARE + "inextensible = 1", ["rod.inextensible = 1", "true or false"]),
    (
        "damping of no shear",
        BARE + "inextensible = true\nshear_damping = 0.1",
        ["rod.shear_damping = 0.1", "inextensible rod does not stretch", "leave shear_damping out"],
    ),
    ("plane", BARE + 'plane = "xy"', ["rod.plane = 'xy'", '"xz", "yz"']),
    (
        "gravity off the plane",
        BARE + 'plane = "yz"\ngravity = [-9.81, 0.0, 0.0]',
        ["rod.gravity = [-9.81, 0.0, 0.0]", 'not in the plane "yz"', "expected 0 for x"],
    ),
    (
        "tendon off the plane",
        BARE + 'plane = "xz"\n[[tendons]]\noffset = [4e-3, 0]\n[[tendons]]\noffset = [0, 4e-3]',
        ["tendons[1].offset = [0.0, 0.004]", "expected 0 for y", "or no plane"],
    ),
]


@pytest.mark.parametrize("name, text, fragments", BAD, ids=[name for name, _, _ in BAD])
def test_refuses(tmp_path, name, text, fragments):
    with pytest.raises(SceneError) as error:
        load_scene(write(tmp_path, text))
    message = str(error.value)
    assert "robot.toml" in message
    assert "\n" not in message
    assert len(message) < 500
    for fragment in fragments:
        assert fragment in message


def test_refuses_unreadable_files(tmp_path):
    binary = tmp_path / "binary.toml"
    binary.write_bytes(b"length = \xff\xfe")
    for path, fragment in [
        (tmp_path / "absent.toml", "No such file"),
        (tmp_path, "cannot read"),
        (tmp_path / "a\0b.toml", "cannot read"),
        (binary, "UTF-8"),
    ]:
        with pytest.raises(SceneError, match=fragment):
            load_scene(path)


def test_refuses_to_save_what_could_not_be_read(tmp_path):
    robot = hybrid_robot()
    batch = jax.tree.map(lambda x: jnp.stack([x, x]), robot)
    impossible = Scene(0.1, Circle(-1.0), 1e5, 0.49, 1000.0)
    for scene, fragment in [(batch, "rod.length"), (impossible, "rod.section.radius = -1.0")]:
        with pytest.raises(SceneError) as error:
            save_scene(scene, tmp_path / "bad.toml")
        assert fragment in str(error.value)
        assert not (tmp_path / "bad.toml").exists()


def test_needs_float64(tmp_path):
    path = write(tmp_path, BARE)
    jax.config.update("jax_enable_x64", False)
    try:
        with pytest.raises(ValueError, match="jax_enable_x64"):
            load_scene(path)
    finally:
        jax.config.update("jax_enable_x64", True)
