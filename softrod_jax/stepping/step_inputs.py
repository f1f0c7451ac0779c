"""The inputs of every step of a motion: from where, to where, and whether they jump."""

import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from softrod_jax.scene.inputs import Inputs, good_inputs, zero_unless


class StepInputs(NamedTuple):
    """Inputs of every step: where each comes from, where it goes, and if it jumps there.

    `good`: whether all can be; in the place of those that cannot are zeros.
    """

    before: Inputs
    now: Inputs
    jumps: Inputs
    good: Bool[Array, "steps"]

    def at(self, progress, rise) -> Inputs:
        """The inputs of one step at `progress` in [0, 1]; those that jump rise within `rise`."""
        risen = jnp.minimum(progress / rise, 1.0)

        def one(before, now, jumps):
            x = jnp.where(jumps, risen, progress)
            return x * now + (1 - x) * before

        return jax.tree.map(one, self.before, self.now, self.jumps)


def inputs_of_steps(
    inputs: Inputs, steps: int, from_rest: bool
) -> tuple[StepInputs, Bool[Array, "steps"]]:
    """Those of every step, and at the beginning of which steps any of them jumps.

    At the first step all do. Before it all are zero, or, where the motion begins in an
    equilibrium, what they are in that step.
    """
    good = good_inputs(inputs) & jnp.ones(steps, dtype=bool)
    inputs = zero_unless(good, inputs)
    jumped = jax.tree.map(jumps, inputs)
    first = lambda x: jnp.zeros_like(x[:1]) if from_rest else x[:1]
    before = jax.tree.map(lambda x: jnp.concatenate([first(x), x[:-1]]), inputs)
    jump = [jnp.any(jump, axis=1) for jump in jax.tree.leaves(jumped)]
    restart = functools.reduce(jnp.logical_or, jump, jnp.arange(steps) == 0)
    return StepInputs(before, inputs, jumped, good), restart


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
