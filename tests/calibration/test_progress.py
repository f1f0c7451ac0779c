"""The bar of a fit in a notebook."""

from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
FIT = f"""
import sys
sys.path.insert(0, {str(ROOT)!r})
from types import SimpleNamespace
from calibration.search.progress import Bar

point = SimpleNamespace(ok=True, loss=1.0, rms=1e-3, x=[])
point.problem = SimpleNamespace(space=SimpleNamespace(parameters=SimpleNamespace(items=[])))
with Bar() as bar:
    bar.stage("search", 5)
    bar.show(point)
    bar.show(point)
"""


def test_a_notebook_shows_the_bar_as_a_widget():
    nbformat, nbclient = pytest.importorskip("nbformat"), pytest.importorskip("nbclient")
    pytest.importorskip("ipywidgets")
    notebook = nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell(FIT)])
    client = nbclient.NotebookClient(notebook, timeout=120)
    client.execute()
    kinds = [kind for output in notebook.cells[0].outputs for kind in output.get("data", {})]
    assert "application/vnd.jupyter.widget-view+json" in kinds
    # What the widget holds in the end is all that was done.
    (shown,) = [x for x in client.widget_state.values() if x.get("_model_name") == "OutputModel"]
    assert "2/2" in str(shown["outputs"]) and "rms 1 mm" in str(shown["outputs"])
