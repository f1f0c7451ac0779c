"""The simulated motion of a recording, and its tip at the times of the samples.

The simulated tip is interpolated in time, so that it is a smooth function of a clock's delay.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

import softrod_jax as sr
from calibration.data.carried import BASE, at_first, moves_of
from calibration.experiment.quantities import simulated_in_time
from calibration.experiment.release import with_supporting_hand
from calibration.experiment.setup import Setup
from calibration.problem.batch import Batch
from softrod_jax.rod.rotations import to_base

# The scheme of fits, and the grid with which they begin (`calibration.problem.resolution`). An
# order 4 in time at 10 ms shifts the modulus of a 100 mm silicone beam ringing at 8 Hz by 0.01 %;
# BDF-alpha at 5 ms costs more and shifts it by 0.8 %, and the damping by 4 %.
SCHEME = sr.SDIRK()
# A search passes places where that grid is too coarse: only the last of them must not be.
METHOD = sr.Collocation(intervals=4, order=6, max_error=0.1)
NEWTON = sr.NewtonOptions(tolerance=1e-7)


class Motion(eqx.Module):
    """The simulated marker of one recording on the grid of time steps, (steps + 1, 3) each.

    `shapes`: the rod, (steps + 1, outputs, 3). `error`: of the grid along it, the largest of all
    steps, as the solver estimates it, in lengths of the rod. `others`: what else was measured, all
    numbers of the batch's keys; None where nothing was. `attitudes`, (steps + 1, outputs, 4),
    and `strains`, (steps + 1, outputs, 6), at `arc_lengths` [m]: what draws the rod between.
    """

    positions: Float[Array, "rows 3"]
    velocities: Float[Array, "rows 3"]
    shapes: Float[Array, "rows outputs 3"]
    result: Int[Array, ""]
    error: Float[Array, ""]
    attitudes: Float[Array, "rows outputs 4"] | None = None
    strains: Float[Array, "rows outputs 6"] | None = None
    others: Float[Array, "rows numbers"] | None = None
    arc_lengths: Float[Array, "outputs"] | None = None


def simulate_motion(setup: Setup, batch: Batch, scheme, method) -> Motion:
    """The motion of one recording of the batch (its arrays without the leading axis)."""
    setup, poses = _carried(setup, batch)
    scene = setup.simulated_scene()
    inputs = setup.arriving_in_time(batch.inputs, batch.dt)
    initial, start_result = None, jnp.zeros((), jnp.int32)
    if batch.any_hanging:
        first = jax.tree.map(lambda x: x[0], inputs)
        still = setup.held_scene(scene) if setup.is_held else scene
        initial = sr.solve_static(still, *first, method=method, throw=False)
        start_result = jnp.where(batch.hanging, initial.result, 0)
        strain = jnp.where(batch.hanging, initial.point_strains, _rest_strain(scene))
        tensions = jnp.where(batch.hanging, initial.tensions, 0.0)
        initial = eqx.tree_at(
            lambda i: (i.point_strains, i.tensions, i.wrenches, i.result),
            initial,
            (strain, tensions, jnp.where(batch.hanging, initial.wrenches, 0.0), start_result),
        )
    inputs = jax.tree.map(lambda x: x[1:], inputs)
    if setup.release_duration is not None and not jax.tree.leaves(inputs):
        scene, tension = with_supporting_hand(scene, setup.release_duration, batch.dt, batch.steps)
        inputs = inputs._replace(tensions=tension)
    trajectory = sr.simulate(
        scene,
        batch.dt,
        *inputs,
        **moves_of(poses),
        steps=batch.steps,
        initial=initial,
        scheme=scheme,
        method=method,
        newton=NEWTON,
        # A motion whose steps are too long for it has a misfit and a slope like any other.
        max_time_error=jnp.inf,
        throw=False,
    )
    positions, velocities = trajectory.tip_positions, trajectory.tip_velocities
    if setup.sensor_offset is not None:
        attitude = trajectory.quaternions[:, -1]
        turning = jnp.cross(trajectory.velocities[:, -1, 3:], setup.sensor_offset)
        positions = positions + to_base(attitude, setup.sensor_offset)
        velocities = velocities + to_base(attitude, turning)
    positions, velocities = setup.seen_position(positions), setup.seen_direction(velocities)
    error = jax.lax.stop_gradient(jnp.max(trajectory.stats["error"]))
    others = [simulated_in_time(setup, trajectory, key) for key in batch.keys]
    return Motion(
        positions,
        velocities,
        trajectory.positions,
        trajectory.result,
        error,
        trajectory.quaternions,
        trajectory.strains,
        jnp.concatenate(others, axis=1) if others else None,
        trajectory.arc_lengths,
    )


def _carried(setup: Setup, batch: Batch):
    """The setup with its base where it is at first, and the poses at the ends of steps, by name."""
    poses = dict(batch.carried)
    if BASE in poses:
        setup = eqx.tree_at(lambda s: s.scene, setup, at_first(setup.scene, poses))
        poses[BASE] = setup.clamp_poses(poses[BASE])
    return setup, {name: rows[1:] for name, rows in poses.items()}


def driven(batch: Batch, drifted: Float[Array, "windows"]) -> Batch:
    """The recording with its inputs as they arrive, `drifted` by so much in each window."""
    arriving = 1.0 + batch.ramps["inputs"] @ drifted
    inputs = jax.tree.map(lambda x: arriving[:, None] * x, batch.inputs)
    return eqx.tree_at(lambda b: b.inputs, batch, inputs)


def _rest_strain(scene):
    v = jnp.array([0.0, 0.0, 1.0]) if scene.rest_stretch is None else scene.rest_stretch
    u = jnp.zeros(3) if scene.rest_curvature is None else scene.rest_curvature
    return jnp.concatenate([v, u])


def tip_at(motion: Motion, dt, times: Float[Array, "samples"]) -> Float[Array, "samples 3"]:
    """The tip at `times` [s] of the simulation, by cubic Hermite interpolation.

    Before the start it is where it starts; at the start its velocity is zero, so that the tip
    is a smooth function of time. After the end it is where it ends.
    """
    last = motion.positions.shape[0] - 1
    x = jnp.clip(times / dt, 0, last)
    k = jnp.clip(jnp.floor(jax.lax.stop_gradient(x)).astype(int), 0, last - 1)
    u = (x - k)[:, None]
    p0, p1 = motion.positions[k], motion.positions[k + 1]
    v0, v1 = dt * motion.velocities[k], dt * motion.velocities[k + 1]
    change = u * u * (3 - 2 * u) * (p1 - p0)
    return p0 + change + u * (1 - u) * ((1 - u) * v0 - u * v1)


def others_at(motion: Motion, dt, times: Float[Array, "samples"]) -> Float[Array, "samples n"]:
    """What else was measured at `times` [s] of the simulation, by cubic interpolation with slopes
    of differences; it need not be at rest at the ends."""
    values = motion.others
    assert values is not None, "there is something to interpolate"
    last = values.shape[0] - 1
    x = jnp.clip(times / dt, 0, last)
    k = jnp.clip(jnp.floor(jax.lax.stop_gradient(x)).astype(int), 0, last - 1)
    u = (x - k)[:, None]
    slope = lambda k: (values[jnp.minimum(k + 1, last)] - values[jnp.maximum(k - 1, 0)]) / 2
    change = u * u * (3 - 2 * u) * (values[k + 1] - values[k])
    return values[k] + change + u * (1 - u) * ((1 - u) * slope(k) - u * slope(k + 1))
