"""Signed distances from a closed surface of triangles.

The nearest triangle is looked for among those whose middles are nearest, as many as it takes to be
sure. Inside and outside are told by the angle-weighted normals of what is nearest, a face, an edge
or a corner, which are right for every closed surface (Baerentzen & Aanaes, IEEE TVCG 11, 2005).
"""

from typing import NamedTuple

import numpy as np

# Of so many triangles the distance is taken at first, and of so many pairs at once.
_NEAREST, _AT_ONCE = 24, 1_000_000


class Triangles(NamedTuple):
    """A closed surface whose faces turn one way, seen from outside.

    - `corners` [m], (corners, 3), and `faces`, (faces, 3), their numbers.
    """

    corners: np.ndarray
    faces: np.ndarray


def signed_distances(surface: Triangles, points: np.ndarray) -> np.ndarray:
    """How far each of `points` [m], (n, 3), is outside; below zero within. It needs scipy."""
    from scipy.spatial import KDTree

    corners = surface.corners[surface.faces]
    middles = corners.mean(1)
    reach = np.linalg.norm(corners - middles[:, None], axis=-1).max()
    tree, normals = KDTree(middles), _normals(surface)
    found, left, count = np.empty(len(points)), np.arange(len(points)), _NEAREST
    while len(left):
        count, again = min(count, len(middles)), []
        for part in np.array_split(left, len(left) * count // _AT_ONCE + 1):
            away, number = tree.query(points[part], k=count)
            found[part] = _nearest(surface, normals, points[part], number)
            # No triangle beyond those can be nearer than this.
            unsure = np.abs(found[part]) > away[:, -1] - reach
            again.append(part[unsure])
        left = np.concatenate(again) if count < len(middles) else []
        count *= 4
    return found


class _Normals(NamedTuple):
    """Directions outwards, of any length: of faces, their edges (from corner k to k + 1), corners.

    (faces, 3), (faces, 3, 3), (corners, 3).
    """

    faces: np.ndarray
    edges: np.ndarray
    corners: np.ndarray


def _normals(surface: Triangles) -> _Normals:
    corners, faces = surface
    a = corners[faces]
    normal = np.cross(a[:, 1] - a[:, 0], a[:, 2] - a[:, 0])
    normal /= np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-300)
    pairs = np.sort(np.stack([faces, np.roll(faces, -1, 1)], -1), -1).reshape(-1, 2)
    edges, number = np.unique(pairs, axis=0, return_inverse=True)
    of_edges = np.zeros((len(edges), 3))
    np.add.at(of_edges, number.ravel(), np.repeat(normal, 3, 0))
    of_corners = np.zeros_like(corners)
    for k in range(3):
        to = a[:, [(k + 1) % 3, (k + 2) % 3]] - a[:, k : k + 1]
        to /= np.maximum(np.linalg.norm(to, axis=-1, keepdims=True), 1e-300)
        angle = np.arccos(np.clip(np.sum(to[:, 0] * to[:, 1], -1), -1, 1))
        np.add.at(of_corners, faces[:, k], angle[:, None] * normal)
    return _Normals(normal, of_edges[number.ravel()].reshape(-1, 3, 3), of_corners)


def _nearest(surface: Triangles, normals: _Normals, points, number) -> np.ndarray:
    """The signed distances of `points`, (n, 3), from the nearest of the triangles `number`, (n, k).

    Each triangle has four candidates: the foot of the perpendicular, where it is within, and the
    nearest places of its edges.
    """
    corners = surface.corners[surface.faces[number]]
    ahead = np.roll(corners, -1, 2)
    along = ahead - corners
    square = np.maximum(np.sum(along**2, -1), 1e-300)
    part = np.clip(np.sum((points[:, None, None] - corners) * along, -1) / square, 0, 1)
    on_edges = corners + part[..., None] * along
    normal = normals.faces[number]
    height = np.sum((points[:, None] - corners[:, :, 0]) * normal, -1)
    foot = points[:, None] - height[..., None] * normal
    turns = np.sum(np.cross(along, foot[:, :, None] - corners) * normal[:, :, None], -1)
    within = np.all(turns > 0, -1)
    far_edges = np.linalg.norm(points[:, None, None] - on_edges, axis=-1)
    far = np.concatenate([far_edges, np.where(within, np.abs(height), np.inf)[..., None]], -1)
    rows = np.arange(len(points))
    triangle, place = np.divmod(np.argmin(far.reshape(len(points), -1), 1), 4)
    edge = np.minimum(place, 2)
    face, t = number[rows, triangle], part[rows, triangle, edge]
    ends = surface.faces[face[:, None], (edge[:, None] + [0, 1]) % 3]
    outwards = np.where((t > 0)[:, None], normals.edges[face, edge], normals.corners[ends[:, 0]])
    outwards = np.where((t < 1)[:, None], outwards, normals.corners[ends[:, 1]])
    on_face = (place == 3)[:, None]
    outwards = np.where(on_face, normals.faces[face], outwards)
    there = np.where(on_face, foot[rows, triangle], on_edges[rows, triangle, edge])
    side = np.sum((points - there) * outwards, -1)
    return np.where(side < 0, -1.0, 1.0) * far[rows, triangle, place]
