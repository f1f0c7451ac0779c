"""Recordings as one batch of arrays, and the simulated tip at the times of their samples.

Each recording has a clock, and the simulation has its own: it starts at `origin + delay` of the
recording. The origin is the best guess beforehand; the delay is fitted. The simulated tip is
interpolated in time, so that it is a smooth function of the delay.
"""

import math
from collections.abc import Mapping, Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

import softrod_jax as sr
from calibration.data.onset import detect_onset
from calibration.data.recording import Recording, RecordingError
from calibration.data.selection import Selection, input_onset, kept
from calibration.experiment import drift
from calibration.experiment.beginning import hangs
from calibration.experiment.drift import Clock
from calibration.experiment.release import held
from calibration.experiment.setup import Setup, rotated
from calibration.problem.memory import check_memory

# The scheme of fits, and the grid with which they begin (`calibration.inference.resolution`). An
# order 4 in time at 10 ms shifts the modulus of a 100 mm silicone beam ringing at 8 Hz by 0.01 %;
# BDF-alpha at 5 ms costs more and shifts it by 0.8 %, and the damping by 4 %.
SCHEME = sr.SDIRK()
# A search passes places where that grid is too coarse: only the last of them must not be.
METHOD = sr.Collocation(intervals=4, order=6, max_error=0.1)
NEWTON = sr.NewtonOptions(tolerance=1e-7)
_PADDING = 16
# A delay is sought this far around its first guess: so many samples, or seconds if that is more.
_DELAY_SAMPLES = 10
_DELAY_SECONDS = 0.1


class Batch(eqx.Module):
    """Recordings, padded to the same lengths: all of them run through one compiled program.

    - `dt` [s], (recordings,). `tensions` [N], (recordings, steps + 1, tendons), `pressures`
      [Pa], (recordings, steps + 1, chambers): row 0 at the start, row k + 1 acts in step k.
    - `times` [s], (recordings, samples), from the origin; `tip` [m], (recordings, samples, 3),
      zero where it is not `used`.
    - `hanging`: the rod starts in equilibrium under the first inputs, not straight.
    - `weights`, like `tip`: of each residual in the sum of squares, as a factor of the residual;
      0 where not `used`.
    - `free_frame`: the recording does not know where the clamp is, nor its axes quite.
    - `ramps`: for each channel that may drift what part of each of its windows is over, at
      `times`, and for the inputs at their rows: (recordings, samples or rows, windows).
    - `conditions`: values in which recordings differ from the setup, by name, (recordings,).
    """

    dt: Float[Array, "recordings"]
    tensions: Float[Array, "recordings rows tendons"] | None
    pressures: Float[Array, "recordings rows chambers"] | None
    times: Float[Array, "recordings samples"]
    tip: Float[Array, "recordings samples 3"]
    used: Bool[Array, "recordings samples 3"]
    weights: Float[Array, "recordings samples 3"]
    hanging: Bool[Array, "recordings"]
    free_frame: Bool[Array, "recordings"]
    ramps: dict[str, Float[Array, "recordings _ windows"]]
    conditions: dict[str, Float[Array, "recordings"]]
    steps: int = eqx.field(static=True)
    any_hanging: bool = eqx.field(static=True)


class Motion(eqx.Module):
    """The simulated marker of one recording on the grid of time steps, (steps + 1, 3) each.

    `shapes`: the rod, (steps + 1, outputs, 3). `error`: of the grid along it, the largest of all
    steps, as the solver estimates it, in lengths of the rod.
    """

    positions: Float[Array, "rows 3"]
    velocities: Float[Array, "rows 3"]
    shapes: Float[Array, "rows outputs 3"]
    result: Int[Array, ""]
    error: Float[Array, ""]


def simulate_motion(setup: Setup, batch: Batch, scheme, method) -> Motion:
    """The motion of one recording of the batch (its arrays without the leading axis)."""
    scene = setup.simulated_scene()
    tensions, pressures = setup.arriving(batch.tensions), batch.pressures
    initial, start_result = None, jnp.zeros((), jnp.int32)
    if batch.any_hanging:
        first = [None if x is None else x[0] for x in (tensions, pressures)]
        initial = sr.solve_static(scene, *first, method=method, throw=False)
        start_result = jnp.where(batch.hanging, initial.result, 0)
        strain = jnp.where(batch.hanging, initial.point_strains, _rest_strain(scene))
        initial = eqx.tree_at(
            lambda i: (i.point_strains, i.result), initial, (strain, start_result)
        )
    after_start = lambda x: None if x is None else x[1:]
    tensions, pressures = after_start(tensions), after_start(pressures)
    if setup.release_duration is not None and tensions is None and pressures is None:
        scene, tensions = held(scene, setup.release_duration, batch.dt, batch.steps)
    trajectory = sr.simulate(
        scene,
        batch.dt,
        tensions,
        pressures,
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
        positions = positions + rotated(attitude, setup.sensor_offset)
        velocities = velocities + rotated(attitude, turning)
    error = jax.lax.stop_gradient(jnp.max(trajectory.stats["error"]))
    return Motion(positions, velocities, trajectory.positions, trajectory.result, error)


def driven(batch: Batch, drifted: Float[Array, "windows"]) -> Batch:
    """The recording with its inputs as they arrive, `drifted` by so much in each window."""
    arriving = 1.0 + batch.ramps["inputs"] @ drifted
    inputs = lambda b: [x for x in (b.tensions, b.pressures) if x is not None]
    return eqx.tree_at(inputs, batch, [arriving[:, None] * x for x in inputs(batch)])


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


def make_batch(
    scene: sr.Scene,
    recordings: list[Recording],
    selections: list[Selection],
    time_offset: bool,
    dt: float | Sequence[float] | None,
    defaults: Mapping[str, float],
    drifting: Mapping[str, float] | None = None,
    steps: int = 0,
    samples: int = 0,
    windows: Mapping[str, int] | None = None,
) -> tuple[Batch, list[Clock]]:
    """The recordings as arrays, and their clocks; `steps`, `samples` and `windows`: the
    least number of them, so that the batch runs through a program compiled for another.

    `dt` [s], of all or of each; None: the interval between samples. `defaults`: the conditions in
    which recordings differ, by name, each with the value of those that do not give it. `drifting`:
    the channels that may drift, and the durations of their windows [s].

    Raises `RecordingError` if a release cannot be seen in a recording and `time_offset` is
    asked for, or if inputs do not fit the scene; `ValueError` for a bad `dt`.
    """
    for recording in recordings:
        _check_inputs(scene, recording)
    each = dt if isinstance(dt, Sequence) else [dt] * len(recordings)
    clocks = [
        drift.divided(_clock(scene, r, time_offset, d), r, s, drifting or {})
        for r, s, d in zip(recordings, selections, each, strict=True)
    ]
    needed = max(
        math.ceil((s.end - c.origin - c.low + drift.latest(c)) / c.dt - 1e-9)
        for s, c in zip(selections, clocks, strict=True)
    )
    steps = max(_padded(needed), steps)
    chosen = [kept(r, s) for r, s in zip(recordings, selections, strict=True)]
    shape = (len(recordings), max(samples, _padded(max(int(np.sum(k)) for k in chosen))))
    times, tip = np.zeros(shape), np.zeros((*shape, 3))
    used = np.zeros((*shape, 3), dtype=bool)
    most = {
        name: max(n, *(c.windows.get(name, 0) for c in clocks))
        for name, n in {**dict.fromkeys(drifting or {}, 0), **(windows or {})}.items()
    }
    rows = {name: steps + 1 if name == "inputs" else shape[1] for name in most}
    check_memory(
        8.0 * len(recordings) * sum(rows[name] * (1 + n) for name, n in most.items()),
        f"{max(most.values(), default=0)} windows of drift in {shape[1]} samples",
        "let it drift in longer windows",
    )
    over = {name: np.zeros((len(recordings), rows[name], n)) for name, n in most.items()}
    for i, (r, c, k) in enumerate(zip(recordings, clocks, chosen, strict=True)):
        n = int(np.sum(k))
        measured = r.tip_positions[k]
        times[i, :n] = r.times[k] - c.origin
        used[i, :n] = np.isfinite(measured)
        tip[i, :n] = np.nan_to_num(measured)
        for name, ramps in over.items():
            at = r.times[0] + c.dt * np.arange(steps + 1) if name == "inputs" else r.times[k]
            ramps[i, : len(at), : c.windows.get(name, 0)] = drift.ramps(at, c, name)
    hanging = np.array([hangs(scene, r) for r in recordings])
    tensions, pressures = (
        _inputs([getattr(r, name) for r in recordings], recordings, clocks, steps)
        for name in ("tensions", "pressures")
    )
    conditions = {
        name: jnp.array([float(r.conditions.get(name, usual)) for r in recordings])
        for name, usual in sorted(defaults.items())
    }
    batch = Batch(
        dt=jnp.array([c.dt for c in clocks]),
        tensions=tensions,
        pressures=pressures,
        times=jnp.array(times),
        tip=jnp.array(tip),
        used=jnp.array(used),
        weights=jnp.array(used, dtype=float),
        hanging=jnp.array(hanging),
        free_frame=jnp.array([not r.origin_known for r in recordings]),
        ramps={name: jnp.array(x) for name, x in over.items()},
        conditions=conditions,
        steps=steps,
        any_hanging=bool(np.any(hanging)),
    )
    return batch, clocks


def _padded(count: int) -> int:
    """Recordings of about the same length share a compiled program."""
    return _PADDING * max(1, math.ceil(count / _PADDING))


def _check_inputs(scene, recording):
    where = recording.source or recording.name
    for name, part, actuators in (
        ("tensions", "tendons", scene.tendons),
        ("pressures", "chambers", scene.chambers),
    ):
        inputs = getattr(recording, name)
        count = 0 if actuators is None else actuators.count
        if inputs is not None and inputs.shape[1] != count:
            raise RecordingError(
                f"{where}: {inputs.shape[1]} columns of {name}, and the scene has {count} {part}; "
                "one column each is needed"
            )


def sample_interval(recording: Recording) -> float:
    """Of the tip [s]: inputs may have been sampled faster."""
    return float(np.median(np.diff(recording.times[recording.has_tip])))


def _clock(scene, recording: Recording, time_offset: bool, dt: float | None) -> Clock:
    times, interval = recording.times, sample_interval(recording)
    if dt is None:
        dt = interval
    elif not (np.isfinite(dt) and dt > 0):
        raise ValueError(f"dt={dt!r} s: a positive number is needed")
    begin = float(times[0])
    if not time_offset:
        return Clock(begin, 0.0 if _released(recording) else begin, 0.0, 0.0, dt, interval)
    margin = max(_DELAY_SAMPLES * interval, _DELAY_SECONDS)
    if recording.starts_hanging and not _released(recording):
        # A part of a longer log: it begins anywhere, and its clocks are about right.
        return Clock(begin, begin, -margin, margin, dt, interval)
    onset = detect_onset(recording)
    if _released(recording):
        return Clock(onset, 0.0, -margin, margin, dt, interval)
    # The inputs have a clock, and the tip's may be late or early. What moves the rod first is a
    # load that acts from the start, or an input: whichever asks for less.
    guess = min((onset - begin, onset - input_onset(recording)), key=abs)
    low, high = min(guess, 0.0) - margin, max(guess, 0.0) + margin
    return Clock(begin + guess, begin, low - guess, high - guess, dt, interval)


def _released(recording: Recording) -> bool:
    return recording.tensions is None and recording.pressures is None


def _inputs(inputs, recordings, clocks, steps):
    """(recordings, steps + 1, channels): inputs at the start and in each step, from the logs.

    Between rows of a log inputs change linearly; after its end they stay. None if no recording
    has any; a recording without has zeros.
    """
    channels = next((x.shape[1] for x in inputs if x is not None), None)
    if channels is None:
        return None
    steps_done = np.arange(steps + 1)
    grid = np.zeros((len(inputs), steps + 1, channels))
    for i, (x, r, c) in enumerate(zip(inputs, recordings, clocks, strict=True)):
        if x is not None:
            at = r.times[0] + c.dt * steps_done
            grid[i] = np.stack([np.interp(at, r.times, column) for column in x.T], axis=1)
    return jnp.array(grid)
