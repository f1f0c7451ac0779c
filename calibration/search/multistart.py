"""The search of a fit from several places, of which the best outcome is kept."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from calibration.parameters.scales import Factor
from calibration.problem.problem import Problem
from calibration.search import optimise
from calibration.search.history import History
from calibration.search.optimise import Outcome
from calibration.search.settings import SearchSettings

# Half the width of the span from which the starts of a multi-start are drawn: one decade.
_SPAN = np.log(10.0)
_SPAN_OTHERS = 2.0


@dataclass(frozen=True)
class Start:
    """One start of several: where it began and ended, by label, the rms distance [m] that it left,
    and how it ended."""

    initial: dict[str, float]
    values: dict[str, float]
    rms: float
    result: str


def search(
    problem: Problem, settings: SearchSettings, history: History
) -> tuple[Outcome, tuple[Start, ...]]:
    """The best outcome of all starts, and how each of them ended, the best first.

    Starts that a checkpoint has are not searched again. After an interrupt, the best so far.
    """
    outcomes, interrupted = [], False
    places, done = _places(problem, settings), history.checkpoint.done
    for k, x in enumerate(places):
        if k < len(done):
            end = problem.at(np.array(done[k]["x"]))
            outcomes.append(Outcome(end, done[k]["result"], 0))
            continue
        if k == len(done) and history.checkpoint.x is not None:
            x = history.checkpoint.x
        try:
            outcomes.append(_from(problem, x, k, settings, history))
        except KeyboardInterrupt:
            if history.best is None and not outcomes:
                raise
            interrupted = True
            if history.best is not None:
                outcomes.append(Outcome(history.best, "interrupted", 0))
            break
    loss = lambda k: outcomes[k].best.loss if outcomes[k].best.ok else np.inf
    order = sorted(range(len(outcomes)), key=loss)
    best = outcomes[order[0]]
    starts = tuple(_start(problem, places[k], outcomes[k]) for k in order)
    return (replace(best, result="interrupted") if interrupted else best), starts


def _places(problem: Problem, settings: SearchSettings) -> list[Float[np.ndarray, "unknowns"]]:
    """Where to start: the setup's own values, and others drawn around them."""
    space, random = problem.space, np.random.default_rng(settings.seed)
    n = space.parameter_count
    low, high = (bound[:n] for bound in space.bounds)
    spans = [
        _SPAN if isinstance(u.parameter.scale, Factor) else _SPAN_OTHERS
        for u in space.parameters.items
    ]
    places = [space.origin() for _ in range(settings.starts)]
    for x in places[1:]:
        x[:n] = np.clip(random.uniform(-1, 1, n) * spans, low, high)
    return places


def _from(problem: Problem, x, k: int, settings: SearchSettings, history: History) -> Outcome:
    """The outcome of start `k`, which is told to the checkpoint."""
    number = f" {k + 1} of {settings.starts}" if settings.starts > 1 else ""
    stage = lambda title, total: history.stage(title + number, total)
    history.best = None
    outcome = optimise.minimise(
        problem, settings.optimiser, settings.max_iterations, history.add_of_search, stage, x
    )
    if outcome.best.ok:
        history.checkpoint.finish(outcome.best.x, outcome.best.loss, outcome.result)
    return outcome


def _start(problem: Problem, begun, outcome: Outcome) -> Start:
    plain = lambda x: {k: float(np.max(v)) for k, v in problem.space.values(x).items()}
    best = outcome.best
    return Start(plain(begun), plain(best.x), best.rms if best.ok else np.inf, outcome.result)
