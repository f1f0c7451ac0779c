"""The README: its commands, code, links and names are those of the project."""

import json
import os
import re
import shlex
import subprocess
import sys
import tomllib
from pathlib import Path

import jax
import numpy as np
import pytest

import softrod_jax as sr

ROOT = Path(__file__).parents[2]
README = (ROOT / "README.md").read_text(encoding="utf-8")
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]


def blocks(language):
    """The fenced blocks of a language, in order."""
    return re.findall(rf"^```{language}\n(.*?)^```$", README, re.MULTILINE | re.DOTALL)


def test_the_two_commands():
    first, second = blocks("sh")[:2]
    for command in (first, second):
        assert command.count("\n") == 1
        assert command.startswith("python3 -m venv .venv && .venv/bin/pip install ")
    assert first.rstrip().endswith(".venv/bin/softrod calibrate")
    assert ".venv/bin/python -m pytest" in second
    for extra in re.findall(r"\[(\w+)\]\"", first + second):
        assert extra in PROJECT["optional-dependencies"]
    assert "softrod" in PROJECT["scripts"]


def test_ci_runs_the_second_command_as_it_stands():
    """`.ci/run` with a `bash` that prints what it was given instead of running it."""
    script = (ROOT / ".ci" / "run").read_text()
    *rest, last = script.rstrip().splitlines()
    assert last == 'bash -euo pipefail -c "$command"'
    dry = "\n".join(rest).replace("${BASH_SOURCE[0]}", str(ROOT / ".ci" / "run"))
    done = subprocess.run(["bash", "-c", dry], capture_output=True, text=True, check=True)
    assert done.stdout == f"+ {blocks('sh')[1]}"
    assert os.access(ROOT / ".ci" / "run", os.X_OK)


def test_links_to_files_and_headings():
    headings = re.findall(r"^#+ (.*)$", README, re.MULTILINE)
    anchors = {"#" + re.sub(r"[^\w -]", "", h).lower().replace(" ", "-") for h in headings}
    targets = re.findall(r"\]\(([^)\s]+)\)", README)
    targets += re.findall(r'src="([^"]+)"', README)
    assert len(targets) > 5
    for target in targets:
        if not target.startswith("https://"):
            assert target in anchors or (ROOT / target).exists(), target


def test_markers_of_the_benchmarks():
    for name in re.findall(r"<!-- (.*): begin -->", README):
        _, begin, rest = README.partition(f"<!-- {name}: begin -->\n")
        content, end, _ = rest.partition(f"\n<!-- {name}: end -->")
        assert begin and end and content.startswith("| "), name


def test_the_result_codes():
    rows = dict(re.findall(r"^\| (\d) \| `(\w+)` \|", README, re.MULTILINE))
    assert {int(code): name for code, name in rows.items()} == {r.value: r.name for r in sr.RESULTS}


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A directory that holds the README's scene file, and is the current one."""
    monkeypatch.chdir(tmp_path)
    (scene,) = blocks("toml")
    (tmp_path / "robot.toml").write_text(scene, encoding="utf-8")
    return tmp_path


def test_the_scene_file(folder):
    scene, paper = sr.load_scene("robot.toml"), sr.hybrid_robot()
    assert float(scene.payload.mass) == 2e-3
    for part in ("length", "young_modulus", "density", "bending_damping", "drag_coefficient"):
        assert float(getattr(scene, part)) == float(getattr(paper, part))
    np.testing.assert_allclose(scene.tendons.offsets, paper.tendons.offsets, atol=1e-7)
    np.testing.assert_allclose(scene.chambers.areas, paper.chambers.areas, rtol=1e-7)


@pytest.mark.long
def test_the_code_and_the_commands(folder):
    """In the order of the page: what one writes, the next may read."""
    commands = {c.split()[1]: shlex.split(c) for c in blocks("sh")[2].splitlines()}
    environment = {**os.environ, "JAX_COMPILATION_CACHE_DIR": jax.config.jax_compilation_cache_dir}

    def run(*line):
        done = subprocess.run(
            [sys.executable, *line], env=environment, capture_output=True, text=True
        )
        assert done.returncode == 0, done.stderr
        return done.stdout

    def softrod(name):
        return run("-m", "calibration.cli", *commands.pop(name)[1:])

    assert json.loads(softrod("solve"))["result"] == "successful"
    softrod("simulate")
    softrod("plot")
    softrod("calibrate")
    found = json.loads((folder / "fitted" / "parameters.json").read_text())["parameters"]
    for name, truth in (("young_modulus", 5e4), ("bending_damping", 1e-6)):
        (low, high), value = found[name]["ci95"], found[name]["value"]
        assert low < truth < high and abs(value / truth - 1) < 1e-3
        assert found[name]["identifiable"]
    softrod("doctor")
    assert not commands
    run("-c", "".join(blocks("python")))
