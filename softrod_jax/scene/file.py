"""Scene files: a `Scene` from TOML and back.

SI units. A key or a table that is absent means that the effect is not in the scene. The format
itself is the tables of `schema.py`; what a table becomes is in `reading.py`, and the way back in
`writing.py`.
"""

import tomllib
from os import PathLike
from pathlib import Path

import jax
from jax.core import Tracer

from softrod_jax.foundation.precision import require_float64
from softrod_jax.foundation.whole_files import whole_file
from softrod_jax.scene.checks import impossible
from softrod_jax.scene.grid_file import load_grid, save_grid
from softrod_jax.scene.reading import scene_of
from softrod_jax.scene.scene import Scene
from softrod_jax.scene.schema import SceneError, complaint
from softrod_jax.scene.writing import document_of, grids_of, toml

__all__ = ["SceneError", "load_scene", "save_scene"]


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
        return scene_of(document, f"{path}:", lambda name: load_grid(Path(path).parent / name))


def save_scene(scene: Scene, path: str | PathLike) -> None:
    """Write `scene` to `path`, so that `load_scene(path)` gives the same numbers, bit by bit.

    Distances on a grid are written beside it, to a .npz with the names of the file and the contact.

    Raises `SceneError` if the scene could not be read back (an impossible value, a batch of
    scenes, tendons or paths of a class of one's own) and `OSError` if the file cannot be written.
    """
    if any(isinstance(x, Tracer) for x in jax.tree.leaves(scene)):
        raise SceneError(f"{path}: the scene is traced and has no numbers yet; save it outside jit")
    with jax.ensure_compile_time_eval():
        for key, value, remedy in impossible(scene):
            raise SceneError(complaint(f"{path}: {key}", value, remedy))
        stem = Path(path).stem
        document, grids = document_of(scene, f"{path}:", stem), grids_of(scene, stem)
        scene_of(document, f"{path}:", grids.__getitem__)
    for name, grid in grids.items():
        save_grid(grid, Path(path).parent / name)
    with whole_file(path, encoding="utf-8") as file:
        file.write(toml(document))
