"""Laws, silicones and relaxation in scene files."""

import dataclasses

import pytest
from test_scene_file import assert_same, write
from test_scene_language import OF_ONE, UNIFORM, WIDER

import softrod_jax as sr
from softrod_jax.scene.checks import checked_scene, parts_of

RUBBER = WIDER.replace("young_modulus = 8.0e4\npoisson_ratio = 0.45\n", "MATERIAL\n").replace(
    "MATERIAL", 'material = { law = "mooney_rivlin", c1 = 6e3, c2 = 0.0 }'
)


def test_materials(tmp_path):
    """A segment has the rod's, or moduli or stiffness instead; or a law of its own."""
    third = '[[segments]]\nlength = 1e-4\nsection = { shape = "circle", radius = 5e-3 }\n'
    law = 'material = { law = "neo_hookean", mu = 3e4 }\n'
    scene = sr.load_scene(write(tmp_path, RUBBER + third + third + law))
    assert isinstance(scene.material, sr.MooneyRivlin) and scene.material.c1 == 6e3
    first, second, *others = scene.parts
    assert first.material is None and first.young_modulus == 2e5
    assert second.material is None and second.stiffness.torsion == 1e-5
    assert others[0].material is scene.material and others[0].young_modulus is None
    assert isinstance(others[1].material, sr.NeoHookean) and others[1].material.mu == 3e4
    keys = [part.key for part in parts_of(scene)]
    assert "rod.material.c2" in keys and "segments[3].material.mu" in keys
    sr.save_scene(scene, tmp_path / "a.toml")
    assert_same(scene, sr.load_scene(tmp_path / "a.toml"))
    # The linear law may be named; a segment of rubber does not ask for the moduli of the rod.
    linear = UNIFORM + 'material = { law = "linear" }\n'
    assert_same(sr.load_scene(write(tmp_path, linear)), sr.load_scene(write(tmp_path, UNIFORM)))
    scene = sr.load_scene(write(tmp_path, WIDER + third + law))
    assert scene.parts[0].material is None and scene.parts[2].young_modulus is None


def test_silicones_have_names(tmp_path):
    """A name is a law, and a density where the scene has none; a file keeps the numbers."""
    known = sr.silicone("ecoflex-00-50")
    named = OF_ONE.replace("1070.0", "1050.0") + 'material = "ecoflex-00-50"\n'
    bare = "\n".join(x for x in named.splitlines() if not x.startswith("density"))
    assert bare != named.strip()
    for text, density in ((named, 1050.0), (bare, known.density)):
        scene = sr.load_scene(write(tmp_path, text))
        assert isinstance(scene.material, sr.NeoHookean)
        assert scene.material.mu == known.law.mu and scene.density == density
        sr.save_scene(scene, tmp_path / "a.toml")
        assert_same(scene, sr.load_scene(tmp_path / "a.toml"))
    part = '[[segments]]\nlength = 0.1\nsection = { shape = "circle", radius = 5e-3 }\n'
    both = "[rod]\n" + "".join(part + f'material = "dragon-skin-{n}"\n' for n in (10, 20))
    first, second = sr.load_scene(write(tmp_path, both)).parts
    assert (first.density, second.density) == (1070.0, 1080.0)
    assert first.material.mu < second.material.mu
    with pytest.raises(ValueError, match='did you mean "dragon-skin-10"'):
        sr.silicone("dragon-skin10")


@pytest.mark.parametrize(
    "text, expected",
    [
        (OF_ONE + "material = 3", ["rod.material = 3", "expected { law = .. }", "ecoflex-00-50"]),
        (
            OF_ONE + 'material = "ecoflex-50"',
            ["rod.material = 'ecoflex-50'", 'did you mean "ecoflex-00-50"?', "a table with a law"],
        ),
        (OF_ONE + "material = { mu = 1 }", ["rod.material.law is missing", "neo_hookean"]),
        (OF_ONE + 'material = { law = "ogden" }', ["material.law = 'ogden'", '"linear"']),
        (OF_ONE + 'material = { law = "neo_hookean" }', ["material.mu is missing", "[Pa]"]),
        (
            OF_ONE + 'material = { law = "neo_hookean", mu = 0.0 }',
            ["rod.material.mu = 0.0", "[Pa], above 0"],
        ),
        (
            OF_ONE + 'material = { law = "mooney_rivlin", c1 = 1.0, c2 = -1.0 }',
            ["rod.material.c2 = -1.0", "at least 0"],
        ),
        (
            OF_ONE + 'material = { law = "linear", c1 = 1.0 }',
            ["rod.material.c1 = 1.0", "unknown key"],
        ),
        (
            UNIFORM + 'material = { law = "neo_hookean", mu = 1e4 }',
            ["rod.young_modulus = 50000.0", "material stands for it"],
        ),
        (
            OF_ONE.replace(
                'shape = "circle", radius = 6e-3',
                'shape = "general", area = 1e-4, second_moments = [1e-9, 1e-9],'
                " torsion_constant = 1e-9",
            )
            + 'material = { law = "neo_hookean", mu = 1e4 }',
            ["rod.section = 'general'", "another shape"],
        ),
        (
            RUBBER.replace("young_modulus = 2.0e5\n", ""),
            ["segments[0].poisson_ratio = 0.49", "rod.material stands for it"],
        ),
        (
            RUBBER.replace("intervals = 6", 'material = { law = "linear" }').replace(
                "young_modulus = 2.0e5\npoisson_ratio = 0.49\n", ""
            ),
            ["segments[0].material.law = 'linear'", "give young_modulus"],
        ),
    ],
)
def test_materials_that_cannot_be(tmp_path, text, expected):
    with pytest.raises(sr.SceneError) as error:
        sr.load_scene(write(tmp_path, text))
    assert all(x in str(error.value) for x in expected), error.value


def test_relaxation(tmp_path):
    line = "relaxation = [[0.3, 0.05], [0.2, 1.0]]\n"
    own = WIDER.replace("intervals = 6", "relaxation = [[0.25, 2.0]]")
    scene = sr.load_scene(write(tmp_path, own.replace("[rod]\n", f"[rod]\n{line}")))
    assert scene.relaxation.tolist() == [[0.3, 0.05], [0.2, 1.0]]
    assert scene.parts[0].relaxation.tolist() == [[0.25, 2.0]]
    assert scene.parts[1].relaxation is scene.relaxation
    sr.save_scene(scene, tmp_path / "a.toml")
    assert_same(scene, sr.load_scene(tmp_path / "a.toml"))


@pytest.mark.parametrize(
    "value, expected",
    [
        ("0.3", "1 or more lists of 2 numbers each"),
        ("[0.3, 0.05]", "1 or more lists of 2 numbers each"),
        ("[]", "1 or more lists of 2 numbers each"),
        ("[[0.3]]", "1 or more lists of 2 numbers each"),
        ("[[0.3, 0.0]]", "above 0"),
        ("[[-0.3, 1.0]]", "above 0"),
        ("[[0.4, 1.0], [0.6, 2.0]]", "whose sum is below 1"),
    ],
)
def test_relaxation_that_cannot_be(tmp_path, value, expected):
    with pytest.raises(sr.SceneError, match="rod.relaxation = .*" + expected):
        sr.load_scene(write(tmp_path, UNIFORM + f"relaxation = {value}\n"))


def test_a_law_of_ones_own_is_that_of_the_whole_rod():
    class Springs(sr.AbstractEnergy):
        def density(self, v, u, s):
            return u @ u + v @ v

    segment = sr.Segment(length=0.1, section=sr.Circle(1e-2), material=Springs())
    with pytest.raises(ValueError, match=r"segments\[0\].material = Springs: .* whole rod"):
        checked_scene("here", sr.Scene(segments=(segment,), density=1e3))
    rubber = dataclasses.replace(segment, material=sr.NeoHookean(1e4))
    with pytest.raises(ValueError, match=r"segments\[0\].material = NeoHookean: .* leave one out"):
        checked_scene("here", sr.Scene(segments=(rubber,), density=1e3, material=Springs()))
    soft = dataclasses.replace(segment, material=None, relaxation=[[0.1, 1.0]])
    with pytest.raises(ValueError, match=r"segments\[0\].relaxation = .* relaxes as a whole"):
        checked_scene("here", sr.Scene(segments=(soft,), density=1e3, material=Springs()))
