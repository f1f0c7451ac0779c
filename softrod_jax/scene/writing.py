"""A scene as the text of its file."""

from typing import Any

import numpy as np

from softrod_jax.scene import schema
from softrod_jax.scene.contacts import contact_names
from softrod_jax.scene.distance_grid import DistanceGrid
from softrod_jax.scene.scene import Scene
from softrod_jax.scene.schema import SceneError
from softrod_jax.scene.tendons import Tendons

_SECTIONS = {kind: shape for shape, (kind, _) in schema.SECTIONS.items()}
_LAWS = {kind: law for law, (kind, _) in schema.LAWS.items()}
_OBSTACLES = {kind: shape for shape, (kind, _) in schema.OBSTACLES.items()}
_PATHS = {kind: shape for shape, (kind, _) in schema.PATHS.items()}


def grids_of(scene: Scene, stem: str) -> dict[str, DistanceGrid]:
    """The grids of distances of its obstacles, by the names of their files beside its own."""
    named = zip(contact_names(scene.contacts), scene.contacts or (), strict=True)
    grids = {name: x.obstacle for name, x in named if isinstance(x.obstacle, DistanceGrid)}
    return {_grid_file(stem, name): grid for name, grid in grids.items()}


def _grid_file(stem: str, name: str) -> str:
    return f"{stem}_{name}.npz"


def document_of(scene: Scene, file: str, stem: str) -> dict:
    """The scene as the nested dictionary that its file would parse to; `stem`: of its name.

    Raises `SceneError`, which begins with `file`, for what has no form in a file.
    """
    document: dict[str, Any] = {"rod": _shaped(scene, schema.ROD, f"{file} rod")}
    # Static, and so at hand as they are; one that restricts nothing is left out.
    document["rod"] |= {
        key: getattr(scene, key) for key in ("inextensible", "plane") if getattr(scene, key)
    }
    if scene.segments is not None:
        document["rod"].pop("length")
        document["segments"] = [
            _shaped(x, schema.SEGMENT, f"{file} segments[{i}]")
            | ({} if x.intervals is None else {"intervals": x.intervals})
            for i, x in enumerate(scene.segments)
        ]
    if scene.tendons is not None:
        document["tendons"] = _tendons(scene.tendons, file)
    if scene.chambers is not None:
        pairs = zip(_plain(scene.chambers.areas), _plain(scene.chambers.offsets), strict=True)
        document["chambers"] = [
            {"area": a, "offset": x, **_of_each(scene.chambers, i, ("starts_at", "ends_at"))}
            for i, (a, x) in enumerate(pairs)
        ]
    if scene.payload is not None:
        document["payload"] = _values(scene.payload, schema.PAYLOAD)
    if scene.tip_load is not None:
        document["tip_load"] = _values(scene.tip_load, schema.TIP_LOAD)
    for name, keys in (("loads", schema.LOAD), ("masses", schema.MASS), ("markers", schema.MARKER)):
        if getattr(scene, name) is not None:
            document[name] = [_values(x, keys) for x in getattr(scene, name)]
    for table, load in zip(document.get("loads", []), scene.loads or (), strict=True):
        if load.force is None and load.moment is None:
            table["force"] = [0.0, 0.0, 0.0]
        if load.frame != "base":
            table["frame"] = load.frame
    for i, marker in enumerate(scene.markers or ()):
        document["markers"][i] = {"name": marker.name, **document["markers"][i]}
    if scene.contacts is not None:
        document["contacts"] = [
            ({} if x.name is None else {"name": x.name})
            | _with_shape(x.obstacle, _OBSTACLES, schema.OBSTACLES, f"{file} contacts[{i}]")
            | _values(x, schema.CONTACT)
            | ({"moves": True} if x.moves else {})
            for i, x in enumerate(scene.contacts)
        ]
        for table, name in zip(document["contacts"], contact_names(scene.contacts), strict=True):
            if "file" in schema.OBSTACLES[str(table["shape"])][1]:
                table["file"] = _grid_file(stem, name)
    if scene.base_moves:
        document["base"] = {"moves": True}
    return document


def _shaped(owner, keys: schema.Schema, where: str) -> dict:
    """The rod or a segment: its numbers, its sections and its stiffness."""
    table = _values(owner, keys)
    for name in ("section", "section_at_end"):
        section = getattr(owner, name)
        if section is not None:
            table[name] = _with_shape(section, _SECTIONS, schema.SECTIONS, f"{where}.{name}")
    if owner.stiffness is not None:
        table["stiffness"] = _values(owner.stiffness, schema.STIFFNESS)
    if owner.material is not None:
        place = f"{where}.material"
        table["material"] = _with_word("law", owner.material, _LAWS, schema.LAWS, place)
    return table


def _with_shape(part, shapes: dict, kinds: dict, where: str) -> dict:
    """A section or a path, of which there are several classes."""
    return _with_word("shape", part, shapes, kinds, where)


def _with_word(name: str, part, words: dict, kinds: dict, where: str) -> dict:
    """What there are several classes of, with the word for its own under `name`."""
    if type(part) not in words:
        raise SceneError(f"{where}: a {type(part).__name__} has no form in a scene file")
    word = words[type(part)]
    return {name: word, **_values(part, kinds[word][1])}


def _tendons(tendons, file: str) -> list[dict]:
    if type(tendons) is not Tendons:
        name = type(tendons).__name__
        raise SceneError(f"{file} tendons: {name} have no form in a scene file, only Tendons have")
    tables = []
    for i, offset in enumerate(_plain(tendons.offsets)):
        path, table = tendons.path(i), {}
        if path is None or any(offset):
            table["offset"] = offset
        if path is not None:
            table["path"] = _with_shape(path, _PATHS, schema.PATHS, f"{file} tendons[{i}].path")
        table |= _of_each(tendons, i, ("starts_at", "ends_at"))
        words = {"guided": "rod", "control": "tension"}
        table |= {k: w for k, usual in words.items() if (w := tendons.words(k)[i]) != usual}
        table |= _of_each(tendons, i, ("stiffness", "pretension", "friction", "backlash"))
        tables.append(table)
    return tables


def _of_each(actuators, i: int, names) -> dict:
    given = {name: getattr(actuators, name) for name in names}
    return {k: _plain(x[i]) for k, x in given.items() if x is not None and x[i] is not None}


def _values(part, keys: schema.Schema) -> dict:
    """The numbers of a part of the scene under their keys."""
    fields = {key: field for field, key in schema.PATH_KEYS.items()}
    numbers = {k: fields.get(k, k) for k, kind in keys.items() if isinstance(kind, schema.Numbers)}
    return {k: _plain(getattr(part, f)) for k, f in numbers.items() if getattr(part, f) is not None}


def _plain(x):
    return np.asarray(x, dtype=np.float64).tolist()


def toml(document: dict) -> str:
    """The text of a document of tables, with tables in them written inline."""
    lines = []
    for name, content in document.items():
        header, tables = (
            (f"[[{name}]]", content) if isinstance(content, list) else (f"[{name}]", [content])
        )
        for table in tables:
            lines += [header, *(f"{k} = {_toml_value(v)}" for k, v in table.items()), ""]
    return "\n".join(lines)


def _toml_value(value) -> str:
    match value:
        case bool():
            return str(value).lower()
        case str():
            return f'"{value}"'
        case dict():
            return "{ " + ", ".join(f"{k} = {_toml_value(v)}" for k, v in value.items()) + " }"
        case list():
            return "[" + ", ".join(_toml_value(v) for v in value) + "]"
    return repr(value)  # the shortest decimal that reads back as the same float64
