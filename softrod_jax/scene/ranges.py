"""What values a number of a scene can have: one rule for Python, scene files and traced numbers.

Each class of the scene says it of its fields, where they are declared. Scene files are read by it
(`schema.py`), and calls check by it what they are given (`checks.py`).
"""

import dataclasses
import functools
import math
from typing import Any

import equinox as eqx
import jax.numpy as jnp


@dataclasses.dataclass(frozen=True)
class Number:
    """A number or a list of numbers, in `unit`, each within the range.

    - `sizes`: the shapes allowed; 0 is a number, n a list of n numbers.
    - `above`, `below` exclude their bound, `at_least` includes it.
    - `zero_is_absent`: zero throughout means that the effect is not in the scene.
    - `per_actuator`: the field has one such value for each actuator, as rows of one array.
    - `each`: the field has a tuple of such values or `None`, one for each actuator.
    - `rows`: the field is an array with this many rows at least, each of which is such a value.
    - `least`: the field is an array with as many axes, and at least as many numbers along each.
    - `harmless`: what stands in for a traced value that cannot be.
    """

    unit: str = ""
    sizes: tuple[int, ...] = (0,)
    above: float = -math.inf
    at_least: float = -math.inf
    below: float = math.inf
    zero_is_absent: bool = False
    per_actuator: bool = False
    each: bool = False
    rows: int = 0
    least: tuple[int, ...] = ()
    harmless: Any = 0.0

    def __str__(self) -> str:
        shapes = ["a number" if n == 0 else f"a list of {n} numbers" for n in self.sizes]
        bounds = [
            f"{words} {bound:g}"
            for words, bound in (
                ("above", self.above),
                ("at least", self.at_least),
                ("below", self.below),
            )
            if math.isfinite(bound)
        ]
        if self.rows:
            shapes = [f"{self.rows} or more lists of {n} numbers each" for n in self.sizes]
        if self.least:
            shapes = [f"an array of {' x '.join(map(str, self.least))} or more numbers"]
        unit = f" [{self.unit}]" if self.unit else ""
        text = " or ".join(shapes) + unit
        return text + (", " + " and ".join(bounds) if bounds else ", finite")

    def fits(self, value, module):
        """Whether each entry is finite and in the range; `module` is numpy or jax.numpy."""
        fits = module.isfinite(value) & (value > self.above) & (value >= self.at_least)
        return fits & (value < self.below)

    def stand_in(self, shape: tuple[int, ...]):
        """What stands in for a value of this shape that cannot be."""
        harmless = jnp.asarray(self.harmless, dtype=float)
        if self.rows:
            return jnp.linspace(harmless[0], harmless[-1], shape[0])
        return jnp.broadcast_to(harmless, shape)

    def has_shape(self, shape: tuple[int, ...]) -> bool:
        """Whether an array of this shape can be such a value, or rows of them."""
        if self.least:
            enough = zip(shape, self.least)
            return len(shape) == len(self.least) and all(n >= least for n, least in enough)
        if self.per_actuator or self.rows:
            if not shape or shape[0] < max(self.rows, 1):
                return False
            shape = shape[1:]
        return shape in [(n,) if n else () for n in self.sizes]


# What is known of a number that no class says anything about.
ANY = Number(harmless=1.0)


_MISSING = object()


def number(
    unit: str = "",
    *,
    optional: bool = False,
    converter=None,
    default: Any = _MISSING,
    **range_: Any,
):
    """A field of a class of the scene, and the range of its numbers; `None` where `optional`."""
    keywords: dict[str, Any] = {"metadata": {"number": Number(unit, **range_)}}
    if optional or range_.get("each"):
        keywords["default"] = None
    if default is not _MISSING:
        keywords["default"] = default
    if range_.get("each"):
        converter = one_for_each
    if converter is not None:
        keywords["converter"] = converter
    return eqx.field(**keywords)


def singular(name: str) -> str:
    """The key of one actuator's number, of the name of a field that has one for each."""
    return name if name.endswith("ss") else name.removesuffix("s")


def one_for_each(values):
    """A tuple with a value for each actuator; `None` where there is a value for none."""
    try:
        values = None if values is None else tuple(values)
    except TypeError:  # one number for all, which the class refuses by its name
        return values
    return None if values is None or all(x is None for x in values) else values


@functools.cache
def numbers_of(kind: type) -> dict[str, Number]:
    """The ranges that a class of the scene declares, by the names of its fields."""
    fields = dataclasses.fields(kind)
    return {f.name: f.metadata["number"] for f in fields if "number" in f.metadata}


@functools.cache
def fields_of(kind: type) -> tuple[str, ...]:
    """The names of the fields of a class of the scene that are part of its pytree."""
    fields = dataclasses.fields(kind)
    return tuple(f.name for f in fields if not f.metadata.get("static", False))


def is_required(kind: type, name: str) -> bool:
    """Whether a field of a class of the scene must be given."""
    field = next(f for f in dataclasses.fields(kind) if f.name == name)
    return field.default is dataclasses.MISSING
