"""From the best point of a search to what is handed back: estimates, and each recording's fit."""

from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np

from calibration.data.recording import Recording
from calibration.data.selection import Selection, kept
from calibration.experiment.beginning import beginning
from calibration.experiment.drift import drifts
from calibration.experiment.setup import Setup
from calibration.inference.checks import row
from calibration.inference.resolution import Refined
from calibration.inference.uncertainty import IDENTIFIED, Uncertainty
from calibration.problem.motion import Motion, tip_at
from calibration.problem.problem import Point, Problem
from calibration.report.results import Estimate, RecordingFit


def estimates(
    problem: Problem, best: Point, known: Uncertainty, finer: Refined, labels: Sequence[str]
) -> dict[str, Estimate]:
    """An `Estimate` of every unknown, by its label; `labels`: the recordings' names."""
    out = {}
    for i, u in enumerate(problem.unknowns.items):

        def at(theta, u=u):
            return _plain(u.value(theta)) if np.isfinite(theta) else None

        def relative(shift, i=i, u=u):
            if shift is None:
                return None
            # The ends of an interval that is open are no measure.
            width = known.quantile * known.standard_errors[i]
            return float(shift[i] / min(width, max(u.parameter.scale.vague, 1.0)))

        out[u.label] = Estimate(
            name=u.parameter.name,
            recording=None if u.recording is None else labels[u.recording],
            value=_plain(u.value(best.x[i])),
            ci95=(at(known.low[i]), at(known.high[i])),
            initial=_plain(u.initial),
            unit=u.parameter.unit,
            verdict=known.verdicts[i],
            standard_error=float(known.standard_errors[i]),
            step_shift=relative(finer.by_step),
            grid_shift=relative(finer.by_grid),
        )
    return out


def setup_with(problem: Problem, best: Point, known: Uncertainty) -> Setup:
    """The setup with what all recordings share and was identified. What was not is as it was, or
    at the end of its interval that is nearest to that: the data say no more."""
    x = best.x.copy()
    for i, verdict in enumerate(known.verdicts):
        if verdict != IDENTIFIED:
            x[i] = np.clip(0.0, known.low[i], known.high[i])
    return problem.fitted_setup(x)


def _plain(value):
    value = np.asarray(value)
    return float(value) if value.ndim == 0 else value


def recording_fit(
    best: Point,
    k: int,
    label: str,
    recording: Recording,
    selection: Selection,
    known: Uncertainty | None = None,
    finer: Motion | None = None,
) -> RecordingFit:
    """Recording `k` of the best point. `known`: for the interval of its clock; `finer`: motions
    with half the time step, for the rod's shapes."""
    problem, evaluation = best.problem, best.evaluation
    clock = problem.clocks[k]
    chosen = kept(recording, selection)
    times, measured = recording.times[chosen], recording.tip_positions[chosen]
    residuals = np.where(np.isfinite(measured), evaluation.residuals[k, : len(times)], np.nan)
    course = {name: x[k] for name, x in problem.courses(best.x).items()}
    delay, drift = course["delay"], drifts(course, clock)
    motion, alignment = row(evaluation.motion, k), row(evaluation.alignment, k)
    curve_times = np.linspace(times[0], times[-1], 4 * len(times))
    gained = drift["clock"].at(curve_times)[:, 0] if "clock" in drift else 0.0
    moved = drift["tip"].at(curve_times) if "tip" in drift else 0.0
    simulate_at = jnp.asarray(curve_times - clock.origin - delay - gained)
    curve = tip_at(motion, clock.dt, simulate_at)
    curve = np.asarray(curve + alignment.of(curve - motion.positions[0])) + moved
    at = clock.origin - clock.zero + delay
    ci95 = None
    if problem.time_offset and known is not None:
        error = known.standard_errors[problem.size + k] * clock.interval
        ci95 = (at - known.quantile * error, at + known.quantile * error)
    count = np.maximum(np.sum(np.isfinite(residuals), axis=0), 1)
    axes = np.sqrt(np.nansum(residuals**2, axis=0) / count)
    shown, step = (motion, clock.dt) if finer is None else (row(finer, k), clock.dt / 2)
    duration = selection.end - clock.origin - delay
    rows = np.arange(min(len(shown.shapes), int(duration / step) + 2))
    return RecordingFit(
        name=label,
        recording=recording,
        selection=selection,
        times=times,
        measured=measured,
        simulated=measured + residuals,
        weights=problem.weights[k, : len(times)],
        curve_times=curve_times,
        curve=curve,
        rmse=float(np.sqrt(np.nansum(residuals**2) / len(times))),
        rmse_axes=np.where(np.any(np.isfinite(measured), axis=0), axes, np.nan),
        time_offset=at,
        time_offset_ci95=ci95,
        drift=drift,
        tip_offset=None if recording.origin_known else np.asarray(alignment.offset),
        frame_rotation=None if recording.origin_known else np.asarray(alignment.rotation),
        beginning=beginning(recording, bool(problem.batch.hanging[k])),
        shape_times=step * rows,
        shapes=np.asarray(shown.shapes)[rows],
    )
