"""How many substeps a motion needs for a given accuracy: by solving it twice, and comparing.

The difference of two solutions is an estimate of the error that holds for stiff, damped and
oscillating rods alike. It fails only if both miss an oscillation that is faster than their
steps and lasts; so the first try resolves the slowest bending mode, unless that is damped out
within a step.
"""

import math
from typing import Callable

import numpy as np

from softrod_jax.results import RESULTS
from softrod_jax.rod import Rod

# Steps per radian of the slowest bending mode in the first try.
_STEPS_PER_RADIAN = 2
# The difference to half as many substeps, over this, is taken for the error: an asymptotic
# 2^order - 1 with a safety factor of 4.
_SAFETY = 4.0
# Failures that shorter steps may cure, and how many times shorter they are tried.
_RETRY, _RETRIES = (RESULTS.diverged, RESULTS.max_iterations), 4


def first_substeps(rod: Rod, dt: float, tolerance: float) -> int:
    """Substeps of the first try, for steps of `dt` [s] and an error of `tolerance` lengths.

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


def refine_in_time(
    run: Callable, first: int, order: int, length: float, tolerance: float, most: int
):
    """`run(substeps)` with as many substeps as an error of `tolerance` lengths takes.

    Returns the trajectory, its substeps, the estimated error of the tip at each step in lengths
    of the rod, (steps,), and a result code.
    """
    substeps = first
    coarse = run(substeps)
    while True:
        substeps *= 2
        fine = run(substeps)
        solved = fine.result == RESULTS.successful and coarse.result == RESULTS.successful
        moved = np.linalg.norm(fine.tip_positions - coarse.tip_positions, axis=-1)[1:] / length
        error = np.maximum.accumulate(moved) * min(1.0, _SAFETY / (2**order - 1))
        if solved and error[-1] <= tolerance:
            return fine, substeps, error, RESULTS.successful
        result = RESULTS(int(fine.result))
        retry = result in _RETRY and substeps <= _RETRIES * first
        if 2 * substeps > most or not (retry or result == RESULTS.successful):
            return fine, substeps, error, result or RESULTS.inaccurate
        coarse = fine
