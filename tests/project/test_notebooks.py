"""The notebooks run from top to bottom, and are committed with their outputs."""

import os
from importlib.util import find_spec
from pathlib import Path

import jax
import pytest

nbformat = pytest.importorskip("nbformat")
nbclient = pytest.importorskip("nbclient")

NOTEBOOKS = sorted((Path(__file__).parents[2] / "notebooks").glob("*.ipynb"))
# Recordings of others, which are not in this project.
RECORDED = {"13_tentacle": "tentacle/postures.csv", "14_segment": "segment/300mbar_V3.c3d"}
DATA = Path(os.environ.get("SOFTROD_DATA", Path(__file__).parents[3] / "shared" / "data"))
# What is not among the extras that tests have, and the extra that brings it.
FURTHER = {"16_reach": (("skrl", "flax"), "ppo")}
# They run a program hundreds of times or ten thousand of its samples: LLVM's optimisations pay.
OFTEN = "04_calibrate", "05_ten_thousand_actuations", "07_learning", "12_catheter", "16_reach"


def read(path):
    return nbformat.read(path, as_version=4)


def test_there_are_notebooks():
    assert NOTEBOOKS


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_committed_with_outputs(path):
    cells = [cell for cell in read(path).cells if cell.cell_type == "code"]
    assert [cell.execution_count for cell in cells] == list(range(1, len(cells) + 1))
    outputs = [output for cell in cells for output in cell.outputs]
    assert all(output.output_type != "error" for output in outputs)
    assert any("image/png" in output.get("data", {}) for output in outputs)


@pytest.mark.long
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_runs(path, monkeypatch):
    needed = RECORDED.get(path.stem)
    if needed is not None and not (DATA / needed).exists():
        pytest.skip(f"the recording {needed} is not here (shared/data, or SOFTROD_DATA)")
    packages, extra = FURTHER.get(path.stem, ((), ""))
    if not all(find_spec(package) for package in packages):
        pytest.skip(f"needs {' and '.join(packages)}: pip install 'softrod_jax[{extra}]'")
    monkeypatch.setenv("SOFTROD_DATA", str(DATA.resolve()))
    # Notebooks share programs with each other.
    monkeypatch.setenv("JAX_COMPILATION_CACHE_DIR", jax.config.jax_compilation_cache_dir)
    if path.stem in OFTEN:
        flags = os.environ.get("XLA_FLAGS", "").replace("--xla_backend_optimization_level=0", "")
        monkeypatch.setenv("XLA_FLAGS", flags.strip())
    nbclient.NotebookClient(read(path), timeout=1200, kernel_name="python3").execute()
