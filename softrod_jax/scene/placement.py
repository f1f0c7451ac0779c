"""Where things are along the rod and in its sections, and whether they can be there.

A rule about arc lengths or tubes can be asked of traced numbers, too. That tendons and chambers lie
inside the sections is asked where numbers are known, at points along each segment.
"""

from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import numpy as np

from softrod_jax.scene.contacts import Tube
from softrod_jax.scene.scene import Scene
from softrod_jax.scene.sections import Annulus, Circle, GeneralSection, Rectangle
from softrod_jax.scene.segments import section_between
from softrod_jax.scene.tendons import Tendons

# Rounding errors, as parts of a length.
_ROUNDING = 1e-9
# Places along a segment at which a path is held against the section.
_SAMPLES = 257


class Rule(NamedTuple):
    """Something that must hold: a key as in a scene file, its value, and what is expected."""

    key: str
    value: Any
    holds: Any
    expected: Callable[[], str]


def arc_lengths(scene: Scene) -> Iterator[Rule]:
    """Rules for the places along the rod; of arrays of numpy or of JAX, which may be traced."""
    length = scene.length
    last = length * (1 + _ROUNDING)
    on_rod = lambda: f"expected a place on the rod, from 0 to its length {float(length):g} [m]"
    for name in ("loads", "masses", "markers"):
        for i, part in enumerate(getattr(scene, name) or ()):
            yield Rule(f"{name}[{i}].at", part.at, part.at <= last, on_rod)
    for name in ("tendons", "chambers"):
        actuators = getattr(scene, name)
        if actuators is None or (actuators.starts_at is None and actuators.ends_at is None):
            continue
        for i in range(actuators.count):
            start, end = (
                None if ends is None else ends[i]
                for ends in (actuators.starts_at, actuators.ends_at)
            )
            if end is not None:
                yield Rule(f"{name}[{i}].ends_at", end, end <= last, on_rod)
            if start is None:
                continue
            until = length if end is None else end
            before = lambda until=until: f"expected less than where it ends, {float(until):g} [m]"
            yield Rule(f"{name}[{i}].starts_at", start, start < until, before)


def tubes(scene: Scene) -> Iterator[Rule]:
    """Rules for tubes with the rod in them, whose sections are round; as those of `arc_lengths`."""
    for i, contact in enumerate(scene.contacts or ()):
        if not isinstance(contact.obstacle, Tube):
            continue
        radius = contact.obstacle.radius
        # Between the ends of a segment radii change linearly.
        for part in scene.segments or (scene,):
            for section in (part.section, part.section_at_end):
                if isinstance(section, Circle | Annulus):
                    own = section.radius if isinstance(section, Circle) else section.outer_radius
                    expected = lambda own=own: (
                        f"thinner than the rod, whose radius is {float(own):g} [m]; expected at "
                        "least that"
                    )
                    yield Rule(f"contacts[{i}].radius", radius, radius >= own, expected)


class _Stretch(NamedTuple):
    """Where a segment is [m], and its sections at both ends."""

    start: float
    end: float
    section: Any
    at_end: Any


def outside_sections(scene: Scene) -> Iterator[tuple[str, Any, str]]:
    """Tendons and chambers that do not fit: key, value, remedy. All numbers must be known."""
    stretches = list(_stretches(scene))
    tendons, chambers = scene.tendons, scene.chambers
    # Where tendons of another kind run is their own business.
    if type(tendons) is Tendons and not _all_inside(scene, tendons):
        for i in range(tendons.count):
            if tendons.guides[i] == "rod":
                yield from _tendon_outside(scene, tendons, stretches, i)
    if chambers is None:
        return
    for i in range(chambers.count):
        offset, area = chambers.offsets[i], chambers.areas[i]
        key, part = f"chambers[{i}]", _part(chambers, i, scene.length)
        found = _first_outside(stretches, part, lambda s, x=offset: x, straight=True)
        if found is not None:
            yield f"{key}.offset", offset.tolist(), found.remedy("")
        smallest = min(
            (_outline_area(section) for _, section in _ends_of(stretches, part)), default=np.inf
        )
        if area > smallest * (1 + _ROUNDING):
            yield (
                f"{key}.area",
                area.tolist(),
                f"larger than the section itself; expected at most {smallest:.6g} [m^2]",
            )


def _all_inside(scene: Scene, tendons: Tendons) -> bool:
    """Whether straight tendons of a uniform rod are inside, seen at one glance."""
    if scene.section is None or scene.section_at_end is not None or tendons.paths is not None:
        return False
    return bool(np.all(_inside(scene.section, tendons.offsets)))


def _stretches(scene: Scene) -> Iterator[_Stretch]:
    if scene.segments is None:
        yield _Stretch(0.0, float(scene.length), scene.section, scene.section_at_end)
        return
    start = 0.0
    for segment in scene.segments:
        end = start + float(segment.length)
        yield _Stretch(start, end, segment.section, segment.section_at_end)
        start = end


def _part(actuators, i: int, length) -> tuple[float, float]:
    """As `part_of`, in numbers of Python."""
    start = None if actuators.starts_at is None else actuators.starts_at[i]
    end = None if actuators.ends_at is None else actuators.ends_at[i]
    return 0.0 if start is None else float(start), float(length if end is None else end)


def _tendon_outside(scene: Scene, tendons: Tendons, stretches, i: int):
    straight = tendons.path(i) is None
    place = lambda s: (
        tendons.offsets[i] if straight else np.asarray(tendons.place(i, s, scene.length))
    )
    found = _first_outside(stretches, _part(tendons, i, scene.length), place, straight)
    if found is not None:
        name = "offset" if straight else "path"
        yield f"tendons[{i}].{name}", found.place.tolist(), found.remedy('; or guided = "disks"')


class _Outside(NamedTuple):
    """A place that is outside the section there."""

    place: np.ndarray
    s: float
    section: Any

    def remedy(self, otherwise: str) -> str:
        outline = _outline(self.section)
        return (
            f"outside the section at s = {self.s:.4g} m; expected x and y [m] within "
            f"{outline}{otherwise}"
        )


def _first_outside(stretches, part, place, straight: bool) -> _Outside | None:
    """The first place between the ends of a part that is outside the section, if there is one.

    What is straight is so at an end of a segment: dimensions change linearly.
    """
    if straight:
        for s, section in _ends_of(stretches, part):
            if not _inside(section, place(s)):
                return _Outside(place(s), s, section)
        return None
    for stretch in stretches:
        low, high = max(stretch.start, float(part[0])), min(stretch.end, float(part[1]))
        if low >= high:
            continue
        s = np.linspace(low, high, _SAMPLES)
        x = (s - stretch.start) / (stretch.end - stretch.start)
        places = place(s)
        inside = _inside(section_between(stretch.section, stretch.at_end, x), places)
        if not np.all(inside):
            k = int(np.argmin(np.broadcast_to(inside, s.shape)))
            section = section_between(stretch.section, stretch.at_end, x[k])
            return _Outside(places[k], float(s[k]), section)
    return None


def _ends_of(stretches, part) -> Iterator[tuple[float, Any]]:
    """Arc lengths and sections at the ends of what a part covers of each segment."""
    for stretch in stretches:
        low, high = max(stretch.start, float(part[0])), min(stretch.end, float(part[1]))
        if low >= high:
            continue
        for s in (low,) if stretch.at_end is None else (low, high):
            x = (s - stretch.start) / (stretch.end - stretch.start)
            yield s, section_between(stretch.section, stretch.at_end, x)


def _inside(section, place):
    """Whether places (*n, 2) are inside, where a tendon in the surface is."""
    return np.asarray(section.contains(place * (1 - _ROUNDING)))


def _outline(section) -> str:
    match section:
        case Circle():
            return f"a circle of radius {section.radius:g} m"
        case Annulus():
            return f"a circle of radius {section.outer_radius:g} m"
        case Rectangle():
            return f"{section.width / 2:g} m of the axis in x and {section.height / 2:g} m in y"
    return "the section"


def _outline_area(section) -> float:
    """What the outline encloses [m^2]: a tube's bore may be the chamber."""
    match section:
        case Annulus():
            return float(np.pi * section.outer_radius**2)
        case Circle():
            return float(np.pi * section.radius**2)
        case Rectangle():
            return float(section.width * section.height)
        case GeneralSection():
            return np.inf  # its outline is unknown
    return float(section.area)
