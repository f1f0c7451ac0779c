"""Motion of a scene under inputs that change with time."""

import functools
from collections.abc import Mapping, Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, Real

from softrod_jax.bvp.collocation import Collocation
from softrod_jax.bvp.grid_control import first_grid
from softrod_jax.bvp.method import AbstractMethod
from softrod_jax.bvp.newton import NewtonOptions
from softrod_jax.foundation.compiling import compiled
from softrod_jax.foundation.numbers import ManyLike, ScalarLike
from softrod_jax.foundation.precision import require_float64
from softrod_jax.foundation.results import RESULTS, raise_unless_successful, without_derivative
from softrod_jax.foundation.tracing import is_traced
from softrod_jax.rod.given_lengths import held_of, tensions_of
from softrod_jax.rod.markers import seen
from softrod_jax.rod.reduction import clamp_pose
from softrod_jax.rod.rotations import to_base
from softrod_jax.rod.shape import strain_between
from softrod_jax.rod.validity import usable_in_time
from softrod_jax.scene.checks import checked_scene
from softrod_jax.scene.contacts import contact_names
from softrod_jax.scene.inputs import (
    Inputs,
    after_play_in_time,
    checked_inputs,
    time_step,
    whole_number,
)
from softrod_jax.scene.poses import Poses, PosesLike, checked_poses
from softrod_jax.scene.scene import Scene
from softrod_jax.scene.tendons import driven_by_length
from softrod_jax.statics import StaticSolution
from softrod_jax.stepping.courses import Course, courses_of
from softrod_jax.stepping.marching import march, stepping_of
from softrod_jax.stepping.moving_rod import Beginning
from softrod_jax.stepping.scheme import AbstractTimeScheme
from softrod_jax.stepping.sdirk import SDIRK
from softrod_jax.stepping.step_control import advice, run_checked, run_within
from softrod_jax.stepping.substeps import MOST_SUBSTEPS
from softrod_jax.tables import motion_dataset, motion_frame


class Track(eqx.Module):
    """Where a marker goes: `positions` [m], (times, 3), and `quaternions`, (times, 4); `strains`
    (v, u) of the rod at its place, (times, 6), body frame."""

    positions: Float[Array, "times 3"]
    quaternions: Float[Array, "times 4"]
    strains: Float[Array, "times 6"]


class Trajectory(eqx.Module):
    """A motion; entry 0 is the initial state, entry k + 1 the end of step k.

    - `ts` [s], (steps + 1,); `tip_positions` [m], (steps + 1, 3).
    - `tip_velocities` [m/s], (steps + 1, 3), base frame.
    - `positions` [m], (steps + 1, outputs, 3); `quaternions` (w, x, y, z), (steps + 1, outputs, 4).
    - `strains` (v, u) and `velocities` (q, omega), (steps + 1, outputs, 6), body frame.
    - `arc_lengths` [m], (outputs,).
    - `tensions` [N], (steps + 1, tendons): of all tendons, at the end where their actuator is.
    - `held`, (steps + 1, conditions): what holds each of the scene's `conditions`.
    - `markers`: by name, "tip" among them, a `Track` with `positions` [m], (steps + 1, 3), and
      `quaternions`, (steps + 1, 4), and the rod's `strains` there, (steps + 1, 6).
    - `contact_forces`: by the name of each contact, the force [N], (steps + 1, 3), with which its
      obstacle pushes the rod, base frame.
    - `base_wrenches`, (steps + 1, 6): total force [N] and moment [N m] at the base, body frame,
      with which the robot, its actuators mounted on its base, pushes what carries that.
    - `result`: a code of `RESULTS`; 0 is success. `failed_step`: the first step k that has no
      solution, or -1; from there on the rod is held where it was. Where steps are too long for the
      motion (`inaccurate`, and "time_error" above its limit), the first whose error is too large;
      the rod then moves on.
    - `stats`: per step, (steps,): "iterations" (evaluations along the rod), "residual"
      (Newton's last correction, relative to the size of the state), "error" (of the
      discretisation along the rod, estimated, in lengths of the rod; NaN: no estimate) and
      "time_error" (of the tip so far from the steps in time, estimated, in lengths of the rod),
      "substeps"; with obstacles "touch_error" (of the tip so far from what the grid misses of their
      push, estimated, in lengths); and one number, "needed_substeps" (that keep "time_error" below
      its limit, about); outside `jit` also "intervals".
    """

    ts: Float[Array, "times"]
    tip_positions: Float[Array, "times 3"]
    tip_velocities: Float[Array, "times 3"]
    positions: Float[Array, "times outputs 3"]
    quaternions: Float[Array, "times outputs 4"]
    strains: Float[Array, "times outputs 6"]
    velocities: Float[Array, "times outputs 6"]
    arc_lengths: Float[Array, "outputs"]
    tensions: Float[Array, "times tendons"]
    held: Float[Array, "times conditions"]
    markers: dict[str, Track]
    contact_forces: dict[str, Float[Array, "times 3"]]
    base_wrenches: Float[Array, "times 6"]
    result: Int[Array, ""]
    failed_step: Int[Array, ""]
    stats: dict

    def to_pandas(self):
        """A `pandas.DataFrame` with a row for each time (`softrod_jax.tables`); extra `tables`."""
        return motion_frame(self)

    def to_xarray(self):
        """An `xarray.Dataset` of the whole rod (`softrod_jax.tables`); extra `tables`."""
        return motion_dataset(self)


def simulate(
    scene: Scene,
    dt: ScalarLike,
    tensions: Real[Array | np.ndarray, "steps by_tension"] | Sequence[ManyLike] | None = None,
    pressures: Real[Array | np.ndarray, "steps chambers"] | Sequence[ManyLike] | None = None,
    pulls: Real[Array | np.ndarray, "steps by_length"] | Sequence[ManyLike] | None = None,
    *,
    base: PosesLike | None = None,
    contacts: Mapping[str, PosesLike] | None = None,
    steps: int | None = None,
    substeps: int | None = None,
    tolerance: float | None = None,
    max_time_error: ScalarLike = 1e-2,
    initial: StaticSolution | None = None,
    scheme: AbstractTimeScheme = SDIRK(),
    method: AbstractMethod | None = None,
    newton: NewtonOptions = NewtonOptions(),
    throw: bool = True,
) -> Trajectory:
    """Move the rod from rest. All loads of the scene act from t = 0.

    - `dt` [s]: the time step.
    - `tensions` [N], (steps, tendons driven by tension), `pressures` [Pa], (steps, chambers), and
      `pulls` [m], (steps, tendons driven by length): row k acts from ts[k] to ts[k + 1]. Where an
      input does not jump but varies, row k is its value at ts[k + 1], reached linearly; pulls,
      which say where an actuator is, never jump. `None` leaves those actuators out.
    - `base`: where the clamp is carried, (steps, 7): its position [m] and quaternion (w, x, y, z)
      at the end of each step; or a pair of both, (steps, 3) and (steps, 4). It begins in the
      scene's `base_position` and `base_quaternion`, at rest, and moves along a smooth curve through
      these poses.
    - `contacts`: where obstacles are carried, by their names, in the same form. Each is
      where the scene has it, moved by its pose, which begins at position 0, quaternion 1, 0, 0, 0.
    - `steps`: how many, where there are no inputs to tell.
    - `substeps`: equal parts into which each step is divided. `None`: one, and more where the
      tip is off by more than `max_time_error` or the motion breaks off, and substeps can still be
      chosen, which is outside of `jit`, `vmap` and `grad`: then so many that two motions agree
      within 0.3 of that.
    - `tolerance`: choose the substeps, and a finer grid along the rod if need be, so that the
      estimated error of the tip stays below this many lengths of the rod. With `SDIRK` substeps
      differ in length, as the motion asks for. What was chosen is in `stats` as "substeps" and
      "intervals". Not under `jit`, `vmap` or `grad`, which need numbers beforehand: give them
      those found on a typical motion.
    - `max_time_error`: above this estimated error of the tip from the steps in time, in lengths,
      the code is `inaccurate`; `stats["needed_substeps"]` says what would do. The estimate of one
      motion is 0.8 to 120 times its error in nine of ten wide motions, in the median 4 times; two
      of 115, off by a tenth of the rod as their steps miss how it snaps, had 0.15 and 0.3. Outside
      of `jit`, `vmap` and `grad`, from 0.4 of the limit on, a second motion with more care decides.
    - `initial`: start from this equilibrium (same `method`); from the unloaded rod if `None`. One
      that has not been found has no motion either: its code is that of the motion.
    - `scheme`: `SDIRK` or `BDFAlpha`. `method`: `Collocation` or `Shooting`, on the grid as given.
      `None`: that of `initial`, or `Collocation()`, refined where the estimated error along the rod
      is above 1e-4 lengths, outside of `jit`, `vmap` and `grad`.
    - `throw`: raise `SolveError` if a step fails; else see `Trajectory.result`.

    Works under `jit`, `vmap`, `grad` and `jacfwd`. Raises `ValueError` for inputs of the wrong
    shape, negative tensions, a step dt <= 0, numbers that a scene cannot have, what contradicts
    `Scene.inextensible` or `Scene.plane`, and without float64.
    """
    require_float64("simulate")
    given, scene = scene, checked_scene("simulate", scene)
    inputs = checked_inputs("simulate", scene, Inputs(tensions, pressures, pulls), ndim=2)
    poses = checked_poses("simulate", scene, base, contacts)
    steps = _count_steps(steps, inputs, poses)
    dt = time_step("simulate", dt)
    fixed_grid = method is not None or initial is not None
    if method is None:
        known = not is_traced(scene.rest_curvature, scene.length)
        method = first_grid(Collocation(), scene) if known else Collocation()
        method = method if initial is None else initial.method
    method = method.fitted(given)
    if initial is not None and initial.method != method:
        raise ValueError(
            "simulate: `initial` was solved with another method; give both the same `method`"
        )
    begin = None if initial is None else beginning_in(initial, scene)
    fixed_steps = substeps is not None
    substeps = whole_number("simulate", "substeps", substeps) if fixed_steps else 1
    limit = jnp.asarray(max_time_error, dtype=float)
    traced = is_traced(scene, dt, inputs, poses, begin, tolerance, limit)

    def run(substeps, method=method, limit=limit):
        how = steps, substeps, scheme, method, newton, limit
        return _simulate(scene, dt, inputs, poses, begin, *how)

    if tolerance is None and traced:
        trajectory = run(substeps)
    elif tolerance is None:
        trajectory = run_checked(
            run,
            scene,
            float(dt),
            scheme,
            method,
            fixed_grid=fixed_grid,
            fixed_steps=fixed_steps,
            substeps=substeps,
            limit=float(limit),
        )
    else:
        _check_tolerance(tolerance, traced)
        trajectory = run_within(
            functools.partial(run, limit=jnp.array(jnp.inf, dtype=float)),
            scene,
            float(dt),
            scheme,
            method,
            fixed_grid=initial is not None,
            substeps=substeps,
            tolerance=tolerance,
        )
    if throw:
        hint = "" if traced else advice(trajectory, float(dt), float(limit))
        trajectory = raise_unless_successful(trajectory.result, trajectory, "simulate", hint)
    return trajectory


def _check_tolerance(tolerance, traced: bool) -> None:
    if traced:
        raise ValueError(
            f"simulate: tolerance={tolerance} under jit, vmap or grad; simulate a typical "
            'motion with it first, and give as many substeps as its stats["substeps"] says'
        )
    if not 0 < tolerance < 1:
        raise ValueError(
            f"simulate: tolerance={tolerance}; a part of the rod's length in (0, 1) is needed"
        )


def _count_steps(steps, inputs: Inputs, poses: Poses) -> int:
    lengths = {} if steps is None else {"steps": whole_number("simulate", "steps", steps)}
    lengths |= {name: x.shape[0] for name, x in inputs._asdict().items() if x is not None}
    lengths |= {name: x.shape[0] for name, x in poses.named.items()}
    if not lengths:
        raise ValueError("simulate: no inputs; say how many `steps`")
    if len(set(lengths.values())) > 1:
        raise ValueError(f"simulate: lengths disagree: {lengths}; one row a step is needed")
    count = int(next(iter(lengths.values())))
    if count < 1:
        raise ValueError(f"simulate: {count} steps; at least 1 is needed")
    return count


def beginning_in(initial: StaticSolution, scene: Scene) -> Beginning:
    """How a motion of `scene` begins in an equilibrium of it."""
    by_length = driven_by_length(scene.tendons)
    found = initial.tensions[jnp.array(by_length)] if by_length else None
    if scene.conditions is not None:
        found = initial.held if found is None else jnp.concatenate([found, initial.held])
    pulls, slid = initial.pulls if by_length else None, initial.reached.slid
    pushes = None
    if scene.contacts is not None:
        pushes = jnp.stack([initial.contact_force[x] for x in contact_names(scene.contacts)])
    now = Inputs(pulls=pulls)
    wrench = initial.wrenches[0]
    return Beginning(initial.point_strains, initial.result, found, now, slid, pushes, wrench)


def _strains_at(scene: Scene, name: str, inside, nodes) -> Float[Array, "times 6"]:
    """The strains at the place of a marker, of all times."""
    places = {marker.name: marker.at for marker in scene.markers or ()}
    at = places.get(name)
    if at is None:
        return inside[:, -1, -1]
    return jax.vmap(lambda strain: strain_between(strain, nodes, at))(inside)


def _by_name(scene: Scene, pushes: Float[Array, "times contacts 3"]):
    return dict(zip(contact_names(scene.contacts), jnp.swapaxes(pushes, 0, 1), strict=True))


def _from_start(inputs: Inputs, begin: Beginning | None):
    """The tensions that are given, (steps + 1, ...): those of the beginning before all others."""
    if inputs.tensions is None:
        return None
    tensions = jnp.asarray(inputs.tensions)
    first = jnp.zeros_like(tensions[:1]) if begin is None else tensions[:1]
    return jnp.concatenate([first, tensions])


def _clamp_in_time(clamp, base: Course | None, steps: int):
    """Positions, (steps + 1, 3), and quaternions, (steps + 1, 4)."""
    if base is None:
        return tuple(jnp.tile(x, (steps + 1, 1)) for x in clamp)
    own = base.now[:, :3], base.now[:, 3:]
    return tuple(jnp.concatenate([x[None], rows]) for x, rows in zip(clamp, own))


@compiled
def _simulate(scene, dt, inputs, poses, begin, steps, substeps, scheme, method, options, limit):
    scene, dt, good = usable_in_time(scene, dt)
    first = jax.tree.map(lambda x: x[0], inputs)
    inputs = after_play_in_time(scene, inputs, None if begin is None else begin.inputs.pulls)
    stepping = stepping_of(scene, dt, first, substeps, scheme, method, options)
    clamp = clamp_pose(scene)
    courses = courses_of(poses, clamp)
    strains, velocities, results, found, stats, wrenches, pushes = march(
        stepping, inputs, begin, steps, good, courses
    )
    grid = method.grid(scene)
    positions, quaternions = jax.vmap(lambda strain, *clamp: method.shape(strain, grid, *clamp))(
        strains, *_clamp_in_time(clamp, courses.base, steps)
    )
    nodes = method.outputs(grid.s)
    inside = jax.vmap(method.inside)(strains)
    poses = seen(scene, inside, nodes, positions, quaternions)
    error = jax.lax.cummax(stats["time_error"])
    # A step that has no solution is the last one. Others may be inaccurate by themselves.
    solved = (results[-1] == RESULTS.successful) | (results[-1] == RESULTS.inaccurate)
    bad_step = (results != RESULTS.successful) | (error > limit)
    failed = jnp.where(solved, bad_step, results == results[-1])
    inaccurate = solved & jnp.any(failed)
    result = jnp.where(inaccurate, RESULTS.inaccurate, results[-1]).astype(jnp.int32)
    more = jnp.maximum(error[-1] / limit, 1.0) ** (1 / scheme.order)
    needed = jnp.ceil(jnp.max(stats["substeps"]) * jnp.minimum(more, MOST_SUBSTEPS))
    return without_derivative(
        ~solved,
        Trajectory(
            ts=dt * jnp.arange(steps + 1),
            tip_positions=positions[:, -1],
            tip_velocities=to_base(quaternions[:, -1], velocities[:, -1, :3]),
            positions=positions,
            quaternions=quaternions,
            strains=jax.vmap(method.outputs)(strains),
            velocities=velocities,
            arc_lengths=nodes,
            tensions=tensions_of(scene, _from_start(inputs, begin), found, (steps + 1,)),
            held=held_of(scene, found, (steps + 1,)),
            markers={
                name: Track(x.position, x.quaternion, _strains_at(scene, name, inside, nodes))
                for name, x in poses.items()
            },
            contact_forces={} if pushes is None else _by_name(scene, pushes),
            base_wrenches=wrenches,
            result=result,
            failed_step=jnp.where(jnp.any(failed), jnp.argmax(failed), -1),
            stats={**stats, "time_error": error, "needed_substeps": needed.astype(jnp.int32)},
        ),
    )
