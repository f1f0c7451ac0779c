"""The tabulator key, asked of the shells themselves."""

# ruff: noqa: F811 - pytest knows fixtures by their names

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from command_line import in_a_directory_of_its_own, run  # noqa: F401

pytest.importorskip("argcomplete")
ROOT = Path(__file__).parents[3]
# What stands on the line, and what the last word becomes.
LINES = [
    ("softrod sim", "simulate"),
    ("softrod calibrate --res", "--resume"),
    ("softrod calibrate --fit young_modulus,dens", "young_modulus,density"),
    ("softrod design --fit pull_g", "pull_gain pull_gain_each"),
    ("softrod init ten", "tentacle"),
    ("softrod solve rob", "robot.toml"),
]
ASK = {
    "bash": """eval "$(softrod completion bash)"
COMP_LINE="$1" COMP_POINT=${#1} COMP_WORDS=($1) COMP_TYPE=9
_python_argcomplete softrod
printf '%s\\n' "${COMPREPLY[@]}"
""",
    "fish": """softrod completion fish | source
complete -C "$argv[1]"
""",
    "zsh": """autoload -U compinit && compinit -u -D
eval "$(softrod completion zsh)"
print -r -- $_comps[softrod]
""",
}


@pytest.fixture
def shell(tmp_path, monkeypatch):
    """Runs a script with an argument in a shell that has the command."""
    command = tmp_path / "bin" / "softrod"
    command.parent.mkdir()
    command.write_text(f'#!/bin/sh\nexec "{sys.executable}" -m calibration.cli "$@"\n')
    command.chmod(0o755)
    monkeypatch.setenv("PATH", str(command.parent), prepend=os.pathsep)
    monkeypatch.setenv("PYTHONPATH", str(ROOT))

    def ask(name, line=""):
        if shutil.which(name) is None:
            pytest.skip(f"{name} is not installed")
        script = tmp_path / "ask"
        script.write_text(ASK[name])
        done = subprocess.run([name, script, line], capture_output=True, text=True, timeout=60)
        assert done.returncode == 0, done.stderr
        return done.stdout

    return ask


@pytest.mark.parametrize("name", ["bash", "fish"])
def test_a_shell_completes_commands_options_names_and_files(name, shell):
    for line, expected in LINES:
        # fish tells what each is, behind a tabulator.
        found = [x.split("\t")[0].strip() for x in shell(name, line).splitlines()]
        assert " ".join(found) == expected, line


def test_zsh_asks_the_same_function(shell):
    assert shell("zsh").split() == ["_python_argcomplete"]


def test_another_shell_is_refused(capsys):
    status, _, err = run(capsys, "completion", "tcsh")
    assert status == 2 and "'bash', 'zsh', 'fish'" in err
