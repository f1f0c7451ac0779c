"""A motion in space as one HTML page that can be turned while it plays, and needs no network.

The page has its own small viewer (`viewer.html`): a canvas, no library. The rod is in it as points
along its axis and the directions of its sections there, so that it is round and smooth from every
side; what was measured is drawn beside it, and the inputs below.
"""

import base64
import json
import re
from collections.abc import Mapping
from html import escape
from importlib import resources
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from softrod_jax.pictures.body import Body, Part, body_of, line_along
from softrod_jax.pictures.drawing import TENDON_COLOURS as _COLOURS
from softrod_jax.pictures.drawing import unit_of, upright
from softrod_jax.pictures.obstacles import courses_by_number, surfaces_of
from softrod_jax.pictures.stills import check_solved
from softrod_jax.scene.contacts import contact_names
from softrod_jax.scene.inputs import KINDS, Inputs, Kind
from softrod_jax.scene.poses import PosesLike
from softrod_jax.scene.scene import Scene
from softrod_jax.scene.tendons import driven_by_length

# More places along the rod, and more moments, are not seen; the page goes between moments by
# straight lines.
_PLACES, _MOMENTS = 33, 400


def film(
    scene: Scene,
    motion,
    path: str | PathLike,
    inputs: Inputs | None = None,
    *,
    measured: Mapping[str, tuple] | None = None,
    contacts: Mapping[str, PosesLike] | None = None,
    title: str = "A motion",
) -> Path:
    """Write a motion to `path`, a .html: to be turned, zoomed, played and stopped by whoever opens
    it.

    - `motion`: a `Trajectory`, or what else has `ts`, `positions`, `quaternions`, `strains` and
      `arc_lengths`.
    - `inputs`: what drove it, (steps, actuators) as for `simulate`, or one row for each of `ts`.
    - `measured`: by name, times (n,) [s] and places (n, 3) [m] in the scene's frame, NaN where a
      coordinate is missing.
    - `contacts`: where obstacles are carried, as in `simulate`. The sizes of their forces, where
      the motion has them, are drawn below.

    Returns `path`. Raises `ValueError` for a failed motion, a batch, and another ending.
    """
    path = Path(path)
    check_solved("film", motion)
    if path.suffix.lower() != ".html":
        raise ValueError(f"film: {path}: the name ends in {path.suffix!r}; expected .html")
    courses = courses_by_number("film", scene, contacts, len(motion.ts))
    page = film_page(scene, motion, inputs, measured or {}, courses, title)
    path.write_text(page, encoding="utf-8")
    return path


def film_page(scene: Scene, motion, inputs: Inputs | None, measured, courses, title: str) -> str:
    """The page of `film`; `courses` of obstacles, (times, 7), by their number."""
    content = _content(scene, motion, Inputs() if inputs is None else inputs, measured, courses)
    # A name may hold what would end the script.
    data = json.dumps(content, allow_nan=False).replace("<", "\\u003c")
    page = resources.files("softrod_jax.pictures").joinpath("viewer.html").read_text("utf-8")
    put = {"TITLE": escape(title), "CONTENT": data}
    return re.sub("TITLE|CONTENT", lambda match: put[match.group()], page)


def _content(scene: Scene, motion, inputs: Inputs, measured, courses) -> dict[str, Any]:
    body = body_of(scene, _PLACES)
    ts = np.asarray(motion.ts, dtype=float)
    shown = np.unique(np.linspace(0, len(ts) - 1, min(_MOMENTS, len(ts))).round().astype(int))
    line = line_along(motion, body.arc)
    p, R = line.p[shown], line.R[shown]
    size, unit = unit_of(scene)
    axis, sign = upright(scene)
    return {
        "times": _rounded(ts[shown]),
        "places": len(body.arc),
        "points": _packed(size * p),
        "across": _packed(R[..., 0]),
        "over": _packed(R[..., 1]),
        "unit": unit,
        "up": [axis, sign],
        "outlines": [_ring(x) for x in body.outlines],
        "chambers": [_ring(x) for x in body.chambers],
        "disks": [_ring(x) for x in body.disks],
        "tendons": _tendons(body),
        "size": size,
        "payload": 0.8 * size * body.radius if scene.payload is not None else 0,
        "obstacles": _obstacles(scene, line.p.reshape(-1, 3), courses, size, shown),
        "inputs": _inputs(scene, inputs, len(ts), shown) + _pushes(scene, motion, shown),
        "measured": [_seen(size, name, *seen) for name, seen in measured.items()],
    }


def _ring(part: Part) -> dict:
    """Corners in the section, (places, corners, 2), in the order of the places of the part."""
    count = part.where.stop - part.where.start
    rings = np.broadcast_to(part.points, (count, *part.points.shape[-2:]))
    # Half of a circle's corners look round; a rectangle has four.
    rings = rings[:, ::2] if rings.shape[1] > 8 else rings
    same = np.allclose(rings, rings[:1], rtol=1e-9, atol=0)
    return {"from": int(part.where.start), "to": int(part.where.stop),
            "rings": [_rounded(x) for x in (rings[:1] if same else rings)]}  # fmt: skip


def _tendons(body: Body) -> list[dict]:
    return [
        {
            "from": int(part.where.start),
            "to": int(part.where.stop),
            "at": _rounded(part.points[:, :2]),
            "colour": _COLOURS[i % len(_COLOURS)],
        }
        for i, part in enumerate(body.tendons)
    ]


def _obstacles(scene: Scene, places, courses, size: float, shown) -> list[dict]:
    """Faces, and where they are carried at the moments that are shown."""
    found = []
    for i, surface in surfaces_of(scene, places).items():
        moved = None
        if i in courses:
            rows = courses[i][shown]
            moved = {"by": _rounded(size * rows[:, :3]), "turned": _rounded(rows[:, 3:])}
        # Corners once, however many faces they are of.
        corners, numbers = np.unique(surface.faces.reshape(-1, 3), axis=0, return_inverse=True)
        found.append(
            {
                "name": surface.name,
                "corners": _rounded(size * corners),
                "faces": numbers.reshape(-1, 4).tolist(),
                "inside": surface.inside,
                "moved": moved,
            }
        )
    return found


def _pushes(scene: Scene, motion, shown) -> list[dict]:
    """The sizes of the forces of obstacles, drawn as inputs are."""
    forces, found = getattr(motion, "contact_forces", {}), []
    for name in contact_names(scene.contacts) if forces else ():
        size = np.linalg.norm(np.asarray(forces[name])[shown], axis=-1)
        found.append({"name": f"force of {name}", "unit": "N", "curves": [_rounded(size)],
                      "colours": ["#c2727a"]})  # fmt: skip
    return found


def _inputs(scene: Scene, inputs: Inputs, times: int, shown) -> list[dict]:
    """Curves by kind, in the unit in which they are shown."""
    found = []
    for kind, given in zip(KINDS, inputs, strict=True):
        if given is None:
            continue
        values = np.asarray(given, dtype=float)
        if len(values) == times - 1:  # row k acts up to the end of step k
            values = np.concatenate([values[:1], values])
        if values.shape != (times, kind.count(scene)):
            raise ValueError(
                f"film: {kind.name} of shape {values.shape}; the scene and the motion need "
                f"({times - 1}, {kind.count(scene)})"
            )
        unit, size = kind.shown
        curves = [_rounded(size * column[shown]) for column in values.T]
        colours = [_COLOURS[i % len(_COLOURS)] for i in _driven(scene, kind)]
        found.append({"name": kind.one, "unit": unit, "curves": curves, "colours": colours})
    return found


def _driven(scene: Scene, kind: Kind) -> list[int]:
    """The numbers of the tendons that inputs of a kind drive; none for chambers."""
    if kind.part != "tendons" or scene.tendons is None:
        return []
    by_length = driven_by_length(scene.tendons)
    return [i for i in range(scene.tendons.count) if (i in by_length) == (kind.control == "length")]


def _seen(size: float, name: str, times, places) -> dict:
    times, places = np.asarray(times, dtype=float), np.asarray(places, dtype=float)
    known = np.all(np.isfinite(places), axis=1) & np.isfinite(times)
    return {"name": name, "times": _rounded(times[known]), "at": _rounded(size * places[known])}


def _packed(values: np.ndarray) -> dict:
    """Numbers in 16 bits between the least and the largest: a 30,000th of the picture."""
    low, high = float(np.min(values)), float(np.max(values))
    if not (np.isfinite(low) and np.isfinite(high)):
        raise ValueError("film: the motion has positions that are not finite")
    step = (high - low) / 65535 or 1.0
    whole = np.round((values - low) / step).astype("<u2")
    return {"low": low, "step": step, "data": base64.b64encode(whole.tobytes()).decode()}


def _rounded(values) -> list:
    """Lists of numbers of 6 digits."""
    values = np.asarray(values, dtype=float)
    if values.ndim > 1:
        return [_rounded(x) for x in values]
    return [float(f"{x:.6g}") for x in values]
