"""Films that can be turned: the page holds the rod, what was seen of it, and all that it needs."""

import base64
import json
import re
import shutil
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import softrod_jax as sr

pytest.importorskip("matplotlib")

from test_pictures import LENGTH, motion  # noqa: E402

from softrod_jax import pictures  # noqa: E402
from softrod_jax.pictures.body import body_of, line_along  # noqa: E402
from softrod_jax.scene.inputs import Inputs  # noqa: E402

# Arcs of known shape stand here for solutions.
pytestmark = pytest.mark.usefixtures("wrong_types")

TENSIONS = np.array([[0.1, 0.2, 0.0]] * 4)


def page(path, **options):
    pictures.film(sr.hybrid_robot(LENGTH), motion(), path, **options)
    return path.read_text("utf-8")


def content(text):
    return json.loads(re.search(r'<script id="content".*?>(.*?)</script>', text, re.DOTALL)[1])


def unpacked(packed):
    whole = np.frombuffer(base64.b64decode(packed["data"]), "<u2")
    return packed["low"] + packed["step"] * whole


def test_the_page_holds_the_rod(tmp_path):
    found = content(page(tmp_path / "a.html", inputs=Inputs(TENSIONS, 2e4 * np.ones((4, 1)))))
    line = line_along(motion(), body_of(sr.hybrid_robot(LENGTH), 33).arc)
    shape = (5, 33, 3)
    assert found["times"] == [0, 0.1, 0.2, 0.3, 0.4] and found["places"] == 33
    np.testing.assert_allclose(unpacked(found["points"]).reshape(shape), 1e3 * line.p, atol=2e-3)
    np.testing.assert_allclose(unpacked(found["across"]).reshape(shape), line.R[..., 0], atol=3e-5)
    assert [x["name"] for x in found["inputs"]] == ["tension", "pressure"]
    assert found["inputs"][0]["curves"][1] == [0.2] * 5  # as many as there are times
    assert found["inputs"][1]["curves"] == [[20.0] * 5] and found["inputs"][1]["unit"] == "kPa"
    assert [x["at"][0] for x in found["tendons"]][0] == [4.0e-3, 0.0]


def test_pulls_have_the_colours_of_their_tendons_and_disks_are_drawn(tmp_path):
    scene = sr.hybrid_robot(LENGTH)
    tendons = replace(scene.tendons, control=("length", "tension", "length"), guided=("disks",) * 3)
    inputs = Inputs(tensions=np.ones((4, 1)), pulls=np.ones((4, 2)))
    path = tmp_path / "a.html"
    pictures.film(replace(scene, tendons=tendons), motion(), path, inputs)
    found = content(path.read_text("utf-8"))
    colours = {x["name"]: x["colours"] for x in found["inputs"]}
    first, second, third = pictures.TENDON_COLOURS[:3]
    assert colours == {"tension": [second], "pull": [first, third]}
    assert len(found["disks"]) == 9
    away = np.linalg.norm(found["disks"][0]["rings"], axis=-1)
    np.testing.assert_allclose(away, 4.4e-3, rtol=1e-5)  # of six digits


def test_it_needs_no_network_and_names_are_text(tmp_path):
    evil = "</script><img src=x onerror=alert(1)>"
    seen = {evil: ([0.0, 0.1, 0.2], [[0, 0, 0.1], [np.nan] * 3, [0.01, 0, 0.09]])}
    text = page(tmp_path / "a.html", title=evil, measured=seen)
    assert "<img" not in text and text.count("</script>") == 2
    own = text.replace("src=x", "")  # of the names, where it is text
    assert not re.search(r"(src|href)\s*=|https?:|import\s*\(|fetch\(|@import", own)
    assert content(text)["measured"][0]["times"] == [0.0, 0.2]  # what is known
    assert len(text) < 100_000


def test_bad_input(tmp_path):
    with pytest.raises(ValueError, match=r"expected .html"):
        page(tmp_path / "a.gif")
    with pytest.raises(ValueError, match=r"tensions of shape \(3, 3\).*\(4, 3\)"):
        page(tmp_path / "a.html", inputs=Inputs(TENSIONS[:3]))
    failed = SimpleNamespace(**{**vars(motion()), "result": np.array(2)})
    with pytest.raises(ValueError, match="nothing to draw"):
        pictures.film(sr.hybrid_robot(LENGTH), failed, tmp_path / "a.html")


@pytest.mark.skipif(shutil.which("ffmpeg") is None, reason="needs ffmpeg")
def test_a_film_of_ffmpeg(tmp_path):
    options = {"size": (201, 181), "fps": 10}
    path = pictures.animate(sr.hybrid_robot(LENGTH), motion(), tmp_path / "a.mp4", **options)
    assert path.read_bytes()[4:8] == b"ftyp"


def test_without_ffmpeg_there_is_no_mp4(tmp_path, monkeypatch):
    monkeypatch.setattr(shutil, "which", lambda name: None)
    with pytest.raises(ValueError, match="needs ffmpeg"):
        pictures.animate(sr.hybrid_robot(LENGTH), motion(), tmp_path / "a.mp4")


def test_a_browser_plays_it(tmp_path):
    """Drawn, turned by dragging, played; nothing is asked for and nothing goes wrong."""
    playwright = pytest.importorskip("playwright.sync_api")
    chromium = shutil.which("chromium") or shutil.which("google-chrome")
    if chromium is None:
        pytest.skip("needs Chromium")
    path = tmp_path / "a.html"
    page(path, measured={"tip": (motion().ts, line_along(motion(), np.array([LENGTH])).p[:, 0])})
    asked, wrong = [], []
    with playwright.sync_playwright() as tools:
        browser = tools.chromium.launch(executable_path=chromium, args=["--no-sandbox"])
        tab = browser.new_page(viewport={"width": 500, "height": 500})
        tab.on("request", lambda request: asked.append(request.url))
        tab.on("pageerror", lambda error: wrong.append(str(error)))
        tab.goto(path.as_uri())
        tab.evaluate("film.go(0.2)")
        before = tab.screenshot()
        tab.mouse.move(200, 200)
        tab.mouse.down()
        tab.mouse.move(260, 230)
        tab.mouse.up()
        state, after = tab.evaluate("film.state()"), tab.screenshot()
        tab.click("#play")
        tab.wait_for_function("film.state().now != 0.2")
        browser.close()
    assert state["now"] == 0.2 and not state["playing"]
    assert state["turn"] == pytest.approx(-0.6 + 0.008 * 60) and state["tilt"] > 0.3
    assert before != after and len(before) > 8000
    assert asked == [path.as_uri()] and wrong == []
