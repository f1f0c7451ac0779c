"""Pictures of a rod in a learning pipeline."""

from types import SimpleNamespace

import numpy as np

from softrod_jax.learning.stepping import RodView
from softrod_jax.scene.scene import Scene

_SIZE, _DOTS = (4.0, 4.0), 80  # [inch], a inch


def frame(scene: Scene, view: RodView, target: np.ndarray) -> np.ndarray:
    """The rod and its `target` [m], (3,), as an image (height, width, 3) of bytes.

    Axes hold all that a rod of this length can reach, so that frames make a film. Raises
    `ImportError`, with what to install, without the extra `plots`.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    from softrod_jax.pictures import draw_rod, rod_axes  # the extra `plots`, for pictures only

    figure = Figure(figsize=_SIZE, dpi=_DOTS)
    figure.subplots_adjust(left=0, right=1, bottom=0, top=1)
    canvas = FigureCanvasAgg(figure)
    axes = rod_axes(figure, scene, _everywhere(scene, view))
    draw_rod(axes, scene, view)
    unit = 1e3 if axes.get_xlabel().endswith("[mm]") else 1.0
    axes.plot(*(unit * target[:, None]), "o", ms=6, color="#c0392b", zorder=10_000)
    canvas.draw()
    return np.asarray(canvas.buffer_rgba())[..., :3].copy()


def _everywhere(scene: Scene, view: RodView):
    """Corners of the space about the base, in the form of shapes."""
    base = np.asarray(view.positions)[0]
    reach = float(scene.length) * np.array([[-1.0], [1.0]])
    points, nodes = base + reach * np.ones(3), view.positions.shape[0]
    still = np.broadcast_to(np.array([1.0, 0, 0, 0]), (2, nodes, 4))
    return SimpleNamespace(
        positions=np.repeat(points[:, None], nodes, axis=1),
        quaternions=still,
        strains=np.zeros((2, nodes, 6)),
    )
