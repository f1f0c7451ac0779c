"""A hose-like trunk that is let go by hand, and that motors drive: fits, and what is predicted.

    python benchmarks/trunk.py FOLDER [held] [releases] [relaxing] [driven] [motors] [commands]

`FOLDER`: `manual_decay_200g.csv`, `observations_controlled_3.csv` and
`control_inputs_controlled_3.csv` of https://github.com/StanfordASL/trunk-stack: three discs on a
hose, seen at 100 Hz by cameras whose y is up. The files are read as they are, by mappings.

- `held`: how far the discs are from those of a rod that a force and a moment at the tip hold, and
  how far apart the tip comes to rest.
- `releases`: six of eight releases by hand from poses anywhere, 200 g at the tip, each with the
  force and the moment of the hand; the two others are predicted from where they were held.
  `relaxing`: with a branch of the stiffness that relaxes besides the viscous damping.
- `driven`: six motors lead the tip around slowly, so that a sample is an equilibrium. Quarters of
  the ten seconds are kept aside and predicted by the three others.
- `motors`: six motors, each of which pulls one tendon and pays out the one opposite; the first 3 s
  are fitted and 10 s predicted, by the angles that the motors report, or by those that they were
  told (`commands`, in a file of their own) behind a lag.

Stiffness, damping and masses of hose and discs are not stated; nor are the tendons' places, of
which the directions follow from the paths that the motors were made to follow, in one turn of which
all three discs move the same way.
"""

import argparse
import tempfile
from dataclasses import replace
from pathlib import Path

import jax

jax.config.update("jax_enable_x64", True)

import jax.numpy as jnp
import numpy as np
from report import machine

import softrod_jax as sr
from calibration import calibrate, load_recording, load_recordings
from calibration.experiment.hand import HAND, hand_loads
from calibration.experiment.setup import Setup
from calibration.postures.data import Postures
from calibration.postures.fitting import calibrate_postures
from softrod_jax.scene.inputs import Inputs
from softrod_jax.scene.scene import as_arrays

ENDS = (0.107, 0.204, 0.3235)  # m, of the discs, by how they hang
DISC = 0.04  # kg, a guess
SEEN = """
[time]
rate = 100.0
[tip]
columns = ["x3", "y3", "z3"]
axes = "x,z,-y"
origin = [0.1018, 0.0, 0.1062]
[[measured]]
key = "third_position"
columns = ["x1", "y1", "z1"]
[[measured]]
key = "two_thirds_position"
columns = ["x2", "y2", "z2"]
"""
TRIALS = """
[trials]
column = "ID"
"""
# Where a motor that turns forward bends the trunk to [degrees about z], and which disc.
MOTORS = {1: (-15, 1), 2: (225, 2), 3: (285, 0), 4: (135, 2), 5: (195, 0), 6: (75, 1)}
OFFSET, PULLEY = 0.025, 0.04  # m, guesses; a gain of the pulls stands for both
DT = 0.02


def hose(stiffness: float, payload: float, **others) -> dict:
    """What releases and motions by motors have in common."""
    bending = sr.Stiffness(bending=[stiffness] * 2, torsion=stiffness, axial=1e4, shear=[1e4, 1e4])
    return {
        "stiffness": bending,
        "linear_density": 0.25,
        "inextensible": True,
        "gravity": [0.0, 0.0, 9.81],
        "payload": sr.Payload(payload),
        "masses": tuple(sr.Mass(at, DISC) for at in ENDS[:2]),
        "markers": (sr.Marker("third", ENDS[0]), sr.Marker("two_thirds", ENDS[1])),
        **others,
    }


def let_go(relaxing: bool) -> sr.Scene:
    """The trunk with a weight of 200 g; tendons are part of its stiffness."""
    stiffness = 0.3 if relaxing else 0.12
    damping = 0.02 * stiffness
    branch = {"relaxation": np.array([[0.6, 0.15]])} if relaxing else {}
    own = hose(stiffness, 0.2 + DISC + 0.01, bending_damping=damping, **branch)
    return as_arrays(sr.Scene(length=ENDS[-1], section=sr.Circle(0.015), **own))


def driven(stiffness: float = 0.15) -> sr.Scene:
    """The trunk with its twelve tendons, each held by a spring."""
    pairs = [MOTORS[m] for m in sorted(MOTORS) for _ in (0, 1)]
    angles = [np.radians(a + 180 * (k % 2)) for k, (a, _) in enumerate(pairs)]
    tendons = sr.Tendons(
        OFFSET * np.stack([np.cos(angles), np.sin(angles)], 1),
        ends_at=tuple(ENDS[disc] if disc < 2 else None for _, disc in pairs),
        control="length",
        guided="disks",
        stiffness=(1500.0,) * 12,
        pretension=(25.0,) * 12,
    )
    parts = np.diff([0.0, *ENDS])
    return as_arrays(
        sr.Scene(
            segments=tuple(sr.Segment(float(x), sr.Circle(0.015), intervals=2) for x in parts),
            tendons=tendons,
            **hose(stiffness, 0.06, bending_damping=0.03 * stiffness),
        )
    )


def mapping(text: str) -> Path:
    path = Path(tempfile.mkdtemp()) / "trunk.map.toml"
    path.write_text(text, encoding="utf-8")
    return path


def pulls(folder: Path, commands: bool) -> str:
    """The inputs: what motors report, in the file itself, or what they were told."""
    text = ""
    for motor in sorted(MOTORS):
        column = f'column = "phi{motor}"'
        if commands:
            place = (folder / "control_inputs_controlled_3.csv").resolve()
            column = f'column = "u{motor}"\nfile = "{place}"\nbefore = 0.0'
        for sign in (1, -1):
            text += f"[[pulls]]\n{column}\nscale = {sign * PULLEY * np.pi / 180}\n"
    return text


def held(folder: Path) -> None:
    """Each release before it begins, and all of them when they are over."""
    scene = let_go(False)
    path = folder / "manual_decay_200g.csv"
    recordings = load_recordings(path, scene, mapping=mapping(SEEN + TRIALS))
    for r in recordings:
        loads = np.array(list(hand_loads(Setup(scene), r, HAND).values()))
        load = sr.TipLoad(jnp.asarray(loads[:3]), jnp.asarray(loads[3:]))
        still = sr.solve_static(replace(scene, tip_load=load), method=sr.Collocation(4))
        apart = [
            np.linalg.norm(still.markers[name].position - seen[0])
            for name, seen in (
                ("third", r.others["third_position"]),
                ("two_thirds", r.others["two_thirds_position"]),
                ("tip", r.tip_positions),
            )
        ]
        told = ", ".join(f"{1e3 * x:.1f}" for x in apart)
        print(f"held {r.name}: discs off by {told} mm; {np.round(loads, 2)} N, N m")
    ends = np.array([np.nanmean(r.tip_positions[-20:], axis=0) for r in recordings])
    pairs = np.linalg.norm(ends[:, None] - ends, axis=-1)
    print(f"at rest in the end up to {1e3 * np.max(pairs):.0f} mm apart")


def releases(folder: Path, relaxing: bool) -> None:
    """Six releases fitted, two predicted."""
    scene = let_go(relaxing)
    path = folder / "manual_decay_200g.csv"
    recordings = load_recordings(path, scene, mapping=mapping(SEEN + TRIALS))
    extra = ("relaxation_part", "relaxation_time") if relaxing else ()
    fit = ("stiffness_bending", "bending_damping", *extra, "clamp_rotation_x", "clamp_rotation_y")
    found = calibrate(
        scene,
        recordings[:6],
        held_out=recordings[6:],
        fit=(*fit, "hand_force", "hand_moment"),
        dt=DT,
        method=sr.Collocation(4, max_error=0.1),
        checks=False,
        progress=False,
        max_iterations=25,
    )
    told("releases" + (", a branch relaxes" if relaxing else ""), found)


def postures(folder: Path, every: int = 25) -> None:
    """Every so-many-th sample of the motion by motors, as an equilibrium.

    The tendons hold the hose so well that its own stiffness is not told: a soft one it is.
    """
    scene, path = driven(2e-3), folder / "observations_controlled_3.csv"
    r = load_recording(path, scene, mapping=mapping(SEEN + pulls(folder, commands=False)))
    assert r.pulls is not None
    rows = slice(every, None, every)
    seen = {name: r.others[f"{name}_position"][rows] for name in ("third", "two_thirds")}
    seen["tip"] = r.tip_positions[rows]
    quarters = tuple(str(int(t // 2.5)) for t in r.times[rows])
    noise = dict.fromkeys(seen, 5e-3)
    given = Postures(Inputs(pulls=r.pulls[rows]), seen, noise=noise, trials=quarters)
    size = np.nanmax(np.linalg.norm(seen["tip"] - np.nanmean(seen["tip"], axis=0), axis=1))
    for gain in ("pull_gain", "pull_gain_each"):
        found = calibrate_postures(
            scene,
            given,
            fit=(gain, "clamp_shift", "clamp_rotation"),
            folds=4,
            method=sr.Collocation(6, max_error=0.3),
        )
        off = ", ".join(f"{name} {1e3 * x:.1f}" for name, x in found.rmse_by_marker.items())
        assert found.held_out_m is not None
        print(
            f"driven, {gain}: {len(found.parameters)} numbers, {found.evaluations} evaluations, "
            f"{found.seconds:.0f} s; mm rms: {off}, of {1e3 * size:.0f}; all markers "
            f"{1e3 * found.rmse_m:.1f}, kept aside {1e3 * found.held_out_m:.1f}",
            flush=True,
        )


def motors(folder: Path, commands: bool) -> None:
    """The first 3 s fitted, all 10 s predicted."""
    scene, path = driven(), folder / "observations_controlled_3.csv"
    whole = load_recording(path, scene, mapping=mapping(SEEN + pulls(folder, commands)))
    fit = ("stiffness_bending", "bending_damping", "tendon_stiffness", "pull_gain", "pull_lag")
    found = calibrate(
        scene,
        [replace(whole.window(-1.0, 3.0), name="3 s")],
        held_out=[replace(whole, name="10 s")],
        fit=(*fit, "camera_rotation", "camera_shift"),
        dt=DT,
        method=sr.Collocation(6, max_error=0.3),
        time_offset=False,
        checks=False,
        progress=False,
        max_iterations=15,
    )
    told("motors, as commanded" if commands else "motors, as reported", found)


def told(name: str, found) -> None:
    """What is left, and what was found."""
    print(f"{name}: {found.result}, {found.seconds:.0f} s")
    for k, r in enumerate((*found.recordings, *found.held_out)):
        size = np.nanmax(np.linalg.norm(r.measured - r.measured[-1], axis=1))
        discs = ", ".join(f"{1e3 * x.rms:.1f}" for x in r.others.values())
        kept = "" if k < len(found.recordings) else ", predicted"
        print(
            f"  {r.name}{kept}: tip {1e3 * r.rmse:.1f} mm rms of {1e3 * size:.0f}, "
            f"discs {discs} mm a coordinate"
        )
    for label, e in found.parameters.items():
        if not label.startswith("hand"):
            low, high = (None if x is None else np.round(x, 5) for x in e.ci95)
            print(f"  {label}: {np.round(e.value, 5)} {e.unit}, {low} to {high}, {e.verdict}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("folder", type=Path)
    parser.add_argument("which", nargs="*", default=["releases", "motors"])
    args = parser.parse_args()
    print(machine())
    for which in args.which:
        if which == "held":
            held(args.folder)
        elif which == "driven":
            postures(args.folder)
        elif which in ("releases", "relaxing"):
            releases(args.folder, which == "relaxing")
        else:
            motors(args.folder, which == "commands")
