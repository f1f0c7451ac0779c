"""`calibrate_postures`: from a scene and postures to fitted numbers with intervals."""

import logging
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

import softrod_jax as sr
from calibration.data.carried import carried_in
from calibration.data.quantities import quantities_of
from calibration.experiment.setup import Setup
from calibration.inference.posterior import Posterior, check_posterior
from calibration.inference.uncertainty import IDENTIFIED, NOT_IDENTIFIABLE
from calibration.parameters.catalogue import as_names, choose, parameters_of, prepared
from calibration.parameters.priors import (
    CONTRADICTED,
    checked_pairs,
    contradictions,
)
from calibration.postures.data import Postures
from calibration.postures.prediction import Evaluation, Model, coarse
from calibration.postures.search import (
    LEAST_SCALE,
    Search,
    covariance_of,
    effective_of,
    noise_scale_of,
    numbers_of,
)
from calibration.report.results import Compared, Estimate, compared

_LOG = logging.getLogger(__name__)

_MOST_EVALUATIONS = 60
# Where there are priors, the noise is estimated and the fit repeated until the weight is settled.
_ROUNDS, _UNCHANGED = 4, 0.05
# Clusters a parameter needs for their scatter to say how uncertain it is.
_CLUSTERS = 3


@dataclass(frozen=True, eq=False)
class PostureFit:
    """What fitting postures hands back.

    - `scene`, `setup`: with what was identified; what was not is as it was.
    - `parameters`: an `Estimate` of each, by name.
    - `rmse_m` [m]: root mean square distance of all markers; `rmse_by_marker`, by name.
    - `simulated`, `measured` [m]: (rows, markers, 3) in the order of `markers`; NaN where missing.
    - `others`: what else was measured: `Compared` by key (`calibration.data.quantities`).
    - `unsolved`: how many rows have no equilibrium.
    - `noise_scale`: how many times larger residuals are than the noise that was stated.
    - `numbers`: how many were measured; `effective`: how many independent ones they are worth, as
      markers of a row, and rows of a trial, are wrong together.
    - `conflicts`: priors that the data contradict, by name: how many standard deviations apart.
    - `held_out_m` [m]: rms of trials that were kept aside in turn; `None` if nobody asked.
    - `posterior`: draws of it; `None` if nobody asked.
    - `information`, (parameters, parameters): of theta, with priors; `correlation`.
    """

    scene: sr.Scene
    setup: Setup
    parameters: dict[str, Estimate]
    rmse_m: float
    rmse_by_marker: dict[str, float]
    markers: tuple[str, ...]
    simulated: Float[np.ndarray, "rows markers 3"]
    measured: Float[np.ndarray, "rows markers 3"]
    others: dict[str, Compared]
    unsolved: int
    noise_scale: float
    numbers: int
    effective: float
    conflicts: dict[str, float]
    held_out_m: float | None
    information: Float[np.ndarray, "parameters parameters"]
    correlation: Float[np.ndarray, "parameters parameters"]
    evaluations: int
    converged: bool
    seconds: float
    postures: Postures
    posterior: Posterior | None = None


def calibrate_postures(
    scene: sr.Scene,
    postures: Postures,
    *,
    fit: Sequence[str] | str,
    priors: Mapping[str, tuple[float, float]] | None = None,
    bounds: Mapping[str, tuple[float, float]] | None = None,
    folds: int | None = None,
    method: sr.Collocation = sr.Collocation(),  # noqa: B008
    max_evaluations: int = _MOST_EVALUATIONS,
    posterior: str | None = None,
    draws: int = 1000,
    seed: int = 0,
) -> PostureFit:
    """Fit numbers of `scene`, and of the bench around it, so that markers are where they were.

    Each row is an equilibrium; where tendons rub or actuators have play, each is reached from the
    row before it in its trial, and the first of a trial from the unloaded rod.

    - `fit`: names out of `calibration.parameters.catalogue.catalogue`, or paths of numbers in the
      scene (`calibration.parameters.paths`). The search starts from their values in the scene.
    - `priors`: (mean, standard deviation) by name, in the parameter's unit: a weighed mass, a data
      sheet's modulus. `bounds`: (low, high).
    - `folds`: keep trials (rows, where there are none) aside in so many parts, one after the other,
      and predict them.
    - `method`: the grid along the rod.
    - `posterior`: "laplace" or "nuts" for `draws` draws of the posterior, with `seed`
      (`calibration.postures.posterior`); by default none are made.

    Raises `ValueError` for bad arguments, `ImportError` for NUTS without blackjax,
    `CalibrationError` if no row can be solved at the
    scene's values.
    """
    begun = time.perf_counter()
    check_posterior(posterior, draws)
    if folds is not None and not postures.positions:
        raise ValueError("folds: the places of markers are predicted, and there are none")
    model = prepared_model(jax.tree.map(jnp.asarray, scene), postures, fit, method)
    names = [parameter.name for parameter in model.parameters]
    priors = checked_pairs("priors", priors, names)
    search = Search(model, priors, checked_pairs("bounds", bounds, names))
    theta, best, count, converged = search.run(np.zeros(len(names)), max_evaluations)
    _LOG.info("%d evaluations, %s", count, "converged" if converged else "not converged")
    for _ in range(_ROUNDS if priors else 0):
        # A prior weighs as one measurement; how much those of the markers do the residuals tell.
        weight = 1.0 / max(noise_scale_of(best), LEAST_SCALE) ** 2
        if abs(weight / search.weight - 1) < _UNCHANGED:
            break
        search = replace(search, weight=weight)
        theta, best, more, converged = search.run(theta, max_evaluations)
        count += more
        _LOG.info("residuals weighed by %.3g beside the priors: %d evaluations", weight, more)
    held_out = None
    if folds is not None:
        held_out = _cross_validated(model, search, theta, folds)
    drawn = None
    if posterior is not None:
        drawn = search.posterior(theta, best, posterior, draws, seed)
    fitted = _assembled(model, search, theta, best, count, converged, held_out, begun)
    return replace(fitted, posterior=drawn, seconds=time.perf_counter() - begun)


def prepared_model(scene: sr.Scene, postures: Postures, fit, method: sr.Collocation) -> Model:
    """The model of what is to be fitted; `method` along the rod. Raises as `calibrate_postures`."""
    setup, names = _prepared(scene, fit)
    return Model(setup, postures, parameters_of(setup.scene, names), coarse(method.fitted(scene)))


def prior_information(model: Model, priors) -> Float[np.ndarray, "parameters parameters"]:
    """What priors say, at theta = 0."""
    names = [parameter.name for parameter in model.parameters]
    _, J = Search(model, checked_pairs("priors", priors, names), {}).prior_rows(
        np.zeros(len(names))
    )
    return J.T @ J


def _prepared(scene: sr.Scene, fit) -> tuple[Setup, tuple[str, ...]]:
    """The setup with a place for everything, and the names, groups replaced by their members."""
    asked = as_names(fit)
    if not asked:
        raise ValueError("fit: no parameters; name at least one")
    if carried_in(scene):
        raise ValueError(
            f"{carried_in(scene)[0]} is carried (moves = true), and postures do not say where; "
            "leave moves out of the scene where it stands still"
        )
    names = choose(scene, asked)
    return prepared(scene, names), names


def _cross_validated(model: Model, search: Search, theta, folds: int) -> float:
    """The rms distance [m] of rows that a fit has not seen."""
    labels = model.postures.labels
    if len(set(labels.tolist())) < folds:
        labels = np.arange(model.postures.rows).astype(str)
    names = np.array(list(dict.fromkeys(labels.tolist())))
    np.random.default_rng(0).shuffle(names)
    squares, points = 0.0, 0
    for part in np.array_split(names, folds):
        aside = np.isin(labels, part)
        seen = replace(model, postures=model.postures.take(~aside))
        own, *_ = replace(search, model=seen).run(theta.copy(), _MOST_EVALUATIONS)
        unseen = replace(model, postures=model.postures.take(aside))
        apart, has = _distances(unseen, unseen.evaluate(own))
        squares, points = squares + float(np.sum(apart[has] ** 2)), points + int(np.sum(has))
    return float(np.sqrt(squares / points))


def _distances(model: Model, evaluation: Evaluation):
    """Distances [m], (rows, markers), and where they were measured in full and solved."""
    target = model.targets
    has = np.all(np.asarray(target.has_position), -1) & evaluation.solved[:, None]
    apart = np.asarray(evaluation.seen.positions) - np.asarray(target.positions)
    return np.linalg.norm(apart, axis=-1), has


def _assembled(model, search, theta, best, count, converged, held_out, begun) -> PostureFit:
    p = len(theta)
    r, J = best.residuals, best.jacobian
    prior_r, prior_J = search.prior_rows(theta)
    freedom = max(numbers_of(best) + len(prior_r) - p, 1)
    scale = noise_scale_of(best)
    # What is stated of noise is relative: how large it is the residuals tell. Priors are absolute.
    weight = 1.0 / max(scale, LEAST_SCALE) ** 2
    flat = J.reshape(-1, p)
    information = weight * flat.T @ flat + prior_J.T @ prior_J
    covariance = covariance_of(search, theta, best)
    errors = np.sqrt(np.diag(covariance))
    errors = np.maximum(errors, _by_clusters(model, r, J, weight, covariance))
    quantile = _student(freedom)
    estimates, identified = {}, theta.copy()
    for i, parameter in enumerate(model.parameters):
        initial = np.asarray(parameter.get(model.setup))
        value = lambda t, s=parameter.scale, x=initial: _plain(s.value(x, t))
        low, high = theta[i] - quantile * errors[i], theta[i] + quantile * errors[i]
        known = high - low < parameter.scale.identified
        if not known:
            identified[i] = np.clip(0.0, low, high)
        estimates[parameter.name] = Estimate(
            name=parameter.name,
            recording=None,
            value=value(theta[i]),
            ci95=(value(low), value(high)),
            initial=_plain(initial),
            unit=parameter.unit,
            verdict=IDENTIFIED if known else NOT_IDENTIFIABLE,
            standard_error=float(errors[i]),
            step_shift=None,
            grid_shift=None,
        )
    apart, has = _distances(model, best)
    of = lambda a, h: float(np.sqrt(np.mean(a[h] ** 2))) if np.any(h) else float("nan")
    setup = model.at(identified)
    target = model.targets
    blank = lambda x, there: np.where(there, np.asarray(x), np.nan)
    return PostureFit(
        scene=setup.scene,
        setup=setup,
        parameters=estimates,
        rmse_m=of(apart, has),
        rmse_by_marker={n: of(apart[:, j], has[:, j]) for j, n in enumerate(model.markers)},
        markers=model.markers,
        simulated=blank(best.seen.positions, best.solved[:, None, None]),
        measured=blank(target.positions, np.asarray(target.has_position)),
        others=_compared(model, best),
        unsolved=int(np.sum(~best.solved)),
        noise_scale=scale,
        numbers=numbers_of(best),
        effective=effective_of(model, best),
        conflicts=_conflicts(search, theta, weight * flat.T @ flat),
        held_out_m=held_out,
        information=information,
        correlation=covariance / np.outer(*[np.sqrt(np.diag(covariance))] * 2),
        evaluations=count,
        converged=converged,
        seconds=time.perf_counter() - begun,
        postures=model.postures,
    )


def _compared(model: Model, best: Evaluation) -> dict[str, Compared]:
    """What was measured besides markers, by key."""
    out, at, known = {}, 0, quantities_of(model.setup.scene)
    for key in model.others:
        own = slice(at, at + len(known[key].columns))
        at = own.stop
        there = np.asarray(model.targets.has_others)[:, own]
        seen = np.where(best.solved[:, None], np.asarray(best.seen.others)[:, own], np.nan)
        measured = np.where(there, np.asarray(model.targets.others)[:, own], np.nan)
        noise = float(model.noise.others[own.start])
        out[key] = compared(seen, measured, noise, known[key].unit)
    return out


def _by_clusters(model: Model, r, J, weight: float, covariance):
    """Standard errors from the scatter of whole trials, whose residuals belong together; 0 where
    there are too few."""
    labels, p = model.postures.labels, J.shape[-1]
    names = list(dict.fromkeys(labels.tolist()))
    if len(names) < _CLUSTERS * p:
        return np.zeros(p)
    scores = np.einsum("knp,kn->kp", J, r) * weight
    sums = np.stack([scores[labels == name].sum(0) for name in names])
    meat = sums.T @ sums * len(names) / (len(names) - p)
    return np.sqrt(np.diag(covariance @ meat @ covariance))


def _conflicts(search: Search, theta, information) -> dict[str, float]:
    """Priors from which the data alone would be over three standard deviations away."""
    apart = contradictions(*search.prior_rows(theta), information)
    pairs = zip(search.priors, apart, strict=True)
    return {name: float(x) for name, x in pairs if x > CONTRADICTED}


def _student(freedom: float) -> float:
    """The 97.5 % quantile of Student's t (Cornish and Fisher 1938)."""
    z = 1.959963984540054
    return z + (z**3 + z) / (4 * max(freedom, 2.0))


def _plain(value) -> Any:
    value = np.asarray(value)
    return float(value) if value.ndim == 0 else value
