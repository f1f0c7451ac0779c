"""How far a simulated motion is from what was measured, as the recording's clock and sensor see it.

None of this needs a simulation: a motion that is there is compared at other delays, or in another
frame, for next to nothing.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

import softrod_jax as sr
from calibration.data.quantities import numbers_of
from calibration.experiment.alignment import Alignment, align
from calibration.experiment.quantities import aligned, apart
from calibration.problem.batch import Batch
from calibration.problem.motion import Motion, others_at, tip_at

# A residual of a simulation that failed, in rod lengths: worse than any motion of the rod.
_FAILED = 10.0


def residual(
    motion: Motion, recording: Batch, nuisance, length, frame: Alignment | None = None
) -> tuple[Float[Array, "samples all"], Alignment]:
    """Residuals of one recording, simulated minus measured, and what aligned the two: of the tip
    [m], then of what else was measured.

    Where the recording's own frame is free, it is the one that fits best, or `frame`. For the
    nuisance parameters see `calibration.problem.evaluation.evaluate`.
    """
    ok = motion.result == sr.RESULTS.successful
    used = recording.used[:, :3]
    times = recording.times - nuisance["delay"]
    if "clock" in nuisance:
        times = times - recording.ramps["clock"] @ nuisance["clock"][:, 0]
    tip = seen = tip_at(motion, recording.dt, times)
    if "tip" in nuisance:
        seen = tip + recording.ramps["tip"] @ nuisance["tip"]
    moved = jnp.where(ok, tip - motion.positions[0], 0.0)
    missed = jnp.where(used & ok, recording.tip - seen, 0.0)
    alignment = align(moved, missed, recording.weights[:, :3]) if frame is None else frame
    free = recording.free_frame
    alignment = jax.tree.map(lambda x: jnp.where(free, x, 0.0), alignment)
    r = jnp.where(ok, alignment.of(moved) - missed, _FAILED * length)
    r = jnp.where(used, r, 0.0)
    if recording.keys:
        # One that failed is bad enough by its tip.
        beside = _beside(others_at(motion, recording.dt, times), motion, recording, alignment)
        beside = jnp.where(recording.used[:, 3:] & ok, beside, 0.0)
        r = jnp.concatenate([r, beside], axis=1)
    return r, alignment


def _beside(simulated, motion: Motion, recording: Batch, alignment: Alignment):
    """Of what else was measured simulated minus measured, (samples, numbers)."""
    start, parts = motion.positions[0], []
    for key, own in numbers_of(recording.keys).items():
        there = aligned(simulated[:, own], key, alignment, start)
        parts.append(apart(there, recording.others[:, own], key))
    return jnp.concatenate(parts, axis=1)


@jax.jit
def losses_by_delay(motion: Motion, batch: Batch, nuisance, delays, length, frame=None):
    """Sums of squares [m^2] at `delays` [s], both (recordings, tries).

    The other nuisance parameters are as they are. The delays are tried one after the other: a long
    log has no room for all at once.
    """

    def of_one(arguments):
        motion, recording, nuisance, delays = arguments

        def at(delay):
            seen = {**nuisance, "delay": delay}
            r, _ = residual(motion, recording, seen, length, frame)
            return jnp.sum((recording.weights * r) ** 2)

        return jax.lax.map(at, delays)

    return jax.lax.map(of_one, (motion, batch, nuisance, delays))


@jax.jit
def residuals_in(motion: Motion, batch: Batch, nuisance, length, frame: Alignment):
    """Residuals of all recordings, (recordings, samples, all), and their alignments, seen in
    `frame` where their own is free."""
    one = lambda motion, recording, own: residual(motion, recording, own, length, frame)
    return jax.vmap(one)(motion, batch, nuisance)
