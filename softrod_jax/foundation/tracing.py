"""Whether numbers are known now, or only when a compiled program runs."""

import jax
import jax.numpy as jnp
from jax.core import Tracer


def is_traced(*trees) -> bool:
    """Whether what is computed of these numbers is known only when the program runs.

    So it is where one of them is traced (by `jit`, `vmap`, `grad`), and under `jit` and in the
    loops of `jax.lax` for all that is computed, of constants as well.
    """
    return any(isinstance(x, Tracer) for x in (*jax.tree.leaves(trees), jnp.zeros(())))
