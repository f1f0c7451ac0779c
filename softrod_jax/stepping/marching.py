"""The march in time: every step of a motion, as one compiled loop, or one step by itself.

A step, from one sample of the inputs to the next, is divided into substeps: into a given number
of equal ones, or into as many as keep the error of each one small.
"""

import dataclasses
import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from softrod_jax.bvp.boundary_value import (
    Equations,
    loads_of,
    scaled_loads,
    slow_unless,
    solve_boundary_value,
    with_loads,
)
from softrod_jax.bvp.method import Guess
from softrod_jax.bvp.newton import Borrowed, no_factors
from softrod_jax.bvp.unloaded import unloaded_guess
from softrod_jax.foundation.results import RESULTS
from softrod_jax.rod.constants import Rod, fastest_wave, full_strain, inner_strain, make_rod
from softrod_jax.rod.grid import Grid
from softrod_jax.rod.ode import History, Layout, layout_of
from softrod_jax.scene.inputs import good_inputs, zero_unless
from softrod_jax.scene.planes import in_space
from softrod_jax.stepping.inertial_continuation import Before, search_by_inertia
from softrod_jax.stepping.schemes import jumps
from softrod_jax.stepping.time_error import accumulated, grown

# Substeps of one step at most, and the shortest one, where errors choose them.
MOST_SUBSTEPS, _SHORTEST = 4096, 1e-7
# A substep in which a wave runs this part of the way from point to point need not be shorter: what
# error it has is that of the grid, and another grid tells. Much shorter ones do harm: symmetric
# collocation says nothing of how strains that alternate from point to point change with time.
_RUN = 0.5
# How a substep's length follows from the error of the one before: a little cautiously, and by
# these factors at most. After a substep that has no solution: by the last one.
_CAUTION, _LEAST, _MOST, _AFTER_FAILURE = 0.9, 0.2, 4.0, 0.25
# The factors of a Jacobian serve the next solve, too, where corrections fell this fast with them.
# Of 0.02 to 0.2 the fastest on the paper's rod, with new factors 9 times as dear as a correction.
_LEND = 0.05


class LocalError(NamedTuple):
    """Substeps as short as it takes: each moves the tip wrongly by `limit` lengths at most."""

    limit: Float[Array, ""]


class Fields(NamedTuple):
    """What has a history: strains (v, u) and velocities (q, omega), (points, 6) each."""

    strain: Float[Array, "points 6"]
    velocity: Float[Array, "points 6"]


class Beginning(NamedTuple):
    """The equilibrium in which a motion begins, and its result code."""

    strain: Float[Array, "points 6"]
    result: Int[Array, ""]


class Stepping(NamedTuple):
    """How a motion begins and goes on; its state is (memory of the time scheme, `Running`).

    `start()`: the state before the first step. `step(state, (coefficients, course))`: the state
    after it and, of this step, what `March` has of all; `course`: a row of a `Course`. Strains and
    velocities are those that are unknown in `rod`.
    """

    start: Callable
    step: Callable
    rod: Rod


class March(NamedTuple):
    """Of every step: fields at its end, velocities as a user sees them, codes and counts."""

    strains: Float[Array, "steps points 6"]
    velocities: Float[Array, "steps outputs 6"]
    results: Int[Array, "steps"]
    stats: dict


class Running(NamedTuple):
    """What a substep hands to the next, besides the memory of the time scheme.

    `loads` and `history`: those of the last solve; `rate`: that of the strains there; `factors`
    of the last Jacobian, made with `c0`. `part`: the length of the next substep, in steps,
    where errors choose it. `time_error`: estimated, of the tip so far, in lengths.
    """

    guess: Guess
    loads: list
    rate: Float[Array, "points 6"]
    history: History
    factors: Any
    c0: Float[Array, ""]
    result: Int[Array, ""]
    iterations: Int[Array, ""]
    correction: Float[Array, ""]
    error: Float[Array, ""]
    part: Float[Array, ""]
    time_error: Float[Array, ""]


def march(scene, dt, inputs, begin, steps, substeps, scheme, method, options, good) -> March:
    """Move `scene` from rest under `inputs`, (tensions, pressures) as in `simulate`.

    `begin`: a `Beginning`, the unloaded rod if `None`. `substeps`: a number, Python's or traced,
    or a `LocalError`. `good`: whether there can be such a scene; see `rod/validity.py`.
    """
    first = jax.tree.map(lambda x: x[0], inputs)
    stepping = make_stepping(scene, dt, first, begin, substeps, scheme, method, options, good)
    start = stepping.start()
    course, restart = _course(inputs, steps, from_rest=begin is None)
    length = dt if isinstance(substeps, LocalError) else dt / substeps
    coefficients = scheme.coefficients(length, restart)
    _, (strains, velocities, results, stats) = jax.lax.scan(
        stepping.step, start, (coefficients, course)
    )
    # An answer that rests on an inaccurate one is inaccurate.
    so_far = jnp.cumsum(results == RESULTS.inaccurate) > 0
    inaccurate = (results == RESULTS.successful) & so_far
    results = jnp.where(inaccurate, RESULTS.inaccurate, results)
    strains = jnp.concatenate([start[0][0].strain[None], strains])
    velocities = jnp.concatenate([jnp.zeros_like(velocities[:1]), velocities])
    rod = stepping.rod
    return March(full_strain(strains, rod), in_space(velocities, rod.plane), results, stats)


def make_stepping(scene, dt, actuation, begin, substeps, scheme, method, options, good) -> Stepping:
    """The steps of `march`, one at a time.

    `actuation`, (tensions, pressures) of any step, says which actuators there are.
    """
    if isinstance(substeps, LocalError):
        # A front is rough on any grid. Two grids are compared in the end: that decides.
        method = dataclasses.replace(method, max_error=jnp.inf)
    grid = method.grid(scene)
    spacing = grid.widest

    def rod_under(tau, pressure):
        return make_rod(scene, tau, pressure, grid=grid, spread_fronts=True)

    rod = rod_under(*zero_unless(good_inputs(*actuation), actuation))
    layout = layout_of(rod, dynamic=True)
    guess = unloaded = unloaded_guess(layout, rod)
    first_code = jnp.where(good, RESULTS.successful, RESULTS.bad_input).astype(jnp.int32)
    if begin is not None:
        begun = good & jnp.all(jnp.isfinite(begin.strain))
        inner = jnp.where(begun, inner_strain(begin.strain, rod), guess.strain)
        guess = guess._replace(strain=inner)
        first_code = jnp.where(good, begin.result, first_code)
    still = jnp.zeros((*guess.strain.shape[:-1], layout.pair))
    fields = Fields(guess.strain, still)

    # No grid holds a front that is thinner than its points are apart: what jumps rises while a wave
    # runs half of that distance, or in a step if that is shorter.
    wave_speed = fastest_wave(rod)
    crossing = spacing / (wave_speed * dt)
    rise, shortest = jnp.minimum(0.5 * crossing, 1.0), _RUN * crossing

    def substep(course, first, part, coefficients, state):
        """The part [first, first + part] of a step, and its local errors."""
        memory, running = state

        def solve(c0, history, at, running):
            # Not above 1 by rounding: a tension that falls to zero would become negative.
            progress = jnp.minimum(first + at * part, 1.0)
            rod = rod_under(*course.at(progress, rise))
            # After a failure, an unloaded rod at rest costs a batch no iterations.
            alive = running.result == RESULTS.successful
            rod = scaled_loads(rod, jnp.where(alive, 1.0, 0.0))
            usable = alive & (running.c0 == c0)
            history = slow_unless(alive, History(c0, history.strain, history.velocity))
            solved = solve_boundary_value(
                method,
                layout,
                options,
                rod,
                history,
                jax.tree.map(lambda a, b: jnp.where(alive, a, b), running.guess, unloaded),
                search_by_inertia,
                jax.lax.stop_gradient(
                    Before(running.loads, running.rate, Borrowed(running.factors, usable))
                ),
                # A stage of several is so close to the next that few need new factors.
                lend_exact=scheme.stages == 1,
            )
            found, fields = solved.found, solved.fields
            result = jnp.where(course.good, found.result, RESULTS.bad_input).astype(jnp.int32)
            _, q, w, _, _ = layout.split(fields.y)
            # No answer depends on where the next search starts, or on estimates: they have no
            # derivatives to carry along.
            running = running._replace(
                guess=jax.lax.stop_gradient(Guess(fields.y, fields.strain)),
                loads=jax.lax.stop_gradient(loads_of(rod)),
                rate=jax.lax.stop_gradient(c0 * fields.strain + history.strain),
                factors=solved.factors,
                c0=jnp.where(found.contraction < _LEND, c0, 0.0),
                result=jnp.where(running.result == 0, result, running.result),
                iterations=running.iterations + found.iterations,
                correction=jnp.maximum(running.correction, found.correction),
                history=jax.lax.stop_gradient(history),
            )
            return Fields(fields.strain, jnp.concatenate([q, w], -1)), running

        new_memory, after, errors = scheme.step(memory, coefficients, solve, running)
        fields, errors = jax.lax.stop_gradient((new_memory[0], errors))
        # Roots in the estimate have no slope at zero, and nothing is differentiated through it.
        time_error = jax.lax.stop_gradient(
            accumulated(running.time_error, errors, part * dt, fields.strain, rod, method)
        )
        # After a failure the rod is held where it was: its numbers stay finite.
        ok = after.result == RESULTS.successful
        hold = lambda new, old: jax.tree.map(lambda a, b: jnp.where(ok, a, b), new, old)
        memory = hold(new_memory, jax.lax.stop_gradient(memory))
        after = after._replace(time_error=time_error)
        last = ("guess", "loads", "rate", "history", "time_error")
        pick = lambda running: {name: getattr(running, name) for name in last}
        return (memory, after._replace(**hold(pick(after), pick(running)))), errors

    def equal_substeps(course, coefficients, state):
        # Inputs jump at the beginning of a step only.
        no_jump = scheme.coefficients(dt / substeps, jnp.zeros(1, dtype=bool))[0]

        def one(k, state):
            here = jnp.where(k == 0, coefficients, no_jump)
            return substep(course, k / substeps, 1 / substeps, here, state)[0]

        if isinstance(substeps, int) and substeps == 1:
            return substep(course, 0.0, 1.0, coefficients, state)[0], 1
        return jax.lax.fori_loop(0, substeps, one, state), substeps

    def substeps_by_error(course, state):
        """Repeat a substep, shorter, whose error is too large or which has no solution."""

        def goes_on(loop):
            (_, running), done, count = loop
            return (done < 1.0) & (count < MOST_SUBSTEPS) & (running.result == 0)

        def attempt(loop):
            (memory, running), done, count = loop
            # Not a sliver at the end of the step.
            part = jnp.where(done + 1.05 * running.part >= 1.0, 1.0 - done, running.part)
            coefficients = scheme.coefficients(part * dt, jnp.zeros(1, dtype=bool))[0]
            new, errors = substep(course, done, part, coefficients, (memory, running))
            shift = tip_shift(errors.lower, errors.of_integral, grid, layout) / substeps.limit
            tried = new[1]
            solved = tried.result == RESULTS.successful
            ok = solved & ((shift <= 1.0) | (part <= 1.01 * shortest))
            factor = _CAUTION * jnp.maximum(shift, 1e-12) ** (-1 / scheme.order)
            next_part = jnp.where(
                solved,
                jnp.maximum(part * jnp.clip(factor, _LEAST, _MOST), jnp.minimum(part, shortest)),
                part * _AFTER_FAILURE,
            )
            too_short = next_part < jnp.maximum(_SHORTEST, shortest / 64)
            hopeless = (~solved & too_short) | (tried.result == RESULTS.bad_input)
            kept = jax.tree.map(lambda a, b: jnp.where(ok, a, b), new, (memory, running))
            after = kept[1]._replace(
                # A substep cut short by the end of the step says little of the next one.
                part=jnp.where(ok & (part < running.part), running.part, next_part),
                iterations=tried.iterations,
                result=jnp.where(hopeless, tried.result, running.result),
            )
            return (kept[0], after), jnp.where(ok, done + part, done), count + 1

        state, done, count = jax.lax.while_loop(goes_on, attempt, (state, jnp.zeros(()), 0))
        memory, running = state
        unfinished = (running.result == 0) & (done < 1.0)
        result = jnp.where(unfinished, RESULTS.inaccurate, running.result).astype(jnp.int32)
        return (memory, running._replace(result=result)), count

    def step(state, row):
        memory, running = state
        coefficients, course = row
        running = running._replace(iterations=jnp.zeros((), jnp.int32), correction=jnp.zeros(()))
        if isinstance(substeps, LocalError):
            state, count = substeps_by_error(course, (memory, running))
        else:
            state, count = equal_substeps(course, coefficients, (memory, running))
        memory, running = state
        now = with_loads(rod, running.loads)
        now_at, history = running.guess, running.history
        error = method.error_in_motion(now_at, now, layout, history, now_at.strain)
        state = memory, running._replace(error=error)
        coarse = (running.result == RESULTS.successful) & (error > method.max_error)
        result = jnp.where(coarse, RESULTS.inaccurate, running.result).astype(jnp.int32)
        stats = {
            "iterations": running.iterations,
            "residual": running.correction,
            "error": error,
            "substeps": jnp.asarray(count, jnp.int32),
            "time_error": grown(running.time_error),
        }
        seen = method.outputs(memory[0].velocity)
        return state, (memory[0].strain, seen, result, stats)

    def start():
        zero, none = jnp.zeros((), jnp.int32), jnp.zeros(())
        steady = jnp.zeros_like(guess.strain)
        at_rest = History(jnp.ones(()), steady, still)
        equations = Equations(method, layout, rod, at_rest, guess.strain)
        running = Running(
            guess,
            loads_of(scaled_loads(rod, 0.0)),
            steady,
            at_rest,
            no_factors(equations.factorise, equations.start(guess)),
            none,
            first_code,
            zero,
            none,
            none,
            jnp.ones(()),
            none,
        )
        return scheme.start(fields, guess), running

    return Stepping(start, step, rod)


def tip_shift(error: Fields, of_integral: Fields, grid: Grid, layout: Layout) -> Float[Array, ""]:
    """How far local errors in time move the tip, in lengths of the rod.

    The tip is the integral of the strains along the rod, and of its velocity over time. The one
    takes a wave front between two points of the grid for an error of the step, and the other a
    vibration that the step damps out: the smaller is right.
    """
    arm = 1 - grid.s[:, None] / grid.length
    stretch, bend = layout.split_strain(error.strain)
    along_rod = jnp.linalg.norm(grid.length * grid.mean(arm * bend))
    if stretch is not None:
        along_rod = jnp.linalg.norm(grid.mean(stretch)) + along_rod
    moved = of_integral.velocity[-1, : layout.vector]
    return jnp.minimum(along_rod, jnp.linalg.norm(moved) / grid.length)


class Course(NamedTuple):
    """Inputs of every step: where each comes from, where it goes, and if it jumps there.

    `good`: whether all can be; in the place of those that cannot are zeros.
    """

    before: tuple
    now: tuple
    jumps: tuple
    good: Bool[Array, "steps"]

    def at(self, progress, rise):
        """The inputs of one step at `progress` in [0, 1]; those that jump rise within `rise`."""
        risen = jnp.minimum(progress / rise, 1.0)

        def one(before, now, jumps):
            x = jnp.where(jumps, risen, progress)
            return x * now + (1 - x) * before

        return jax.tree.map(one, self.before, self.now, self.jumps)


def _course(inputs, steps: int, from_rest: bool) -> tuple[Course, Bool[Array, "steps"]]:
    """The course of the inputs, and at the beginning of which steps any of them jumps.

    At the first step all do. Before it all are zero, or, where the motion begins in an
    equilibrium, what they are in that step.
    """
    good = good_inputs(*inputs) & jnp.ones(steps, dtype=bool)
    inputs = zero_unless(good, inputs)
    jumped = jax.tree.map(jumps, inputs)
    first = lambda x: jnp.zeros_like(x[:1]) if from_rest else x[:1]
    before = jax.tree.map(lambda x: jnp.concatenate([first(x), x[:-1]]), inputs)
    jump = [jnp.any(jump, axis=1) for jump in jax.tree.leaves(jumped)]
    restart = functools.reduce(jnp.logical_or, jump, jnp.arange(steps) == 0)
    return Course(before, inputs, jumped, good), restart
