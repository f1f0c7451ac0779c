"""The inputs of every step of a motion: from where, to where, and whether they jump."""

import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from softrod_jax.scene.inputs import KINDS, Inputs, good_inputs, zero_unless
from softrod_jax.stepping.courses import Courses


class StepInputs(NamedTuple):
    """Inputs of every step: where each comes from, where it goes, and if it jumps there.

    `good`: whether all can be; in the place of those that cannot are zeros. `courses`: of what is
    carried.
    """

    before: Inputs
    now: Inputs
    jumps: Inputs
    good: Bool[Array, "steps"]
    courses: Courses = Courses()

    def at(self, progress, rise) -> Inputs:
        """The inputs of one step at `progress` in [0, 1]; those that jump rise within `rise`."""
        risen = jnp.minimum(progress / rise, 1.0)

        def one(before, now, jumps):
            x = jnp.where(jumps, risen, progress)
            return x * now + (1 - x) * before

        return jax.tree.map(one, self.before, self.now, self.jumps)


def inputs_of_steps(
    inputs: Inputs, steps: int, at_first: Inputs | None
) -> tuple[StepInputs, Bool[Array, "steps"]]:
    """Those of every step, and at the beginning of which steps any of them jumps.

    At the first step all do. Before it all are zero or, where the motion begins in an equilibrium,
    what `at_first` says and, where that says nothing, what they are in that step. What cannot jump
    is linear in every step.
    """
    good = good_inputs(inputs) & jnp.ones(steps, dtype=bool)
    inputs = zero_unless(good, inputs)
    jumped = jax.tree.map(jumps, inputs)

    def before(rows, first):
        if at_first is None:
            first = jnp.zeros_like(rows[0])
        return jnp.concatenate([rows[:1] if first is None else first[None], rows[:-1]])

    begins = Inputs() if at_first is None else at_first
    earlier = [None if x is None else before(x, first) for x, first in zip(inputs, begins)]
    jump = [jnp.any(jump, axis=1) for jump in jax.tree.leaves(jumped)]
    restart = functools.reduce(jnp.logical_or, jump, jnp.arange(steps) == 0)
    return StepInputs(Inputs(*earlier), inputs, without_places(jumped), good), restart


def without_places(jumped: Inputs) -> Inputs:
    """Which inputs jump, of those that can: an actuator's place moves."""
    each = zip(KINDS, jumped, strict=True)
    still = lambda x: jax.tree.map(jnp.zeros_like, x)
    return Inputs(*(still(x) if kind.is_place else x for kind, x in each))


def jumps(inputs: Float[Array, "steps channels"]) -> Bool[Array, "steps channels"]:
    """Where an input jumps at the beginning of a step; at the first, all do.

    A jump changes an input by over 2 % of its range, and by over three times as much as the
    steps before and after it do: samples of a ramp, however steep, are not jumps.
    """
    if inputs.shape[0] == 1:
        return jnp.ones(inputs.shape, dtype=bool)
    change = jnp.abs(jnp.diff(inputs, axis=0))
    range_ = jnp.max(inputs, axis=0) - jnp.min(inputs, axis=0)
    edge = jnp.zeros_like(change[:1])
    before, after = jnp.concatenate([edge, change[:-1]]), jnp.concatenate([change[1:], edge])
    jump = (change > 3 * jnp.maximum(before, after)) & (change > 0.02 * range_)
    return jnp.concatenate([jnp.ones_like(jump[:1]), jump])
