"""What the package says of itself: its version, what it is, how to cite it."""

import ast
import re
import tomllib
from importlib.metadata import metadata, version
from pathlib import Path

import pytest

import softrod_jax as sr

ROOT = Path(__file__).parents[2]
PYPROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
PROJECT = PYPROJECT["project"]
DOI = "10.3390/act13010008"


def test_the_version_is_in_one_place():
    assert re.fullmatch(r"\d+\.\d+\.\d+", sr.__version__)
    assert version("softrod_jax") == sr.__version__
    assert PROJECT["dynamic"] == ["version"] and "version" not in PROJECT
    package, _, name = PYPROJECT["tool"]["setuptools"]["dynamic"]["version"]["attr"].partition(".")
    # setuptools reads a literal without importing the package, which JAX would be needed for.
    tree = ast.parse((ROOT / package / "__init__.py").read_text(encoding="utf-8"))
    (value,) = [n.value for n in tree.body if isinstance(n, ast.Assign) and n.targets[0].id == name]
    assert ast.literal_eval(value) == sr.__version__


def test_classifiers_are_those_of_the_index_and_agree_with_the_rest():
    classifiers = PROJECT["classifiers"]
    known = pytest.importorskip("trove_classifiers").classifiers
    assert set(classifiers) <= known
    assert not any(c.startswith("License ::") for c in classifiers)  # `license` says it


def test_oldest_python():
    least = PROJECT["requires-python"].removeprefix(">=")
    assert f"Programming Language :: Python :: {least}" in PROJECT["classifiers"]
    assert f"Python {least} or later" in (ROOT / "README.md").read_text(encoding="utf-8")


def test_urls_and_keywords():
    assert PROJECT["urls"] == {"Article": f"https://doi.org/{DOI}"}
    assert "Cosserat rod" in PROJECT["keywords"]
    assert metadata("softrod_jax")["Name"] == PROJECT["name"]


def test_the_citation_names_software_and_article():
    cited = pytest.importorskip("yaml").safe_load((ROOT / "CITATION.cff").read_text("utf-8"))
    assert cited["cff-version"] == "1.2.0" and cited["type"] == "software"
    assert cited["version"] == sr.__version__ and cited["license"] == PROJECT["license"]
    assert cited["title"].startswith(PROJECT["name"]) and cited["message"] and cited["authors"]
    (article,) = cited["references"]
    assert [author["family-names"] for author in article["authors"]] == [
        "Roshanfar",
        "Dargahi",
        "Hooshiar",
    ]
    assert (article["journal"], article["year"]) == ("Actuators", 2024)
    assert (article["volume"], article["issue"], article["start"]) == ("13", "1", "8")
    assert article["doi"] == DOI
    assert DOI in (ROOT / "README.md").read_text(encoding="utf-8")
