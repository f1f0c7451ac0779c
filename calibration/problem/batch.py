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
    inputs: Inputs
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
    times, tip, used = _measured(data, clocks, samples)
    hanging = np.array([hangs(scene, r) for r in data.recordings])
    batch = Batch(
        dt=jnp.array([c.dt for c in clocks]),
        inputs=_inputs(scene, data.recordings, clocks, steps),
        times=jnp.array(times),
        tip=jnp.array(tip),
        used=jnp.array(used),
        weights=jnp.array(used, dtype=float),
        hanging=jnp.array(hanging),
        free_frame=jnp.array([not r.origin_known for r in data.recordings]),
        ramps=_ramps(data, clocks, windows, steps, samples),
        conditions={
            name: jnp.array([float(r.conditions.get(name, usual)) for r in data.recordings])
            for name, usual in sorted(data.conditions.items())
        },
        steps=steps,
        any_hanging=bool(np.any(hanging)),
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


def _measured(data: Dataset, clocks: Sequence[Clock], samples: int):
    """Times [s], (recordings, samples), tips [m] and which of their coordinates were measured,
    (recordings, samples, 3); 0 where nothing was."""
    shape = (len(data), samples)
    times, tip, used = np.zeros(shape), np.zeros((*shape, 3)), np.zeros((*shape, 3), dtype=bool)
    for i, (r, s, c) in enumerate(zip(data.recordings, data.selections, clocks, strict=True)):
        chosen = kept(r, s)
        n, measured = int(np.sum(chosen)), r.tip_positions[chosen]
        times[i, :n] = r.times[chosen] - c.origin
        used[i, :n] = np.isfinite(measured)
        tip[i, :n] = np.nan_to_num(measured)
    return times, tip, used


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
