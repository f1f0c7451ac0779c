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


def test_draws_them(tmp_path, capsys):
    """Lines swing to both sides of the rod as far as is said, in the plane of the mode."""
    pictures = pytest.importorskip("softrod_jax.pictures")
    (tmp_path / "rod.toml").write_text(ROD)
    arguments = ["plot", "rod.toml", "--intervals", "16", "--modes"]
    assert main([*arguments, "2", "--out", "modes.png"]) == 0
    assert (tmp_path / "modes.png").read_bytes().startswith(b"\x89PNG")
    scene = sr.load_scene(tmp_path / "rod.toml")
    found = sr.modes(scene, count=2, method=sr.Collocation(16))
    figure = pictures.modes_picture(scene, found)
    assert len(figure.axes) == 2 and f"{found.frequencies[1]:.3g} Hz" in figure.axes[1].get_title()
    for axes in figure.axes:
        lines = [np.array(line.get_data_3d()) for line in axes.lines if line.get_lw() == 0.7]
        ends = np.array([line[:, -1] for line in lines])
        # In millimetres; the strongest line is apart.
        np.testing.assert_allclose(ends[:, 0].min(), -0.12 * 300, rtol=1e-3)
        np.testing.assert_allclose(ends[:, 1], 0, atol=1e-9)
    assert main([*arguments, "0"]) == 2
    (tmp_path / "log.csv").write_text("time_s\n0\n1\n")
    assert main(["plot", "rod.toml", "log.csv", "--modes", "2"]) == 2
    assert "--modes: for a scene without a log only" in capsys.readouterr().err
