"""Postures that are fitted together with motions of the same robot."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Float

import softrod_jax as sr
from calibration.parameters.catalogue import parameters_of
from calibration.postures.data import Postures
from calibration.postures.prediction import Evaluation, Model, coarse
from calibration.postures.search import LEAST_SCALE, effective_of, noise_scale_of
from calibration.problem.problem import AbstractBeside, Point, Problem
from calibration.report.results import PosturesFit


@dataclass(frozen=True, eq=False)
class Equilibria(AbstractBeside):
    """Postures as a part of a problem of motions.

    - `places`: of each of the model's parameters the unknown that it is.
    - `scale`: the noise of an independent number, in terms of what was stated. `effective`: how
      many there are of them, as far as it is known.
    """

    model: Model
    places: Sequence[int]
    scale: float = 1.0
    effective: float = np.inf
    _known: dict[bytes, Evaluation] = field(default_factory=dict, repr=False)

    def evaluation(self, x: Float[np.ndarray, "unknowns"]) -> Evaluation:
        """All rows at `x`; the last place is remembered."""
        theta = np.asarray(x)[list(self.places)]
        key = theta.tobytes()
        if key not in self._known:
            self._known.clear()
            self._known[key] = self.model.evaluate(theta)
        return self._known[key]

    def rows(
        self, x: Float[np.ndarray, "unknowns"]
    ) -> tuple[Float[np.ndarray, "rows"], Float[np.ndarray, "rows unknowns"]]:
        found = self.evaluation(x)
        r, own = found.residuals.ravel(), found.jacobian.reshape(-1, len(self.places))
        measured = np.any(own != 0, axis=1) | (r != 0)
        J = np.zeros((int(np.sum(measured)), np.size(x)))
        J[:, list(self.places)] = own[measured]
        return r[measured] / self.scale, J / self.scale

    def among(self, problem: Problem) -> "Equilibria":
        model, places = _model(problem, self.model.postures, self.model.method)
        return replace(self, model=model, places=places, _known={})

    def weighed(self, x: Float[np.ndarray, "unknowns"]) -> "Equilibria":
        found = self.evaluation(x)
        count = np.sum(np.any(found.jacobian != 0, -1) | (found.residuals != 0))
        effective = effective_of(self.model, found)
        scale = max(noise_scale_of(found), LEAST_SCALE) * np.sqrt(float(count) / effective)
        return replace(self, scale=float(scale), effective=effective)


def with_equilibria(
    problem: Problem, postures: Postures | None, method: sr.Collocation | None
) -> Problem:
    """The problem with postures beside its motions, which have what all recordings share."""
    if postures is None:
        return problem
    grid = sr.Collocation() if method is None else method
    model, places = _model(problem, postures, coarse(grid.fitted(problem.scene)))
    return replace(problem, beside=Equilibria(model, places))


def _model(problem: Problem, postures: Postures, method) -> tuple[Model, list[int]]:
    """The postures by what all recordings of the problem share, and where that is among the
    unknowns."""
    items = problem.space.parameters.items
    places = [i for i, u in enumerate(items) if u.recording is None]
    parameters = parameters_of(problem.scene, [items[i].parameter.name for i in places])
    return Model(problem.setup, postures, parameters, method), places


def equilibria_fit(best: Point) -> PosturesFit | None:
    """What is left of the postures at a point of such a problem; None without any."""
    beside = best.problem.beside
    if not isinstance(beside, Equilibria):
        return None
    model, found = beside.model, beside.evaluation(best.x)
    target = model.targets
    has = np.all(np.asarray(target.has_position), -1) & found.solved[:, None]
    offset = np.asarray(found.seen.positions) - np.asarray(target.positions)
    squares = np.where(has, np.sum(offset**2, axis=-1), 0.0)
    rms = lambda squares, has: float(np.sqrt(np.sum(squares) / max(np.sum(has), 1)))
    return PosturesFit(
        name=model.postures.name,
        source=model.postures.source,
        rows=model.postures.rows,
        unsolved=int(np.sum(~found.solved)),
        rmse_m=rms(squares, has),
        rmse_by_marker={n: rms(squares[:, j], has[:, j]) for j, n in enumerate(model.markers)},
        noise_scale=noise_scale_of(found),
        simulated=np.where(found.solved[:, None, None], found.seen.positions, np.nan),
        measured=np.where(target.has_position, target.positions, np.nan),
    )
