"""The README: short, and its commands, code, links and numbers are those of the project."""

import os
import re
import subprocess
import tomllib
from pathlib import Path

import pytest
from snippets import assert_prints, blocks, commands, follow

import calibration.cli.main
from calibration.cli import calibrate

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "README.md"
README = PAGE.read_text(encoding="utf-8")
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]


def test_it_is_a_front_door():
    """A reader has it in five minutes, and sees a robot before a command."""
    assert len(README.split()) <= 900 and len(README.encode()) <= 10_000
    picture, command = README.index("<img "), README.index("```sh")
    assert picture < command and README.index(".gif") < command


def test_the_two_commands():
    first, second = (block.text for block in blocks(PAGE, "sh")[:2])
    for command in (first, second):
        assert command.count("\n") == 1
        assert command.startswith("python3 -m venv .venv && .venv/bin/pip install ")
    assert first.rstrip().endswith(".venv/bin/softrod calibrate")
    assert ".venv/bin/python -m pytest" in second
    for extra in re.findall(r"\[(\w+)\]\"", first + second):
        assert extra in PROJECT["optional-dependencies"]
    assert "softrod" in PROJECT["scripts"]
    assert "git clone" in README[: README.index("```sh")]
    assert "source .venv/bin/activate" in README[README.index(second) :]


def test_ci_runs_the_second_command_as_it_stands():
    """`.ci/run` with a `bash` that prints what it was given instead of running it."""
    script = (ROOT / ".ci" / "run").read_text()
    *rest, last = script.rstrip().splitlines()
    (fetch,) = [line for line in rest if line.startswith("browser >")]
    rest.remove(fetch)
    assert last == 'bash -euo pipefail -c "$command"'
    dry = "\n".join(rest).replace("${BASH_SOURCE[0]}", str(ROOT / ".ci" / "run"))
    done = subprocess.run(["bash", "-c", dry], capture_output=True, text=True, check=True)
    assert done.stdout == f"+ {blocks(PAGE, 'sh')[1].text}"
    assert os.access(ROOT / ".ci" / "run", os.X_OK)


def test_links_to_files_and_headings():
    headings = re.findall(r"^#+ (.*)$", README, re.MULTILINE)
    anchors = {"#" + re.sub(r"[^\w -]", "", h).lower().replace(" ", "-") for h in headings}
    targets = re.findall(r"\]\(([^)\s]+)\)", README)
    targets += re.findall(r'src="([^"]+)"', README)
    assert len(targets) > 20
    for target in targets:
        if not target.startswith("https://"):
            # Anchors of pages are checked in the built site.
            assert target in anchors or (ROOT / target.partition("#")[0]).exists(), target


def test_the_code_prints_what_it_says(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert follow(PAGE, tmp_path) == 1


@pytest.mark.long
def test_the_first_command_ends_in_the_table(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(calibrate, "prepare_jax", lambda: None)
    assert calibration.cli.main.main(commands(blocks(PAGE, "sh")[0])[0].split()[-1:]) == 0
    (table,) = [b.text for b in blocks(PAGE, "text") if b.text.startswith("parameter")]
    assert_prints(capsys.readouterr().out, f"...\n{table}...\n", "README.md")
    assert "<html" in (tmp_path / "softrod-calibration" / "report.html").read_text("utf-8")
