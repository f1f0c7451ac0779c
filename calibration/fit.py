"""`calibrate`: from a scene and recordings to fitted numbers with intervals."""

import time
from collections.abc import Sequence
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np

import softrod_jax as sr
from calibration import optimise, uncertainty
from calibration.loss import Point, Problem
from calibration.model import METHOD, SCHEME, Clock, make_batch, tip_at
from calibration.parameters import PARAMETERS, choose
from calibration.progress import Bar, Meter, Silent
from calibration.recording import Recording
from calibration.selection import Selection, select


@dataclass(frozen=True)
class Estimate:
    """One fitted parameter, in its unit; arrays (n,) where the scene's value is one.

    - `ci95`: ends of the 95 % interval; None for a side on which the data set no bound.
    - `identifiable`: whether the data bound it on both sides.
    - `step_shift`: how far the value would move, relatively, with a time step twice as long;
      None if that could not be simulated.
    """

    value: float | np.ndarray
    ci95: tuple
    initial: float | np.ndarray
    unit: str
    identifiable: bool
    step_shift: float | None


@dataclass(frozen=True, eq=False)
class RecordingFit:
    """One recording and its fit at the samples that were used (n,).

    - `times` [s], the recording's clock; `measured` and `simulated` [m], (n, 3); NaN where a
      coordinate is missing. The simulated tip is seen in the recording's frame.
    - `curve_times` [s] and `curve` [m]: the simulated tip on a fine grid, for plots.
    - `rmse` [m]: root mean square distance; `rmse_axes` [m], (3,).
    - `time_offset` [s]: for a recording with inputs, how much later than its inputs the tip's
      clock says they began; for a release, when it happened on the recording's clock.
    - `time_offset_ci95` [s], None if it was not fitted.
    - `tip_offset` [m] and `frame_rotation` [rad], (3,) each: how the recording's frame was moved
      to fit (`calibration.alignment`); None if the recording knows where the clamp is.
    """

    name: str
    recording: Recording
    selection: Selection
    times: np.ndarray
    measured: np.ndarray
    simulated: np.ndarray
    curve_times: np.ndarray
    curve: np.ndarray
    rmse: float
    rmse_axes: np.ndarray
    time_offset: float
    time_offset_ci95: tuple[float, float] | None
    tip_offset: np.ndarray | None
    frame_rotation: np.ndarray | None


@dataclass(frozen=True, eq=False)
class Fit:
    """The outcome of `calibrate`.

    - `scene`: the scene with the fitted values; `parameters`: an `Estimate` by name.
    - `recordings`: a `RecordingFit` each. `rmse_m` [m] and `time_offset_s` [s], by name.
    - `result`: "converged", or why the fit stopped.
    - `history`: after each evaluation: stage, rms distance [m] and values by name.
    - `correlation`, (parameters, parameters), in the order of `parameters`.
    - `effective_samples`: how many independent coordinates the residuals are worth.
    - `dt` [s]: the time step used, by recording. `seconds`: how long the fit took.
    """

    scene: sr.Scene
    parameters: dict[str, Estimate]
    recordings: tuple[RecordingFit, ...]
    result: str
    optimiser: str
    iterations: int
    evaluations: int
    history: list[dict]
    correlation: np.ndarray
    effective_samples: float
    dt: dict[str, float]
    seconds: float

    @property
    def rmse_m(self) -> dict[str, float]:
        return {r.name: r.rmse for r in self.recordings}

    @property
    def time_offset_s(self) -> dict[str, float]:
        return {r.name: r.time_offset for r in self.recordings}


class CalibrationError(ValueError):
    """A calibration that cannot be done: the message says why and what to try."""


def calibrate(
    scene: sr.Scene,
    recordings: Sequence[Recording],
    *,
    fit: Sequence[str] | None = None,
    time_offset: bool = True,
    optimiser: str = "levenberg_marquardt",
    progress: bool = True,
    max_iterations: int | None = None,
    dt: float | None = None,
    window: tuple[float, float] | None = None,
    scheme=SCHEME,
    method=METHOD,
) -> Fit:
    """Fit numbers of `scene` so that its tip moves as recorded.

    - `fit`: names out of `calibration.parameters.PARAMETERS`; by default those of
      young_modulus, bending_damping and drag_coefficient that the scene has. The search starts
      from their values in the scene.
    - `time_offset`: also fit, for each recording, when its inputs or its release really began.
    - `optimiser`: "levenberg_marquardt" or "adam" (gradient descent).
    - `progress`: show a bar on stderr.
    - `max_iterations`: evaluations by the optimiser, after the coarse search.
    - `dt` [s]: the time step; by default the sample interval, or the multiple or fraction of it
      that is nearest below 10 ms.
    - `window`: use the samples from start to end [s, the recordings' clocks]; by default
      the rule `calibration.selection.RULE`.
    - `scheme`, `method`: in time and along the rod, as for `softrod_jax.simulate`.

    A recording without inputs is a release: the rod is held straight until it is let go. One
    with inputs starts straight, or hanging in equilibrium if its first sample is elsewhere.
    Ctrl-C ends the optimisation early and keeps the best point.

    Raises `ValueError` for bad arguments, `RecordingError` for recordings that cannot be used,
    `CalibrationError` if nothing can be simulated from the scene's values.
    """
    begun = time.perf_counter()
    scene = jax.tree.map(jnp.asarray, scene)
    names = choose(scene, fit)
    recordings = [recordings] if isinstance(recordings, Recording) else list(recordings)
    if not recordings:
        raise ValueError("recordings: none given; at least one is needed")
    if optimiser not in optimise.OPTIMISERS:
        choices = ", ".join(optimise.OPTIMISERS)
        raise ValueError(f"optimiser={optimiser!r}: choose from {choices}")
    _, usual = optimise.OPTIMISERS[optimiser]
    max_iterations = usual if max_iterations is None else int(max_iterations)
    if max_iterations < 1:
        raise ValueError(f"max_iterations={max_iterations}: at least 1 is needed")

    selections = [select(r, window) for r in recordings]
    batch, clocks = make_batch(scene, recordings, selections, time_offset, dt)
    problem = Problem(scene, batch, clocks, names, time_offset, scheme, method)
    with Bar() if progress else Silent() as meter:
        log = _Log(meter)
        try:
            outcome = optimise.minimise(problem, optimiser, max_iterations, log.add, log.stage)
        except KeyboardInterrupt:
            if log.best is None:
                raise
            outcome = optimise.Outcome(log.best, "interrupted", len(log.history))
        best = outcome.best
        if not best.ok:
            raise CalibrationError(
                "the scene cannot be simulated, neither at its own values nor at others nearby: "
                f"{sr.result_message(best.result)}"
            )
        log.stage("intervals", None)
        known = uncertainty.estimate(best, log.add)
        shift = _step_shift(problem, best, known, recordings, selections)
    labels = _labels(recordings)
    n = len(names)
    return Fit(
        scene=problem.fitted_scene(best.x),
        parameters=_estimates(problem, best, known, shift),
        recordings=tuple(
            _recording_fit(best, known, k, label, recordings[k], selections[k])
            for k, label in enumerate(labels)
        ),
        result=outcome.result,
        optimiser=optimiser,
        iterations=outcome.iterations,
        evaluations=len(log.history),
        history=log.history,
        correlation=known.correlation[:n, :n],
        effective_samples=known.effective_samples,
        dt=dict(zip(labels, (c.dt for c in clocks), strict=True)),
        seconds=time.perf_counter() - begun,
    )


class _Log:
    """Every evaluation of a fit: for the meter, the history and, if interrupted, the best."""

    def __init__(self, meter: Meter):
        self.meter, self.history, self.best, self.title = meter, [], None, ""

    def stage(self, title: str, total: int | None) -> None:
        self.title = title
        self.meter.stage(title, total)

    def add(self, point: Point) -> None:
        values = {name: v.tolist() for name, v in point.problem.values(point.x).items()}
        rms = point.rms if point.ok else None
        self.history.append({"stage": self.title, "rms_m": rms, **values})
        if point.ok and (self.best is None or point.loss < self.best.loss):
            self.best = point
        self.meter.show(point)


def _step_shift(problem, best, known, recordings, selections):
    """Change of x if the time step were doubled; NaN if that cannot be simulated.

    The same compiled program serves: it has steps enough.
    """
    dts = {c.dt for c in problem.clocks}
    coarse, _ = make_batch(
        problem.scene,
        recordings,
        selections,
        problem.time_offset,
        2 * max(dts),
        steps=problem.batch.steps,
    )
    other = problem.at(best.x, coarse)
    if not other.ok:
        return np.full_like(best.x, np.nan)
    return known.shift(best, other.residuals - best.residuals)


def _estimates(problem: Problem, best: Point, known, shift) -> dict[str, Estimate]:
    out = {}
    for i, name in enumerate(problem.names):
        parameter = PARAMETERS[name]
        initial = parameter.find(problem.scene)

        def at(theta, parameter=parameter, initial=initial):
            return _plain(parameter.value(initial, theta)) if np.isfinite(theta) else None

        value = parameter.value(initial, best.x[i])
        moved = parameter.value(initial, best.x[i] + shift[i])
        out[name] = Estimate(
            value=_plain(value),
            ci95=(at(known.low[i]), at(known.high[i])),
            initial=_plain(initial),
            unit=parameter.unit,
            identifiable=bool(known.identifiable[i]),
            step_shift=_relative(moved, value),
        )
    return out


def _relative(moved, value) -> float | None:
    """(moved - value) / value, the same for all parts of a vector; None if it is not a number."""
    largest = np.argmax(np.abs(np.ravel(value)))
    change = float(np.ravel(moved)[largest] / np.ravel(value)[largest] - 1)
    return change if np.isfinite(change) else None


def _plain(value):
    value = np.asarray(value)
    return float(value) if value.ndim == 0 else value


def _recording_fit(best: Point, known, k, label, recording, selection) -> RecordingFit:
    problem, evaluation = best.problem, best.evaluation
    clock: Clock = problem.clocks[k]
    kept = (recording.times >= selection.start) & (recording.times <= selection.end)
    times, measured = recording.times[kept], recording.tip_positions[kept]
    residuals = np.where(np.isfinite(measured), evaluation.residuals[k, : len(times)], np.nan)
    squares = np.nansum(residuals**2, axis=1)
    any_axis = np.any(np.isfinite(measured), axis=1)
    delay = problem.delays(best.x)[k]
    motion = jax.tree.map(lambda x: x[k], evaluation.motion)
    curve_times = np.linspace(times[0], times[-1], 4 * len(times))
    alignment = jax.tree.map(lambda x: x[k], evaluation.alignment)
    simulate_at = jnp.asarray(curve_times - clock.origin - delay)
    curve = tip_at(motion, clock.dt, simulate_at)
    curve = np.asarray(curve + alignment.of(curve - motion.positions[0]))
    at = clock.origin - clock.zero + delay
    ci95 = None
    if problem.time_offset:
        error = known.standard_errors[len(problem.names) + k] * clock.interval
        ci95 = (at - 1.959964 * error, at + 1.959964 * error)
    with np.errstate(invalid="ignore"):
        axes = np.sqrt(np.nansum(residuals**2, axis=0) / np.sum(np.isfinite(residuals), axis=0))
    return RecordingFit(
        name=label,
        recording=recording,
        selection=selection,
        times=times,
        measured=measured,
        simulated=measured + residuals,
        curve_times=curve_times,
        curve=curve,
        rmse=float(np.sqrt(np.sum(squares) / np.sum(any_axis))),
        rmse_axes=axes,
        time_offset=at,
        time_offset_ci95=ci95,
        tip_offset=None if recording.origin_known else np.asarray(alignment.offset),
        frame_rotation=None if recording.origin_known else np.asarray(alignment.rotation),
    )


def _labels(recordings) -> list[str]:
    """The recordings' names, told apart by numbers where they are the same."""
    labels: list[str] = []
    for recording in recordings:
        label, number = recording.name, 2
        while label in labels:
            label, number = f"{recording.name}-{number}", number + 1
        labels.append(label)
    return labels
