"""The fit of each recording, and the prediction of those that were kept aside, at their samples."""

from collections.abc import Mapping
from dataclasses import replace

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from calibration.data.carried import poses_at
from calibration.data.quantities import TURN, numbers_of, quantities_in_motion
from calibration.data.selection import kept
from calibration.experiment.beginning import beginning
from calibration.experiment.drift import Drift, drifts
from calibration.inference.held_out import predictions
from calibration.inference.uncertainty import Uncertainty
from calibration.problem.batch import recording_of
from calibration.problem.dataset import Dataset
from calibration.problem.motion import Motion, tip_at
from calibration.problem.problem import Point
from calibration.report.results import Compared, RecordingFit, RodMotion, compared


def held_out_fits(best: Point, unseen: Dataset, dt: float | None) -> tuple[RecordingFit, ...]:
    """The predictions of recordings that were kept aside, from the best point of a fit."""
    fits = []
    for found in predictions(best, unseen, dt):
        shown = found.own_frame if found.fitted_frame is None else found.fitted_frame
        for k in range(found.count):
            fit = recording_fit(shown, k, found.data)
            if not fit.recording.origin_known:
                own = recording_fit(found.own_frame, k, found.data).rmse
                fit = replace(fit, rmse_own_frame=own, frame_fitted=shown is found.own_frame)
            fits.append(fit)
    return tuple(fits)


def recording_fit(
    best: Point,
    k: int,
    data: Dataset,
    uncertainty: Uncertainty | None = None,
    finer: Motion | None = None,
) -> RecordingFit:
    """Recording `k` of `data` as it is at the best point.

    `uncertainty`: for the interval of its clock; `finer`: motions with half the time step, for the
    rod's shapes.
    """
    problem, evaluation = best.problem, best.evaluation
    recording, selection, clock = data.recordings[k], data.selections[k], problem.space.clocks[k]
    chosen = kept(recording, selection)
    times, measured = recording.times[chosen], recording.tip_positions[chosen]
    residuals = np.where(np.isfinite(measured), evaluation.residuals[k, : len(times), :3], np.nan)
    nuisance = recording_of(problem.space.nuisance(best.x), k)
    delay, drift = nuisance["delay"], drifts(nuisance, clock)
    alignment = recording_of(evaluation.alignment, k)
    curve_times = np.linspace(times[0], times[-1], 4 * len(times))
    count = np.maximum(np.sum(np.isfinite(residuals), axis=0), 1)
    axes = np.sqrt(np.nansum(residuals**2, axis=0) / count)
    motion, step = recording_of(evaluation.motion if finer is None else finer, k), clock.dt
    step = step if finer is None else step / 2
    duration = selection.end - clock.origin - delay
    rows = np.arange(min(len(motion.shapes), int(duration / step) + 2))
    seen_times = times - clock.origin - delay - _gained(drift, times)
    coarse = recording_of(evaluation.motion, k)
    seen_tip = np.asarray(tip_at(coarse, clock.dt, jnp.asarray(seen_times)))
    return RecordingFit(
        name=data.labels[k],
        recording=recording,
        selection=selection,
        times=times,
        measured=measured,
        simulated=measured + residuals,
        weights=problem.statistics.weights[k, : len(times), :3],
        others=_others(best, k, recording, len(times)),
        curve_times=curve_times,
        curve=_curve(best, k, curve_times, delay, drift),
        rmse=float(np.sqrt(np.nansum(residuals**2) / len(times))),
        rmse_axes=np.where(np.any(np.isfinite(measured), axis=0), axes, np.nan),
        time_offset=clock.origin - clock.zero + delay,
        time_offset_ci95=_offset_interval(best, k, delay, uncertainty),
        drift=drift,
        tip_offset=None if recording.origin_known else np.asarray(alignment.offset),
        frame_rotation=None if recording.origin_known else np.asarray(alignment.rotation),
        beginning=beginning(recording, bool(problem.batch.hanging[k])),
        motion=RodMotion(
            ts=step * rows,
            positions=np.asarray(motion.shapes)[rows],
            quaternions=np.asarray(motion.attitudes)[rows],
            strains=np.asarray(motion.strains)[rows],
            arc_lengths=np.asarray(motion.arc_lengths),
            seen_times=seen_times,
            # Where the simulated tip is, less what the recording's frame shows between the two.
            seen=seen_tip - residuals,
            inputs=_inputs(recording, clock.zero + step * rows),
            carried=_carried(problem.batch, recording, k, step * rows),
        ),
    )


def _carried(batch, recording, k: int, ts) -> dict[str, np.ndarray]:
    """Where the base and obstacles are at `ts` [s] of the simulation, by name, (times, 7)."""
    still = {name: np.tile(np.asarray(x)[k, 0], (len(ts), 1)) for name, x in batch.carried.items()}
    at = recording.times[0] + ts
    said = recording.carried.items()
    return still | {name: poses_at(at, recording.times, poses) for name, poses in said}


def _others(best: Point, k: int, recording, samples: int) -> dict[str, Compared]:
    """What else was measured in recording `k`, by key."""
    problem, found = best.problem, {}
    known = quantities_in_motion(problem.scene)
    for key, own in numbers_of(problem.batch.keys).items():
        if key not in recording.others:
            continue
        there = np.asarray(problem.batch.used)[k, :samples, 3:][:, own]
        measured = np.where(there, np.asarray(problem.batch.others)[k, :samples, own], np.nan)
        simulated = measured + best.evaluation.residuals[k, :samples, 3:][:, own]
        noise = recording.noise.get(key, known[key].noise)
        # Four numbers of a quaternion, which change by half an angle, for three angles.
        size = 4 / np.sqrt(3) if key.endswith(TURN) else 1.0
        found[key] = compared(simulated, measured, noise, known[key].unit, size)
    return found


def _inputs(recording, times) -> dict[str, np.ndarray]:
    """The inputs at `times` [s] of their clock, (times, actuators)."""
    return {
        kind.name: np.stack([np.interp(times, recording.times, c) for c in values.T], axis=1)
        for kind, values in recording.driven_by
    }


def _curve(
    best: Point,
    k: int,
    times: Float[np.ndarray, "times"],
    delay: float,
    drift: Mapping[str, Drift],
) -> Float[np.ndarray, "times 3"]:
    """The simulated tip [m] of recording `k` at `times` [s] of its clock, as its sensor sees it."""
    clock = best.problem.space.clocks[k]
    motion, alignment = (
        recording_of(part, k) for part in (best.evaluation.motion, best.evaluation.alignment)
    )
    moved = drift["tip"].at(times) if "tip" in drift else 0.0
    tip = tip_at(
        motion, clock.dt, jnp.asarray(times - clock.origin - delay - _gained(drift, times))
    )
    return np.asarray(tip + alignment.of(tip - motion.positions[0])) + moved


def _gained(drift: Mapping[str, Drift], times: np.ndarray) -> np.ndarray | float:
    """By how much the tip's clock is ahead [s] at `times`."""
    return drift["clock"].at(times)[:, 0] if "clock" in drift else 0.0


def _offset_interval(
    best: Point, k: int, delay: float, uncertainty: Uncertainty | None
) -> tuple[float, float] | None:
    """The 95 % interval [s] of the time offset of recording `k`; None if it was not fitted."""
    space = best.problem.space
    if not space.time_offset or uncertainty is None:
        return None
    clock = space.clocks[k]
    at = clock.origin - clock.zero + delay
    error = uncertainty.standard_errors[space.delays][k] * clock.interval
    half = uncertainty.quantile[space.delays][k] * error
    return at - half, at + half
