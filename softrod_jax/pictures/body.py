"""What of a scene can be seen, as points: its outline, tendons and chambers along a shape.

Arrays of numpy. A solution knows the rod at a few nodes; between them positions and attitudes
are cubic, with the slopes that the strains at the nodes give.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from softrod_jax.rod.rotations import rotation_matrix
from softrod_jax.scene.scene import Scene
from softrod_jax.scene.sections import Annulus, Circle, Rectangle

_CORNERS = 24  # of a circle


class Body(NamedTuple):
    """A scene's parts in the frame of the section [m].

    - `arc`, (points,): where along the rod they are drawn.
    - `outline`, (corners, 2), of the section, and `bore`, that of its hole, or `None`.
    - `tendons`, (tendons, points, 3).
    - `chambers`: the outline of each, (corners, 2).
    """

    arc: np.ndarray
    outline: np.ndarray
    bore: np.ndarray | None
    tendons: np.ndarray
    chambers: list[np.ndarray]

    @property
    def radius(self) -> float:
        """Of the circle about the axis that holds the section [m]."""
        return float(np.linalg.norm(self.outline, axis=1).max())


class Line(NamedTuple):
    """The axis of the rod at `points` along it: `p`, (*batch, points, 3) [m], and `R`."""

    p: np.ndarray
    R: np.ndarray


def body_of(scene: Scene, points: int) -> Body:
    """The parts of `scene` at `points` places, evenly along the rod."""
    length = float(scene.length)
    arc = np.linspace(0.0, length, points)
    outline, bore = _section(scene.section)
    tendons = np.zeros((0, points, 3))
    if scene.tendons is not None:
        paths = jax.vmap(lambda s: scene.tendons.routing(s)[0])(jnp.asarray(arc))
        tendons = np.asarray(paths).swapaxes(0, 1)
    chambers = []
    if scene.chambers is not None:
        # Only the area is known: drawn round.
        radii = np.sqrt(np.asarray(scene.chambers.areas) / np.pi)
        centres = np.asarray(scene.chambers.offsets)
        chambers = [c + _ellipse(r, r) for c, r in zip(centres, radii, strict=True)]
    return Body(arc, outline, bore, tendons, chambers)


def line_along(shape, length: float, points: int) -> Line:
    """The axis at `points` places, from `positions`, `quaternions` and `strains` of `shape`.

    These are (*batch, nodes, 3), (*batch, nodes, 4) and (*batch, nodes, 6), at even nodes, as in
    a `StaticSolution` or a `Trajectory`.
    """
    p, strains = np.asarray(shape.positions), np.asarray(shape.strains)
    R = np.asarray(jax.jit(rotation_matrix)(jnp.asarray(shape.quaternions)))
    v, u = strains[..., :3, None], strains[..., 3:]
    hat = np.stack([np.cross(u, e) for e in np.eye(3)], axis=-1)
    p = _cubic(p, (R @ v)[..., 0], length, points)
    flat = lambda matrices: matrices.reshape(*matrices.shape[:-2], 9)
    # Not quite rotations between the nodes; nobody sees a fourth order.
    R = _cubic(flat(R), flat(R @ hat), length, points)
    return Line(p, R.reshape(*R.shape[:-1], 3, 3))


def placed(line: Line, section_points: np.ndarray) -> np.ndarray:
    """Points of the section, (points, 3), or an outline, (corners, 2), in the base frame [m].

    (points, 3) for the former, (points, corners, 3) for the latter.
    """
    if section_points.shape[-1] == 3:
        return line.p + np.einsum("sij,sj->si", line.R, section_points)
    return line.p[:, None] + np.einsum("sij,cj->sci", line.R[..., :2], section_points)


def _cubic(y, y_s, length, points) -> np.ndarray:
    """Hermite's cubic between even nodes, from values and slopes (*batch, nodes, n)."""
    intervals = y.shape[-2] - 1
    h = length / intervals
    x = np.linspace(0.0, intervals, points)
    k = np.minimum(x.astype(int), intervals - 1)
    t = (x - k)[:, None]
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
