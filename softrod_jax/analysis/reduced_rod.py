"""A rod of few coordinates that keeps its scene: nonlinear, for control, samples and design."""

import dataclasses
import functools
from collections.abc import Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, Real

from softrod_jax.analysis.few_strains import fewest, snapshots
from softrod_jax.analysis.limits import Limits, checked_limits, spread_out
from softrod_jax.analysis.near_rest import check_smooth
from softrod_jax.analysis.newton_of_few import Search, solve_few
from softrod_jax.analysis.strain_coordinates import (
    Motion,
    Past,
    StrainBasis,
    imbalances,
    kinetic_energy,
    laws,
    moving,
    strain_basis,
    strain_energy,
)
from softrod_jax.analysis.targets import Problem
from softrod_jax.bvp.collocation import Collocation
from softrod_jax.bvp.newton import NewtonOptions
from softrod_jax.foundation.compiling import compiled
from softrod_jax.foundation.numbers import ManyLike, ScalarLike
from softrod_jax.foundation.precision import require_float64
from softrod_jax.foundation.results import RESULTS, raise_unless_successful, without_derivative
from softrod_jax.rod.constants import Rod, full_strain
from softrod_jax.rod.markers import seen
from softrod_jax.rod.reduction import clamp_pose, make_rod
from softrod_jax.rod.relaxation import Crept
from softrod_jax.rod.shape import Pose
from softrod_jax.rod.validity import usable, usable_in_time
from softrod_jax.scene.checks import checked_scene
from softrod_jax.scene.inputs import (
    Inputs,
    checked_inputs,
    filled,
    good_inputs,
    time_step,
    whole_number,
    zero_unless,
)
from softrod_jax.scene.scene import Scene
from softrod_jax.scene.tendons import driven_by_length
from softrod_jax.stepping.scheme import AbstractTimeScheme
from softrod_jax.stepping.sdirk import SDIRK
from softrod_jax.stepping.step_inputs import StepInputs, inputs_of_steps

# Loads of an equilibrium rise in so many equal steps.
_LEVELS = 8


class Coordinates(NamedTuple):
    """Those of the strains, their rates [1/s], and what dashpots have crept, if there are any."""

    q: Float[Array, "n"]
    q_t: Float[Array, "n"]
    crept: Crept | None = None


class ReducedState(eqx.Module):
    """All that the next step depends on: `coordinates` and `rates`, and what acts.

    `result`: a code of `RESULTS`; from the first step that has no solution on, the rod is held.
    """

    memory: tuple
    inputs: Inputs
    search: Search
    result: Int[Array, "*batch"]

    @property
    def coordinates(self) -> Float[Array, "*batch n"]:
        return self.memory[0].q

    @property
    def rates(self) -> Float[Array, "*batch n"]:
        return self.memory[0].q_t


class ReducedMotion(eqx.Module):
    """A motion; entry 0 is the initial state, entry k + 1 the end of step k.

    - `ts` [s], (steps + 1,); `coordinates` and `rates` [1/s], (steps + 1, n).
    - `tip_positions` [m], (steps + 1, 3); `strains` (v, u), (steps + 1, outputs, 6), body frame.
    - `markers`: by name, "tip" among them, their poses, with a first axis of times.
    - `result`: a code of `RESULTS`; `iterations`, (steps,): of Newton's method in each step.
    """

    ts: Float[Array, "times"]
    coordinates: Float[Array, "times n"]
    rates: Float[Array, "times n"]
    tip_positions: Float[Array, "times 3"]
    strains: Float[Array, "times outputs 6"]
    markers: dict[str, Pose]
    result: Int[Array, ""]
    iterations: Int[Array, "steps"]


class ReducedRod(eqx.Module):
    """A rod whose strains are x* + sum_i q_i phi_i(s), as `reduce_nonlinear` makes it.

    - `scene`: all of its numbers may be replaced and differentiated; the strains phi_i, `shapes`
      (n, points, 6), stay as they are. The first `order` coordinates move, with 2 `order` states;
      the others follow at once, without inertia and without damping.
    - `left`: what part of the energy of the equilibria and modes that `shapes` were made of they do
      not hold.
    - `scheme`: of its steps in time. `tolerance`: how well the equations of a step are solved, as
      an error of the coordinates, of which a bend by a radian is about 1.

    A pytree: its methods are pure and compiled, and go through `jit`, `vmap`, `grad` and `scan`.
    """

    scene: Scene
    shapes: Float[Array, "n points 6"]
    left: Float[Array, ""]
    scheme: AbstractTimeScheme
    tolerance: Float[Array, ""]
    method: Collocation = eqx.field(static=True)
    order: int = eqx.field(static=True)

    @property
    def size(self) -> int:
        """How many coordinates there are, those that follow at once among them."""
        return self.shapes.shape[0]

    def equilibrium(
        self,
        tensions: Real[Array | np.ndarray, "by_tension"] | Sequence[ScalarLike] | None = None,
        pressures: Real[Array | np.ndarray, "chambers"] | Sequence[ScalarLike] | None = None,
        pulls: Real[Array | np.ndarray, "by_length"] | Sequence[ScalarLike] | None = None,
        *,
        throw: bool = True,
    ) -> ReducedState:
        """The rod at rest under these inputs, its loads raised in steps."""
        inputs = self._checked("ReducedRod.equilibrium", Inputs(tensions, pressures, pulls), 1)
        found = _equilibrium(self, inputs)
        if throw:
            found = raise_unless_successful(found.result, found, "ReducedRod.equilibrium")
        return found

    def begin(self) -> ReducedState:
        """Unloaded, at rest, with all actuators at zero."""
        return _begin(self)

    def step(self, state: ReducedState, dt: ScalarLike, action: Inputs) -> ReducedState:
        """The state `dt` [s] later; `action` is reached linearly at the end. It does not raise."""
        dt = time_step("ReducedRod.step", dt)
        return _step(self, state, dt, self._checked("ReducedRod.step", action, 1))

    def simulate(
        self,
        dt: ScalarLike,
        tensions: Real[Array | np.ndarray, "steps by_tension"] | Sequence[ManyLike] | None = None,
        pressures: Real[Array | np.ndarray, "steps chambers"] | Sequence[ManyLike] | None = None,
        pulls: Real[Array | np.ndarray, "steps by_length"] | Sequence[ManyLike] | None = None,
        *,
        initial: ReducedState | None = None,
        steps: int | None = None,
        throw: bool = True,
    ) -> ReducedMotion:
        """The motion from rest, unloaded or in the equilibrium `initial`; as `sr.simulate`.

        What jumps does so at once. Raises `ValueError` as `sr.simulate` does.
        """
        who = "ReducedRod.simulate"
        dt, given = time_step(who, dt), Inputs(tensions, pressures, pulls)
        checked = checked_inputs(who, self.scene, given, 2)
        rows = {jnp.asarray(x).shape[0] for x in checked if x is not None}
        rows |= set() if steps is None else {whole_number(who, "steps", steps)}
        if len(rows) != 1:
            raise ValueError(
                f"{who}: {sorted(rows)} steps; inputs and `steps` have to say the same"
            )
        count = rows.pop()
        inputs = filled(self.scene, checked, (count,))
        found = _simulate(self, dt, inputs, initial, count)
        if throw:
            found = raise_unless_successful(found.result, found, who)
        return found

    def poses(self, state: ReducedState) -> dict[str, Pose]:
        """Those of the tip and of all markers, by name."""
        return _poses(self, state.coordinates)[1]

    def nearest(self, point_strains: Float[Array, "points 6"]) -> Float[Array, "n"]:
        """The coordinates whose strains are nearest to these at the points of `method`."""
        return _nearest(self, point_strains)

    def energies(self, state: ReducedState) -> tuple[Float[Array, ""], Float[Array, ""]]:
        """Kinetic energy, and that of sections and actuators under constant inputs [J]."""
        return _energies(self, state)

    def _checked(self, who, inputs, ndim) -> Inputs:
        return filled(self.scene, checked_inputs(who, self.scene, inputs, ndim))

    def _rod(self, inputs: Inputs, dynamic: bool) -> tuple[StrainBasis, Rod]:
        grid = self.method.grid(self.scene)
        rod = make_rod(self.scene, inputs, dynamic=dynamic, grid=grid)
        return strain_basis(self.shapes, grid), rod


def reduce_nonlinear(
    scene: Scene,
    limits: Limits | None = None,
    order: int = 6,
    *,
    following: int = 6,
    samples: int = 64,
    modes: int = 6,
    method: Collocation | None = None,
    scheme: AbstractTimeScheme | None = None,
    tolerance: ScalarLike = 1e-6,
) -> ReducedRod:
    """A model of `scene` with `order` coordinates for its strains, and twice as many states.

    - `following`: how many coordinates there are besides, the fastest ones, that follow at once.

    - `limits`: for each kind of inputs, its lowest and highest values, as of `inverse`. The strains
      are those that hold most of the energy of `samples` equilibria under inputs all over them, and
      of the `modes` slowest modes about some. Without limits they are those of the modes alone.
    - `method`: the grid along the rod, `Collocation(4, order=4)` if `None`. `scheme`: of steps in
      time, `SDIRK(2)` if `None`; `BDFAlpha()` takes half the time. `tolerance`: see `ReducedRod`.

    Everything of the scene is in the model, with its numbers: sections, materials, tendons on any
    path, driven by tension or, if they stretch, by length, chambers, loads, drag, obstacles. Of a
    scene in a plane the strains stay in it.

    Raises `ValueError` for less than one coordinate or more than there are, for limits that
    `inverse` refuses, for dry friction and backlash, for conditions of one's own, and for tendons
    driven by length that do not stretch.
    """
    who = "reduce_nonlinear"
    require_float64(who)
    scene = _in_space(who, checked_scene(who, scene))
    order, samples = whole_number(who, "order", order), whole_number(who, "samples", samples)
    modes = whole_number(who, "modes", modes)
    low, high = (Inputs(), Inputs()) if limits is None else checked_limits(who, scene, limits)
    method = (Collocation(4, order=4) if method is None else method).fitted(scene)
    problem = Problem(scene, low, high, jnp.zeros(()), "tip", method, NewtonOptions())
    m = problem.rest.shape[0]
    x = problem.rest[None]
    if m:
        x = jnp.concatenate([x, jnp.asarray(spread_out(samples, m))])
    found = snapshots(problem, x, min(len(x), 4), modes)
    most = min(len(x) + modes * min(len(x), 4), 6 * method.grid(scene).s.shape[0])
    if isinstance(following, bool) or following < 0 or order + following > most:
        raise ValueError(
            f"{who}: order={order}, following={following}; {most} at most in all, of so many "
            "samples and modes"
        )
    few = fewest(problem, found, order + following)
    scheme, close = SDIRK(2) if scheme is None else scheme, jnp.asarray(tolerance, dtype=float)
    return ReducedRod(scene, few.shapes, few.left, scheme, close, method, order)


def _in_space(who: str, scene: Scene) -> Scene:
    """The scene without its plane, which its strains do not leave."""
    check_smooth(who, scene)
    if scene.conditions is not None:
        raise ValueError(f"{who}: conditions on the whole rod are not offered here; leave them out")
    tendons = scene.tendons
    for i in driven_by_length(tendons):
        if tendons is not None and (tendons.stiffness is None or tendons.stiffness[i] is None):
            raise ValueError(
                f"{who}: tendon {i + 1} is driven by its length and does not stretch; give it a "
                "stiffness"
            )
    if scene.plane is None:
        return scene
    nu = scene.poisson_ratio
    # Where nothing is sheared or twisted it is in no equation.
    nu = jnp.zeros(()) if nu is None and scene.inextensible else nu
    return dataclasses.replace(scene, plane=None, poisson_ratio=nu)


class _Carry(NamedTuple):
    """What one solve hands to the next: see `Search`."""

    guess: Float[Array, "n"]
    search: Search


def _acting(rod: Rod, scene: Scene, inputs: Inputs) -> Rod:
    """The rod under other inputs; all else has been computed before."""
    new = make_rod(scene, inputs, grid=rod.grid)
    own = {name: getattr(new, name) for name in ("tau", "n_ch", "m_ch", "constraint")}
    return dataclasses.replace(rod, **own)


def _one_step(model: ReducedRod, basis, rod, state: ReducedState, coefficients, row: StepInputs):
    """The state after a step."""
    memory, result = state.memory, state.result
    alive = (result == RESULTS.successful) & row.good
    begun: Coordinates = memory[0]
    moves = jnp.array([1.0] * model.order + [0.0] * (model.size - model.order))

    def solve(c0, history: Coordinates, at, carry: _Carry):
        now = _acting(rod, model.scene, row.at(at, 1e-9))

        def acting(basis, now, history, q):
            # Of what follows at once, rates are zero: it has no damping.
            q_h = history.q if q is None else jnp.where(moves > 0, history.q, -c0 * q)
            return laws(basis, now, Past(c0, q_h, history.crept))

        # What does not depend on the unknowns is computed once, and not in each iteration.
        known = acting(basis, now, history, None) if model.size == model.order else None

        def residual(given, q):
            basis, now, history, known = given
            q_t = moves * (c0 * q + history.q)
            motion = Motion(q, q_t, moves * (c0 * q_t + history.q_t))
            own = acting(basis, now, history, q) if known is None else known
            return imbalances(basis, own, motion)

        given = basis, now, history, known
        q, search = solve_few(residual, given, carry.guess, carry.search, model.tolerance)
        crept = None
        if rod.relaxation is not None and history.crept is not None:
            crept = rod.relaxation.crept(c0, history.crept, _inner(basis, rod, q))
        q_t = moves * (c0 * q + history.q)
        return Coordinates(q, q_t, crept), _Carry(jax.lax.stop_gradient(q), search)

    jumps = [jnp.any(x) for x in jax.tree.leaves(row.jumps)]
    search = state.search.next(alive, functools.reduce(jnp.logical_or, jumps, jnp.array(False)))
    carry = _Carry(jax.lax.stop_gradient(begun.q), search)
    new, carry, _ = model.scheme.step(memory, coefficients, solve, carry)
    good = alive & carry.search.solved
    held = jax.lax.stop_gradient(memory)
    memory = jax.tree.map(lambda a, b: jnp.where(good, a, b), new, held)
    failed = jnp.where(row.good, RESULTS.diverged, RESULTS.bad_input)
    code = jnp.where(result == RESULTS.successful, jnp.where(good, 0, failed), result)
    return ReducedState(memory, row.now, carry.search, code.astype(jnp.int32))


def _inner(basis: StrainBasis, rod: Rod, q):
    """The strains that are unknown in this rod, beyond those of the unloaded one."""
    strain = basis.strain(q)
    return strain if rod.K_se is not None else strain[:, 3:]


def _start(model: ReducedRod, basis, rod, q) -> tuple:
    crept = None
    if rod.relaxation is not None:
        crept = rod.relaxation.at_rest(_inner(basis, rod, q))
    return model.scheme.start(Coordinates(q, jnp.zeros_like(q), crept), jax.lax.stop_gradient(q))


@compiled
def _begin(model: ReducedRod) -> ReducedState:
    inputs = filled(model.scene, Inputs())
    basis, rod = model._rod(inputs, dynamic=True)
    memory = _start(model, basis, rod, jnp.zeros(model.size))
    search = Search.new(model.size, True)
    return ReducedState(memory, inputs, search, jnp.zeros((), jnp.int32))


@compiled
def _equilibrium(model: ReducedRod, inputs: Inputs) -> ReducedState:
    scene, good = usable(model.scene, good_inputs(inputs), inputs)
    model = dataclasses.replace(model, scene=scene)
    inputs = zero_unless(good, inputs)
    basis, rod = model._rod(inputs, dynamic=False)

    def at_level(state, level):
        q, solved = state
        part = jax.tree.map(lambda x: level * x, inputs)
        now = _acting(rod, scene, part)
        weight = None if rod.weight is None else level * rod.weight
        now = dataclasses.replace(now, weight=weight)
        still = jnp.zeros_like(q)
        residual = lambda given, q: imbalances(given[0], given[1], Motion(q, still, still))
        search = Search.new(q.size, good)
        given = basis, laws(basis, now, None)
        q, search = solve_few(residual, given, jax.lax.stop_gradient(q), search, model.tolerance)
        return (q, solved & search.solved), None

    levels = jnp.linspace(1 / _LEVELS, 1, _LEVELS)
    (q, solved), _ = jax.lax.scan(at_level, (jnp.zeros(model.size), jnp.array(True)), levels)
    result = jnp.where(good, jnp.where(solved, 0, RESULTS.diverged), RESULTS.bad_input)
    q = without_derivative(result != 0, q)
    memory = _start(model, *model._rod(inputs, dynamic=True), q)
    search = Search.new(model.size, True)
    return ReducedState(memory, inputs, search, result.astype(jnp.int32))


@compiled
def _step(model: ReducedRod, state: ReducedState, dt, action: Inputs) -> ReducedState:
    scene, dt, good = usable_in_time(model.scene, dt)
    model = dataclasses.replace(model, scene=scene)
    good &= good_inputs(action)
    action = zero_unless(good, action)
    basis, rod = model._rod(action, dynamic=True)
    never = jax.tree.map(lambda x: jnp.zeros(x.shape, bool), action)
    row = StepInputs(state.inputs, action, never, good)
    coefficients = model.scheme.coefficients(dt, jnp.zeros(1, bool))[0]
    return _one_step(model, basis, rod, state, coefficients, row)


@compiled
def _simulate(model: ReducedRod, dt, inputs: Inputs, initial: ReducedState | None, steps: int):
    scene, dt, good = usable_in_time(model.scene, dt)
    model = dataclasses.replace(model, scene=scene)
    basis, rod = model._rod(jax.tree.map(lambda x: x[0], inputs), dynamic=True)
    at_first = None if initial is None else initial.inputs
    rows, restart = inputs_of_steps(inputs, steps, at_first)
    rows = rows._replace(good=rows.good & good)
    coefficients = model.scheme.coefficients(dt, restart)
    none = jnp.zeros((), jnp.int32)
    if initial is None:
        memory = _start(model, basis, rod, jnp.zeros(model.size))
        now = jax.tree.map(lambda x: x[0], inputs)
        initial = ReducedState(memory, now, Search.new(model.size, True), none)

    def one(state, row):
        state = _one_step(model, basis, rod, state, *row)
        return state, (state.coordinates, state.rates, state.search.iterations)

    last, (q, q_t, iterations) = jax.lax.scan(one, initial, (coefficients, rows))
    result, begun = last.result, initial.memory[0]
    q, q_t = jnp.concatenate([begun.q[None], q]), jnp.concatenate([begun.q_t[None], q_t])
    strains, poses = jax.vmap(lambda q: _poses(model, q))(q)
    ts = dt * jnp.arange(steps + 1)
    tip = poses["tip"].position
    found = ReducedMotion(ts, q, q_t, tip, strains, poses, result, iterations)
    return without_derivative(result != RESULTS.successful, found)


@compiled
def _poses(model: ReducedRod, q):
    """Strains at the outputs of the method, and the poses of the tip and of all markers."""
    scene, method = model.scene, model.method
    grid = method.grid(scene)
    rod = make_rod(scene, grid=grid)
    own = strain_basis(model.shapes, grid).strain(q)
    strain = full_strain(jnp.broadcast_to(rod.rest_strain, _inner_shape(own, rod)), rod) + own
    shape = method.shape(strain, grid, *clamp_pose(scene))
    every = seen(scene, method.inside(strain), method.outputs(grid.s), *shape)
    return method.outputs(strain), every


def _inner_shape(strain, rod: Rod):
    return (strain.shape[0], rod.strain_size)


@compiled
def _nearest(model: ReducedRod, point_strains):
    grid = model.method.grid(model.scene)
    rod = make_rod(model.scene, grid=grid)
    rest = full_strain(jnp.broadcast_to(rod.rest_strain, (grid.s.shape[0], rod.strain_size)), rod)
    sizes = jnp.sqrt(grid.weights)[:, None] * jnp.array([1.0] * 3 + [grid.length] * 3)
    A = (sizes * model.shapes).reshape(model.size, -1).T
    return jnp.linalg.lstsq(A, (sizes * (point_strains - rest)).ravel())[0]


@compiled
def _energies(model: ReducedRod, state: ReducedState):
    basis, rod = model._rod(state.inputs, dynamic=False)
    q, q_t = state.coordinates, state.rates
    here = moving(basis, rod, Motion(q, q_t, jnp.zeros_like(q)))
    return kinetic_energy(basis, rod, here), strain_energy(basis, rod, here.strain)
