"""The picture of the page that `softrod view` opens, as a browser shows it.

    python benchmarks/view_picture.py

Needs playwright (`pip install playwright`) and Chromium; keys move the first slider.
"""

import shutil
import sys
import time
from pathlib import Path

import jax

jax.config.update("jax_enable_x64", True)

import numpy as np
from playwright.sync_api import sync_playwright

import softrod_jax as sr

FIGURE = Path(__file__).parent / "figures" / "view.png"
OPTIONS = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]


def main() -> None:
    chromium = shutil.which("chromium") or shutil.which("google-chrome")
    if chromium is None:
        sys.exit("view_picture.py: no Chromium; install it")
    scene = sr.hybrid_robot(gravity=np.array([0.0, 0.0, 9.81]))
    page = sr.view(scene, block=False, port=8453)
    with sync_playwright() as tools:
        browser = tools.chromium.launch(executable_path=chromium, args=OPTIONS)
        tab = browser.new_page(viewport={"width": 760, "height": 430})
        tab.goto("http://127.0.0.1:8453")
        slider = tab.locator("[role=slider]").first
        slider.focus(timeout=60_000)
        for _ in range(90):
            tab.keyboard.press("ArrowRight")
        time.sleep(3)  # until it hangs still
        tab.locator(".mantine-Notification-closeButton").first.click(timeout=10_000)
        slider.blur()
        time.sleep(1)
        tab.screenshot(path=FIGURE)
        browser.close()
    page.stop()


if __name__ == "__main__":
    main()
