"""The documentation builds without a warning, and its reference has every public name."""

import importlib
import re
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import pytest

import calibration

pytest.importorskip("mkdocs", reason='needs the extra: pip install -e ".[docs]"')

ROOT = Path(__file__).parents[2]


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


def test_every_page_is_there_and_has_something_to_say(site):
    pages = sorted(p.relative_to(ROOT / "docs" / "pages") for p in ROOT.glob("docs/pages/**/*.md"))
    assert len(pages) > 8
    for page in pages:
        assert len(words(site / page.with_suffix(".html"))) > 300, page


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


def test_passages_of_the_readme_and_formulas_are_put_in(site):
    for page in site.glob("**/*.html"):
        text = page.read_text("utf-8")
        assert not re.search(r"<!-- (readme|file|reference):", text), page
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
