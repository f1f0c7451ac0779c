"""Where the base and obstacles are carried in a recording: columns of a log, and poses between its
rows.

A pose is a position [m] and a unit quaternion (w, x, y, z), in the scene's frame. The base is where
its pose says, from the first row on. An obstacle is where the scene has it, moved by its pose.
"""

from collections.abc import Mapping, Sequence

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

import softrod_jax as sr
from calibration.data.recording import Recording, RecordingError
from softrod_jax.scene.contacts import contact_names
from softrod_jax.scene.logs import pose_columns

BASE = "base"
# What a camera says of a quaternion is as long as one as well as this.
_ABOUT_ONE = 0.01
# An obstacle begins where the scene has it as well as this, [m] and of its quaternion.
_AT_REST = 1e-6


def carried_in(scene: sr.Scene) -> tuple[str, ...]:
    """The names of all that is carried in a scene's motions: the base, and obstacles."""
    contacts = scene.contacts or ()
    names = contact_names(scene.contacts)
    moving = [name for name, contact in zip(names, contacts, strict=True) if contact.moves]
    return ((BASE,) if scene.base_moves else ()) + tuple(moving)


def pose_places(header: Sequence[str], scene: sr.Scene | None, path) -> dict[str, list[int]]:
    """Which columns of a header say where things are carried, by the names of these.

    Without a scene whatever has all of these columns is one of them. Raises `RecordingError` where
    some of the columns are missing or one is there twice, and for what stands still in the scene.
    """
    if scene is None:
        begins = [name.removesuffix("_qw") for name in header if name.endswith("_qw")]
        whole = [x for x in begins if x != "tip" and set(pose_columns(x)) <= set(header)]
        return {name: [header.index(c) for c in pose_columns(name)] for name in whole}
    moving = carried_in(scene)
    for name, key in _still(scene, moving):
        own = [c for c in pose_columns(name) if c in header]
        if own:
            raise RecordingError(
                f"{path}: row 1: column {own[0]}: the scene has {name} stand still; set {key} = "
                "true in the scene, or leave the columns out"
            )
    found = {}
    for name in moving:
        columns = pose_columns(name)
        there = [c for c in columns if c in header]
        if not there:
            continue
        missing = [c for c in columns if c not in header]
        if missing:
            raise RecordingError(
                f"{path}: row 1: column {missing[0]} is missing: where {name} is carried takes "
                f"{', '.join(columns)}"
            )
        for c in columns:
            if header.count(c) > 1:
                raise RecordingError(f"{path}: row 1: column {c} is there twice; delete one")
        found[name] = [header.index(c) for c in columns]
    return found


def _still(scene: sr.Scene, moving):
    """What is not carried, and the key that would say that it is."""
    if BASE not in moving:
        yield BASE, "[base] moves"
    for i, name in enumerate(contact_names(scene.contacts)):
        if name not in moving:
            yield name, f"contacts[{i}].moves"


def checked_rows(
    name: str, rows: Float[np.ndarray, "rows 7"], lines: Sequence[int], path
) -> Float[np.ndarray, "rows 7"]:
    """The poses of what is carried, with quaternions of length one, of one sign.

    Raises `RecordingError` for a number that is missing, for a quaternion that is none, and for an
    obstacle that does not begin where the scene has it.
    """
    columns = pose_columns(name)
    for k, j in np.argwhere(~np.isfinite(rows))[:1]:
        raise RecordingError(
            f"{path}: row {lines[k]}, column {columns[j]}: missing; where {name} is carried is "
            "needed in every row: fill it in or delete the row"
        )
    size = np.linalg.norm(rows[:, 3:], axis=1)
    for k in np.flatnonzero(np.abs(size - 1) > _ABOUT_ONE)[:1]:
        raise RecordingError(
            f"{path}: row {lines[k]}, columns {columns[3]} to {columns[6]}: a quaternion of the "
            f"norm {size[k]:.4g}; expected 1: is the order w, x, y, z?"
        )
    h = rows[:, 3:] / size[:, None]
    turned_over = np.where(np.sum(h[1:] * h[:-1], axis=1) < 0, -1.0, 1.0)
    sign = np.where(h[0, 0] < 0, -1.0, 1.0) * np.concatenate([[1.0], np.cumprod(turned_over)])
    poses = np.concatenate([rows[:, :3], sign[:, None] * h], axis=1)
    if not begins_there(name, poses):
        raise RecordingError(
            f"{path}: row {lines[0]}, columns {columns[0]} to {columns[6]}: {name} begins at "
            f"{', '.join(f'{x:g}' for x in poses[0])}; it is where the scene has it, moved by its "
            "pose: begin with 0, 0, 0, 1, 0, 0, 0"
        )
    return poses


def begins_there(name: str, poses: Float[np.ndarray, "rows 7"]) -> bool:
    """Whether a motion can begin there: an obstacle where the scene has it, the base anywhere."""
    return name == BASE or bool(np.all(np.abs(poses[0] - [0, 0, 0, 1, 0, 0, 0]) < _AT_REST))


def poses_at(
    times: Float[np.ndarray, "times"],
    clock: Float[np.ndarray, "rows"],
    poses: Float[np.ndarray, "rows 7"],
) -> Float[np.ndarray, "times 7"]:
    """The poses at `times` [s] between the rows of a log, by cubics, whose slopes are differences
    of second order: straight pieces would push the rod at every row. Before and after the log they
    stay."""
    if len(clock) < 2:
        return np.repeat(poses, len(times), axis=0)
    slopes = np.gradient(poses, clock, axis=0, edge_order=2 if len(clock) > 2 else 1)
    t = np.clip(times, clock[0], clock[-1])
    k = np.clip(np.searchsorted(clock, t, side="right") - 1, 0, len(clock) - 2)
    h = (clock[k + 1] - clock[k])[:, None]
    u = (t - clock[k])[:, None] / h
    x = poses[k] + u * u * (3 - 2 * u) * (poses[k + 1] - poses[k])
    x = x + u * (1 - u) * h * ((1 - u) * slopes[k] - u * slopes[k + 1])
    return np.concatenate([x[:, :3], x[:, 3:] / np.linalg.norm(x[:, 3:], axis=1)[:, None]], axis=1)


def at_first(
    scene: sr.Scene, carried: Mapping[str, Float[Array | np.ndarray, "rows 7"]]
) -> sr.Scene:
    """The scene with the base where a recording has it at first."""
    if BASE not in carried:
        return scene
    first = jnp.asarray(carried[BASE][0])
    return eqx.tree_at(
        lambda s: (s.base_position, s.base_quaternion),
        scene,
        (first[:3], first[3:]),
        is_leaf=lambda x: x is None,
    )


def moves_of(poses: Mapping) -> dict:
    """What `softrod_jax.simulate` is to be told of poses in its steps, by their names."""
    obstacles = {name: x for name, x in poses.items() if name != BASE}
    return {"base": poses.get(BASE), "contacts": obstacles or None}


def standing_still(scene: sr.Scene | None, recording: Recording) -> tuple[str, ...]:
    """A note on what could be carried and of which a recording does not say where."""
    names = () if scene is None else carried_in(scene)
    silent = [name for name in names if name not in recording.carried]
    if not silent:
        return ()
    columns = f"{silent[0]}_x_m, .., {silent[0]}_qz"
    return (f"nothing says where {' and '.join(silent)} is carried ({columns}): held still",)
