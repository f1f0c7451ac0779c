"""Can this tip be the tip of that rod? What most often is wrong, and a hint only where it would
help.

A wrong unit, a wrong clamp and a forgotten rest look alike until each is tried on all the samples.
"""

from dataclasses import dataclass

import numpy as np

from calibration.data.carried import BASE, at_first
from calibration.data.frames import straight_tip
from calibration.data.recording import Recording, RecordingError

# A rod under its own pressure may grow, but a tip further off than this is a wrong unit.
_LARGEST_REACH = 1.5
# A tip that is never further from the clamp than this part of the rod does not belong to it.
_AT_THE_CLAMP = 0.1
# In the right unit the tip is at least once about as far from the clamp as the rod is long.
_ABOUT_ITS_LENGTH = 0.6
_FIRST = 5  # samples
# A movement by less than this part of the rod is none.
_MOVES = 1e-3
# Nor does a tendon become shorter by so many lengths of the rod.
_LARGEST_PULL = 3.0
_USUAL = ("mm", "cm", "m")
_UNITS = {
    "mm": (1e-3, "millimetres"),
    "cm": (1e-2, "centimetres"),
    "m": (1.0, "metres"),
    "in": (0.0254, "inches"),
    "um": (1e-6, "micrometres"),
}


@dataclass(frozen=True)
class Source:
    """Where a recording's numbers are from, for messages.

    - `labels` (T,): of the samples. `columns`: of the tip. `unit`: the key that sets the tip's
      unit, in which it is `now`. `origin`: the key that says where the clamp is, if it is not
      known already; None if it is put in place by the rest.
    """

    labels: list[str]
    columns: str
    unit: str
    origin: str | None
    now: str = "m"


def check_reach(recording: Recording, scene, source: Source) -> None:
    """Refuse a tip that the rod cannot reach, or that stays at the clamp throughout.

    A wrong unit is the usual reason, and otherwise ends in a fit of nonsense.
    """
    if scene is None or not np.any(recording.has_tip):
        return
    rod = _Rod(scene, recording)
    distance = rod.distance(recording.tip_positions)
    where = lambda k: f"{recording.source}: {source.labels[k]}, {source.columns}: the tip"
    if np.any(distance > rod.reach):
        k = int(np.argmax(distance > rod.reach))
        tip = ", ".join(f"{x:g}" for x in recording.tip_positions[k])
        outside = int(np.sum(distance > rod.reach))
        few = outside <= 0.02 * len(distance) + 1 < len(distance) / 2
        raise RecordingError(
            f"{where(k)} ({tip}) is {distance[k]:.4g} m from the base of a rod {rod.length:g} m "
            f"long; {_too_far(recording, rod, source, few)}"
        )
    if not (recording.origin_known and np.all(recording.coordinates)):
        return
    distance = distance[recording.has_tip]
    first = int(np.argmax(recording.has_tip))
    begin, farthest = float(np.median(distance[:_FIRST])), float(np.max(distance))
    if farthest < _AT_THE_CLAMP * rod.length or (
        begin < _AT_THE_CLAMP * rod.length and scene.rest_curvature is None
    ):
        what = "begins" if farthest >= _AT_THE_CLAMP * rod.length else "stays"
        raise RecordingError(
            f"{where(first)} {what} within {begin if what == 'begins' else farthest:.4g} m of "
            f"the base of a rod {rod.length:g} m long; {_too_near(recording, rod, source, begin)}"
        )


def check_pulls(recording: Recording, scene, remedy: str) -> None:
    """Refuse pulls by which no tendon of such a rod can become shorter."""
    if scene is None or recording.pulls is None:
        return
    largest = np.max(np.abs(recording.pulls), axis=0, initial=0.0)
    for i in np.flatnonzero(largest > _LARGEST_PULL * float(scene.length))[:1]:
        raise RecordingError(
            f"{recording.source}: pull {i + 1} is up to {largest[i]:.4g} m, and the rod is "
            f"{float(scene.length):g} m long; {remedy}"
        )


class _Rod:
    """What a recording is compared with: base (3,) or, where it is carried, (T, 3), straight tip
    (3,), length and reach [m]."""

    def __init__(self, scene, recording: Recording):
        scene = at_first(scene, recording.carried)
        self.base = np.zeros(3) if scene.base_position is None else np.asarray(scene.base_position)
        if BASE in recording.carried:
            self.base = recording.carried[BASE][:, :3]
        stretch = 1.0 if scene.rest_stretch is None else np.linalg.norm(scene.rest_stretch)
        self.length = float(scene.length)
        self.reach = _LARGEST_REACH * self.length * stretch
        self.tip = straight_tip(scene)

    def distance(self, tip) -> np.ndarray:
        # A missing coordinate is NaN and counts as zero here: it can only bring the tip nearer.
        return np.linalg.norm(np.nan_to_num(tip - self.base), axis=1)

    def fits(self, tip) -> bool:
        """Whether all of it is within reach, and some of it about as far as the rod is long."""
        distance = self.distance(tip)
        far = np.max(distance) > _ABOUT_ITS_LENGTH * self.length
        return bool(np.all(distance <= self.reach) and far)


def _others(source: Source):
    """The units that the tip is not in, their words, and the factors to them."""
    now = _UNITS[source.now][0]
    for name, (size, words) in _UNITS.items():
        if name != source.now:
            yield name, words, size / now


def _too_far(recording, rod: _Rod, source: Source, few: bool) -> str:
    if few:
        return "check the unit (m) and the origin or, if it is an outlier, leave its cells empty"
    tip, start = recording.tip_positions, recording.track[1][0]
    moved = np.nan_to_num(tip - start)
    moves = lambda factor: factor * np.max(np.linalg.norm(moved, axis=1)) > _MOVES * rod.length
    elsewhere = source.origin is not None and moves(1.0) and rod.fits(moved + rod.tip)
    for name, words, factor in _others(source):
        # In a rare unit anything fits; there, it must begin about where a rod does, too.
        begins = np.linalg.norm(factor * start - rod.tip) < _ABOUT_ITS_LENGTH * rod.length
        if not rod.fits(factor * tip) or (elsewhere and not moves(factor)):
            continue
        if begins or name in _USUAL:
            thousand = (source.now, name) == ("m", "mm")
            ask = "dividing it by 1000 would fit" if thousand else "it would fit"
            return f"is it in {words}? {ask}: {source.unit} = '{name}'"
    if elsewhere:
        return f"it moves as such a rod may, about another place than the clamp: {source.origin}"
    for name, words, factor in _others(source) if source.origin is not None else ():
        if name in _USUAL and moves(factor) and rod.fits(factor * moved + rod.tip):
            return (
                f"in {words}, and about another place than the clamp, it would move as such a rod "
                f"may: {source.unit} = '{name}', and {source.origin}"
            )
    return "check the unit (m), the scene's length and that the clamp is the origin"


def _too_near(recording, rod: _Rod, source: Source, begin: float) -> str:
    tip = recording.tip_positions - rod.base
    for name, words, factor in _others(source):
        begins = _ABOUT_ITS_LENGTH * rod.length < factor * begin <= rod.reach
        if factor > 1 and begins and rod.fits(factor * tip + rod.base):
            return f"in {words} it would fit: {source.unit} = '{name}'"
    if source.origin is not None:
        return f"are these displacements from the rest, or from another place? {source.origin}"
    return "check the unit and that the clamp is the origin"
