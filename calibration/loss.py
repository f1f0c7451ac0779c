"""What a fit makes small: measured minus simulated tip, over all recordings.

One compiled program gives residuals and their forward sensitivities; every part of a fit (coarse
search, gradient descent, Levenberg-Marquardt, uncertainty) calls it and nothing else, so that it
is compiled once. Reverse mode would cost a second program of twice the compile time, and saves
nothing for a handful of parameters.
"""

from dataclasses import dataclass
from functools import cache, cached_property

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

import softrod_jax as sr
from calibration.alignment import Alignment, align
from calibration.compiling import compiler_options
from calibration.model import Batch, Clock, Motion, simulate_motion, tip_at
from calibration.parameters import PARAMETERS, with_values

# A residual of a simulation that failed, in rod lengths: worse than any motion of the rod.
_FAILED = 10.0


class Evaluation(eqx.Module):
    """Residuals [m] and sensitivities of every recording; padded and missing samples are 0.

    - `residuals`, (recordings, samples, 3): simulated minus measured.
    - `by_parameter`, (recordings, samples, 3, parameters), and `by_delay` [m/s], (recordings,
      samples, 3).
    - `alignment`: what was added to the simulated tip to get there.
    - `motion`: the simulated tips, before that.
    """

    residuals: Float[Array, "recordings samples 3"]
    by_parameter: Float[Array, "recordings samples 3 parameters"]
    by_delay: Float[Array, "recordings samples 3"]
    alignment: Alignment
    motion: Motion


def evaluate(scene, batch: Batch, theta, delays, names, scheme, method) -> Evaluation:
    """Residuals at `theta`, (parameters,), and `delays` [s], (recordings,).

    A simulation that fails has residuals of ten rod lengths, whose sensitivities are zero.
    """
    return _compiled()(scene, batch, theta, delays, names, scheme, method)


@cache
def _compiled():
    static = ("names", "scheme", "method")
    return jax.jit(_evaluate, static_argnames=static, compiler_options=compiler_options())


def _evaluate(scene, batch, theta, delays, names, scheme, method):
    def one(inputs):
        recording, delay = inputs

        def by_theta(theta):
            moved = with_values(scene, names, theta)
            motion = simulate_motion(moved, recording, scheme, method)
            return residual(motion, delay)[0], motion

        def residual(motion, delay):
            return _residual(motion, recording, delay, scene.length)

        by_parameter, motion = jax.jacfwd(by_theta, has_aux=True)(theta)
        by_delay = jax.jacfwd(lambda d: residual(motion, d)[0])(delay)
        r, alignment = residual(motion, delay)
        return Evaluation(r, by_parameter, by_delay, alignment, motion)

    # Batched small matrices gain nothing on a CPU, and each step would wait for the slowest.
    if jax.default_backend() == "cpu":
        return jax.lax.map(one, (batch, delays))
    return jax.vmap(one)((batch, delays))


def _residual(motion: Motion, recording: Batch, delay, length):
    ok = motion.result == sr.RESULTS.successful
    used = recording.used
    tip = tip_at(motion, recording.dt, recording.times - delay)
    missed = jnp.where(used & ok, recording.tip - tip, 0.0)
    moved = jnp.where(ok, tip - motion.positions[0], 0.0)
    alignment = align(moved, missed, used)
    free = recording.free_frame
    alignment = jax.tree.map(lambda x: jnp.where(free, x, 0.0), alignment)
    r = jnp.where(ok, alignment.of(moved) - missed, _FAILED * length)
    return jnp.where(used, r, 0.0), alignment


@jax.jit
def losses_by_delay(motion: Motion, batch: Batch, delays, length):
    """Sums of squares [m^2] at `delays` [s], (recordings, tries): (recordings, tries)."""

    def one(motion, recording, delay):
        return jnp.sum(_residual(motion, recording, delay, length)[0] ** 2)

    return jax.vmap(jax.vmap(one, in_axes=(None, None, 0)), in_axes=(0, 0, 0))(
        motion, batch, delays
    )


@dataclass(frozen=True, eq=False)
class Point:
    """A place in the space of all unknowns, evaluated.

    `x`: theta of the parameters, then the delays in sample intervals; (unknowns,).
    `result`: the worst result code; 0 if every simulation succeeded.
    """

    x: np.ndarray
    evaluation: Evaluation
    problem: "Problem"

    @cached_property
    def residuals(self) -> np.ndarray:
        """(recordings * samples * 3,) [m]."""
        return np.asarray(self.evaluation.residuals).ravel()

    @cached_property
    def jacobian(self) -> np.ndarray:
        """(recordings * samples * 3, unknowns) [m]."""
        by_parameter = np.asarray(self.evaluation.by_parameter)
        columns = [by_parameter.reshape(-1, by_parameter.shape[-1])]
        if self.problem.time_offset:
            by_delay = np.asarray(self.evaluation.by_delay)
            for i, clock in enumerate(self.problem.clocks):
                column = np.zeros_like(by_delay)
                column[i] = by_delay[i] * clock.interval
                columns.append(column.reshape(-1, 1))
        return np.concatenate(columns, axis=1)

    @cached_property
    def loss(self) -> float:
        """Sum of squared residuals [m^2]."""
        return float(np.sum(self.residuals**2))

    @property
    def rms(self) -> float:
        """Root mean square distance between measured and simulated tip [m]."""
        return float(np.sqrt(self.loss / self.problem.samples))

    @property
    def result(self) -> int:
        return int(np.max(np.asarray(self.evaluation.motion.result)))

    @property
    def ok(self) -> bool:
        return self.result == sr.RESULTS.successful and np.isfinite(self.loss)


@dataclass(frozen=True, eq=False)
class Problem:
    """Scene, recordings and what is fitted: from numbers to an evaluated `Point`."""

    scene: sr.Scene
    batch: Batch
    clocks: list[Clock]
    names: tuple[str, ...]
    time_offset: bool
    scheme: sr.SDIRK | sr.BDFAlpha
    method: sr.Collocation

    @cached_property
    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Lowest and highest x."""
        reach = [PARAMETERS[name].largest_theta for name in self.names]
        low, high = [-r for r in reach], list(reach)
        if self.time_offset:
            low += [c.low / c.interval for c in self.clocks]
            high += [c.high / c.interval for c in self.clocks]
        return np.array(low), np.array(high)

    @cached_property
    def samples(self) -> int:
        """Samples with at least one coordinate of the tip."""
        return int(np.sum(np.any(np.asarray(self.batch.used), axis=-1)))

    @cached_property
    def motion_rms(self) -> float:
        """Root mean square distance of the measured tips from their mean [m]."""
        tip = np.where(self.batch.used, self.batch.tip, np.nan)
        about = tip - np.nanmean(tip, axis=1, keepdims=True)
        return float(np.sqrt(np.nansum(about**2) / self.samples))

    def start(self) -> np.ndarray:
        """x at the scene's own values and the first guess of the clocks."""
        return np.zeros(len(self.names) + len(self.clocks) * self.time_offset)

    def delays(self, x) -> np.ndarray:
        """Delays [s], (recordings,)."""
        if not self.time_offset:
            return np.zeros(len(self.clocks))
        return x[len(self.names) :] * np.array([c.interval for c in self.clocks])

    def at(self, x, batch: Batch | None = None) -> Point:
        """Evaluate at `x`, cut to the bounds."""
        x = np.clip(x, *self.bounds)
        batch = self.batch if batch is None else batch
        evaluation = evaluate(
            self.scene,
            batch,
            jnp.asarray(x[: len(self.names)]),
            jnp.asarray(self.delays(x)),
            self.names,
            self.scheme,
            self.method,
        )
        return Point(x, jax.device_get(evaluation), self)

    def values(self, x) -> dict[str, np.ndarray]:
        """The parameters' values at `x`, by name."""
        out = {}
        for name, theta in zip(self.names, x, strict=False):
            parameter = PARAMETERS[name]
            out[name] = np.asarray(parameter.value(parameter.find(self.scene), theta))
        return out

    def fitted_scene(self, x) -> sr.Scene:
        return with_values(self.scene, self.names, jnp.asarray(x[: len(self.names)]))
