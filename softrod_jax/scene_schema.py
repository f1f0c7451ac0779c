"""What a scene file may hold: each key's shape, unit and range, and the check of one table.

The tables below are the whole format. `read_table` is the one place that looks at a key, so
every complaint has the same form: file, key, value, what is allowed.
"""

import math
from dataclasses import dataclass
from difflib import get_close_matches
from typing import Any

import numpy as np

from softrod_jax.scene import PLANES
from softrod_jax.sections import Annulus, Circle, GeneralSection, Rectangle


class SceneError(ValueError):
    """A scene that cannot be: the message names the file, the key, the value and the remedy."""


@dataclass(frozen=True)
class Number:
    """A number or a list of numbers, in `unit`, each within the range.

    - `sizes`: the shapes allowed; 0 is a number, n a list of n numbers.
    - `above`, `below` exclude their bound, `at_least` includes it.
    - `zero_is_absent`: zero throughout means that the effect is not in the scene.
    """

    unit: str = ""
    sizes: tuple[int, ...] = (0,)
    above: float = -math.inf
    at_least: float = -math.inf
    below: float = math.inf
    required: bool = False
    zero_is_absent: bool = False

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
        unit = f" [{self.unit}]" if self.unit else ""
        text = " or ".join(shapes) + unit
        return text + (", " + " and ".join(bounds) if bounds else ", finite")

    def read(self, value: Any, where: str) -> np.ndarray | None:
        """`value` as a float64 array of shape () or (n,); None where zero means absent.

        Raises `SceneError`.
        """
        size, items = (len(value), value) if isinstance(value, list) else (0, [value])
        if size not in self.sizes or not all(_is_number(x) for x in items):
            raise SceneError(complaint(where, value, f"expected {self}"))
        try:
            array = np.array(value, dtype=np.float64)
        except OverflowError:
            array = np.array(math.inf)
        fits = np.isfinite(array) & (array > self.above) & (array >= self.at_least)
        if not np.all(fits & (array < self.below)):
            raise SceneError(complaint(where, value, f"expected {self}"))
        if self.zero_is_absent and not np.any(array):
            return None
        return array


@dataclass(frozen=True)
class Table:
    """A table, written [name], or inline as { key = value }."""

    required: bool = False

    def read(self, value: Any, where: str) -> dict:
        if not isinstance(value, dict):
            name = where.rsplit(".", 1)[-1].rsplit(" ", 1)[-1]
            raise SceneError(complaint(where, value, f"expected one table, written [{name}]"))
        return value


@dataclass(frozen=True)
class Tables:
    """Any number of tables, each written [[name]]."""

    required: bool = False

    def read(self, value: Any, where: str) -> list[dict]:
        if not isinstance(value, list) or not all(isinstance(x, dict) for x in value):
            name = where.rsplit(" ", 1)[-1]
            raise SceneError(
                complaint(where, value, f"expected tables with two brackets each, [[{name}]]")
            )
        return value


@dataclass(frozen=True)
class Word:
    """One of a few words."""

    words: tuple[str, ...]
    required: bool = False

    def read(self, value: Any, where: str) -> str:
        if value not in self.words:
            allowed = ", ".join(f'"{w}"' for w in self.words)
            raise SceneError(complaint(where, value, f"expected one of {allowed}"))
        return value


@dataclass(frozen=True)
class Flag:
    """Whether something is so."""

    required: bool = False

    def read(self, value: Any, where: str) -> bool:
        if not isinstance(value, bool):
            raise SceneError(complaint(where, value, "expected true or false"))
        return value


Schema = dict[str, Number | Table | Tables | Word | Flag]

_SIZE = Number("m", above=0, required=True)
_DAMPING = {"sizes": (0, 3), "at_least": 0, "zero_is_absent": True}

SCENE: Schema = {
    "rod": Table(required=True),
    "tendons": Tables(),
    "chambers": Tables(),
    "payload": Table(),
    "tip_load": Table(),
}

ROD: Schema = {
    "length": _SIZE,
    "section": Table(required=True),
    "young_modulus": Number("Pa", above=0, required=True),
    "poisson_ratio": Number(above=-1, below=0.5, required=True),
    "density": Number("kg/m^3", above=0, required=True),
    "bending_damping": Number("N m^2 s", **_DAMPING),
    "shear_damping": Number("N s", **_DAMPING),
    "gravity": Number("m/s^2", sizes=(3,), zero_is_absent=True),
    "drag_coefficient": Number("kg/m^2", **_DAMPING),
    "shear_correction": Number(above=0),
    "rest_curvature": Number("1/m", sizes=(3,)),
    "rest_stretch": Number(sizes=(3,)),
    "base_position": Number("m", sizes=(3,)),
    "base_quaternion": Number(sizes=(4,)),
    "inextensible": Flag(),
    "plane": Word(PLANES),
}

SECTIONS: dict[str, tuple[type, Schema]] = {
    "circle": (Circle, {"radius": _SIZE}),
    "annulus": (
        Annulus,
        {"outer_radius": _SIZE, "inner_radius": Number("m", at_least=0, required=True)},
    ),
    "rectangle": (Rectangle, {"width": _SIZE, "height": _SIZE}),
    "general": (
        GeneralSection,
        {
            "area": Number("m^2", above=0, required=True),
            "second_moments": Number("m^4", sizes=(2,), above=0, required=True),
            "torsion_constant": Number("m^4", above=0, required=True),
        },
    ),
}
SHAPE = Word(tuple(SECTIONS), required=True)

TENDON: Schema = {"offset": Number("m", sizes=(2,), required=True)}

CHAMBER: Schema = {
    "area": Number("m^2", above=0, required=True),
    "offset": Number("m", sizes=(2,), required=True),
}

PAYLOAD: Schema = {"mass": Number("kg", at_least=0, required=True, zero_is_absent=True)}

TIP_LOAD: Schema = {
    "force": Number("N", sizes=(3,), zero_is_absent=True),
    "moment": Number("N m", sizes=(3,), zero_is_absent=True),
}


def read_table(table: dict, schema: Schema, where: str) -> dict:
    """The values of `table`, checked against `schema`; keys that are absent are left out.

    `where` is the file and the path of the table in it, the beginning of every message. Raises
    `SceneError` for an unknown key, a missing required one, a wrong type or value.
    """
    for key in table:
        if key not in schema:
            close = get_close_matches(key, schema, n=1)
            hint = f'did you mean "{close[0]}"? ' if close else ""
            raise SceneError(
                complaint(
                    _join(where, key),
                    table[key],
                    f"unknown key; {hint}allowed here: {', '.join(schema)}",
                )
            )
    for key, kind in schema.items():
        if kind.required and key not in table:
            expected = "a table" if isinstance(kind, Table) else str(kind)
            raise SceneError(f"{_join(where, key)} is missing: expected {expected}")
    return {key: schema[key].read(table[key], _join(where, key)) for key in table}


def complaint(where: str, value: Any, allowed: str) -> str:
    """One line: where, the value as it stands, and what is allowed."""
    text = repr(value)
    if len(text) > 80:
        text = text[:77] + "..."
    return f"{where} = {text}: {allowed}"


def _join(where: str, key: str) -> str:
    # `where` is "file:" for the file's top level and "file: rod" for a table.
    return f"{where} {key}" if where.endswith(":") else f"{where}.{key}"


def _is_number(x: Any) -> bool:
    return isinstance(x, int | float) and not isinstance(x, bool)
