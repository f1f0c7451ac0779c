"""Every evaluation of a fit: for the meter, the checkpoint, the history, and the best."""

import logging

from calibration.problem.problem import Point
from calibration.search.checkpoint import Checkpoint
from calibration.search.progress import AbstractMeter

_LOG = logging.getLogger(__name__)


class History:
    """The evaluations so far, `entries`: stage, rms distance [m] and values by label of each.

    `best`: the best point of the start that is being searched from, or None.
    """

    def __init__(self, meter: AbstractMeter, checkpoint: Checkpoint):
        self.meter, self.checkpoint = meter, checkpoint
        self.entries: list[dict] = []
        self.best: Point | None = None
        self._stage = ""

    def stage(self, title: str, total: int | None) -> None:
        """A part of the fit begins, of at most `total` evaluations; None: nobody knows."""
        self._stage = title
        _LOG.info("stage: %s", title)
        self.meter.stage(title, total)

    def add(self, point: Point) -> None:
        """One evaluation, of whatever part of the fit."""
        values = {name: v.tolist() for name, v in point.problem.space.values(point.x).items()}
        rms = point.rms if point.ok else None
        self.entries.append({"stage": self._stage, "rms_m": rms, **values})
        _LOG.debug("%s: rms %s m at %s", self._stage, rms, values)
        self.meter.show(point)

    def add_of_search(self, point: Point) -> None:
        """An evaluation of the search itself, whose best is kept, on disk as well."""
        self.add(point)
        self.checkpoint.point(point)
        if point.ok and (self.best is None or point.loss < self.best.loss):
            self.best = point

    def result(self, point: Point) -> None:
        """What the fit ended with."""
        self.meter.result(point)
