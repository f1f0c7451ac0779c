"""How fine a grid along the rod a given accuracy needs: the estimated error says when to refine.

Only calls that nobody compiles into a larger program can do that: the number of intervals is part
of the program.
"""

import logging
import math
from collections.abc import Callable

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from softrod_jax.bvp.method import AbstractMethod
from softrod_jax.foundation.results import RESULTS
from softrod_jax.scene.scene import Scene

_LOG = logging.getLogger(__name__)

# Lengths of the rod within which an answer is sought where nothing else is said.
DEFAULT_TOLERANCE = 1e-4
# Where the search for a grid ends.
MOST_INTERVALS = 768
# Turns of the unloaded rod that one interval may hold [rad].
_TURN = 1.0
# A search that failed is tried once more with this many times as many intervals.
_AFTER_FAILURE = 4
_FAILURES = (RESULTS.diverged, RESULTS.max_iterations)


def first_grid(method: AbstractMethod, scene: Scene) -> AbstractMethod:
    """`method`, refined so far that the unloaded rod's own curvature is seen."""
    if scene.rest_curvature is None:
        return method
    turn = float(np.linalg.norm(scene.rest_curvature)) * float(scene.length)
    needed = turn / _TURN
    while method.intervals < needed and 2 * method.intervals <= MOST_INTERVALS:
        method = method.finer()
    return method


def solve_within(solve: Callable, method: AbstractMethod, tolerance: float):
    """`solve(method)` on a grid so fine that the estimated error is below `tolerance`.

    Returns the solution, with the code `inaccurate` where no grid on offer is fine enough.
    """
    solution, failures = solve(method), 0
    while True:
        code, error = int(solution.result), float(solution.stats["error"])
        if code in _FAILURES:
            failures += 1
        solved = code in (RESULTS.successful, RESULTS.inaccurate)
        if failures > 1 or not (solved or code in _FAILURES):
            return solution
        if code == RESULTS.successful and error <= tolerance:
            return solution
        factor = _factor(error / tolerance, method.order) if solved else _AFTER_FAILURE
        finer = _times(method, factor)
        _LOG.info(
            "%d intervals along the rod: %s, error %.2g lengths (%.2g allowed); next %s",
            method.intervals,
            RESULTS(code).name,
            error,
            tolerance,
            "none, it is the finest grid" if finer == method else finer.intervals,
        )
        if finer == method:
            return _inaccurate(solution) if solved else solution
        method = finer
        solution = solve(method)


def needed_intervals(error, method: AbstractMethod, tolerance: float = DEFAULT_TOLERANCE):
    """How many intervals an error of `tolerance` takes if this many leave `error`."""
    more = jnp.maximum(error / tolerance, 1.0) ** (1 / method.order)
    return jnp.ceil(jnp.minimum(more, MOST_INTERVALS) * method.intervals).astype(jnp.int32)


def _factor(excess: float, order: int) -> int:
    """By how much to refine, a power of two; an error that is no number says little."""
    if not 0 < excess < math.inf:
        return 2
    return 2 ** max(1, math.floor(math.log2(excess) / order))


def _times(method: AbstractMethod, factor: int) -> AbstractMethod:
    while factor > 1 and 2 * method.intervals <= MOST_INTERVALS:
        method, factor = method.finer(), factor // 2
    return method


def _inaccurate(solution):
    code = jnp.array(int(RESULTS.inaccurate), jnp.int32)
    return eqx.tree_at(lambda x: x.result, solution, code)
