"""From what a search found to the `Fit` that is handed back."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from calibration.experiment.setup import Setup
from calibration.inference.beliefs import contradicted
from calibration.inference.explain import Explanation
from calibration.inference.motion_posterior import bands
from calibration.inference.posterior import Posterior
from calibration.inference.profile import Profile
from calibration.inference.refinement import Resolved
from calibration.inference.uncertainty import IDENTIFIED, Uncertainty
from calibration.problem.dataset import Dataset
from calibration.problem.problem import Point
from calibration.report.recordings import recording_fit
from calibration.report.results import Estimate, Fit, PosturesFit, RecordingFit
from calibration.search.history import History
from calibration.search.multistart import Start
from calibration.search.settings import SearchSettings


def assemble_fit(
    resolved: Resolved,
    data: Dataset,
    settings: SearchSettings,
    history: History,
    *,
    starts: tuple[Start, ...],
    profiles: Mapping[str, Profile],
    explanations: tuple[Explanation, ...] | None,
    held_out: tuple[RecordingFit, ...],
    material: str | None,
    postures: PosturesFit | None,
    posterior: Posterior | None,
    seconds: float,
) -> Fit:
    """The fit of `data` that ended where `resolved` says, with all that was found out about it."""
    best, uncertainty, refinement = resolved.best, resolved.uncertainty, resolved.refinement
    setup = _fitted_setup(best, uncertainty)
    n = best.problem.space.parameter_count
    recordings = tuple(
        recording_fit(best, k, data, uncertainty, refinement.motions) for k in range(len(data))
    )
    if posterior is not None:
        recordings = tuple(
            replace(r, band=tuple(end[: len(r.times)] for end in ends))
            for r, ends in zip(recordings, bands(best, posterior), strict=True)
        )
    return Fit(
        scene=setup.scene,
        setup=setup,
        parameters=_estimates(resolved, data.labels),
        recordings=recordings,
        held_out=held_out,
        result=resolved.outcome.result,
        optimiser=settings.optimiser,
        loss=settings.loss,
        iterations=resolved.outcome.iterations,
        evaluations=len(history.entries),
        history=history.entries,
        correlation=uncertainty.correlation[:n, :n],
        samples=uncertainty.samples,
        effective_samples=uncertainty.effective_samples,
        profiles=profiles,
        starts=starts,
        explanations=explanations,
        material=material,
        dt={label: c.dt for label, c in zip(data.labels, best.problem.space.clocks, strict=True)},
        method=best.problem.method,
        resolution_note=refinement.note,
        priors=best.problem.priors,
        conflicts=contradicted(best),
        checkpoint=history.checkpoint,
        postures=postures,
        posterior=posterior,
        seconds=seconds,
    )


def _estimates(resolved: Resolved, labels: Sequence[str]) -> dict[str, Estimate]:
    """An `Estimate` of every unknown parameter, by its label; `labels`: the recordings' names."""
    best, uncertainty, refinement = resolved.best, resolved.uncertainty, resolved.refinement
    out = {}
    for i, u in enumerate(best.problem.space.parameters.items):

        def at(theta, u=u):
            return _plain(u.value(theta)) if np.isfinite(theta) else None

        def relative(shift, i=i, u=u):
            if shift is None:
                return None
            # The ends of an interval that is open are no measure.
            width = uncertainty.quantile[i] * uncertainty.standard_errors[i]
            return float(shift[i] / min(width, max(u.parameter.scale.vague, 1.0)))

        out[u.label] = Estimate(
            name=u.parameter.name,
            recording=None if u.recording is None else labels[u.recording],
            value=_plain(u.value(best.x[i])),
            ci95=(at(uncertainty.low[i]), at(uncertainty.high[i])),
            initial=_plain(u.initial),
            unit=u.parameter.unit,
            verdict=uncertainty.verdicts[i],
            standard_error=float(uncertainty.standard_errors[i]),
            step_shift=relative(refinement.by_step),
            grid_shift=relative(refinement.by_grid),
        )
    return out


def _fitted_setup(best: Point, uncertainty: Uncertainty) -> Setup:
    """The setup with what all recordings share and was identified. What was not is as it was, or
    at the end of its interval that is nearest to that: the data say no more."""
    x = best.x.copy()
    for i, verdict in enumerate(uncertainty.verdicts):
        if verdict != IDENTIFIED:
            x[i] = np.clip(0.0, uncertainty.low[i], uncertainty.high[i])
    return best.problem.fitted_setup(x)


def _plain(value):
    value = np.asarray(value)
    return float(value) if value.ndim == 0 else value
