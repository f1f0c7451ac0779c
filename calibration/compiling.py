"""Compiling faster: the simulation's program is large, and a fit runs it a few dozen times."""

from functools import cache

import jax

# XLA's newer code generator for CPUs (jax 0.10) takes two thirds longer to compile the program
# of a fit, which then runs no faster. The option is XLA's own and may go away.
_OPTIONS = {"xla_cpu_use_fusion_emitters": False}


@cache
def compiler_options() -> dict | None:
    """`compiler_options` for `jax.jit`, None where this jaxlib or device does not know them."""
    if jax.default_backend() != "cpu":
        return None
    try:
        jax.jit(lambda x: x + 1.0, compiler_options=_OPTIONS)(0.0)
    except RuntimeError:  # of which XLA's "No such compile option" is a kind
        return None
    return _OPTIONS
