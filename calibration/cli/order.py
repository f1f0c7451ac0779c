"""Options and positions of a command line in any order.

argparse takes positions only where they stand together, and an option that takes many values takes
all that follows, a scene file too. Here positions are put first.
"""

import argparse
import difflib
import math
import re
from collections.abc import Iterable
from pathlib import PurePath

from calibration.cli.common import UsageError

# What ends the values of an option that takes many: the name of a file that it is not about.
_SCENES = (".toml",)
_TABLES = (".csv", ".tsv", ".txt", ".dat", ".asc", ".lvm", ".trc", ".mat", ".h5", ".hdf5",
           ".parquet", ".c3d")  # fmt: skip
_NUMBER = re.compile(r"-(\.?\d|inf|nan)", re.IGNORECASE)


def positions_first(parser: argparse.ArgumentParser, words: list[str]) -> list[str]:
    """The words of a command line, those that belong to no option before all others.

    Raises `UsageError` for an option that there is not.
    """
    positions, options, k = [], [], 0
    while k < len(words):
        word = words[k]
        k += 1
        if word == "--":  # whatever follows is none
            return [*options, "--", *positions, *words[k:]]
        if not _is_option(word):
            positions.append(word)
            continue
        options.append(word)
        action = _action(parser, word)
        if action is None or "=" in word:
            continue
        most, taken = _most(action), 0
        while taken < most and k < len(words) and not _is_option(words[k]):
            if most == math.inf and _is_position(words[k], action):
                break
            options.append(words[k])
            k, taken = k + 1, taken + 1
    return [*positions, *options]


def _is_option(word: str) -> bool:
    return len(word) > 1 and word.startswith("-") and not _NUMBER.match(word)


def _action(parser, word: str) -> argparse.Action | None:
    """The option that a word names, perhaps by its beginning."""
    name = word.partition("=")[0]
    known = {option: action for action in parser._actions for option in action.option_strings}
    if name in known:
        return known[name]
    begun = {id(a): a for option, a in known.items() if option.startswith(name)}
    if not begun and name.startswith("--"):
        raise UsageError(f"no option {name}{like(name, known)} (see `{parser.prog} --help`)")
    return next(iter(begun.values())) if len(begun) == 1 else None


def like(name: str, known: Iterable[str]) -> str:
    """A question whether what is most like `name` was meant; empty if nothing is."""
    near = difflib.get_close_matches(name, list(known), 1)
    return f"; did you mean '{near[0]}'?" if near else ""


def _most(action: argparse.Action) -> float:
    """How many values an option takes at most."""
    if action.nargs is None or action.nargs == "?":
        return 1
    return action.nargs if isinstance(action.nargs, int) else math.inf


def _is_position(word: str, action: argparse.Action) -> bool:
    """Whether a word is a file that an option of many values is not about."""
    suffix = PurePath(word).suffix.lower()
    of_logs = isinstance(action.metavar, str) and action.metavar.startswith("LOG")
    return suffix in (_SCENES if of_logs else _SCENES + _TABLES) and "=" not in word
