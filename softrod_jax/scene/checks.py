"""Scenes that cannot be: what is known at once raises, and what is traced becomes a code.

The ranges are those of `ranges.py`, for every number of the scene alike; what must be there is in
`completeness.py`, and what must fit where in `placement.py`. What becomes of traced numbers is in
`rod/validity.py`.
"""

import operator
from collections.abc import Iterator
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Bool

from softrod_jax.foundation.tracing import is_traced
from softrod_jax.scene.completeness import incomplete
from softrod_jax.scene.placement import Rule, arc_lengths, outside_sections, tubes
from softrod_jax.scene.planes import fits_plane, misfits
from softrod_jax.scene.ranges import ANY, Number, fields_of, numbers_of, singular
from softrod_jax.scene.scene import Scene, as_arrays, map_numbers, total_length, with_total_length


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
        stated = f"{key} is missing" if value is None else f"{key} = {value}"
        raise ValueError(f"{who}: the scene's {stated}: {remedy}")
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
    """What cannot be, where it is known: key, value (`None` where it is missing), remedy."""
    wrong = False
    for breach in (*incomplete(scene), *_out_of_range(scene)):
        wrong = True
        yield breach
    if wrong:
        return
    as_array = lambda x: (jnp if _is_traced(x) else np).asarray(x)
    known = map_numbers(as_array, scene)
    if scene.segments is not None:
        known = eqx.tree_at(lambda s: s.length, known, total_length(known.segments))
    with np.errstate(over="ignore"):
        rules = list(rules_of(known))
    for key, value, holds, expected in rules:
        if not _is_traced(holds) and not np.all(holds):
            wrong = True
            yield key, np.asarray(value).tolist(), expected()
    if scene.chambers is not None:
        areas, offsets = (len(x) for x in (known.chambers.areas, known.chambers.offsets))
        if areas != offsets:
            wrong = True
            yield "chambers", f"{areas} areas and {offsets} offsets", "expected one of each"
    if not wrong:
        yield from _outside(known)


def _out_of_range(scene: Scene) -> Iterator[tuple[str, Any, str]]:
    for part in parts_of(scene):
        if scene.segments is not None and part.key == "rod.length":
            continue  # those of the segments are what is given
        for key, value in _unfit(part):
            yield key, value, f"expected {part.number}"


def _outside(scene: Scene) -> list[tuple[str, Any, str]]:
    """Actuators that leave the sections, where all that decides it is known."""
    if scene.tendons is None and scene.chambers is None:
        return []
    shapes = (scene.length, scene.section, scene.section_at_end)
    if scene.segments is not None:
        shapes = [(x.length, x.section, x.section_at_end) for x in scene.segments]
    if _is_traced((shapes, scene.tendons, scene.chambers)):
        return []
    # Sections and paths may compute with JAX, under `jit` as well.
    with jax.ensure_compile_time_eval():
        return list(outside_sections(scene))


def rules_of(scene: Scene) -> Iterator[Rule]:
    """All that must hold between the numbers of a scene, which may be traced."""
    for prefix, owner in _owners(scene, "rod"):
        relations = getattr(type(owner), "relations", None)
        if relations is not None:
            for name, holds, expected in relations(owner):
                yield Rule(f"{prefix}.{name}", getattr(owner, name), holds, expected)
    yield from arc_lengths(scene)
    yield from tubes(scene)


def can_be(scene: Scene) -> Bool[Array, ""]:
    """Whether all numbers of a scene of arrays can be, as far as a program that runs asks that."""
    good = jnp.array(True)
    for part in parts_of(scene):
        good &= jnp.all(part.number.fits(part.value, jnp))
    for rule in rules_of(scene):
        good &= jnp.all(rule.holds)
    return good if scene.plane is None else good & fits_plane(scene)


def harmless_unless(good: Bool[Array, ""], scene: Scene) -> Scene:
    """The scene of arrays or, where it is not good, one of the same structure that can be."""
    leaves, structure = jax.tree.flatten(scene)
    leaves = [
        jnp.where(good, x, part.number.stand_in(jnp.shape(x)))
        for x, part in zip(leaves, parts_of(scene), strict=True)
    ]
    return with_total_length(jax.tree.unflatten(structure, leaves))


def parts_of(module: eqx.Module, prefix: str = "rod") -> list[Part]:
    """All numbers, in the order of `jax.tree.leaves`."""
    parts = []
    for key, number, value in _fields(module, prefix):
        if isinstance(value, eqx.Module):
            parts += parts_of(value, key)
        else:
            parts.append(Part(key, number, value))
    return parts


def _owners(module: eqx.Module, prefix: str) -> Iterator[tuple[str, eqx.Module]]:
    """The module and all modules in it, by their keys in a scene file."""
    yield prefix, module
    for key, _, value in _fields(module, prefix):
        if isinstance(value, eqx.Module):
            yield from _owners(value, key)


# Tables of a scene file that are within that of the rod.
_OF_THE_ROD = ("section", "section_at_end", "stiffness", "material")
# Parts whose keys a scene file has among those of the table that they are in.
_AMONG_OTHERS = ("obstacle",)


def _fields(module: eqx.Module, prefix: str) -> Iterator[tuple[str, Number, Any]]:
    """Each number and each module in a module, with its key in a scene file."""
    # Equinox takes its time to give an attribute.
    ranges, values, whole = numbers_of(type(module)), vars(module), isinstance(module, Scene)
    for name in fields_of(type(module)):
        value = values[name]
        if value is None:
            continue
        number = ranges.get(name, ANY)
        within = whole and name not in _OF_THE_ROD and name not in ranges
        key = name if within else f"{prefix}.{name}"
        key = prefix if name in _AMONG_OTHERS else key
        if number.each or _is_row(value):
            for i, item in enumerate(value):
                one = f"{prefix}[{i}].{singular(name)}"
                if item is not None:
                    yield f"{name}[{i}]" if within else one, number, item
        elif isinstance(value, eqx.Module) or name in ranges:
            yield key, number, value
        else:
            # Of an actuator or a section that is not one of this package.
            for leaf in jax.tree.leaves(value):
                yield key, ANY, leaf


def _is_row(value) -> bool:
    """Whether it holds a module for each of several."""
    return isinstance(value, tuple | list) and any(isinstance(x, eqx.Module) for x in value)


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
        yield f"{owner}[{i}].{singular(name)}", value[i].tolist()


def _is_traced(value) -> bool:
    """Unlike `is_traced`, of a number that is given and not of what is made with it."""
    return any(isinstance(x, Tracer) for x in jax.tree.leaves(value))
