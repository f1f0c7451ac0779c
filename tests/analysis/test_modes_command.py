"""`softrod modes` says what `modes` does."""

import json

import numpy as np
import pytest
from command_line import in_a_directory_of_its_own  # noqa: F401

import softrod_jax as sr
from calibration.cli.main import main

ROD = """
[rod]
length = 0.3
section = { shape = "circle", radius = 4e-3 }
young_modulus = 1.0e6
poisson_ratio = 0.45
density = 1000.0
bending_damping = 2e-6
inextensible = true
plane = "xz"
"""


def test_lists_them(tmp_path, capsys):
    (tmp_path / "rod.toml").write_text(ROD)
    arguments = ["modes", "rod.toml", "--count", "3", "--intervals", "16"]
    assert main([*arguments, "--json"]) == 0
    rows = json.loads(capsys.readouterr().out)["modes"]
    scene = sr.load_scene(tmp_path / "rod.toml")
    expected = sr.modes(scene, count=3, method=sr.Collocation(16))
    frequencies = [row["frequency_Hz"] for row in rows]
    np.testing.assert_allclose(frequencies, expected.frequencies, rtol=1e-9)
    np.testing.assert_allclose([r["damping_ratio"] for r in rows], expected.damping_ratios)
    assert [row["along"] for row in rows] == ["x"] * 3
    assert main(arguments) == 0
    shown = capsys.readouterr().out.splitlines()
    assert len(shown) == 4 and f"{frequencies[0]:.6g}" in shown[1]


@pytest.mark.parametrize("count", ["0", "1.5"])
def test_refuses_a_count_that_is_none(count, tmp_path, capsys):
    (tmp_path / "rod.toml").write_text(ROD)
    assert main(["modes", "rod.toml", "--count", count]) == 2
    assert "a whole number from 1" in capsys.readouterr().err
