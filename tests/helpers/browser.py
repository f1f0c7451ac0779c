"""A real browser without a window: Debian's or Google's, or the one that playwright has fetched."""

import contextlib
import shutil
from pathlib import Path

import pytest

# 3D without a graphics card.
_OPTIONS = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]


@contextlib.contextmanager
def tab(url: str, width: int = 900, height: int = 600):
    """A tab that shows `url`. Skips the test where there is no browser, and says what helps."""
    playwright = pytest.importorskip("playwright.sync_api")
    with playwright.sync_playwright() as tools:
        own = tools.chromium.executable_path
        names = ("chromium", "google-chrome", "chromium-browser")
        found = next(filter(None, map(shutil.which, names)), own if Path(own).exists() else None)
        if found is None:
            pytest.skip("no browser: apt-get install chromium, or playwright install chromium")
        browser = tools.chromium.launch(executable_path=found, args=_OPTIONS)
        try:
            shown = browser.new_page(viewport={"width": width, "height": height})
            shown.set_default_timeout(120_000)  # however busy the machine is
            shown.goto(url)
            yield shown
        finally:
            browser.close()
