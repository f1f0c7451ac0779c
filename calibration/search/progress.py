"""What a fit shows while it runs: iteration, loss, parameters and time left."""

import abc
from collections.abc import Callable

import numpy as np

from calibration.problem.problem import Point

# What a part of a fit tells about itself: each point evaluated, and that a part of at most so many
# evaluations begins.
Report = Callable[[Point], None]
Stage = Callable[[str, int | None], None]


class AbstractMeter(abc.ABC):
    """Used as a context; `stage` begins a part of the fit, `show` reports a point of it."""

    @abc.abstractmethod
    def __enter__(self):
        pass

    @abc.abstractmethod
    def __exit__(self, *error):
        pass

    @abc.abstractmethod
    def stage(self, title: str, total: int | None) -> None:
        """A part of at most `total` evaluations begins; None: nobody knows."""

    @abc.abstractmethod
    def show(self, point: Point) -> None:
        """One evaluation is done."""

    @abc.abstractmethod
    def result(self, point: Point) -> None:
        """What the fit ended with."""


class Silent(AbstractMeter):
    """Shows nothing."""

    def __enter__(self):
        return self

    def __exit__(self, *error):
        pass

    def stage(self, title, total):
        pass

    def show(self, point):
        pass

    def result(self, point):
        pass


class Bar(AbstractMeter):
    """A bar on stderr, by rich; below it the parameters of the best point of the stage, and in the
    end those of the result."""

    def __init__(self):
        from rich.console import Console
        from rich.live import Live
        from rich.progress import (
            BarColumn,
            Progress,
            SpinnerColumn,
            TextColumn,
            TimeRemainingColumn,
        )

        self._progress = Progress(
            SpinnerColumn(),
            TextColumn("{task.description}"),
            BarColumn(bar_width=16),
            TextColumn("{task.fields[count]}"),
            TextColumn("{task.fields[loss]}"),
            TimeRemainingColumn(),
            TextColumn("left"),
        )
        self._task = None
        self._total: int | None = None
        self._done = 0
        self._title = ""
        self._best = np.inf
        self._values = ""
        self._console = Console(stderr=True)
        self._live = Live(get_renderable=self._render, console=self._console)

    def __enter__(self):
        self._live.start()
        return self

    def __exit__(self, *error):
        self._finish()
        self._live.refresh()  # in a notebook the last picture is not drawn otherwise
        self._live.stop()
        if not (self._console.is_terminal or self._console.is_jupyter):
            self._console.line()  # rich ends the last picture in a file without one

    def stage(self, title, total):
        first = self._task is None
        self._finish()
        self._best, self._title = np.inf, title
        shown = "compiling the simulation" if first else title
        self._task = self._progress.add_task(shown, total=total, loss="", count="")
        self._total, self._done = total, 0

    def show(self, point):
        if self._task is None:
            return
        self._done += 1
        count = f"{self._done}/{'?' if self._total is None else self._total}"
        self._progress.update(self._task, description=self._title, advance=1, count=count)
        if point.ok and point.loss < self._best:
            self._best, self._values = point.loss, _values(point)
            self._progress.update(self._task, loss=f"rms {1e3 * point.rms:.4g} mm")

    def result(self, point):
        self._finish()
        self._values = _values(point)

    def _finish(self):
        """An optimiser that stopped early is done, not at 20 %."""
        if self._task is not None:
            # What evaluated nothing has no bar: 0 of 0 says nothing.
            self._progress.update(
                self._task,
                total=self._done,
                completed=self._done,
                count=f"{self._done}/{self._done}",
                visible=self._done > 0,
            )

    def _render(self):
        from rich.console import Group
        from rich.text import Text

        return Group(self._progress, Text("  " + self._values))


def _values(point: Point) -> str:
    parts = []
    for item, theta in zip(point.problem.space.parameters.items, point.x, strict=False):
        unit = item.parameter.unit
        text = ",".join(f"{v:.4g}" for v in np.ravel(item.value(theta)))
        parts.append(f"{item.label} {text}" + (f" {unit}" if unit != "1" else ""))
    return "  ".join(parts)
