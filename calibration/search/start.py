"""Where to start: a sum of squares of a ringing tip has a minimum wherever a period is lost.

First what the recordings tell by themselves: how fast the tip rings gives the modulus to within
a few percent, and a damping under which it could not ring is reduced. Where that does not do, a
coarse search over factors of the modulus and the damping.
"""

import numpy as np

from calibration.experiment.bulk import bulk
from calibration.problem.problem import Point, Problem
from calibration.problem.residuals import losses_by_delay
from calibration.search.progress import Report

# Factors of the coarse search. The tip of a rod that rings for n periods is in phase only within
# 1/n of the right modulus: a ratio of 1.4 does for three periods, beyond which damping helps.
_SEARCH = (
    ("young_modulus", 2.0 ** (np.array([1, -1, 2, -2, 3, -3, 4, -4, 5, -5]) / 2)),
    ("bending_damping", 10.0 ** np.array([-0.5, 0.5, -1, 1, -1.5, 1.5, -2, 2])),
    ("young_modulus", 2.0 ** np.array([0.5, -0.5, 0.25, -0.25])),
    ("young_modulus", 2.0 ** (np.array([6, -6, 7, -7, 8, -8]) / 2)),
)
_DELAYS = 41
# The search ends with what leaves less than this part of the motion.
_GOOD = 0.3
# A tip that is seen to ring is damped less than this part of critically.
_LARGEST_DAMPING_RATIO = 0.15
_LARGEST_STEP = np.log(16.0)
_TRIES = 3


def by_frequency(problem: Problem, first: Point, report: Report) -> np.ndarray:
    """The best of `first` and of places with the measured frequency; evaluates up to four."""
    best = in_time(first)
    modulus, damping = (indices(problem, n) for n in ("young_modulus", "bending_damping"))
    measured = _frequency(problem, np.asarray(problem.batch.tip))
    if measured is None:
        return best[1]
    x, point = first.x.copy(), first
    largest = _largest_damping(problem, x, measured)
    for i in damping:
        excess = np.max(problem.space.parameters.items[i].value(x[i])) / largest
        if excess > 1:
            x[i] -= np.log(excess)
    if np.any(x != first.x):
        point, best = _tried(problem, x, best, report)
    for _ in range(_TRIES if modulus else 0):
        if not point.ok:
            break
        tip = np.asarray(problem.batch.tip) + point.evaluation.residuals[..., :3]
        simulated = _frequency(problem, tip)
        if simulated is None or abs(np.log(measured / simulated)) < 0.01:
            break
        x = point.x.copy()
        x[modulus] += np.clip(2 * np.log(measured / simulated), -_LARGEST_STEP, _LARGEST_STEP)
        point, best = _tried(problem, x, best, report)
    return best[1]


def coarse_search(problem: Problem, first: Point, report: Report) -> np.ndarray:
    """Try factors of the modulus and the damping around `first`, one after the other."""
    best = in_time(first)
    for name, factors in _SEARCH:
        found = indices(problem, name)
        centre = best[1]
        for theta in np.log(factors) if found else ():
            if problem.statistics.explained(best[0], _GOOD):
                return best[1]
            x = centre.copy()
            x[found] += theta
            _, best = _tried(problem, x, best, report)
    return best[1]


def _tried(problem: Problem, x, best, report):
    """The point at x, and the better of it, its clocks set, and `best`: (loss, x)."""
    point = problem.at(x)
    report(point)
    return point, min(best, in_time(point), key=lambda pair: pair[0])


def search_size(problem: Problem) -> int:
    """How many points `coarse_search` evaluates at most."""
    return sum(len(factors) for name, factors in _SEARCH if indices(problem, name))


def indices(problem: Problem, name: str) -> list[int]:
    """Which unknowns are the parameter `name`, of whatever recording."""
    return [i for i, u in enumerate(problem.space.parameters.items) if u.parameter.name == name]


def better(a: Point, b: Point) -> Point:
    return a if a.ok and (a.loss < b.loss or not b.ok) else b


def in_time(point: Point) -> tuple[float, np.ndarray]:
    """Loss and x of the same motion with each recording's clock where it fits best.

    Needs no simulation: the motion is only shifted. The loss is infinite if there is no motion.
    """
    problem, x = point.problem, point.x.copy()
    space = problem.space
    if not point.ok:
        return np.inf, x
    if not space.time_offset:
        return point.loss, x
    low, high = (np.array([getattr(c, k) for c in space.clocks]) for k in ("low", "high"))
    delays = np.linspace(low, high, _DELAYS, axis=1)
    nuisance, motion = space.nuisance(x), point.evaluation.motion
    losses = np.asarray(
        losses_by_delay(motion, problem.batch, nuisance, delays, problem.scene.length)
    )
    best = np.argmin(losses, axis=1)
    rows = np.arange(len(best))
    loss = float(np.sum(losses[rows, best]))
    if loss >= point.misfit:
        return point.loss, x
    x[space.delays] = delays[rows, best] / [c.interval for c in space.clocks]
    return loss + point.loss - point.misfit, x


def _largest_damping(problem: Problem, x, frequency: float) -> float:
    """B_bt [N m^2 s] of the largest damping ratio, zeta = omega B_bt / (2 E I)."""
    stiffness = float(np.max(bulk(problem.fitted_setup(x, 0).scene).EI))
    return 2 * _LARGEST_DAMPING_RATIO * stiffness / (2 * np.pi * frequency)


def _frequency(problem: Problem, tip: np.ndarray) -> float | None:
    """The frequency [Hz] at which the tips (recordings, samples, 3) ring; None if they do not.

    The highest peak of the mean spectrum, from the second period of the record on.
    """
    total, grid = np.zeros(1), None
    times = np.asarray(problem.batch.times)
    for k, clock in enumerate(problem.space.clocks):
        measured = np.all(np.asarray(problem.batch.used)[k, :, :3], axis=1)
        moving = measured & (times[k] >= 0)
        if np.count_nonzero(moving) < 16:
            continue
        t, path = times[k, moving], tip[k, moving]
        even = np.arange(t[0], t[-1], clock.interval)
        path = np.stack([np.interp(even, t, c) for c in path.T], axis=1)
        path = path - np.mean(path, axis=0)
        spectrum = np.abs(np.fft.rfft(np.hanning(len(path))[:, None] * path, 8192, axis=0)) ** 2
        frequencies = np.fft.rfftfreq(8192, clock.interval)
        spectrum = np.where(frequencies > 2 / (even[-1] - even[0]), np.sum(spectrum, axis=1), 0)
        if grid is None:
            grid = frequencies
        total = total + np.interp(grid, frequencies, spectrum / np.max(spectrum))
    if grid is None:
        return None
    peak = int(np.argmax(total))
    # A peak stands out on both sides; a slow drift only falls off.
    return float(grid[peak]) if 0 < peak and total[peak - 1] > 0 else None
