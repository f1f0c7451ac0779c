"""What a fit makes small: measured minus simulated tip, over all recordings.

One compiled program gives residuals and their forward sensitivities; every part of a fit (coarse
search, gradient descent, Levenberg-Marquardt, uncertainty) calls it and nothing else, so that it
is compiled once. All recordings run through it in one call, divided between all devices. Gradient
descent by many parameters uses another, of reverse mode, whose cost does not grow with their
number.
"""

from dataclasses import dataclass, replace
from functools import cache, cached_property

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

import softrod_jax as sr
from calibration.data.onset import white_noise
from calibration.experiment import drift
from calibration.experiment.alignment import Alignment, align
from calibration.experiment.drift import Clock
from calibration.experiment.setup import Setup
from calibration.parameters.catalogue import with_values
from calibration.parameters.unknowns import Unknowns, conditioned
from calibration.problem.memory import check_memory, motion_bytes
from calibration.problem.motion import Batch, Motion, driven, simulate_motion, tip_at
from softrod_jax.foundation.compiling import compiler_options

# A residual of a simulation that failed, in rod lengths: worse than any motion of the rod.
_FAILED = 10.0
# A result that leaves less than this part of the tip's motion (rms), or less than so many standard
# deviations of the noise, is taken for the right one.
UNEXPLAINED, _NOISE = 0.15, 1.5
# One sweep of reverse mode costs about as much as seven tangents of forward mode (0.6 s of a robot
# with three tendons: 0.09 s, against 0.13 s by 12 and 0.31 s by 33 parameters), and the time to
# compile a second program.
_TANGENTS_A_SWEEP = 10


def reverse_pays(parameters: int, outputs: int) -> bool:
    """Whether reverse mode is the cheaper way to the derivatives of `outputs` numbers.

    Forward mode costs a tangent for each parameter, reverse mode a sweep for each output. The loss
    of gradient descent is one output; Levenberg-Marquardt needs the derivatives of every residual,
    hundreds of outputs, and always goes forward.
    """
    return parameters > _TANGENTS_A_SWEEP * outputs


class Evaluation(eqx.Module):
    """Residuals [m] and sensitivities of every recording; padded and missing samples are 0.

    - `residuals`, (recordings, samples, 3): simulated minus measured.
    - `by_parameter`, (recordings, samples, 3, parameters), and `by_course`, its leaves
      (recordings, samples, 3, ..) by those of the course, see `evaluate`: of the residuals, by
      forward mode. By reverse mode, (recordings, parameters) [m^2] and (recordings, ..): of each
      recording's sum of squared weighted residuals.
    - `alignment`: what was added to the simulated tip to get there.
    - `motion`: the simulated tips, before that.
    """

    residuals: Float[Array, "recordings samples 3"]
    by_parameter: Float[Array, "recordings *samples parameters"]
    by_course: dict[str, Float[Array, "recordings ..."]]
    alignment: Alignment
    motion: Motion


def evaluate(
    setup, batch: Batch, theta, courses, names, scheme, method, reverse: bool = False
) -> Evaluation:
    """Residuals at `theta`, (recordings, names), and `courses`.

    A course is how a recording's clock and sensor see the simulation, and what became of its
    inputs: a dictionary of "delay" [s], (recordings,), and for each channel that may drift of how
    much it changes in each window, (recordings, windows, numbers), see
    `calibration.experiment.drift`.

    A simulation that fails has residuals of ten rod lengths, whose sensitivities are zero. Raises
    `RecordingError` if all that takes more memory than is reasonable.
    """
    _check_memory(batch, courses, len(names), method, reverse)
    return _compiled(_gradients if reverse else _sensitivities)(
        setup, batch, theta, courses, names, scheme, method
    )


def _check_memory(batch: Batch, courses, parameters: int, method, reverse: bool) -> None:
    many, steps, samples = batch.dt.shape[0], batch.steps, batch.times.shape[1]
    seen = {name: np.size(x) // many for name, x in courses.items()}
    # The motion depends on parameters and on what became of the inputs; how it is seen, on all.
    moving = parameters + seen.get("inputs", 0)
    needed = motion_bytes(many, steps, method.intervals, 1 if reverse else moving)
    needed += 0 if reverse else 3 * 8.0 * batch.times.size * (parameters + sum(seen.values()))
    check_memory(
        needed,
        f"{many} recording{'s'[: many > 1]} of up to {steps} steps and {samples} samples"
        + (f", with {parameters + sum(seen.values())} unknowns each" if parameters else ""),
        "use a part of the recordings (--window START END), longer windows of a drift, or larger "
        "steps (dt)",
    )


@cache
def _compiled(function):
    static = ("names", "scheme", "method")
    return jax.jit(function, static_argnames=static, compiler_options=compiler_options())


def _each(one, batch: Batch, *inputs):
    """`one` of every recording, in one program, on all devices of all processes."""
    devices = jax.devices()
    if jax.process_count() == 1:
        # One without a recording would only repeat another's work.
        devices = devices[: batch.dt.shape[0]]
    return sr.spread(one, devices)(batch, *inputs)


def _moved(own: Setup, recording: Batch, course, scheme, method) -> Motion:
    """The motion under the inputs as they arrive."""
    if "inputs" in course:
        recording = driven(recording, course["inputs"][:, 0])
    return simulate_motion(own, recording, scheme, method)


def _gradients(setup, batch, theta, courses, names, scheme, method):
    def one(recording, theta, course):
        own = conditioned(setup, recording.conditions)

        def loss(theta, course):
            motion = _moved(with_values(own, names, theta), recording, course, scheme, method)
            r, alignment = _residual(motion, recording, course, setup.scene.length)
            return jnp.sum((recording.weights * r) ** 2), (r, alignment, motion)

        (by_theta, by_course), (r, *rest) = jax.grad(loss, (0, 1), has_aux=True)(theta, course)
        return Evaluation(r, by_theta, by_course, *rest)

    return _each(one, batch, theta, courses)


def _sensitivities(setup, batch, theta, courses, names, scheme, method):
    def one(recording, theta, course):
        own = conditioned(setup, recording.conditions)
        # Only these move the rod; what else is in the course costs no simulation.
        inputs = {name: x for name, x in course.items() if name == "inputs"}

        def by_cause(theta, inputs):
            motion = _moved(with_values(own, names, theta), recording, inputs, scheme, method)
            return residual(motion, course)[0], motion

        def residual(motion, course):
            return _residual(motion, recording, course, setup.scene.length)

        (by_parameter, by_inputs), motion = jax.jacfwd(by_cause, (0, 1), has_aux=True)(
            theta, inputs
        )
        seen = {name: x for name, x in course.items() if name not in inputs}
        by_course = jax.jacfwd(lambda c: residual(motion, c)[0])(seen)
        r, alignment = residual(motion, course)
        return Evaluation(r, by_parameter, {**by_course, **by_inputs}, alignment, motion)

    return _each(one, batch, theta, courses)


def predict(setup, batch: Batch, theta, courses, names, scheme, method):
    """Like `evaluate`, without sensitivities: residuals and motions of every recording."""
    # Of what `evaluate` takes, half the step or twice the grid takes no more.
    _check_memory(batch, {}, 0, method, reverse=False)
    return _compiled(_predict)(setup, batch, theta, courses, names, scheme, method)


def _predict(setup, batch, theta, courses, names, scheme, method):
    def one(recording, theta, course):
        own = with_values(conditioned(setup, recording.conditions), names, theta)
        motion = _moved(own, recording, course, scheme, method)
        return _residual(motion, recording, course, setup.scene.length)[0], motion

    return _each(one, batch, theta, courses)


def _residual(motion: Motion, recording: Batch, course, length, frame: Alignment | None = None):
    """In the frame that fits best, or in `frame`, where the recording's own is free."""
    ok = motion.result == sr.RESULTS.successful
    used = recording.used
    times = recording.times - course["delay"]
    if "clock" in course:
        times = times - recording.ramps["clock"] @ course["clock"][:, 0]
    tip = seen = tip_at(motion, recording.dt, times)
    if "tip" in course:
        seen = tip + recording.ramps["tip"] @ course["tip"]
    moved = jnp.where(ok, tip - motion.positions[0], 0.0)
    missed = jnp.where(used & ok, recording.tip - seen, 0.0)
    alignment = align(moved, missed, recording.weights) if frame is None else frame
    free = recording.free_frame
    alignment = jax.tree.map(lambda x: jnp.where(free, x, 0.0), alignment)
    r = jnp.where(ok, alignment.of(moved) - missed, _FAILED * length)
    return jnp.where(used, r, 0.0), alignment


@jax.jit
def losses_by_delay(motion: Motion, batch: Batch, courses, delays, length, frame=None):
    """Sums of squares [m^2] at `delays` [s], (recordings, tries), the rest of the courses being as
    it is: (recordings, tries). One after the other: a long log has no room for all at once."""

    def of_one(arguments):
        motion, recording, course, delays = arguments

        def at(delay):
            seen = {**course, "delay": delay}
            residual = _residual(motion, recording, seen, length, frame)[0]
            return jnp.sum((recording.weights * residual) ** 2)

        return jax.lax.map(at, delays)

    return jax.lax.map(of_one, (motion, batch, courses, delays))


@jax.jit
def residuals_in(motion: Motion, batch: Batch, courses, length, frame: Alignment):
    """Residuals [m] of all recordings, (recordings, samples, 3), and their alignments, seen in
    `frame` where their own is free."""
    one = lambda *recording: _residual(*recording, length, frame)
    return jax.vmap(one)(motion, batch, courses)


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
