"""`compare_postures`: the same postures fitted by several models, and which the data ask for."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from calibration.inference.criteria import Candidate, Verdict, judged
from calibration.parameters.laws import Model
from calibration.postures.data import Postures
from calibration.postures.fitting import PostureFit, calibrate_postures


@dataclass(frozen=True, eq=False)
class PostureComparison:
    """`fits` by the name of the model, the `verdict` on them, and `best`, the fit of the one that
    the data ask for."""

    fits: dict[str, PostureFit]
    verdict: Verdict

    @property
    def best(self) -> PostureFit:
        return self.fits[self.verdict.chosen]


def compare_postures(
    models: Mapping[str, Model],
    postures: Postures,
    *,
    told: Callable[[str], None] = lambda words: None,
    **options: Any,
) -> PostureComparison:
    """Fit each of `models`, by name, to the postures, and tell which the data ask for
    (`calibration.inference.criteria`).

    - `told`: is called with what is about to be fitted, in words.
    - `options`: of `calibration.postures.fitting.calibrate_postures`, the same for all models, but
      that bounds and priors are those of what a model fits. With `folds`, all are asked to predict
      the same rows.

    Raises `ValueError` for fewer than two models and for bounds or priors of what none of them
    fits; else as `calibrate_postures`.
    """
    if len(models) < 2:
        raise ValueError("compare: at least two models are needed")
    fitted = {name for model in models.values() for name in model.names}
    for key in ("bounds", "priors"):
        for name in options.get(key) or ():
            if name not in fitted:
                raise ValueError(f"{key}: {name!r} is fitted by none of the models")
    fits = {}
    for k, (name, model) in enumerate(models.items(), 1):
        told(f"{name}, model {k} of {len(models)}")
        own = dict(options)
        for key in ("bounds", "priors"):
            own[key] = {n: x for n, x in (options.get(key) or {}).items() if n in model.names}
        fits[name] = calibrate_postures(model.scene, postures, fit=model.names, **own)
    return PostureComparison(fits, judged([_candidate(n, fit) for n, fit in fits.items()]))


def _candidate(name: str, fit: PostureFit) -> Candidate:
    n, p = fit.numbers, len(fit.parameters)
    aside = {} if fit.held_out_m is None else {"postures": fit.held_out_m}
    trouble = "" if fit.converged else "the search has not converged"
    if fit.unsolved:
        trouble = f"{fit.unsolved} rows have no equilibrium"
    return Candidate(
        name=name,
        numbers=p,
        measurements=n,
        effective=fit.effective,
        mean_square=fit.noise_scale**2 * max(n - p, 1) / n,
        rms_m={"postures": fit.rmse_m},
        held_out_m=aside,
        vague=tuple(k for k, e in fit.parameters.items() if not e.identifiable),
        trouble=trouble,
    )
