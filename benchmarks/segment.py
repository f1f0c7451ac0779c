"""One fit of a pneumatic segment at three pressures: lag of its valve, growth of its thrust.

    python benchmarks/segment.py FOLDER

`FOLDER`: `100mbar_V3.c3d`, `200mbar_V3.c3d` and `300mbar_V3.c3d` of
https://github.com/srl-ethz/diffPD_sim2real: one chamber is stepped to a pressure and vented, which
was not recorded; when it began is fitted to each recording. The segment hangs; what its section and
its chamber are is not said, so that modulus and thrust stand for them. All three were made with
one set-up: its frame is fitted once, with the place of the markers aside of the axis.
"""

import argparse
from dataclasses import replace
from pathlib import Path

import jax

jax.config.update("jax_enable_x64", True)

import numpy as np
from report import machine

import softrod_jax as sr
from calibration import calibrate, load_recording
from calibration.data.frames import in_one_frame
from softrod_jax.scene.scene import as_arrays

# When pressure rose and fell, by eye [s].
STEPS = {100: (0.57, 3.57), 200: (0.77, 3.77), 300: (1.55, 4.55)}
FRAME = ("camera_shift", "camera_rotation_z", "sensor_offset_x")
ROBOT = ("young_modulus", "damping_time", "chamber_area", "relaxation_part", "relaxation_time")
BETWEEN = ("pressure_lag", "pressure_gain")
BOUNDS = {"young_modulus": (1.7e5, 3e5), "damping_time": (3e-4, 1e-2)}


def segment() -> sr.Scene:
    """As far as it is known; the modulus is that of a rod that rings as seen."""
    return as_arrays(
        sr.Scene(
            length=0.102,
            section=sr.Circle(0.02),
            young_modulus=2.25e5,
            poisson_ratio=0.45,
            density=1070.0,
            gravity=[0.0, 0.0, 9.81],
            damping_time=2e-3,
            relaxation=np.array([[0.1, 1.0]]),
            chambers=sr.Chambers(np.array([1.6e-4]), np.array([[0.01, 0.0]])),
        )
    )


def recordings(folder: Path):
    """The three, in one frame, with the pressure that was commanded."""
    found = []
    for millibar, (on, off) in STEPS.items():
        path = folder / f"{millibar}mbar_V3.c3d"
        read = load_recording(path, segment(), axes="y,z,x", base_markers=None)
        on = (read.times >= on) & (read.times < off)
        pressures = np.where(on, 100.0 * millibar, 0.0)[:, None]
        found.append(replace(read, pressures=pressures, name=f"{millibar} mbar"))
    return in_one_frame(found, [])[0]


def told(name: str, fit) -> None:
    """Fit, and print what is left."""
    found = calibrate(
        segment(),
        recordings(args.folder),
        fit=fit,
        bounds={k: v for k, v in BOUNDS.items() if k in fit},
        checks=False,
        progress=False,
        dt=args.dt,
        method=sr.Collocation(args.intervals, max_error=0.1),
    )
    left = ", ".join(f"{k}: {1e3 * x:.2f}" for k, x in found.rmse_m.items())
    print(f"{name}: {left} mm rms; {found.result}, {found.seconds:.0f} s", flush=True)
    for label, e in found.parameters.items():
        low, high = e.ci95
        print(f"  {label}: {e.value} {e.unit}, {low} to {high}, {e.verdict}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("folder", type=Path)
    parser.add_argument("--dt", type=float, default=0.01)
    parser.add_argument("--intervals", type=int, default=3)
    parser.add_argument("--without", action="store_true", help="also without lag and gain")
    args = parser.parse_args()
    print(machine())
    told("with lag and gain", (*ROBOT, *BETWEEN, *FRAME))
    if args.without:
        told("without", (*ROBOT, *FRAME))
