"""In which unit a tip was measured, about which place, and along which axis the rod lies.

With a scene its length decides; without, only sizes that no rod has.
"""

import itertools
from dataclasses import replace

import numpy as np

from calibration.data import units
from calibration.data.frames import straight_tip
from calibration.data.guesses import Guess
from calibration.data.table import Table

_UNITS = ("mm", "m", "cm", "in")
# A number of this size is no place in metres of a rod that is held in a hand.
_NOT_METRES = 3.0
# How far the tip of a rod at rest may be from the straight one, and how much closer another axis
# must bring it, in lengths of the rod.
_REST, _REACH = 0.6, 1.5
_FIRST = 5  # samples


def place(table: Table, found: Guess, scene=None, unit: str | None = None) -> Guess:
    """The guess with the tip's unit (`unit` if given), its axes, and whether its rest tells where
    it is."""
    if found.tip is None:
        return found
    tip = np.stack([np.asarray(table.columns[c], dtype=float) for c in found.tip], axis=1)
    tip = tip[np.all(np.isfinite(tip), axis=1)]
    said = table.unit(found.tip[0])
    known = unit or (units.canonical(said) if said else None)
    if not len(tip):
        return found
    if known is not None:
        found = replace(found, unit=known).noted(f"the tip is in {known}")
    if scene is None:
        return _by_size(tip, found, known)
    return _by_length(tip, found, known, scene)


def _by_size(tip: np.ndarray, found: Guess, known: str | None) -> Guess:
    if known is None:
        known = "mm" if np.max(np.abs(tip)) > _NOT_METRES else "m"
        found = replace(found, unit=known).noted(
            f"the tip is in {known}, which is assumed: its largest coordinate is "
            f"{np.max(np.abs(tip)):.4g}",
            "unit",
        )
    if found.origin is None and not found.rest:
        found = found.noted(
            "the clamp is taken to be the file's origin, and z to run along the rod; with the "
            "scene this is checked"
        )
    return found


def _by_length(tip: np.ndarray, found: Guess, known: str | None, scene) -> Guess:
    length = float(scene.length)
    base = np.zeros(3) if scene.base_position is None else np.asarray(scene.base_position)
    straight = straight_tip(scene) - base
    origin = np.zeros(3) if found.origin is None else np.asarray(found.origin)
    moved = tip - np.median(tip[:_FIRST], axis=0)
    given = found.rest or found.axes is not None
    for name in (known,) if known else _UNITS:
        size = units.UNITS["length"][name]
        start = size * (np.median(tip[:_FIRST], axis=0) - origin) - base
        reach = np.linalg.norm(size * (tip - origin) - base, axis=1)
        near = _REST * length
        if np.max(reach) > _REACH * length or np.max(reach) < near:
            continue
        found = _united(found, name, known)
        if given or np.linalg.norm(start - straight) < near:
            return found
        axes = _turned(start, straight)
        if np.linalg.norm(_matrix(axes) @ start - straight) < 0.5 * near:
            return replace(found, axes=axes).noted(
                f"the rod lies along another axis: the scene's x, y, z are taken to be the "
                f"file's {axes}; turns about the rod itself cannot be told from this",
                "axes",
            )
    for name in (known,) if known else _UNITS:
        if 1e-3 * length < units.UNITS["length"][name] * np.max(
            np.linalg.norm(moved, axis=1)
        ) < 2 * length:  # fmt: skip
            found = _united(found, name, known)
            return replace(found, rest=True, origin=None).noted(
                "where the clamp is cannot be told: the rest at the beginning is put at the "
                "scene's straight tip, and only displacements are measurements",
                "origin",
            )
    if known is None:
        return _by_size(tip, found, known)
    return found


def _united(found: Guess, name: str, known: str | None) -> Guess:
    if known is not None:
        return found
    return replace(found, unit=name).noted(f"the tip is in {name}: that fits the rod's length")


def _matrix(axes: str) -> np.ndarray:
    rows = np.zeros((3, 3))
    for i, name in enumerate(axes.split(",")):
        rows[i, "xyz".index(name[-1])] = -1 if name.startswith("-") else 1
    return rows


def _turned(start: np.ndarray, straight: np.ndarray) -> str:
    """The axes, right-handed, that bring the start nearest to the straight tip; of those that do
    so alike the one that reverses least."""
    best = []
    for letters in itertools.permutations("xyz"):
        for signs in itertools.product(("", "-"), repeat=3):
            axes = ",".join(s + x for s, x in zip(signs, letters, strict=True))
            matrix = _matrix(axes)
            if np.linalg.det(matrix) > 0:
                away = float(np.linalg.norm(matrix @ start - straight))
                best.append((round(away, 6), axes.count("-"), axes))
    return min(best)[2]
