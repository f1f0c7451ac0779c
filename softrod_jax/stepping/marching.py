"""The march in time: every step of a motion, as one compiled loop, or one step by itself.

A step, from one sample of the inputs to the next, is divided into substeps: into a given number
of equal ones, or into as many as keep the error of each one small.
"""

import dataclasses
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from softrod_jax.bvp.equations import with_loads
from softrod_jax.bvp.method import AbstractMethod
from softrod_jax.bvp.newton import NewtonOptions
from softrod_jax.foundation.results import RESULTS
from softrod_jax.rod.constants import full_strain
from softrod_jax.scene.inputs import Inputs
from softrod_jax.scene.planes import in_space
from softrod_jax.scene.scene import Scene
from softrod_jax.stepping.courses import Courses
from softrod_jax.stepping.moving_rod import Beginning, MovingRod, State, moving_rod
from softrod_jax.stepping.scheme import AbstractTimeScheme
from softrod_jax.stepping.step_inputs import StepInputs, inputs_of_steps
from softrod_jax.stepping.substeps import LocalError, equal_substeps, substeps_by_error
from softrod_jax.stepping.time_error import grown


class March(NamedTuple):
    """What there is at the end of every step: velocities as a user sees them, codes and counts."""

    strains: Float[Array, "steps points n"]
    velocities: Float[Array, "steps outputs m"]
    results: Int[Array, "steps"]
    multipliers: Float[Array, "steps conditions"] | None
    stats: dict
    wrenches: Float[Array, "steps 6"]
    pushes: Float[Array, "steps contacts 3"] | None = None


class Stepping(NamedTuple):
    """How a motion goes on, one step at a time.

    `substeps`: a number, Python's or traced, or a `LocalError`.
    """

    moving: MovingRod
    substeps: int | Int[Array, ""] | LocalError

    def step(self, state: State, coefficients, inputs: StepInputs) -> tuple[State, March]:
        """The state one step later, and what `March` has, of this step.

        `coefficients` of the time scheme in this step; see `AbstractTimeScheme.coefficients`.
        """
        none = jnp.zeros((), jnp.int32), jnp.zeros(())
        progress = state.progress._replace(iterations=none[0], correction=none[1])
        state = State(state.memory, progress)
        if isinstance(self.substeps, LocalError):
            state, count = substeps_by_error(self.moving, self.substeps, inputs, state)
        else:
            state, count = equal_substeps(self.moving, self.substeps, inputs, coefficients, state)
        progress = state.progress._replace(error=self._error(state))
        return State(state.memory, progress), self._seen(state, progress, count)

    def _error(self, state: State) -> Float[Array, ""]:
        """Along the rod, estimated, in lengths."""
        method, layout, progress = self.moving.method, self.moving.layout, state.progress
        guess = progress.guess
        rod = with_loads(self.moving.rod, progress.loads).under(guess.multipliers)
        return method.error_in_motion(guess, rod, layout, progress.history, guess.strain)

    def _seen(self, state: State, progress, count) -> March:
        method, result = self.moving.method, progress.result
        coarse = (result == RESULTS.successful) & (progress.from_grid > method.max_error)
        stats = {
            "iterations": progress.iterations,
            "residual": progress.correction,
            "error": progress.error,
            "substeps": jnp.asarray(count, jnp.int32),
            "time_error": grown(progress.time_error),
        }
        if progress.shaken is not None:
            stats["touch_error"] = progress.shaken.most
        return March(
            state.fields.strain,
            method.outputs(state.fields.velocity),
            jnp.where(coarse, RESULTS.inaccurate, result).astype(jnp.int32),
            progress.multipliers,
            stats,
            in_space(progress.wrench, self.moving.rod.plane),
            progress.pushes,
        )


def stepping_of(
    scene: Scene,
    dt,
    inputs: Inputs,
    substeps,
    scheme: AbstractTimeScheme,
    method: AbstractMethod,
    options: NewtonOptions,
) -> Stepping:
    """The steps of `scene`; `inputs` of any one of them say which actuators there are."""
    if isinstance(substeps, LocalError):
        # A front is rough on any grid. Two grids are compared in the end: that decides.
        method = dataclasses.replace(method, max_error=jnp.inf)
    return Stepping(moving_rod(scene, dt, inputs, scheme, method, options), substeps)


def march(
    stepping: Stepping,
    inputs: Inputs,
    begin: Beginning | None,
    steps: int,
    good,
    courses: Courses = Courses(),
) -> March:
    """Move from rest under `inputs`, one row a step, while base and obstacles take their `courses`.

    `begin`: the unloaded rod if `None`. `good`: whether there can be such a scene; see
    `rod/validity.py`. The first entry of the strains and velocities is that of the beginning.
    """
    moving, substeps = stepping
    start = moving.at_rest(begin, good)
    at_first = None if begin is None else begin.inputs
    step_inputs, restart = inputs_of_steps(inputs, steps, at_first)
    if courses.good is not None:
        can_be = step_inputs.good & courses.good
        step_inputs = step_inputs._replace(courses=courses, good=can_be)
    length = moving.dt if isinstance(substeps, LocalError) else moving.dt / substeps
    coefficients = moving.scheme.coefficients(length, restart)
    _, seen = jax.lax.scan(
        lambda state, row: stepping.step(state, *row), start, (coefficients, step_inputs)
    )
    # An answer that rests on an inaccurate one is inaccurate.
    so_far = jnp.cumsum(seen.results == RESULTS.inaccurate) > 0
    inaccurate = (seen.results == RESULTS.successful) & so_far
    results = jnp.where(inaccurate, RESULTS.inaccurate, seen.results)
    strains = jnp.concatenate([start.fields.strain[None], seen.strains])
    velocities = jnp.concatenate([jnp.zeros_like(seen.velocities[:1]), seen.velocities])
    rod, multipliers, at_first = moving.rod, seen.multipliers, start.progress.multipliers
    if multipliers is not None and at_first is not None:
        multipliers = jnp.concatenate([at_first[None], multipliers])
    pushes, unpushed = seen.pushes, start.progress.pushes
    if pushes is not None and unpushed is not None:
        pushes = jnp.concatenate([unpushed[None], pushes])
    strains, velocities = full_strain(strains, rod), in_space(velocities, rod.plane)
    at_rest = in_space(start.progress.wrench, rod.plane)
    wrenches = jnp.concatenate([at_rest[None], seen.wrenches])
    return March(strains, velocities, results, multipliers, seen.stats, wrenches, pushes)
