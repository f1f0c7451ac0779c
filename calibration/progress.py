"""What a fit shows while it runs: iteration, loss, parameters and time left."""

import abc

import numpy as np

from calibration.loss import Point
from calibration.parameters import PARAMETERS


class Meter(abc.ABC):
    """Used as a context; `stage` begins a part of the fit, `show` reports a point of it."""

    def __enter__(self):
        return self

    def __exit__(self, *error):
        return None

    @abc.abstractmethod
    def stage(self, title: str, total: int | None) -> None:
        """A part of at most `total` evaluations begins; None: nobody knows."""

    @abc.abstractmethod
    def show(self, point: Point) -> None:
        """One evaluation is done."""


class Silent(Meter):
    """Shows nothing."""

    def stage(self, title, total):
        pass

    def show(self, point):
        pass


class Bar(Meter):
    """A bar on stderr, by rich. Parameters are shown at their values in the best point so far."""

    def __init__(self):
        from rich.console import Console
        from rich.progress import (
            BarColumn,
            MofNCompleteColumn,
            Progress,
            SpinnerColumn,
            TextColumn,
            TimeElapsedColumn,
            TimeRemainingColumn,
        )

        self._progress = Progress(
            SpinnerColumn(),
            TextColumn("{task.description}"),
            BarColumn(bar_width=20),
            MofNCompleteColumn(),
            TextColumn("{task.fields[loss]}"),
            TimeElapsedColumn(),
            TextColumn("left"),
            TimeRemainingColumn(),
            TextColumn("{task.fields[values]}"),
            console=Console(stderr=True),
        )
        self._task = None
        self._best = np.inf

    def __enter__(self):
        self._progress.start()
        return self

    def __exit__(self, *error):
        self._finish()
        self._progress.stop()

    def stage(self, title, total):
        self._finish()
        self._best = np.inf
        self._task = self._progress.add_task(title, total=total, loss="", values="")

    def show(self, point):
        if point.ok and point.loss < self._best:
            self._best = point.loss
            self._progress.update(
                self._task, loss=f"rms {1e3 * point.rms:.3g} mm", values=_values(point)
            )
        self._progress.advance(self._task)

    def _finish(self):
        """An optimiser that stopped early is done, not at 20 %."""
        if self._task is not None:
            done = self._progress.tasks[-1].completed
            self._progress.update(self._task, total=done)
            self._progress.stop_task(self._task)


def _values(point: Point) -> str:
    parts = []
    for name, value in point.problem.values(point.x).items():
        unit = PARAMETERS[name].unit
        text = ",".join(f"{v:.4g}" for v in np.ravel(value))
        parts.append(f"{name} {text}" + (f" {unit}" if unit != "1" else ""))
    return "  ".join(parts)
