"""Motion of a scene under inputs that change with time."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from softrod_jax.collocation import Collocation
from softrod_jax.compiling import compiled
from softrod_jax.inputs import actuation, is_traced, time_step, whole_number
from softrod_jax.marching import Beginning, march
from softrod_jax.method import Method
from softrod_jax.newton import NewtonOptions
from softrod_jax.precision import require_float64
from softrod_jax.results import RESULTS, raise_unless_successful, without_derivative
from softrod_jax.rod import clamp_pose, make_rod
from softrod_jax.rotations import to_base
from softrod_jax.scene import Scene
from softrod_jax.scene_checks import checked_scene, usable_in_time
from softrod_jax.statics import StaticSolution
from softrod_jax.step_control import run_within
from softrod_jax.time_schemes import SDIRK, TimeScheme


class Trajectory(eqx.Module):
    """A motion; entry 0 is the initial state, entry k + 1 the end of step k.

    - `ts` [s], (steps + 1,); `tip_positions` [m], (steps + 1, 3).
    - `tip_velocities` [m/s], (steps + 1, 3), base frame.
    - `positions` [m], (steps + 1, outputs, 3); `quaternions` (w, x, y, z), (steps + 1, outputs, 4).
    - `strains` (v, u) and `velocities` (q, omega), (steps + 1, outputs, 6), body frame.
    - `result`: a code of `RESULTS`; 0 is success. `failed_step`: the first step k that has no
      solution, or -1; from there on the rod is held where it was.
    - `stats`: per step, (steps,): "iterations" (evaluations along the rod), "residual"
      (Newton's last correction, relative to the size of the state), "error" (of the
      discretisation along the rod, estimated, in lengths of the rod; NaN: no estimate) and
      "time_error" (of the tip so far from the steps in time, estimated, in lengths of the rod),
      "substeps"; with a `tolerance` also "intervals".
    """

    ts: Float[Array, "times"]
    tip_positions: Float[Array, "times 3"]
    tip_velocities: Float[Array, "times 3"]
    positions: Float[Array, "times outputs 3"]
    quaternions: Float[Array, "times outputs 4"]
    strains: Float[Array, "times outputs 6"]
    velocities: Float[Array, "times outputs 6"]
    result: Int[Array, ""]
    failed_step: Int[Array, ""]
    stats: dict


def simulate(
    scene: Scene,
    dt,
    tensions: Float[Array, "steps tendons"] | None = None,
    pressures: Float[Array, "steps chambers"] | None = None,
    *,
    steps: int | None = None,
    substeps: int = 1,
    tolerance: float | None = None,
    initial: StaticSolution | None = None,
    scheme: TimeScheme = SDIRK(),
    method: Method = Collocation(),
    newton: NewtonOptions = NewtonOptions(),
    throw: bool = True,
) -> Trajectory:
    """Move the rod from rest. All loads of the scene act from t = 0.

    - `dt` [s]: the time step.
    - `tensions` [N], (steps, tendons), and `pressures` [Pa], (steps, chambers): row k acts from
      ts[k] to ts[k + 1]. Where an input does not jump but varies, row k is its value at
      ts[k + 1], reached linearly. `None` leaves that actuator out.
    - `steps`: how many, where there are no inputs to tell.
    - `substeps`: equal parts into which each step is divided.
    - `tolerance`: choose the substeps, and a finer grid along the rod if need be, so that the
      estimated error of the tip stays below this many lengths of the rod. With `SDIRK` substeps
      differ in length, as the motion asks for. What was chosen is in `stats` as "substeps" and
      "intervals". Not under `jit`, `vmap` or `grad`, which need numbers beforehand: give them
      those found on a typical motion.
    - `initial`: start from this equilibrium (same `method`); from the unloaded rod if `None`. One
      that has not been found has no motion either: its code is that of the motion.
    - `scheme`: `SDIRK` or `BDFAlpha`. `method`: `Collocation` or `Shooting`.
    - `throw`: raise `SolveError` if a step fails; else see `Trajectory.result`.

    Works under `jit`, `vmap`, `grad` and `jacfwd`. Raises `ValueError` for inputs of the wrong
    shape, negative tensions, a step dt <= 0, numbers that a scene cannot have, what contradicts
    `Scene.inextensible` or `Scene.plane`, and without float64.
    """
    require_float64("simulate")
    scene = checked_scene("simulate", scene)
    tensions, pressures = actuation("simulate", scene, tensions, pressures, ndim=2)
    steps = _count_steps(steps, tensions, pressures)
    dt = time_step("simulate", dt)
    if initial is not None and initial.method != method:
        raise ValueError(
            "simulate: `initial` was solved with another method; give both the same `method`"
        )
    begin = None if initial is None else Beginning(initial.point_strains, initial.result)
    substeps = whole_number("simulate", "substeps", substeps)

    def run(substeps, method=method):
        return _simulate(
            scene, dt, tensions, pressures, begin, steps, substeps, scheme, method, newton
        )

    if tolerance is None:
        trajectory = run(substeps)
    else:
        if is_traced(scene, dt, tensions, pressures, begin, tolerance):
            raise ValueError(
                f"simulate: tolerance={tolerance} under jit, vmap or grad; simulate a typical "
                'motion with it first, and give as many substeps as its stats["substeps"] says'
            )
        if not 0 < tolerance < 1:
            raise ValueError(
                f"simulate: tolerance={tolerance}; a part of the rod's length in (0, 1) is needed"
            )
        trajectory = run_within(
            run,
            make_rod(scene),
            float(dt),
            scheme,
            method,
            fixed_grid=initial is not None,
            substeps=substeps,
            tolerance=tolerance,
        )
    if throw:
        trajectory = raise_unless_successful(trajectory.result, trajectory, "simulate")
    return trajectory


def _count_steps(steps, tensions, pressures) -> int:
    lengths = {
        name: n
        for name, n in (
            ("steps", None if steps is None else whole_number("simulate", "steps", steps)),
            ("tensions", None if tensions is None else tensions.shape[0]),
            ("pressures", None if pressures is None else pressures.shape[0]),
        )
        if n is not None
    }
    if not lengths:
        raise ValueError("simulate: no inputs; say how many `steps`")
    if len(set(lengths.values())) > 1:
        raise ValueError(f"simulate: lengths disagree: {lengths}; one row a step is needed")
    count = int(next(iter(lengths.values())))
    if count < 1:
        raise ValueError(f"simulate: {count} steps; at least 1 is needed")
    return count


@compiled
def _simulate(scene, dt, tensions, pressures, begin, steps, substeps, scheme, method, options):
    scene, dt, good = usable_in_time(scene, dt)
    inputs = (tensions, pressures)
    strains, velocities, results, stats = march(
        scene, dt, inputs, begin, steps, substeps, scheme, method, options, good
    )
    base, h_base = clamp_pose(scene)
    positions, quaternions = jax.vmap(
        lambda strain: method.shape(strain, scene.length, base, h_base)
    )(strains)
    failed = results != RESULTS.successful
    error = _time_error(positions[:, -1], scheme, stats["substeps"])
    return without_derivative(
        results[-1] != RESULTS.successful,
        Trajectory(
            ts=dt * jnp.arange(steps + 1),
            tip_positions=positions[:, -1],
            tip_velocities=to_base(quaternions[:, -1], velocities[:, -1, :3]),
            positions=positions,
            quaternions=quaternions,
            strains=jax.vmap(method.outputs)(strains),
            velocities=velocities,
            result=results[-1],
            failed_step=jnp.where(jnp.any(failed), jnp.argmax(failed), -1),
            stats={**stats, "time_error": error / scene.length},
        ),
    )


def _time_error(tip: Float[Array, "times 3"], scheme: TimeScheme, substeps):
    """Estimated error of the tip [m] from the steps in time, (steps,), growing.

    The sum of C |dt^(p + 1) p^(p + 1)| over all steps, by differences of the tip's path. After a
    jump, and where a step does not resolve the motion, it is too large rather than too small.
    """
    order = scheme.order
    path = jnp.concatenate([jnp.broadcast_to(tip[0], (order, 3)), tip])
    local = jnp.linalg.norm(jnp.diff(path, order + 1, axis=0) + 1e-300, axis=-1)
    return scheme.error_constant * jnp.cumsum(local / jnp.asarray(substeps, float) ** order)
