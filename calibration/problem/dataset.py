"""The recordings of a fit, told apart, and which of their samples are compared."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

import softrod_jax as sr
from calibration.data.recording import Recording
from calibration.data.selection import Selection, select
from calibration.experiment.drift import durations
from calibration.parameters.catalogue import catalogue, prepared
from calibration.parameters.unknowns import check_conditions


@dataclass(frozen=True, eq=False)
class Dataset:
    """Recordings that are simulated together.

    - `labels`, `selections`: of each recording a name of its own, and the samples that are used.
    - `conditions`: those in which recordings differ, by name, with the value that holds where a
      recording does not give it.
    - `drift`: the channels that may drift, and the durations of their windows [s].
    """

    recordings: tuple[Recording, ...]
    labels: tuple[str, ...]
    selections: tuple[Selection, ...]
    conditions: Mapping[str, float] = field(default_factory=dict)
    drift: Mapping[str, float] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.recordings)

    def take(self, indices: Sequence[int]) -> "Dataset":
        """The recordings at these indices, in their order; one may be taken more than once."""
        return replace(
            self,
            recordings=tuple(self.recordings[i] for i in indices),
            labels=tuple(self.labels[i] for i in indices),
            selections=tuple(self.selections[i] for i in indices),
        )


def datasets(
    scene: sr.Scene,
    recordings: Recording | Sequence[Recording],
    held_out: Recording | Sequence[Recording] = (),
    window: tuple[float, float] | None = None,
    drift: Mapping[str, float] | None = None,
) -> tuple[Dataset, Dataset]:
    """The recordings to fit, and those that are kept aside, which are not searched for drifts.

    `window` and `drift` are those of `calibration.calibrate`. Raises `ValueError` if there is
    nothing to fit, and for a bad window or drift; `RecordingError` for recordings that do not fit
    the scene or have no samples to use.
    """
    fitted, unseen = (
        (r,) if isinstance(r, Recording) else tuple(r) for r in (recordings, held_out)
    )
    if not fitted:
        raise ValueError("recordings: none given; at least one is needed")
    drift = durations(drift)
    check_conditions(scene, (*fitted, *unseen))
    labels = _labels((*fitted, *unseen))
    conditions = _usual_conditions(scene, (*fitted, *unseen))
    n = len(fitted)
    selections = [tuple(select(r, window) for r in part) for part in (fitted, unseen)]
    return (
        Dataset(fitted, labels[:n], selections[0], conditions, drift),
        Dataset(unseen, labels[n:], selections[1], conditions),
    )


def _usual_conditions(scene: sr.Scene, recordings: Sequence[Recording]) -> dict[str, float]:
    """The scene's values of all parameters that any recording gives as a condition."""
    names = {name for r in recordings for name in r.conditions}
    setup = prepared(scene, names)
    parameters, _ = catalogue(setup.scene)
    return {name: float(np.asarray(parameters[name].get(setup))) for name in names}


def _labels(recordings: Sequence[Recording]) -> tuple[str, ...]:
    """The recordings' names, told apart by numbers where they are the same."""
    labels: list[str] = []
    for recording in recordings:
        label, number = recording.name, 2
        while label in labels:
            label, number = f"{recording.name}-{number}", number + 1
        labels.append(label)
    return tuple(labels)
