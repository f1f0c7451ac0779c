"""The notebooks run from top to bottom, and are committed with their outputs.

All of them take as long as a sixth of all tests. At each commit a third of them run, by turns; with
`NOTEBOOKS=all` in the environment, all do.
"""

import os
import subprocess
from pathlib import Path

import jax
import pytest

nbformat = pytest.importorskip("nbformat")
nbclient = pytest.importorskip("nbclient")

NOTEBOOKS = sorted((Path(__file__).parents[2] / "notebooks").glob("*.ipynb"))
# They run a program hundreds of times or ten thousand of its samples: LLVM's optimisations pay.
OFTEN = "04_calibrate", "05_ten_thousand_actuations", "07_learning", "12_catheter"


TURNS = 3


def turn():
    """Whose turn it is at this commit, below `TURNS`; `None`, all, where there is no git."""
    if os.environ.get("NOTEBOOKS") == "all":
        return None
    asked = ["git", "rev-parse", "HEAD"]
    try:
        found = subprocess.run(asked, cwd=NOTEBOOKS[0].parent, capture_output=True, text=True)
    except OSError:
        return None
    return None if found.returncode else int(found.stdout[:8], 16) % TURNS


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
    now = turn()
    if now is not None and NOTEBOOKS.index(path) % TURNS != now:
        pytest.skip("its turn is at another commit; NOTEBOOKS=all runs it")
    # Notebooks share programs with each other.
    monkeypatch.setenv("JAX_COMPILATION_CACHE_DIR", jax.config.jax_compilation_cache_dir)
    if path.stem in OFTEN:
        flags = os.environ.get("XLA_FLAGS", "").replace("--xla_backend_optimization_level=0", "")
        monkeypatch.setenv("XLA_FLAGS", flags.strip())
    nbclient.NotebookClient(read(path), timeout=1200, kernel_name="python3").execute()
