"""Motion capture files (C3D), as written by Qualisys, Vicon, OptiTrack and others.

A C3D knows its markers, its rate and its unit. It does not know the rod: where the clamp is,
which axis runs along the rod, and when the rod was let go. This reader takes

- the mean of the tip markers as the tip,
- the file's axes as the scene's, or as `axes` maps them,
- the rest at the beginning of the recording, the rod being held straight, as the place of the
  scene's straight tip. Only displacements are therefore measured.
"""

import subprocess
import sys
from os import PathLike
from pathlib import Path

import numpy as np

from calibration.frames import axes_matrix, rest_samples, straight_tip
from calibration.recording import Recording, RecordingError, check_reach

_METRES = {"m": 1.0, "cm": 1e-2, "mm": 1e-3}


def read_c3d(
    path: str | PathLike,
    scene,
    *,
    tip_markers: str = "tip",
    base_markers: str | None = "base",
    axes: str = "x,y,z",
) -> Recording:
    """The recording in the C3D file `path`, for `scene`. Time 0 is the file's first frame.

    - `tip_markers`, `base_markers`: how the markers' labels begin; upper and lower case are
      the same, several beginnings are separated by commas. With base markers in the file, the
      tip is measured from their mean, so that a clamp that shifts is not taken for a rod that
      bends; `None` takes the tip alone.
    - `axes`: which axes of the file are the scene's x, y and z, such as "-y,x,z".

    A frame in which any of these markers is missing is a missing sample.

    Raises `RecordingError` if ezc3d is not installed, the file cannot be read, markers, unit
    or rate are not there, or the recording does not begin with the rod at rest.
    """
    if scene is None:
        raise RecordingError(f"{path}: a C3D does not say where the clamp is: give the scene")
    rotation = axes_matrix(axes, f"{path}: ")
    points, labels, unit, rate, promised = read_points(path)
    tip_columns = _find(labels, tip_markers)
    if not tip_columns:
        raise RecordingError(
            f"{path}: no marker's label begins with {tip_markers!r} (tip_markers); the file has "
            f"{', '.join(labels)}"
        )
    base_columns = [] if base_markers is None else _find(labels, base_markers)
    points = unit * points @ rotation.T
    tip = np.mean(points[:, tip_columns], axis=1)
    clamp = np.mean(points[:, base_columns], axis=1) if base_columns else np.zeros_like(tip)
    known = np.all(np.isfinite(tip + clamp), axis=1)
    if not np.any(known):
        raise RecordingError(
            f"{path}: no frame has all the markers "
            f"{', '.join(labels[j] for j in tip_columns + base_columns)}; choose markers that "
            "were seen with tip_markers and base_markers"
        )
    # The tip alone tells the rest: base markers move least and their noise would hide it.
    rest = rest_samples(tip[known], path)
    clamp_moved = clamp - np.median(clamp[known][:rest], axis=0)
    tip = tip - np.median(tip[known][:rest], axis=0) - clamp_moved
    notes = [
        f"tip = mean of the markers {', '.join(labels[j] for j in tip_columns)}",
        f"origin: the median of the tip over {rest} samples at rest is the scene's straight tip",
    ]
    if len(points) < promised:
        notes.append(f"the file ends early: {len(points)} of {promised} frames")
    if base_columns:
        largest = 1e3 * np.nanmax(np.linalg.norm(clamp_moved, axis=1))
        notes.append(
            f"movement of the clamp, up to {largest:.2g} mm, subtracted (mean of the markers "
            f"{', '.join(labels[j] for j in base_columns)})"
        )
    recording = Recording(
        times=np.arange(len(tip)) / rate,
        tensions=None,
        pressures=None,
        tip_positions=tip + straight_tip(scene),
        name=Path(path).stem,
        source=str(path),
        origin_known=False,
        notes=tuple(notes),
    )
    check_reach(recording, scene, [f"frame {k + 1}" for k in range(len(tip))])
    return recording


def read_points(path) -> tuple[np.ndarray, list[str], float, float, int]:
    """Markers (frames, markers, 3), labels, unit [m], rate [Hz] and the frames promised.

    Markers are NaN where missing.
    """
    try:
        import ezc3d
    except ImportError:
        raise RecordingError(
            f"{path}: reading C3D files needs ezc3d: pip install 'softrod_jax[c3d]'"
        ) from None
    try:
        head = Path(path).read_bytes()[:10]
    except (OSError, ValueError) as e:
        reason = getattr(e, "strerror", None) or e
        raise RecordingError(f"{path}: cannot read the recording: {reason}") from None
    if len(head) < 10 or head[1] != 0x50:
        raise RecordingError(f"{path}: not a C3D file (its second byte is not 0x50)")
    _try_apart(path)
    try:
        file = ezc3d.c3d(str(path))
        points = np.array(file["data"]["points"][:3]).transpose(2, 1, 0)
        residuals = file["data"]["meta_points"]["residuals"][0].T
        parameters = file["parameters"]["POINT"]
        labels = [label.strip() for label in parameters["LABELS"]["value"]]
    except Exception as e:  # ezc3d raises whatever its C++ throws
        raise RecordingError(f"{path}: not a readable C3D file: {e}") from None
    if not len(points):
        raise RecordingError(f"{path}: holds no frames")
    points[residuals < 0] = np.nan
    # ezc3d says nothing of a file that was cut short, and forgets what its header promised.
    first, last = (int.from_bytes(head[i : i + 2], "little") for i in (6, 8))
    return points, labels, _unit(parameters, path), _rate(parameters, path), last - first + 1


def _try_apart(path) -> None:
    """Read the file in a process of its own first: ezc3d dies of some corrupted ones."""
    program = "import sys, ezc3d\ntry: ezc3d.c3d(sys.argv[1])\nexcept Exception: pass"
    done = subprocess.run([sys.executable, "-c", program, str(path)], capture_output=True)
    if done.returncode < 0 or done.returncode > 255:  # by a signal; Windows: by an exception
        raise RecordingError(f"{path}: ezc3d crashes on it: the file is corrupted; export it again")


def _unit(parameters, path) -> float:
    values = parameters["UNITS"]["value"] if "UNITS" in parameters else []
    name = values[0].strip().lower() if len(values) else ""
    if name not in _METRES:
        raise RecordingError(
            f"{path}: POINT:UNITS is {name!r}, expected one of {', '.join(_METRES)}; set it in "
            "the software that exported the file"
        )
    return _METRES[name]


def _rate(parameters, path) -> float:
    values = parameters["RATE"]["value"] if "RATE" in parameters else []
    rate = float(values[0]) if len(values) else 0.0
    if not (np.isfinite(rate) and rate > 0):
        raise RecordingError(f"{path}: POINT:RATE is {rate:g}, expected a number above 0 [Hz]")
    return rate


def _find(labels: list[str], beginnings: str) -> list[int]:
    """The labels that begin with one of `beginnings`; a subject's name before ':' is ignored."""
    wanted = tuple(b.strip().lower() for b in beginnings.split(",") if b.strip())
    return [j for j, x in enumerate(labels) if x.split(":")[-1].strip().lower().startswith(wanted)]
