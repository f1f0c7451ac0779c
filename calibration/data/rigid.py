"""Several markers on one body: its pose, sample by sample, by a rigid fit."""

import numpy as np
from jaxtyping import Float

from calibration.data.recording import RecordingError

# Fewer markers, or ones that lie on a line, do not tell how a body is turned.
_LEAST, _FLAT = 3, 1e-3
# Markers that miss their places by more than this are not where they are said to be.
_LARGEST_MISFIT = 3e-3  # m
_OF_THE_BODY = 0.1  # of its size, where that says what is where


def rigid_pose(
    seen: Float[np.ndarray, "samples markers 3"], meant: Float[np.ndarray, "markers 3"]
) -> tuple[Float[np.ndarray, "samples 3 3"], Float[np.ndarray, "samples 3"]]:
    """Rotations and places of a body: seen = rotation meant + place, by least squares over the
    markers that a sample has (Kabsch 1976). NaN in samples that have too few of them, or only some
    on a line.
    """
    rotations, places = np.full((len(seen), 3, 3), np.nan), np.full((len(seen), 3), np.nan)
    there = np.all(np.isfinite(seen), axis=-1)
    # Samples with the same markers are turned together.
    for pattern in np.unique(there, axis=0):
        rows = np.flatnonzero(np.all(there == pattern, axis=1))
        own = meant[pattern]
        if len(own) < _LEAST:
            continue
        middle = own.mean(0)
        spread = np.linalg.svd(own - middle, compute_uv=False)
        if spread[1] < _FLAT * spread[0] or spread[0] == 0:
            continue
        points = seen[np.ix_(rows, pattern)]
        centre = points.mean(1)
        u, _, vt = np.linalg.svd(np.einsum("nmi,mj->nij", points - centre[:, None], own - middle))
        sign = np.sign(np.linalg.det(u @ vt))
        flip = np.stack([np.ones_like(sign), np.ones_like(sign), sign], axis=-1)
        R = (u * flip[:, None]) @ vt
        rotations[rows], places[rows] = R, centre - R @ middle
    return rotations, places


def tip_of_body(
    seen: Float[np.ndarray, "samples markers 3"], meant: Float[np.ndarray, "markers 3"], where: str
) -> tuple[Float[np.ndarray, "samples 3"], str]:
    """Where the middle of the tip is, from markers whose places `meant` in the tip's own frame are
    known, and a note. Raises `RecordingError` if they are not there, or too few of them."""
    if len(meant) < _LEAST or np.linalg.matrix_rank(meant - meant.mean(0), tol=1e-9) < 2:
        raise RecordingError(
            f"{where}positions: a body needs at least 3 markers that are not on one line"
        )
    rotation, tip = rigid_pose(seen, meant)
    known = np.all(np.isfinite(tip), axis=1)
    if not known.any():
        raise RecordingError(f"{where}positions: no sample has three of the markers")
    expected = np.einsum("nij,mj->nmi", rotation, meant) + tip[:, None]
    misfit = float(np.sqrt(np.nanmean(np.sum((expected - seen)[known] ** 2, axis=-1))))
    if misfit > _LARGEST_MISFIT:
        raise RecordingError(
            f"{where}positions: after the best rigid fit the markers are {1e3 * misfit:.2g} mm rms "
            "from them; check their order, the positions [m], the unit and the axes"
        )
    return tip, f"tip fitted to {len(meant)} markers of one body, {1e3 * misfit:.2g} mm rms"


def body_pose(
    seen: Float[np.ndarray, "samples markers 3"], at_rest: slice, where: str
) -> tuple[Float[np.ndarray, "samples 3"], Float[np.ndarray, "samples 4"], str]:
    """Places of the middle of the markers on a body, and quaternions (w, x, y, z) of its turns from
    where it is in the samples `at_rest`, which tell its form; and a note.

    A sample in which some markers are missing has both from the others, if they are three that are
    not on one line. Raises `RecordingError` if the markers do not tell a pose.
    """
    whole = seen[np.all(np.isfinite(seen), axis=(1, 2))][at_rest]
    meant = np.median(whole, axis=0)
    meant = meant - meant.mean(0)
    if len(meant) < _LEAST or np.linalg.svd(meant, compute_uv=False)[1] < _FLAT * np.ptp(meant):
        raise RecordingError(
            f"{where}{len(meant)} markers tell no attitude: a body needs at least 3 that are not "
            "on one line; name more of them, or leave tip_body out"
        )
    rotation, place = rigid_pose(seen, meant)
    known = np.all(np.isfinite(place), axis=1)
    expected = np.einsum("nij,mj->nmi", rotation, meant) + place[:, None]
    misfit = float(np.sqrt(np.nanmean(np.sum((expected - seen)[known] ** 2, axis=-1))))
    if misfit > min(_LARGEST_MISFIT, _OF_THE_BODY * np.sqrt(np.mean(np.sum(meant**2, axis=1)))):
        raise RecordingError(
            f"{where}after the best rigid fit the markers are {1e3 * misfit:.2g} mm rms from it: "
            "they are not on one body"
        )
    filled = int(np.sum(known & ~np.all(np.isfinite(seen), axis=(1, 2))))
    return (
        place,
        quaternions_of(rotation),
        f"pose of the tip from {len(meant)} markers of one body, {1e3 * misfit:.2g} mm rms"
        + (f"; {filled} samples without some of them" if filled else ""),
    )


def quaternions_of(R: Float[np.ndarray, "samples 3 3"]) -> Float[np.ndarray, "samples 4"]:
    """Unit quaternions (w, x, y, z), w >= 0, of rotations; NaN where these are."""
    from scipy.spatial.transform import Rotation  # which JAX has brought; 0.3 s that few need

    found, known = np.full((len(R), 4), np.nan), np.all(np.isfinite(R), axis=(1, 2))
    if known.any():
        found[known] = Rotation.from_matrix(R[known]).as_quat(canonical=True, scalar_first=True)
    return found
