"""How finely the recordings of a fit are simulated: steps in time, intervals along the rod.

Both are found by trying. The recordings are simulated on twice the grid, with the steps in question
and with half of them, all in one program; what that changes is the error, in time and along the
rod. It is done at the values from which a search starts, and again where it ended: there what
counts is whether finer simulations would lead elsewhere.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

import softrod_jax as sr
from calibration.data.recording import Recording
from calibration.data.selection import Selection
from calibration.inference.uncertainty import IDENTIFIED, Uncertainty
from calibration.problem.evaluation import predict
from calibration.problem.motion import Motion, make_batch, sample_interval
from calibration.problem.problem import Point, Problem

# What an error of the tip may be, rms, in lengths of the rod, by default; of what moves less than
# that, this part of the motion. An error along the rod falls with the sixth power of the intervals,
# so that a tenth of it costs little.
TOLERANCE, _OF_THE_MOTION, _ALONG_THE_ROD = 1e-3, 0.05, 0.1
# A long log is tried with about so many steps first: one in which little happens needs no more.
_FIRST_STEPS = 512
# Of the error, by which steps and intervals are chosen where too few were tried; cautious.
_ORDER_IN_TIME, _ORDER_ALONG = 3, 5
_MOST_AT_ONCE, _MOST_INTERVALS, _TRIES = 3, 64, 8  # at once: halvings
# After the fit a finer simulation is called for if it would move a value by this part of the half
# width of its interval, and by more than this in theta, or leaves less than this part of the
# residuals; if it leaves more than that part, the log was itself simulated no finer than that.
_PART_OF_INTERVAL, _LEAST_SHIFT, _CLEARLY_BETTER, _CLEARLY_WORSE = 0.25, 3e-4, 0.9, 1.5
REFITS = 3
# Failures that finer simulations may cure; after so many in a row they will not.
_CURABLE = (sr.RESULTS.diverged, sr.RESULTS.max_iterations, sr.RESULTS.inaccurate)
_FAILURES = 3


@dataclass(frozen=True)
class Finer:
    """The recordings at one place on twice the grid, with the steps as they are and with half.

    - `same`, `half` [m], (recordings, samples, 3): residuals; None where a simulation failed.
    - `motions`: with half the steps. `error`: along the rod on twice the grid, as the solver
      estimates it, in lengths of the rod.
    - `curable`: whether what failed may succeed with finer simulations.
    """

    same: Float[np.ndarray, "recordings samples 3"] | None
    half: Float[np.ndarray, "recordings samples 3"] | None
    motions: Motion | None
    error: float
    curable: bool


@dataclass(frozen=True)
class Resolution:
    """What is simulated, and how fine it has to be.

    - `tolerance`: of the tip, in lengths of the rod.
    - `steps_fixed`, `grid_fixed`: the user has chosen, and they stay as they are.
    """

    recordings: Sequence[Recording]
    selections: Sequence[Selection]
    defaults: dict[str, float]
    drift: dict[str, float]
    tolerance: float
    steps_fixed: bool
    grid_fixed: bool

    def of(self, problem: Problem, dts: Sequence[float], method) -> Problem:
        """The problem with these steps [s] and that grid."""
        batch, clocks = make_batch(
            problem.scene, list(self.recordings), list(self.selections), problem.time_offset,
            list(dts), self.defaults, self.drift,
        )  # fmt: skip
        batch = eqx.tree_at(lambda b: b.weights, batch, problem.batch.weights)
        return replace(problem, batch=batch, clocks=clocks, method=method)

    def finer(self, problem: Problem, x) -> Finer:
        """Simulate at `x` on twice the grid, with the steps of `problem` and with half of them."""
        steps = [c.dt for c in problem.clocks]
        batch, _ = make_batch(
            problem.scene, [*self.recordings] * 2, [*self.selections] * 2, problem.time_offset,
            [*steps, *(dt / 2 for dt in steps)], self.defaults, self.drift,
        )  # fmt: skip
        twice = lambda array: np.concatenate([array, array])
        batch = eqx.tree_at(lambda b: b.weights, batch, jnp.asarray(twice(problem.weights)))
        residuals, motions = jax.device_get(
            predict(
                problem.setup,
                batch,
                jnp.asarray(twice(problem.unknowns.theta(x))),
                {name: twice(course) for name, course in problem.courses(x).items()},
                problem.unknowns.names,
                problem.scheme,
                problem.method.finer(),
            )
        )
        n = len(steps)
        ok = np.asarray(motions.result) == sr.RESULTS.successful
        second = jax.tree.map(lambda leaf: leaf[n:], motions)
        return Finer(
            same=residuals[:n] if np.all(ok[:n]) else None,
            half=residuals[n:] if np.all(ok[n:]) else None,
            motions=second if np.all(ok[n:]) else None,
            error=float(np.max(motions.error)),
            curable=bool(np.all(np.isin(np.asarray(motions.result)[~ok], _CURABLE))),
        )


def first_choice(problem: Problem, resolution: Resolution) -> Problem:
    """The problem with the steps and the grid that its recordings need at the setup's own values.

    As it is, if nothing can be simulated there: the search may find places where something can.
    """
    x, first = problem.start(), problem
    allowed, failures = allowed_errors(problem, resolution), 0
    both_fixed = resolution.steps_fixed and resolution.grid_fixed
    for _ in range(0 if both_fixed else _TRIES):
        finer = resolution.finer(problem, x)
        failures = failures + 1 if finer.half is None else 0
        if failures > _FAILURES or not finer.curable:
            return first
        steps, intervals = _needed(problem, finer, x, allowed, resolution)
        if steps == 1 and intervals == problem.method.intervals:
            return problem
        dts = [c.dt / steps for c in problem.clocks]
        problem = resolution.of(problem, dts, _with_intervals(problem.method, intervals))
    return problem


def allowed_errors(problem: Problem, resolution: Resolution) -> tuple[float, float]:
    """Of the tip [m], rms: from the steps in time, and from the grid along the rod."""
    length = float(problem.scene.length)
    in_time = min(resolution.tolerance * length, _OF_THE_MOTION * problem.motion_rms)
    return in_time, _ALONG_THE_ROD * in_time


def first_steps(recordings: Sequence[Recording], selections: Sequence[Selection]) -> list[float]:
    """What to try first [s]: a sample each, or several of them where a recording is long."""
    steps = []
    for recording, selection in zip(recordings, selections, strict=True):
        interval = sample_interval(recording)
        samples = (selection.end - selection.start) / interval
        steps.append(interval * max(1, math.ceil(samples / _FIRST_STEPS)))
    return steps


def _needed(problem: Problem, finer: Finer, x, allowed, resolution) -> tuple[int, int]:
    """Into how many parts to divide the steps, and how many intervals to take."""
    in_time, along = allowed
    intervals, steps = problem.method.intervals, 1
    if not resolution.steps_fixed:
        if finer.same is None:
            steps = 2 if finer.half is not None else 4
        elif finer.half is not None:
            steps = _parts(_rms(problem, finer.half - finer.same) / in_time, _ORDER_IN_TIME)
    if not resolution.grid_fixed:
        # What is too little on twice the grid need not be tried.
        on_twice = finer.error * float(problem.scene.length) / along
        if finer.same is None or on_twice > 1:
            intervals *= 2 * _parts(on_twice, _ORDER_ALONG)
        elif steps == 1:
            here = problem.at(x)
            change = finer.same - here.evaluation.residuals
            intervals *= _parts(_rms(problem, change) / along, _ORDER_ALONG) if here.ok else 2
    return steps, min(intervals, max(_MOST_INTERVALS, problem.method.intervals))


def _parts(excess: float, order: int) -> int:
    """A power of two by which to divide what has `excess` times the error that is allowed."""
    if not excess > 1:
        return 1
    return 2 ** math.ceil(min(math.log2(excess) / order, _MOST_AT_ONCE))


def _rms(problem: Problem, change) -> float:
    """Of a change of all residuals [m], the largest of any recording."""
    weights = problem.weights**2
    each = np.sum(weights * change**2, axis=(1, 2)) / np.sum(np.max(weights, axis=2), axis=1)
    return float(np.sqrt(np.max(each)))


@dataclass(frozen=True)
class Refined:
    """What finer simulations say of a fit; None where they failed.

    - `by_step`, `by_grid`: change of x (unknowns,) with half the time step and twice the grid.
    - `motions`: of each recording, with half the time step.
    - `again`: whether to fit again, with a step divided by `steps` and with `intervals`.
    - `note`: what is to be said of it, or "".
    """

    by_step: np.ndarray | None = None
    by_grid: np.ndarray | None = None
    motions: Motion | None = None
    steps: int = 1
    intervals: int = 0
    note: str = ""
    again: bool = False


def finer_problem(problem: Problem, refined: Refined, resolution: Resolution) -> Problem:
    """The problem with the steps and intervals that `refined` asks for."""
    dts = [c.dt / refined.steps for c in problem.clocks]
    return resolution.of(problem, dts, _with_intervals(problem.method, refined.intervals))


def _with_intervals(method, intervals: int):
    return method if intervals == method.intervals else replace(method, intervals=intervals)


def refine(best: Point, known: Uncertainty, resolution: Resolution) -> Refined:
    """Simulate the result of a fit again, more finely."""
    problem = best.problem
    finer = resolution.finer(problem, best.x)
    steps, intervals, notes = 1, problem.method.intervals, []
    by_step = by_grid = None
    if finer.same is not None:
        by_grid, verdict = _judged(best, known, finer.same - best.evaluation.residuals)
        if verdict == _FINER and not resolution.grid_fixed and 2 * intervals <= _MOST_INTERVALS:
            intervals *= 2
        elif verdict == _SIMULATED:
            notes.append("twice the grid along the rod")
        if finer.half is not None:
            by_step, verdict = _judged(best, known, finer.half - finer.same)
            if verdict == _FINER and not resolution.steps_fixed:
                steps = 2
            elif verdict == _SIMULATED:
                notes.append("half the time step")
    note = ""
    if notes:
        note = (
            f"With {' or '.join(notes)} the simulation would be further from the recordings than "
            "it is now, which is not so of a real robot: they look as if they had been simulated "
            "like this, and no finer. The values are those of that simulation."
        )
    again = steps > 1 or intervals > problem.method.intervals
    return Refined(by_step, by_grid, finer.motions, steps, intervals, note, again)


_FINER, _SIMULATED, _FINE = "finer", "simulated", "fine"


def _judged(best: Point, known: Uncertainty, change) -> tuple[np.ndarray, str]:
    """How x moves if residuals change by `change`, and what follows from that."""
    problem = best.problem
    change = (problem.weights * change).ravel()
    shift = known.shift(best, change)
    n = problem.size
    now = np.linalg.norm(best.residuals)
    then = np.linalg.norm(best.residuals + change + best.jacobian @ shift)
    floor = 1e-4 * float(problem.scene.length) * np.sqrt(problem.samples)
    half = known.quantile * known.standard_errors[:n]
    moved = np.abs(shift[:n])
    identified = np.array([v == IDENTIFIED for v in known.verdicts])
    matters = np.any(identified & (moved > _PART_OF_INTERVAL * half) & (moved > _LEAST_SHIFT))
    if matters and then > _CLEARLY_WORSE * now:
        return shift, _SIMULATED
    if matters or (now > floor and then < _CLEARLY_BETTER * now):
        return shift, _FINER
    return shift, _FINE
