"""Time schemes: how `y_t = c0 y + y_h` follows from earlier steps.

A scheme turns one time step into one or more solves along the rod, each with its own `c0` and
history `y_h`. What it advances is a pytree of fields (strains and velocities at the points of
the method along the rod), so that the history is kept at the order of that method.
"""

import abc
from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float


def combine(*terms):
    """The sum of coefficient * tree over `terms` of (coefficient, tree)."""
    first, *rest = [jax.tree.map(lambda x, c=c: c * x, tree) for c, tree in terms]
    for term in rest:
        first = jax.tree.map(jnp.add, first, term)
    return first


class LocalErrors(NamedTuple):
    """Estimates of the errors that one step makes in the fields; each like the fields, or `None`.

    - `lower`: the difference to a scheme of lower order.
    - `of_integral`: as `lower`, of the integrals of the fields over time.
    - `difference`: of the rates in the step, of an order as high as that of the error. In an
      oscillation of any frequency it is about as large as the error, or larger.
    """

    lower: Any = None
    of_integral: Any = None
    difference: Any = None


class AbstractTimeScheme(eqx.Module):
    """`start` makes a memory from the initial fields, `step` advances it.

    The memory is a tuple; its first entry is the fields at the end of the step.

    `one_step`: whether steps may differ in length from one to the next.
    """

    stages: eqx.AbstractVar[int]
    order: eqx.AbstractVar[int]
    one_step: eqx.AbstractVar[bool]

    @abc.abstractmethod
    def coefficients(self, dt, restart: Bool[Array, "steps"]) -> Float[Array, "steps _"]:
        """Coefficients of every step, (steps, ...): what `step` gets row by row.

        `restart`: whether an input jumps at the beginning of the step.
        """

    @abc.abstractmethod
    def start(self, y, guess) -> tuple:
        """Memory of a rod at rest with the fields `y`; `guess`: of Newton's method there."""

    @abc.abstractmethod
    def step(self, memory, coefficients, solve: Callable, carry) -> tuple[tuple, Any, LocalErrors]:
        """One step: `solve(c0, y_h, at, carry) -> (y, carry)` for each stage in turn.

        `at`, in (0, 1]: the time of the stage in the step. `carry` is a named tuple; its field
        `guess` is the last solution, and where Newton's method starts. Returns the memory and
        the carry after the step, and its `LocalErrors`; those of a `one_step` scheme have
        `lower` and `of_integral`.
        """
