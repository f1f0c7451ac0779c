"""Any number of a scene as a parameter, by its path in the scene file.

    segments[1].young_modulus     of the second segment
    tendons[*].friction           of all tendons that have it, scaled or shifted together
    stiffness.bending[0]          one of several numbers
    segments[0].material.c1       of a law of rubber
    relaxation[1][0]              of the second branch the part of the stiffness; [1] is its time
    segments[0].young_modulus = segments[2].young_modulus    tied: changed together

A number that cannot be negative changes by a factor, one with two ends (such as a part of the
stiffness) between them, any other one by a shift.
"""

import re
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np

import softrod_jax as sr
from calibration.experiment.setup import Setup
from calibration.parameters.parameter import AbstractParameter
from calibration.parameters.scales import AbstractScale, Between, Factor, Shift
from softrod_jax.scene.chambers import Chambers
from softrod_jax.scene.ranges import numbers_of, singular
from softrod_jax.scene.tendons import Tendons

_STEP = re.compile(r"([a-z_][a-z_0-9]*)((?:\[(?:\d+|\*)\])*)")
# What matters of a number that may have either sign, by its unit.
_SIZES = {"m": 1e-3, "rad": np.pi / 180, "1/m": 0.5, "N": 0.05, "N m": 1e-3, "m/s^2": 0.5, "": 0.05}

# Unit and scale of what a branch of a Prony series has.
_OF_BRANCHES = {0: ("1", Between(0.0, 1.0)), 1: ("s", Factor())}


class _Place(NamedTuple):
    """A leaf of a scene, `find` of it, and the index in the leaf; all of it if `None`."""

    find: Callable
    index: Any


def is_path(name: str) -> bool:
    """Whether a name is that of a place in a scene, and not of a parameter in the catalogue."""
    return any(sign in name for sign in ".[=")


@dataclass(frozen=True)
class PathParameter(AbstractParameter):
    """The numbers at the places of a path, changed together."""

    places: tuple[_Place, ...]

    def get(self, setup: Setup):
        """The values, (numbers,), or one number."""
        values = []
        for place in self.places:
            leaf = jnp.asarray(place.find(setup.scene))
            values.append(jnp.ravel(leaf if place.index is None else leaf[place.index]))
        together = jnp.concatenate(values)
        return together[0] if together.size == 1 else together

    def put(self, setup: Setup, value) -> Setup:
        """The setup with other values."""
        flat, at = jnp.ravel(jnp.asarray(value)), 0
        for place in self.places:
            leaf = jnp.asarray(place.find(setup.scene))
            count = leaf.size if place.index is None else leaf[place.index].size
            own = flat[at : at + count]
            at += count
            if place.index is None:
                new = own.reshape(leaf.shape)
            else:
                new = leaf.at[place.index].set(own.reshape(leaf[place.index].shape))
            setup = eqx.tree_at(lambda s, f=place.find: f(s.scene), setup, new)
        return setup


def path_parameter(scene: sr.Scene, name: str) -> PathParameter:
    """The parameter of this name. Raises `ValueError` for a path that leads to no number."""
    found = [_resolved(scene, part.strip(), name) for part in name.split("=")]
    units = {unit for _, unit, _ in found}
    if len(units) > 1:
        raise ValueError(f"fit: {name!r} ties numbers of the units {sorted(units)}; they differ")
    places = tuple(place for own, _, _ in found for place in own)
    _, unit, scale = found[0]
    return PathParameter(name, unit or "1", places, scale=scale)


def _resolved(scene: sr.Scene, path: str, name: str):
    """Places, unit and scale of one path."""
    steps = path.removeprefix("rod.").split(".")
    matched = [_STEP.fullmatch(step) for step in steps]
    if not all(matched):
        raise ValueError(f"fit: {name!r} is no path, such as segments[1].young_modulus")
    words: list[Any] = []
    for match in matched:
        assert match is not None, "all of them match"
        words.append(match[1])
        words += [x if x == "*" else int(x) for x in re.findall(r"\[(\d+|\*)\]", match[2])]
    places, owner = _walk(scene, words, lambda s: s, name)
    kind, field = owner
    if field == "relaxation":
        return places, *_OF_BRANCHES[words[-1]]
    known = numbers_of(kind).get(field)
    unit = "" if known is None else known.unit
    return places, unit, _scale(known, unit)


def _walk(here: Any, words: list, find: Callable, name: str):
    """All places that `words` lead to from `here`, and the class and field of the numbers."""
    word, *rest = words
    field = word
    if type(here) in (Tendons, Chambers) and (word == "*" or isinstance(word, int)):
        return _of_actuators(here, words, find, name)
    if word == "*":
        each = [_walk(x, rest, _item(find, i), name) for i, x in enumerate(here)]
        return tuple(p for places, _ in each for p in places), each[0][1]
    if isinstance(word, int):
        if word >= len(here):
            raise ValueError(f"fit: {name!r}: there are {len(here)}, counted from 0")
        return _walk(here[word], rest, _item(find, word), name)
    there = getattr(here, word, None)
    if there is None:
        raise ValueError(
            f"fit: the scene has no {word!r} of {name!r}; give it a starting value, or leave it out"
        )
    inner = lambda s: getattr(find(s), field)
    if field == "relaxation" and (len(rest) != 2 or rest[1] not in _OF_BRANCHES):
        raise ValueError(
            f"fit: {name!r}: of a branch a part of the stiffness or a time is fitted, "
            "relaxation[i][0] or relaxation[i][1]"
        )
    if isinstance(there, (tuple, list, eqx.Module)) and rest:
        return _walk(there, rest, inner, name)
    return _entries(there, rest, inner, name), (type(here), field)


def _of_actuators(part, words, find: Callable, name: str):
    """Of tendons[i].key: one number for each, in an array or a tuple of a field."""
    which, key, *rest = words
    fields = [key, f"{key}s", f"{key}es"]
    field = next((f for f in fields if f in numbers_of(type(part))), key)
    values = getattr(part, field, None)
    one = [which] if which != "*" else range(part.count)
    there = [] if values is None else [i for i in one if i < part.count and values[i] is not None]
    if not there:
        raise ValueError(
            f"fit: {name!r}: the scene has none; give {singular(field)} a starting value"
        )
    if isinstance(values, tuple):
        places = tuple(
            p
            for i in there
            for p in _entries(values[i], rest, lambda s, i=i: getattr(find(s), field)[i], name)
        )
        return places, (type(part), field)
    inner = lambda s: getattr(find(s), field)
    if not rest:
        return tuple(_Place(inner, i) for i in there), (type(part), field)
    return tuple(_Place(inner, (i, *rest)) for i in there), (type(part), field)  # pyright: ignore


def _entries(leaf, rest, find: Callable, name: str) -> tuple[_Place, ...]:
    """The whole of a leaf, or an entry of it."""
    if not rest or rest == ["*"]:
        return (_Place(find, None),)
    shape = np.shape(leaf)
    inside = [x == "*" or (isinstance(x, int) and x < n) for x, n in zip(rest, shape)]
    if len(rest) != len(shape) or not all(inside):
        raise ValueError(f"fit: {name!r} is no number of the scene; its shape is {shape}")
    return (_Place(find, tuple(slice(None) if x == "*" else x for x in rest)),)


def _item(find: Callable, i: int) -> Callable:
    return lambda s: find(s)[i]


def _scale(known, unit: str) -> AbstractScale:
    if known is None:
        return Shift(_SIZES[""])
    if known.below < np.inf:
        return Between(known.above, known.below)
    if known.above >= 0 or known.at_least >= 0:
        return Factor()
    return Shift(_SIZES.get(unit, 0.05))
