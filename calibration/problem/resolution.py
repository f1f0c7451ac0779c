"""How finely the recordings of a fit are simulated: steps in time, intervals along the rod.

Both are found by trying. The recordings are simulated on twice the grid, with the steps in question
and with half of them, all in one program; what that changes is the error, in time and along the
rod. It is done at the values from which a search starts, and again where it ended
(`calibration.inference.refinement`).
"""

import logging
import math
from dataclasses import dataclass, replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

import softrod_jax as sr
from calibration.experiment.clock import sample_interval
from calibration.experiment.setup import Setup
from calibration.parameters.unknowns import Unknowns
from calibration.problem.batch import make_batch
from calibration.problem.dataset import Dataset
from calibration.problem.evaluation import predict
from calibration.problem.motion import METHOD, SCHEME, Motion
from calibration.problem.problem import Problem, make_problem

_LOG = logging.getLogger(__name__)

# What an error of the tip may be, rms, in lengths of the rod, by default; of what moves less than
# that, this part of the motion. An error along the rod falls with the sixth power of the intervals,
# so that a tenth of it costs little.
_TOLERANCE, _OF_THE_MOTION, _ALONG_THE_ROD = 1e-3, 0.05, 0.1
# A long log is tried with about so many steps first: one in which little happens needs no more.
_FIRST_STEPS = 512
# The orders of the error, cautious, by which steps and intervals follow from those tried.
_ORDER_IN_TIME, _ORDER_ALONG = 3, 5
_MOST_AT_ONCE, _TRIES = 3, 8  # at once: halvings
MOST_INTERVALS = 64
# Failures that finer simulations may cure; after so many in a row they will not.
_CURABLE = (sr.RESULTS.diverged, sr.RESULTS.max_iterations, sr.RESULTS.inaccurate)
_FAILURES = 3


@dataclass(frozen=True)
class FinerSimulations:
    """The recordings at one place on twice the grid, with the steps as they are and with half.

    - `same`, `half`, (recordings, samples, all): residuals; None where a simulation failed.
    - `motions`: with half the steps. `error`: along the rod on twice the grid, as the solver
      estimates it, in lengths of the rod.
    - `curable`: whether what failed may succeed with finer simulations.
    """

    same: Float[np.ndarray, "recordings samples all"] | None
    half: Float[np.ndarray, "recordings samples all"] | None
    motions: Motion | None
    error: float
    curable: bool


@dataclass(frozen=True)
class Resolution:
    """What is simulated, and how fine it has to be.

    - `dt` [s], `method`: the time step and the grid along the rod, which stay as they are; None
      where they are to be found.
    - `tolerance`: of the tip, in lengths of the rod; None: 1e-3.
    """

    data: Dataset
    dt: float | None = None
    method: sr.Collocation | None = None
    tolerance: float | None = None

    def __post_init__(self):
        if self.tolerance is not None and not 0 < self.tolerance < 1:
            raise ValueError(
                f"tolerance={self.tolerance!r}: a part of the rod's length in (0, 1) is needed"
            )

    def first_problem(
        self,
        setup: Setup,
        parameters: Unknowns,
        time_offset: bool,
        scheme: sr.SDIRK | sr.BDFAlpha = SCHEME,
    ) -> Problem:
        """The problem of fitting `parameters`, with the steps and the grid to try first."""
        dt = _first_steps(self.data) if self.dt is None else self.dt
        method = METHOD if self.method is None else self.method
        return make_problem(setup, parameters, self.data, time_offset, dt, scheme, method)

    def refined(self, problem: Problem, divide_steps: int, intervals: int) -> Problem:
        """The problem with every step divided into so many, and so many intervals."""
        dts, method = [c.dt / divide_steps for c in problem.space.clocks], problem.method
        batch, clocks = make_batch(problem.scene, self.data, problem.space.time_offset, dts)
        batch = eqx.tree_at(lambda b: b.weights, batch, problem.batch.weights)
        space = replace(problem.space, clocks=clocks)
        if intervals != method.intervals:
            method = replace(method, intervals=intervals)
        return replace(problem, batch=batch, space=space, method=method)

    def simulate_finer(self, problem: Problem, x) -> FinerSimulations:
        """Simulate at `x` on twice the grid, with the steps of `problem` and with half of them."""
        space, steps = problem.space, [c.dt for c in problem.space.clocks]
        data = self.data.take([*range(len(steps))] * 2)
        halved = [*steps, *(dt / 2 for dt in steps)]
        batch, _ = make_batch(problem.scene, data, space.time_offset, halved)
        twice = lambda array: np.concatenate([array, array])
        weights = jnp.asarray(twice(problem.statistics.weights))
        batch = eqx.tree_at(lambda b: b.weights, batch, weights)
        residuals, motions = jax.device_get(
            predict(
                problem.setup,
                batch,
                jnp.asarray(twice(space.parameters.theta(x))),
                {name: twice(value) for name, value in space.nuisance(x).items()},
                space.parameters.names,
                problem.scheme,
                problem.method.finer(),
            )
        )
        n = len(steps)
        ok = np.asarray(motions.result) == sr.RESULTS.successful
        second = jax.tree.map(lambda leaf: leaf[n:], motions)
        return FinerSimulations(
            same=residuals[:n] if np.all(ok[:n]) else None,
            half=residuals[n:] if np.all(ok[n:]) else None,
            motions=second if np.all(ok[n:]) else None,
            error=float(np.max(motions.error)),
            curable=bool(np.all(np.isin(np.asarray(motions.result)[~ok], _CURABLE))),
        )


def choose_resolution(problem: Problem, resolution: Resolution) -> Problem:
    """The problem with the steps and the grid that its recordings need at the setup's own values.

    As it is, if nothing can be simulated there: the search may find places where something can.
    """
    x, first = problem.space.origin(), problem
    allowed, failures = allowed_errors(problem, resolution), 0
    given = resolution.dt is not None and resolution.method is not None
    for _ in range(0 if given else _TRIES):
        finer = resolution.simulate_finer(problem, x)
        _LOG.debug(
            "tried %s, half the steps and twice the grid: %s",
            told(problem),
            "no solution" if finer.half is None else "solved",
        )
        failures = failures + 1 if finer.half is None else 0
        if failures > _FAILURES or not finer.curable:
            _LOG.info("no steps and grid serve at the first values: %s, as they were", told(first))
            return first
        steps, intervals = _needed(problem, finer, x, allowed, resolution)
        if steps == 1 and intervals == problem.method.intervals:
            break
        problem = resolution.refined(problem, steps, intervals)
    _LOG.info("simulated with %s", told(problem))
    return problem


def told(problem: Problem) -> str:
    """The steps of each recording and the grid of a problem, for the log."""
    steps = ", ".join(dict.fromkeys(f"{clock.dt:.4g}" for clock in problem.space.clocks))
    return f"steps of {steps} s, {problem.method.intervals} intervals along the rod"


def allowed_errors(problem: Problem, resolution: Resolution) -> tuple[float, float]:
    """The errors of the tip [m], rms, that steps in time and the grid along the rod may make."""
    length = float(problem.scene.length)
    tolerance = _TOLERANCE if resolution.tolerance is None else resolution.tolerance
    in_time = min(tolerance * length, _OF_THE_MOTION * problem.statistics.motion_rms)
    return in_time, _ALONG_THE_ROD * in_time


def _first_steps(data: Dataset) -> list[float]:
    """The time steps [s] to try first: a sample's, or several of them where a recording is long."""
    steps = []
    for recording, selection in zip(data.recordings, data.selections, strict=True):
        interval = sample_interval(recording)
        samples = (selection.end - selection.start) / interval
        steps.append(interval * max(1, math.ceil(samples / _FIRST_STEPS)))
    return steps


def _needed(
    problem: Problem, finer: FinerSimulations, x, allowed, resolution: Resolution
) -> tuple[int, int]:
    """Into how many parts to divide the steps, and how many intervals to take."""
    in_time, along = allowed
    intervals, steps = problem.method.intervals, 1
    if resolution.dt is None:
        if finer.same is None:
            steps = 2 if finer.half is not None else 4
        elif finer.half is not None:
            steps = _parts(_rms(problem, finer.half - finer.same) / in_time, _ORDER_IN_TIME)
    if resolution.method is None:
        # What is too little on twice the grid need not be tried.
        on_twice = finer.error * float(problem.scene.length) / along
        if finer.same is None or on_twice > 1:
            intervals *= 2 * _parts(on_twice, _ORDER_ALONG)
        elif steps == 1:
            here = problem.at(x)
            change = finer.same - here.evaluation.residuals
            intervals *= _parts(_rms(problem, change) / along, _ORDER_ALONG) if here.ok else 2
    return steps, min(intervals, max(MOST_INTERVALS, problem.method.intervals))


def _parts(excess: float, order: int) -> int:
    """A power of two by which to divide what has `excess` times the error that is allowed."""
    if not excess > 1:
        return 1
    return 2 ** math.ceil(min(math.log2(excess) / order, _MOST_AT_ONCE))


def _rms(problem: Problem, change) -> float:
    """The rms of a change of the tips' residuals [m], in the recording where it is largest."""
    weights = problem.statistics.weights[..., :3] ** 2
    each = np.sum(weights * change[..., :3] ** 2, axis=(1, 2)) / np.sum(
        np.max(weights, axis=2), axis=1
    )
    return float(np.sqrt(np.max(each)))
