"""How short steps in time, and how fine a grid along the rod, a given accuracy needs.

A motion is solved twice, the second time with more care in time, and on a finer grid where the
estimate along the rod asks for it; their difference is taken for the error. That holds for stiff,
damped and oscillating rods alike, and sees both kinds of error at once. It fails only if both
motions miss an oscillation that is faster than their steps, and lasts.
"""

import math
from typing import Callable

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from softrod_jax.marching import MOST_SUBSTEPS, LocalError
from softrod_jax.method import MOST_INTERVALS, Method
from softrod_jax.results import RESULTS
from softrod_jax.rod import Rod
from softrod_jax.time_schemes import TimeScheme

# The limit of the local error in the first try, in tolerances, and how strict it may become. The
# errors of many steps add up, so that it starts below one.
_FIRST_LIMIT, _LAST_LIMIT = 0.1, 1e-6
# The estimated error along the rod, in tolerances, from which on the grid is refined.
_GRID_SHARE = 0.25
# How much stricter the next limit is: as the error asks for, which falls a little slower than the
# limit, within these factors.
_LEAST_STRICTER, _MOST_STRICTER = 8.0, 64.0
# Steps per radian of the slowest bending mode in the first try with equal steps.
_STEPS_PER_RADIAN = 2
# Failures that more care may cure.
_CURABLE = (RESULTS.diverged, RESULTS.max_iterations, RESULTS.inaccurate)


def run_within(
    run: Callable, rod: Rod, dt: float, scheme: TimeScheme, method: Method, fixed_grid: bool, *,
    substeps: int, tolerance: float,
):
    """`run(substeps, method)` with as much care as an error of `tolerance` lengths takes.

    Returns the trajectory with its errors in `stats`, in lengths of the rod, and with the code
    `inaccurate` where no care that is offered is enough.
    """
    length, care = float(rod.L), _first_care(rod, dt, scheme, substeps, tolerance)
    coarse = run(care, method)
    excess = 1.0
    while True:
        coarse_method = method
        if not fixed_grid and _needs_finer_grid(coarse, method, tolerance):
            method = method.finer()
        # Where the grid was to blame, too, stricter steps than these may be for nothing.
        care = _more_care(care, excess if method == coarse_method else 1.0)
        fine = run(care, method)
        moved = np.linalg.norm(fine.tip_positions - coarse.tip_positions, axis=-1)[1:] / length
        error = np.maximum.accumulate(moved)
        codes = {int(coarse.result), int(fine.result)}
        if codes == {RESULTS.successful} and error[-1] <= tolerance:
            if coarse_method != method or not np.max(fine.stats["error"]) > method.max_error:
                return _with(fine, error, method)
        if len(codes) == 1 and not codes & {RESULTS.successful, *_CURABLE}:
            return _with(fine, error, method)  # twice the same answer: there is none
        if _is_last(care, tolerance):
            break
        solved = codes == {RESULTS.successful}
        coarse, excess = fine, error[-1] / tolerance if solved else 1.0
    if fine.result == RESULTS.successful:
        fine = eqx.tree_at(
            lambda t: (t.result, t.failed_step),
            fine,
            (jnp.array(RESULTS.inaccurate, jnp.int32), jnp.argmax(jnp.array(error) > tolerance)),
        )
    return _with(fine, error, method)


def _first_care(rod, dt, scheme, substeps, tolerance):
    """What to give to `run` for its `substeps` at first: a `LocalError`, or a number."""
    if scheme.one_step:
        return LocalError(jnp.array(_FIRST_LIMIT * tolerance))
    # On the device the number of substeps is an input: one program serves all tries.
    return jnp.array(max(substeps, _first_substeps(rod, dt, tolerance)))


def _more_care(care, excess: float):
    """For an error that is `excess` times the tolerance."""
    if isinstance(care, LocalError):
        return LocalError(care.limit / np.clip(excess**1.25, _LEAST_STRICTER, _MOST_STRICTER))
    return care * (4 if excess > 16 else 2)


def _is_last(care, tolerance) -> bool:
    if isinstance(care, LocalError):
        return bool(care.limit < _LAST_LIMIT * tolerance)
    return bool(2 * care > MOST_SUBSTEPS)


def _first_substeps(rod: Rod, dt: float, tolerance: float) -> int:
    """Equal substeps that resolve the slowest bending mode, unless that is damped out in one step.

    The frequency is that of a cantilever with a tip mass, as a pendulum stiffened by gravity.
    """
    EI, L = float(np.max(rod.K_bt[:2])), float(rod.L)
    mass = 0.2427 * float(rod.rho_A) * L + (0.0 if rod.payload is None else float(rod.payload))
    elastic = 3 * EI / (L**3 * mass)
    gravity = 0.0 if rod.gravity is None else float(np.linalg.norm(rod.gravity))
    omega = math.sqrt(elastic + 2 * gravity / L)
    damping = 0.0 if rod.B_bt is None else float(np.min(rod.B_bt[:2])) / EI
    decay = min(elastic * damping / 2, omega)
    if decay * dt > math.log(1 / tolerance):
        return 1
    return max(1, math.ceil(_STEPS_PER_RADIAN * omega * dt))


def _needs_finer_grid(motion, method: Method, tolerance: float) -> bool:
    if 2 * method.intervals > MOST_INTERVALS:
        return False
    # One that is not a number is above no limit.
    rough = np.max(motion.stats["error"]) > _GRID_SHARE * tolerance
    return bool(rough) or int(motion.result) in _CURABLE


def _with(motion, error, method):
    stats = {**motion.stats, "time_error": error, "intervals": method.intervals}
    return eqx.tree_at(lambda t: t.stats, motion, stats)
