"""Types: annotations hold at every call, and type checkers and linters find nothing.

That annotations hold is asked by all tests, through `conftest.py`; here, that they are asked.
"""

import os
import subprocess
import sys
from importlib import resources
from pathlib import Path

import jax.numpy as jnp
import jaxtyping
import numpy as np
import pytest
from snippets import blocks

import softrod_jax as sr
from softrod_jax.rod.rotations import quaternion_exp

ROOT = Path(__file__).parents[2]


def found(*command):
    """What a command says, run where the project is; empty if it finds nothing."""
    environment = {**os.environ, "PYRIGHT_PYTHON_IGNORE_WARNINGS": "1"}
    done = subprocess.run(
        [sys.executable, "-m", *command], cwd=ROOT, env=environment, capture_output=True, text=True
    )
    return "" if done.returncode == 0 else done.stdout + done.stderr


def test_pyright_finds_nothing_in_the_packages_and_the_pages(tmp_path):
    """Nor in the snippets of each page, one after the other."""
    pytest.importorskip("pyright")
    for page in (ROOT / "README.md", *ROOT.glob("docs/pages/**/*.md")):
        if code := [block.text for block in blocks(page, "python")]:
            name = page.relative_to(ROOT).with_suffix(".py").as_posix().replace("/", "_")
            (tmp_path / name).write_text("\n".join(code), encoding="utf-8")
    assert len(list(tmp_path.iterdir())) > 5
    checked = ("softrod_jax", "calibration", str(tmp_path))
    assert found("pyright", "--pythonpath", sys.executable, *checked) == ""


def test_pyright_knows_the_types_of_the_packages(tmp_path):
    """Plain numbers are welcome; what is no number is not."""
    pytest.importorskip("pyright")
    wrong = tmp_path / "wrong.py"
    wrong.write_text(
        "import softrod_jax as sr\n"
        "good = sr.Scene(length=0.5, gravity=[0, 0.0, 9.81], section=sr.Circle(1e-3))\n"
        "sr.solve_static(good, tensions=(0.1, 0.0, 0.0)).tip_position.shape\n"
        'bad = sr.Scene(length="long")\n'
        "sr.solve_static(good, tensions=0.1)\n",
        encoding="utf-8",
    )
    errors = found("pyright", "--pythonpath", sys.executable, str(wrong))
    lines = [line.split(" - ")[0] for line in errors.splitlines() if " - error: " in line]
    assert [int(line.rsplit(":", 2)[1]) for line in lines] == [4, 5], errors


def test_ruff_finds_nothing():
    assert found("ruff", "check", ".") == ""
    assert found("ruff", "format", "--check", ".") == ""


@pytest.mark.parametrize("package", ["softrod_jax", "calibration"])
def test_packages_say_that_they_have_types(package):
    assert resources.files(package).joinpath("py.typed").is_file()


@pytest.mark.parametrize(
    "call",
    [
        lambda: sr.Circle("wide"),
        lambda: sr.Scene(gravity=jnp.zeros(2)),
        lambda: quaternion_exp(jnp.zeros(4)),
        lambda: quaternion_exp(np.zeros(3)),
    ],
)
def test_annotations_are_checked(call):
    with pytest.raises(jaxtyping.TypeCheckError):
        call()


def test_plain_numbers_are_numbers():
    section = sr.Rectangle(width=1, height=np.float64(2e-3))
    stiffness = sr.Stiffness([1e-4, 1e-4], torsion=np.array(1e-4))
    scene = sr.Scene(0.1, section, gravity=(0, 0, 9.81), bending_damping=[1e-6] * 3)
    assert scene.length == 0.1 and stiffness.bending == [1e-4, 1e-4]
    sr.Tendons([[4e-3, 0.0]], starts_at=[0.02], guided=["disks"])
