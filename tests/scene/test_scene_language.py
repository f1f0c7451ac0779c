"""Scene files of wider robots."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from test_scene_file import assert_same, write

import softrod_jax as sr
from softrod_jax.scene.checks import checked_scene, parts_of
from softrod_jax.scene.scene import as_arrays

WIDER = """
[rod]
young_modulus = 8.0e4
poisson_ratio = 0.45
density = 1000.0
gravity = [0.0, -9.81, 0.0]

[[segments]]
length = 0.06
section = { shape = "circle", radius = 6e-3 }
section_at_end = { shape = "circle", radius = 5e-3 }
young_modulus = 2.0e5
poisson_ratio = 0.49
bending_damping = 1e-6
intervals = 6
[[segments]]
length = 0.05
section = { shape = "circle", radius = 5e-3 }
stiffness = { bending = [2e-5, 3e-5], torsion = 1e-5, axial = 6.0, shear = [2.0, 2.0] }
linear_density = 0.08
rest_curvature = [1.0, 0.0, 0.0]

[[tendons]]
offset = [4e-3, 0.0]
starts_at = 0.01
ends_at = 0.06
[[tendons]]
path = { shape = "helix", radius = 4e-3, angle = 1.5, turns = -0.5 }
[[tendons]]
path = { shape = "line", from = [9e-3, 0.0], to = [1e-3, 0.0] }
guided = "disks"
[[tendons]]
path = { shape = "points", points = [[0.0, 3e-3, 0.0], [0.05, 0.0, 3e-3], [0.11, -3e-3, 0.0]] }
offset = [1e-3, 0.0]

[[chambers]]
area = 7e-6
offset = [2e-3, 1e-3]
ends_at = 0.055

[[loads]]
at = 0.06
force = [0.0, 0.0, 5e-3]
[[loads]]
at = 0.1
moment = [1e-4, 0.0, 0.0]
frame = "body"

[[masses]]
at = 0.06
mass = 2e-3

[[markers]]
name = "m1"
at = 0.05
offset = [5e-3, 0.0, 0.0]
[[markers]]
name = "elbow"
at = 0.06
"""

UNIFORM = """
[rod]
length = 0.1
section = { shape = "circle", radius = 6e-3 }
young_modulus = 5.0e4
poisson_ratio = 0.49
density = 1070.0
"""
OF_ONE = UNIFORM.replace("young_modulus = 5.0e4\npoisson_ratio = 0.49\n", "")


def test_reads_every_key(tmp_path):
    scene = sr.load_scene(write(tmp_path, WIDER))
    first, second = scene.parts
    assert scene.section is None and scene.length == 0.06 + 0.05
    assert (first.young_modulus, first.poisson_ratio, first.density) == (2e5, 0.49, 1000.0)
    assert first.intervals == 6 and second.intervals is None
    assert (first.section.radius, first.section_at_end.radius) == (6e-3, 5e-3)
    assert first.section_at(0.5).radius == 5.5e-3
    assert first.stiffness is None and first.bending_damping == 1e-6
    # What is measured stands instead of the density of all.
    assert second.linear_density == 0.08
    assert second.stiffness.torsion == 1e-5 and np.array_equal(
        second.stiffness.bending, [2e-5, 3e-5]
    )
    assert second.bending_damping is None and np.array_equal(second.rest_curvature, [1, 0, 0])
    tendons = scene.tendons
    assert tendons.count == 4 and tendons.guides == ("rod", "rod", "disks", "rod")
    assert tendons.starts_at == (0.01, None, None, None)
    assert tendons.ends_at == (0.06, None, None, None)
    assert tendons.paths[0] is None and tendons.paths[1].turns == -0.5
    assert np.array_equal(tendons.paths[2].begin, [9e-3, 0]) and tendons.paths[2].end[0] == 1e-3
    assert tendons.paths[3].points.shape == (3, 3)
    assert np.array_equal(tendons.offsets, [[4e-3, 0], [0, 0], [0, 0], [1e-3, 0]])
    assert scene.chambers.ends_at == (0.055,) and scene.chambers.starts_at is None
    assert [load.frame for load in scene.loads] == ["base", "body"]
    assert scene.loads[0].moment is None and scene.masses[0].mass == 2e-3
    assert [marker.name for marker in scene.markers] == ["m1", "elbow"]
    assert all(isinstance(x, jax.Array) and x.dtype == float for x in jax.tree.leaves(scene))


def test_a_taper_and_stiffness_of_a_rod_without_segments(tmp_path):
    taper = 'section_at_end = { shape = "circle", radius = 5e-3 }\n'
    scene = sr.load_scene(write(tmp_path, UNIFORM + taper))
    assert scene.parts[0].section_at_end.radius == 5e-3
    measured = UNIFORM.replace("young_modulus = 5.0e4\npoisson_ratio = 0.49\ndensity = 1070.0", "")
    measured += "stiffness = { bending = [1e-4, 1e-4], torsion = 1e-4 }\nlinear_density = 0.1\n"
    scene = sr.load_scene(write(tmp_path, measured + "inextensible = true\n"))
    assert scene.young_modulus is None and scene.stiffness.axial is None
    assert scene.linear_density == 0.1


def test_ends_that_are_those_of_the_rod_are_left_out(tmp_path):
    """Three segments add up to 0.30000000000000004 m."""
    lengths = "".join(
        f'[[segments]]\nlength = {x}\nsection = {{ shape = "circle", radius = 0.01 }}\n'
        for x in (0.1, 0.1, 0.1)
    )
    rod = "[rod]\nyoung_modulus = 1e5\npoisson_ratio = 0.4\ndensity = 1000\n"
    tendon = "[[tendons]]\noffset = [1e-3, 0]\nstarts_at = 0.0\nends_at = 0.3\n"
    scene = sr.load_scene(write(tmp_path, rod + lengths + tendon))
    assert scene.length != 0.3
    assert scene.tendons.starts_at is None and scene.tendons.ends_at is None


@pytest.mark.parametrize(
    "line",
    [
        "[[loads]]\nat = 0.05\nforce = [0, 0, 0]",
        "[[masses]]\nat = 0.05\nmass = 0",
        "loads = []\n",
    ],
)
def test_zero_is_absent(tmp_path, line):
    text = line + UNIFORM if "[[" not in line else UNIFORM + line
    assert_same(sr.load_scene(write(tmp_path, text)), sr.load_scene(write(tmp_path, UNIFORM)))


@pytest.mark.parametrize("change", ["", "inextensible = true\n"])
def test_round_trip_is_exact(tmp_path, change):
    text = WIDER.replace("[rod]\n", f"[rod]\n{change}").replace("0.06", repr(0.18 / 3))
    scene = sr.load_scene(write(tmp_path, text))
    sr.save_scene(scene, tmp_path / "a.toml")
    once = sr.load_scene(tmp_path / "a.toml")
    assert_same(scene, once)
    sr.save_scene(once, tmp_path / "b.toml")
    assert (tmp_path / "a.toml").read_text() == (tmp_path / "b.toml").read_text()


def test_numbers_are_in_the_order_of_the_leaves(tmp_path):
    scene = sr.load_scene(write(tmp_path, WIDER))
    for part, leaf in zip(parts_of(scene), jax.tree.leaves(scene), strict=True):
        assert part.value is leaf and part.number.has_shape(leaf.shape), part.key
    keys = [part.key for part in parts_of(scene)]
    for key in ("segments[1].stiffness.torsion", "tendons[0].ends_at", "tendons[2].path.begin"):
        assert key in keys
    assert len(set(keys)) == len(keys)


def test_a_scene_that_is_replaced_has_the_length_of_its_segments(tmp_path):
    scene = sr.load_scene(write(tmp_path, WIDER))
    longer = dataclasses.replace(scene.segments[1], length=jnp.array(0.07))
    assert dataclasses.replace(scene, segments=(scene.segments[0], longer)).length == 0.13
    slope = jax.grad(lambda s: as_arrays(s).length)(scene)
    assert [x.length for x in slope.segments] == [1.0, 1.0] and slope.length == 0.0


def test_a_path_of_ones_own_has_no_form_in_a_file(tmp_path):
    class Bow(sr.scene.tendons.AbstractPath):
        height: float = 1e-3

        def place(self, s, start, end):
            x = (s - start) / (end - start)
            return jnp.stack([4 * self.height * x * (1 - x), 0 * x])

    tendons = sr.Tendons([[1e-3, 0.0]], paths=[Bow()])
    scene = dataclasses.replace(sr.hybrid_robot(), tendons=tendons)
    checked_scene("here", scene)
    with pytest.raises(sr.SceneError, match=r"tendons\[0\].path: a Bow has no form"):
        sr.save_scene(scene, tmp_path / "a.toml")
