"""Obstacles from the surfaces of bodies as CAD programs and scanners write them (STL, OBJ, PLY).

trimesh reads them (extra `meshes`); what is made is a grid of distances, which needs it no more.
"""

from os import PathLike
from typing import Any

import jax.numpy as jnp
import numpy as np

from softrod_jax.foundation.precision import require_float64
from softrod_jax.scene.distance_grid import DistanceGrid, box_of_points
from softrod_jax.scene.triangles import Triangles, signed_distances


def grid_of_mesh(
    mesh: str | PathLike | Any,
    spacing: float,
    *,
    margin: float,
    scale: float = 1.0,
    inside: bool = False,
) -> DistanceGrid:
    """The distance from a closed surface of triangles, on a grid around all of it.

    - `mesh`: a file that trimesh reads, such as .stl, .obj or .ply, or a `trimesh.Trimesh`.
    - `spacing` [m] between points: what is smaller is rounded off.
    - `margin` [m]: how far around the body the distance is to hold; at least the radius of the rod.
    - `scale`: the size of the mesh's unit in metres, 1e-3 for millimetres.
    - `inside`: whether the rod is inside of the surface.

    Raises `ValueError` without trimesh or scipy, for a file that cannot be read, and for a surface
    that is not closed, or whose faces do not turn one way.
    """
    require_float64("grid_of_mesh")
    if not margin >= 0 or not scale > 0:
        raise ValueError(
            f"grid_of_mesh: margin = {margin} and scale = {scale}; expected at least 0, and above 0"
        )
    surface = _closed(mesh, scale)
    low, high = surface.corners.min(0) - margin, surface.corners.max(0) + margin
    origin, counts = box_of_points("grid_of_mesh", low, high, spacing)
    axes = [a + spacing * np.arange(n) for a, n in zip(origin, counts, strict=True)]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), -1)
    values = signed_distances(surface, points.reshape(-1, 3)).reshape(points.shape[:3])
    values = -values if inside else values
    return DistanceGrid(jnp.asarray(values), jnp.asarray(origin), jnp.asarray(float(spacing)))


def _closed(mesh: Any, scale: float) -> Triangles:
    """The triangles in metres, seen from outside; `ValueError` if they do not close."""
    try:
        import scipy.spatial  # noqa: F401 - what looks for the nearest
        import trimesh
    except ImportError as e:
        raise ValueError(
            f"grid_of_mesh: meshes need {e.name}: pip install 'softrod_jax[meshes]'"
        ) from None
    named = "the mesh"
    if isinstance(mesh, str | PathLike):
        named = str(mesh)
        try:
            mesh = _loaded(trimesh, named)
        except Exception as e:  # whatever its many readers say of a file that is none
            reason = getattr(e, "strerror", None) or e
            raise ValueError(f"{named}: cannot read the mesh: {reason}") from None
    faces = getattr(mesh, "faces", None)
    if faces is None or not len(faces):
        raise ValueError(f"{named}: has no triangles; expected a closed surface of them")
    if not mesh.is_watertight or not mesh.is_winding_consistent:
        raise ValueError(
            f"{named}: not a closed surface whose triangles turn one way, so that nothing is "
            "inside of it; close and orient it (trimesh.repair, MeshLab, Blender)"
        )
    faces = np.asarray(faces) if mesh.volume > 0 else np.asarray(faces)[:, ::-1]
    return Triangles(scale * np.asarray(mesh.vertices, dtype=float), faces)


def _loaded(trimesh: Any, path: str) -> Any:
    """What a file holds, as one mesh; its class depends on the file."""
    return trimesh.load(path, force="mesh")
