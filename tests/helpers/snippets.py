"""Pages as a reader follows them: their blocks run in order, and print what they say they print.

- `toml` and `csv` with a `title="NAME"` are files, `python` runs in one namespace, `sh` in which
  every line begins with `softrod` is run by the command line's `main`, in this process.
- A comment `<!-- after: PAGE.md -->` says that the files of another page are there.
- `text` behind one that ran is what it writes to stdout: numbers to one unit of their last
  digit; a line `...` stands for any lines. Any other block is not run.
"""

import contextlib
import io
import math
import re
import shlex
from dataclasses import dataclass
from pathlib import Path

import calibration.cli.main

_BLOCK = re.compile(r"^```(\w+)(?: title=\"([^\"]+)\")?\n(.*?)^```$", re.MULTILINE | re.DOTALL)
_NUMBER = re.compile(r"[-+]?\d+(?:,\d{3})*(?:\.\d*)?(?:e[-+]?\d+)?")
_AFTER = re.compile(r"^<!-- after: (.*) -->$", re.MULTILINE)


@dataclass(frozen=True)
class Block:
    language: str
    title: str | None
    text: str
    line: int


def blocks(page: Path, language: str | None = None) -> list[Block]:
    """The fenced blocks of a page, in order; only those of a language if it is given."""
    text = page.read_text(encoding="utf-8")
    found = [
        Block(m[1], m[2], m[3], text[: m.start()].count("\n") + 2) for m in _BLOCK.finditer(text)
    ]
    return [block for block in found if language in (None, block.language)]


def follow(page: Path, folder: Path) -> int:
    """Do what a page says, in `folder`, the current directory; how many blocks ran.

    Raises `AssertionError` where something else is printed, or a command fails.
    """
    names, written, ran = {"__name__": "__main__"}, None, 0
    for other in _AFTER.findall(page.read_text(encoding="utf-8")):
        write_files(page.parent / other, folder)
    write_files(page, folder)
    for block in blocks(page):
        if block.title is not None:
            continue
        if block.language == "python":
            # Lines of errors are those of the page.
            code = compile("\n" * (block.line - 1) + block.text, page.name, "exec")
            written = _stdout(exec, code, names)
        elif block.language == "sh" and all(c.startswith("softrod ") for c in commands(block)):
            written = _stdout(_run, commands(block))
        elif block.language == "text" and written is not None:
            assert_prints(written, block.text, f"{page.name}, line {block.line}")
            written = None
            continue
        else:
            written = None
            continue
        ran += 1
    return ran


def write_files(page: Path, folder: Path) -> None:
    """The blocks of a page that have names of files, as such."""
    for block in blocks(page):
        if block.title is not None:
            (folder / block.title).write_text(block.text, encoding="utf-8")


def commands(block: Block) -> list[str]:
    """The lines of a block of commands, without comments; one that ends with \\ goes on."""
    lines = block.text.replace("\\\n", " ").splitlines()
    return [line.split("  #")[0].strip() for line in lines if line.strip()]


def _run(lines: list[str]) -> None:
    for line in lines:
        errors = io.StringIO()
        with contextlib.redirect_stderr(errors):
            status = calibration.cli.main.main(shlex.split(line)[1:])
        assert status == 0, f"{line}: {errors.getvalue()}"


def _stdout(function, *arguments) -> str:
    written = io.StringIO()
    with contextlib.redirect_stdout(written):
        function(*arguments)
    return written.getvalue()


def assert_prints(written: str, expected: str, where: str) -> None:
    parts = [part.split() for part in re.split(r"^\.\.\.$", expected, flags=re.MULTILINE)]
    message = f"{where}: it says\n{expected}\nand prints\n{written}"
    assert _match(written.split(), parts), message


def _match(words: list[str], parts: list[list[str]]) -> bool:
    """Whether the words are those of the parts in order, with any words in between."""
    first, *others = parts
    if not others:
        return _alike(words, first)
    *middle, last = others
    if not _alike(words[: len(first)], first):
        return False
    rest = words[len(first) :]
    for part in middle:
        places = range(len(rest) - len(part) + 1)
        at = next((i for i in places if _alike(rest[i : i + len(part)], part)), None)
        if at is None:
            return False
        rest = rest[at + len(part) :]
    return len(rest) >= len(last) and _alike(rest[len(rest) - len(last) :], last)


def _alike(words: list[str], expected: list[str]) -> bool:
    return len(words) == len(expected) and all(map(_same, words, expected))


def _same(word: str, expected: str) -> bool:
    if _NUMBER.sub("#", word) != _NUMBER.sub("#", expected):
        return False
    pairs = zip(_NUMBER.findall(word), _NUMBER.findall(expected), strict=True)
    return all(abs(_value(a) - _value(b)) <= _unit(b) * (1 + 1e-9) for a, b in pairs)


def _value(number: str) -> float:
    return float(number.replace(",", ""))


def _unit(number: str) -> float:
    """One unit of the last digit that is given; a number without a decimal point is exact."""
    mantissa, _, exponent = number.lower().partition("e")
    if mantissa in ("0.0", "-0.0"):  # as Python prints an exact zero
        return 1e-9
    if "." not in mantissa and not exponent:
        return 0.0
    decimals = len(mantissa.partition(".")[2])
    return math.pow(10.0, int(exponent or 0) - decimals)
