"""What the tables of a scene file become: a checked `Scene`, or an error that names the key."""

import dataclasses
from collections.abc import Callable, Iterable, Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from softrod_jax.scene import schema
from softrod_jax.scene.chambers import Chambers
from softrod_jax.scene.checks import impossible
from softrod_jax.scene.contacts import Contact
from softrod_jax.scene.distance_grid import DistanceGrid
from softrod_jax.scene.loads import Load, Marker, Mass, Payload, TipLoad
from softrod_jax.scene.planes import misfits
from softrod_jax.scene.scene import Scene, as_arrays
from softrod_jax.scene.schema import SceneError, complaint, read_table
from softrod_jax.scene.segments import Segment, Stiffness
from softrod_jax.scene.silicones import silicone
from softrod_jax.scene.tendons import Tendons

# An end this close to the tip, in lengths of the rod, is the tip: lengths add up with rounding.
_AT_THE_TIP = 1e-12


def scene_of(document: dict, file: str, grid_of: Callable[[str], DistanceGrid]) -> Scene:
    """The checked scene of a parsed document; `file` begins every message.

    `grid_of`: the grid of distances by the name of its file, or a `ValueError`.
    """
    top = read_table(document, schema.SCENE, file)
    rod = _shaped(top["rod"], schema.ROD, f"{file} rod")
    segments = [
        Segment(**_shaped(table, schema.SEGMENT, where, rod))
        for table, where in _each(top, "segments", file)
    ]
    if "segments" in top:
        _only_segments(top, rod, file)
    for i, segment in enumerate(segments):
        _linear_with_moduli(top["segments"][i], segment, rod, f"{file} segments[{i}]")
    mass = None
    if "payload" in top:
        mass = read_table(top["payload"], schema.PAYLOAD, f"{file} payload")["mass"]
    load = read_table(top.get("tip_load", {}), schema.TIP_LOAD, f"{file} tip_load")
    base = read_table(top["base"], schema.BASE, f"{file} base") if "base" in top else {}
    has_load = any(x is not None for x in load.values())
    scene = as_arrays(
        Scene(
            **rod,
            segments=tuple(segments) or None,
            tendons=_tendons(list(_each(top, "tendons", file))),
            chambers=_chambers(list(_each(top, "chambers", file))),
            payload=None if mass is None else Payload(mass),
            tip_load=TipLoad(**load) if has_load else None,
            loads=[_load(*entry) for entry in _each(top, "loads", file)],
            masses=[Mass(**read_table(x, schema.MASS, w)) for x, w in _each(top, "masses", file)],
            markers=[
                Marker(**read_table(x, schema.MARKER, w)) for x, w in _each(top, "markers", file)
            ],
            contacts=[_contact(*entry, grid_of) for entry in _each(top, "contacts", file)],
            base_moves=base.get("moves", False),
        )
    )
    for key, value, remedy in (*impossible(scene), *misfits(scene)):
        raise SceneError(complaint(f"{file} {key}", value, remedy))
    return _without_nothing(_unit(scene))


def _each(top: dict, name: str, file: str):
    """The tables of this name, each with the beginning of its messages."""
    for i, table in enumerate(top.get(name, [])):
        yield table, f"{file} {name}[{i}]"


def _shaped(table: dict, keys: schema.Schema, where: str, rod: Iterable[str] = ()) -> dict:
    """The values of [rod], or of a segment of a rod with the keys `rod`: sections, stiffness."""
    values = read_table(table, keys, where)
    for name in ("section", "section_at_end"):
        if name in values:
            values[name] = _section(values[name], f"{where}.{name}")
    if "section_at_end" in values and "section" in values:
        shape, other = (table[name]["shape"] for name in ("section", "section_at_end"))
        if shape != other:
            remedy = f'expected "{shape}", as the section begins'
            raise SceneError(complaint(f"{where}.section_at_end.shape", other, remedy))
    if "stiffness" in values:
        numbers = read_table(values["stiffness"], schema.STIFFNESS, f"{where}.stiffness")
        values["stiffness"] = Stiffness(**numbers)
    material = values.get("material")
    if isinstance(material, str):
        values["material"], density = silicone(material)
        # What is weighed is better known than what a name says.
        if not {"density", "linear_density"} & {*values, *rod}:
            values["density"] = density
    elif material is not None:
        values["material"] = _law(material, f"{where}.material")
    return values


def _law(table: dict, where: str):
    """The law of a material; `None` for the linear one."""
    if table.get("law") == schema.LINEAR:
        read_table(table, {"law": schema.LAW}, where)
        return None
    return _one_of(table, "law", schema.LAW, schema.LAWS, where)


def _only_segments(top: dict, rod: dict, file: str) -> None:
    """Raise `SceneError` for segments beside a length and a section, or if there are none."""
    if not top["segments"]:
        raise SceneError(
            complaint(f"{file} segments", [], "expected one at least; or leave it out")
        )
    for name in ("length", "section", "section_at_end"):
        if name in rod:
            remedy = f"each of the segments has its own; leave {name} out, or the segments"
            raise SceneError(complaint(f"{file} rod.{name}", top["rod"][name], remedy))


def _linear_with_moduli(table: dict, segment: Segment, rod: dict, where: str) -> None:
    """Raise `SceneError` for a linear segment of a rod of rubber that does not say how stiff."""
    own = segment.young_modulus is not None or segment.stiffness is not None
    if "material" in table and segment.material is None and rod.get("material") and not own:
        remedy = "the rod has another law; give young_modulus and poisson_ratio, too, or stiffness"
        raise SceneError(complaint(f"{where}.material.law", schema.LINEAR, remedy))


def _section(table: dict, where: str):
    return jax.tree.map(jnp.asarray, _of_shape(table, schema.SHAPE, schema.SECTIONS, where))


def _of_shape(
    table: dict, word: schema.Word, kinds: Mapping[Any, tuple[Callable, schema.Schema]], where: str
):
    """A section or a path: one of several classes, by the table's `shape`."""
    return _one_of(table, "shape", word, kinds, where)


def _one_of(
    table: dict,
    name: str,
    word: schema.Word,
    kinds: Mapping[Any, tuple[Callable, schema.Schema]],
    where: str,
):
    """One of several classes, by the word that the table has under `name`."""
    if name not in table:
        raise SceneError(f"{where}.{name} is missing: expected one of {', '.join(word.words)}")
    kind, keys = kinds[word.read(table[name], f"{where}.{name}")]
    values = read_table(table, {name: word, **keys}, where)
    fields = {key: field for field, key in schema.PATH_KEYS.items()}
    return kind(**{fields.get(k, k): v for k, v in values.items() if k != name})


def _tendons(entries: list) -> Tendons | None:
    if not entries:
        return None
    tables = [read_table(table, schema.TENDON, where) for table, where in entries]
    for table, (_, where) in zip(tables, entries, strict=True):
        if "offset" not in table and "path" not in table:
            expected = f"expected {schema.TENDON['offset']}, or a path"
            raise SceneError(complaint(f"{where}.offset", None, expected))
        if "path" in table:
            place = f"{where}.path"
            table["path"] = _of_shape(table["path"], schema.PATH_SHAPE, schema.PATHS, place)
    return Tendons(
        np.stack([table.get("offset", np.zeros(2)) for table in tables]),
        paths=[table.get("path") for table in tables],
        starts_at=[table.get("starts_at") for table in tables],
        ends_at=[table.get("ends_at") for table in tables],
        guided=[table.get("guided", "rod") for table in tables],
        control=[table.get("control", "tension") for table in tables],
        stiffness=[table.get("stiffness") for table in tables],
        pretension=[table.get("pretension") for table in tables],
        friction=[table.get("friction") for table in tables],
        backlash=[table.get("backlash") for table in tables],
    )


def _chambers(entries: list) -> Chambers | None:
    if not entries:
        return None
    tables = [read_table(table, schema.CHAMBER, where) for table, where in entries]
    return Chambers(
        np.stack([table["area"] for table in tables]),
        np.stack([table["offset"] for table in tables]),
        starts_at=[table.get("starts_at") for table in tables],
        ends_at=[table.get("ends_at") for table in tables],
    )


def _load(table: dict, where: str) -> Load:
    values = read_table(table, schema.LOAD, where)
    if "force" not in table and "moment" not in table:
        expected = f"expected {schema.LOAD['force']}, or a moment"
        raise SceneError(complaint(f"{where}.force", None, expected))
    return Load(**values)


def _contact(table: dict, where: str, grid_of: Callable[[str], DistanceGrid]) -> Contact:
    def of_kind(kind, own: schema.Schema, values: dict) -> Contact:
        keys = {key: values.pop(key) for key in own}
        obstacle = _grid(keys["file"], where, grid_of) if kind is DistanceGrid else kind(**keys)
        return Contact(obstacle, **values)

    kinds = {
        word: (
            lambda kind=kind, own=own, **values: of_kind(kind, own, values),
            {**own, **schema.CONTACT},
        )
        for word, (kind, own) in schema.OBSTACLES.items()
    }
    return _of_shape(table, schema.OBSTACLE, kinds, where)


def _grid(name: str, where: str, grid_of: Callable[[str], DistanceGrid]) -> DistanceGrid:
    try:
        return grid_of(name)
    except ValueError as e:
        raise SceneError(complaint(f"{where}.file", name, str(e))) from None


def _without_nothing(scene: Scene) -> Scene:
    """Without loads of zero, and with ends of actuators that are those of the rod left out."""
    loads = tuple(x for x in scene.loads or () if x.force is not None or x.moment is not None)
    masses = tuple(x for x in scene.masses or () if x.mass != 0)
    changes = {"loads": loads, "masses": masses}
    for name in ("tendons", "chambers"):
        part = getattr(scene, name)
        if part is not None:
            starts = [None if x is None or x == 0 else x for x in part.starts_at or ()]
            ends = [
                None if x is None or x >= scene.length * (1 - _AT_THE_TIP) else x
                for x in part.ends_at or ()
            ]
            changes[name] = dataclasses.replace(
                part, starts_at=starts or None, ends_at=ends or None
            )
    return dataclasses.replace(scene, **changes)


def _unit(scene: Scene) -> Scene:
    """With the quaternion of the clamp normalised, to rounding."""
    h = scene.base_quaternion
    # One that is so already stays as it is, so that saving and loading is exact.
    if h is None or abs(np.linalg.norm(h) - 1) < 4e-16:
        return scene
    return dataclasses.replace(scene, base_quaternion=h / np.linalg.norm(h))
