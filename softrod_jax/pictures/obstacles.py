"""Obstacles as they are drawn: of each what is near the rod, as grids of points, and its course.

A shape of one's own is not drawn: its surface is not known.
"""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from softrod_jax.pictures.zero_surface import is_around, zero_faces
from softrod_jax.scene.contacts import Plane, Sphere, Tube, contact_names
from softrod_jax.scene.distance_grid import DistanceGrid
from softrod_jax.scene.poses import PosesLike, checked_poses
from softrod_jax.scene.scene import Scene, as_arrays

# Of what has no end a part of this size is drawn, in lengths of the rod, to each side.
_NEAR = 0.3
_FLAT, _ROUND = 9, 24  # points along an edge, and around a circle


class Surface(NamedTuple):
    """Of one obstacle: its faces [m], (faces, 4, 3), where the scene has it.

    `inside`: whether the rod is inside of it.
    """

    name: str
    faces: np.ndarray
    inside: bool


def surfaces_of(scene: Scene, places: np.ndarray) -> dict[int, Surface]:
    """The surfaces of obstacles, by their number. `places` [m] of the rod, (n, 3)."""
    scene, found = as_arrays(scene), {}
    size = _NEAR * float(scene.length)
    given = zip(contact_names(scene.contacts), scene.contacts or (), strict=True)
    for i, (name, contact) in enumerate(given):
        match contact.obstacle:
            case Plane(point=point, normal=normal):
                grid = _plane(np.asarray(point), np.asarray(normal), places, size)
            case Sphere(center=center, radius=radius):
                grid = _sphere(np.asarray(center), float(radius), places, size)
            case Tube(axis=axis, radius=radius):
                grid = _tube(np.asarray(axis), float(radius), places)
            case DistanceGrid() as distances:
                faces = zero_faces(distances, places, size)
                if len(faces):
                    found[i] = Surface(name, faces, is_around(distances))
                continue
            case _:
                continue
        found[i] = Surface(name, faces_of(grid), isinstance(contact.obstacle, Tube))
    return found


def courses_by_number(
    who: str, scene: Scene, contacts: Mapping[str, PosesLike] | None, times: int
) -> dict[int, np.ndarray]:
    """Where obstacles are carried, (times, 7), by their number, of those that are.

    As in `simulate`, with the pose in which they begin before the first.

    Raises `ValueError` as `simulate` does, and for another number of steps.
    """
    poses = checked_poses(who, scene, None, contacts)
    courses = {i: np.asarray(rows) for i, rows in enumerate(poses.obstacles) if rows is not None}
    for rows in courses.values():
        if len(rows) != times - 1:
            raise ValueError(
                f"{who}: contacts of {len(rows)} steps; the motion has {times - 1}, one row a step "
                "is needed"
            )
    start = np.array([[0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]])
    return {i: np.concatenate([start, rows]) for i, rows in courses.items()}


def carried(points: np.ndarray, pose: np.ndarray) -> np.ndarray:
    """Points, (.., 3), where a pose, (7,), has carried them."""
    p, (w, *v) = pose[:3], pose[3:]
    across = np.cross(v, points)
    return points + 2 * (w * across + np.cross(v, across)) + p


def faces_of(grid: np.ndarray) -> np.ndarray:
    """The quadrangles between the points of a grid, (faces, 4, 3)."""
    a, b, c, d = grid[:-1, :-1], grid[1:, :-1], grid[1:, 1:], grid[:-1, 1:]
    return np.stack([a, b, c, d], axis=2).reshape(-1, 4, 3)


def _plane(point, normal, places, size):
    """A square about the place that is nearest to the rod."""
    n = normal / np.linalg.norm(normal)
    above = (places - point) @ n
    k = np.argmin(above)
    x, y = _across(n)
    edge = np.linspace(-size, size, _FLAT)
    return (places[k] - above[k] * n) + edge[:, None, None] * x + edge[:, None] * y


def _sphere(center, radius, places, size):
    """All of it or, of a large one, a cap towards the rod."""
    away = np.linalg.norm(places - center, axis=-1)
    towards = places[np.argmin(away)] - center
    z = towards / max(np.linalg.norm(towards), 1e-12)
    x, y = _across(z)
    angle, around = _polar(min(np.pi, size / radius))
    ring = np.cos(around)[:, None] * x + np.sin(around)[:, None] * y
    return center + radius * (
        np.cos(angle)[:, None, None] * z + np.sin(angle)[:, None, None] * ring
    )


def _polar(last):
    """Angles from close to a pole, where faces would have no area, and around it."""
    return np.linspace(0.01 * last, last, _FLAT), np.linspace(0, 2 * np.pi, _ROUND + 1)


def _tube(axis, radius, places):
    """Rings along its axis, whose ends go straight on as far as the rod does."""
    axis = axis.copy()
    for end, next_one in ((0, 1), (-1, -2)):
        out = (axis[end] - axis[next_one]) / np.linalg.norm(axis[end] - axis[next_one])
        axis[end] = axis[end] + max(0.0, np.max((places - axis[end]) @ out)) * out
    pieces = np.diff(axis, axis=0)
    pieces /= np.linalg.norm(pieces, axis=-1, keepdims=True)
    along = np.concatenate([pieces[:1], pieces[1:] + pieces[:-1], pieces[-1:]])
    along /= np.linalg.norm(along, axis=-1, keepdims=True)
    _, around = _polar(np.pi)
    x, rings = _across(along[0])[0], []
    for centre, t in zip(axis, along, strict=True):
        x = x - (x @ t) * t  # carried along the axis without a turn about it
        x = x / np.linalg.norm(x)
        ring = np.cos(around)[:, None] * x + np.sin(around)[:, None] * np.cross(t, x)
        rings.append(centre + radius * ring)
    return np.stack(rings)


def _across(n):
    """Two directions across a unit vector `n`, and across each other."""
    x = np.cross(n, np.eye(3)[np.argmin(np.abs(n))])
    x /= np.linalg.norm(x)
    return x, np.cross(n, x)
