"""`compare`: the same recordings fitted by several models, and which of them the data ask for."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import jax
import numpy as np

from calibration.data.quantities import NOISE, TURN
from calibration.data.recording import Recording
from calibration.fit import calibrate
from calibration.inference.criteria import Candidate, Verdict, judged
from calibration.parameters.catalogue import choose, prepared
from calibration.parameters.laws import Model, without_nothing
from calibration.report.results import Fit
from calibration.search.minimum import CalibrationError

# Options of `calibrate` that are about single parameters: a model takes what is about its own.
_NAMED = ("per_recording", "bounds", "priors", "profiles")
# Residuals below this part of the rod's length are rounding.
_ROUNDING = 1e-9


@dataclass(frozen=True, eq=False)
class Comparison:
    """`fits` by the name of the model, of those that could be fitted; `verdict` on all of them;
    `best`: the fit of the one that the data ask for."""

    fits: dict[str, Fit]
    verdict: Verdict

    @property
    def best(self) -> Fit:
        fit = self.fits[self.verdict.chosen]
        setup = replace(fit.setup, scene=without_nothing(fit.setup.scene))
        return replace(fit, scene=without_nothing(fit.scene), setup=setup)


def compare(
    models: Mapping[str, Model],
    recordings: Sequence[Recording],
    *,
    told: Callable[[str], None] = lambda words: None,
    **options: Any,
) -> Comparison:
    """Fit each of `models`, by name, to the recordings, and tell which the data ask for
    (`calibration.inference.criteria`).

    - `told`: is called with what is about to be fitted, in words.
    - `options`: of `calibration.calibrate`, such as `held_out`, the same for all models. Of those
      by name each model takes what it fits.

    Models that fit different numbers of one scene share a compiled program. Ctrl-C ends the
    comparison with what there is, if that is two models or more.

    Raises `ValueError` for fewer than two models, for names that none of them fits and for a
    robust loss, whose weights differ between models; else as `calibration.calibrate`, but that a
    model which cannot be simulated is left out.
    """
    if len(models) < 2:
        raise ValueError("compare: at least two models are needed")
    if options.get("loss", "squares") != "squares":
        raise ValueError(
            f"compare: loss={options['loss']!r}: weights would differ from model to model; "
            "compare by squares, without the outliers"
        )
    if options.get("postures") is not None:
        raise ValueError("compare: postures beside motions are not counted; compare each alone")
    by_model = _own_options(models, options)
    shared = {} if options.get("explain") else _programs(models)
    fits, troubles = {}, {}
    for k, (name, model) in enumerate(models.items(), 1):
        told(f"{name}, model {k} of {len(models)}")
        try:
            fits[name] = calibrate(
                model.scene,
                recordings,
                fit=model.names,
                program=shared.get(name),
                **by_model[name],
            )
        except CalibrationError as e:
            troubles[name] = str(e)
            continue
        if fits[name].result == "interrupted":
            break
    if not fits:
        raise CalibrationError(f"compare: no model can be fitted: {'; '.join(troubles.values())}")
    candidates = [_candidate(name, fit, options) for name, fit in fits.items()]
    candidates += [_untold(name, why, candidates[0]) for name, why in troubles.items()]
    if len(candidates) < 2:
        raise KeyboardInterrupt
    return Comparison(fits, judged(candidates))


def _own_options(models: Mapping[str, Model], options: Mapping) -> dict[str, dict]:
    """The options for each model. Raises `ValueError` for a name that none of them fits."""
    used: dict[str, set] = {key: set() for key in _NAMED}
    out = {}
    for label, model in models.items():
        fitted, own = set(model.names), dict(options)
        for key in _NAMED:
            given = options.get(key)
            if not given:
                continue
            of_it = [n for n in given if fitted & set(_members(model, n.partition("@")[0]))]
            used[key] |= set(of_it)
            own[key] = {n: given[n] for n in of_it} if isinstance(given, Mapping) else of_it
        out[label] = own
    for key in _NAMED:
        for name in options.get(key) or ():
            if name not in used[key]:
                raise ValueError(
                    f"{key}: {name!r} is fitted by none of the models; add it to one, or leave it "
                    "out"
                )
    return out


def _members(model: Model, name: str) -> tuple[str, ...]:
    """What a name stands for in the scene of a model; itself where that has no such thing."""
    try:
        return choose(model.scene, (name,))
    except ValueError:
        return (name,)


def _programs(models: Mapping[str, Model]) -> dict[str, tuple[str, ...]]:
    """By model the names that all models with scenes of one form fit, if what one of them does not
    fit can be there without doing anything."""
    form = lambda model, names: jax.tree.structure(prepared(model.scene, names))
    found = {}
    for label, model in models.items():
        own = jax.tree.structure(model.scene)
        alike = [m for m in models.values() if jax.tree.structure(m.scene) == own]
        names = tuple(dict.fromkeys(name for m in alike for name in m.names))
        if all(form(m, m.names) == form(model, names) for m in alike):
            found[label] = names
    return found


def _candidate(name: str, fit: Fit, options: Mapping) -> Candidate:
    parts = [np.nansum((r.simulated - r.measured) ** 2) for r in fit.recordings]
    for r in fit.recordings:
        tip = r.recording.noise.get("tip", NOISE)
        for key, x in r.others.items():
            noise = x.noise / 2 if key.endswith(TURN) else x.noise
            parts.append(np.nansum(((x.simulated - x.measured) * tip / noise) ** 2))
    floor = (_ROUNDING * float(fit.scene.length)) ** 2
    frames = sum(r.tip_offset is not None for r in fit.recordings)
    clocks = len(fit.recordings) * bool(options.get("time_offset", True))
    return Candidate(
        name=name,
        numbers=len(fit.parameters) + 6 * frames + clocks,
        measurements=fit.samples,
        effective=fit.effective_samples,
        mean_square=max(float(sum(parts)) / fit.samples, floor),
        rms_m=fit.rmse_m,
        held_out_m={r.name: r.rmse for r in fit.held_out},
        vague=tuple(k for k, e in fit.parameters.items() if not e.identifiable),
        trouble="" if fit.result == "converged" else fit.result,
    )


def _untold(name: str, why: str, like: Candidate) -> Candidate:
    """One that could not be fitted."""
    return Candidate(name, 0, like.measurements, like.effective, np.inf, {}, trouble=why)
