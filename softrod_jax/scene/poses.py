"""Poses of what is carried in a motion, the base and obstacles, and their checks."""

from collections.abc import Mapping
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from softrod_jax.foundation.numbers import RowsLike
from softrod_jax.foundation.tracing import is_traced
from softrod_jax.scene.contacts import contact_names
from softrod_jax.scene.planes import turns_off, vectors_off
from softrod_jax.scene.scene import Scene

PosesLike = RowsLike | tuple[RowsLike, RowsLike]
# What cameras and robots give is of length one as well as this; it is made so.
_ABOUT_ONE = 0.01


class Poses(NamedTuple):
    """Of the base and of each obstacle, (steps, 7), at the ends of steps; `None`: stands still."""

    base: Float[Array, "steps 7"] | None = None
    obstacles: tuple[Float[Array, "steps 7"] | None, ...] = ()

    @property
    def named(self) -> dict[str, Float[Array, "steps 7"]]:
        """Those that there are, by the name in messages."""
        own = {"base": self.base, **{f"contacts[{i}]": x for i, x in enumerate(self.obstacles)}}
        return {name: x for name, x in own.items() if x is not None}


def checked_poses(
    who: str, scene: Scene, base: PosesLike | None, contacts: Mapping[str, PosesLike] | None
) -> Poses:
    """The poses as arrays, quaternions of length one.

    Given are rows (steps, 7), or a pair of positions (steps, 3) and quaternions (steps, 4).
    `contacts`: by the name of the obstacle. Raises `ValueError` for a name that no contact has, a
    wrong shape, a value that is not finite, a quaternion that is none, and what leaves the plane.
    """
    names, given = contact_names(scene.contacts), dict(contacts or {})
    for name in given:
        if name not in names:
            has = f"it has {', '.join(names)}" if names else "it has none"
            raise ValueError(f"{who}: contacts has {name!r}, no contact of the scene; {has}")
    if base is not None:
        base = _checked(who, scene, "base", base)
    own = {k: _checked(who, scene, f"contacts[{k!r}]", rows) for k, rows in given.items()}
    return Poses(base, tuple(own.get(name) for name in names) if own else ())


def checked_pose(
    who: str, scene: Scene, base: PosesLike | None, contacts: Mapping[str, PosesLike] | None
) -> Poses:
    """As `checked_poses`, of one step: (7,) each, or a pair of (3,) and (4,)."""
    rows = {k: _as_row(x) for k, x in (contacts or {}).items()}
    poses = checked_poses(who, scene, None if base is None else _as_row(base), rows)
    first = lambda x: None if x is None else x[0]
    return Poses(first(poses.base), tuple(map(first, poses.obstacles)))


def _as_row(given):
    """One pose as a list of one; what is none is refused as such rows are."""
    if isinstance(given, tuple | list) and len(given) == 2:
        return tuple(jnp.asarray(x, dtype=float)[None] for x in given)
    return jnp.asarray(given, dtype=float)[None]


def _checked(who, scene, name, given):
    try:
        rows = _in_rows(given)
    except (TypeError, ValueError):
        raise ValueError(f"{who}: {name} = {given!r} is not an array of numbers") from None
    if rows.ndim != 2 or rows.shape[-1] != 7:
        raise ValueError(
            f"{who}: {name} has shape {rows.shape}; (steps, 7) is needed: position [m] and "
            "quaternion (w, x, y, z)"
        )
    if not is_traced(given):
        _refuse_bad(who, scene, name, np.asarray(rows))
    square = jnp.sum(rows[:, 3:] ** 2, -1, keepdims=True)
    good = jnp.abs(square - 1) < 2.1 * _ABOUT_ONE
    unit = rows[:, 3:] / jnp.sqrt(jnp.where(good, square, 1.0))
    return jnp.concatenate([rows[:, :3], jnp.where(good, unit, jnp.nan)], -1)


def _in_rows(given):
    """One array; positions and quaternions may also be a pair of two."""
    if isinstance(given, tuple | list) and len(given) == 2:
        p, h = (jnp.asarray(x, dtype=float) for x in given)
        if p.ndim == h.ndim == 2:
            return jnp.concatenate([p, h], -1)
    return jnp.asarray(given, dtype=float)


def _refuse_bad(who, scene, name, rows):
    if not np.all(np.isfinite(rows)):
        raise ValueError(f"{who}: {name} has a value that is not finite")
    size = np.linalg.norm(rows[:, 3:], axis=-1)
    worst = int(np.argmax(np.abs(size - 1)))
    if abs(size[worst] - 1) > _ABOUT_ONE:
        raise ValueError(
            f"{who}: the quaternion of {name}[{worst}], {rows[worst, 3:].tolist()}, has the norm "
            f"{size[worst]:.4g}; expected 1"
        )
    if scene.plane is None:
        return
    at_first = np.zeros(3) if scene.base_position is None else np.asarray(scene.base_position)
    start = at_first if name == "base" else np.zeros(3)
    off = vectors_off(scene.plane, rows[:, :3] - start) | turns_off(scene.plane, rows[:, 4:])
    if off.any():
        k = int(np.argmax(off))
        raise ValueError(
            f'{who}: {name}[{k}], {rows[k].tolist()}, leaves the plane "{scene.plane}" of the '
            "scene; leave plane out"
        )
