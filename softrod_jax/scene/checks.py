"""Scenes that cannot be: what is known at once raises, and what is traced becomes a code.

The ranges are those of `ranges.py`, for every number of the scene alike. What becomes of traced
ones is in `rod/validity.py`.
"""

import dataclasses
import operator
from collections.abc import Iterator
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from softrod_jax.foundation.tracing import is_traced
from softrod_jax.scene.planes import misfits
from softrod_jax.scene.ranges import ANY, Number, numbers_of
from softrod_jax.scene.scene import Scene, as_arrays, is_list


class Part(NamedTuple):
    """A number or an array of a scene, by its key in a scene file, and its range."""

    key: str
    number: Number
    value: Any


def checked_scene(who: str, scene: Scene) -> Scene:
    """The scene as float arrays.

    Raises `ValueError` for a number out of its range, an array of a wrong shape, and what
    contradicts the scene's restrictions, where that is known.
    """
    if not isinstance(scene, Scene):
        raise ValueError(
            f"{who}: the scene is a {type(scene).__name__}; give a Scene, as load_scene returns it"
        )
    leaves, structure = jax.tree.flatten(scene)
    last = _last_checked.get(structure)
    if last is not None and all(map(operator.is_, leaves, last.leaves)):
        return last.arrays
    for key, value, remedy in impossible(scene):
        raise ValueError(f"{who}: the scene's {key} = {value}: {remedy}")
    arrays = as_arrays(scene)
    for key, value, remedy in misfits(arrays):
        raise ValueError(f"{who}: the scene's {key} = {value}: {remedy}")
    if not is_traced(leaves) and all(isinstance(x, jax.Array) for x in leaves):
        _last_checked.clear()
        _last_checked[structure] = _Checked(leaves, arrays)
    return arrays


class _Checked(NamedTuple):
    """The numbers of a scene, which have been found good, and the scene as float arrays."""

    leaves: list
    arrays: Scene


# The one that was checked last. Its arrays cannot change, and checking them takes a fifth of the
# time of an equilibrium; a loop of calls would pay that for each.
_last_checked: dict[Any, _Checked] = {}


def impossible(scene: Scene) -> Iterator[tuple[str, Any, str]]:
    """What cannot be, where it is known: key, value, remedy."""
    parts = parts_of(scene, "rod")
    wrong = False
    for part in parts:
        for key, value in _unfit(part):
            wrong = True
            yield key, value, f"expected {part.number}"
    if wrong:
        return
    as_array = lambda x: (jnp if _is_traced(x) else np).asarray(x)
    known = jax.tree.map(as_array, scene, is_leaf=is_list)
    for prefix, owner in (("rod", known), ("rod.section", known.section)):
        with np.errstate(over="ignore"):
            relations = list(relations_of(owner))
        for name, holds, expected in relations:
            if not _is_traced(holds) and not np.all(holds):
                yield f"{prefix}.{name}", np.asarray(getattr(owner, name)).tolist(), expected()
    if scene.chambers is not None:
        areas, offsets = (len(x) for x in (known.chambers.areas, known.chambers.offsets))
        if areas != offsets:
            yield "chambers", f"{areas} areas and {offsets} offsets", "expected one of each"


def parts_of(module: eqx.Module, prefix: str) -> list[Part]:
    """All numbers, in the order of `jax.tree.leaves`."""
    parts, ranges = [], numbers_of(type(module))
    for field in dataclasses.fields(module):
        value = getattr(module, field.name)
        if value is None or field.metadata.get("static", False):
            continue
        within = "rod.section" if field.name == "section" else field.name
        key = f"{prefix}.{field.name}"
        if isinstance(value, eqx.Module):
            parts += parts_of(value, within)
        elif field.name in ranges:
            parts.append(Part(key, ranges[field.name], value))
        else:
            # Of an actuator or a section that is not one of this package.
            parts += [Part(key, ANY, x) for x in jax.tree.leaves(value)]
    return parts


def _unfit(part: Part) -> Iterator[tuple[str, Any]]:
    """Its key and value if it cannot be; of an array with a row an actuator, those of the row."""
    shown, known = part.value, not _is_traced(part.value)
    try:
        value = np.asarray(part.value) if known else jnp.asarray(part.value)
    except (TypeError, ValueError):  # a list with rows of different lengths
        value = None
    if value is None or value.dtype.kind not in "biuf":
        yield part.key, repr(shown)
        return
    if part.number is not ANY and not part.number.has_shape(value.shape):
        yield part.key, f"{value.tolist() if known else ''} of shape {value.shape}".strip()
        return
    if not known:
        return
    fits = np.asarray(part.number.fits(value.astype(float), np))
    if np.all(fits):
        return
    if not part.number.per_actuator:
        yield part.key, value.tolist()
        return
    owner, name = part.key.rsplit(".", 1)
    for i in np.flatnonzero(~fits.reshape(len(fits), -1).all(axis=1)):
        yield f"{owner}[{i}].{name.removesuffix('s')}", value[i].tolist()


def _is_traced(value) -> bool:
    """Unlike `is_traced`, of a number that is given and not of what is made with it."""
    return any(isinstance(x, jax.core.Tracer) for x in jax.tree.leaves(value))


def relations_of(owner):
    """What must hold between the numbers of a scene or a section; see their `relations`."""
    return owner.relations() if hasattr(owner, "relations") else ()
