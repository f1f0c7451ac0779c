"""What of a scene can be seen, as points: its outline, tendons and chambers along a shape.

Arrays of numpy. A solution knows the rod at a few nodes; between them positions and attitudes
are cubic, with the slopes that the strains at the nodes give.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from softrod_jax.rod.rotations import rotation_matrix
from softrod_jax.scene.scene import Scene, as_arrays
from softrod_jax.scene.sections import Annulus, Circle, Rectangle
from softrod_jax.scene.tendons import Tendons

_CORNERS = 24  # of a circle
_DISKS = 9  # along a rod


class Part(NamedTuple):
    """What is along a part of the rod: `where` among the places, and points of the section.

    `points`: a line, (places, 3), or an outline, (corners, 2) or (places, corners, 2).
    """

    where: slice
    points: np.ndarray


class Body(NamedTuple):
    """A scene's parts in the frame of the section [m].

    - `arc`, (places,): where along the rod they are drawn. Two places are the same where one
      segment ends and the next begins.
    - `outlines` of the segments, and `bores`, of the holes in them.
    - `tendons`, and `ends`: where they begin and end inside the rod.
    - `disks`: thin plates that guide tendons outside the sections. `chambers`.
    """

    arc: np.ndarray
    outlines: list[Part]
    bores: list[Part]
    tendons: list[Part]
    ends: list[Part]
    disks: list[Part]
    chambers: list[Part]

    @property
    def radius(self) -> float:
        """That of the circle about the axis that holds all sections [m]."""
        return max(float(np.linalg.norm(x.points, axis=-1).max()) for x in self.outlines)

    @property
    def reach(self) -> float:
        """That of the circle about the axis that holds tendons and disks, too [m]."""
        away = [np.linalg.norm(x.points, axis=-1).max() for x in (*self.tendons, *self.disks)]
        return max([self.radius, *map(float, away)])

    def nearest(self, s) -> int:
        """The place that is nearest to arc length `s` [m]."""
        return int(np.argmin(np.abs(self.arc - float(s))))


class Line(NamedTuple):
    """The axis of the rod at places along it: `p`, (*batch, places, 3) [m], and `R`."""

    p: np.ndarray
    R: np.ndarray

    def part(self, where: slice) -> "Line":
        return Line(self.p[..., where, :], self.R[..., where, :, :])


def body_of(scene: Scene, points: int) -> Body:
    """The parts of `scene` at `points` places or some more, about evenly along the rod."""
    scene = as_arrays(scene)  # it may hold lists
    arc, pieces = _places(scene, points)
    outlines, bores = [], []
    for where, segment in pieces:
        rings = [_section(section) for section in _sections(segment, arc[where])]
        outlines.append(Part(where, np.stack([outline for outline, _ in rings])))
        if rings[0][1] is not None or rings[-1][1] is not None:
            empty = np.zeros((_CORNERS, 2))
            bores.append(Part(where, np.stack([empty if b is None else b for _, b in rings])))
    tendons, chambers, length = [], [], float(scene.length)
    if scene.tendons is not None:
        route = lambda s, tendons=scene.tendons: _route(tendons, scene.length, s)
        paths = np.asarray(jax.vmap(route)(jnp.asarray(arc)))
        for i in range(scene.tendons.count):
            where = _where(arc, scene.tendons.part(i, scene.length))
            tendons.append(Part(where, paths[where, i]))
    if scene.chambers is not None:
        # Only the area is known: drawn round.
        radii = np.sqrt(np.asarray(scene.chambers.areas) / np.pi)
        centres = np.asarray(scene.chambers.offsets)
        for i, (centre, radius) in enumerate(zip(centres, radii, strict=True)):
            where = _where(arc, scene.chambers.part(i, scene.length))
            chambers.append(Part(where, centre + _ellipse(radius, radius)))
    ends = [
        Part(slice(k, k + 1), tendon.points[j : j + 1])
        for tendon in tendons
        for k, j in ((tendon.where.start, 0), (tendon.where.stop - 1, -1 + len(tendon.points)))
        if 1e-9 * length < arc[k] < (1 - 1e-9) * length
    ]
    return Body(arc, outlines, bores, tendons, ends, _disks(scene, tendons), chambers)


def _places(scene: Scene, points: int):
    """Arc lengths, and for each segment which of them it has. What is somewhere has its own."""
    lengths = [float(segment.length) for segment in scene.parts]
    edges = np.concatenate([[0.0], np.cumsum(lengths)])
    own = [x.at for x in (*(scene.loads or ()), *(scene.masses or ()), *(scene.markers or ()))]
    for actuators in (scene.tendons, scene.chambers):
        if actuators is not None:
            ends = (*(actuators.starts_at or ()), *(actuators.ends_at or ()))
            own += [x for x in ends if x is not None]
    own = np.array([float(x) for x in own])
    arcs, pieces, first = [], [], 0
    for segment, low, high in zip(scene.parts, edges[:-1], edges[1:], strict=True):
        count = max(
            round((points - 1) * (high - low) / edges[-1]) + 1, 3 if len(lengths) > 1 else 2
        )
        inside = own[(own > low) & (own < high)]
        arc = np.union1d(np.linspace(low, high, count), inside)
        arcs.append(arc)
        pieces.append((slice(first, first + len(arc)), segment))
        first += len(arc)
    return np.concatenate(arcs), pieces


def _sections(segment, arc):
    """The sections of a segment at its places."""
    x = (arc - arc[0]) / (arc[-1] - arc[0])
    if segment.section_at_end is None:
        return [segment.section] * len(arc)
    return [segment.section_at(part) for part in x]


def _route(tendons: Tendons, length, s):
    """Where the tendons are at arc length `s`, (tendons, 3)."""
    if type(tendons) is Tendons:
        return tendons.routing(s, length)[0]
    return tendons.routing(s)[0]


def _where(arc, part) -> slice:
    """The places between two arc lengths."""
    low, high = (float(x) for x in part)
    rounding = 1e-9 * arc[-1]
    inside = np.flatnonzero((arc >= low - rounding) & (arc <= high + rounding))
    return slice(int(inside[0]), int(inside[-1]) + 1)


def _disks(scene: Scene, tendons: list[Part]) -> list[Part]:
    """Plates that hold the tendons which disks guide, evenly along them."""
    if scene.tendons is None:
        return []
    guided = [x for x, way in zip(tendons, scene.tendons.guides, strict=True) if way == "disks"]
    if not guided:
        return []
    start, stop = min(x.where.start for x in guided), max(x.where.stop for x in guided)
    disks = []
    for k in np.unique(np.linspace(start, stop - 1, _DISKS).round().astype(int)):
        here = [x for x in guided if x.where.start <= k < x.where.stop]
        away = [np.linalg.norm(x.points[k - x.where.start, :2]) for x in here]
        radius = 1.1 * max(away, default=0.0)
        if radius > 0:
            disks.append(Part(slice(k, k + 1), _ellipse(radius, radius)))
    return disks


def line_along(shape, arc: np.ndarray) -> Line:
    """The axis at arc lengths `arc`, (places,), of what has `positions` and the like.

    `positions`, `quaternions` and `strains` of `shape` are (*batch, nodes, 3), (.., 4) and (.., 6),
    as in a `StaticSolution` or a `Trajectory`, at its `arc_lengths`; at even nodes without them.
    """
    p, strains = np.asarray(shape.positions), np.asarray(shape.strains)
    nodes = getattr(shape, "arc_lengths", None)
    if nodes is None:
        nodes = np.linspace(0.0, arc[-1], p.shape[-2])
    nodes = np.reshape(np.asarray(nodes), (-1, p.shape[-2]))[0]
    R = np.asarray(jax.jit(rotation_matrix)(jnp.asarray(shape.quaternions)))
    v, u = strains[..., :3, None], strains[..., 3:]
    hat = np.stack([np.cross(u, e) for e in np.eye(3)], axis=-1)
    p = cubic(p, (R @ v)[..., 0], nodes, arc)
    flat = lambda matrices: matrices.reshape(*matrices.shape[:-2], 9)
    # Not quite rotations between the nodes; nobody sees a fourth order.
    R = cubic(flat(R), flat(R @ hat), nodes, arc)
    return Line(p, R.reshape(*R.shape[:-1], 3, 3))


def placed(line: Line, section_points: np.ndarray) -> np.ndarray:
    """Points of the section in the base frame [m].

    Of a line, (places, 3), the same. Of an outline, (corners, 2) or (places, corners, 2), they are
    (places, corners, 3).
    """
    if section_points.shape[-1] == 3:
        return line.p + np.einsum("sij,sj->si", line.R, section_points)
    outlines = np.broadcast_to(section_points, (len(line.p), *section_points.shape[-2:]))
    return line.p[:, None] + np.einsum("sij,scj->sci", line.R[..., :2], outlines)


def cubic(y, y_s, nodes, arc) -> np.ndarray:
    """Hermite's cubic between nodes, from values and slopes (*batch, nodes, n)."""
    # Where something jumps there are two nodes, with nothing between them.
    k = np.clip(np.searchsorted(nodes, arc, side="right") - 1, 0, len(nodes) - 2)
    h = (nodes[k + 1] - nodes[k])[:, None]
    t = (arc - nodes[k])[:, None] / np.where(h > 0, h, 1.0)
    left, right = y[..., k, :], y[..., k + 1, :]
    return (
        left * (1 + 2 * t) * (1 - t) ** 2
        + right * t**2 * (3 - 2 * t)
        + h * (y_s[..., k, :] * t * (1 - t) ** 2 + y_s[..., k + 1, :] * t**2 * (t - 1))
    )


def _section(section) -> tuple[np.ndarray, np.ndarray | None]:
    match section:
        case Circle():
            return _ellipse(section.radius, section.radius), None
        case Annulus():
            outer, inner = section.outer_radius, section.inner_radius
            return _ellipse(outer, outer), _ellipse(inner, inner) if inner > 0 else None
        case Rectangle():
            w, h = float(section.width) / 2, float(section.height) / 2
            return np.array([[w, h], [-w, h], [-w, -h], [w, -h]]), None
    # The outline is unknown: the ellipse that has the same radii of gyration.
    a, b = 2 * np.sqrt(np.asarray(section.second_moments)[::-1] / float(section.area))
    return _ellipse(a, b), None


def _ellipse(a, b) -> np.ndarray:
    angle = np.linspace(0, 2 * np.pi, _CORNERS, endpoint=False)
    return np.stack([float(a) * np.cos(angle), float(b) * np.sin(angle)], axis=1)
