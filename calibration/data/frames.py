"""From a sensor's frame to the scene's: axes, a fit to base markers, the rest as origin."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from calibration.data.onset import last_rest_sample
from calibration.data.recording import Recording, RecordingError

# Fewer samples at rest than this do not tell where the rest is.
_LEAST_REST = 5
# Base markers that miss their places by more than this are not where they are said to be.
_LARGEST_MISFIT = 3e-3  # m
# Markers of which the distance changes by more than this part of the rod are not on one body.
_LARGEST_STRETCH = 0.2


def axes_matrix(axes: str, where: str) -> np.ndarray:
    """The matrix (3, 3) from a file's coordinates to the scene's, for axes such as "-y,x,z"."""
    rows = np.zeros((3, 3))
    names = [name.strip().lower() for name in axes.split(",")]
    letters = [name.removeprefix("-").removeprefix("+") for name in names]
    if sorted(letters) != ["x", "y", "z"]:
        raise RecordingError(
            f"{where}axes = {axes!r}: expected x, y and z in any order, each with a sign if "
            "reversed, such as -y,x,z"
        )
    for i, (name, letter) in enumerate(zip(names, letters, strict=True)):
        rows[i, "xyz".index(letter)] = -1 if name.startswith("-") else 1
    if np.linalg.det(rows) < 0:
        raise RecordingError(
            f"{where}axes = {axes!r} mirrors the recording (a left-handed frame); reverse one "
            "sign, or swap two axes"
        )
    return rows


def quaternion_of_turn(matrix: np.ndarray) -> np.ndarray:
    """The unit quaternion (w, x, y, z) of a rotation matrix (3, 3), by its largest component."""
    r = np.asarray(matrix)
    # Rows of 4 q q^T.
    (a, b, c), (d, e, f), (g, h, i) = r
    four = np.array(
        [
            [1 + a + e + i, h - f, c - g, d - b],
            [h - f, 1 + a - e - i, b + d, c + g],
            [c - g, b + d, 1 - a + e - i, f + h],
            [d - b, c + g, f + h, 1 - a - e + i],
        ]
    )
    row = four[np.argmax(np.diag(four))]
    return row / np.linalg.norm(row)


def from_base_markers(tip, seen, meant, where: str):
    """The tip (T, 3) in the scene's frame, and a note, by a rigid fit (Kabsch 1976).

    `seen`: base markers (T, 3) each, in the sensor's frame; `meant`: where they are in the
    scene's, (3,) each. The attitude is fitted to their medians, the place to every sample: a clamp
    that shifts is not taken for a rod that bends.
    """
    if len(seen) < 3:
        raise RecordingError(
            f"{where}base_markers: {len(seen)} given, and a frame needs at least 3"
        )
    meant = np.array(meant)
    medians = np.array([np.nanmedian(s, axis=0) for s in seen])
    if not np.all(np.isfinite(medians)):
        raise RecordingError(f"{where}base_markers: one of them was never seen")
    a, b = medians - medians.mean(axis=0), meant - meant.mean(axis=0)
    u, s, vt = np.linalg.svd(b.T @ a)
    if s[1] < 1e-6 * s[0] or s[0] == 0:
        raise RecordingError(f"{where}base_markers: they lie on one line; move one of them")
    turn = u @ np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ vt))]) @ vt
    misfit = float(np.sqrt(np.mean(np.sum((a @ turn.T - b) ** 2, axis=1))))
    if misfit > _LARGEST_MISFIT:
        raise RecordingError(
            f"{where}base_markers: after the best rigid fit they are {1e3 * misfit:.2g} mm rms "
            "from their positions; check their order, their positions [m] and the unit"
        )
    centre = np.mean(seen, axis=0)
    note = f"frame fitted to {len(seen)} base markers, {1e3 * misfit:.2g} mm rms"
    return (tip - centre) @ turn.T + meant.mean(axis=0), (note,)


def from_rest(tip, scene, path):
    """The tip with its rest at the beginning at the scene's straight tip, and a note."""
    known = np.all(np.isfinite(tip), axis=1)
    rest = rest_samples(tip[known], path)
    placed = straight_tip(scene) - np.median(tip[known][:rest], axis=0)
    note = f"origin: the median of the tip over {rest} samples at rest is the straight tip"
    return tip + placed, placed, note


def in_one_frame(
    recordings: Recording | Sequence[Recording], others: Recording | Sequence[Recording]
) -> tuple[list[Recording], list[Recording]]:
    """Recordings of one set-up in one frame: put in place as the first of them is, of which a fit
    finds by how much that is wrong. `others`: further ones that were kept aside.

    Raises `RecordingError` for one that knows where the clamp is.
    """
    parts = [[x] if isinstance(x, Recording) else [*x] for x in (recordings, others)]
    for r in (*parts[0], *parts[1]):
        if r.origin_known or r.placed is None:
            raise RecordingError(
                f"{r.source or r.name}: knows where the clamp is, so that there is no frame to "
                "share: leave one_frame out; camera_shift and camera_rotation can be fitted"
            )
    first = parts[0][0]
    note = f"in the frame of {first.name}, which was put in place by its rest"

    def moved(r: Recording) -> Recording:
        tip = r.tip_positions + first.placed - r.placed
        known = {"origin_known": True, "placed": first.placed}
        return replace(r, tip_positions=tip, notes=(*r.notes, note), **known)

    together, aside = ([moved(r) for r in own] for own in parts)
    return together, aside


def rest_samples(tip: np.ndarray, path) -> int:
    """How many samples at the beginning are at rest."""
    last = last_rest_sample(tip) if len(tip) > 2 else None
    rest = len(tip) if last is None else last + 1
    if rest < _LEAST_REST:
        raise RecordingError(
            f"{path}: the tip moves from frame {rest} on, and at least {_LEAST_REST} frames at "
            "rest, the rod held straight, must come first: they give the origin; a mapping can say "
            "where the clamp is with [tip] origin instead"
        )
    return rest


def straight_tip(scene) -> np.ndarray:
    """The tip [m] of the unloaded rod, (3,), if it is straight."""
    tip = np.array([0.0, 0.0, float(scene.length)])
    if scene.base_quaternion is not None:
        w, *xyz = np.asarray(scene.base_quaternion)
        tip = tip + 2 * np.cross(xyz, np.cross(xyz, tip) + w * tip)
    return tip if scene.base_position is None else tip + np.asarray(scene.base_position)


def check_one_body(path, points, labels: list[str], scene) -> None:
    """Refuse markers whose mean is no place: `points` (T, markers, 3) [m] that are further from
    each other than the rod is long, or whose distances change by a good part of it.

    Angles and forces, stored like markers, and markers of another object look like that.
    """
    length = float(scene.length)
    for j in range(1, len(labels)):
        for i in range(j):
            distance = np.linalg.norm(points[:, i] - points[:, j], axis=1)
            distance = distance[np.isfinite(distance)]
            if not len(distance):
                continue
            low, middle, high = np.quantile(distance, (0.02, 0.5, 0.98))
            if middle > length or high - low > _LARGEST_STRETCH * length:
                raise RecordingError(
                    f"{path}: {labels[i]} and {labels[j]} are {low:.3g} to {high:.3g} m apart, "
                    f"and the rod is {length:g} m long: they are not on one body; is one of them "
                    "no position, or another object's? choose the markers by their whole names"
                )
