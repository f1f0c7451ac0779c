"""Samples of exactly (0, 0, 0): how many programs write a marker that was not seen."""

import numpy as np

# A zero is a place where the marker was, if the next other sample is within so many of its steps.
_STEPS = 3.0


def base_is_zero(scene) -> bool:
    """Whether the clamp is at the origin, where no tip can be."""
    return scene.base_position is None or not np.any(np.asarray(scene.base_position))


def at_zero(tip: np.ndarray, always: bool) -> tuple[np.ndarray, list[str]]:
    """A marker (T, 3) with NaN where it was not seen, and a note if there are such samples.

    `always`: a tip at (0, 0, 0) is impossible, because the clamp is there. Otherwise zeros stay
    that the motion passes through or rests at, as of a log of displacements.
    """
    zero = np.all(tip == 0, axis=1)
    other = np.flatnonzero(~zero & np.all(np.isfinite(tip), axis=1))
    if not np.any(zero) or len(other) < 2:
        return tip, []
    at = np.flatnonzero(zero)
    if not always:
        steps = np.linalg.norm(np.diff(tip[other], axis=0), axis=1)
        after = np.clip(np.searchsorted(other, at), 0, len(other) - 1)
        before = np.clip(after - 1, 0, len(other) - 1)
        size = np.linalg.norm(tip[other], axis=1)
        at = at[np.minimum(size[before], size[after]) > _STEPS * np.max(steps)]
    if not len(at):
        return tip, []
    tip = tip.copy()
    tip[at] = np.nan
    return tip, [f"{len(at)} samples of a marker at exactly (0, 0, 0) are taken for missing"]
