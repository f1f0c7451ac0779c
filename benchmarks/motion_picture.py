"""The gallery's motion: a robot whose three tendons are pulled in turn.

python benchmarks/motion_picture.py
"""

from pathlib import Path

import jax
import jax.numpy as jnp
import matplotlib
import matplotlib.pyplot as plt
import numpy as np

import softrod_jax as sr

FIGURE = Path(__file__).parent / "figures" / "motion.png"
DT, STEPS = 2e-3, 600
PERIOD, TENSION = 0.4, 0.25  # s, N: each tendon's pull comes once a period
BETWEEN_SHAPES = 15  # steps
COLOURS = {"x": "#0072b2", "y": "#d55e00", "z": "#009e73"}


def motion():
    """The robot hangs; tendon i is pulled by tau sin^2 over a half period, one after another."""
    scene = sr.hybrid_robot(gravity=jnp.array([0.0, 0.0, 9.81]))
    t = DT * np.arange(1, STEPS + 1)[:, None]
    phase = 2 * np.pi * (t / PERIOD - np.arange(3) / 3)
    tensions = TENSION * np.maximum(np.sin(phase), 0.0) ** 2 * (t > PERIOD * np.arange(3) / 3)
    return sr.simulate(scene, DT, tensions, initial=sr.solve_static(scene, (0.0, 0.0, 0.0)))


def draw(trajectory):
    ts, shapes = np.asarray(trajectory.ts), 1e3 * np.asarray(trajectory.positions)
    tip = shapes[:, -1]
    figure = plt.figure(figsize=(9.5, 4))
    shade = matplotlib.cm.ScalarMappable(plt.Normalize(0, ts[-1]), "viridis")

    space = figure.add_axes([0.0, 0.02, 0.44, 0.98], projection="3d")
    for k in range(0, len(ts), BETWEEN_SHAPES):
        x, y, z = shapes[k].T
        space.plot(x, y, z, color=shade.to_rgba(ts[k]), lw=1.6)
    space.plot(*tip.T, color="black", lw=0.8)
    space.set(xlabel="x [mm]", ylabel="y [mm]", zlabel="z [mm]")
    space.set(xlim=(-60, 60), ylim=(-60, 60), zlim=(105, 0), box_aspect=(120, 120, 105))
    space.set(xticks=(-50, 0, 50), yticks=(-50, 0, 50), zticks=(0, 50, 100))
    space.zaxis.labelpad = 3
    space.view_init(elev=16, azim=-60)
    bar = figure.add_axes([0.53, 0.25, 0.012, 0.5])
    figure.colorbar(shade, cax=bar, label="time [s]")

    place = {"left": 0.68, "right": 0.985, "top": 0.96, "bottom": 0.14, "hspace": 0.18}
    rows = figure.subplots(3, 1, sharex=True, gridspec_kw=place)
    for row, (name, colour), values in zip(rows, COLOURS.items(), tip.T, strict=True):
        row.plot(ts, values, color=colour)
        row.set_ylabel(f"tip {name} [mm]")
        row.grid(alpha=0.3)
    rows[-1].set(xlabel="time [s]", xticks=(0, 0.3, 0.6, 0.9, 1.2))
    figure.align_ylabels(rows)
    return figure


if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    matplotlib.use("agg")
    FIGURE.parent.mkdir(exist_ok=True)
    draw(motion()).savefig(FIGURE, dpi=130)
    print(FIGURE)
