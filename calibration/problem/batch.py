"""Recordings as one batch of arrays, padded to the same lengths.

All of them run through one compiled program. Recordings of about the same length share it, and so
do those that are padded to be like another batch.
"""

import math
from collections.abc import Mapping, Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

import softrod_jax as sr
from calibration.data.carried import BASE, begins_there, carried_in, poses_at
from calibration.data.quantities import NOISE, numbers_of, quantities_in_motion, unit_noise
from calibration.data.recording import RecordingError
from calibration.data.selection import kept
from calibration.experiment import drift
from calibration.experiment.beginning import hangs
from calibration.experiment.clock import Clock, first_clock
from calibration.problem.dataset import Dataset
from calibration.problem.memory import check_memory
from softrod_jax.scene.inputs import KINDS, Inputs

_PADDING = 16


class Batch(eqx.Module):
    """Recordings, padded to the same lengths: all of them run through one compiled program.

    - `dt` [s], (recordings,). `inputs`, (recordings, steps + 1, actuators) each: row 0 at the
      start, row k + 1 acts in step k.
    - `times` [s], (recordings, samples), from the origin; `tip` [m], (recordings, samples, 3),
      zero where it is not `used`; `others`, (recordings, samples, numbers): what else was measured
      of `keys`, one after the other (`calibration.data.quantities`).
    - `used`, (recordings, samples, 3 + numbers): which coordinates of the tip, and then which of
      the others, were measured.
    - `hanging`: the rod starts in equilibrium under the first inputs, not straight.
    - `factors`, (recordings, 3 + numbers): of residuals of other units, to metres that weigh as
      much: the noise of the tip over their own. `weights`, like `used`: of each residual in the sum
      of squares, as a factor of the residual, these among them; 0 where not `used`.
    - `free_frame`: the recording does not know where the clamp is, nor its axes quite.
    - `ramps`: for each channel that may drift what part of each of its windows is over, at
      `times`, and for the inputs at their rows: (recordings, samples or rows, windows).
    - `carried`: where the base and obstacles are at the start and at the ends of steps, by name,
      (recordings, steps + 1, 7), of those of which any recording says it.
    - `conditions`: values in which recordings differ from the setup, by name, (recordings,).
    """

    dt: Float[Array, "recordings"]
    inputs: Inputs
    times: Float[Array, "recordings samples"]
    tip: Float[Array, "recordings samples 3"]
    others: Float[Array, "recordings samples numbers"]
    used: Bool[Array, "recordings samples all"]
    factors: Float[Array, "recordings all"]
    weights: Float[Array, "recordings samples all"]
    hanging: Bool[Array, "recordings"]
    free_frame: Bool[Array, "recordings"]
    ramps: dict[str, Float[Array, "recordings _ windows"]]
    carried: dict[str, Float[Array, "recordings rows 7"]]
    conditions: dict[str, Float[Array, "recordings"]]
    steps: int = eqx.field(static=True)
    any_hanging: bool = eqx.field(static=True)
    keys: tuple[str, ...] = eqx.field(static=True, default=())


def make_batch(
    scene: sr.Scene,
    data: Dataset,
    time_offset: bool,
    dt: float | Sequence[float] | None,
    like: Batch | None = None,
) -> tuple[Batch, list[Clock]]:
    """The recordings as arrays, and their clocks.

    - `time_offset`: whether a delay of each clock is sought.
    - `dt` [s]: the time step of all or of each; None: the interval between samples.
    - `like`: a batch that this one is at least as large as, to run through its compiled program.

    Raises `RecordingError` if a release cannot be seen in a recording and `time_offset` is
    asked for, or if inputs do not fit the scene; `ValueError` for a bad `dt`.
    """
    for recording in data.recordings:
        _check_inputs(scene, recording)
    each = dt if isinstance(dt, Sequence) else [dt] * len(data)
    clocks = [
        drift.divided(first_clock(r, time_offset, d), r, s, data.drift)
        for r, s, d in zip(data.recordings, data.selections, each, strict=True)
    ]
    steps, samples, windows = _sizes(data, clocks, like)
    keys = _keys(data, like)
    factors = np.array([_factors(scene, r, keys) for r in data.recordings])
    times, measured, used = _measured(data, clocks, samples, keys)
    hanging = np.array([hangs(scene, r) for r in data.recordings])
    batch = Batch(
        dt=jnp.array([c.dt for c in clocks]),
        inputs=_inputs(scene, data.recordings, clocks, steps),
        times=jnp.array(times),
        tip=jnp.array(measured[..., :3]),
        others=jnp.array(measured[..., 3:]),
        used=jnp.array(used),
        factors=jnp.array(factors),
        weights=jnp.array(used * factors[:, None]),
        hanging=jnp.array(hanging),
        free_frame=jnp.array([not r.origin_known for r in data.recordings]),
        ramps=_ramps(data, clocks, windows, steps, samples),
        carried=_carried(scene, data.recordings, clocks, steps, like),
        conditions={
            name: jnp.array([float(r.conditions.get(name, usual)) for r in data.recordings])
            for name, usual in sorted(data.conditions.items())
        },
        steps=steps,
        any_hanging=bool(np.any(hanging)),
        keys=keys,
    )
    return batch, clocks


def recording_of(tree, k: int):
    """Recording `k` of arrays that have one along their first axis."""
    return jax.tree.map(lambda x: x[k], tree)


def _sizes(
    data: Dataset, clocks: Sequence[Clock], like: Batch | None
) -> tuple[int, int, dict[str, int]]:
    """How many steps, samples and, by channel, windows of drift all recordings are padded to."""
    steps = _padded(
        max(
            math.ceil((s.end - c.origin - c.low + drift.latest(c)) / c.dt - 1e-9)
            for s, c in zip(data.selections, clocks, strict=True)
        )
    )
    pairs = zip(data.recordings, data.selections, strict=True)
    samples = _padded(max(int(np.sum(kept(r, s))) for r, s in pairs))
    windows = dict.fromkeys(data.drift, 0)
    if like is not None:
        steps, samples = max(steps, like.steps), max(samples, like.times.shape[1])
        windows |= {name: ramps.shape[-1] for name, ramps in like.ramps.items()}
    own = lambda name: (c.windows.get(name, 0) for c in clocks)
    return steps, samples, {name: max(n, *own(name)) for name, n in windows.items()}


def _keys(data: Dataset, like: Batch | None) -> tuple[str, ...]:
    """What was measured besides the tip in any recording, and in those of another batch."""
    own = (key for r in data.recordings for key in r.others)
    return tuple(dict.fromkeys((*(() if like is None else like.keys), *own)))


def _factors(scene: sr.Scene, recording, keys) -> list[float]:
    """See `Batch`; raises `RecordingError` for a key that the scene does not have."""
    tip = recording.noise.get("tip", NOISE)
    try:
        return [1.0] * 3 + [
            tip / x for x in unit_noise(quantities_in_motion(scene), keys, recording.noise)
        ]
    except ValueError as e:
        raise RecordingError(f"{recording.source or recording.name}: {e}") from None


def _measured(data: Dataset, clocks: Sequence[Clock], samples: int, keys):
    """Times [s], (recordings, samples), tips [m] and what else was measured, and which of all that
    was, (recordings, samples, 3 + numbers); 0 where nothing was."""
    shape = (len(data), samples)
    counts = {key: own.stop - own.start for key, own in numbers_of(keys).items()}
    times, all_ = np.zeros(shape), np.zeros((*shape, 3 + sum(counts.values())))
    used = np.zeros(all_.shape, dtype=bool)
    for i, (r, s, c) in enumerate(zip(data.recordings, data.selections, clocks, strict=True)):
        chosen = kept(r, s)
        n = int(np.sum(chosen))
        nothing = lambda key, n=n: np.full((n, counts[key]), np.nan)
        parts = [r.others[k][chosen] if k in r.others else nothing(k) for k in keys]
        measured = np.concatenate([r.tip_positions[chosen], *parts], axis=1)
        times[i, :n] = r.times[chosen] - c.origin
        used[i, :n] = np.isfinite(measured)
        all_[i, :n] = np.nan_to_num(measured)
    return times, all_, used


def _ramps(
    data: Dataset, clocks: Sequence[Clock], windows: Mapping[str, int], steps: int, samples: int
) -> dict[str, Float[Array, "recordings _ _"]]:
    """What part of each window is over, by channel: inputs at their rows, others at samples."""
    rows = {name: steps + 1 if name == "inputs" else samples for name in windows}
    check_memory(
        8.0 * len(data) * sum(rows[name] * (1 + n) for name, n in windows.items()),
        f"{max(windows.values(), default=0)} windows of drift in {samples} samples",
        "let it drift in longer windows",
    )
    over = {name: np.zeros((len(data), rows[name], n)) for name, n in windows.items()}
    for i, (r, s, c) in enumerate(zip(data.recordings, data.selections, clocks, strict=True)):
        chosen = kept(r, s)
        for name, ramps in over.items():
            at = r.times[0] + c.dt * np.arange(steps + 1) if name == "inputs" else r.times[chosen]
            ramps[i, : len(at), : c.windows.get(name, 0)] = drift.ramps(at, c, name)
    return {name: jnp.array(x) for name, x in over.items()}


def _padded(count: int) -> int:
    """Recordings of about the same length share a compiled program."""
    return _PADDING * max(1, math.ceil(count / _PADDING))


def _check_inputs(scene, recording):
    where = recording.source or recording.name
    for kind, inputs in recording.driven_by:
        count = kind.count(scene)
        if inputs.shape[1] != count:
            raise RecordingError(
                f"{where}: {inputs.shape[1]} columns of {kind.name}, and the scene has {count} "
                f"{kind.of(scene)}; one column each is needed"
            )
    for name, poses in recording.carried.items():
        if name not in carried_in(scene):
            raise RecordingError(
                f"{where}: it says where {name!r} is carried, and the scene has "
                f"{', '.join(carried_in(scene)) or 'nothing'} with moves = true"
            )
        if not begins_there(name, poses):
            raise RecordingError(
                f"{where}: {name} begins at {poses[0].tolist()}; an obstacle begins where the "
                "scene has it, in the pose 0, 0, 0, 1, 0, 0, 0"
            )


def _carried(scene, recordings, clocks, steps, like) -> dict[str, Float[Array, "_ _ 7"]]:
    """See `Batch.carried`. What one recording says nothing of stands still in it."""
    said = {name for r in recordings for name in r.carried} | set(like.carried if like else ())
    found = {}
    for name in sorted(said):
        rows = [_stands(scene, name, steps)] * len(recordings)
        for i, (r, c) in enumerate(zip(recordings, clocks, strict=True)):
            if name in r.carried:
                at = r.times[0] + c.dt * np.arange(steps + 1)
                rows[i] = poses_at(at, r.times, r.carried[name])
        found[name] = jnp.array(np.stack(rows))
    return found


def _stands(scene, name: str, steps: int) -> np.ndarray:
    """The pose of what stands still, (steps + 1, 7)."""
    pose = np.array([0.0, 0, 0, 1, 0, 0, 0])
    if name == BASE and scene.base_position is not None:
        pose[:3] = np.asarray(scene.base_position)
    if name == BASE and scene.base_quaternion is not None:
        pose[3:] = np.asarray(scene.base_quaternion)
    return np.tile(pose, (steps + 1, 1))


def _inputs(scene, recordings, clocks, steps) -> Inputs:
    """Inputs at the start and in each step, (recordings, steps + 1, actuators) each, of the logs.

    Between rows of a log inputs change linearly; after its end they stay. A recording without some
    has zeros. `None`: no recording has any. But a tendon that is driven by its length is one at
    pull 0, too.
    """
    found = {}
    for kind in KINDS:
        holds = kind.control == "length" and kind.count(scene) > 0
        given = [getattr(recording, kind.name) for recording in recordings]
        if all(x is None for x in given) and not holds:
            continue
        grid = np.zeros((len(given), steps + 1, kind.count(scene)))
        for i, (x, r, c) in enumerate(zip(given, recordings, clocks, strict=True)):
            if x is not None:
                at = r.times[0] + c.dt * np.arange(steps + 1)
                grid[i] = np.stack([np.interp(at, r.times, column) for column in x.T], axis=1)
        found[kind.name] = jnp.array(grid)
    return Inputs(**found)
