"""The README's fit: the bundled recording, and the robot that is fitted to it.

python benchmarks/readme_fit.py
"""

from pathlib import Path

import jax
import matplotlib
import matplotlib.pyplot as plt

import softrod_jax as sr
from calibration import calibrate, load_recording
from calibration.examples import example_paths

FIGURE = Path(__file__).parent / "figures" / "fit.png"


def fitted():
    scene_path, (log,) = example_paths()
    scene = sr.load_scene(scene_path)
    return calibrate(scene, [load_recording(log, scene)], progress=False)


def draw(fit):
    (recording,) = fit.recordings
    figure, panels = plt.subplots(1, 3, figsize=(9.5, 2.9), layout="constrained")
    for panel, axis, measured, simulated in zip(
        panels, "xyz", recording.measured.T, recording.curve.T, strict=True
    ):
        panel.plot(recording.times, 1e3 * measured, ".", ms=7, color="0.68", label="measured")
        panel.plot(recording.curve_times, 1e3 * simulated, lw=1.1, color="#d55e00", label="fitted")
        panel.set(title=f"tip {axis} [mm]", xlabel="time [s]")
        panel.grid(alpha=0.3)
    panels[1].legend(loc="upper left", fontsize=9)
    return figure


if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    matplotlib.use("agg")
    draw(fitted()).savefig(FIGURE, dpi=130)
    print(FIGURE)
