"""The documentation builds without a warning, and lacks no public name, link or picture."""

import importlib
import json
import re
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path
from types import ModuleType
from urllib.parse import unquote, urlsplit

import pytest

import calibration

pytest.importorskip("mkdocs", reason='needs the extra: pip install -e ".[docs]"')

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT / "docs"))

import notebooks  # noqa: E402


def public_names():
    """By package: `softrod_jax`, `calibration` and the packages inside that offer any."""
    found = {"calibration": calibration.__all__}
    for path in sorted(ROOT.glob("softrod_jax/**/__init__.py")):
        package = ".".join(path.parent.relative_to(ROOT).parts)
        module = importlib.import_module(package)
        names = [
            name
            for name, value in vars(module).items()
            if not name.startswith("_") and not isinstance(value, ModuleType)
        ]
        if names:
            found[package] = names
    return found


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """The folder of the built site; a warning ends the build."""
    folder = tmp_path_factory.mktemp("site")
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(folder)]
    done = subprocess.run(
        [*command, "--config-file", str(ROOT / "docs" / "mkdocs.yml")],
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert done.returncode == 0, done.stderr
    return folder


def words(page: Path) -> str:
    """What a reader sees of the page itself."""
    (article,) = re.findall(r"<article.*?</article>", page.read_text("utf-8"), re.DOTALL)
    return re.sub(r"<[^>]+>", "", article)


class Page(HTMLParser):
    """What a built page links to and shows, and what can be linked to in it."""

    def __init__(self, path: Path):
        super().__init__()
        self.links, self.pictures, self.anchors = [], [], set()
        self.feed(path.read_text("utf-8"))

    def handle_starttag(self, tag, attrs):
        found = dict(attrs)
        self.anchors |= {found[key] for key in ("id", "name") if found.get(key)}
        if tag in ("a", "link") and found.get("href"):
            self.links.append(found["href"])
        if tag in ("img", "script", "source") and found.get("src"):
            self.links.append(found["src"])
        if tag == "img":
            self.pictures.append(found)


@pytest.fixture(scope="module")
def pages(site):
    # 404.html links from the root of a server.
    return {p: Page(p) for p in sorted(site.glob("**/*.html")) if p.name != "404.html"}


def broken(pages) -> list[str]:
    """Links within the site that lead nowhere: to no file, an empty one or no anchor of a page."""
    found = []
    for path, page in pages.items():
        for link in page.links:
            parts = urlsplit(link)
            if parts.scheme:
                continue
            target = (path.parent / unquote(parts.path)).resolve() if parts.path else path
            if target.is_dir():
                target = target / "index.html"
            there = target.is_file() and target.stat().st_size > 0
            if not there:
                found.append(f"{path.name}: {link}: no such file")
            elif parts.fragment and unquote(parts.fragment) not in pages[target].anchors:
                found.append(f"{path.name}: {link}: no such anchor")
    return found


def test_links_anchors_and_pictures_lead_somewhere(pages):
    assert sum(len(page.links) for page in pages.values()) > 1000
    assert sum(len(page.pictures) for page in pages.values()) > 40
    assert broken(pages) == []


def test_broken_links_are_seen(tmp_path):
    (tmp_path / "a.html").write_text('<a href="#here"><a href="b.html#there"><img src="c.png">')
    (tmp_path / "b.html").write_text('<h2 id="there"><a href="https://example.org/x">')
    found = broken({p.resolve(): Page(p) for p in tmp_path.glob("*.html")})
    assert found == ["a.html: #here: no such anchor", "a.html: c.png: no such file"]


def test_pictures_are_described(pages):
    for path, page in pages.items():
        for picture in page.pictures:
            assert picture.get("alt"), (path, picture)


def test_long_pages_have_a_table_of_contents(site):
    counted = 0
    for path in site.glob("**/*.html"):
        text = path.read_text("utf-8")
        headings = re.findall(r'<h2[^>]* id="([^"]+)"', text)
        if len(headings) > 1:
            counted += 1
            for heading in headings:
                assert re.search(rf'<a href="#{re.escape(heading)}" class="md-nav__link"', text), (
                    path,
                    heading,
                )
    assert counted > 25


def test_every_page_is_there_and_has_something_to_say(site):
    written = [p.relative_to(ROOT / "docs" / "pages") for p in ROOT.glob("docs/pages/**/*.md")]
    made = [p.relative_to(ROOT).with_suffix(".md") for p in ROOT.glob("notebooks/*.ipynb")]
    pages = sorted([*written, *made])
    assert len(pages) > 30
    navigation = (ROOT / "docs" / "mkdocs.yml").read_text("utf-8")
    for page in pages:
        assert len(words(site / page.with_suffix(".html"))) > 300, page
        assert re.search(rf"[ :] ?{re.escape(page.as_posix())}$", navigation, re.MULTILINE), page


def test_notebooks_show_their_pictures_and_are_in_the_gallery(site):
    gallery = (site / "gallery.html").read_text("utf-8")
    for path in sorted(ROOT.glob("notebooks/*.ipynb")):
        cells = json.loads(path.read_text("utf-8"))["cells"]
        outputs = [output.get("data", {}) for cell in cells for output in cell.get("outputs", [])]
        pictures = [data for data in outputs if any(kind.startswith("image/") for kind in data)]
        page = (site / "notebooks" / f"{path.stem}.html").read_text("utf-8")
        assert page.count(f'src="{path.stem}/') == len(pictures) > 0, path
        assert f'href="notebooks/{path.stem}.html"' in gallery
        assert f'src="notebooks/{path.stem}/' in gallery


def test_notebooks_are_executed_where_that_is_asked(tmp_path):
    nbformat = pytest.importorskip("nbformat")
    pytest.importorskip("ipykernel")
    cells = [nbformat.v4.new_markdown_cell("# Sum\n\nOf two [numbers](other.ipynb).")]
    cells.append(nbformat.v4.new_code_cell("print(20 + 2)\nprint('and so on')"))
    cells[1].outputs = [nbformat.v4.new_output("stream", text="22, as committed\n")]
    path = tmp_path / "sum.ipynb"
    nbformat.write(nbformat.v4.new_notebook(cells=cells), path)
    page, pictures = notebooks.page_of(notebooks._read(path, execute=False), "sum")
    assert page.startswith("# Sum\n\n*The notebook") and "[numbers](other.md)" in page
    assert page.endswith("```text\n22, as committed\n```\n") and pictures == {}
    page, _ = notebooks.page_of(notebooks._read(path, execute=True), "sum")
    assert page.endswith("```text\n22\nand so on\n```\n")


def test_every_public_name_is_in_the_reference(site):
    text = "".join(p.read_text("utf-8") for p in sorted(site.glob("reference/*.html")))
    public = public_names()
    assert len(public["softrod_jax"]) > 20
    for package, names in public.items():
        for name in names:
            assert text.count(f'<a id="{package}.{name}"></a>') == 1, f"{package}.{name}"
            # Under its anchor is its heading, and a docstring.
            _, _, entry = text.partition(f'<a id="{package}.{name}"></a>')
            heading, _, body = entry.partition('<div class="doc doc-contents')
            assert re.search(rf">\s*{name}\s*<", heading), name
            assert len(re.sub(r"<[^>]+>", "", body[:2000]).split()) > 2, name


def test_whole_files_and_formulas_are_put_in(site):
    for page in site.glob("**/*.html"):
        text = page.read_text("utf-8")
        assert not re.search(r"<!-- (file|reference|layout|notebooks)\b", text), page
        assert 'class="arithmatex"' not in text, page
    assert (site / "model.html").read_text("utf-8").count("<math") > 20


def test_nothing_is_fetched_from_elsewhere(site):
    for page in site.glob("**/*.html"):
        loaded = re.findall(
            r'<(?:script|link|img)[^>]*(?:src|href)="(https?:[^"]*)"', page.read_text("utf-8")
        )
        assert not loaded, page


def test_the_contributing_page_names_files_that_exist(site):
    """Every path and every dotted name of code in it."""
    text = (ROOT / "docs" / "pages" / "contributing.md").read_text("utf-8")
    paths = set(
        re.findall(r"`((?:softrod_jax|calibration|tests|benchmarks|docs|\.ci)/[\w./]*)`", text)
    )
    assert len(paths) > 10
    for path in paths:
        assert (ROOT / path).exists(), path


def test_tests_that_are_measured_to_take_long_exist():
    for name in (ROOT / "tests" / "long.txt").read_text().split():
        path, _, test = name.partition("::")
        assert f"def {test}(" in (ROOT / path).read_text(), name
