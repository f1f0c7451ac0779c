"""A rod that moves: the solve along it at one instant, and a substep of the motion.

A substep is a part of the time from one sample of the inputs to the next. The time scheme turns it
into one solve or several, each with a history of its own (paper eq. 14); a solve starts from the
one before it, with its factors where these still serve.
"""

import dataclasses
import functools
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from softrod_jax.bvp.boundary_value import slow_unless, solve_boundary_value
from softrod_jax.bvp.equations import Equations, loads_of, scaled_loads
from softrod_jax.bvp.method import AbstractMethod, Guess
from softrod_jax.bvp.newton import NewtonOptions, ReusedFactors, no_factors
from softrod_jax.bvp.unloaded import unloaded_guess
from softrod_jax.foundation.compiling import on_cpu
from softrod_jax.foundation.results import RESULTS
from softrod_jax.rod.carried import Surroundings
from softrod_jax.rod.constants import Rod, fastest_wave, inner_strain
from softrod_jax.rod.friction import Slid
from softrod_jax.rod.grid import Grid
from softrod_jax.rod.ode import contact_forces, slid_after
from softrod_jax.rod.reduction import make_rod
from softrod_jax.rod.relaxation import Crept
from softrod_jax.rod.state import History, Layout, layout_of
from softrod_jax.scene.inputs import Inputs, good_inputs, zero_unless
from softrod_jax.scene.planes import turn_in, vector_in
from softrod_jax.scene.scene import Scene
from softrod_jax.stepping.first_mode import axis_of
from softrod_jax.stepping.inertial_continuation import Before, SharedFactors, search_by_inertia
from softrod_jax.stepping.scheme import AbstractTimeScheme, LocalErrors
from softrod_jax.stepping.step_inputs import StepInputs
from softrod_jax.stepping.time_error import accumulated
from softrod_jax.stepping.touch_error import Shaken, shaken_on, unshaken

# The factors of a Jacobian serve the next solve, too, where corrections fell this fast with them.
# Of 0.02 to 0.2 the fastest on the paper's rod, with new factors 9 times as dear as a correction.
_REUSE = 0.05
# What jumps rises while a wave runs this part of the way from point to point: no grid holds a front
# that is thinner than its points are apart.
_RISE = 0.5


class Fields(NamedTuple):
    """What has a history: strains (v, u) and velocities (q, omega), (points, 6) each.

    Of a rod that relaxes, also what dashpots have crept, (points, branches, 6).
    """

    strain: Float[Array, "points strain"]
    velocity: Float[Array, "points pair"]
    crept: Crept | None = None


class Beginning(NamedTuple):
    """The equilibrium in which a motion begins, its result code and, where they are known, inputs.

    `multipliers`: as in `Guess`; `slid`: of tendons with friction; `pushes` [N]: of obstacles;
    `wrench`: the total force and moment at the base, body frame.
    """

    strain: Float[Array, "points 6"]
    result: Int[Array, ""]
    multipliers: Float[Array, "conditions"] | None = None
    inputs: Inputs = Inputs()
    slid: Slid | None = None
    pushes: Float[Array, "contacts 3"] | None = None
    wrench: Float[Array, "6"] | None = None


class Progress(NamedTuple):
    """What a solve hands to the next, besides the memory of the time scheme.

    - `guess`: the last solution; `multipliers`: those of it, with their derivatives; `slid`: how
      tendons with friction have slid until then.
    - `loads` and `history`: those of the last solve; `rate`: that of the strains there; `crept`:
      what dashpots have crept there, or `None`; `factors` of the last Jacobian, made with `c0`,
      which is negative where they serve no longer, and only parts of them do.
    - `stage`: of the step, on a GPU: all stages have the `factors` of the first. Else `None`.
    - `result`: the code so far. `iterations` and `correction`: in this step.
    - `error`: estimated, along the rod; `time_error`: estimated, of the tip so far, in lengths.
    - `pushes` [N]: the force of each obstacle on the rod, with its derivative; `None` without any.
    - `wrench`: (N, M) at the base, with its derivative.
    - `shaken`: by what the grid missed of pushes; `None` without obstacles.
    - `part`: the length of the next substep, in steps, where errors choose it.
    """

    guess: Guess
    multipliers: Float[Array, "conditions"] | None
    slid: Slid | None
    loads: list
    rate: Float[Array, "points strain"]
    history: History
    factors: Any
    c0: Float[Array, ""]
    stage: Int[Array, ""] | None
    result: Int[Array, ""]
    iterations: Int[Array, ""]
    correction: Float[Array, ""]
    error: Float[Array, ""]
    part: Float[Array, ""]
    time_error: Float[Array, ""]
    wrench: Float[Array, "pair"]
    crept: Crept | None = None
    pushes: Float[Array, "contacts 3"] | None = None
    shaken: Shaken | None = None

    @property
    def from_grid(self) -> Float[Array, ""]:
        """The estimated error from the grid, in lengths: of the rod itself, and of pushes on it."""
        if self.shaken is None:
            return self.error
        return jnp.maximum(self.error, self.shaken.most)


class State(NamedTuple):
    """Between two substeps: the `memory` of the time scheme, `Fields` its first entry."""

    memory: tuple
    progress: Progress

    @property
    def fields(self) -> Fields:
        return self.memory[0]


class MovingRod(NamedTuple):
    """What all solves of one motion share.

    `rod`: under the first inputs. `unloaded`: the guess of a rod without loads. `crossing`: how
    long a wave takes from point to point, in steps of `dt`.
    """

    scene: Scene
    dt: Float[Array, ""]
    scheme: AbstractTimeScheme
    method: AbstractMethod
    options: NewtonOptions
    grid: Grid
    rod: Rod
    layout: Layout
    unloaded: Guess
    crossing: Float[Array, ""]

    def under(self, inputs: Inputs, around: Surroundings = Surroundings()) -> Rod:
        """The rod under other inputs, its base and obstacles elsewhere."""
        return make_rod(self.scene, inputs, grid=self.grid, spread_fronts=True, around=around)

    def at_rest(self, begin: Beginning | None, good) -> State:
        """Before the first step: in the equilibrium `begin`, or unloaded if `None`.

        `good`: whether there can be such a scene; see `rod/validity.py`.
        """
        guess, result = self.unloaded, RESULTS.successful
        multipliers = guess.multipliers
        if begin is not None:
            begun = good & jnp.all(jnp.isfinite(begin.strain))
            strain = jnp.where(begun, inner_strain(begin.strain, self.rod), guess.strain)
            guess, result = guess._replace(strain=strain), begin.result
            if multipliers is not None and begin.multipliers is not None:
                multipliers = jnp.where(begun, begin.multipliers, 0.0)
                guess = guess._replace(multipliers=jax.lax.stop_gradient(multipliers))
        slid = self._slid_at_first(begin)
        if slid is not None:
            own = jax.lax.stop_gradient((slid.loss, slid.slip))
            guess = guess._replace(y=self.layout.with_losses_and_slips(guess.y, *own))
        still = jnp.zeros((*guess.strain.shape[:-1], self.layout.pair))
        steady = jnp.zeros_like(guess.strain)
        relaxation, crept = self.rod.relaxation, None
        if relaxation is not None:
            crept = relaxation.at_rest(guess.strain - self.rod.rest_strain)
        none_crept = None if crept is None else jnp.zeros_like(crept)
        history = History(jnp.ones(()), steady, still, none_crept)
        equations = Equations(self.method, self.layout, self.rod, history, guess.strain)
        none, factorise = jnp.zeros(()), equations.factorise
        if not on_cpu():
            factorise = functools.partial(factorise, single=True)
        progress = Progress(
            guess=guess,
            multipliers=multipliers,
            slid=slid,
            loads=loads_of(scaled_loads(self.rod, 0.0)),
            rate=steady,
            history=history,
            factors=no_factors(factorise, equations.start(guess)),
            c0=none,
            stage=None if on_cpu() else jnp.zeros((), jnp.int32),
            result=jnp.where(good, result, RESULTS.bad_input).astype(jnp.int32),
            iterations=jnp.zeros((), jnp.int32),
            correction=none,
            error=none,
            part=jnp.ones(()),
            time_error=none,
            wrench=self._wrench_at_first(begin),
            crept=jax.lax.stop_gradient(crept),
            pushes=self._pushed_at_first(begin),
            shaken=None if self.rod.radius is None else unshaken(),
        )
        return State(self.scheme.start(Fields(guess.strain, still, crept), guess), progress)

    def _wrench_at_first(self, begin: Beginning | None):
        if begin is None or begin.wrench is None:
            return jnp.zeros(self.layout.pair)
        wrench = jnp.where(jnp.all(jnp.isfinite(begin.strain)), begin.wrench, 0.0)
        plane = self.rod.plane
        return jnp.concatenate([vector_in(plane, wrench[:3]), turn_in(plane, wrench[3:])])

    def _pushed_at_first(self, begin: Beginning | None):
        if begin is None or begin.pushes is None:
            return pushes_on(self.rod, self.layout, self.unloaded.y)
        good = jnp.all(jnp.isfinite(begin.strain))
        return jnp.where(good, begin.pushes, 0.0)

    def _slid_at_first(self, begin: Beginning | None) -> Slid | None:
        if self.rod.friction is None:
            return None
        unslid = self.rod.friction.slid
        if begin is None or begin.slid is None:
            return unslid
        good = jnp.all(jnp.isfinite(begin.strain))
        return jax.tree.map(lambda a, b: jnp.where(good, a, b), begin.slid, unslid)

    def solve(self, c0, history: Fields, rod: Rod, good, progress: Progress):
        """The fields where y_t = c0 y + `history`, and the progress with them."""
        # After a failure, an unloaded rod at rest costs a batch no iterations.
        alive = progress.result == RESULTS.successful
        rod = scaled_loads(rod, jnp.where(alive, 1.0, 0.0))
        if rod.base_velocity is not None:
            moving = jnp.where(alive, rod.base_velocity, 0.0)
            rod = dataclasses.replace(rod, base_velocity=moving)
        usable = alive & (progress.c0 == c0)
        slowed = slow_unless(alive, History(c0, *history))
        if progress.stage is None:
            alike = alive & (jnp.abs(progress.c0) == c0)
            reused = ReusedFactors(progress.factors, usable, alike)
            before = Before(progress.loads, progress.rate, reused, crept=progress.crept)
        else:
            new = progress.stage == 0
            shared = SharedFactors(progress.factors, new, new | (progress.c0 == c0))
            before = Before(progress.loads, progress.rate, None, shared, progress.crept)
        solved = solve_boundary_value(
            self.method,
            self.layout,
            self.options,
            rod,
            slowed,
            jax.tree.map(lambda a, b: jnp.where(alive, a, b), progress.guess, self.unloaded),
            search_by_inertia,
            jax.lax.stop_gradient(before),
            # A stage of several is so close to the next that few need new factors.
            reuse_exact=self.scheme.stages == 1 and progress.stage is None,
        )
        found, fields = solved.found, solved.fields
        result = jnp.where(good, found.result, RESULTS.bad_input).astype(jnp.int32)
        _, q, w, _, _ = self.layout.split(fields.y)
        crept = None
        if rod.relaxation is not None and slowed.crept is not None:
            e = fields.strain - rod.rest_strain
            crept = rod.relaxation.crept(slowed.c0, slowed.crept, e)
        # No answer depends on where the next search starts, or on estimates: they have no
        # derivatives to carry along.
        progress = progress._replace(
            guess=jax.lax.stop_gradient(fields),
            multipliers=fields.multipliers,
            slid=slid_after(fields, rod, self.layout),
            loads=jax.lax.stop_gradient(loads_of(rod)),
            rate=jax.lax.stop_gradient(c0 * fields.strain + slowed.strain),
            factors=solved.factors,
            c0=c0 if progress.stage is not None else jnp.where(found.contraction < _REUSE, c0, -c0),
            result=jnp.where(progress.result == RESULTS.successful, result, progress.result),
            iterations=progress.iterations + found.iterations,
            correction=jnp.maximum(progress.correction, found.correction),
            history=jax.lax.stop_gradient(slowed),
            crept=jax.lax.stop_gradient(crept),
            stage=None if progress.stage is None else progress.stage + 1,
            pushes=pushes_on(rod, self.layout, fields.y),
            wrench=fields.y[0, -self.layout.pair :],
        )
        return Fields(fields.strain, jnp.concatenate([q, w], -1), crept), progress

    def substep(
        self, inputs: StepInputs, first, part, coefficients, state: State
    ) -> tuple[State, LocalErrors]:
        """The part [first, first + part] of a step, and its local errors."""
        memory, progress = state
        if progress.stage is not None:
            progress = progress._replace(stage=jnp.zeros_like(progress.stage))
        rise = jnp.minimum(_RISE * self.crossing, 1.0)

        def solve(c0, history, at, progress):
            # Not above 1 by rounding: a tension that falls to zero would become negative.
            here = jnp.minimum(first + at * part, 1.0)
            rod = self.under(inputs.at(here, rise), inputs.courses.at(here, self.dt))
            rod = rod.having_slid(state.progress.slid)
            return self.solve(c0, history, rod, inputs.good, progress)

        new_memory, after, errors = self.scheme.step(memory, coefficients, solve, progress)
        fields, errors = jax.lax.stop_gradient((new_memory[0], errors))
        rod = self.rod
        if inputs.courses.good is not None:  # something is carried
            end = jnp.minimum(first + part, 1.0)
            rod = self.under(inputs.at(end, rise), inputs.courses.at(end, self.dt))
        # Roots in the estimate have no slope at zero, and nothing is differentiated through it.
        length, axis = part * self.dt, axis_of(fields.strain, rod, self.method)
        error = accumulated(progress.time_error, errors, length, axis, rod, self.method)
        time_error = jax.lax.stop_gradient(error)
        if progress.shaken is not None:
            args = after.guess.y, length, axis.tangent, rod, self.layout, self.method
            shaken = jax.lax.stop_gradient(shaken_on(progress.shaken, *args))
            after = after._replace(shaken=shaken)
        # After a failure the rod stays where it was: its numbers stay finite.
        ok = after.result == RESULTS.successful
        unless_failed = lambda new, old: jax.tree.map(lambda a, b: jnp.where(ok, a, b), new, old)
        memory = unless_failed(new_memory, jax.lax.stop_gradient(memory))
        after = after._replace(time_error=time_error)
        last = (
            "guess",
            "multipliers",
            "slid",
            "loads",
            "rate",
            "history",
            "time_error",
            "crept",
            "pushes",
            "wrench",
            "shaken",
        )
        pick = lambda progress: {name: getattr(progress, name) for name in last}
        return State(memory, after._replace(**unless_failed(pick(after), pick(progress)))), errors


def pushes_on(rod: Rod, layout: Layout, y) -> Float[Array, "contacts 3"] | None:
    """The force of each obstacle on the rod [N]; `None` without any."""
    return None if rod.radius is None else contact_forces(y, rod, layout)


def moving_rod(
    scene: Scene, dt, inputs: Inputs, scheme: AbstractTimeScheme, method: AbstractMethod, options
) -> MovingRod:
    """`scene` in motion; `inputs` of any one step say which actuators there are."""
    grid = method.grid(scene)
    rod = make_rod(scene, zero_unless(good_inputs(inputs), inputs), grid=grid, spread_fronts=True)
    layout = layout_of(rod, dynamic=True)
    unloaded = unloaded_guess(layout, rod)
    crossing = grid.widest / (fastest_wave(rod) * dt)
    return MovingRod(scene, dt, scheme, method, options, grid, rod, layout, unloaded, crossing)
