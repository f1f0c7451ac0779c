"""Files of the repository in the pages: the README, the changelog, figures and notebooks.

A line of a page that is this comment is replaced by a whole file:

    <!-- file: CHANGELOG.md -->

In such files, links are relative to where they lie; in pages, one that begins with / is from the
root of the repository. So they hold where the files are read without the site, too. Here they
follow: to a page of the site, to a copy of a picture. Other files of the repository are not part
of the site, and a link to one becomes its text. Pictures open in their full size.
"""

import posixpath
import re
from pathlib import Path

from mkdocs.exceptions import PluginError
from mkdocs.structure.files import File

ROOT = Path(__file__).parents[1]
PAGES = "docs/pages/"
PICTURES = (".png", ".gif", ".svg")
_COMMENT = re.compile(r"^<!-- file: (.*) -->$", re.MULTILINE)
_FENCED = re.compile(r"(^```.*?^```$)", re.MULTILINE | re.DOTALL)
# The text of a link may be a picture.
_LINK = re.compile(r"(!?)\[((?:[^\[\]]|!\[[^\]]*\]\([^)]*\))*)\]\(([^)\s]+)\)")
_SOURCE = re.compile(r'(<img[^>]*\bsrc=")([^"]+)(")')

_PICTURE = re.compile(r'(<a\b[^>]*>\s*)?(<img\b[^>]*\bsrc="([^"]+)"[^>]*>)')

_included = {}  # the page that a whole file is, by the file's name


def on_files(files, config):
    """Note which files are pages, and add the pictures that lie elsewhere in the repository."""
    _included.clear()
    shown = set()
    for file in files.documentation_pages():
        text = file.content_string
        _included.update({name: file.src_uri for name in _COMMENT.findall(text)})
        for target in re.findall(r'(?:\]\(|src=")([^)"\s]+)', _whole(text)):
            path = target.removeprefix("/")
            if path.startswith("benchmarks/") and path.endswith(PICTURES):
                shown.add(path)
    for picture in sorted(shown):
        if not (ROOT / picture).is_file():
            raise PluginError(f"a page shows {picture}, which does not exist")
        files.append(File.generated(config, picture, abs_src_path=str(ROOT / picture)))
    return files


def on_page_markdown(markdown, page, config, files):
    """Put whole files in, and let links follow; blocks of code are left as they are."""
    whole = _COMMENT.search(markdown) is not None

    def link(match):
        image, text, target = match.groups()
        found = _place(target, whole)
        if found is None:
            return text
        return f"{image}[{_LINK.sub(link, text)}]({_relative(found, page)})"

    def source(match):
        before, target, after = match.groups()
        return before + _relative(_place(target, whole) or target, page) + after

    parts = _FENCED.split(_whole(markdown))
    parts[::2] = [_SOURCE.sub(source, _LINK.sub(link, part)) for part in parts[::2]]
    return "".join(parts)


def on_page_content(content, page, config, files):
    """A picture that is no link opens in its full size."""

    def opened(match):
        link, image, source = match.groups()
        return f"{link}{image}" if link else f'<a href="{source}">{image}</a>'

    return _PICTURE.sub(opened, content)


def _whole(text: str) -> str:
    return _COMMENT.sub(lambda m: (ROOT / m.group(1)).read_text(encoding="utf-8").strip(), text)


def _place(target: str, whole: bool) -> str | None:
    """Where a link leads: from the root of the site with a / before it, else as it stands.

    None if it leads to a file that the site does not have. `whole`: the link is in a whole file.
    """
    path, hash_, anchor = target.partition("#")
    if "://" in path or not path or not (whole or path.startswith("/")):
        return target
    path = path.removeprefix("/")
    if path in _included:
        return f"/{_included[path]}{hash_}{anchor}"
    if path.startswith(PAGES) or path.endswith(".ipynb"):
        return f"/{path.removeprefix(PAGES).replace('.ipynb', '.md')}{hash_}{anchor}"
    return f"/{path}" if path.endswith(PICTURES) else None


def _relative(target: str, page) -> str:
    """As seen from a page."""
    if not target.startswith("/"):
        return target
    return posixpath.relpath(target[1:], posixpath.dirname(page.file.src_uri) or ".")
