"""Fits to postures that others have published: what is left, and what is predicted unseen.

    python benchmarks/postures.py [tdcr=FOLDER] [tentacle=FOLDER] [--folds 5] [--every 1]

- `tdcr`: `v4_train.csv` of https://github.com/ContinuumRoboticsLab/opencr-mujoco (data/sysid), a
  robot of three segments and nine servos, 1,620 postures; each servo's pull in mm, the tip in mm.
- `tentacle`: `postures.csv`, eight equilibria of the tapered tentacle of
  https://github.com/tud-phi/soromox (paper_results/secVa_system_identification): tensions, and four
  markers [m].

Patterns of commands are kept aside in so many parts, one after the other. `--every` takes every
n-th row only.
"""

import argparse
import csv
import os
import time
from pathlib import Path

import jax

jax.config.update("jax_enable_x64", True)
jax.config.update("jax_num_cpu_devices", os.cpu_count() or 1)

import numpy as np
from report import machine

import softrod_jax as sr
from calibration.postures.data import Postures
from calibration.postures.fitting import calibrate_postures, prepared_model
from softrod_jax.scene.inputs import Inputs
from softrod_jax.scene.scene import as_arrays

FRAME = ("clamp_shift", "clamp_rotation")
LENGTHS, TURNED = (0.060, 0.0625, 0.064), (-3.06, -2.56, -2.05)
GRID = sr.Collocation(intervals=9)


def servo_robot(gravity=None) -> sr.Scene:
    """As its authors state it; stiffness and pretension of the tendons are a guess."""
    ends = np.cumsum(LENGTHS)
    angle = np.add.outer(TURNED, 2 * np.pi * np.arange(3) / 3).ravel()
    tendons = sr.Tendons(
        4.5e-3 * np.stack([np.cos(angle), np.sin(angle)], 1),
        ends_at=(*np.repeat(ends[:2], 3), None, None, None),
        control="length",
        guided="disks",
        stiffness=(2000.0,) * 9,
        pretension=(0.3,) * 9,
    )
    wire = sr.Circle(5e-4)
    return as_arrays(
        sr.Scene(
            segments=tuple(sr.Segment(length=x, section=wire, intervals=3) for x in LENGTHS),
            young_modulus=50e9,
            poisson_ratio=0.3,
            linear_density=0.05 / ends[-1],
            inextensible=True,
            gravity=gravity,
            tendons=tendons,
            markers=(sr.Marker("beyond", ends[-1], [0.0, 0.0, 8e-3]),),
        )
    )


def servo_postures(folder: Path, every: int) -> Postures:
    """The log, in SI units."""
    rows = list(csv.DictReader((folder / "v4_train.csv").open(encoding="utf-8")))[::every]
    # Columns are in the order of the tendons, and each has its servo's number.
    servos = [name for name in rows[0] if name.startswith("servo_")]
    table = lambda names: 1e-3 * np.array([[float(row[n]) for n in names] for row in rows])
    return Postures(
        Inputs(pulls=table(servos)),
        {"beyond": table(("tip_x", "tip_y", "tip_z"))},
        noise={"beyond": 5e-3},
        trials=tuple(row["pattern_label"] for row in rows),
    )


def each_segment(key: str) -> tuple[str, ...]:
    """A number for the tendons of each segment, as paths."""
    return tuple("=".join(f"tendons[{3 * k + j}].{key}" for j in range(3)) for k in range(3))


def servos(folder: Path, folds: int, every: int) -> None:
    """The fits of the robot with servos, from few numbers to many."""
    postures = servo_postures(folder, every)
    own = (*FRAME, *each_segment("stiffness"), *each_segment("pretension"))
    model = prepared_model(servo_robot(), postures, own, GRID)
    for _ in range(3):
        begun = time.perf_counter()
        model.evaluate(np.zeros(len(model.parameters)))
        last = time.perf_counter() - begun
    print(f"{postures.rows} postures, {len(model.parameters)} derivatives: {last:.2f} s")
    weighs = servo_robot([0.0, 0.0, -0.5])
    offsets, gravity = (*own, "pull_offset"), tuple(f"gravity[{i}]" for i in range(3))
    places = (*offsets, "pull_gain_each", "tendon_position")
    told("one of each", servo_robot(), postures, (*FRAME, "tendon_stiffness", "pretension"))
    told("by segment", servo_robot(), postures, own, folds)
    told("and offsets of servos", servo_robot(), postures, offsets)
    told("and gravity", weighs, postures, (*offsets, *gravity))
    told("offsets, gains and places", servo_robot(), postures, places)


def tentacle_robot() -> sr.Scene:
    """Hanging, with a taper that changes where its two tendons end."""
    end, angle = 0.305, np.radians([30.0, 150.0])
    at = lambda s: (0.0114 - 0.0295 * s) * np.stack([np.cos(angle), np.sin(angle)], 1)
    radii = (15.41e-3, 6.42e-3, 4.80e-3)
    parts = zip((end, 0.36 - end), radii, radii[1:])
    places = {"m1": (0.1291, 25e-3, 0), "m2": (0.2195, -21e-3, 0), "m3": (0.28, 20e-3, 0)}
    places["m4"] = (0.36, 0, 8e-3)
    return as_arrays(
        sr.Scene(
            segments=tuple(sr.Segment(a, sr.Circle(r), sr.Circle(end)) for a, r, end in parts),
            young_modulus=3.2e5,
            poisson_ratio=0.45,
            density=1318.0,
            gravity=[0.0, 0.0, 9.81],
            tendons=sr.Tendons(
                np.zeros((2, 2)),
                paths=tuple(sr.Line(a, b) for a, b in zip(at(0.0), at(end))),
                ends_at=(end, end),
            ),
            markers=tuple(sr.Marker(k, s, [0.0, y, z]) for k, (s, y, z) in places.items()),
        )
    )


def tentacle(folder: Path) -> None:
    """The fits of the tentacle."""
    rows = list(csv.DictReader((folder / "postures.csv").open(encoding="utf-8")))
    table = lambda names: np.array([[float(row[n]) for n in names] for row in rows])
    columns = {"m1": "m1", "m2": "m2", "m3": "m3", "m4": "tip"}
    positions = {k: table([f"{c}_{a}_m" for a in "xyz"]) for k, c in columns.items()}
    postures = Postures(Inputs(tensions=table(["tau1_N", "tau2_N"])), positions)
    for name, frame in (("modulus and density", ()), ("and the cameras' frame", FRAME)):
        told(name, tentacle_robot(), postures, ("young_modulus", "density", *frame))


def told(name: str, scene: sr.Scene, postures: Postures, fit, folds: int | None = None) -> None:
    """Fit, and print what is left."""
    found = calibrate_postures(scene, postures, fit=fit, folds=folds, method=GRID)
    apart = np.linalg.norm(found.simulated - found.measured, axis=-1)
    unseen = "" if found.held_out_m is None else f", unseen {1e3 * found.held_out_m:.2f} mm rms"
    known = sum(e.identifiable for e in found.parameters.values())
    print(
        f"{name}: {len(found.parameters)} numbers, {known} identified; {1e3 * found.rmse_m:.2f} mm "
        f"rms, mean {1e3 * np.nanmean(apart):.2f}, worst {1e3 * np.nanmax(apart):.1f}{unseen}; "
        f"{found.unsolved} rows unsolved, {found.evaluations} evaluations, {found.seconds:.0f} s",
        flush=True,
    )


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("folders", nargs="+", metavar="NAME=FOLDER")
    parser.add_argument("--folds", type=int, default=5)
    parser.add_argument("--every", type=int, default=1)
    args = parser.parse_args()
    print(machine())
    for text in args.folders:
        kind, _, place = text.partition("=")
        if kind == "tdcr":
            servos(Path(place), args.folds, args.every)
        else:
            tentacle(Path(place))
