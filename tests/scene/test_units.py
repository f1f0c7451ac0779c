"""Numbers of scene files that are written with a unit."""

import builtins

import jax
import numpy as np
import pytest

import softrod_jax as sr
from softrod_jax.scene.units import in_unit

pytest.importorskip("pint")

SCENE = """
[rod]
length = {length}
section = {{ shape = "circle", radius = {radius} }}
young_modulus = {modulus}
poisson_ratio = 0.49
density = {density}
bending_damping = {damping}
gravity = {gravity}
[[tendons]]
path = {{ shape = "helix", radius = {offset}, angle = {angle}, turns = 1.0 }}
[[contacts]]
shape = "sphere"
center = {center}
radius = {radius}
stiffness = {push}
"""
PLAIN = dict(length=0.1, radius=6e-3, modulus=5e4, density=1070.0, damping=1e-6, offset=4e-3,
             gravity=[-9.81, 0.0, 0.0], angle=np.pi / 2, center=[0.0, 0.05, 0.1],
             push=2e4)  # fmt: skip
OWN = dict(
    length='"10 cm"',
    radius='"6mm"',
    modulus='"0.05 MPa"',
    density='"1.07 g/cm^3"',
    damping='"1e-3 mN m^2 s"',
    gravity='["-9.81 m/s^2", 0.0, "0 mm/s^2"]',
    offset='"4000 um"',
    angle='"90 deg"',
    center='[0, "5e-2 m", "1 dm"]',
    push='"20 N/m/mm"',
)


def loaded(tmp_path, **values):
    path = tmp_path / "scene.toml"
    path.write_text(SCENE.format(**values))
    return sr.load_scene(path)


def test_the_same_scene_in_other_units(tmp_path):
    plain, own = loaded(tmp_path, **PLAIN), loaded(tmp_path, **OWN)
    for a, b in zip(*map(jax.tree.leaves, (plain, own)), strict=True):
        np.testing.assert_allclose(a, b, rtol=4e-16)


@pytest.mark.parametrize(
    "value, words",
    [
        ('"10 kg"', "rod.length = '10 kg': kg is no unit of this: give one like m"),
        ('"10 cmm"', "rod.length = '10 cmm': there is no unit cmm: give one like m"),
        ('"10 cm; x"', "there is no unit cm; x"),
        ('"-10 cm"', "rod.length = -0.1: expected a number [m], above 0"),
        ('"0.1"', "rod.length = '0.1': expected a number [m], above 0"),
        ('"long"', "rod.length = 'long': expected a number [m], above 0"),
        ('["10 cm"]', "expected a number [m], above 0"),
        ('"10,5 cm"', "rod.length = '10,5 cm': expected a number [m]"),
    ],
)
def test_what_is_no_such_number_is_refused(tmp_path, value, words):
    with pytest.raises(sr.SceneError) as caught:
        loaded(tmp_path, **{**PLAIN, "length": value})
    assert words in str(caught.value) and "scene.toml" in str(caught.value)


def test_a_number_without_a_unit_takes_none():
    with pytest.raises(ValueError, match="has no one unit"):
        in_unit([[0.3, "50 ms"]], "")


def test_pint_is_asked_only_where_a_unit_is(tmp_path, monkeypatch):
    imported = builtins.__import__

    def without(name, *rest):
        if name == "pint":
            raise ImportError("No module named 'pint'")
        return imported(name, *rest)

    monkeypatch.setattr(builtins, "__import__", without)
    loaded(tmp_path, **PLAIN)
    with pytest.raises(sr.SceneError, match=r"pip install 'softrod_jax\[units\]'; or write the"):
        loaded(tmp_path, **{**PLAIN, "length": '"10 cm"'})
