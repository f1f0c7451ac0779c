"""Static equilibrium of a scene under constant actuation."""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from softrod_jax.boundary_value import (
    Equations,
    Found,
    scaled_loads,
    search_directly,
    solve_boundary_value,
)
from softrod_jax.collocation import Collocation
from softrod_jax.compiling import compiled
from softrod_jax.grid_control import (
    DEFAULT_TOLERANCE,
    first_grid,
    needed_intervals,
    solve_within,
)
from softrod_jax.inputs import actuation, good_inputs, is_traced, zero_unless
from softrod_jax.method import Guess, Method
from softrod_jax.newton import NewtonOptions, no_factors
from softrod_jax.precision import require_float64
from softrod_jax.restrictions import in_space
from softrod_jax.results import RESULTS, raise_unless_successful, without_derivative
from softrod_jax.rod import Rod, clamp_pose, full_strain, make_rod
from softrod_jax.rod_ode import Layout, layout_of
from softrod_jax.rotations import quaternion_exp, quaternion_product
from softrod_jax.scene import Scene
from softrod_jax.scene_checks import checked_scene, usable
from softrod_jax.settling import settle

# Continuation gives up when the next load step is a smaller part of the whole than this.
_SMALLEST_LOAD_STEP = 1e-4
_MAX_LOAD_STEPS = 200
# Corrections that fall at least this fast, undamped, from one load to the next: the answer is
# on the branch that the last one was on.
_SAFE_CONTRACTION = 0.5


class StaticSolution(eqx.Module):
    """A static equilibrium.

    - `tip_position` [m], (3,); `tip_quaternion` (w, x, y, z), (4,).
    - `arc_lengths` [m], (outputs,); `positions` [m], (outputs, 3); `quaternions`, (outputs, 4).
      Where along the rod is up to the method: its nodes, or the ends of its steps.
    - `strains` (v, u), (outputs, 6): v [-], u [1/m], body frame.
    - `wrenches` (N, M), (outputs, 6): *total* force [N] and moment [N m], body frame.
    - `result`: a code of `RESULTS`; 0 is success. Else the numbers are the last iterate.
    - `stats`: "iterations", "residual" (Newton's last correction, relative to the size of the
      state), "load_steps" (1: reached at once; more: by continuation in the load), "stable"
      (false: a disturbance, however small, takes the rod to another equilibrium; of a scene with
      a plane, one in that plane), "error" (of the tip from the grid along the rod, estimated, in
      lengths of the rod), "needed_intervals" (with which that would be 1e-4), "transient_steps"
      (of the damped motion; 0: it was not needed).
    """

    tip_position: Float[Array, "3"]
    tip_quaternion: Float[Array, "4"]
    arc_lengths: Float[Array, "outputs"]
    positions: Float[Array, "outputs 3"]
    quaternions: Float[Array, "outputs 4"]
    strains: Float[Array, "outputs 6"]
    wrenches: Float[Array, "outputs 6"]
    result: Int[Array, ""]
    stats: dict
    point_strains: Float[Array, "points 6"]
    method: Method = eqx.field(static=True)


def solve_static(
    scene: Scene,
    tensions: Float[Array, "tendons"] | None = None,
    pressures: Float[Array, "chambers"] | None = None,
    *,
    method: Method | None = None,
    newton: NewtonOptions = NewtonOptions(),
    tolerance: float | None = None,
    throw: bool = True,
) -> StaticSolution:
    """The equilibrium reached by raising all loads together from zero.

    Where several exist, it is the one that the unloaded rod moves to if the loads rise slowly.
    Where that path ends, as in snapping or buckling, a heavily damped motion goes on from there.

    - `tensions` [N], (tendons,), and `pressures` [Pa], (chambers,): `None` leaves that
      actuator out.
    - `method`: how to solve along the rod; `Collocation` or `Shooting`, on the grid as given.
      `None`: `Collocation()`, refined until the tip is good to 1e-4 lengths of the rod.
    - `tolerance`: refine the grid, from `method` on, until the estimated error is below this many
      lengths of the rod. Under `jit`, `vmap` and `grad` a grid cannot be refined: the code
      `inaccurate` says that it is too coarse, and `stats["needed_intervals"]` which one is not.
    - `throw`: raise `SolveError` if there is no answer; else see `StaticSolution.result`.

    Under `jit`, `vmap` and `grad` the damped motion is not tried: such a sample has a code.

    Works under `jit`, `vmap`, `grad` and `jacfwd`. Raises `ValueError` for inputs of the wrong
    shape, negative tensions, numbers that a scene cannot have, what contradicts
    `Scene.inextensible` or `Scene.plane`, and without float64.
    """
    require_float64("solve_static")
    scene = checked_scene("solve_static", scene)
    tensions, pressures = actuation("solve_static", scene, tensions, pressures, ndim=1)
    arguments = (scene, tensions, pressures)
    traced = is_traced(arguments)
    if tolerance is not None and (traced or is_traced(tolerance) or not 0 < tolerance < 1):
        raise ValueError(
            f"solve_static: tolerance={tolerance}; a part of the rod's length in (0, 1) is needed, "
            "and not under jit, vmap or grad: there, give a method with enough intervals"
        )
    if method is None and not traced:
        method, tolerance = first_grid(Collocation(), scene), tolerance or DEFAULT_TOLERANCE
    method = Collocation() if method is None else method
    solve = lambda method: _solve(*arguments, method, newton, traced)
    solution = solve(method) if tolerance is None else solve_within(solve, method, tolerance)
    if throw:
        solution = raise_unless_successful(solution.result, solution, "solve_static")
    return solution


def _solve(scene, tensions, pressures, method, options, traced):
    solution = _solve_static(scene, tensions, pressures, method, options)
    if not traced and int(solution.result) in (RESULTS.diverged, RESULTS.max_iterations):
        return _settled(scene, tensions, pressures, method, options)
    return solution


@compiled
def _solve_static(scene, tensions, pressures, method, options):
    scene, rod, valid, layout, guess = _problem(scene, tensions, pressures, method)
    solved = solve_boundary_value(method, layout, options, rod, None, guess, search_by_load)
    return _solution(scene, rod, method, solved, valid, jnp.zeros((), jnp.int32))


@compiled
def _settled(scene, tensions, pressures, method, options):
    """By a damped motion, and Newton's method from where it comes to rest."""
    scene, rod, valid, layout, guess = _problem(scene, tensions, pressures, method)
    rest = settle(method, layout, options, rod, guess)
    solved = solve_boundary_value(method, layout, options, rod, None, rest.guess)
    found = solved.found
    moving = jnp.where(rest.at_rest, found.result, RESULTS.diverged).astype(jnp.int32)
    solved = solved._replace(found=found._replace(result=moving))
    return _solution(scene, rod, method, solved, valid, rest.steps)


def _problem(scene, tensions, pressures, method):
    inputs = (tensions, pressures)
    scene, valid = usable(scene, good_inputs(*inputs), *inputs)
    tensions, pressures = zero_unless(valid, inputs)
    rod = make_rod(scene, tensions, pressures, dynamic=False)
    layout = layout_of(rod, dynamic=False)
    return scene, rod, valid, layout, unloaded_guess(method, layout, rod)


def _solution(scene, rod, method, solved, valid, transient_steps):
    result = jnp.where(valid, solved.found.result, RESULTS.bad_input).astype(jnp.int32)
    fields, error = solved.fields, solved.found.error
    strain = full_strain(fields.strain, rod)
    positions, quaternions = method.shape(strain, rod.L, *clamp_pose(scene))
    wrench = method.outputs(fields.y)[:, -layout_of(rod, dynamic=False).pair :]
    solution = StaticSolution(
        tip_position=positions[-1],
        tip_quaternion=quaternions[-1],
        arc_lengths=method.outputs(method.points(rod.L)),
        positions=positions,
        quaternions=quaternions,
        strains=method.outputs(strain),
        wrenches=in_space(wrench, rod.plane),
        result=result,
        stats={
            "iterations": solved.found.iterations,
            "residual": solved.found.correction,
            "load_steps": solved.found.load_steps,
            "stable": solved.found.stable & valid,
            "error": error,
            "needed_intervals": needed_intervals(error, method),
            "transient_steps": transient_steps,
        },
        point_strains=strain,
        method=method,
    )
    # On a coarse grid there is an answer, and so there is a derivative.
    answered = (result == RESULTS.successful) | (result == RESULTS.inaccurate)
    return without_derivative(~answered, solution)


def unloaded_guess(method: Method, layout: Layout, rod: Rod) -> Guess:
    """The rod without any load: strains v*, u*, no wrench, at rest."""
    s = method.points(rod.L)
    strain = rod.u_star
    if not layout.inextensible:
        strain = jnp.concatenate([rod.v_star, strain])
    strain = jnp.broadcast_to(strain, (s.shape[0], layout.strain_size))
    h = None
    if layout.attitude:
        turn = s[:, None] * rod.u_star
        h = rod.h_base + turn if layout.planar else quaternion_exp(turn)
        if not layout.planar:
            h = quaternion_product(jnp.broadcast_to(rod.h_base, h.shape), h)
    rest = jnp.zeros((s.shape[0], layout.size - layout.attitude_size))
    return Guess(layout.join(h, rest), strain)


class _Load(NamedTuple):
    """Continuation: solved at `load`; `before` and `before_load` are one step earlier."""

    load: Array
    step: Array
    U: Array
    found: Found
    before: Array
    before_load: Array
    factors: Any
    tries: Array
    running: Array


def search_by_load(equations: Equations, options: NewtonOptions, U, before=None):
    """Raise all loads together from zero to one, in as few steps as is safe.

    A step is taken when Newton's corrections fall fast and undamped from the last answer (by a
    secant), which keeps the solution on its branch. Ordinary scenes take one.
    """
    del before

    def attempt(state):
        load = jnp.minimum(1.0, state.load + state.step)
        ahead = (load - state.load) / jnp.maximum(state.load - state.before_load, 1e-12)
        past = state.found
        ahead = jnp.where(past.load_steps > 1, ahead, 0.0)
        start = state.U + ahead * (state.U - state.before)
        loaded = equations._replace(rod=scaled_loads(equations.rod, load))
        new, found, factors = search_directly(loaded, options, start)
        converged = found.result == RESULTS.successful
        # An unstable answer means that a singular point was stepped over: the path, with its
        # imperfections, passes by its side. Only where the path itself is unstable (a column
        # that is straight for symmetry) do no smaller steps help.
        smallest = state.step / 4 < _SMALLEST_LOAD_STEP
        passes = found.stable | ~past.stable | smallest
        ok = converged & (found.contraction < _SAFE_CONTRACTION) & passes
        step = jnp.where(ok, 2 * state.step, state.step / 4)
        tries = state.tries + 1
        stuck = (~ok & (step < _SMALLEST_LOAD_STEP)) | (tries >= _MAX_LOAD_STEPS)
        finished = ok & (load >= 1.0)
        failure = jnp.where(converged, RESULTS.diverged, found.result).astype(jnp.int32)
        found = found._replace(
            result=jnp.where(finished, found.result, failure),
            stable=jnp.where(ok, found.stable, past.stable),
            iterations=past.iterations + found.iterations,
            load_steps=past.load_steps + ok,
        )
        return _Load(
            load=jnp.where(ok, load, state.load),
            step=step,
            U=jnp.where(ok, new, state.U),
            found=found,
            before=jnp.where(ok, state.U, state.before),
            before_load=jnp.where(ok, state.load, state.before_load),
            factors=factors,
            tries=tries,
            running=~stuck & ~finished,
        )

    zero, none = jnp.zeros((), jnp.int32), jnp.zeros(())
    found = Found(zero, zero, none, none, zero, jnp.array(True))
    factors = no_factors(equations.factorise, U)
    start = _Load(none, jnp.ones(()), U, found, U, none, factors, zero, jnp.array(True))
    end = jax.lax.while_loop(lambda state: state.running, attempt, start)
    return end.U, end.found, end.factors
