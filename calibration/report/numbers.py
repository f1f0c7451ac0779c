"""A fit as plain numbers, lists and strings: what `parameters.json` has."""

from collections.abc import Mapping

import numpy as np

from calibration.inference.criteria import Verdict
from calibration.inference.posterior import Posterior
from calibration.report.comparison import comparison_json
from calibration.report.granted import taken_for_granted
from calibration.report.provenance import provenance
from calibration.report.remarks import remarks
from calibration.report.results import Compared, Estimate, Fit, PosturesFit
from calibration.report.text import sampled


def as_json(fit: Fit, compared: Verdict | None = None) -> dict:
    """The fit as plain numbers, lists and strings.

    "parameters", by name: value, ci95 = [low, high] (null on a side without a bound), initial,
    unit, identifiable, verdict, recording (null: all), step_shift and grid_shift (change with half
    the time step and twice the grid, in half widths of the interval). "rmse_m" and "time_offset_s",
    by recording; "held_out_rmse_m", in the frame of the fit, and "held_out_rmse_own_frame_m", in
    one fitted to the recording, where it does not know its own (else null); "drift", by recording
    and channel (`calibration.experiment.drift`), at the edges of the windows; "comparison", of
    models (`calibration.report.comparison.comparison_json`), or null; "others", by recording, what
    is left of what else was measured; and how the fit was made.
    """
    return {
        "result": fit.result,
        "parameters": {name: estimate_as_json(e) for name, e in fit.parameters.items()},
        "rmse_m": fit.rmse_m,
        "held_out_rmse_m": {r.name: r.rmse for r in fit.held_out},
        "held_out_rmse_own_frame_m": {r.name: r.rmse_own_frame for r in fit.held_out},
        "rmse_axes_m": {r.name: plain(r.rmse_axes) for r in fit.recordings},
        "postures": None if fit.postures is None else _postures_json(fit.postures),
        "others": {r.name: others_json(r.others) for r in (*fit.recordings, *fit.held_out)},
        "samples": {r.name: sampled(r) for r in fit.recordings},
        "window_s": {r.name: [r.selection.start, r.selection.end] for r in fit.recordings},
        "time_offset_s": fit.time_offset_s,
        "time_offset_ci95_s": {r.name: plain(r.time_offset_ci95) for r in fit.recordings},
        "drift": {
            r.name: {
                name: {"edges_s": plain(d.edges), "values": plain(d.values)}
                for name, d in r.drift.items()
            }
            for r in fit.recordings
            if r.drift
        },
        "tip_offset_m": {r.name: plain(r.tip_offset) for r in fit.recordings},
        "frame_rotation_rad": {r.name: plain(r.frame_rotation) for r in fit.recordings},
        "conditions": {r.name: dict(r.recording.conditions) for r in fit.recordings},
        "priors": {name: list(pair) for name, pair in fit.priors.items()},
        "priors_contradicted": dict(fit.conflicts),
        "correlation": plain(fit.correlation),
        "samples_of_coordinates": fit.samples,
        "effective_samples": fit.effective_samples,
        "profiles": {
            label: {"values": plain(p.values), "excess": plain(p.excess)}
            for label, p in fit.profiles.items()
        },
        "starts": [
            {"initial": s.initial, "values": s.values, "rms_m": plain(s.rms), "result": s.result}
            for s in fit.starts
        ],
        "explanations": [
            {"name": e.name, "rms_m": e.rms, "values": e.values, "reading": e.reading}
            for e in fit.explanations or ()
        ],
        "posterior": posterior_json(fit.posterior),
        "comparison": None if compared is None else comparison_json(compared),
        "material": fit.material,
        "loss": fit.loss,
        "optimiser": fit.optimiser,
        "iterations": fit.iterations,
        "evaluations": fit.evaluations,
        "beginning": {r.name: r.beginning for r in (*fit.recordings, *fit.held_out)},
        "taken_for_granted": taken_for_granted(fit),
        "dt_s": fit.dt,
        "intervals": fit.method.intervals,
        "seconds": fit.seconds,
        "remarks": remarks(fit),
        "made_by": provenance(_sources(fit)),
    }


def estimate_as_json(e: Estimate) -> dict:
    """One parameter, as `as_json` has it."""
    return {
        "value": plain(e.value),
        "ci95": [plain(end) for end in e.ci95],
        "initial": plain(e.initial),
        "unit": e.unit,
        "identifiable": e.identifiable,
        "verdict": e.verdict,
        "recording": e.recording,
        "step_shift": plain(e.step_shift),
        "grid_shift": plain(e.grid_shift),
    }


def posterior_json(drawn: Posterior | None) -> dict | None:
    """The draws' intervals and how good they are."""
    if drawn is None:
        return None
    return {
        "method": drawn.method,
        "ci95": {name: [plain(end) for end in ends] for name, ends in drawn.ci95.items()},
        "median": {name: plain(np.median(x, axis=0)) for name, x in drawn.values.items()},
        "draws": len(drawn.theta),
        "effective_draws": drawn.effective,
        "gelman_rubin": drawn.mixed,
        "divergent": drawn.divergent,
    }


def _sources(fit: Fit) -> list[str]:
    own = [r.recording.source for r in (*fit.recordings, *fit.held_out)]
    return own if fit.postures is None else [*own, *fit.postures.source.split("\n")]


def _postures_json(postures: PosturesFit) -> dict:
    return {
        "rows": postures.rows,
        "unsolved": postures.unsolved,
        "rmse_m": plain(postures.rmse_m),
        "rmse_by_marker_m": {name: plain(x) for name, x in postures.rmse_by_marker.items()},
        "noise_scale": plain(postures.noise_scale),
    }


def others_json(others: Mapping[str, Compared]) -> dict:
    """What is left of what else was measured, by key."""
    return {
        key: {"rms": plain(x.rms), "unit": x.unit, "rms_by_noise": plain(x.rms / x.noise)}
        for key, x in others.items()
    }


def plain(value):
    """Lists and floats; None for what is absent or not a number."""
    if value is None:
        return None
    array = np.asarray(value, dtype=float)
    if array.ndim == 0:
        return float(array) if np.isfinite(array) else None
    return [plain(x) for x in array]
