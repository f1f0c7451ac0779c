"""Compiling faster: a rod's program is large, and often runs a few times only."""

import contextlib
import contextvars
import functools
import logging
from collections.abc import Callable

import equinox as eqx
import jax

from softrod_jax.foundation.tracing import is_traced

_LOG = logging.getLogger(__name__)

# XLA's newer code generator for CPUs (jax 0.10) takes twice as long to compile a rod's program,
# which then runs no faster. Its search for what does not change in a loop takes a tenth of the rest
# and makes programs 4 % slower: what it moves out of loops is copied with their state. The options
# are XLA's own and may go away.
_OPTIONS = {
    "xla_cpu_use_fusion_emitters": False,
    "xla_disable_hlo_passes": "while-loop-invariant-code-motion",
}
_LOCKSTEP = contextvars.ContextVar("lockstep", default=False)


def compiled(function: Callable, jit: Callable = eqx.filter_jit) -> Callable:
    """`jit(function)`, in half the time on a CPU where nothing else is being traced.

    As a part of a larger program (under `jit`, `vmap`, `grad`), that program's options hold.
    """
    inside = jit(function)

    @functools.cache
    def outermost():
        return jit(function, compiler_options=compiler_options())

    @functools.wraps(function)
    def call(*args):
        return (inside if is_traced(args) else outermost())(*args)

    return call


@functools.cache
def compiler_options() -> dict | None:
    """`compiler_options` for `jax.jit`, None where this jaxlib or device does not know them."""
    if jax.default_backend() != "cpu":
        return None
    try:
        jax.jit(lambda x: x + 1.0, compiler_options=_OPTIONS)(0.0)
    except RuntimeError as e:  # of which XLA's "No such compile option" is a kind
        _LOG.info("compiling without XLA's options %s, which take less time: %s", list(_OPTIONS), e)
        return None
    return _OPTIONS


def on_cpu() -> bool:
    """Whether programs run on a CPU, where one sample after the other is often the faster way."""
    return jax.default_backend() == "cpu" and not _LOCKSTEP.get()


@contextlib.contextmanager
def in_lockstep():
    """Programs traced here are those for a GPU, wherever they run: to test and to count them."""
    before = _LOCKSTEP.set(True)
    jax.clear_caches()
    try:
        yield
    finally:
        _LOCKSTEP.reset(before)
        jax.clear_caches()
