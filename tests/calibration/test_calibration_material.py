"""Constants of materials as parameters of motions: relaxation, rubber, segments of their own."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from beams import FIT, NOISE, TRUTH, beam, release

import softrod_jax as sr
from calibration import calibrate, write_log
from calibration.cli.main import main
from calibration.parameters.catalogue import choose
from calibration.parameters.materials import MATERIALS
from softrod_jax.scene.silicones import SILICONES

ALL = (0.0, 1.0)
QUIET = {"checks": False, "window": ALL, "progress": False, **FIT}
# A beam that loses its swing by creeping, and hardly by a viscous damping.
E, G, TAU = 2.9e5, 0.3, 0.04
PLAIN = dict(young_modulus=E, bending_damping=1e-6)


def holds(found, truth):
    for name, value in truth.items():
        estimate = found.parameters[name]
        low, high = estimate.ci95
        assert estimate.identifiable and low < value < high, (name, estimate)


def test_creep_of_a_beam_is_told():
    """The part of the stiffness that relaxes and the time it takes, by name and by path."""
    recording = release(beam(**PLAIN, relaxation=[[G, TAU]]))
    start = beam(**(PLAIN | {"young_modulus": 2.5e5}), relaxation=[[0.15, 0.1]])
    names = ("young_modulus", "relaxation_part_1", "relaxation_time_1")
    assert choose(start, ("young_modulus", "relaxation_part", "relaxation_time")) == names
    found = calibrate(start, [recording], fit=names, **QUIET)
    holds(found, dict(zip(names, (E, G, TAU))))
    np.testing.assert_allclose(found.rmse_m["release"], NOISE * np.sqrt(3), rtol=0.15)
    np.testing.assert_allclose(found.scene.relaxation, [[G, TAU]], rtol=0.2)
    assert [found.parameters[name].unit for name in names] == ["Pa", "1", "s"]
    paths = ("rod.young_modulus", "relaxation[0][0]", "relaxation[0][1]")
    same = calibrate(start, [recording], fit=paths, **QUIET)
    for name, path in zip(names, paths):
        low, high = found.parameters[name].ci95
        apart = same.parameters[path].value - found.parameters[name].value
        assert abs(apart) < 0.01 * (high - low)


@pytest.mark.long
def test_what_relaxes_explains_residuals():
    recording = release(beam(**PLAIN, relaxation=[[G, TAU]]))
    start = beam(**(PLAIN | {"young_modulus": 2.5e5}), relaxation=[[0.1, TAU]])
    found = calibrate(start, [recording], fit="young_modulus", explain=True, **QUIET)
    rms = {e.name: e.rms for e in found.explanations}
    assert {"relaxation_part", "relaxation_time"} <= set(rms)
    assert rms["relaxation_part"] < 0.5 * found.rmse_m["release"]


@pytest.mark.long
def test_constants_of_rubber():
    law = lambda c1, c2: beam(young_modulus=None, material=sr.MooneyRivlin(c1, c2))
    plain = lambda c1, c2: replace(law(c1, c2), poisson_ratio=None)
    recording = release(plain(4e4, 8e3))
    start = plain(3e4, 8e3)
    assert choose(start, ("material_c1", "material_c2")) == ("material_c1", "material_c2")
    names = ("material.c1", "bending_damping")
    found = calibrate(start, [recording], fit=names, explain=True, **QUIET)
    holds(found, {"material.c1": 4e4, "bending_damping": TRUTH["bending_damping"]})
    assert found.parameters["material.c1"].unit == "Pa"
    assert "material_c2" in {e.name for e in found.explanations}


def test_of_a_rubber_its_modulus_is_fitted_unless_something_else_is_named():
    """At small strain all constants together, in the proportion that they have."""
    law = lambda c1, c2: replace(
        beam(young_modulus=None, material=sr.MooneyRivlin(c1, c2)), poisson_ratio=None
    )
    start = law(3e4, 6e3)
    assert choose(start, None) == ("young_modulus", "bending_damping")
    found = calibrate(start, [release(law(4e4, 8e3))], **QUIET)
    holds(found, {"young_modulus": 6 * 4.8e4, "bending_damping": TRUTH["bending_damping"]})
    assert found.parameters["young_modulus"].initial == 6 * 3.6e4
    c1, c2 = found.scene.material.constants
    assert float(c1 / c2) == pytest.approx(5.0)
    assert float(c1 + c2) == pytest.approx(found.parameters["young_modulus"].value / 6)
    with pytest.raises(ValueError, match="'material_c2' one of them"):
        choose(start, ("young_modulus", "material_c2"))
    silicone = replace(start, material=sr.NeoHookean(2e4))
    assert choose(silicone, None) == ("young_modulus", "bending_damping")
    assert choose(segmented(E, E), None) == ("bending_damping",)


def segmented(*moduli):
    parts = [
        sr.Segment(length=0.05, section=sr.Rectangle(0.03, 0.03), young_modulus=E) for E in moduli
    ]
    scene = replace(beam(young_modulus=None), length=None, section=None)
    return replace(scene, segments=tuple(parts))


def test_a_segment_of_a_motion_by_its_path():
    recording = release(segmented(4e5, 2e5))
    path = "segments[0].young_modulus"
    options = dict(QUIET, fit=(path,), bounds={path: (1e5, 1e6)})
    found = calibrate(segmented(2.5e5, 2e5), [recording], profiles=(path,), **options)
    holds(found, {path: 4e5})
    assert [float(s.young_modulus) for s in found.scene.segments][1] == 2e5


def test_the_command_line_takes_paths(tmp_path, capsys):
    recording = release(segmented(4e5, 2e5))
    scene, log = tmp_path / "rod.toml", tmp_path / "log.csv"
    sr.save_scene(segmented(2.5e5, 2e5), scene)
    write_log(log, recording.times, tip_positions=recording.tip_positions)
    path = "segments[0].young_modulus"
    call = ["calibrate", str(scene), str(log), "--fit", path, "--out", str(tmp_path / "out")]
    assert main([*call, "--no-checks", "--dt", "0.01", "--intervals", "2"]) == 0
    assert path in capsys.readouterr().out
    assert main([*call[:3], "--fit", "segments[4].density", *call[5:]]) == 2
    assert "there are 2, counted from 0" in capsys.readouterr().err


def test_silicones_are_within_their_ranges():
    """What a name stands for does not make a report warn of it."""
    for name, (law, density) in SILICONES.items():
        low, high = MATERIALS[name].young_modulus
        assert low < float(law.young_modulus) < high, name
        low, high = MATERIALS[name].density
        assert low < density < high, name


def test_the_page_has_the_numbers_of_the_package():
    page = (Path(__file__).parents[2] / "docs" / "pages" / "materials.md").read_text("utf-8")
    for name, (law, density) in SILICONES.items():
        row = f"| `{name}` | {law.mu / 1e3:.1f} | {law.young_modulus / 1e3:.1f} | {density:.0f} |"
        assert row in page
