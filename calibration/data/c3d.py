"""Motion capture files (C3D), as written by Qualisys, Vicon, OptiTrack and others.

A C3D knows its markers, its rate and its unit. It does not know the rod: where the clamp is,
which axis runs along the rod, and when the rod was let go. This reader takes

- the mean of the tip markers as the tip or, if they are said to be on one body, its pose,
- the file's axes as the scene's, or as `axes` maps them,
- the rest at the beginning of the recording, the rod being held straight, as the place of the
  scene's straight tip. Only displacements are therefore measured.
"""

from os import PathLike
from pathlib import Path

import numpy as np

from calibration.data.c3d_points import Points, length_unit, read_points
from calibration.data.frames import axes_matrix, check_one_body, rest_samples, straight_tip
from calibration.data.plausible import Source, check_reach
from calibration.data.quantities import TURN
from calibration.data.recording import Recording, RecordingError
from calibration.data.rigid import body_pose


def read_c3d(
    path: str | PathLike,
    scene,
    *,
    tip_markers: str = "tip",
    base_markers: str | None = "base",
    axes: str = "x,y,z",
    tip_body: bool = False,
) -> Recording:
    """The recording in the C3D file `path`, for `scene`. Time 0 is the file's first frame.

    - `tip_markers`, `base_markers`: how the markers' labels begin; upper and lower case are
      the same, several beginnings are separated by commas. With base markers in the file, the
      tip is measured from their mean, so that a clamp that shifts is not taken for a rod that
      bends; `None` takes the tip alone.
    - `axes`: which axes of the file are the scene's x, y and z, such as "-y,x,z".
    - `tip_body`: the tip markers, three or more, are on one body. Its pose is fitted to those that
      a frame has; how it is turned is a measurement, too, `others["tip_attitude"]`, by which a
      middle that is off the axis can be told (parameter sensor_offset).

    A frame in which any of these markers is missing, or at exactly (0, 0, 0), is a missing sample;
    of a body, one that has fewer than three.

    Raises `RecordingError` if ezc3d is not installed, the file cannot be read, markers, unit
    or rate are not there, two markers have one label or are not on one body, or the recording does
    not begin with the rod at rest.
    """
    if scene is None:
        raise RecordingError(f"{path}: a C3D does not say where the clamp is: give the scene")
    rotation = axes_matrix(axes, f"{path}: ")
    file = read_points(path)
    tips, bases, notes = _chosen(path, file, tip_markers, base_markers)
    if file.rate is None:
        raise RecordingError(f"{path}: POINT:RATE is missing, expected a number above 0 [Hz]")
    points = length_unit(path, file.unit) * file.positions @ rotation.T
    for markers in (tips, bases):
        check_one_body(path, points[:, markers], [file.labels[j] for j in markers], scene)
    tip, turned = np.mean(points[:, tips], axis=1), {}
    if tip_body:
        seen = np.all(np.isfinite(tip), axis=1)
        rest = rest_samples(tip[seen], path) if np.any(seen) else 0
        tip, turns, note = body_pose(points[:, tips], slice(0, rest), f"{path}: ")
        turned = {f"tip{TURN}": _from_base(scene, turns)}
        notes.append(note)
    displacement, rest, placed = _from_rest(path, points, tip, tips, bases, file.labels)
    recording = Recording(
        times=np.arange(len(points)) / file.rate,
        tensions=None,
        pressures=None,
        tip_positions=displacement + straight_tip(scene),
        name=Path(path).stem,
        source=str(path),
        origin_known=False,
        placed=straight_tip(scene) - rest,
        notes=(*notes, *placed, *file.notes),
        others=turned,
    )
    source = Source(
        [f"frame {k + 1}" for k in range(len(points))],
        f"markers {_named(file.labels, tips)}",
        unit="POINT:UNITS",
        origin=None,
    )
    check_reach(recording, scene, source)
    return recording


def _chosen(
    path, file: Points, tip_markers: str, base_markers: str | None
) -> tuple[list[int], list[int], list[str]]:
    """The markers of the tip and of the clamp, and notes. Raises `RecordingError` without a tip."""
    tips, notes = _find(path, file, tip_markers, "tip_markers")
    if not tips:
        others = f" (not positions: {', '.join(file.kinds)})" if file.kinds else ""
        raise RecordingError(
            f"{path}: no marker's label begins with {tip_markers!r} (tip_markers); the file has "
            f"{', '.join(x for x in file.labels if x not in file.kinds)}{others}"
        )
    bases: list[int] = []
    if base_markers is not None:
        bases, others = _find(path, file, base_markers, "base_markers")
        notes += others
        # Always at the origin: it was never seen, or marks it. Either way it does not move.
        bases = [j for j in bases if np.any(file.positions[:, j])]
    return tips, bases, notes


def _from_base(scene, turns: np.ndarray) -> np.ndarray:
    """Attitudes of a tip that has turned so from where the straight rod has it, (frames, 4)."""
    base = getattr(scene, "base_quaternion", None)
    if base is None:
        return turns
    w, r = np.asarray(base, dtype=float)[0], np.asarray(base, dtype=float)[1:]
    u, v = turns[:, :1], turns[:, 1:]
    return np.concatenate([u * w - v @ r[:, None], u * r + w * v + np.cross(v, r)], axis=1)


def _from_rest(path, points: np.ndarray, tip: np.ndarray, tips: list[int], bases, labels):
    """The tip's displacement from its rest, seen from the clamp, (frames, 3) [m], where that rest
    is, (3,), and notes."""
    clamp = np.mean(points[:, bases], axis=1) if bases else np.zeros_like(tip)
    seen = np.all(np.isfinite(tip + clamp), axis=1)
    if not np.any(seen):
        raise RecordingError(
            f"{path}: no frame has all the markers {_named(labels, tips + bases)}; choose markers "
            "that were seen with tip_markers and base_markers"
        )
    # The tip alone tells the rest: base markers move least and their noise would hide it.
    rest = rest_samples(tip[seen], path)
    clamp_at, tip_at = (np.median(x[seen][:rest], axis=0) for x in (clamp, tip))
    clamp_moved = clamp - clamp_at
    notes = [
        f"tip = middle of the markers {_named(labels, tips)}",
        f"origin: the median of the tip over {rest} samples at rest is the scene's straight tip",
    ]
    if bases:
        largest = 1e3 * np.nanmax(np.linalg.norm(clamp_moved, axis=1))
        notes.append(
            f"movement of the clamp, up to {largest:.2g} mm, subtracted (mean of the markers "
            f"{_named(labels, bases)})"
        )
    return tip - tip_at - clamp_moved, tip_at - clamp_at, notes


def _named(labels, markers: list[int]) -> str:
    return ", ".join(labels[j] for j in markers)


def _find(path, file: Points, beginnings: str, option: str) -> tuple[list[int], list[str]]:
    """The positions whose label begins with one of `beginnings`, and what is left out.

    A subject's name before ':' is ignored unless it is given. Raises `RecordingError` if labels
    of two subjects begin so, or two markers have one label.
    """
    wanted = tuple(b.strip().lower() for b in beginnings.split(",") if b.strip())
    chosen, left_out = [], []
    for j, label in enumerate(file.labels):
        name = label.split(":")[-1].strip().lower()
        if name.startswith(wanted) or label.lower().startswith(
            tuple(w for w in wanted if ":" in w)
        ):
            (left_out if label in file.kinds else chosen).append(j)
    labels = [file.labels[j] for j in chosen]
    for label in labels:
        if label in file.twice:
            raise RecordingError(
                f"{path}: two markers are called {label!r}, and both were seen: rename one in the "
                f"software that exported the file, or choose others with {option}"
            )
    subjects = {
        label.rpartition(":")[0] for label in labels if not label.lower().startswith(wanted)
    }
    if len(subjects) > 1:
        raise RecordingError(
            f"{path}: {', '.join(labels)} are of {len(subjects)} subjects; choose one with its "
            f"name and colon, {option} = {labels[0]!r}"
        )
    names = ", ".join(file.labels[j] for j in left_out)
    return chosen, [f"{names}: no positions, left out"] if left_out else []
