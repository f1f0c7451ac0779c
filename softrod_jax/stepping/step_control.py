"""How short steps in time, and how fine a grid along the rod, a given accuracy needs.

Where no accuracy is asked for, a motion is solved once, and again only if it breaks off or its own
estimates say that it may be wrong by much. Where one is, a motion is solved twice, the second time
with more care in time, and on a finer grid where the estimate along the rod asks for it; their
difference is taken for the error. That holds for stiff, damped and oscillating rods alike, and sees
both kinds of error at once. It fails only if both motions miss an oscillation that is faster than
their steps, and lasts.
"""

import functools
import itertools
import logging
import math
from collections.abc import Callable

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from softrod_jax.bvp.method import AbstractMethod
from softrod_jax.foundation.results import RESULTS
from softrod_jax.rod.constants import Rod
from softrod_jax.rod.reduction import make_rod
from softrod_jax.scene.scene import Scene
from softrod_jax.stepping.scheme import AbstractTimeScheme
from softrod_jax.stepping.substeps import MOST_SUBSTEPS, LocalError

_LOG = logging.getLogger(__name__)

# The limit of the local error in the first try, in tolerances, and how strict it may become. The
# errors of many steps add up, so that it starts below one.
_FIRST_LIMIT, _LAST_LIMIT = 0.1, 1e-6
# The estimated error along the rod, in tolerances, from which on the grid is refined.
_GRID_SHARE = 0.25
# How much stricter the next limit is: as the error asks for, which falls a little slower than the
# limit, within these factors; and how much shorter the longest substep.
_LEAST_STRICTER, _MOST_STRICTER = 8.0, 64.0
_SHORTER = 2.0
# Steps per radian of the slowest bending mode in the first try with equal steps.
_STEPS_PER_RADIAN = 2
# Where no tolerance is given: the lengths of the rod that are kept once steps turn out too long,
# and the estimated error along the rod from which on a finer grid is tried.
_KEPT, _ROUGH = 2e-3, 1e-4
# The estimate of one motion may be too small by this factor. From there up to the limit, this many
# times as many substeps must not move the tip by more than this part of the limit.
_DOUBTFUL, _TIMES, _CONFIRMS = 0.4, 4, 0.3
# A grid is good for a motion that touches where it misses so little of what pushes, in lengths of
# the tip, or where two grids agree on the tip to that.
_AGREE = 3e-3
# Of two motions, the one with this many times as many substeps may confirm the other.
_MORE = 1.25
# Motions with more and more care at most, where no accuracy is asked for; and where the first one
# broke off, or the last one took so few substeps a step that another costs little.
_TRIES, _RESCUES, _FEW = 3, 5, 200
# Where two motions differ by over so many tolerances, small errors grow: what is left of those of
# the grid may, too, and motions on one grid agree on a wrong answer.
_GROWS = 10.0
# A finer grid is of no use where it does not lower that estimate by this: fronts are rough on any.
_SMOOTHER = 0.25
# Where the search for a grid of a motion ends.
_MOST_INTERVALS = 96
# Failures that more care may cure.
_CURABLE = (RESULTS.diverged, RESULTS.max_iterations, RESULTS.inaccurate)
# Those of a whole motion: a step too long may stretch a rod further than it would go.
_BROKEN = (*_CURABLE, RESULTS.no_equilibrium)


def run_within(
    run: Callable,
    scene: Scene,
    dt: float,
    scheme: AbstractTimeScheme,
    method: AbstractMethod,
    fixed_grid: bool,
    *,
    substeps: int,
    tolerance: float,
):
    """`run(substeps, method)` with as much care as an error of `tolerance` lengths takes.

    Returns the trajectory with its errors in `stats`, in lengths of the rod, and with the code
    `inaccurate` where no care that is offered is enough.
    """
    care = _first_care(scene, dt, scheme, substeps, tolerance)
    first = run(care, method)
    _told("at first", first, method)
    last, error, method, agrees = _with_more_care(
        run, scene, first, care, method, fixed_grid, tolerance
    )
    if _solved(last) and not agrees:
        last = _never_twice(last, error, tolerance)
    return _with(last, error, method)


def _with_more_care(
    run, scene, first, care, method, fixed_grid, tolerance, enough=None, rough=None, tries=None
):
    """The last motion, its difference to the one before, its method, and whether they agree.

    `first`: the motion with the `care` and `method` that are given. There are `tries` at most, and
    else as many as there is more care to take. To agree is to differ by `enough` at most, by
    `tolerance` where that is `None`; `rough` is the estimate along the rod from which on a finer
    grid is taken, and else a share of `tolerance`.
    """
    enough = tolerance if enough is None else enough
    rough = _GRID_SHARE * tolerance if rough is None else rough
    last, excess, error, grows = first, 1.0, None, False
    good, good_method = (last if _solved(last) else None), method
    trust = 1.0 if fixed_grid else _DOUBTFUL
    for attempt in itertools.count(1):
        if attempt > 1 and (_is_last(care, tolerance) or _is_enough(attempt, tries, last)):
            break
        before = method
        # Too much of a touch may lie between the points.
        unseen = attempt == 1 and not _missed(last) <= rough
        if not fixed_grid and (unseen or _needs_finer_grid(last, method, rough)):
            method = method.finer()
        # Where the grid was to blame, too, stricter steps than these may be for nothing.
        care = _more_care(care, excess if method == before else 1.0)
        code, last, excess = int(last.result), run(care, method), 1.0
        _told("with more care", last, method)
        if not _solved(last):
            if int(last.result) == code and code not in _CURABLE:
                break  # twice the same answer: there is none
            continue
        if good is not None:
            error = _apart(last, good, scene)
            if not _is_finer(last, good):
                error = np.maximum(error, _stat(last, "time_error"))
            excess = error[-1] / tolerance
            grows |= excess > _GROWS
            agrees, same_grid = error[-1] <= enough, method == good_method
            blind = not fixed_grid and not _missed(last) <= method.max_error
            if agrees and same_grid and (grows or blind):
                finer, error = _on_another_grid(run, last, care, method, scene, error)
                if error[-1] <= enough:
                    return last, error, method, True
                if fixed_grid or 2 * method.intervals > _MOST_INTERVALS:
                    break
                last, method, excess = finer, method.finer(), 1.0
            # A front is rough on any grid, and then only another grid can tell.
            elif agrees and (not same_grid or _is_smooth(last, method, trust)):
                return last, error, method, True
        good, good_method = (last if _solved(last) else good), method
    return last, error, method, False


def _on_another_grid(run, motion, care, method, scene, error):
    """The same on a finer grid, and the error that this shows of `motion`, if it is larger."""
    finer = run(care, method.finer())
    _told("on another grid", finer, method.finer())
    apart = _apart(motion, finer, scene) if _solved(finer) else np.full_like(error, np.inf)
    return finer, np.maximum(error, apart)


def run_checked(
    run: Callable,
    scene: Scene,
    dt: float,
    scheme: AbstractTimeScheme,
    method: AbstractMethod,
    *,
    fixed_grid: bool,
    fixed_steps: bool,
    substeps: int,
    limit: float,
):
    """`run(substeps, method, limit)`, and again where its estimates say that it may be wrong.

    On finer grids until the tip is good to `_ROUGH` lengths. Where the steps in time may be wrong
    by more than `limit` lengths, other motions tell their error; where it is larger and the
    steps are not given (`fixed_steps`), the motion is that with substeps that errors choose.
    """
    once = lambda method: run(_count(substeps), method, _number(limit))
    unjudged = lambda care, method: run(care, method, _number(jnp.inf))
    motion = once(method)
    _told("once", motion, method)
    least = np.zeros_like(_stat(motion, "time_error"))
    if not fixed_grid:
        motion, method = _smoother(once, motion, method)
        if not _sees_touches(motion, limit):
            motion, method, apart, good = _where_it_touches(once, motion, method, scene, limit)
            if _solved(motion) and not good and (apart is None or apart[-1] > limit):
                return _with(_never_twice(motion, apart, limit), apart, method)
            least = least if apart is None else apart
    estimate = float(_stat(motion, "time_error")[-1])
    moving = int(motion.result) in (RESULTS.successful, RESULTS.inaccurate)
    careful = functools.partial(_first_care, scene, dt, scheme, _TIMES * substeps, _KEPT)
    more = lambda fine, care, tries: _with_more_care(
        unjudged, scene, fine, care, method, fixed_grid, *_shown_by(limit), tries
    )
    if not (moving or fixed_steps) and int(motion.result) in _BROKEN:
        _LOG.info("the motion breaks off at step %d: more care is tried", int(motion.failed_step))
        care = careful()
        return _rescued(motion, method, more(unjudged(care, method), care, _RESCUES), limit)
    if not fixed_grid:
        motion = _unless_too_rough(motion, method)
    if not (estimate > _DOUBTFUL * limit and moving and _is_smooth(motion, method)):
        return _with(motion, None, method)
    if estimate <= limit:
        other = unjudged(_count(_TIMES * substeps), method)
        if _solved(other):
            least = np.maximum(least, _apart(motion, other, scene))
            if least[-1] <= _CONFIRMS * limit:
                return _with(motion, None, method)
    judged = lambda error, **more: _judged(_with(motion, error, method, **more), limit)
    _LOG.info(
        "the steps in time may leave an error of %.2g lengths (%.2g allowed): another motion tells",
        estimate,
        limit,
    )
    care = careful()
    fine = unjudged(care, method)
    _told("in substeps that errors choose", fine, method)
    if _solved(fine):
        error = np.maximum(_apart(motion, fine, scene) + _stat(fine, "time_error"), least)
        if error[-1] <= limit:
            return judged(error)
    # Short steps show waves for which the grid of long ones is too coarse.
    found, error, method_found, agrees = more(fine, care, _TRIES)
    if not agrees:
        if not _solved(fine):
            return _with(motion, None, method)  # no other tells more than the estimate does
        # The estimate is contradicted: it may be too small. What is right is not known, but the
        # motion with the most care is the best guess at it.
        error = _stat(motion, "time_error") / _DOUBTFUL
        if _solved(found):
            error = np.maximum(error, _apart(motion, found, scene))
        return judged(error)
    if not fixed_steps:
        return _with(found, error, method_found)
    needed = _count(int(np.max(_stat(found, "substeps"))))
    return judged(_apart(motion, found, scene) + error, needed_substeps=needed)


def _shown_by(limit: float) -> tuple[float, float, float]:
    """Where no accuracy is asked for: the error that is aimed at, what two motions may differ by,
    and the estimate along the rod from which on a finer grid is taken."""
    return _KEPT, _CONFIRMS * limit, _ROUGH


def _rescued(motion, method, more, limit):
    """What becomes of a motion that broke off: the one with more care, if there is one.

    Where more care ends in no equilibrium, that is why, whatever the first motion said.
    """
    found, error, method_found, agrees = more
    if agrees:
        return _with(found, error, method_found)
    if int(found.result) == RESULTS.no_equilibrium:
        return _with(found, error, method_found)
    if not _solved(found):
        return _with(motion, None, method)
    return _with(_never_twice(found, error, limit), error, method_found)


def _never_twice(motion, error, limit: float):
    """A motion that is solved, but never twice the same, with the code that says so."""
    step = 0 if error is None else int(np.argmax(error > min(limit, error[-1])))
    code = jnp.asarray(np.int32(RESULTS.inaccurate))
    return eqx.tree_at(lambda t: (t.result, t.failed_step), motion, (code, _count(step)))


def _told(how: str, motion, method: AbstractMethod) -> None:
    """A motion that was solved, for the log."""
    if not _LOG.isEnabledFor(logging.INFO):
        return
    _LOG.info(
        "the motion %s: %s, %d substeps, %d intervals",
        how,
        RESULTS(int(motion.result)).name,
        np.sum(_stat(motion, "substeps")),
        method.intervals,
    )


def _solved(motion) -> bool:
    return int(motion.result) == RESULTS.successful


def _stat(motion, name: str) -> np.ndarray:
    """As numpy has it: each operation of JAX's here would be a program to compile."""
    return np.asarray(motion.stats[name])


def _apart(motion, other, scene: Scene):
    """How far the tips of two motions have been apart, (steps,), in lengths."""
    tips = np.asarray(motion.tip_positions), np.asarray(other.tip_positions)
    moved = np.linalg.norm(tips[0] - tips[1], axis=-1)[1:]
    return np.maximum.accumulate(moved) / float(scene.length)


def _is_finer(motion, other) -> bool:
    """Whether a motion has clearly more substeps than another: else that they agree says nothing.

    Local errors that are too small to divide a step may still add up.
    """
    count = lambda motion: int(np.sum(_stat(motion, "substeps")))
    return count(motion) >= _MORE * count(other)


def advice(motion, dt: float, limit: float) -> str:
    """What steps to take where those of a motion are too long; empty where they are not."""
    error, needed = float(_stat(motion, "time_error")[-1]), int(motion.stats["needed_substeps"])
    if int(motion.result) != RESULTS.inaccurate or not error > limit:
        return ""
    return (
        f"Here the error in time is estimated at {error:.2g} lengths of the rod: take "
        f"substeps={needed}, or dt={dt / needed:.2g} s. "
    )


def _smoother(run: Callable, motion, method: AbstractMethod):
    """The motion and the method, refined while the estimate along the rod asks for it."""
    roughness = lambda motion: float(np.max(_stat(motion, "error")))
    curable = (RESULTS.successful, RESULTS.inaccurate)
    while roughness(motion) > _ROUGH and int(motion.result) in curable:
        if 2 * method.intervals > _MOST_INTERVALS:
            break
        finer = run(method.finer())
        _told(f"on a finer grid, for an error of {roughness(motion):.2g}", finer, method.finer())
        if int(finer.result) not in curable:
            break
        coarse, motion, method = motion, finer, method.finer()
        if _solved(coarse) and roughness(finer) > _SMOOTHER * roughness(coarse):
            break
    return motion, method


def _unless_too_rough(motion, method: AbstractMethod):
    """The motion, `inaccurate` where no finer grid is left to tell, and its own may be too coarse.

    On coarser ones, what a finer grid hardly changes is a front, and the tip is right.
    """
    rough = _stat(motion, "error") > _DOUBTFUL * method.max_error
    if 2 * method.intervals <= _MOST_INTERVALS or not (_solved(motion) and np.any(rough)):
        return motion
    code, step = jnp.asarray(np.int32(RESULTS.inaccurate)), _count(int(np.argmax(rough)))
    return eqx.tree_at(lambda t: (t.result, t.failed_step), motion, (code, step))


def _missed(motion) -> float:
    """What the grid misses of pushes moves the tip by so many lengths, as estimated."""
    return float(_stat(motion, "touch_error")[-1]) if "touch_error" in motion.stats else 0.0


def _sees_touches(motion, limit: float) -> bool:
    """Whether its grid is good for what it touches, as far as steps that are too long can tell."""
    off = _missed(motion)
    return off == 0.0 or bool(off <= _AGREE and _stat(motion, "time_error")[-1] <= limit)


def _where_it_touches(run: Callable, motion, method: AbstractMethod, scene: Scene, limit: float):
    """The motion and the method, on finer grids until one is good, or two agree on the tip.

    The edge of a touch lies between points of the grid. What a push is off by changes how fast the
    rod leaves, which no strain shows; the estimate of it is often far too large. The third is how
    far the last two are apart, (steps,), in lengths; `None` where there is no other. The last:
    whether the grid is good.
    """
    apart = None
    curable = (RESULTS.successful, RESULTS.inaccurate)  # the latter in time, perhaps
    while int(motion.result) in curable and 2 * method.intervals <= _MOST_INTERVALS:
        finer = run(method.finer())
        _told("on a finer grid, for it touches", finer, method.finer())
        if int(finer.result) not in curable:
            break
        apart = _apart(motion, finer, scene)
        motion, method = finer, method.finer()
        good, moved = _sees_touches(motion, limit), apart[-1]
        if (good and moved <= limit) or (_missed(motion) <= method.max_error and moved <= _AGREE):
            return motion, method, apart, True
    return motion, method, apart, False


def _judged(motion, limit: float):
    """The motion, solved at every step, with the code that its error in time asks for."""
    too_large = _stat(motion, "time_error") > limit
    wrong = bool(too_large[-1])
    code = jnp.asarray(np.int32(RESULTS.inaccurate if wrong else RESULTS.successful))
    step = _count(int(np.argmax(too_large)) if wrong else -1)
    return eqx.tree_at(lambda t: (t.result, t.failed_step), motion, (code, step))


def _first_care(scene, dt, scheme, substeps, tolerance):
    """What to give to `run` for its `substeps` at first: a `LocalError`, or a number."""
    if scheme.one_step:
        return LocalError(_number(_FIRST_LIMIT * tolerance), _number(1 / substeps))
    return _count(max(substeps, _first_substeps(make_rod(scene), dt, tolerance)))


def _number(x: float):
    """An input of the compiled program, with a dtype of its own: one program serves all tries."""
    return jnp.asarray(np.asarray(x, dtype=float))


def _count(x: int):
    """As `_number`. A loop of so many substeps costs 1 % more than a step that is written out."""
    return jnp.asarray(np.asarray(x, dtype=int))


def _more_care(care, excess: float):
    """For an error that is `excess` times the tolerance."""
    if isinstance(care, LocalError):
        # Every substep is shorter: that two motions agree where both have the same ones tells
        # nothing of the error, and a local error that moves nothing yet may be one of speed.
        stricter = np.clip(excess**1.25, _LEAST_STRICTER, _MOST_STRICTER)
        return LocalError(care.limit / stricter, care.longest / _SHORTER)
    return care * (4 if excess > 16 else 2)


def _is_enough(attempt: int, tries: int | None, last) -> bool:
    """Whether no other motion is tried after `last`, where there are `tries` at most."""
    if tries is None or attempt < tries:
        return False
    costs_little = _solved(last) and np.mean(_stat(last, "substeps")) < _FEW
    return attempt >= _RESCUES or not costs_little


def _is_last(care, tolerance) -> bool:
    if isinstance(care, LocalError):
        return bool(care.limit < _LAST_LIMIT * tolerance)
    return bool(2 * care > MOST_SUBSTEPS)


def _first_substeps(rod: Rod, dt: float, tolerance: float) -> int:
    """Equal substeps that resolve the slowest bending mode, unless that is damped out in one step.

    The frequency is that of a cantilever with a tip mass, as a pendulum stiffened by gravity.
    """
    EI, L = float(np.max(rod.K_bt[..., :2])), float(rod.L)
    mass = 0.2427 * float(rod.mass) + (0.0 if rod.payload is None else float(rod.payload))
    elastic = 3 * EI / (L**3 * mass)
    gravity = 0.0 if rod.gravity is None else float(np.linalg.norm(rod.gravity))
    omega = math.sqrt(elastic + 2 * gravity / L)
    damping = 0.0 if rod.B_bt is None else float(np.min(rod.B_bt[..., :2])) / EI
    decay = min(elastic * damping / 2, omega)
    if decay * dt > math.log(1 / tolerance):
        return 1
    return max(1, math.ceil(_STEPS_PER_RADIAN * omega * dt))


def _needs_finer_grid(motion, method: AbstractMethod, rough: float) -> bool:
    if 2 * method.intervals > _MOST_INTERVALS:
        return False
    # One that is not a number is above no limit.
    too_rough = np.max(_stat(motion, "error")) > rough
    return bool(too_rough) or int(motion.result) in _CURABLE


def _is_smooth(motion, method: AbstractMethod, trust: float = 1.0) -> bool:
    """Whether its estimated errors from the grid are within this part of the limit."""
    return not max(np.max(_stat(motion, "error")), _missed(motion)) > trust * method.max_error


def _with(motion, error, method, **more):
    stats = {**motion.stats, "intervals": method.intervals, **more}
    if error is not None:
        stats["time_error"] = error
    return eqx.tree_at(lambda t: t.stats, motion, stats)
