"""The pages of the documentation: their snippets run in order, and print what they say."""

import json
import logging
import re
from pathlib import Path

import numpy as np
import pytest
from snippets import assert_prints, blocks, follow, write_files

import softrod_jax as sr
from calibration.cli import common

ROOT = Path(__file__).parents[2]
PAGES = ROOT / "docs" / "pages"
# How many blocks of each page run; no other page has code. A new page with code is added here.
RUN = {
    "analysis.md": 6,
    "calibration.md": 1,
    "command-line.md": 5,
    "contact.md": 2,
    "learning.md": 1,
    "logging.md": 1,
    "python.md": 2,
    "scene-file.md": 1,
    "see-and-touch.md": 1,
    "settings.md": 1,
    "tasks/catheter.md": 2,
    "tasks/closed-loop.md": 2,
    "tasks/design.md": 1,
    "tasks/fit-a-modulus.md": 1,
    "tasks/many-cores.md": 3,
    "tasks/tendon-robot.md": 2,
}


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """The current directory; JAX's cache stays as the tests have it."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(common, "prepare_jax", lambda: None)
    for command in ("solve", "simulate", "plot", "calibrate", "doctor", "modes"):
        monkeypatch.setattr(f"calibration.cli.{command}.prepare_jax", lambda: None)
    logger = logging.getLogger("softrod_jax")
    before = logger.level, list(logger.handlers)
    yield tmp_path
    logger.setLevel(before[0])
    logger.handlers[:] = before[1]


@pytest.mark.long
@pytest.mark.parametrize("page", RUN)
def test_snippets_print_what_the_page_says(page, folder):
    assert follow(PAGES / page, folder) == RUN[page]
    if page == "command-line.md":
        found = json.loads((folder / "fitted" / "parameters.json").read_text())["parameters"]
        for name, truth in (("young_modulus", 5e4), ("bending_damping", 1e-6)):
            (low, high), value = found[name]["ci95"], found[name]["value"]
            assert low < truth < high and abs(value / truth - 1) < 1e-3
            assert found[name]["identifiable"]


def test_no_page_has_code_that_is_not_run():
    with_code = {
        path.relative_to(PAGES).as_posix()
        for path in PAGES.glob("**/*.md")
        if blocks(path, "python")
    }
    assert with_code <= set(RUN), f"{with_code - set(RUN)}: run them, too, in RUN above"


def test_another_number_is_seen():
    written = "tip at [ 1.2345 -0.5] m,\nerror 3.2e-07\nand so on\ndone 7"
    assert_prints(written, "tip at [ 1.23 -0.5] m,\n...\ndone 7\n", "here")
    for wrong in ("tip at [ 1.25 -0.5] m,\n...", "...\ndone 8\n", "...\nerror 3.4e-07\n..."):
        with pytest.raises(AssertionError, match="here"):
            assert_prints(written, wrong, "here")
    with pytest.raises(AssertionError, match="here"):
        assert_prints(written, "tip at [ 1.23 -0.5] m,\n", "here")


def test_the_scene_file(folder):
    write_files(PAGES / "scene-file.md", folder)
    scene, paper = sr.load_scene("robot.toml"), sr.hybrid_robot()
    assert float(scene.payload.mass) == 2e-3
    for part in ("length", "young_modulus", "density", "bending_damping", "drag_coefficient"):
        assert float(getattr(scene, part)) == float(getattr(paper, part))
    np.testing.assert_allclose(scene.tendons.offsets, paper.tendons.offsets, atol=1e-7)
    np.testing.assert_allclose(scene.chambers.areas, paper.chambers.areas, rtol=1e-7)
    own = sr.load_scene("with-units.toml")
    for part in ("length", "young_modulus", "density"):
        assert float(getattr(own, part)) == pytest.approx(float(getattr(paper, part)), rel=1e-15)


def test_the_result_codes():
    text = (PAGES / "results.md").read_text("utf-8")
    rows = dict(re.findall(r"^\| (\d) \| `(\w+)` \|", text, re.MULTILINE))
    assert {int(code): name for code, name in rows.items()} == {r.value: r.name for r in sr.RESULTS}


def test_markers_of_the_benchmarks():
    """Each script that writes a table finds the place for it."""
    places = {}
    for page in PAGES.glob("*.md"):
        text = page.read_text("utf-8")
        for name in re.findall(r"<!-- (.*): begin -->", text):
            _, begin, rest = text.partition(f"<!-- {name}: begin -->\n")
            content, end, _ = rest.partition(f"\n<!-- {name}: end -->")
            assert begin and end and "| --- |" in content, name
            assert name not in places, f"{name} is in {places[name]} and {page.name}"
            places[name] = page.name
    for script in ROOT.glob("benchmarks/*.py"):
        for name, page in re.findall(
            r"(?:publish|put)\(\s*\"([^\"]+)\",\s*\"([^\"]+)\"", script.read_text("utf-8")
        ):
            assert places.pop(name) == page, script
    assert not places
