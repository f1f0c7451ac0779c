"""Pictures of small motions: the shapes of modes about an equilibrium."""

import math
from types import SimpleNamespace

import numpy as np
from matplotlib.figure import Figure

from softrod_jax.analysis.modes import Modes
from softrod_jax.pictures.body import body_of, cubic, line_along
from softrod_jax.pictures.drawing import POINTS, draw_rod, rod_axes, unit_of
from softrod_jax.pictures.stills import check_solved
from softrod_jax.scene.scene import Scene

# The largest displacement that is drawn, in lengths of the rod, and at how many moments.
_AMPLITUDE, _MOMENTS = 0.12, 12
_MOST_COLUMNS = 3
_COLOUR, _ON_TOP = "#c0392b", 10_000


def modes_picture(
    scene: Scene,
    found: Modes,
    *,
    view: tuple[float, float] = (16.0, -60.0),
    size: tuple[float, float] = (4.0, 3.8),
) -> Figure:
    """The modes of `sr.modes`, each in 3D beside the next: the rod in equilibrium, and how its axis
    swings about it.

    Lines are the axis at moments of one turn, the strong one where it is farthest out. Amplitudes
    are chosen to be seen; a mode that moves the axis nowhere, such as twisting, has no lines.

    - `view`: elevation and azimuth [deg]. `size` of each mode [inch].

    Returns a figure of matplotlib, with `savefig`. Raises `ValueError` for an equilibrium that
    failed, or for a batch of them.
    """
    check_solved("modes_picture", found.equilibrium)
    rest, count = found.equilibrium, len(found.eigenvalues)
    columns = min(count, _MOST_COLUMNS)
    rows = math.ceil(count / columns)
    figure = Figure(figsize=(columns * size[0], rows * size[1]))
    figure.subplots_adjust(left=0, right=0.97, bottom=0.03, top=0.95, wspace=0.02, hspace=0.12)
    moved = [_swing(shape, float(scene.length)) for shape in np.asarray(found.shapes)]
    everywhere = _shapes(rest, np.concatenate(moved))
    unit, _ = unit_of(scene)
    # Where something jumps there are two nodes in one place.
    nodes, first = np.unique(np.asarray(rest.arc_lengths), return_index=True)
    arc = body_of(scene, POINTS).arc
    axis = line_along(rest, arc).p
    for k, swing in enumerate(moved):
        axes = rod_axes(figure, scene, everywhere, place=(rows, columns, k + 1), view=view)
        draw_rod(axes, scene, rest)
        for n, change in reversed(list(enumerate(swing))):
            slopes = np.gradient(change[first], nodes, axis=0)
            line = unit * (axis + cubic(change[first], slopes, nodes, arc))
            width, strength = (1.8, 1.0) if n == 0 else (0.7, 0.45)
            axes.plot(*line.T, color=_COLOUR, lw=width, alpha=strength, zorder=_ON_TOP)
        frequency, ratio = float(found.frequencies[k]), float(found.damping_ratios[k])
        axes.set_title(f"{k + 1}: {frequency:.3g} Hz, damping ratio {ratio:.2g}", fontsize=9)
    return figure


def _swing(shape: np.ndarray, length: float) -> np.ndarray:
    """Displacements (moments, nodes, 3) [m] of the axis, the farthest first."""
    largest = shape.ravel()[np.argmax(np.abs(shape))]
    if largest == 0:
        return np.zeros((1, *shape.shape))
    turn = np.exp(2j * np.pi * np.arange(_MOMENTS) / _MOMENTS)
    return _AMPLITUDE * length * np.real(turn[:, None, None] * shape / largest)


def _shapes(rest, moved: np.ndarray):
    """All displaced axes, as `rod_axes` takes them: it makes room for them."""
    tile = lambda x: np.tile(np.asarray(x), (len(moved), 1, 1))
    return SimpleNamespace(
        positions=tile(rest.positions) + moved,
        quaternions=tile(rest.quaternions),
        strains=tile(rest.strains),
        arc_lengths=rest.arc_lengths,
    )
