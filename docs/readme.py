"""Passages of the README and other files in the pages, so that no number is copied by hand.

A line of a page that is one of these comments is replaced:

    <!-- readme: # Limits -->     the README's section of that heading, without the heading
    <!-- readme: stress -->       what is between <!-- stress: begin --> and its end
    <!-- readme: rest -->         the sections that no page includes, with their headings
    <!-- file: CHANGELOG.md -->   a whole file

Links follow: to a section of the README, the page that includes it; to a figure, a copy of it.
Other files of the repository are not part of the site, and a link to one becomes its text.
"""

import posixpath
import re
from pathlib import Path

from mkdocs.exceptions import PluginError
from mkdocs.structure.files import File

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")
_COMMENT = re.compile(r"^<!-- (readme|file): (.*) -->$", re.MULTILINE)
_LINK = re.compile(r"(!?)\[([^\]]*)\]\(([^)\s]+)\)")

_ELSEWHERE = {"Development"}  # what contributors read is a page of its own
_rest = []  # headings that no page includes by name
_places = {}  # the page on which each section of the README is, by anchor


def on_files(files, config):
    """Note what is included where, and add the figures that it shows."""
    _places.clear()
    figures, rest_on = set(), None
    for file in files.documentation_pages():
        text = Path(file.abs_src_path).read_text(encoding="utf-8")
        for kind, name in _COMMENT.findall(text):
            if name == "rest":
                rest_on = file.src_uri
                continue
            if kind == "readme" and name.startswith("# "):
                _places[_anchor(name[2:])] = file.src_uri
            for image, _, target in _LINK.findall(_passage(kind, name)):
                if image:
                    figures.add(target)
        figures.update(re.findall(r"\]\(/(benchmarks/[^)]*\.png)\)", text))
    if rest_on:
        _rest[:] = [h for h in _headings() if _anchor(h) not in _places and h not in _ELSEWHERE]
        _places.update({_anchor(heading): rest_on for heading in _rest})
        figures.update(x for image, _, x in _LINK.findall(_passage("readme", "rest")) if image)
    for figure in sorted(figures):
        files.append(File.generated(config, figure, abs_src_path=str(ROOT / figure)))
    return files


def on_page_markdown(markdown, page, config, files):
    """Put the passages in."""

    def passage(match):
        return _LINK.sub(link, _passage(*match.groups()))

    def link(match):
        image, text, target = match.groups()
        if target.startswith("https://"):
            return match.group()
        if image:
            return f"![{text}]({_relative(target, page)})"
        if target.startswith("#") and target[1:] in _places:
            return f"[{text}]({_relative(_places[target[1:]], page)}{target})"
        return text

    markdown = _COMMENT.sub(passage, markdown)
    # A figure that a page shows by itself is written from the root of the repository.
    return re.sub(
        r"\]\(/(benchmarks/[^)]*)\)", lambda m: f"]({_relative(m.group(1), page)})", markdown
    )


def _passage(kind: str, name: str) -> str:
    if kind == "file":
        return (ROOT / name).read_text(encoding="utf-8")
    if name == "rest":
        return "\n\n".join(f"## {h}\n\n{_passage('readme', f'# {h}')}" for h in _rest)
    if name.startswith("# "):
        found = re.findall(rf"^#+ {re.escape(name[2:])}\n(.*?)(?=^## |\Z)", README, re.M | re.S)
    else:
        marks = [re.escape(f"<!-- {name}: {end} -->") for end in ("begin", "end")]
        found = re.findall("(.*?)".join(marks), README, re.S)
    if len(found) != 1:
        raise PluginError(f"README.md has {len(found)} passages {name!r}; one is needed")
    return found[0].strip()


def _headings() -> list[str]:
    return re.findall(r"^## (.*)$", README, re.MULTILINE)


def _anchor(heading: str) -> str:
    return re.sub(r"[^\w -]", "", heading).lower().replace(" ", "-")


def _relative(target: str, page) -> str:
    return posixpath.relpath(target, posixpath.dirname(page.file.src_uri) or ".")
