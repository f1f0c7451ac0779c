"""Residuals of all recordings under trial values, measured minus simulated tip, and derivatives.

One compiled program gives residuals and their forward sensitivities; every part of a fit (coarse
search, gradient descent, Levenberg-Marquardt, uncertainty) calls it and nothing else, so that it
is compiled once. All recordings run through it in one call, divided between all devices. Gradient
descent by many parameters uses another, of reverse mode, whose cost does not grow with their
number.
"""

from functools import cache

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

import softrod_jax as sr
from calibration.experiment.alignment import Alignment, align
from calibration.experiment.setup import Setup
from calibration.parameters.catalogue import with_values
from calibration.parameters.unknowns import conditioned
from calibration.problem.memory import check_memory, motion_bytes
from calibration.problem.motion import Batch, Motion, driven, simulate_motion, tip_at
from softrod_jax.foundation.compiling import compiler_options

# A residual of a simulation that failed, in rod lengths: worse than any motion of the rod.
_FAILED = 10.0
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
