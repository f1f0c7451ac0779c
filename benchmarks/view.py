"""How many frames a second `softrod view` shows of a robot that moves, without a browser.

    python benchmarks/view.py [SCENE.toml]

By default the article's robot, hanging. A slider goes to and fro; a frame is a step of 1/60 s, the
rod's shape, and what is sent to browsers. Real time needs 60, and an eye 30.
"""

import sys
import threading
import time

import jax

jax.config.update("jax_enable_x64", True)

import numpy as np

import softrod_jax as sr
from softrod_jax.live.page import Page
from softrod_jax.live.session import Session

SECONDS = 5.0


def main(scene) -> None:
    session = Session(scene)
    page = Page(session, "127.0.0.1", 8452, "view.csv")
    page.frame()  # compiles
    slider = next((x[0] for x in page.sliders.values() if x), page.gravity[0])
    most, begun, frames = slider.max, time.perf_counter(), 0
    while time.perf_counter() - begun < SECONDS:  # as fast as it goes
        slider.value = most * (0.25 + 0.25 * np.sin(0.05 * frames))
        page.frame()
        frames += 1
    fastest = frames / SECONDS
    driver = threading.Timer(0.1, lambda: setattr(slider, "value", 0.5 * most))
    driver.start()
    before, simulated = page.frames, session.time
    page.run(SECONDS)
    print(f"at most {fastest:.0f} frames/s, of which 60 are real time")
    print(
        f"in real time {(page.frames - before) / SECONDS:.0f} frames/s; "
        f"{(session.time - simulated) / SECONDS:.2f} s simulated a second"
    )
    page.stop()


if __name__ == "__main__":
    gravity = np.array([0.0, 0.0, 9.81])
    main(sr.load_scene(sys.argv[1]) if len(sys.argv) > 1 else sr.hybrid_robot(gravity=gravity))
