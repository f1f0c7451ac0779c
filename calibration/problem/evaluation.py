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
from calibration.experiment.alignment import Alignment
from calibration.experiment.setup import Setup
from calibration.parameters.catalogue import with_values
from calibration.parameters.unknowns import conditioned
from calibration.problem.batch import Batch
from calibration.problem.memory import check_memory, motion_bytes
from calibration.problem.motion import Motion, driven, simulate_motion
from calibration.problem.residuals import residual
from softrod_jax.foundation.compiling import compiler_options

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
    """Residuals and sensitivities of every recording, or of one; 0 where samples are missing.

    - `residuals`, (recordings, samples, all): simulated minus measured, of the tip [m], then of
      what else was measured.
    - `by_parameter`, (recordings, samples, all, parameters), and `by_nuisance`, its leaves
      (recordings, samples, all, ..) by those of the nuisance parameters, see `evaluate`:
      derivatives of the residuals, by forward mode. By reverse mode, (recordings, parameters)
      [m^2] and (recordings, ..): derivatives of each recording's sum of squared weighted residuals.
    - `alignment`: what was added to the simulated tip to get there.
    - `motion`: the simulated tips, before that.
    """

    residuals: Float[Array, "*recordings samples all"]
    by_parameter: Float[Array, "... parameters"]
    by_nuisance: dict[str, Float[Array, "..."]]
    alignment: Alignment
    motion: Motion


def evaluate(
    setup, batch: Batch, theta, nuisance, names, scheme, method, reverse: bool = False
) -> Evaluation:
    """Residuals at `theta`, (recordings, names), and `nuisance`.

    The nuisance parameters are how a recording's clock and sensor see the simulation, and what
    became of its inputs: a dictionary of "delay" [s], (recordings,), and for each channel that may
    drift of how much it changes in each window, (recordings, windows, numbers), see
    `calibration.experiment.drift`.

    A simulation that fails has residuals of ten rod lengths, whose sensitivities are zero. Raises
    `RecordingError` if all that takes more memory than is reasonable.
    """
    _check_memory(batch, nuisance, len(names), method, reverse)
    return _compiled(_gradients if reverse else _sensitivities)(
        setup, batch, theta, nuisance, names, scheme, method
    )


def _check_memory(batch: Batch, nuisance, parameters: int, method, reverse: bool) -> None:
    many, steps, samples = batch.dt.shape[0], batch.steps, batch.times.shape[1]
    seen = {name: np.size(x) // many for name, x in nuisance.items()}
    # The motion depends on parameters and on what became of the inputs; how it is seen, on all.
    moving = parameters + seen.get("inputs", 0)
    needed = motion_bytes(many, steps, method.intervals, 1 if reverse else moving)
    needed += 0 if reverse else 8.0 * batch.used.size * (parameters + sum(seen.values()))
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


def _moved(own: Setup, recording: Batch, nuisance, scheme, method) -> Motion:
    """The motion under the inputs as they arrive."""
    if "inputs" in nuisance:
        recording = driven(recording, nuisance["inputs"][:, 0])
    return simulate_motion(own, recording, scheme, method)


def _gradients(setup, batch, theta, nuisance, names, scheme, method):
    def one(recording, theta, nuisance):
        own = conditioned(setup, recording.conditions)

        def loss(theta, nuisance):
            motion = _moved(with_values(own, names, theta), recording, nuisance, scheme, method)
            r, alignment = residual(motion, recording, nuisance, setup.scene.length)
            return jnp.sum((recording.weights * r) ** 2), (r, alignment, motion)

        (by_theta, by_nuisance), (r, *rest) = jax.grad(loss, (0, 1), has_aux=True)(theta, nuisance)
        return Evaluation(r, by_theta, by_nuisance, *rest)

    return _each(one, batch, theta, nuisance)


def _sensitivities(setup, batch, theta, nuisance, names, scheme, method):
    def one(recording, theta, nuisance):
        own = conditioned(setup, recording.conditions)
        # Only these move the rod; the other nuisance parameters cost no simulation.
        inputs = {name: x for name, x in nuisance.items() if name == "inputs"}

        def by_cause(theta, inputs):
            motion = _moved(with_values(own, names, theta), recording, inputs, scheme, method)
            return seen_as(motion, nuisance)[0], motion

        def seen_as(motion, nuisance):
            return residual(motion, recording, nuisance, setup.scene.length)

        (by_parameter, by_inputs), motion = jax.jacfwd(by_cause, (0, 1), has_aux=True)(
            theta, inputs
        )
        seen = {name: x for name, x in nuisance.items() if name not in inputs}
        by_nuisance = jax.jacfwd(lambda c: seen_as(motion, c)[0])(seen)
        r, alignment = seen_as(motion, nuisance)
        return Evaluation(r, by_parameter, {**by_nuisance, **by_inputs}, alignment, motion)

    return _each(one, batch, theta, nuisance)


def traced(setup, batch: Batch, theta, nuisance, names, scheme, method) -> Evaluation:
    """`evaluate` as a part of a larger program; nothing is checked."""
    return _sensitivities(setup, batch, theta, nuisance, names, scheme, method)


def predict(setup, batch: Batch, theta, nuisance, names, scheme, method):
    """Like `evaluate`, without sensitivities: residuals and motions of every recording."""
    # Half the step or twice the grid takes no more than the derivatives of `evaluate`.
    _check_memory(batch, {}, 0, method, reverse=False)
    return _compiled(_predict)(setup, batch, theta, nuisance, names, scheme, method)


def _predict(setup, batch, theta, nuisance, names, scheme, method):
    def one(recording, theta, nuisance):
        own = with_values(conditioned(setup, recording.conditions), names, theta)
        motion = _moved(own, recording, nuisance, scheme, method)
        return residual(motion, recording, nuisance, setup.scene.length)[0], motion

    return _each(one, batch, theta, nuisance)
