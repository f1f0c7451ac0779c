"""A scene as a person reads it: every number with its unit, tendons and other parts counted.

Traced numbers and batches have no single number: they are shown by their shapes and, where they
are known, by the range of their values.
"""

import dataclasses

import equinox as eqx
import jax
import numpy as np
from jax.core import Tracer

from softrod_jax.scene.ranges import ANY, Number, numbers_of, singular

# More parts of a kind, and larger arrays, are not shown as a whole.
_MOST_PARTS = 8
_MOST_NUMBERS = 12
# What need not be said.
_USUAL = {"guided": "rod", "control": "tension", "frame": "base", "inextensible": False}
_USUAL |= {"base_moves": False, "moves": False}
# Tables beside that of the rod.
_OTHERS = (
    *("segments", "tendons", "chambers", "payload", "tip_load"),
    *("loads", "masses", "markers"),
    *("energies", "dissipations", "distributed_loads", "conditions", "contacts"),
)


def described(scene: eqx.Module) -> str:
    """The scene in a few lines."""
    lines = ["Scene", "  rod"]
    lines += [f"    {key} = {text}" for key, text in _entries(scene, without=_OTHERS)]
    for name in _OTHERS:
        part = getattr(scene, name)
        if part is None:
            continue
        if isinstance(part, tuple | list):
            own = name in ("energies", "dissipations", "distributed_loads", "conditions")
            lines += _counted(name, [_value(x, ANY) if own else _inline(x) for x in part])
        elif _has_rows(part):
            lines += _counted(name, [_row(part, i) for i in range(part.count)])
        else:
            lines.append(f"  {name}: {_inline(part)}")
    return "\n".join(lines)


def _counted(name: str, texts: list[str]) -> list[str]:
    """A heading with how many there are, and a line for each of the first."""
    one = {"masses": "mass", "energies": "energy"}.get(name, singular(name))
    counted = one if len(texts) == 1 else name
    lines = [f"  {len(texts)} {counted.replace('_', ' ')}"]
    shown = texts if len(texts) <= _MOST_PARTS else texts[: _MOST_PARTS - 1]
    lines += [f"    {i}: {text}" for i, text in enumerate(shown)]
    if len(shown) < len(texts):
        lines.append(f"    ... and {len(texts) - len(shown)} more")
    return lines


def _entries(module, without=()):
    """The keys of a part of the scene and what stands there; what is absent is left out."""
    ranges = numbers_of(type(module))
    for field in dataclasses.fields(module):
        name, value = field.name, getattr(module, field.name, None)
        if value is None or name in without:
            continue
        if field.metadata.get("static", False):
            if value != _USUAL.get(name):
                yield name, str(value)
        else:
            yield name, _value(value, ranges.get(name, ANY))


def _inline(module) -> str:
    return ", ".join(f"{key} = {text}" for key, text in _entries(module)) or "nothing"


def _value(value, number: Number) -> str:
    if isinstance(value, eqx.Module):
        return f"{type(value).__name__}({_inline(value)})"
    if isinstance(value, tuple) and (number.each or any(isinstance(x, eqx.Module) for x in value)):
        return "[" + ", ".join("-" if x is None else _value(x, number) for x in value) + "]"
    return _quantity(value, number)


def _quantity(value, number: Number) -> str:
    unit = f" {number.unit}" if number.unit else ""
    if any(isinstance(x, Tracer) for x in jax.tree.leaves(value)):
        return f"traced, of shape {np.shape(value)}{unit}"
    try:
        array = np.asarray(value, dtype=float)
    except (TypeError, ValueError):  # no number: a scene need not be a good one
        return repr(value)
    expected = number is ANY or number.has_shape(array.shape)
    if expected and array.size <= _MOST_NUMBERS:
        return f"{_plain(array)}{unit}"
    if array.size == 0:
        return f"of shape {array.shape}"
    return f"{np.min(array):.6g} to {np.max(array):.6g}{unit}, of shape {array.shape}"


def _plain(array: np.ndarray | np.floating) -> str:
    if array.ndim == 0:
        return f"{float(array):.6g}"
    return "[" + ", ".join(_plain(x) for x in array) + "]"


def _has_rows(part) -> bool:
    """Whether it is of several actuators, with a row of known numbers for each."""
    rows = [n for n, number in numbers_of(type(part)).items() if number.per_actuator]
    values = [getattr(part, name) for name in rows]
    if not rows or any(isinstance(x, Tracer) for x in jax.tree.leaves(values)):
        return False
    ranges = numbers_of(type(part))
    shapes = [np.shape(x) for x in values]
    good = all(ranges[n].has_shape(shape) for n, shape in zip(rows, shapes, strict=True))
    return good and len({shape[0] for shape in shapes}) == 1


def _row(part, i: int) -> str:
    """What one actuator has."""
    ranges, texts = numbers_of(type(part)), []
    for field in dataclasses.fields(part):
        name, value = field.name, getattr(part, field.name)
        number = ranges.get(name, ANY)
        if value is None:
            continue
        if number.per_actuator:
            one = dataclasses.replace(number, per_actuator=False)
            texts.append(f"{singular(name)} = {_quantity(value[i], one)}")
        elif name in ("guided", "control"):
            if part.words(name)[i] != _USUAL[name]:
                texts.append(f"{name} = {part.words(name)[i]}")
        elif isinstance(value, tuple) and len(value) == part.count:
            if value[i] is not None:
                texts.append(f"{singular(name)} = {_value(value[i], number)}")
        else:
            texts.append(f"{name} = {_value(value, number)}")
    return ", ".join(texts)
