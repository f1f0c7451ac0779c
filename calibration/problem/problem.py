"""What a fit makes small, and where: a problem, and points of its search space.

A `Problem` evaluates places in its space; a `Point` is such a place with its residuals, its loss
and its derivatives, which `calibration.problem.evaluation` computes.
"""

import abc
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

import softrod_jax as sr
from calibration.experiment.setup import Setup
from calibration.parameters.priors import Priors, prior_rows
from calibration.parameters.unknowns import Unknowns, conditioned
from calibration.problem.batch import Batch, make_batch
from calibration.problem.dataset import Dataset
from calibration.problem.evaluation import Evaluation, evaluate
from calibration.problem.motion import METHOD, SCHEME
from calibration.problem.space import SearchSpace
from calibration.problem.statistics import DataStatistics


@dataclass(frozen=True, eq=False)
class Point:
    """A place x of a problem's search space, (unknowns,), evaluated.

    `result`: the worst result code; 0 if every simulation succeeded.
    """

    x: Float[np.ndarray, "unknowns"]
    evaluation: Evaluation
    problem: "Problem"

    @cached_property
    def residuals(self) -> Float[np.ndarray, "coordinates"]:
        """Weighted, of all that was measured [m]."""
        return (self.problem.statistics.weights * self.evaluation.residuals).ravel()

    @cached_property
    def jacobian(self) -> Float[np.ndarray, "coordinates unknowns"]:
        """Derivatives of the weighted residuals [m]; of a problem that is not `reverse`."""
        weights = self.problem.statistics.weights
        return (weights[..., None] * self._derivatives).reshape(-1, self.x.size)

    @cached_property
    def gradient(self) -> Float[np.ndarray, "unknowns"]:
        """Derivatives of the loss [m^2]."""
        pull = 2 * self.pull
        if self.problem.reverse:
            return np.sum(self._derivatives, axis=0) + pull
        return 2 * self.jacobian.T @ self.residuals + pull

    @cached_property
    def from_priors(
        self,
    ) -> tuple[Float[np.ndarray, "priors"], Float[np.ndarray, "priors unknowns"]]:
        """How far the parameters are from their priors, in standard deviations, and derivatives."""
        return prior_rows(self.problem.prior_places, self.x)

    @cached_property
    def beliefs(
        self,
    ) -> tuple[Float[np.ndarray, "told"], Float[np.ndarray, "told unknowns"]]:
        """Of all that is told besides the recordings, priors first: how far off it is, in standard
        deviations, and derivatives."""
        if self.problem.beside is None:
            return self.from_priors
        parts = zip(self.from_priors, self.problem.beside.rows(self.x), strict=True)
        r, J = (np.concatenate(part) for part in parts)
        return r, J

    @cached_property
    def rows(
        self,
    ) -> tuple[Float[np.ndarray, "all"], Float[np.ndarray, "all unknowns"]]:
        """Residuals and those of the priors [m], and their derivatives."""
        size = np.sqrt(self.problem.variance)
        r, J = self.beliefs
        residuals = np.concatenate([self.residuals, size * r])
        return residuals, np.concatenate([self.jacobian, size * J])

    @cached_property
    def known(self) -> Float[np.ndarray, "unknowns unknowns"]:
        """The information of what is believed beforehand of drifts and parameters [m^2]."""
        _, J = self.beliefs
        return np.diag(self.problem.prior) + self.problem.variance * J.T @ J

    @cached_property
    def pull(self) -> Float[np.ndarray, "unknowns"]:
        """Half the derivative of what that adds to the loss [m^2]."""
        r, J = self.beliefs
        return self.problem.prior * self.x + self.problem.variance * J.T @ r

    @property
    def _derivatives(self):
        by_nuisance = {name: np.asarray(x) for name, x in self.evaluation.by_nuisance.items()}
        by_parameter = np.asarray(self.evaluation.by_parameter)
        return self.problem.space.derivatives(by_parameter, by_nuisance)

    @cached_property
    def misfit(self) -> float:
        """Sum of squared weighted residuals [m^2]."""
        return float(np.sum(self.residuals**2))

    @cached_property
    def loss(self) -> float:
        """What is made small: the misfit and what is believed beforehand [m^2]."""
        r, _ = self.beliefs
        believed = self.problem.variance * np.sum(r**2) + np.sum(self.problem.prior * self.x**2)
        return self.misfit + float(believed)

    @property
    def rms(self) -> float:
        """Root mean square distance between measured and simulated tip [m]."""
        statistics = self.problem.statistics
        apart = (statistics.weights * self.evaluation.residuals)[..., :3]
        return float(np.sqrt(np.sum(apart**2) / statistics.samples))

    @property
    def explains(self) -> bool:
        """Whether it leaves little of the motion, or no more than noise."""
        own = self.loss if self.problem.beside is None else self.misfit
        return self.problem.statistics.explained(own)

    @property
    def result(self) -> int:
        return int(np.max(np.asarray(self.evaluation.motion.result)))

    @property
    def ok(self) -> bool:
        return self.result == sr.RESULTS.successful and bool(np.isfinite(self.loss))


class AbstractBeside(abc.ABC):
    """What was measured besides the recordings of a problem and depends on the same unknowns.

    `scale`: its noise, in terms of what was stated. `effective`: how many independent numbers it
    is worth.
    """

    scale: float
    effective: float

    @abc.abstractmethod
    def rows(
        self, x: Float[np.ndarray, "unknowns"]
    ) -> tuple[Float[np.ndarray, "rows"], Float[np.ndarray, "rows unknowns"]]:
        """Residuals in terms of their noise, and derivatives."""

    @abc.abstractmethod
    def among(self, problem: "Problem") -> "AbstractBeside":
        """The same of the unknowns of another problem, in which more is fitted."""

    @abc.abstractmethod
    def weighed(self, x: Float[np.ndarray, "unknowns"]) -> "AbstractBeside":
        """The same with the noise that its residuals at `x` have."""


@dataclass(frozen=True, eq=False)
class Problem:
    """Setup, recordings and what is fitted: from x to an evaluated `Point`.

    - `reverse`: points have the gradient of the loss, and no Jacobian.
    - `priors`: mean and standard deviation of parameters, by name or label.
    - `prior_variance` [m^2]: of an independent coordinate of the residuals, by which priors are
      weighed against them; None: that of the noise alone (`calibration.inference.beliefs`).
    - `beside`: what else was measured, weighed in the same way.
    """

    setup: Setup
    batch: Batch
    space: SearchSpace
    scheme: sr.SDIRK | sr.BDFAlpha
    method: sr.Collocation
    reverse: bool = False
    priors: Priors = field(default_factory=dict)
    prior_variance: float | None = None
    beside: AbstractBeside | None = None

    @property
    def scene(self) -> sr.Scene:
        return self.setup.scene

    @cached_property
    def statistics(self) -> DataStatistics:
        return DataStatistics(self.batch)

    @cached_property
    def prior(self) -> Float[np.ndarray, "unknowns"]:
        """Weights [m^2] of x^2 in the loss, for what is believed of drifts."""
        prior, drifts = self.space.origin(), self.space.drifts
        if drifts.stop > drifts.start:
            prior[drifts] = self.statistics.noise**2
        return prior

    @cached_property
    def prior_places(self) -> list[tuple[int, Callable, float, float]]:
        """Of each prior the unknown, its value as a function of x, mean and deviation."""
        found = []
        for name, (mean, spread) in self.priors.items():
            for i, u in enumerate(self.space.parameters.items):
                if name in (u.label, u.parameter.name):
                    value = lambda x, u=u: jnp.mean(
                        jnp.asarray(u.parameter.scale.value(u.initial, x))
                    )
                    found.append((i, value, mean, spread))
        return found

    @cached_property
    def variance(self) -> float:
        """That by which priors are weighed [m^2]."""
        if not self.priors and self.beside is None:
            return 0.0
        given = self.prior_variance
        return self.statistics.noise**2 if given is None else given

    def weighted(self, weights: Float[np.ndarray, "recordings samples all"]) -> "Problem":
        """The same problem with other weights."""
        batch = eqx.tree_at(lambda b: b.weights, self.batch, jnp.asarray(weights))
        return replace(self, batch=batch)

    def at(self, x: Float[np.ndarray, "unknowns"]) -> Point:
        """Evaluate at `x`, cut to the bounds."""
        space = self.space
        x = np.clip(x, *space.bounds)
        evaluation = evaluate(
            self.setup,
            self.batch,
            jnp.asarray(space.parameters.theta(x)),
            space.nuisance(x),
            space.parameters.names,
            self.scheme,
            self.method,
            self.reverse,
        )
        return Point(x, jax.device_get(evaluation), self)

    def fitted_setup(self, x, recording: int | None = None) -> Setup:
        """The setup at `x`: of one recording, or with what all recordings share."""
        setup = self.setup
        if recording is not None:
            own = {name: v[recording] for name, v in self.batch.conditions.items()}
            setup = conditioned(setup, own)
        for u, theta in zip(self.space.parameters.items, x, strict=False):
            if u.recording is None or u.recording == recording:
                setup = u.parameter.put(setup, jnp.asarray(u.value(theta)))
        return setup


def make_problem(
    setup: Setup,
    parameters: Unknowns,
    data: Dataset,
    time_offset: bool,
    dt: float | Sequence[float] | None,
    scheme: sr.SDIRK | sr.BDFAlpha = SCHEME,
    method: sr.Collocation = METHOD,
) -> Problem:
    """The problem of fitting `parameters` of `setup`, and delays if `time_offset`, to `data`.

    `dt` [s]: the time step, see `calibration.problem.batch.make_batch`, which also raises.
    """
    batch, clocks = make_batch(setup.scene, data, time_offset, dt)
    windows = {name: ramps.shape[-1] for name, ramps in batch.ramps.items()}
    space = SearchSpace(parameters, clocks, time_offset, windows, float(setup.scene.length))
    return Problem(setup, batch, space, scheme, method)
