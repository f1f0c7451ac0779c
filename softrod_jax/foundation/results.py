"""Result codes: what a solve says about its answer, one integer a sample.

`RESULTS.successful` is 0. Every other code means that the numbers beside it are the last
iterate, not a solution; the message says what to do about it.
"""

from enum import IntEnum

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer


class RESULTS(IntEnum):
    """Codes of `StaticSolution.result`, `Trajectory.result` and `InverseSolution.result`."""

    successful = 0
    no_equilibrium = 1
    diverged = 2
    max_iterations = 3
    bad_input = 4
    inaccurate = 5
    unreachable = 6


# What happened, and what to do about it in Python.
_MESSAGES = {
    RESULTS.successful: ("successful", ""),
    RESULTS.no_equilibrium: (
        "no smooth equilibrium: along a stretch of the rod the loads press a tendon path, or the "
        "rod itself, to nothing",
        "lower the tensions, the suction or the other loads along the rod, or raise young_modulus",
    ),
    RESULTS.diverged: (
        "Newton's method found no way on, nor did a continuation in the load or the time step",
        "take a smaller dt, or smaller loads",
    ),
    RESULTS.max_iterations: (
        "Newton's method did not converge in the iterations allowed",
        "raise max_iterations, or take a smaller dt",
    ),
    RESULTS.bad_input: (
        "an input or a number of the scene cannot be: it is not finite or out of its range, or so "
        "large or small that stiffness or mass has no float, or a "
        "tension is negative (a tendon can only pull), or the scene has a plane and something in "
        "it is not in that plane",
        "",
    ),
    RESULTS.inaccurate: (
        "the estimated error of the tip is too large: the grid along the rod is too coarse or, in "
        "a motion whose time_error is large, the steps in time are too long",
        "take more intervals, or shorter steps along the rod, or in time a smaller dt or more "
        "substeps; with a tolerance: no steps and grid on offer keep it; take a larger one, or "
        "loads that change less suddenly",
    ),
    RESULTS.unreachable: (
        "the target is out of reach within the limits: the inputs are those of the nearest point "
        "found",
        "widen the limits, or take that point",
    ),
}


class SolveError(RuntimeError):
    """Raised at the outermost call when a solve fails and `throw=True`."""


def result_message(code, remedy: str | None = None) -> str:
    """The message of a result code ("successful" for 0), with this remedy if one is given."""
    what, usual = _MESSAGES[RESULTS(int(code))]
    remedy = usual if remedy is None else remedy
    return f"{what}; {remedy}" if remedy else what


def raise_unless_successful(result, values, who: str, hint: str = ""):
    """`values`, or an error if any sample of `result` failed; `hint`: what to do about it.

    Raises `SolveError` where the codes are concrete. Under `jit` the check is compiled in and
    raises when the program runs.
    """
    if isinstance(result, Tracer):
        for code in RESULTS:
            if code != RESULTS.successful:
                message = f"{who}: {result_message(code)}. Pass throw=False for a code per sample."
                values = eqx.error_if(values, jnp.any(result == code), message)
        return values
    codes = np.asarray(result)
    if np.any(codes != 0):
        failed = codes[codes != 0]
        which = "" if codes.ndim == 0 else f" {failed.size} of {codes.size} samples failed;"
        raise SolveError(
            f"{who}:{which} {result_message(failed.flat[0])}. {hint}"
            "Pass throw=False for a code per sample."
        )
    return values


def without_derivative(failed, values):
    """`values` which, where a sample has failed, do not depend on anything."""
    held = lambda x: jnp.where(failed, jax.lax.stop_gradient(x), x)
    return jax.tree.map(lambda x: held(x) if eqx.is_inexact_array(x) else x, values)
