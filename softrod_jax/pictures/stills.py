"""Pictures that stand still: an equilibrium, or some moments of a motion."""

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from softrod_jax.dynamics import Trajectory
from softrod_jax.foundation.results import RESULTS, result_message
from softrod_jax.pictures.body import Line, body_of, line_along
from softrod_jax.pictures.drawing import (
    CHAMBER_COLOUR,
    MEASURED_COLOUR,
    POINTS,
    TENDON_COLOURS,
    draw_line,
    draw_obstacles,
    draw_rod,
    rod_axes,
    unit_of,
)
from softrod_jax.scene.scene import Scene

_ON_TOP = 10_000


def picture(
    scene: Scene,
    solution,
    tensions=None,
    pressures=None,
    *,
    view: tuple[float, float] = (16.0, -60.0),
    size: tuple[float, float] = (5.5, 5.0),
) -> Figure:
    """One shape of a rod, such as a `StaticSolution`, in 3D.

    - `tensions` [N], (tendons,), and `pressures` [Pa], (chambers,), are shown in the legend, and
      by the width of a tendon and the darkness of a chamber.
    - `view`: elevation and azimuth [deg]. `size` of the figure [inch].

    Returns a figure of matplotlib, with `savefig`. Raises `ValueError` for a solution that failed,
    or for a batch of them.
    """
    check_solved("picture", solution)
    figure = Figure(figsize=size)
    figure.subplots_adjust(left=0, right=1, bottom=0, top=1)
    axes = rod_axes(figure, scene, solution, view=view)
    draw_obstacles(axes, scene, np.asarray(solution.positions))
    draw_rod(axes, scene, solution, tensions=tensions, pressures=pressures)
    add_legend(axes, scene, tensions, pressures)
    return figure


def stills(
    scene: Scene,
    trajectory: Trajectory,
    count: int = 6,
    *,
    view: tuple[float, float] = (16.0, -60.0),
    size: tuple[float, float] = (5.5, 5.0),
) -> Figure:
    """`count` shapes of a motion, evenly in time, faint to strong, and the path of the tip.

    Obstacles are drawn where the scene has them. Options and errors as in `picture`.
    """
    check_solved("stills", trajectory)
    if count < 1:
        raise ValueError(f"stills: count={count}; at least 1 is needed")
    figure = Figure(figsize=size)
    figure.subplots_adjust(left=0, right=1, bottom=0, top=1)
    axes = rod_axes(figure, scene, trajectory, view=view)
    draw_stills(axes, scene, trajectory, count)
    return figure


def draw_stills(
    axes, scene: Scene, trajectory: Trajectory, count: int = 6, *, measured_tip=None
) -> None:
    """`count` shapes of a motion, faint to strong, and the path of the tip, into `axes`.

    `axes`: of `rod_axes`. `measured_tip` [m], (times, 3): dots, where it is known.
    """
    body = body_of(scene, POINTS)
    lines = line_along(trajectory, body.arc)
    draw_obstacles(axes, scene, lines.p.reshape(-1, 3))
    shown = np.unique(np.linspace(0, len(trajectory.ts) - 1, count).round().astype(int))
    half = [np.full(len(part), 0.5) for part in (body.tendons, body.chambers)]
    for n, k in enumerate(shown):
        strength = 0.12 + 0.88 * ((n + 1) / len(shown)) ** 3
        line = Line(lines.p[k], lines.R[k])
        draw_line(axes, scene, body, line, *half, strength=strength, clamp=n == 0, layer=n)
    size, _ = unit_of(scene)
    axes.plot(*(size * lines.p[:, -1].T), color="black", lw=0.8, zorder=_ON_TOP)
    if measured_tip is not None:
        draw_dots(axes, size * np.asarray(measured_tip))


def draw_dots(axes, points) -> None:
    """Points (n, 3), where they are known."""
    points = points[np.all(np.isfinite(points), axis=1)]
    axes.plot(*points.T, ".", ms=2, color=MEASURED_COLOUR, zorder=_ON_TOP)


def add_legend(axes, scene: Scene, tensions=None, pressures=None) -> None:
    """What the colours mean, with the inputs where there are any."""
    handles = []
    count = 0 if scene.tendons is None else scene.tendons.count
    for i in range(count):
        value = "" if tensions is None else f": {float(tensions[i]):.3g} N"
        colour = TENDON_COLOURS[i % len(TENDON_COLOURS)]
        handles.append(Line2D([], [], color=colour, lw=2, label=f"tendon {i + 1}{value}"))
    count = 0 if scene.chambers is None else scene.chambers.count
    for i in range(count):
        name = "chamber" if count == 1 else f"chamber {i + 1}"
        value = "" if pressures is None else f": {1e-3 * float(pressures[i]):.3g} kPa"
        handles.append(Patch(color=CHAMBER_COLOUR, alpha=0.6, label=f"{name}{value}"))
    if handles:
        axes.legend(handles=handles, loc="upper left", fontsize=8, frameon=False)


def check_solved(who: str, solution) -> None:
    """Raise `ValueError` unless `solution` is one that succeeded."""
    result = getattr(solution, "result", RESULTS.successful)
    if np.ndim(result) != 0:
        raise ValueError(
            f"{who}: a batch of {np.shape(result)}; take one sample of it, such as "
            "jax.tree.map(lambda x: x[0], solutions)"
        )
    if int(result) != 0:
        raise ValueError(f"{who}: there is nothing to draw: {result_message(result)}")
