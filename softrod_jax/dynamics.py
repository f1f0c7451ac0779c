"""Motion of a scene under inputs that change with time."""

from typing import NamedTuple, Optional

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from softrod_jax.boundary_value import solve_boundary_value
from softrod_jax.collocation import Collocation
from softrod_jax.inputs import actuation, valid_actuation
from softrod_jax.method import Guess, Method
from softrod_jax.newton import NewtonOptions
from softrod_jax.precision import require_float64
from softrod_jax.results import RESULTS, raise_unless_successful
from softrod_jax.rod import make_rod
from softrod_jax.rod_ode import History, Layout
from softrod_jax.rotations import to_base
from softrod_jax.scene import Scene, as_arrays
from softrod_jax.statics import StaticSolution, unloaded_guess
from softrod_jax.time_schemes import BDFAlpha, TimeScheme, jumps


class Trajectory(eqx.Module):
    """A motion; entry 0 is the initial state, entry k + 1 the end of step k.

    - `ts` [s], (steps + 1,); `tip_positions` [m], (steps + 1, 3).
    - `tip_velocities` [m/s], (steps + 1, 3), base frame.
    - `positions` [m], (steps + 1, outputs, 3); `quaternions` (w, x, y, z), (steps + 1, outputs, 4).
    - `strains` (v, u) and `velocities` (q, omega), (steps + 1, outputs, 6), body frame.
    - `result`: a code of `RESULTS`; 0 is success. `failed_step`: the first step k that has no
      solution, or -1; from there on the rod is held where it was.
    - `stats`: per step, (steps,): "iterations" (evaluations along the rod), "residual"
      (Newton's last correction, relative to the size of the state) and "error" (of the
      discretisation along the rod, estimated, in lengths of the rod; NaN: no estimate).
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
    tensions: Optional[Float[Array, "steps tendons"]] = None,
    pressures: Optional[Float[Array, "steps chambers"]] = None,
    *,
    steps: Optional[int] = None,
    initial: Optional[StaticSolution] = None,
    scheme: TimeScheme = BDFAlpha(),
    method: Method = Collocation(),
    newton: NewtonOptions = NewtonOptions(),
    throw: bool = True,
) -> Trajectory:
    """Move the rod from rest. All loads of the scene act from t = 0.

    - `dt` [s]: the time step.
    - `tensions` [N], (steps, tendons), and `pressures` [Pa], (steps, chambers): row k acts from
      ts[k] to ts[k + 1]. `None` leaves that actuator out.
    - `steps`: how many, where there are no inputs to tell.
    - `initial`: start from this equilibrium (same `method`); from the unloaded rod if `None`.
    - `scheme`: `BDFAlpha` or `SDIRK`. `method`: `Collocation` or `Shooting`.
    - `throw`: raise `SolveError` if a step fails; else see `Trajectory.result`.

    Works under `jit`, `vmap`, `grad` and `jacfwd`. Raises `ValueError` for inputs of the wrong
    shape, negative tensions, a step dt <= 0, and without float64.
    """
    require_float64("simulate")
    scene = as_arrays(scene)
    tensions, pressures = actuation("simulate", scene, tensions, pressures, ndim=2)
    steps = _count_steps(steps, tensions, pressures)
    dt = jnp.asarray(dt, dtype=float)
    if not isinstance(dt, jax.core.Tracer) and not (dt.ndim == 0 and 0 < dt < np.inf):
        raise ValueError(f"simulate: dt={dt} s; a positive number is needed")
    if initial is not None and initial.method != method:
        raise ValueError(
            "simulate: `initial` was solved with another method; give both the same `method`"
        )
    strain = None if initial is None else initial.point_strains
    trajectory = _simulate(scene, dt, tensions, pressures, strain, steps, scheme, method, newton)
    if throw:
        trajectory = raise_unless_successful(trajectory.result, trajectory, "simulate")
    return trajectory


def _count_steps(steps, tensions, pressures) -> int:
    lengths = {
        name: n
        for name, n in (
            ("steps", steps),
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


class _Fields(NamedTuple):
    """What has a history: strains (v, u) and velocities (q, omega), (points, 6) each."""

    strain: Float[Array, "points 6"]
    velocity: Float[Array, "points 6"]


class _Running(NamedTuple):
    """What a step hands to the next, besides the memory of the time scheme."""

    guess: Guess
    result: Int[Array, ""]
    iterations: Int[Array, ""]
    correction: Float[Array, ""]
    error: Float[Array, ""]


@eqx.filter_jit
def _simulate(scene, dt, tensions, pressures, strain, steps, scheme, method, options):
    def rod_under(tau, pressure):
        return valid_actuation(make_rod(scene, tau, pressure))

    first = [None if x is None else x[0] for x in (tensions, pressures)]
    rod, _ = rod_under(*first)
    layout = Layout(attitude=rod.has_dead_load, dynamic=True)
    guess = unloaded_guess(method, layout, rod)
    if strain is not None:
        guess = guess._replace(strain=strain)
    fields = _Fields(guess.strain, jnp.zeros_like(guess.strain))

    def step(state, inputs):
        memory, running = state
        coefficients, tau, pressure = inputs
        rod, valid = rod_under(tau, pressure)

        def solve(c0, history, running):
            solved = solve_boundary_value(
                method,
                layout,
                options,
                rod,
                History(c0, history.strain, history.velocity),
                running.guess,
            )
            found, fields = solved.found, solved.fields
            result = jnp.where(valid, found.result, RESULTS.bad_input).astype(jnp.int32)
            _, q, w, _, _ = layout.split(fields.y)
            running = _Running(
                Guess(fields.y, fields.strain),
                jnp.where(running.result == 0, result, running.result),
                running.iterations + found.iterations,
                jnp.maximum(running.correction, found.correction),
                jnp.maximum(running.error, fields.error),
            )
            return _Fields(fields.strain, jnp.concatenate([q, w], -1)), running

        begin = running._replace(
            iterations=jnp.zeros((), jnp.int32), correction=jnp.zeros(()), error=jnp.zeros(())
        )
        new_memory, after = scheme.step(memory, coefficients, solve, begin)
        # After a failure the rod is held where it was: its numbers stay finite.
        ok = after.result == RESULTS.successful
        hold = lambda new, old: jax.tree.map(lambda a, b: jnp.where(ok, a, b), new, old)
        memory = hold(new_memory, memory)
        after = after._replace(guess=hold(after.guess, running.guess))
        seen = method.outputs(memory[0].velocity)
        stats = {
            "iterations": after.iterations,
            "residual": after.correction,
            "error": after.error,
        }
        return (memory, after), (memory[0].strain, seen, after.result, stats)

    zero = jnp.zeros((), jnp.int32)
    running = _Running(guess, zero, zero, jnp.zeros(()), jnp.zeros(()))
    restart = _restarts(steps, tensions, pressures)
    coefficients = scheme.coefficients(dt, restart)
    _, (strains, velocities, results, stats) = jax.lax.scan(
        step, (scheme.start(fields), running), (coefficients, tensions, pressures)
    )

    strains = jnp.concatenate([fields.strain[None], strains])
    velocities = jnp.concatenate([jnp.zeros_like(velocities[:1]), velocities])
    base = jnp.zeros(3) if scene.base_position is None else scene.base_position
    positions, quaternions = jax.vmap(
        lambda strain: method.shape(strain, rod.L, base, rod.h_base)
    )(strains)
    failed = results != RESULTS.successful
    return Trajectory(
        ts=dt * jnp.arange(steps + 1),
        tip_positions=positions[:, -1],
        tip_velocities=to_base(quaternions[:, -1], velocities[:, -1, :3]),
        positions=positions,
        quaternions=quaternions,
        strains=jax.vmap(method.outputs)(strains),
        velocities=velocities,
        result=results[-1],
        failed_step=jnp.where(jnp.any(failed), jnp.argmax(failed), -1),
        stats=stats,
    )


def _restarts(steps, tensions, pressures):
    inputs = [x for x in (tensions, pressures) if x is not None]
    if not inputs:
        return jnp.arange(steps) == 0
    return jumps(jnp.concatenate(inputs, axis=1))
