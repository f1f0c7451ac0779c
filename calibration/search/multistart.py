"""The search of a fit: from several places, with outliers taken out, and on finer grids."""

from dataclasses import dataclass, replace

import numpy as np

from calibration.parameters.scales import Factor
from calibration.problem.problem import Point, Problem
from calibration.search import optimise, robust
from calibration.search.checkpoint import Checkpoint
from calibration.search.optimise import Outcome
from calibration.search.progress import Meter


@dataclass(frozen=True)
class Start:
    """One start of several: where it began and ended (by label), its loss relative to the best,
    and the rms distance [m]."""

    initial: dict[str, float]
    values: dict[str, float]
    rms: float
    result: str


# Half the width of the span from which the starts of a multi-start are drawn: one decade.
_SPAN = np.log(10.0)
_SPAN_OTHERS = 2.0


class Log:
    """Every evaluation of a fit: for the meter, the checkpoint, the history, and the best."""

    def __init__(self, meter: Meter, saved: Checkpoint):
        self.meter, self.saved, self.history, self.title = meter, saved, [], ""
        self.best = None

    def stage(self, title: str, total: int | None) -> None:
        self.title = title
        self.meter.stage(title, total)

    def add(self, point: Point) -> None:
        values = {name: v.tolist() for name, v in point.problem.values(point.x).items()}
        rms = point.rms if point.ok else None
        self.history.append({"stage": self.title, "rms_m": rms, **values})
        self.meter.show(point)

    def result(self, point: Point) -> None:
        """What the fit ended with."""
        self.meter.result(point)

    def search(self, point: Point) -> None:
        """An evaluation of the search itself, whose best is kept."""
        self.add(point)
        self.saved.point(point)
        if point.ok and (self.best is None or point.loss < self.best.loss):
            self.best = point


def search(problem, optimiser, max_iterations, starts, seed, log) -> tuple[Outcome, tuple]:
    """The best outcome of all starts, and how each of them ended, the best first."""
    random = np.random.default_rng(seed)
    low, high = (b[: problem.size] for b in problem.bounds)
    spans = [
        _SPAN if isinstance(u.parameter.scale, Factor) else _SPAN_OTHERS
        for u in problem.unknowns.items
    ]
    outcomes, begun, interrupted = [], [], False
    for k in range(starts):
        x = problem.start()
        if k:
            x[: problem.size] = np.clip(random.uniform(-1, 1, problem.size) * spans, low, high)
        begun.append(x)
        if k < len(log.saved.done):
            done = log.saved.done[k]
            outcomes.append(Outcome(problem.at(np.array(done["x"])), done["result"], 0))
            continue
        if k == len(log.saved.done) and log.saved.x is not None:
            x = log.saved.x
        number = f" {k + 1} of {starts}" if starts > 1 else ""
        stage = lambda title, total, number=number: log.stage(title + number, total)
        log.best = None
        try:
            outcome = optimise.minimise(problem, optimiser, max_iterations, log.search, stage, x)
        except KeyboardInterrupt:
            if log.best is None and not outcomes:
                raise
            interrupted = True
            if log.best is not None:
                outcomes.append(Outcome(log.best, "interrupted", 0))
            break
        outcomes.append(outcome)
        if outcome.best.ok:
            log.saved.finish(outcome.best.x, outcome.best.loss, outcome.result)
    order = sorted(
        range(len(outcomes)), key=lambda k: outcomes[k].best.loss if outcomes[k].best.ok else np.inf
    )
    plain = lambda x: {k: float(np.max(v)) for k, v in problem.values(x).items()}
    ends = tuple(
        Start(plain(begun[k]), plain(b.x), b.rms if b.ok else np.inf, outcomes[k].result)
        for k in order
        for b in [outcomes[k].best]
    )
    best = outcomes[order[0]]
    return (replace(best, result="interrupted") if interrupted else best), ends


def reweighted(outcome: Outcome, loss: str, max_iterations: int, log) -> Outcome:
    """The outcome with outliers taken out; the same for "squares"."""
    if loss == "squares":
        return outcome
    point, iterations = outcome.best, outcome.iterations
    log.stage(f"{loss} weights", None)
    for k in range(robust.ROUNDS):
        weights = robust.weights(point, loss, k)
        if robust.settled(point.problem.weights, weights):
            break
        problem = point.problem.weighted(weights)
        point = replace(point, problem=problem)
        done = optimise.levenberg_marquardt(problem, point, max_iterations, log.add)
        point, iterations = done.best, iterations + done.iterations
    return Outcome(point, outcome.result, iterations)


def polished(point: Point, problem: Problem, max_iterations: int, log: Log) -> Outcome:
    """From `point` to the best of `problem`, the same with other steps or another grid."""
    log.stage("finer simulation", max_iterations)
    start = problem.at(point.x)
    log.add(start)
    return optimise.levenberg_marquardt(problem, start, max_iterations, log.add)
