"""The minimum of a problem: the whole search, and going on from where one ended."""

from dataclasses import replace

import numpy as np

import softrod_jax as sr
from calibration.problem.evaluation import reverse_pays
from calibration.problem.problem import Point, Problem
from calibration.search.history import History
from calibration.search.multistart import Start, search
from calibration.search.optimise import Outcome, levenberg_marquardt
from calibration.search.robust import robust_weights
from calibration.search.settings import SearchSettings

# Robust weights change for so many rounds at most, or until none changes by more than this.
_ROUNDS, _UNCHANGED = 6, 0.02


class CalibrationError(ValueError):
    """A calibration that cannot be done: the message says why and what to try."""


def find_minimum(
    problem: Problem, settings: SearchSettings, history: History
) -> tuple[Outcome, tuple[Start, ...]]:
    """The best outcome of all starts with outliers taken out, and how each start ended.

    Raises `CalibrationError` if nothing can be simulated.
    """
    parameters = len(problem.space.parameters.names)
    reverse = settings.optimiser == "adam" and reverse_pays(parameters, outputs=1)
    outcome, starts = search(replace(problem, reverse=reverse), settings, history)
    if not outcome.best.ok:
        raise CalibrationError(
            "the scene cannot be simulated, neither at its own values nor at others nearby: "
            f"{sr.result_message(outcome.best.result)}"
        )
    if reverse:
        # What follows needs the sensitivities of every residual.
        outcome = replace(outcome, best=problem.at(outcome.best.x))
    return _reweighted(outcome, settings.loss, settings.max_iterations, history), starts


def _reweighted(outcome: Outcome, loss: str, max_iterations: int, history: History) -> Outcome:
    """The outcome with outliers taken out; the same for "squares"."""
    if loss == "squares":
        return outcome
    point, iterations = outcome.best, outcome.iterations
    history.stage(f"{loss} weights", None)
    for k in range(_ROUNDS):
        weights = robust_weights(point, loss, k)
        change = np.abs(weights - point.problem.statistics.weights)
        if np.max(change, initial=0.0) < _UNCHANGED:
            break
        problem = point.problem.weighted(weights)
        point = replace(point, problem=problem)
        done = levenberg_marquardt(problem, point, max_iterations, history.add)
        point, iterations = done.best, iterations + done.iterations
    return Outcome(point, outcome.result, iterations)


def minimise_from(point: Point, problem: Problem, max_iterations: int, history: History) -> Outcome:
    """From `point` to the best of `problem`, the same with other steps or another grid."""
    history.stage("finer simulation", max_iterations)
    start = problem.at(point.x)
    history.add(start)
    return levenberg_marquardt(problem, start, max_iterations, history.add)
