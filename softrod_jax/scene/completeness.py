"""What a scene must say of its rod, and what it must not say twice.

These rules are about what is there and not about its numbers, so they hold for traced scenes, too.
Each breach is a key as a scene file has it, the value (`None` where it is missing), and a remedy.
"""

import re
from collections.abc import Iterator
from typing import Any

import numpy as np

from softrod_jax.scene.acting import AbstractEnergy
from softrod_jax.scene.contacts import contact_names
from softrod_jax.scene.materials import AbstractRubber
from softrod_jax.scene.ranges import numbers_of
from softrod_jax.scene.scene import Scene
from softrod_jax.scene.sections import Annulus, Circle, GeneralSection
from softrod_jax.scene.segments import Segment, Stiffness
from softrod_jax.scene.tendons import Tendons

Breach = tuple[str, Any, str]

# Names that columns of logs have for themselves: NAME_x_m would be another's.
_TAKEN = ("tip", "base")
_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*")
_MODULI = ("young_modulus", "poisson_ratio", "shear_correction")


def incomplete(scene: Scene) -> Iterator[Breach]:
    """What is missing in a scene, or contradicts something else in it."""
    if scene.segments is None:
        yield from _shape(scene, "rod", ", or add [[segments]]")
    else:
        for name in ("section", "section_at_end"):
            if getattr(scene, name) is not None:
                remedy = "each of the segments has a section of its own; leave it out"
                yield f"rod.{name}", type(getattr(scene, name)).__name__, remedy
        for i, segment in enumerate(scene.segments):
            yield from _shape(segment, f"segments[{i}]", "")
    yield from _twice(scene, "rod")
    for i, segment in enumerate(scene.segments or ()):
        yield from _twice(segment, f"segments[{i}]")
    yield from _material(scene)
    yield from _relaxation(scene)
    yield from _names(scene)
    yield from _touched(scene)
    yield from _tendons(scene)


def _tendons(scene: Scene) -> Iterator[Breach]:
    """What only tendons driven by their length have."""
    tendons = scene.tendons
    if type(tendons) is not Tendons:
        return
    for name in ("stiffness", "pretension", "backlash"):
        each = getattr(tendons, name) or ()
        for i, value in enumerate(each):
            if value is not None and i not in tendons.by_length:
                remedy = 'its tension is given; leave it out, or control = "length"'
                yield f"tendons[{i}].{name}", _plain(value), remedy


def _shape(owner: Scene | Segment, key: str, otherwise: str) -> Iterator[Breach]:
    """A length and a section; a taper keeps its shape."""
    given = vars(owner)
    section, end = given["section"], given["section_at_end"]
    if given["length"] is None:
        yield f"{key}.length", None, f"expected {numbers_of(Segment)['length']}{otherwise}"
    if section is None:
        yield f"{key}.section", None, f"expected a table{otherwise}"
    if section is not None and end is not None and type(end) is not type(section):
        kinds = [type(x).__name__ for x in (end, section)]
        yield f"{key}.section_at_end", kinds[0], f"expected {kinds[1]}, the shape of section"
    elif isinstance(section, Circle) and isinstance(end, Circle):
        counts = [0 if x.holes is None else len(x.holes) for x in (end, section)]
        if counts[0] != counts[1]:
            remedy = f"expected {counts[1]} holes, as section has"
            yield f"{key}.section_at_end.holes", counts[0], remedy


def _twice(owner: Scene | Segment, key: str) -> Iterator[Breach]:
    """What is measured beside what it would follow from."""
    if owner.stiffness is not None:
        for name in _MODULI:
            if getattr(owner, name) is not None:
                yield f"{key}.{name}", _shown(owner, name), "stiffness stands for it; leave one out"
    if isinstance(owner.material, AbstractRubber):
        for name in ("young_modulus", "poisson_ratio", "stiffness"):
            if getattr(owner, name) is not None:
                yield f"{key}.{name}", _shown(owner, name), "material stands for it; leave one out"
    if owner.linear_density is not None and owner.density is not None:
        remedy = "linear_density stands for it; leave one out"
        yield f"{key}.density", _shown(owner, "density"), remedy


def _material(scene: Scene) -> Iterator[Breach]:
    """Stiffness and mass of every segment, its own or the rod's."""
    if scene.segments is None:
        owners = [("rod", scene, scene)]
    else:
        own = (scene, *scene.segments)
        if any(x is None or type(x) is str for s in own[1:] for x in (s.section, s.length)):
            return  # said already
        parts = zip(scene.parts, scene.segments, strict=True)
        owners = [(f"segments[{i}]", part, own) for i, (part, own) in enumerate(parts)]
    for key, part, own in owners:
        yield from _needed(scene, key, part, own)


def _needed(scene: Scene, key: str, part, own) -> Iterator[Breach]:
    ranges, measured = numbers_of(Scene), part.stiffness
    where = "" if own is scene else ", here or in [rod]"
    if isinstance(own.material, AbstractEnergy) and own is not scene:
        remedy = "a law of one's own is that of the whole rod: give it to the scene"
        yield f"{key}.material", type(own.material).__name__, remedy
    elif isinstance(part.material, AbstractRubber):
        yield from _of_rubber(scene, key, part, own)
    elif part.material is not None:
        pass  # it has moduli of its own
    elif measured is None:
        for name in ("young_modulus", "poisson_ratio"):
            if getattr(part, name) is None:
                yield f"{key}.{name}", None, f"expected {ranges[name]}{where}; or stiffness"
    elif not scene.inextensible:
        source = key if own.stiffness is not None else "rod"
        for name in ("axial", "shear"):
            if getattr(measured, name) is None:
                remedy = f"expected {numbers_of(Stiffness)[name]}, or rod.inextensible"
                yield f"{source}.stiffness.{name}", None, remedy
    if measured is not None and own.stiffness is None:
        for name in _MODULI:
            if getattr(own, name) is not None:
                remedy = "rod.stiffness stands for it; leave it out, or give young_modulus, too"
                yield f"{key}.{name}", _shown(own, name), remedy
    if part.density is None and part.linear_density is None:
        yield f"{key}.density", None, f"expected {ranges['density']}{where}; or linear_density"


def _of_rubber(scene: Scene, key: str, part, own) -> Iterator[Breach]:
    """What fibres cannot be made of, and what a law of the rod already says."""
    if isinstance(part.section, GeneralSection):
        remedy = "where the fibres are is not known; give another shape, or young_modulus"
        yield f"{key}.section", "general", remedy
    if own.material is None and own.poisson_ratio is not None:
        remedy = "rod.material stands for it; leave it out, or give young_modulus, too"
        yield f"{key}.poisson_ratio", _shown(own, "poisson_ratio"), remedy
    if isinstance(scene.material, AbstractEnergy):
        remedy = "the scene has a law of one's own for the whole rod; leave one out"
        yield f"{key}.material", type(own.material).__name__, remedy


def _relaxation(scene: Scene) -> Iterator[Breach]:
    """That of a law of one's own, which has the same one everywhere."""
    if isinstance(scene.material, AbstractEnergy):
        for i, segment in enumerate(scene.segments or ()):
            if segment.relaxation is not None:
                remedy = "a law of one's own relaxes as a whole: give relaxation to the scene"
                yield f"segments[{i}].relaxation", _shown(segment, "relaxation"), remedy


def _touched(scene: Scene) -> Iterator[Breach]:
    """Sections of a rod that obstacles touch."""
    owners = [("rod", scene)] + [(f"segments[{i}]", x) for i, x in enumerate(scene.segments or ())]
    for key, owner in owners if scene.contacts else ():
        if owner.section is not None and not isinstance(owner.section, Circle | Annulus):
            name = type(owner.section).__name__
            remedy = (
                "in contact the rod's surface is round; expected Circle or Annulus, or no contacts"
            )
            yield f"{key}.section", name, remedy


def _names(scene: Scene) -> Iterator[Breach]:
    """Names of markers and obstacles, by which logs have columns."""
    seen: dict[str, str] = {}
    named = [(f"markers[{i}].name", x.name) for i, x in enumerate(scene.markers or ())]
    given = enumerate(contact_names(scene.contacts))
    for key, name in named + [(f"contacts[{i}].name", x) for i, x in given]:
        if not isinstance(name, str) or not _NAME.fullmatch(name):
            yield key, name, "expected letters, digits and _, the first a letter"
        elif name in _TAKEN:
            yield key, name, "this name is taken; choose another"
        elif name in seen:
            one = "another" if key.startswith(seen[name]) else "a"
            yield key, name, f"{one} {seen[name]} has this name; each needs one of its own"
        seen[name] = "marker" if key.startswith("marker") else "contact"


def _shown(owner, name: str):
    """A number as it is written, where it is known."""
    return _plain(getattr(owner, name))


def _plain(value):
    try:
        return np.asarray(value).tolist()
    except Exception:  # noqa: BLE001 - traced, or no number at all
        return value
