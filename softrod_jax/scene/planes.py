"""What a scene may give up for fewer unknowns: stretch and shear, and the third dimension.

A scene in a plane keeps, of a vector (p, v, q, N), two components: across the rod and along z. Of a
turn (u, omega, M) it keeps the one about the plane's normal, and its attitude is an angle. In the
plane "xz" these are x, z and the turn about y; in "yz" they are y, z and minus the turn about x. A
turn then leads from z to the first axis in both, and both have the same equations.

What is not in the plane is refused: at once where numbers are known, with a result code where they
are traced.
"""

from collections.abc import Iterator
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from softrod_jax.scene.scene import PLANES, Scene
from softrod_jax.scene.tendons import Tendons

# Components off the plane that are smaller than this part of the largest are rounding errors.
_ROUNDING = 1e-12


def vector_in(plane: str | None, a: Float[Array, "*points 3"] | None):
    """The components of a vector, or of numbers along the axes, that remain; all if no plane."""
    if plane is None or a is None:
        return a
    return jnp.stack([a[..., PLANES.index(plane)], a[..., 2]], -1)


def turn_in(plane: str | None, a: Float[Array, "*points 3"] | None):
    """The component of a turn that remains; all if no plane."""
    if plane is None or a is None:
        return a
    return a[..., 1:2] if plane == "xz" else -a[..., :1]


def about_normal(plane: str | None, a: Float[Array, "n"] | None):
    """Of numbers for turns about x, y (and z), that about the normal; all if no plane."""
    if plane is None or a is None:
        return a
    return a[..., 1:2] if plane == "xz" else a[..., :1]


def angle_in(plane: str, h: Float[Array, "4"]) -> Float[Array, "1"]:
    """The angle of a quaternion that turns in the plane."""
    return 2 * jnp.arctan2(turn_in(plane, h[1:]), h[:1])


def quaternion_in(plane: str | None, h: Float[Array, "n"]) -> Float[Array, "4"]:
    """The quaternion of an attitude, which is an angle in a plane."""
    if plane is None:
        return h
    a, o = 0.5 * h[0], jnp.zeros(())
    turn = (o, jnp.sin(a), o) if plane == "xz" else (-jnp.sin(a), o, o)
    return jnp.stack([jnp.cos(a), *turn])


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
    value: Array
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
    load, tendons, chambers = scene.tip_load, scene.tendons, scene.chambers
    parts = [
        ("rod.gravity", scene.gravity, *vector),
        ("rod.rest_stretch", scene.rest_stretch, *vector),
        ("rod.rest_curvature", scene.rest_curvature, *turn),
        ("rod.base_quaternion", scene.base_quaternion, *quaternion),
        ("tip_load.force", None if load is None else load.force, *vector),
        ("tip_load.moment", None if load is None else load.moment, *turn),
        ("tendons", None if tendons is None else _routes(tendons, scene.length), *vector),
        ("chambers", None if chambers is None else chambers.offsets, *vector),
    ]
    return [_Part(*part) for part in parts if part[1] is not None]


def _routes(tendons, length):
    """Where the tendons run in the section; of those that vary along the rod, at many points."""
    if type(tendons) is Tendons:
        return tendons.offsets
    return tendons.routing(length * jnp.linspace(0.0, 1.0, 33))[0]


def _off_plane(part: _Part, module) -> Bool[Array, "*rows"]:
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
    return fits


def misfits(scene: Scene) -> Iterator[tuple[str, object, str]]:
    """What contradicts the scene's restrictions, where numbers are known: key, value, remedy."""
    if scene.inextensible:
        for name in ("shear_damping", "shear_correction"):
            value = getattr(scene, name)
            if value is not None:
                shown = value if isinstance(value, jax.core.Tracer) else np.asarray(value).tolist()
                yield (
                    f"rod.{name}",
                    shown,
                    (
                        "an inextensible rod does not stretch or shear; "
                        f"leave {name} out, or inextensible"
                    ),
                )
    if scene.plane is None:
        return
    for part in _parts(scene):
        if isinstance(part.value, jax.core.Tracer):
            continue
        value = np.asarray(part.value)
        for row in np.atleast_1d(np.argwhere(_off_plane(part._replace(value=value), np))):
            is_list = value.ndim > 1
            yield (
                f"{part.key}[{row[-1]}].offset" if is_list else part.key,
                value[tuple(row)].tolist(),
                f'not in the plane "{scene.plane}" of the scene; expected 0 for {part.names}, '
                "or no plane",
            )
