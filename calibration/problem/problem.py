"""What a fit makes small, and where: the space of all unknowns, and points in it.

A `Problem` knows which unknown is which parameter, clock or drift; a `Point` is a place in their
space with its residuals, its loss and its derivatives, which `calibration.problem.evaluation`
computes.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import softrod_jax as sr
from calibration.data.onset import white_noise
from calibration.experiment import drift
from calibration.experiment.drift import Clock
from calibration.experiment.setup import Setup
from calibration.parameters.unknowns import Unknowns, conditioned
from calibration.problem.evaluation import Evaluation, evaluate
from calibration.problem.motion import Batch

# A result that leaves less than this part of the tip's motion (rms), or less than so many standard
# deviations of the noise, is taken for the right one.
UNEXPLAINED, _NOISE = 0.15, 1.5


@dataclass(frozen=True, eq=False)
class Point:
    """A place in the space of all unknowns, evaluated.

    `x`, (unknowns,): theta of the parameters, then the delays in sample intervals, then for each
    recording the drifts of its windows in terms of their standard deviations
    (`calibration.experiment.drift`). `result`: the worst result code; 0 if every simulation
    succeeded.
    """

    x: np.ndarray
    evaluation: Evaluation
    problem: "Problem"

    @cached_property
    def residuals(self) -> np.ndarray:
        """Weighted, (recordings * samples * 3,) [m]."""
        return (self.problem.weights * self.evaluation.residuals).ravel()

    @cached_property
    def jacobian(self) -> np.ndarray:
        """Of the weighted residuals, (recordings * samples * 3, unknowns) [m]; of a problem that
        is not `reverse`."""
        problem, unknowns = self.problem, self.problem.unknowns
        weights = problem.weights
        J = np.zeros((*weights.shape, self.x.size))
        for k, j in np.argwhere(unknowns.columns >= 0):
            J[k, ..., unknowns.columns[k, j]] += self.evaluation.by_parameter[k, ..., j]
        for name, (place, size) in problem.course_columns.items():
            for k, *j in np.argwhere(place >= 0):
                by = self.evaluation.by_course[name][k, ..., *j]
                J[k, ..., place[k, *j]] = by * size[k, *j]
        return (weights[..., None] * J).reshape(-1, self.x.size)

    @cached_property
    def gradient(self) -> np.ndarray:
        """Of the loss, (unknowns,) [m^2]."""
        problem, unknowns = self.problem, self.problem.unknowns
        prior = 2 * problem.prior * self.x
        if not problem.reverse:
            return 2 * self.jacobian.T @ self.residuals + prior
        gradient = prior
        for k, j in np.argwhere(unknowns.columns >= 0):
            gradient[unknowns.columns[k, j]] += self.evaluation.by_parameter[k, j]
        for name, (place, size) in problem.course_columns.items():
            for k, *j in np.argwhere(place >= 0):
                gradient[place[k, *j]] += self.evaluation.by_course[name][k, *j] * size[k, *j]
        return gradient

    @cached_property
    def misfit(self) -> float:
        """Sum of squared weighted residuals [m^2]."""
        return float(np.sum(self.residuals**2))

    @cached_property
    def loss(self) -> float:
        """What is made small: the misfit and what is believed of drifts beforehand [m^2]."""
        return self.misfit + float(np.sum(self.problem.prior * self.x**2))

    @property
    def rms(self) -> float:
        """Root mean square distance between measured and simulated tip [m]."""
        return float(np.sqrt(self.misfit / self.problem.samples))

    @property
    def explains(self) -> bool:
        """Whether it leaves little of the motion, or no more than noise."""
        return self.problem.explained(self.loss, UNEXPLAINED)

    @property
    def result(self) -> int:
        return int(np.max(np.asarray(self.evaluation.motion.result)))

    @property
    def ok(self) -> bool:
        return self.result == sr.RESULTS.successful and np.isfinite(self.loss)


@dataclass(frozen=True, eq=False)
class Problem:
    """Setup, recordings and what is fitted: from numbers to an evaluated `Point`.

    `reverse`: points have the gradient of the loss, and no Jacobian.
    """

    setup: Setup
    batch: Batch
    clocks: list[Clock]
    unknowns: Unknowns
    time_offset: bool
    scheme: sr.SDIRK | sr.BDFAlpha
    method: sr.Collocation
    reverse: bool = False

    @property
    def scene(self) -> sr.Scene:
        return self.setup.scene

    @property
    def size(self) -> int:
        """How many parameters are fitted; the delays come after them in x."""
        return len(self.unknowns.items)

    @property
    def delays(self) -> slice:
        """Where the delays are in x."""
        return slice(self.size, self.size + len(self.clocks) * self.time_offset)

    @cached_property
    def course_columns(self) -> dict[str, tuple[np.ndarray, np.ndarray]]:
        """Of every number of the recordings' courses, shaped like these: which entry of x it is,
        -1 for none, and its size in units of x."""
        many, end = len(self.clocks), self.delays.stop
        place = np.arange(many) + self.size if self.time_offset else np.full(many, -1)
        columns = {"delay": (place, np.array([clock.interval for clock in self.clocks]))}
        for name, ramps in self.batch.ramps.items():
            place = np.full((many, ramps.shape[-1], drift.CHANNELS[name]), -1)
            size = np.zeros(place.shape)
            for k, clock in enumerate(self.clocks):
                own = place[k, : clock.windows.get(name, 0)]
                if own.size:
                    own[...] = end + np.arange(own.size).reshape(own.shape)
                    size[k] = drift.size(clock, name, self.scene.length)
                    end += own.size
            columns[name] = place, size
        return columns

    @cached_property
    def drifts(self) -> int:
        """How many unknowns all drifts have, the last of x."""
        return sum(
            drift.CHANNELS[name] * windows
            for clock in self.clocks
            for name, windows in clock.windows.items()
        )

    @cached_property
    def prior(self) -> np.ndarray:
        """(unknowns,) [m^2]: weights of x^2 in the loss, for what is believed of drifts."""
        prior = np.zeros(self.delays.stop + self.drifts)
        if self.drifts:
            prior[self.delays.stop :] = self.noise**2
        return prior

    @cached_property
    def noise(self) -> float:
        """Standard deviation [m] of a coordinate's noise, from second differences."""
        used = np.asarray(self.batch.used)
        measured = np.any(used, axis=1, keepdims=True)
        used = np.all(used | ~measured, axis=-1) & np.any(used, axis=-1)
        tips = [np.asarray(tip)[u] for tip, u in zip(self.batch.tip, used, strict=True)]
        return float(np.median([white_noise(tip) for tip in tips]))

    @cached_property
    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Lowest and highest x."""
        low, high = ([getattr(u, k) for u in self.unknowns.items] for k in ("low", "high"))
        if self.time_offset:
            low += [c.low / c.interval for c in self.clocks]
            high += [c.high / c.interval for c in self.clocks]
        far = [drift.LARGEST] * self.drifts
        return np.array(low + [-x for x in far]), np.array(high + far)

    @cached_property
    def weights(self) -> np.ndarray:
        """(recordings, samples, 3)."""
        return np.asarray(self.batch.weights)

    @cached_property
    def samples(self) -> float:
        """Samples with at least one coordinate of the tip, each counting by its weight."""
        return float(np.sum(np.max(self.weights**2, axis=-1)))

    def explained(self, loss: float, part: float) -> bool:
        """Whether a loss leaves less than `part` of the motion (rms), or no more than noise."""
        noise = _NOISE * np.sqrt(3) * self.noise
        return loss < max(part * self.motion_rms, noise) ** 2 * self.samples

    @cached_property
    def motion_rms(self) -> float:
        """Root mean square distance of the measured tips from their mean [m]."""
        w = self.weights**2
        mean = np.sum(w * self.batch.tip, axis=1) / np.maximum(np.sum(w, axis=1), 1e-12)
        about = np.asarray(self.batch.tip) - mean[:, None]
        return float(np.sqrt(np.sum(w * about**2) / self.samples))

    def weighted(self, weights: np.ndarray) -> "Problem":
        """The same problem with other weights, (recordings, samples, 3)."""
        batch = eqx.tree_at(lambda b: b.weights, self.batch, jnp.asarray(weights))
        return replace(self, batch=batch)

    def start(self) -> np.ndarray:
        """x at the setup's own values, the first guess of the clocks, and no drift."""
        return np.zeros(self.delays.stop + self.drifts)

    def courses(self, x) -> dict[str, np.ndarray]:
        """The courses at `x`, see `evaluate`."""
        return {
            name: np.where(place < 0, 0.0, x[np.maximum(place, 0)]) * size
            for name, (place, size) in self.course_columns.items()
        }

    def at(self, x, batch: Batch | None = None) -> Point:
        """Evaluate at `x`, cut to the bounds."""
        x = np.clip(x, *self.bounds)
        evaluation = evaluate(
            self.setup,
            self.batch if batch is None else batch,
            jnp.asarray(self.unknowns.theta(x)),
            self.courses(x),
            self.unknowns.names,
            self.scheme,
            self.method,
            self.reverse,
        )
        return Point(x, jax.device_get(evaluation), self)

    def values(self, x) -> dict[str, np.ndarray]:
        """The parameters' values at `x`, by label."""
        return {u.label: u.value(t) for u, t in zip(self.unknowns.items, x, strict=False)}

    def fitted_setup(self, x, recording: int | None = None) -> Setup:
        """The setup at `x`: of one recording, or with what all recordings share."""
        setup = self.setup
        if recording is not None:
            own = {name: v[recording] for name, v in self.batch.conditions.items()}
            setup = conditioned(setup, own)
        for u, theta in zip(self.unknowns.items, x, strict=False):
            if u.recording is None or u.recording == recording:
                setup = u.parameter.put(setup, jnp.asarray(u.value(theta)))
        return setup
