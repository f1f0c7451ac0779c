"""The README's drawing of a robot with its tendons and chamber, and a film of it.

python benchmarks/readme_film.py
"""

import dataclasses
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

import softrod_jax as sr
from softrod_jax import pictures

FIGURES = Path(__file__).parent / "figures"
DT, STEPS = 5e-3, 400
TURN, TENSION, PRESSURE = 0.8, 0.3, 3e4  # s, N, Pa


def robot():
    """The paper's robot, hanging, with 2 g at its tip."""
    scene = sr.hybrid_robot(gravity=jnp.array([0.0, 0.0, 9.81]))
    return dataclasses.replace(scene, payload=sr.Payload(2e-3))


def inputs():
    """Tendons pulled in turn, ever harder over the first turn, and two breaths of the chamber."""
    t = DT * np.arange(1, STEPS + 1)[:, None]
    phase = 2 * np.pi * (t / TURN - np.arange(3) / 3)
    tensions = TENSION * np.clip(np.cos(phase), 0, None) * np.clip(t / TURN, 0, 1)
    pressures = PRESSURE * np.sin(np.pi * t / (DT * STEPS) * 2) ** 2
    return tensions, pressures


def main():
    scene = robot()
    tensions, pressures = (0.3, 0.0, 0.12), (3e4,)
    still = pictures.picture(
        scene, sr.solve_static(scene, tensions, pressures), tensions, pressures
    )
    still.savefig(FIGURES / "robot.png", dpi=130)
    start = sr.solve_static(scene, np.zeros(3), np.zeros(1))
    pull, air = inputs()
    motion = sr.simulate(scene, DT, pull, air, initial=start)
    pictures.animate(scene, motion, FIGURES / "robot.gif", pull, air, size=(400, 400))


if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    main()
