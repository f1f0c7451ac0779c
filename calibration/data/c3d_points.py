"""What is in a C3D file: markers by label, their unit and rate, and what is no position.

Programs write markers that were not seen as a negative residual, as NaN, or as exactly (0, 0, 0).
More than 255 labels go on in LABELS2, and angles, forces and moments are stored like markers.
"""

import re
import subprocess
import sys
from dataclasses import dataclass

import numpy as np

from calibration.data import units
from calibration.data.recording import RecordingError

# Parameters that list what is no position, and its unit.
_LISTS = {
    "ANGLES": ("ANGLE_UNITS", "deg"),
    "FORCES": ("FORCE_UNITS", "N"),
    "MOMENTS": ("MOMENT_UNITS", "N*mm"),
    "REACTIONS": ("", "N"),
    "POWERS": ("POWER_UNITS", "W"),
    "SCALARS": ("SCALAR_UNITS", "%"),
}
# Models name their outputs so: LKneeAngles, TipForce, tip_moment, base.velocity.
_MODELLED = re.compile(
    r"(angles?|forces?|moments?|torques?|powers?|velocit(y|ies)|accelerations?|quaternions?|"
    r"rotations?|orientations?|euler)(?![a-z])",
    re.IGNORECASE,
)


@dataclass(frozen=True)
class Points:
    """`positions` (frames, markers, 3) in the file's own `unit`, NaN where missing; `labels`.

    - `unit`: as the file calls it, empty if it does not say. `rate` [Hz], None if it does not say.
    - `kinds`: labels of what is no position, with their units. `twice`: labels of two markers.
    """

    positions: np.ndarray
    labels: list[str]
    unit: str
    rate: float | None
    kinds: dict[str, str]
    twice: frozenset[str]
    notes: tuple[str, ...]


def read_points(path) -> Points:
    """The markers of the C3D file `path`. Raises `RecordingError` if it cannot be read."""
    try:
        import ezc3d
    except ImportError:
        raise RecordingError(
            f"{path}: reading C3D files needs ezc3d: pip install 'softrod_jax[c3d]'"
        ) from None
    try:
        with open(path, "rb") as file:
            head = file.read(10)
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
        labels = _labels(parameters)[: points.shape[1]]
        points = points[:, : len(labels)]
        points[residuals[:, : len(labels)] < 0] = np.nan
        units_ = parameters["UNITS"]["value"] if "UNITS" in parameters else []
        kinds = _kinds(parameters, labels)
        rates = parameters["RATE"]["value"] if "RATE" in parameters else []
        rate = float(rates[0]) if len(rates) else 0.0
    except Exception as e:  # ezc3d raises whatever its C++ throws
        raise RecordingError(f"{path}: not a readable C3D file: {e}") from None
    if not points.size:
        raise RecordingError(f"{path}: holds no frames of markers")
    notes = _unseen_at_zero(points, labels)
    # ezc3d says nothing of a file that was cut short, and forgets what its header promised.
    first, last = (int.from_bytes(head[i : i + 2], "little") for i in (6, 8))
    if len(points) < last - first + 1:
        notes.append(f"the file ends early: {len(points)} of {last - first + 1} frames")
    points, labels, twice = _once(points, labels)
    rate = rate if np.isfinite(rate) and rate > 0 else None
    unit = units_[0].strip() if len(units_) else ""
    return Points(points, labels, unit, rate, kinds, twice, tuple(notes))


def length_unit(path, unit: str) -> float:
    """The factor to metres of POINT:UNITS. Raises `RecordingError` for another than m, cm or mm."""
    name = units.canonical(unit)
    if name not in ("m", "cm", "mm"):
        raise RecordingError(
            f"{path}: POINT:UNITS is {unit!r}, expected one of m, cm, mm; set it in the software "
            "that exported the file, or give a mapping with [tip] unit"
        )
    return units.UNITS["length"][name]


def _labels(parameters) -> list[str]:
    """A parameter holds 255 texts at most: further ones are in LABELS2, LABELS3, .."""
    labels, k = list(parameters["LABELS"]["value"]), 2
    while f"LABELS{k}" in parameters:
        labels += parameters[f"LABELS{k}"]["value"]
        k += 1
    return [label.strip() for label in labels]


def _kinds(parameters, labels) -> dict[str, str]:
    kinds = {}
    for label in labels:
        found = _MODELLED.search(label.split(":")[-1])
        if found:
            kinds[label] = "deg" if found.group(1).lower().startswith("angle") else found.group(1)
    for name, (unit, usual) in _LISTS.items():
        listed = parameters[name]["value"] if name in parameters else []
        said = parameters[unit]["value"] if unit in parameters else []
        for label in listed:
            if isinstance(label, str) and label.strip():
                kinds[label.strip()] = str(said[0]) if len(said) and said[0] else usual
    return kinds


def _unseen_at_zero(points, labels) -> list[str]:
    """Frames of exactly (0, 0, 0) become missing, in place, unless a marker is always there: it may
    mark the origin. Returns what was assumed."""
    zero = np.all(points == 0, axis=2)
    known = np.all(np.isfinite(points), axis=2)
    some = np.any(zero, axis=0) & np.any(known & ~zero, axis=0)
    points[zero & some] = np.nan
    return [
        f"{np.sum(zero[:, j])} frames of {labels[j]} at exactly (0, 0, 0) are taken for missing"
        for j in np.flatnonzero(some)
    ]


def _once(points, labels):
    """Of markers with one label those that were ever seen; the labels of which several are left."""
    there = np.all(np.isfinite(points), axis=2) & np.any(points != 0, axis=2)
    seen = np.any(there, axis=0)
    keep = [j for j, x in enumerate(labels) if labels.count(x) == 1 or seen[j]]
    labels = [labels[j] for j in keep]
    twice = frozenset(x for x in labels if labels.count(x) > 1)
    return points[:, keep], labels, twice


def _try_apart(path) -> None:
    """Read the file in a process of its own first: ezc3d dies of some corrupted ones."""
    program = "import sys, ezc3d\ntry: ezc3d.c3d(sys.argv[1])\nexcept Exception: pass"
    done = subprocess.run([sys.executable, "-c", program, str(path)], capture_output=True)
    if done.returncode < 0 or done.returncode > 255:  # by a signal; Windows: by an exception
        raise RecordingError(f"{path}: ezc3d crashes on it: the file is corrupted; export it again")
