"""Scene files: a `Scene` from TOML and back.

SI units. A key or a table that is absent means that the effect is not in the scene. The format
itself is the tables of `schema.py`; here are reading, writing and the checks that need two
keys at once (a tendon must lie inside the section, a tube's bore be smaller than the tube, all be
in the scene's plane).
"""

import dataclasses
import tomllib
from os import PathLike
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from softrod_jax.foundation.precision import require_float64
from softrod_jax.foundation.whole_files import whole_file
from softrod_jax.scene import schema
from softrod_jax.scene.chambers import Chambers
from softrod_jax.scene.checks import impossible
from softrod_jax.scene.loads import Payload, TipLoad
from softrod_jax.scene.planes import misfits
from softrod_jax.scene.scene import Scene, as_arrays
from softrod_jax.scene.schema import SceneError, complaint, read_table
from softrod_jax.scene.sections import Annulus, Circle, GeneralSection, Rectangle
from softrod_jax.scene.tendons import Tendons


def load_scene(path: str | PathLike) -> Scene:
    """The scene in the TOML file `path`: a pytree of float64 arrays.

    Zero damping, drag, gravity or payload is the same as none, and gives `None`.

    Raises `SceneError` (a `ValueError`) if the file cannot be read or is not TOML, for an
    unknown or missing key, a wrong type, or an impossible value; the message names the file,
    the key, the value and what is allowed. Raises `ValueError` if JAX is not set to float64.
    """
    require_float64("load_scene")
    try:
        # Some editors begin a file with a mark of the encoding.
        text = Path(path).read_bytes().decode("utf-8-sig")
    except UnicodeDecodeError as e:
        raise SceneError(f"{path}: not UTF-8 text (byte {e.start}): save it as UTF-8") from None
    except (OSError, ValueError) as e:
        reason = getattr(e, "strerror", None) or e
        raise SceneError(f"{path}: cannot read the scene file: {reason}") from None
    try:
        document = tomllib.loads(text)
    except tomllib.TOMLDecodeError as e:
        raise SceneError(f"{path}: not a TOML file: {e}") from None
    except RecursionError:
        raise SceneError(
            f"{path}: not a TOML file that can be read: brackets nested too deep; a scene has "
            "tables in tables, and no more"
        ) from None
    except ValueError:  # Python reads whole numbers of some thousand digits only
        raise SceneError(
            f"{path}: not a TOML file that can be read: a whole number of too many digits; write "
            "it as 1e9"
        ) from None
    # Its numbers are known, also where something is traced.
    with jax.ensure_compile_time_eval():
        return _scene(document, f"{path}:")


def save_scene(scene: Scene, path: str | PathLike) -> None:
    """Write `scene` to `path`, so that `load_scene(path)` gives the same numbers, bit by bit.

    Raises `SceneError` if the scene could not be read back (an impossible value, a batch of
    scenes, tendons that are not straight) and `OSError` if the file cannot be written.
    """
    if any(isinstance(x, jax.core.Tracer) for x in jax.tree.leaves(scene)):
        raise SceneError(f"{path}: the scene is traced and has no numbers yet; save it outside jit")
    document = _document(scene, f"{path}:")
    with jax.ensure_compile_time_eval():
        _scene(document, f"{path}:")
    with whole_file(path, encoding="utf-8") as file:
        file.write(_toml(document))


def _scene(document: dict, file: str) -> Scene:
    """The checked scene of a parsed document; `file` begins every message."""
    top = read_table(document, schema.SCENE, file)
    rod = read_table(top["rod"], schema.ROD, f"{file} rod")
    rod["section"] = section = _section(rod["section"], f"{file} rod.section")
    tendons = [
        _placed(entry, schema.TENDON, section, f"{file} tendons[{i}]")
        for i, entry in enumerate(top.get("tendons", []))
    ]
    chambers = [
        _placed(entry, schema.CHAMBER, section, f"{file} chambers[{i}]")
        for i, entry in enumerate(top.get("chambers", []))
    ]
    mass = None
    if "payload" in top:
        mass = read_table(top["payload"], schema.PAYLOAD, f"{file} payload")["mass"]
    load = read_table(top.get("tip_load", {}), schema.TIP_LOAD, f"{file} tip_load")
    has_load = any(x is not None for x in load.values())
    scene = as_arrays(
        Scene(
            **rod,
            tendons=Tendons(_stack(tendons, "offset")) if tendons else None,
            chambers=(
                Chambers(_stack(chambers, "area"), _stack(chambers, "offset")) if chambers else None
            ),
            payload=None if mass is None else Payload(mass),
            tip_load=TipLoad(**load) if has_load else None,
        )
    )
    for key, value, remedy in (*impossible(scene), *misfits(scene)):
        raise SceneError(complaint(f"{file} {key}", value, remedy))
    return _unit(scene)


def _stack(entries: list[dict], key: str):
    return jnp.asarray(np.stack([entry[key] for entry in entries]))


def _section(table: dict, where: str):
    if "shape" not in table:
        raise SceneError(f"{where}.shape is missing: expected one of {', '.join(schema.SECTIONS)}")
    shape = schema.SHAPE.read(table["shape"], f"{where}.shape")
    kind, keys = schema.SECTIONS[shape]
    values = read_table(table, {"shape": schema.SHAPE, **keys}, where)
    del values["shape"]
    section = jax.tree.map(jnp.asarray, kind(**values))
    return section


def _placed(table: dict, keys: schema.Schema, section, where: str) -> dict:
    """A tendon or a chamber: its values, if it fits into the section."""
    values = read_table(table, keys, where)
    if not bool(section.contains(values["offset"])):
        raise SceneError(
            complaint(
                f"{where}.offset",
                table["offset"],
                f"outside the section; expected x and y [m] within {_outline(section)}",
            )
        )
    if "area" in values and values["area"] > _outline_area(section):
        raise SceneError(
            complaint(
                f"{where}.area",
                table["area"],
                f"larger than the section itself; expected at most "
                f"{_outline_area(section):.6g} [m^2]",
            )
        )
    return values


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
            return float(jnp.pi * section.outer_radius**2)
        case GeneralSection():
            return float("inf")  # its outline is unknown
    return float(section.area)


def _unit(scene: Scene) -> Scene:
    """With the quaternion of the clamp normalised, to rounding."""
    h = scene.base_quaternion
    # One that is so already stays as it is, so that saving and loading is exact.
    if h is None or abs(np.linalg.norm(h) - 1) < 4e-16:
        return scene
    return dataclasses.replace(scene, base_quaternion=h / np.linalg.norm(h))


def _document(scene: Scene, file: str) -> dict:
    """The scene as the nested dictionary that its file would parse to."""
    shapes = {kind: shape for shape, (kind, _) in schema.SECTIONS.items()}
    if type(scene.section) not in shapes:
        name = type(scene.section).__name__
        raise SceneError(f"{file} rod.section: a {name} has no form in a scene file")
    if scene.tendons is not None and type(scene.tendons) is not Tendons:
        name = type(scene.tendons).__name__
        raise SceneError(f"{file} tendons: {name} have no form in a scene file, only straight ones")
    shape = shapes[type(scene.section)]
    section = {"shape": shape, **_values(scene.section, schema.SECTIONS[shape][1])}
    document = {"rod": {**_values(scene, schema.ROD), "section": section}}
    # Static, and so at hand as they are; one that restricts nothing is left out.
    document["rod"] |= {
        key: getattr(scene, key) for key in ("inextensible", "plane") if getattr(scene, key)
    }
    if scene.tendons is not None:
        document["tendons"] = [{"offset": x} for x in _plain(scene.tendons.offsets)]
    if scene.chambers is not None:
        pairs = zip(_plain(scene.chambers.areas), _plain(scene.chambers.offsets), strict=True)
        document["chambers"] = [{"area": a, "offset": x} for a, x in pairs]
    if scene.payload is not None:
        document["payload"] = _values(scene.payload, schema.PAYLOAD)
    if scene.tip_load is not None:
        document["tip_load"] = _values(scene.tip_load, schema.TIP_LOAD)
    return document


def _values(part, keys: schema.Schema) -> dict:
    """The numbers of a part of the scene under their keys."""
    numbers = [key for key, kind in keys.items() if isinstance(kind, schema.Numbers)]
    return {key: _plain(getattr(part, key)) for key in numbers if getattr(part, key) is not None}


def _plain(x):
    return np.asarray(x, dtype=np.float64).tolist()


def _toml(document: dict) -> str:
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
