"""Data flows one way: no file or room imports in a circle, also not when it is used."""

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parents[1] / "docs"))

from reference import between_rooms, imports_of, in_order, sources  # noqa: E402


@pytest.mark.parametrize("package", ["softrod_jax", "calibration"])
def test_files_and_rooms_import_in_no_circle(package):
    trees = sources(package)
    imports = {name: imports_of(package, tree, trees) for name, tree in trees.items()}
    assert len(imports) > 30
    in_order(imports)
    in_order(between_rooms(imports))


def test_the_rod_does_not_know_its_calibration():
    trees, others = sources("softrod_jax"), sources("calibration")
    assert not any(imports_of("calibration", tree, others) for tree in trees.values())


def test_an_import_inside_a_function_is_seen():
    import ast

    tree = ast.parse("def f():\n    from calibration.data import dates\n")
    assert imports_of("calibration", tree, {"data.dates": tree}) == {"data.dates"}
