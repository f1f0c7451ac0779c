"""Data flows one way: no file or room imports in a circle, also not when it is used."""

import ast
import sys
from graphlib import CycleError
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parents[2] / "docs"))

from reference import between_rooms, imported, imports_of, in_order, sources  # noqa: E402


@pytest.mark.parametrize("package", ["softrod_jax", "calibration"])
def test_files_and_rooms_import_in_no_circle(package):
    trees = sources(package)
    imports = {name: imports_of(package, tree, trees) for name, tree in trees.items()}
    assert len(imports) > 30 and sum(map(len, imports.values())) > 60
    in_order(imports)
    in_order(between_rooms(imports))


def test_the_rod_does_not_know_its_calibration():
    found = {module for tree in sources("softrod_jax").values() for module, _ in imported(tree)}
    assert "equinox" in found
    assert not [module for module in found if module.split(".")[0] == "calibration"]


@pytest.mark.parametrize(
    "line",
    [
        "from calibration.data import dates",
        "from calibration.data.dates import parse",
        "import calibration.data.dates",
    ],
)
def test_an_import_inside_a_function_is_seen(line):
    tree = ast.parse(f"def f():\n    {line}\n")
    assert imports_of("calibration", tree, {"data.dates": tree}) == {"data.dates"}


def test_circles_are_seen():
    circle = {"a.x": {"b.y"}, "b.y": set(), "b.z": {"a.x"}}
    in_order(circle)
    with pytest.raises(CycleError):
        in_order(between_rooms(circle))


@pytest.mark.parametrize("package", ["softrod_jax", "calibration"])
def test_classes_are_abstract_or_final(package):
    """A class from which others derive says so in its name."""
    classes = {
        node.name: [ast.unparse(base).split("[")[0].split(".")[-1] for base in node.bases]
        for tree in sources(package).values()
        for node in ast.walk(tree)
        if isinstance(node, ast.ClassDef)
    }
    assert len(classes) > 30
    derived = {name: [b for b in bases if b in classes] for name, bases in classes.items()}
    for name, bases in derived.items():
        assert all(base.startswith("Abstract") for base in bases), (name, bases)
