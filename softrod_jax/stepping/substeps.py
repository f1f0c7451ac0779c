"""How a step is divided into substeps: into equal ones, or as their errors ask for."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from softrod_jax.foundation.results import RESULTS
from softrod_jax.rod.grid import Grid
from softrod_jax.rod.state import Layout
from softrod_jax.stepping.moving_rod import Fields, MovingRod, State
from softrod_jax.stepping.step_inputs import StepInputs

# Substeps of one step at most, and the shortest one, where errors choose them.
MOST_SUBSTEPS, _SHORTEST = 4096, 1e-7
# A substep in which a wave runs this part of the way from point to point need not be shorter: what
# error it has is that of the grid, and another grid tells. Much shorter ones do harm: symmetric
# collocation says nothing of how strains that alternate from point to point change with time.
_RUN = 0.5
# How a substep's length follows from the error of the one before: a little cautiously, and by
# these factors at most. After a substep that has no solution: by the last one.
_CAUTION, _LEAST, _MOST, _AFTER_FAILURE = 0.9, 0.2, 4.0, 0.25


class LocalError(NamedTuple):
    """Substeps as short as it takes: each moves the tip wrongly by `limit` lengths at most.

    `longest`: of a substep, in steps.
    """

    limit: Float[Array, ""]
    longest: Float[Array, ""]


def equal_substeps(
    moving: MovingRod, substeps, inputs: StepInputs, coefficients, state: State
) -> tuple[State, int | Int[Array, ""]]:
    """A step in so many equal parts; the first has these `coefficients` of the time scheme."""
    # Inputs jump at the beginning of a step only.
    no_jump = moving.scheme.coefficients(moving.dt / substeps, jnp.zeros(1, dtype=bool))[0]

    def one(k, state):
        here = jnp.where(k == 0, coefficients, no_jump)
        return moving.substep(inputs, k / substeps, 1 / substeps, here, state)[0]

    if isinstance(substeps, int) and substeps == 1:
        return moving.substep(inputs, 0.0, 1.0, coefficients, state)[0], 1
    return jax.lax.fori_loop(0, substeps, one, state), substeps


def substeps_by_error(
    moving: MovingRod, care: LocalError, inputs: StepInputs, state: State
) -> tuple[State, Int[Array, ""]]:
    """A step in parts with as much `care`, and their number.

    A substep whose error is too large, or which has no solution, is repeated, shorter.
    """

    def goes_on(loop):
        (_, progress), done, count = loop
        unsolved = progress.result != RESULTS.successful
        return (done < 1.0) & (count < MOST_SUBSTEPS) & ~unsolved

    def attempt(loop):
        state, done, count = loop
        state, accepted_part = _attempt(moving, care, inputs, state, done)
        return state, done + accepted_part, count + 1

    (memory, progress), done, count = jax.lax.while_loop(
        goes_on, attempt, (state, jnp.zeros(()), jnp.zeros((), jnp.int32))
    )
    unfinished = (progress.result == RESULTS.successful) & (done < 1.0)
    result = jnp.where(unfinished, RESULTS.inaccurate, progress.result).astype(jnp.int32)
    return State(memory, progress._replace(result=result)), count


def _attempt(moving: MovingRod, care: LocalError, inputs: StepInputs, state: State, done):
    """One substep from `done` on: the state, and its part of the step, 0 if it was rejected."""
    shortest = _RUN * moving.crossing
    longest = jnp.maximum(care.longest, jnp.minimum(shortest, 1.0))
    before = state.progress._replace(part=jnp.minimum(state.progress.part, longest))
    # Not a sliver at the end of the step.
    part = jnp.where(done + 1.05 * before.part >= 1.0, 1.0 - done, before.part)
    coefficients = moving.scheme.coefficients(part * moving.dt, jnp.zeros(1, dtype=bool))[0]
    new, errors = moving.substep(inputs, done, part, coefficients, state)
    shift = tip_shift(errors.lower, errors.of_integral, moving.grid, moving.layout) / care.limit
    tried = new.progress
    solved = tried.result == RESULTS.successful
    ok = solved & ((shift <= 1.0) | (part <= 1.01 * shortest))
    factor = _CAUTION * jnp.maximum(shift, 1e-12) ** (-1 / moving.scheme.order)
    next_part = jnp.where(
        solved,
        jnp.maximum(part * jnp.clip(factor, _LEAST, _MOST), jnp.minimum(part, shortest)),
        part * _AFTER_FAILURE,
    )
    too_short = next_part < jnp.maximum(_SHORTEST, shortest / 64)
    hopeless = (~solved & too_short) | (tried.result == RESULTS.bad_input)
    memory, kept = jax.tree.map(lambda a, b: jnp.where(ok, a, b), new, state)
    after = kept._replace(
        # A substep cut short by the end of the step says little of the next one.
        part=jnp.where(ok & (part < before.part), before.part, next_part),
        iterations=tried.iterations,
        result=jnp.where(hopeless, tried.result, before.result),
    )
    return State(memory, after), jnp.where(ok, part, 0.0)


def tip_shift(error: Fields, of_integral: Fields, grid: Grid, layout: Layout) -> Float[Array, ""]:
    """How far local errors in time move the tip, in lengths of the rod.

    The tip is the integral of the strains along the rod, and of its velocity over time. The one
    takes a wave front between two points of the grid for an error of the step, and the other a
    vibration that the step damps out: the smaller is right.
    """
    arm = 1 - grid.s[:, None] / grid.length
    stretch, bend = layout.split_strain(error.strain)
    along_rod = jnp.linalg.norm(grid.length * grid.mean(arm * bend))
    if stretch is not None:
        along_rod = jnp.linalg.norm(grid.mean(stretch)) + along_rod
    moved = of_integral.velocity[-1, : layout.vector]
    return jnp.minimum(along_rod, jnp.linalg.norm(moved) / grid.length)
