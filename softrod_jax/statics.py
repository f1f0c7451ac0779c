"""Static equilibrium of a scene under constant actuation."""

import logging
from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, Real

from softrod_jax.bvp.boundary_value import (
    solve_boundary_value,
)
from softrod_jax.bvp.collocation import Collocation
from softrod_jax.bvp.dynamic_relaxation import dynamic_relaxation
from softrod_jax.bvp.equations import loads_of
from softrod_jax.bvp.grid_control import (
    DEFAULT_TOLERANCE,
    first_grid,
    needed_intervals,
    solve_within,
)
from softrod_jax.bvp.load_continuation import SAFE_CONTRACTION, Reached, search_by_load
from softrod_jax.bvp.method import AbstractMethod
from softrod_jax.bvp.newton import NewtonOptions
from softrod_jax.bvp.unloaded import unloaded_guess
from softrod_jax.foundation.compiling import compiled
from softrod_jax.foundation.numbers import ScalarLike
from softrod_jax.foundation.precision import require_float64
from softrod_jax.foundation.results import RESULTS, raise_unless_successful, without_derivative
from softrod_jax.foundation.tracing import is_traced
from softrod_jax.rod.constants import full_strain, inner_strain
from softrod_jax.rod.given_lengths import held_of, path_shortening, tensions_of
from softrod_jax.rod.markers import seen
from softrod_jax.rod.ode import contact_forces, slid_after
from softrod_jax.rod.reduction import clamp_pose, make_rod, where_active
from softrod_jax.rod.shape import Pose, pose_between, strain_between
from softrod_jax.rod.state import layout_of
from softrod_jax.rod.validity import usable
from softrod_jax.scene.checks import checked_scene
from softrod_jax.scene.contacts import contact_names
from softrod_jax.scene.inputs import (
    Inputs,
    after_play,
    checked_inputs,
    filled,
    good_inputs,
    zero_unless,
)
from softrod_jax.scene.planes import in_space
from softrod_jax.scene.scene import Scene
from softrod_jax.scene.tendons import rubbing

_LOG = logging.getLogger(__name__)


class StaticSolution(eqx.Module):
    """A static equilibrium.

    - `tip_position` [m], (3,); `tip_quaternion` (w, x, y, z), (4,).
    - `arc_lengths` [m], (outputs,); `positions` [m], (outputs, 3); `quaternions`, (outputs, 4).
      Where along the rod is up to the method: its nodes, or the ends of its steps.
    - `strains` (v, u), (outputs, 6): v [-], u [1/m], body frame.
    - `wrenches` (N, M), (outputs, 6): *total* force [N] and moment [N m], body frame.
    - `tensions` [N], (tendons,): of all tendons, at the end where their actuator is; those of
      tendons driven by length follow from their pulls, and are 0 where they are slack.
    - `tensions_along` [N], (outputs, tendons): along the rod, where friction takes from them; zero
      where a tendon is not.
    - `pulls` [m]: those that tendons have followed, behind the play of their actuators.
    - `held`, (conditions,): what holds each of the scene's `conditions`, 0 where nothing must.
    - `markers`: by name, "tip" among them, a `Pose` (`position` [m], (3,), `quaternion`, (4,)).
    - `contact_force`: by the name of each contact, the force [N], (3,), with which its obstacle
      pushes the rod, base frame.
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
    tensions: Float[Array, "tendons"]
    tensions_along: Float[Array, "outputs tendons"]
    pulls: Float[Array, "by_length"]
    held: Float[Array, "conditions"]
    markers: dict[str, Pose]
    contact_force: dict[str, Float[Array, "3"]]
    result: Int[Array, ""]
    stats: dict
    point_strains: Float[Array, "points 6"]
    reached: Reached
    method: AbstractMethod = eqx.field(static=True)

    def at(self, s) -> Pose:
        """The pose of the section at arc length `s` [m], a number that can be traced."""
        return _pose_at(self, jnp.asarray(s, dtype=float))

    def strain_at(self, s) -> Float[Array, "6"]:
        """The strains (v [-], u [1/m]) at arc length `s` [m], body frame; where they jump, those
        beyond."""
        return _strain_at(self, jnp.asarray(s, dtype=float))


@compiled
def _pose_at(found: StaticSolution, s) -> Pose:
    inside = found.method.inside(found.point_strains)
    return pose_between(inside, found.arc_lengths, found.positions, found.quaternions, s)


@compiled
def _strain_at(found: StaticSolution, s) -> Float[Array, "6"]:
    return strain_between(found.method.inside(found.point_strains), found.arc_lengths, s)


def solve_static(
    scene: Scene,
    tensions: Real[Array | np.ndarray, "by_tension"] | Sequence[ScalarLike] | None = None,
    pressures: Real[Array | np.ndarray, "chambers"] | Sequence[ScalarLike] | None = None,
    pulls: Real[Array | np.ndarray, "by_length"] | Sequence[ScalarLike] | None = None,
    *,
    before: StaticSolution | None = None,
    sliding: Sequence[float] | np.ndarray | None = None,
    method: AbstractMethod | None = None,
    newton: NewtonOptions = NewtonOptions(),
    tolerance: float | None = None,
    throw: bool = True,
) -> StaticSolution:
    """The equilibrium reached by raising all loads together from zero, or from those `before`.

    Where several exist, it is the one that the unloaded rod moves to if the loads rise slowly.
    Where that path ends, as in snapping or buckling, a heavily damped motion goes on from there.
    Tendons with friction remember where they have slid: the equilibrium depends on the path of the
    inputs, of which this call is one straight piece. `solve_path` takes many.

    - `tensions` [N], one for each tendon that is driven by tension, `pressures` [Pa], (chambers,),
      and `pulls` [m], one for each tendon that is driven by length: by how much its actuator
      shortens it. `None` leaves those actuators out.
    - `before`: the equilibrium in which the rod was before, of the same scene; the unloaded rod if
      `None`. Its method is this one's, too.
    - `sliding`: for each tendon with friction the direction in which it slides, 1 towards its
      actuator, as when it is pulled, or -1, whatever was before.
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
    given, scene = scene, checked_scene("solve_static", scene)
    inputs = checked_inputs("solve_static", scene, Inputs(tensions, pressures, pulls), ndim=1)
    past = None if before is None else before.reached
    directions = _directions(scene, sliding)
    arguments = (scene, inputs, past, directions)
    traced = is_traced(arguments)
    if tolerance is not None and (traced or is_traced(tolerance) or not 0 < tolerance < 1):
        raise ValueError(
            f"solve_static: tolerance={tolerance}; a part of the rod's length in (0, 1) is needed, "
            "and not under jit, vmap or grad: there, give a method with enough intervals"
        )
    if before is not None:
        if method is not None and method.fitted(given) != before.method:
            raise ValueError("solve_static: `before` was solved with another method; leave it out")
        method = before.method
    if method is None and not traced:
        method, tolerance = first_grid(Collocation(), scene), tolerance or DEFAULT_TOLERANCE
    method = (Collocation() if method is None else method).fitted(given)
    solve = lambda method: _solve(*arguments, method, newton, traced)
    solution = solve(method) if tolerance is None else solve_within(solve, method, tolerance)
    if not traced and _LOG.isEnabledFor(logging.DEBUG):
        _LOG.debug(
            "equilibrium: %s, %d iterations, %d load steps, %d intervals along the rod",
            RESULTS(int(solution.result)).name,
            solution.stats["iterations"],
            solution.stats["load_steps"],
            solution.method.intervals,
        )
    if throw:
        solution = raise_unless_successful(solution.result, solution, "solve_static")
    return solution


def tendon_pulls(scene: Scene, solution: StaticSolution) -> Float[Array, "tendons"]:
    """By how much the path of each tendon is shorter than in the unloaded rod [m].

    Pulled by that much, tendons that do not stretch and are driven by length hold `scene` in the
    same equilibrium, with the same tensions.
    """
    if scene.tendons is None:
        return jnp.zeros(0)
    return _tendon_pulls(checked_scene("tendon_pulls", scene), solution)


@compiled
def _tendon_pulls(scene: Scene, solution: StaticSolution) -> Float[Array, "tendons"]:
    assert scene.tendons is not None
    grid = solution.method.grid(scene)
    rod = make_rod(scene, filled(scene, Inputs()), dynamic=False, grid=grid)
    there = where_active(scene, grid, scene.tendons)
    return path_shortening(rod, inner_strain(solution.point_strains, rod), there)


def _directions(scene: Scene, sliding) -> Float[Array, "rubbing"] | None:
    """Checked: `ValueError` unless there is 1 or -1 for each tendon with friction."""
    if sliding is None:
        return None
    count = 0 if scene.tendons is None else len(rubbing(scene.tendons))
    known = np.asarray(sliding, dtype=float)
    if known.shape != (count,) or not np.all(np.abs(known) == 1):
        raise ValueError(
            f"solve_static: sliding={sliding!r}; expected 1 (towards the actuator) or -1 for each "
            f"of the {count} tendons with friction"
        )
    return jnp.asarray(known)


def _solve(scene, inputs, past, directions, method, options, traced):
    problem = scene, inputs, past, directions
    solution = solve_from(*problem, method, options)
    if not traced and int(solution.result) in (RESULTS.diverged, RESULTS.max_iterations):
        _LOG.info(
            "the path of equilibria under rising loads ends; a damped motion goes on from there"
        )
        solution = _relaxed(*problem, method, options)
        said = RESULTS(int(solution.result)).name, int(solution.stats["transient_steps"])
        _LOG.info("the damped motion: %s after %d steps", *said)
    return solution


@compiled
def solve_from(scene, inputs, past, directions, method, options):
    """The equilibrium after `past`, a `Reached`, of what has been checked."""
    inputs = after_play(scene, inputs, None if past is None else past.pulls)
    scene, rod, valid, layout, guess, loads = _problem(scene, inputs, past, directions, method)
    solved = solve_boundary_value(method, layout, options, rod, None, guess, search_by_load, loads)
    none = jnp.zeros((), jnp.int32)
    return _solution(scene, inputs, rod, method, solved, valid, none)


@compiled
def _relaxed(scene, inputs, past, directions, method, options):
    """By a damped motion, and Newton's method from where it comes to rest."""
    inputs = after_play(scene, inputs, None if past is None else past.pulls)
    scene, rod, valid, layout, guess, _ = _problem(scene, inputs, past, directions, method)
    rest = dynamic_relaxation(method, layout, options, rod, guess)
    solved = solve_boundary_value(method, layout, options, rod, None, rest.guess)
    found = solved.found
    # A rod that still creeps is on its way to the stable equilibrium in whose basin it is.
    close = found.stable & (found.contraction < SAFE_CONTRACTION)
    arrives = rest.at_rest | (rest.loaded & close)
    moving = jnp.where(arrives, found.result, RESULTS.diverged).astype(jnp.int32)
    solved = solved._replace(found=found._replace(result=moving))
    return _solution(scene, inputs, rod, method, solved, valid, rest.steps)


def _problem(scene, inputs, past, directions, method):
    """The scene and its rod, whether they can be, and where the search begins."""
    scene, valid = usable(scene, good_inputs(inputs), inputs)
    rod = make_rod(scene, zero_unless(valid, inputs), dynamic=False, grid=method.grid(scene))
    layout = layout_of(rod, dynamic=False)
    guess, loads = unloaded_guess(layout, rod), None
    if past is not None:
        ok = valid & jnp.all(jnp.isfinite(past.guess.y))
        guess = jax.tree.map(lambda a, b: jnp.where(ok, a, b), past.guess, guess)
        loads = jax.tree.map(lambda x: jnp.where(ok, x, 0.0), past.loads)
    rod = rod.having_slid(None if past is None else past.slid, directions)
    return scene, rod, valid, layout, guess, jax.lax.stop_gradient(loads)


def _solution(scene, inputs, rod, method, solved, valid, transient_steps):
    result = jnp.where(valid, solved.found.result, RESULTS.bad_input).astype(jnp.int32)
    fields, error = solved.fields, solved.found.error
    tensions = tensions_of(scene, inputs.tensions, fields.multipliers)
    layout = layout_of(rod, dynamic=False)
    strain = full_strain(fields.strain, rod)
    positions, quaternions = method.shape(strain, rod.grid, *clamp_pose(scene))
    nodes = method.outputs(rod.grid.s)
    wrench = method.outputs(fields.y)[:, -layout.pair :]
    solution = StaticSolution(
        tip_position=positions[-1],
        tip_quaternion=quaternions[-1],
        arc_lengths=nodes,
        positions=positions,
        quaternions=quaternions,
        strains=method.outputs(strain),
        wrenches=in_space(wrench, rod.plane),
        tensions=tensions,
        tensions_along=method.outputs(_tensions_along(rod, layout, fields, tensions.shape[0])),
        pulls=jnp.zeros(0) if inputs.pulls is None else jnp.asarray(inputs.pulls),
        held=held_of(scene, fields.multipliers),
        markers=seen(scene, method.inside(strain), nodes, positions, quaternions),
        contact_force=dict(
            zip(contact_names(scene.contacts), contact_forces(fields.y, rod, layout), strict=True)
        ),
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
        reached=Reached(fields, loads_of(rod), slid_after(fields, rod, layout), inputs.pulls),
        method=method,
    )
    # On a coarse grid there is an answer, and so there is a derivative.
    answered = (result == RESULTS.successful) | (result == RESULTS.inaccurate)
    return without_derivative(~answered, solution)


def _tensions_along(rod, layout, fields, count: int):
    """The tensions of all tendons at all points: zero where a tendon is not."""
    points = fields.y.shape[0]
    rod = rod.under(fields.multipliers)
    if rod.friction is not None:
        rod = rod.rubbing(layout.losses_and_slips(fields.y)[0])
    tau = jnp.zeros(count) if rod.tau is None else rod.tau
    return jnp.broadcast_to(tau, (points, count))
