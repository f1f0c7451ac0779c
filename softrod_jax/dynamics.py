"""Motion of a scene under inputs that change with time."""

from typing import NamedTuple, Optional

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from softrod_jax.boundary_value import scaled_loads, slow_unless, solve_boundary_value
from softrod_jax.collocation import Collocation
from softrod_jax.inertial_search import search_by_inertia
from softrod_jax.inputs import actuation, is_traced, valid_actuation
from softrod_jax.method import MOST_INTERVALS, Guess, Method
from softrod_jax.newton import NewtonOptions
from softrod_jax.precision import require_float64
from softrod_jax.results import RESULTS, raise_unless_successful
from softrod_jax.rod import make_rod
from softrod_jax.rod_ode import History, Layout
from softrod_jax.rotations import to_base
from softrod_jax.scene import Scene, as_arrays
from softrod_jax.statics import StaticSolution, unloaded_guess
from softrod_jax.step_control import first_substeps, refine_in_time
from softrod_jax.time_schemes import SDIRK, TimeScheme, jumps

# Where a search for an accuracy in time ends.
_MOST_SUBSTEPS = 2048


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
      "time_error" (of the tip so far from the steps in time, estimated, in lengths of the rod).
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
    substeps: int = 1,
    tolerance: Optional[float] = None,
    initial: Optional[StaticSolution] = None,
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
    - `tolerance`: find `substeps`, and a finer grid along the rod if need be, so that the
      estimated error of the tip stays below this many lengths of the rod. What was found is in
      `stats` as "substeps" and "intervals". Not under `jit`, `vmap` or `grad`, which need these
      numbers beforehand: give them those.
    - `initial`: start from this equilibrium (same `method`); from the unloaded rod if `None`.
    - `scheme`: `SDIRK` or `BDFAlpha`. `method`: `Collocation` or `Shooting`.
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
    if not isinstance(substeps, int) or substeps < 1:
        raise ValueError(f"simulate: substeps={substeps!r}; a whole number from 1 is needed")

    def run(substeps, method=method):
        return _simulate(
            scene, dt, tensions, pressures, strain, steps, substeps, scheme, method, newton
        )

    if tolerance is None:
        trajectory = run(substeps)
    else:
        if is_traced(scene, dt, tensions, pressures, strain):
            raise ValueError(
                f"simulate: tolerance={tolerance} under jit, vmap or grad; simulate a typical "
                'motion with it first, and give the substeps=stats["substeps"] found there'
            )
        if not 0 < tolerance < 1:
            raise ValueError(
                f"simulate: tolerance={tolerance}; a part of the rod's length in (0, 1) is needed"
            )
        trajectory = _within(
            run, scene, float(dt), method, scheme, substeps, tolerance, initial is None
        )
    if throw:
        trajectory = raise_unless_successful(trajectory.result, trajectory, "simulate")
    return trajectory


def _within(run, scene, dt, method, scheme, substeps, tolerance, may_refine_grid):
    """The trajectory `run(substeps, method)` whose estimated errors are below `tolerance`."""
    # On the device the number of substeps is an input: one program serves all tries.
    attempt = lambda n: run(jnp.array(n), method)
    length = float(scene.length)
    n = max(substeps, first_substeps(make_rod(scene), dt, tolerance))
    while True:
        found, n, error, result = refine_in_time(
            attempt, n, scheme.order, length, tolerance, max(_MOST_SUBSTEPS, 2 * n)
        )
        # An estimate that is not a number is above no tolerance.
        if result != RESULTS.successful or not np.max(found.stats["error"]) > tolerance:
            break
        if not may_refine_grid or 2 * method.intervals > MOST_INTERVALS:
            result = RESULTS.inaccurate
            break
        # The estimate is a pessimist: two grids decide.
        coarse, method = found, method.finer()
        found = attempt(n)
        moved = np.linalg.norm(found.tip_positions - coarse.tip_positions, axis=-1).max()
        if found.result == RESULTS.successful and moved <= tolerance * length:
            break
        n = max(1, n // 2)
    chosen = {"substeps": n, "intervals": method.intervals}
    failed_step = found.failed_step
    if result == RESULTS.inaccurate and failed_step < 0:
        failed_step = jnp.argmax(jnp.asarray(error) > tolerance)
    return eqx.tree_at(
        lambda t: (t.result, t.failed_step, t.stats),
        found,
        (
            jnp.array(int(result), jnp.int32),
            failed_step,
            {**found.stats, "time_error": error, **chosen},
        ),
    )


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
def _simulate(
    scene, dt, tensions, pressures, strain, steps, substeps, scheme, method, options
):
    def rod_under(tau, pressure):
        return valid_actuation(make_rod(scene, tau, pressure))

    inputs = (tensions, pressures)
    rod, _ = rod_under(*jax.tree.map(lambda x: x[0], inputs))
    layout = Layout(attitude=rod.has_dead_load, dynamic=True)
    guess = unloaded = unloaded_guess(method, layout, rod)
    if strain is not None:
        guess = guess._replace(strain=strain)
    fields = _Fields(guess.strain, jnp.zeros_like(guess.strain))

    def substep(now, before, first, coefficients, state):
        """One of `substeps` equal parts of a step; it begins at `first`, in [0, 1)."""
        memory, running = state

        def solve(c0, history, at, running):
            # Not above 1 by rounding: a tension that falls to zero would become negative.
            progress = jnp.minimum(first + at / substeps, 1.0)
            rod, valid = rod_under(
                *jax.tree.map(lambda a, b: progress * a + (1 - progress) * b, now, before)
            )
            # After a failure, an unloaded rod at rest costs a batch no iterations.
            alive = running.result == RESULTS.successful
            solved = solve_boundary_value(
                method,
                layout,
                options,
                scaled_loads(rod, jnp.where(alive, 1.0, 0.0)),
                slow_unless(alive, History(c0, history.strain, history.velocity)),
                jax.tree.map(lambda a, b: jnp.where(alive, a, b), running.guess, unloaded),
                search_by_inertia,
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

        new_memory, after = scheme.step(memory, coefficients, solve, running)
        # After a failure the rod is held where it was: its numbers stay finite.
        ok = after.result == RESULTS.successful
        hold = lambda new, old: jax.tree.map(lambda a, b: jnp.where(ok, a, b), new, old)
        return hold(new_memory, memory), after._replace(guess=hold(after.guess, running.guess))

    def step(state, row):
        memory, running = state
        coefficients, now, before = row
        state = memory, running._replace(
            iterations=jnp.zeros((), jnp.int32), correction=jnp.zeros(()), error=jnp.zeros(())
        )

        def part(k, state):
            # Inputs jump at the beginning of a step only.
            here = jnp.where(k == 0, coefficients, no_jump)
            return substep(now, before, k / substeps, here, state)

        if isinstance(substeps, int) and substeps == 1:
            state = substep(now, before, 0.0, coefficients, state)
        else:
            state = jax.lax.fori_loop(0, substeps, part, state)
        memory, running = state
        stats = {
            "iterations": running.iterations,
            "residual": running.correction,
            "error": running.error,
        }
        seen = method.outputs(memory[0].velocity)
        return state, (memory[0].strain, seen, running.result, stats)

    zero = jnp.zeros((), jnp.int32)
    running = _Running(guess, zero, zero, jnp.zeros(()), jnp.zeros(()))
    before, restart = _inputs_before(steps, inputs)
    coefficients = scheme.coefficients(dt / substeps, restart)
    no_jump = scheme.coefficients(dt / substeps, jnp.zeros(1, dtype=bool))[0]
    _, (strains, velocities, results, stats) = jax.lax.scan(
        step, (scheme.start(fields, guess), running), (coefficients, inputs, before)
    )

    strains = jnp.concatenate([fields.strain[None], strains])
    velocities = jnp.concatenate([jnp.zeros_like(velocities[:1]), velocities])
    base = jnp.zeros(3) if scene.base_position is None else scene.base_position
    positions, quaternions = jax.vmap(
        lambda strain: method.shape(strain, rod.L, base, rod.h_base)
    )(strains)
    failed = results != RESULTS.successful
    error = _time_error(positions[:, -1], scheme, substeps)
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
        stats={**stats, "time_error": error / rod.L},
    )


def _inputs_before(steps, inputs):
    """Where each input comes from as a step begins, and if any of them jumps there.

    An input that jumps acts as given from the beginning of the step; another changes linearly
    during the step, from its last value.
    """
    jumped = jax.tree.map(jumps, inputs)
    held = lambda x, jump: jnp.where(jump, x, jnp.concatenate([x[:1], x[:-1]]))
    restart = jnp.arange(steps) == 0
    for jump in jax.tree.leaves(jumped):
        restart |= jnp.any(jump, axis=1)
    return jax.tree.map(held, inputs, jumped), restart


def _time_error(tip: Float[Array, "times 3"], scheme: TimeScheme, substeps):
    """Estimated error of the tip [m] from the steps in time, (steps,), growing.

    The sum of C |dt^(p + 1) p^(p + 1)| over all steps, by differences of the tip's path. After a
    jump, and where a step does not resolve the motion, it is too large rather than too small.
    """
    order = scheme.order
    path = jnp.concatenate([jnp.broadcast_to(tip[0], (order, 3)), tip])
    local = jnp.linalg.norm(jnp.diff(path, order + 1, axis=0) + 1e-300, axis=-1)
    return scheme.error_constant / substeps**order * jnp.cumsum(local)
