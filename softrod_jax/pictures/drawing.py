"""A rod in 3D axes: its body, translucent, with its tendons and chambers, clamp and payload.

Obstacles are drawn behind the rod, wherever they are: what is touched does not hide what touches.
"""

from collections.abc import Mapping

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from mpl_toolkits.mplot3d.art3d import Line3DCollection, Poly3DCollection

from softrod_jax.pictures.body import Body, Line, Part, body_of, line_along, placed
from softrod_jax.pictures.obstacles import carried, faces_of, surfaces_of
from softrod_jax.scene.scene import Scene

# Places along the rod at which it is drawn.
POINTS = 49
TENDON_COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9")
CHAMBER_COLOUR, MEASURED_COLOUR = "#7b3fa0", "#b00020"
_BODY, _CLAMP, _PAYLOAD, _FORCE = "#c9a98b", "#6b6f75", "#3a3d42", "#b00020"
_DISK, _MARKER = "#55585e", "#1b4d3e"
_OBSTACLE = "#c2727a"
# A line of a tendon is so wide when slack, and so much wider at the largest tension [points].
_SLACK, _TAUT = 1.0, 2.2
# Of a chamber, without pressure and at the largest one.
_EMPTY, _FULL = 0.35, 0.9
_LIGHT = np.array([0.4, -0.7, 0.6])


def rod_axes(
    figure: Figure,
    scene: Scene,
    shapes,
    *,
    place: int | tuple[int, int, int] = 111,
    view: tuple[float, float] = (16.0, -60.0),
):
    """Equal 3D axes in `figure` that hold all `shapes`, labelled in mm, or m for long rods.

    Up is against gravity: a rod that hangs is drawn hanging. Without gravity, up is z.

    - `shapes`: a `StaticSolution`, a `Trajectory`, or what else has `positions`, `quaternions`
      and `strains`, (*batch, nodes, ..).
    - `place`: where in the figure, as in `Figure.add_subplot`, a number or three of them. `view`:
      elevation and azimuth [deg].
    """
    body = body_of(scene, POINTS)
    line = line_along(shapes, body.arc)
    heads = [at + arrow for at, arrow in _arrows(scene, body, line)]
    obstacles = [x.faces for x in surfaces_of(scene, line.p.reshape(-1, 3)).values()]
    points = np.concatenate([x.reshape(-1, 3) for x in (line.p, *heads, *obstacles)])
    if not np.all(np.isfinite(points)):
        raise ValueError("rod_axes: the shapes have positions that are not finite")
    margin = 1.4 * body.reach
    low, high = points.min(axis=0) - margin, points.max(axis=0) + margin
    # No face of the box is a sliver.
    room = np.maximum(0.55 * np.max(high - low) - (high - low), 0)
    low, high = low - room / 2, high + room / 2

    size, unit = unit_of(scene)
    vertical, sign = upright(scene)
    with rc_context({"grid.color": "#d8dade", "grid.linewidth": 0.6}):
        at = place if isinstance(place, tuple) else (place,)
        axes = figure.add_subplot(*at, projection="3d", computed_zorder=False)
    flipped = set() if sign > 0 else {vertical, (vertical + 2) % 3}
    for i, name in enumerate("xyz"):
        ends = size * np.array([low[i], high[i]])
        # Two axes turned round are a rotation; one would show the mirror image.
        axes.set(**{f"{name}lim": ends[::-1] if i in flipped else ends})
        axis = getattr(axes, f"{name}axis")
        axis.set_major_locator(MaxNLocator(4))
        axis.set_label_text(f"{name} [{unit}]")
        axis.pane.set_facecolor((0.96, 0.96, 0.97))
    axes.tick_params(labelsize=8)
    elevation, azimuth = view
    # With x upright the rod, along z, would run into the page.
    axes.view_init(elevation, azimuth + (90 if vertical == 0 else 0), vertical_axis="xyz"[vertical])
    # After the view, which says what is upright. A zoom need not be a whole number.
    axes.set_box_aspect(high - low, zoom=0.84)  # pyright: ignore[reportArgumentType]
    return axes


def draw_rod(
    axes,
    scene: Scene,
    shape,
    *,
    tensions=None,
    pressures=None,
    largest_tension: float | None = None,
    largest_pressure: float | None = None,
    strength: float = 1.0,
    clamp: bool = True,
) -> list:
    """Draw one shape of a rod into 3D axes, and return what was drawn.

    - `axes`: of `rod_axes`, or any 3D axes of matplotlib.
    - `shape`: a `StaticSolution`, or what else has `positions` (nodes, 3), `quaternions`
      (nodes, 4) and `strains` (nodes, 6).
    - `tensions` [N], (tendons,), and `pressures` [Pa], (chambers,): a tendon is drawn the wider
      and a chamber the darker, up to `largest_tension` and `largest_pressure`.
    - `strength`: below 1 the rod is drawn fainter. `clamp`: whether to draw that, too.

    The body has the true size of the sections; of a `GeneralSection`, whose outline is unknown,
    it is the ellipse with the same radii of gyration. Chambers are drawn round. A dot is where a
    tendon begins or ends inside the rod, a thin circle a disk that guides tendons.
    """
    if np.ndim(shape.positions) != 2:
        raise ValueError(
            f"draw_rod: positions of shape {np.shape(shape.positions)}, expected (nodes, 3): "
            "draw one sample of a batch, or one time of a motion"
        )
    body = body_of(scene, POINTS)
    line = line_along(shape, body.arc)
    return draw_line(
        axes,
        scene,
        body,
        line,
        shares(tensions, largest_tension, len(body.tendons)),
        shares(pressures, largest_pressure, len(body.chambers)),
        strength,
        clamp,
    )


def draw_line(
    axes, scene, body: Body, line: Line, pull, air, strength=1.0, clamp=True, layer=0
) -> list:
    """As `draw_rod`, from the axis of the rod; `pull` and `air`: shares in [0, 1] of the most.

    `layer`: a rod of a higher one is drawn over those of lower ones.
    """
    size, _ = unit_of(scene)
    drawn = []

    def add(artist):
        artist.set_zorder(artist.get_zorder() + 10 * layer)
        axes.add_collection3d(artist)
        drawn.append(artist)

    def surface(grid, colour, alpha, order):
        add(_surface(size * grid, colour, alpha * strength, order))

    if clamp:
        for grid in _plate(line, body.radius):
            add(_surface(size * grid, _CLAMP, 0.9, 1))
    at = lambda part: placed(line.part(part.where), part.points)
    for chamber, share in zip(body.chambers, air, strict=True):
        surface(at(chamber), CHAMBER_COLOUR, _EMPTY + share * (_FULL - _EMPTY), 3)
    for bore in body.bores:
        surface(at(bore), _BODY, 0.3, 3)
    for i, (tendon, share) in enumerate(zip(body.tendons, pull, strict=True)):
        colour = TENDON_COLOURS[i % len(TENDON_COLOURS)]
        width = (_SLACK + _TAUT * share) * strength
        add(Line3DCollection([size * at(tendon)], colors=[colour], linewidths=width, zorder=4))
    if body.disks:
        rings = [np.concatenate([ring, ring[:1]]) for ring in (size * at(x)[0] for x in body.disks)]
        add(Line3DCollection(rings, colors=_DISK, linewidths=0.8 * strength, zorder=4))
    for outline in body.outlines:
        surface(at(outline), _BODY, 0.25, 5)
        surface(_cap(line, outline, body.bores), _BODY, 0.25, 5)
    if scene.payload is not None:
        surface(_ball(line.p[-1], 0.8 * body.radius), _PAYLOAD, 0.95, 6)
    for mass in scene.masses or ():
        surface(_ball(line.p[body.nearest(mass.at)], 0.6 * body.radius), _PAYLOAD, 0.95, 6)
    order = 7 + 10 * layer
    for foot, arrow in _arrows(scene, body, line):
        foot, arrow = size * foot, size * arrow
        drawn.append(axes.quiver(*foot, *arrow, color=_FORCE, lw=1.5 * strength, zorder=order))
    drawn += _dots(axes, scene, body, line, size, strength, order)
    return drawn


def draw_obstacles(axes, scene: Scene, places, poses: Mapping[int, np.ndarray] | None = None):
    """The obstacles of `scene` near `places` [m] of the rod, (n, 3); returns what was drawn.

    `poses`: of some, by their number, where they are carried, (7,).
    """
    size, drawn = unit_of(scene)[0], []
    for i, surface in surfaces_of(scene, places).items():
        pose = (poses or {}).get(i)
        faces = surface.faces if pose is None else carried(surface.faces, pose)
        alpha = 0.12 if surface.inside else 0.35
        drawn.append(_lit(size * faces, _OBSTACLE, alpha, 0.5))
        axes.add_collection3d(drawn[-1])
    return drawn


def _dots(axes, scene, body: Body, line: Line, size: float, strength: float, order: int) -> list:
    """Where tendons begin and end inside the rod, and markers with their names."""
    style = {"linestyle": "none", "alpha": strength, "zorder": order}
    drawn = []
    if body.ends:
        ends = size * np.concatenate([placed(line.part(x.where), x.points) for x in body.ends])
        drawn += axes.plot(*ends.T, marker="o", ms=3, color="black", **style)
    for marker in scene.markers or ():
        k = body.nearest(marker.at)
        offset = np.zeros(3) if marker.offset is None else np.asarray(marker.offset)
        place = size * (line.p[k] + line.R[k] @ offset)
        drawn += axes.plot(*place[:, None], marker="D", ms=3.5, color=_MARKER, **style)
        # Names once, also where a motion is drawn as many shapes.
        if strength == 1.0:
            text = f" {marker.name}"
            drawn.append(axes.text(*place, text, fontsize=7, color=_MARKER, zorder=order))
    return drawn


def _arrows(scene, body: Body, line: Line) -> list[tuple[np.ndarray, np.ndarray]]:
    """Forces as they are drawn, a quarter of the rod long: where, and what, (*batch, 3) [m]."""
    arrows = []
    tip = [] if scene.tip_load is None else [(scene.tip_load.force, scene.length, "base")]
    for force, s, frame in (*tip, *((x.force, x.at, x.frame) for x in scene.loads or ())):
        if force is None or not np.any(force):
            continue
        k = body.nearest(s)
        arrow = 0.25 * float(scene.length) * np.asarray(force) / np.linalg.norm(force)
        if frame == "body":
            arrow = line.R[..., k, :, :] @ arrow
        arrows.append((line.p[..., k, :], np.broadcast_to(arrow, line.p[..., k, :].shape)))
    return arrows


def unit_of(scene) -> tuple[float, str]:
    """The size of a metre in pictures of `scene`, and the name of the unit."""
    return (1e3, "mm") if float(scene.length) < 1 else (1.0, "m")


def upright(scene) -> tuple[int, int]:
    """The axis that is drawn upright, and whether its positive (1) or negative (-1) end is up."""
    if scene.gravity is None or not np.any(scene.gravity):
        return 2, 1
    gravity = np.asarray(scene.gravity)
    axis = int(np.argmax(np.abs(gravity)))
    return axis, -int(np.sign(gravity[axis]))


def shares(values, largest, count) -> np.ndarray:
    """Each value as a part of the largest one; half where nothing is known."""
    if values is None:
        return np.full(count, 0.5)
    values = np.asarray(values, dtype=float)
    if values.shape != (count,):
        raise ValueError(f"draw_rod: inputs of shape {values.shape}; the scene needs ({count},)")
    largest = np.max(np.abs(values), initial=0.0) if largest is None else largest
    return np.clip(np.abs(values) / largest, 0, 1) if largest > 0 else np.zeros(count)


def _surface(grid, colour, alpha, order) -> Poly3DCollection:
    """Rings of points, (rings, corners, 3), joined to a surface."""
    return _lit(faces_of(np.concatenate([grid, grid[:, :1]], axis=1)), colour, alpha, order)


def _lit(faces, colour, alpha, order) -> Poly3DCollection:
    """Faces, (faces, 4, 3), that are lit from one side."""
    normal = np.cross(faces[:, 2] - faces[:, 0], faces[:, 3] - faces[:, 1])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True) + 1e-300
    light = 0.72 + 0.28 * normal @ (_LIGHT / np.linalg.norm(_LIGHT))
    rgb = np.array(list(bytes.fromhex(colour[1:]))) / 255
    colours = np.concatenate([light[:, None] * rgb, np.full((len(light), 1), alpha)], axis=1)
    # Smoothed edges leave a gap between faces: closed by edges where hardly anything shines
    # through, and not seen where much does.
    edges = colours if alpha > 0.6 else "none"
    return Poly3DCollection(
        faces, facecolors=colours, edgecolors=edges, linewidths=0.3, zorder=order
    )


def _cap(line: Line, outline: Part, bores: list[Part]):
    """The end of a segment: rings from its outline to its bore, or to the axis."""
    last = outline.where.stop - 1
    end = line.part(slice(last, last + 1))
    inner = [bore.points[-1] for bore in bores if bore.where == outline.where]
    ring = outline.points[-1]
    return np.concatenate([placed(end, ring), placed(end, inner[0] if inner else 1e-3 * ring)])


def _plate(line: Line, radius: float):
    """The clamp: a round plate behind the beginning of the rod, its rim and its two faces."""
    angle = np.linspace(0, 2 * np.pi, 32, endpoint=False)
    circle = 2.0 * radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    thick = 0.5 * radius * line.R[0, :, 2]
    front = placed(Line(line.p[:1], line.R[:1]), circle)
    middle = placed(Line(line.p[:1], line.R[:1]), 1e-3 * circle)
    back = front - thick
    return (
        np.concatenate([middle - thick, back]),
        np.concatenate([back, front]),
        np.concatenate([front, middle]),
    )


def _ball(centre, radius):
    along, around = np.linspace(0, np.pi, 9), np.linspace(0, 2 * np.pi, 16, endpoint=False)
    x = np.sin(along)[:, None] * np.cos(around)
    y = np.sin(along)[:, None] * np.sin(around)
    z = np.cos(along)[:, None] * np.ones_like(around)
    return centre + radius * np.stack([x, y, z], axis=-1)
