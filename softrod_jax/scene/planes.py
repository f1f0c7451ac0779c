"""What a scene may give up for fewer unknowns: stretch and shear, and the third dimension.

A scene in a plane keeps, of a vector (p, v, q, N), two components: across the rod and along z. Of a
turn (u, omega, M) it keeps the one about the plane's normal, and its attitude is an angle. In the
plane "xz" these are x, z and the turn about y; in "yz" they are y, z and minus the turn about x. A
turn then leads from z to the first axis in both, and both have the same equations.

What is not in the plane is refused: at once where numbers are known, with a result code where they
are traced.
"""

from collections.abc import Iterator
from typing import NamedTuple, overload

import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Bool, Float

from softrod_jax.scene.contacts import Plane, Sphere, Tube
from softrod_jax.scene.distance_grid import DistanceGrid
from softrod_jax.scene.materials import AbstractRubber
from softrod_jax.scene.scene import PLANES, Scene
from softrod_jax.scene.sections import Circle
from softrod_jax.scene.tendons import Tendons

# Components off the plane that are smaller than this part of the largest are rounding errors.
_ROUNDING = 1e-12
# As far as holes on both sides of a plane may differ, in terms of the radius around them.
_ALIKE = 1e-9
# As far as distances on a grid may differ on both sides of a plane, in its spacings.
_MIRRORED = 1e-6


@overload
def vector_in(plane: str | None, a: Array) -> Array: ...
@overload
def vector_in(plane: str | None, a: None) -> None: ...
def vector_in(
    plane: str | None, a: Float[Array, "*points 3"] | None
) -> Float[Array, "*points vector"] | None:
    """The components of a vector, or of numbers along the axes, that remain; all if no plane."""
    if plane is None or a is None:
        return a
    return jnp.stack([a[..., PLANES.index(plane)], a[..., 2]], -1)


@overload
def turn_in(plane: str | None, a: Array) -> Array: ...
@overload
def turn_in(plane: str | None, a: None) -> None: ...
def turn_in(
    plane: str | None, a: Float[Array, "*points 3"] | None
) -> Float[Array, "*points turn"] | None:
    """The component of a turn that remains; all if no plane."""
    if plane is None or a is None:
        return a
    return a[..., 1:2] if plane == "xz" else -a[..., :1]


@overload
def about_normal(plane: str | None, a: Array) -> Array: ...
@overload
def about_normal(plane: str | None, a: None) -> None: ...
def about_normal(
    plane: str | None, a: Float[Array, "*points n"] | None
) -> Float[Array, "*points turn"] | None:
    """Of numbers for turns about x, y (and z), that about the normal; all if no plane."""
    if plane is None or a is None:
        return a
    return a[..., 1:2] if plane == "xz" else a[..., :1]


def angle_in(plane: str, h: Float[Array, "4"]) -> Float[Array, "1"]:
    """The angle of a quaternion that turns in the plane."""
    return 2 * jnp.arctan2(turn_in(plane, h[1:]), h[:1])


def quaternion_in(plane: str | None, h: Float[Array, "n"]) -> Float[Array, "4"]:
    """The quaternion of an attitude, which in a plane has cosine and sine of half the angle."""
    if plane is None:
        return h
    (c, s), o = h, jnp.zeros(())
    return jnp.stack([c, o, s, o] if plane == "xz" else [c, -s, o, o])


def in_space(pair: Float[Array, "*points n"], plane: str | None) -> Float[Array, "*points 6"]:
    """A vector and a turn with all their components: zeros for those off the plane."""
    if plane is None:
        return pair
    across, along, turn = (pair[..., i] for i in range(3))
    o = jnp.zeros_like(across)
    if plane == "xz":
        return jnp.stack([across, o, along, o, turn, o], -1)
    return jnp.stack([o, across, along, -turn, o, o], -1)


class _Part(NamedTuple):
    """A number of the scene by its key in a scene file, and its components off the plane."""

    key: str
    value: Array | np.ndarray
    off: tuple[int, ...]
    names: str


def _parts(scene: Scene) -> list[_Part]:
    """What must be in the scene's plane."""
    normal = 1 - PLANES.index(scene.plane)
    turns = tuple(i for i in range(3) if i != normal)
    named = lambda off: " and ".join("xyz"[i] for i in off)
    vector, turn = ((normal,), named((normal,))), (turns, named(turns))
    # Of a quaternion (w, x, y, z).
    quaternion = (tuple(i + 1 for i in turns), named(turns))
    load, chambers = scene.tip_load, scene.chambers
    rests = [("rod", scene)] + [(f"segments[{i}]", x) for i, x in enumerate(scene.segments or ())]
    loads = [("tip_load", load)] if load is not None else []
    loads += [(f"loads[{i}]", x) for i, x in enumerate(scene.loads or ())]
    parts = [
        ("rod.gravity", scene.gravity, *vector),
        *((f"{key}.rest_stretch", x.rest_stretch, *vector) for key, x in rests),
        *((f"{key}.rest_curvature", x.rest_curvature, *turn) for key, x in rests),
        ("rod.base_quaternion", scene.base_quaternion, *quaternion),
        *((f"{key}.force", x.force, *vector) for key, x in loads),
        *((f"{key}.moment", x.moment, *turn) for key, x in loads),
        *((key, value, *vector) for key, value in _routes(scene)),
        ("chambers", None if chambers is None else chambers.offsets, *vector),
        *((key, value, *vector) for key, value in _obstacles(scene)),
    ]
    return [_Part(*part) for part in parts if part[1] is not None]


def vectors_off(plane: str, a: np.ndarray) -> np.ndarray:
    """Whether each of these vectors, (rows, 3), has a component off the plane."""
    off = np.abs(a[:, 1 - PLANES.index(plane)])
    return off > _ROUNDING * np.max(np.abs(a), initial=1e-300)


def turns_off(plane: str, a: np.ndarray) -> np.ndarray:
    """Whether each of these turns, (rows, 3), is about another axis than the plane's normal."""
    normal = 1 - PLANES.index(plane)
    others = [i for i in range(3) if i != normal]
    return np.max(np.abs(a[:, others]), axis=-1) > _ROUNDING * np.max(np.abs(a), initial=1.0)


def _routes(scene: Scene):
    """Where the tendons run in the section; those that vary along the rod, at many points."""
    tendons, x = scene.tendons, jnp.linspace(0.0, 1.0, 33)
    if tendons is None:
        return
    if type(tendons) is not Tendons:
        yield "tendons", tendons.routing(scene.length * x)[0]
    elif tendons.paths is None:
        yield "tendons", tendons.offsets
    else:
        for i, path in enumerate(tendons.paths):
            start, end = tendons.part(i, scene.length)
            if path is None:
                yield f"tendons[{i}].offset", tendons.offsets[i]
            else:
                yield (
                    f"tendons[{i}].path",
                    tendons.place(i, start + (end - start) * x, scene.length),
                )


def _obstacles(scene: Scene):
    """What the obstacles of this package are the same on both sides of, from the clamp on."""
    base = 0.0 if scene.base_position is None else scene.base_position
    for i, contact in enumerate(scene.contacts or ()):
        shape, key = contact.obstacle, f"contacts[{i}]"
        if isinstance(shape, Plane):
            yield f"{key}.normal", shape.normal
        elif isinstance(shape, Sphere):
            yield f"{key}.center", shape.center - base
        elif isinstance(shape, Tube):
            yield f"{key}.axis", shape.axis - base


def _off_plane(part: _Part, module) -> Bool[Array | np.ndarray, "*rows"] | np.bool:
    """Whether it leaves the plane, of each row; `module` is numpy or jax.numpy."""
    size = module.abs(part.value)
    limit = _ROUNDING * module.max(size)
    # What is not a number is not in the plane.
    return ~module.all(size[..., list(part.off)] <= limit, axis=-1)


def fits_plane(scene: Scene) -> Bool[Array, ""]:
    """Whether everything is in the scene's plane; its numbers may be traced."""
    fits = jnp.array(True)
    for part in _parts(scene):
        fits &= ~jnp.any(_off_plane(part, jnp))
    for _, holes, radius in _holes(scene):
        fits &= _is_mirrored(holes, radius, scene.plane or PLANES[0])
    for _, grid in _grids(scene):
        fits &= _is_mirror_image(grid, scene, jnp)
    return fits


def _grids(scene: Scene):
    for i, contact in enumerate(scene.contacts or ()):
        if isinstance(contact.obstacle, DistanceGrid):
            yield f"contacts[{i}]", contact.obstacle


def _is_mirror_image(grid: DistanceGrid, scene: Scene, module):
    """Whether distances on a grid are the same on both sides of the plane through the clamp."""
    normal = 1 - PLANES.index(scene.plane or PLANES[0])
    spacing = module.broadcast_to(grid.spacing, (3,))[normal]
    base = 0.0 if scene.base_position is None else scene.base_position[normal]
    middle = grid.origin[normal] + spacing * (grid.values.shape[normal] - 1) / 2
    apart = module.max(module.abs(grid.values - module.flip(grid.values, normal)))
    limit = _MIRRORED * spacing
    return (module.abs(middle - base) <= limit) & (apart <= limit)


def _holes(scene: Scene):
    """Those in sections of rubber: the key, (holes, 3), and the radius around them."""
    prefix = "rod" if scene.segments is None else "segments[{}]"
    for i, part in enumerate(scene.parts):
        if isinstance(part.material, AbstractRubber):
            for name in ("section", "section_at_end"):
                section = getattr(part, name)
                if isinstance(section, Circle) and section.holes is not None:
                    yield f"{prefix.format(i)}.{name}.holes", section.holes, section.radius


def _is_mirrored(holes, radius, plane: str):
    """Whether they are the same on both sides of the plane, as odd moments tell.

    Where stiffness changes with strain, a section that bends in a plane stays in it only so.
    """
    across, off = (holes[:, i] / radius for i in (PLANES.index(plane), 1 - PLANES.index(plane)))
    weight = holes[:, 2] ** 2
    odd = [weight @ (across**i * off**j) for j in (1, 3, 5) for i in range(6 - j)]
    return (abs(jnp.stack(odd)) <= _ALIKE * weight.sum()).all()


def misfits(scene: Scene) -> Iterator[tuple[str, object, str]]:
    """What contradicts the scene's restrictions, where numbers are known: key, value, remedy."""
    if scene.inextensible:
        yield from _without_meaning(scene)
    if scene.plane is None:
        return
    for part in _parts(scene):
        if isinstance(part.value, Tracer):
            continue
        value = np.asarray(part.value)
        rows = np.atleast_1d(np.argwhere(_off_plane(part._replace(value=value), np)))
        of_each = value.ndim > 1 and not part.key.endswith((".path", ".axis"))
        for row in rows if of_each else rows[:1]:
            yield (
                f"{part.key}[{row[-1]}].offset" if of_each else part.key,
                value[tuple(row)].tolist(),
                f'not in the plane "{scene.plane}" of the scene; expected 0 for {part.names}, '
                "or no plane",
            )
    for key, grid in _grids(scene):
        if not any(isinstance(x, Tracer) for x in (*vars(grid).values(), scene.base_position)):
            if not _is_mirror_image(grid, scene, np):
                remedy = (
                    f'not the same on both sides of the plane "{scene.plane}" through the clamp'
                )
                shown = f"a grid of shape {grid.values.shape}"
                yield f"{key}.values", shown, remedy + "; expected that, or no plane"
    for key, holes, radius in _holes(scene):
        if not isinstance(holes, Tracer) and not isinstance(radius, Tracer):
            if not _is_mirrored(holes, radius, scene.plane):
                remedy = f'not the same on both sides of the plane "{scene.plane}"; turn them'
                yield key, np.asarray(holes).tolist(), remedy + ", or no plane"


def _without_meaning(scene: Scene) -> Iterator[tuple[str, object, str]]:
    """What an inextensible rod has no use for."""
    owners = [("rod", scene)] + [(f"segments[{i}]", x) for i, x in enumerate(scene.segments or ())]
    for key, owner in owners:
        for name in ("shear_damping", "shear_correction"):
            value = getattr(owner, name)
            if value is not None:
                shown = value if isinstance(value, Tracer) else np.asarray(value).tolist()
                yield (
                    f"{key}.{name}",
                    shown,
                    f"an inextensible rod does not stretch or shear; leave {name} out, "
                    "or inextensible",
                )
