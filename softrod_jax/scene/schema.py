"""What a scene file may hold: each key's shape, unit and range, and the check of one table.

The tables below are the whole format; what numbers can be is said by the classes of the scene
(`ranges.py`). `read_table` is the one place that looks at a key, so
every complaint has the same form: file, key, value, what is allowed.
"""

from dataclasses import dataclass
from difflib import get_close_matches
from typing import Any

import numpy as np

from softrod_jax.scene.chambers import Chambers
from softrod_jax.scene.contacts import AbstractObstacle, Contact, Plane, Sphere, Tube
from softrod_jax.scene.distance_grid import DistanceGrid
from softrod_jax.scene.loads import FRAMES, Load, Marker, Mass, Payload, TipLoad
from softrod_jax.scene.materials import MooneyRivlin, NeoHookean
from softrod_jax.scene.ranges import Number, is_required, numbers_of
from softrod_jax.scene.scene import PLANES, Scene
from softrod_jax.scene.sections import Annulus, Circle, GeneralSection, Rectangle
from softrod_jax.scene.segments import Segment, Stiffness
from softrod_jax.scene.silicones import SILICONES, known_silicones
from softrod_jax.scene.tendons import CONTROLS, GUIDES, Helix, Line, Points, Tendons
from softrod_jax.scene.units import UnitError, in_unit


class SceneError(ValueError):
    """A scene that cannot be: the message names the file, the key, the value and the remedy."""


@dataclass(frozen=True)
class Numbers:
    """A number or a list of numbers, within the range that a class of the scene declares."""

    number: Number
    required: bool = False

    def __str__(self) -> str:
        return str(self.number)

    def read(self, value: Any, where: str) -> np.ndarray | None:
        """`value` as a float64 array of shape () or (n,); None where zero means absent.

        Raises `SceneError`.
        """
        try:
            value = in_unit(value, self.number.unit)
        except UnitError as e:
            raise SceneError(complaint(where, value, str(e))) from None
        if not self._has_shape(value):
            raise SceneError(complaint(where, value, f"expected {self}"))
        try:
            array = np.array(value, dtype=np.float64)
        except OverflowError:
            array = np.array(np.inf)
        if not np.all(self.number.fits(array, np)):
            raise SceneError(complaint(where, value, f"expected {self}"))
        if self.number.zero_is_absent and not np.any(array):
            return None
        return array

    def _has_shape(self, value: Any) -> bool:
        rows = value if self.number.rows else [value]
        if not isinstance(rows, list) or len(rows) < self.number.rows:
            return False
        for row in rows:
            size, items = (len(row), row) if isinstance(row, list) else (0, [row])
            if size not in self.number.sizes or not all(_is_number(x) for x in items):
                return False
        return True


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
class LawOrName:
    """A table with a law, or the name of a silicone."""

    required: bool = False

    def read(self, value: Any, where: str) -> dict | str:
        named = isinstance(value, str)
        if isinstance(value, dict) or (named and value in SILICONES):
            return value
        if named:
            allowed = f"no such silicone; {known_silicones(value)}; or a table with a law"
        else:
            names = ", ".join(f'"{name}"' for name in SILICONES)
            allowed = f"expected {{ law = .. }}, or one of {names}"
        raise SceneError(complaint(where, value, allowed))


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
class Text:
    """A name."""

    required: bool = False
    what: str = "a word"

    def __str__(self) -> str:
        return f"{self.what} in quotes"

    def read(self, value: Any, where: str) -> str:
        if not isinstance(value, str):
            raise SceneError(complaint(where, value, f"expected {self}"))
        return value


@dataclass(frozen=True)
class Count:
    """A whole number from 1."""

    required: bool = False

    def read(self, value: Any, where: str) -> int:
        if not isinstance(value, int) or isinstance(value, bool) or value < 1:
            raise SceneError(complaint(where, value, "expected a whole number, at least 1"))
        return value


@dataclass(frozen=True)
class Flag:
    """Whether something is so."""

    required: bool = False

    def __str__(self) -> str:
        return "true or false"

    def read(self, value: Any, where: str) -> bool:
        if not isinstance(value, bool):
            raise SceneError(complaint(where, value, f"expected {self}"))
        return value


Schema = dict[str, Numbers | Table | LawOrName | Tables | Word | Text | Count | Flag]


def _numbers_of(kind: type) -> Schema:
    """The numbers of a class of the scene, as one of its tables has them."""
    return {
        name.removesuffix("s") if number.per_actuator else name: Numbers(
            number, is_required(kind, name)
        )
        for name, number in numbers_of(kind).items()
    }


# Fields whose names in Python are other than those in a file: `from` is a word of the language.
PATH_KEYS = {"begin": "from", "end": "to"}

SCENE: Schema = {
    "rod": Table(required=True),
    "segments": Tables(),
    "tendons": Tables(),
    "chambers": Tables(),
    "payload": Table(),
    "tip_load": Table(),
    "loads": Tables(),
    "masses": Tables(),
    "markers": Tables(),
    "contacts": Tables(),
    "base": Table(),
}
BASE: Schema = {"moves": Flag(required=True)}

# A length and a section, or segments instead: that is checked with the scene as a whole.
ROD: Schema = {
    "section": Table(),
    "section_at_end": Table(),
    **_numbers_of(Scene),
    "stiffness": Table(),
    "material": LawOrName(),
    "inextensible": Flag(),
    "plane": Word(PLANES),
}

SECTIONS: dict[str, tuple[type, Schema]] = {
    name: (kind, _numbers_of(kind))
    for name, kind in (
        ("circle", Circle),
        ("annulus", Annulus),
        ("rectangle", Rectangle),
        ("general", GeneralSection),
    )
}
SHAPE = Word(tuple(SECTIONS), required=True)

SEGMENT: Schema = {
    "section": Table(required=True),
    "section_at_end": Table(),
    **_numbers_of(Segment),
    "stiffness": Table(),
    "material": LawOrName(),
    "intervals": Count(),
}
STIFFNESS = _numbers_of(Stiffness)
# The linear law is that of a scene without a material, whose moduli are keys beside it.
LINEAR = "linear"
LAWS: dict[str, tuple[type, Schema]] = {
    "neo_hookean": (NeoHookean, _numbers_of(NeoHookean)),
    "mooney_rivlin": (MooneyRivlin, _numbers_of(MooneyRivlin)),
}
LAW = Word((LINEAR, *LAWS), required=True)

# A tendon has an offset or a path: that is checked when it is read.
TENDON: Schema = {
    "offset": Numbers(numbers_of(Tendons)["offsets"]),
    "path": Table(),
    "starts_at": Numbers(numbers_of(Tendons)["starts_at"]),
    "ends_at": Numbers(numbers_of(Tendons)["ends_at"]),
    "guided": Word(GUIDES),
    "control": Word(CONTROLS),
    "stiffness": Numbers(numbers_of(Tendons)["stiffness"]),
    "pretension": Numbers(numbers_of(Tendons)["pretension"]),
    "friction": Numbers(numbers_of(Tendons)["friction"]),
    "backlash": Numbers(numbers_of(Tendons)["backlash"]),
}
# The keys of a path, and which fields of its class they are where that is not the same.
PATHS: dict[str, tuple[type, Schema]] = {
    "helix": (Helix, _numbers_of(Helix)),
    "line": (Line, {PATH_KEYS.get(k, k): v for k, v in _numbers_of(Line).items()}),
    "points": (Points, _numbers_of(Points)),
}
PATH_SHAPE = Word(tuple(PATHS), required=True)
CHAMBER = _numbers_of(Chambers)
LOAD: Schema = {**_numbers_of(Load), "frame": Word(FRAMES)}
MASS = _numbers_of(Mass)
MARKER: Schema = {"name": Text(required=True), **_numbers_of(Marker)}
CONTACT: Schema = {"name": Text(), **_numbers_of(Contact), "moves": Flag()}
# The keys of an obstacle stand beside those of the contact with it.
OBSTACLES: dict[str, tuple[type[AbstractObstacle], Schema]] = {
    name: (kind, _numbers_of(kind))
    for name, kind in (("plane", Plane), ("sphere", Sphere), ("tube", Tube))
}
OBSTACLES["grid"] = DistanceGrid, {"file": Text(required=True, what="the name of a file")}
OBSTACLE = Word(tuple(OBSTACLES), required=True)
PAYLOAD, TIP_LOAD = _numbers_of(Payload), _numbers_of(TipLoad)


def read_table(table: dict, schema: Schema, where: str) -> dict[str, Any]:
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
            expected = f"a table, [{key}]" if isinstance(kind, Table) else str(kind)
            raise SceneError(f"{_join(where, key)} is missing: expected {expected}")
    return {key: schema[key].read(table[key], _join(where, key)) for key in table}


def complaint(where: str, value: Any, allowed: str) -> str:
    """One line: where, the value as it stands (`None`: it is missing), and what is allowed."""
    if value is None:
        return f"{shortened(where, 200)} is missing: {allowed}"
    return f"{shortened(where, 200)} = {shortened(_shown(value), 80)}: {allowed}"


def shortened(text: str, most: int) -> str:
    """`text`, or its beginning where it is longer than `most`."""
    return text if len(text) <= most else text[: most - 3] + "..."


def _shown(value: Any) -> str:
    try:
        return repr(value)
    except (RecursionError, ValueError):  # nested too deep, or a whole number of many digits
        return f"<{type(value).__name__}, too large to show>"


def _join(where: str, key: str) -> str:
    # `where` is "file:" for the file's top level and "file: rod" for a table. What would break a
    # message into lines is shown as it is written.
    key = key if key.isprintable() else repr(key)
    return f"{where} {key}" if where.endswith(":") else f"{where}.{key}"


def _is_number(x: Any) -> bool:
    return isinstance(x, int | float) and not isinstance(x, bool)
