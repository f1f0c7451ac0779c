"""Which postures to record next: those that shrink the intervals of a fit most.

The information that a posture brings follows from the derivatives of its markers, without any
measurement (Fedorov, Theory of Optimal Experiments, 1972). Postures are chosen one by one, and then
exchanged for others as long as that helps.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int

import softrod_jax as sr
from calibration.parameters.catalogue import as_names, catalogue
from calibration.postures.data import Postures
from calibration.postures.fitting import prepared_model, prior_information
from calibration.postures.prediction import Model

_ROUNDS = 50
# An exchange that gains less than this is none.
_LEAST_GAIN = 1e-9
_NORMAL = 1.959963984540054  # 97.5 % quantile
CRITERIA = ("D", "A")


@dataclass(frozen=True, eq=False)
class Design:
    """Chosen rows of the candidates, in the order in which they were chosen.

    - `rows`, (chosen,): by index. `trials`: what was chosen, where rows of a trial belong together.
    - `half_widths`: of the 95 % intervals that are expected with them, by parameter, in theta
      (about relative for what is positive); `before`: with what was known; `all_rows`: with all
      candidates.
    - `intervals`: that are expected with them, around the scene's values, in the parameter's unit.
    - `unsolved`: candidates without an equilibrium, by index; none of them is chosen.
    """

    rows: Int[np.ndarray, "chosen"]
    trials: tuple[str, ...]
    half_widths: dict[str, float]
    before: dict[str, float]
    all_rows: dict[str, float]
    intervals: dict[str, tuple[float, float]]
    units: dict[str, str]
    unsolved: Int[np.ndarray, "unsolved"]


@dataclass(frozen=True, eq=False)
class Information:
    """What candidates tell of theta, in terms of their noise.

    - `each`, (units, parameters, parameters): of a row, or of a trial where rows of one depend on
      each other. `rows`: those of each unit, by index. `trials`: the names of the units, or empty.
    - `start`, (parameters, parameters): what is known without them.
    """

    each: Float[np.ndarray, "units parameters parameters"]
    rows: tuple[np.ndarray, ...]
    trials: tuple[str, ...]
    start: Float[np.ndarray, "parameters parameters"]
    solved: Bool[np.ndarray, "rows"]
    model: Model


def design_postures(
    scene: sr.Scene,
    candidates: Postures,
    *,
    fit: Sequence[str] | str,
    count: int,
    shrink: Sequence[str] | str | None = None,
    criterion: str = "D",
    known: Sequence[int] = (),
    recorded: Postures | None = None,
    priors: Mapping[str, tuple[float, float]] | None = None,
    noise_scale: float = 1.0,
    method: sr.Collocation = sr.Collocation(),  # noqa: B008
) -> Design:
    """The `count` rows of `candidates` that tell most of parameters, at their values in the scene.

    Where tendons rub or actuators have play, a row depends on those before it in its trial: then
    whole trials are chosen.

    - `candidates`: inputs, and any finite numbers for each marker that will be seen
      (`calibration.postures.data.load_candidates` makes them); `noise` counts.
    - `fit`: what will be fitted. `shrink`: those of it whose intervals count, by default all; the
      others are fitted too, and may be vague.
    - `criterion`: "D" makes the volume of the joint interval small (the determinant of the
      covariance), "A" the sum of squares of the intervals, in theta.
    - `known`: rows that have been recorded already; `recorded`: postures that have been.
    - `priors`: as of `calibrate_postures`.
    - `noise_scale`: how many times larger the noise is than stated, as a fit tells; of the
      candidates and of `recorded`. It counts where there are priors.

    Raises `ValueError` if there are not so many rows or trials, if none brings anything, and for
    bad arguments.
    """
    if criterion not in CRITERIA:
        raise ValueError(f"criterion: {criterion!r}; expected one of {', '.join(CRITERIA)}")
    told = information(scene, candidates, fit, known, recorded, priors, noise_scale, method)
    names = [p.name for p in told.model.parameters]
    which = _indices(told.model, shrink, names)
    free = [k for k, rows in enumerate(told.rows) if len(rows) and told.each[k].any()]
    many = len([k for k, rows in enumerate(told.rows) if len(rows)])
    if not 0 < count <= many:
        what = "trials" if told.trials else "rows"
        raise ValueError(f"design: count={count}; {many} {what} can be chosen")
    if len(free) < count:
        raise ValueError(
            f"design: {len(free)} of {many} candidates say anything of these parameters, and "
            f"count={count}"
        )
    chosen = chosen_rows(told.each, free, count, told.start, which, criterion)
    with_them = told.start + told.each[chosen].sum(0)
    widths = lambda H: dict(zip(names, _NORMAL * standard_errors(H), strict=True))
    expected = widths(with_them)
    return Design(
        rows=np.concatenate([told.rows[k] for k in chosen]),
        trials=tuple(told.trials[k] for k in chosen) if told.trials else (),
        half_widths=expected,
        before=widths(told.start),
        all_rows=widths(told.start + told.each[free].sum(0)),
        intervals={
            p.name: _interval(told.model, p, expected[p.name]) for p in told.model.parameters
        },
        units={p.name: p.unit for p in told.model.parameters},
        unsolved=np.flatnonzero(~told.solved),
    )


def information(
    scene: sr.Scene,
    candidates: Postures,
    fit: Sequence[str] | str,
    known: Sequence[int] = (),
    recorded: Postures | None = None,
    priors: Mapping[str, tuple[float, float]] | None = None,
    noise_scale: float = 1.0,
    method: sr.Collocation = sr.Collocation(),  # noqa: B008
) -> Information:
    """What each of the candidates tells; arguments and errors as of `design_postures`."""
    if not 0 < noise_scale < np.inf:
        raise ValueError(f"noise_scale={noise_scale}: a number above 0 is needed")
    scene = jax.tree.map(jnp.asarray, scene)
    model = prepared_model(scene, candidates, fit, method)
    each, solved = _of_rows(model, noise_scale)
    vague = np.diag([(2.0 / p.scale.largest) ** 2 for p in model.parameters])
    start = vague + prior_information(model, priors) + each[list(known)].sum(0)
    if recorded is not None:
        before, _ = _of_rows(prepared_model(scene, recorded, fit, method), noise_scale)
        start = start + before.sum(0)
    there = [k for k in np.flatnonzero(solved) if k not in known]
    if not model.followed:
        return Information(
            each[there], tuple(np.array([k]) for k in there), (), start, solved, model
        )
    if not candidates.trials:
        raise ValueError(
            "design: tendons rub or actuators have play, so that a posture depends on those before "
            "it: say with a column `trial` which rows are recorded one after the other"
        )
    labels = candidates.labels
    names = [
        x for x in dict.fromkeys(labels.tolist()) if not set(np.flatnonzero(labels == x)) & {*known}
    ]
    rows = tuple(np.flatnonzero((labels == x) & solved) for x in names)
    together = np.stack([each[r].sum(0) for r in rows])
    return Information(together, rows, tuple(names), start, solved, model)


def _of_rows(model: Model, noise_scale: float):
    """The information of each row at theta = 0, and which rows have an equilibrium."""
    evaluation = model.evaluate(np.zeros(len(model.parameters)))
    J = np.where(evaluation.solved[:, None, None], evaluation.jacobian, 0.0) / noise_scale
    return np.einsum("kni,knj->kij", J, J), evaluation.solved


def _indices(model: Model, shrink, names: list[str]) -> list[int]:
    """Which of the fitted parameters count."""
    if shrink is None:
        return [*range(len(names))]
    _, groups = catalogue(model.setup.scene)
    found = [n for asked in as_names(shrink) for n in groups.get(asked, (asked,))]
    for name in found:
        if name not in names:
            raise ValueError(f"shrink: {name!r} is not fitted; add it to fit, or leave it out")
    return [names.index(name) for name in found]


def _interval(model: Model, parameter, half_width: float) -> tuple[float, float]:
    """Around the value in the scene, of the first of several numbers."""
    initial = np.asarray(parameter.get(model.setup))
    reach = min(half_width, parameter.scale.largest)
    low, high = (np.ravel(parameter.scale.value(initial, x))[0] for x in (-reach, reach))
    return float(low), float(high)


def standard_errors(H: Float[np.ndarray, "*n p p"]) -> Float[np.ndarray, "*n p"]:
    """Of theta, from the information."""
    return np.sqrt(np.diagonal(np.linalg.inv(H), axis1=-2, axis2=-1))


def badness(
    H: Float[np.ndarray, "*n p p"], which: Sequence[int], criterion: str = "D"
) -> Float[np.ndarray, "*n"]:
    """What a design makes small of the parameters at the indices `which`: the logarithm of the
    determinant of their covariance, or of its trace."""
    covariance = np.linalg.inv(H)[..., which, :][..., :, which]
    if criterion == "A":
        return np.asarray(np.log(np.trace(covariance, axis1=-2, axis2=-1)))
    return np.asarray(np.linalg.slogdet(covariance)[1])


def chosen_rows(
    each: Float[np.ndarray, "rows p p"],
    free: Sequence[int],
    count: int,
    start: Float[np.ndarray, "p p"],
    which: Sequence[int] | None = None,
    criterion: str = "D",
) -> list[int]:
    """The rows whose information, added to that of the `start`, has the least `badness`: one after
    the other, then each in turn against all others (Fedorov 1972; Cook and Nachtsheim 1980)."""
    which = [*range(each.shape[-1])] if which is None else which
    of = lambda H: badness(H, which, criterion)
    rows, total = [], np.asarray(start)
    for _ in range(count):
        left = [k for k in free if k not in rows]
        best = left[int(np.argmin(of(total + each[left])))]
        rows.append(best)
        total = total + each[best]
    for _ in range(_ROUNDS):
        exchanged = False
        for i, a in enumerate(rows):
            left = [k for k in free if k not in rows]
            if not left:
                break
            without = total - each[a]
            after = of(without + each[left])
            best = int(np.argmin(after))
            if after[best] < of(total) - _LEAST_GAIN:
                rows[i], total, exchanged = left[best], without + each[left[best]], True
        if not exchanged:
            break
    return rows
