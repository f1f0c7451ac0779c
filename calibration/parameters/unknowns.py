"""The parameters that a fit looks for: which of them, of which recording, between which bounds."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

import softrod_jax as sr
from calibration.data.recording import Recording, RecordingError
from calibration.experiment.hand import HAND
from calibration.experiment.setup import Setup
from calibration.parameters.catalogue import (
    as_names,
    catalogue,
    choose,
    parameters_of,
    prepared,
)
from calibration.parameters.parameter import AbstractParameter
from calibration.parameters.scales import Factor


@dataclass(frozen=True)
class Unknown:
    """An unknown parameter. `recording`: the index of the one it belongs to, None for all.

    `initial`: the value at theta = 0; `low`, `high`: bounds of theta.
    """

    label: str
    parameter: AbstractParameter
    recording: int | None
    initial: np.ndarray
    low: float
    high: float

    def value(self, theta) -> np.ndarray:
        return np.asarray(self.parameter.scale.value(self.initial, theta))


@dataclass(frozen=True)
class Unknowns:
    """The unknown parameters.

    `names`: the columns of theta as a simulation takes it; `columns`, (recordings, names): the
    unknown behind each, -1 where there is none and the value is the setup's.
    """

    names: tuple[str, ...]
    items: tuple[Unknown, ...]
    columns: np.ndarray

    def theta(self, x: np.ndarray) -> np.ndarray:
        """(recordings, names) from the unknowns, the first of `x`."""
        return np.where(self.columns < 0, 0.0, x[np.maximum(self.columns, 0)])

    def indices(self, names: Sequence[str] | str) -> list[int]:
        """Which unknowns have these labels or are these parameters.

        Raises `ValueError` for a name, of those to profile, that is not fitted.
        """
        found = []
        for name in as_names(names):
            its = [i for i, u in enumerate(self.items) if name in (u.label, u.parameter.name)]
            if not its:
                raise ValueError(
                    f"profiles: {name!r} is not fitted; add it to fit, or leave it out"
                )
            found += its
        return found

    def shared(self, x: np.ndarray, recordings: int) -> tuple["Unknowns", np.ndarray]:
        """The unknowns of so many other recordings, and their theta, from `x` of the fitted ones.

        They share the mean, in theta, of a parameter of which each fitted recording has its own;
        but how they were held by a hand is theirs alone, and stays as it is.
        """
        items, thetas = [], []
        for name in self.names:
            of_it = [i for i, u in enumerate(self.items) if u.parameter.name == name]
            if not of_it or name in HAND:
                # Every recording's condition is 0, and stays it; or it is another for each.
                continue
            items.append(replace(self.items[of_it[0]], label=name, recording=None))
            thetas.append(np.mean(x[of_it]))
        place = {u.parameter.name: i for i, u in enumerate(items)}
        columns = np.tile([place.get(name, -1) for name in self.names], (recordings, 1))
        return Unknowns(self.names, tuple(items), columns), np.array(thetas)


def conditioned(setup: Setup, conditions: Mapping[str, Any]) -> Setup:
    """The setup with the values that a recording gives."""
    parameters = parameters_of(setup.scene, conditions)
    for parameter, value in zip(parameters, conditions.values(), strict=True):
        setup = parameter.put(setup, value)
    return setup


def choose_unknowns(
    scene: sr.Scene,
    recordings: Sequence[Recording],
    labels: Sequence[str],
    fit: Sequence[str] | str | None,
    per_recording: Sequence[str] | str = (),
    bounds: Mapping[str, tuple[float, float]] | None = None,
    places: Iterable[str] = (),
    program: Sequence[str] | None = None,
) -> tuple[Setup, Unknowns]:
    """The setup that all recordings share, and the unknowns. The setup has a place for what is
    fitted, for the recordings' conditions and for the parameters `places`.

    A parameter is one number for all recordings, unless it is among `per_recording` or recordings
    give it as a condition: then each has its own. One whose condition is 0 keeps it.

    `program`: all names that the compiled program has, what is fitted among them, so that fits of
    some of them share it; the others stay as they are.

    Raises `ValueError` for unknown names and for bounds that are not around the initial value.
    """
    conditions = dict.fromkeys(name for r in recordings for name in r.conditions)
    check_conditions(scene, recordings)
    setup = prepared(scene, conditions)
    names = choose(setup.scene, fit, conditions)
    own = choose(setup.scene, per_recording, conditions) if per_recording else ()
    bounds = bounds or {}
    for what, given in (("per_recording", own), ("bounds", bounds)):
        for name in given:
            if name not in names:
                raise ValueError(f"{what}: {name!r} is not fitted; add it to fit, or leave it out")
    setup = prepared(setup.scene, [*conditions, *names, *places])
    parameters = parameters_of(setup.scene, names)
    items: list[Unknown] = []
    simulated = names if program is None else tuple(program)
    columns = np.full((len(recordings), len(simulated)), -1)
    for parameter, name in zip(parameters, names, strict=True):
        j, given = simulated.index(name), bounds.get(name)
        if name not in own and name not in conditions:
            columns[:, j] = len(items)
            items.append(_unknown(parameter, name, None, setup, given))
            continue
        for k, recording in enumerate(recordings):
            its_own = conditioned(setup, recording.conditions)
            nothing = not np.any(np.asarray(parameter.get(its_own)))
            if not (nothing and isinstance(parameter.scale, Factor)):
                columns[k, j] = len(items)
                items.append(_unknown(parameter, f"{name}@{labels[k]}", k, its_own, given))
    return setup, Unknowns(simulated, tuple(items), columns)


def _unknown(
    parameter: AbstractParameter, label: str, recording: int | None, setup: Setup, given
) -> Unknown:
    """An unknown that is searched around its value in `setup`, between the bounds `given`."""
    initial = np.asarray(parameter.get(setup))
    low, high = _bounds(parameter, initial, given, setup)
    return Unknown(label, parameter, recording, initial, low, high)


def with_frame(scene: sr.Scene, fit: Sequence[str] | str | None) -> tuple[str, ...]:
    """What is fitted, and where the cameras are, as far as it is not among that."""
    names = choose(scene, fit)
    return (*names, *(n for n in choose(scene, _FRAME) if n not in names))


_FRAME = ("camera_shift", "camera_rotation")


def check_conditions(scene: sr.Scene, recordings: Sequence[Recording]) -> None:
    """Raises `RecordingError` for a condition that `scene` cannot have."""
    for recording in recordings:
        for name in recording.conditions:
            _check_condition(scene, name, recording)


def _check_condition(scene, name, recording):
    where = recording.source or recording.name
    parameters, _ = catalogue(scene)
    if name not in parameters:
        raise RecordingError(
            f"{where}: condition {name!r} is unknown; known: {', '.join(parameters)}"
        )
    parameter = parameters[name]
    value = recording.conditions[name]
    if not np.isfinite(value):
        raise RecordingError(f"{where}: condition {name} = {value}: a finite number is needed")
    now = parameter.get(parameter.prepare(Setup(scene)))
    if now is None:
        raise RecordingError(
            f"{where}: condition {name}: the scene has none; add {parameter.remedy} to it"
        )
    positive = isinstance(parameter.scale, Factor)
    if np.ndim(now) or (positive and value < 0):
        what = "one number at least 0 is needed" if not np.ndim(now) else "has several numbers"
        raise RecordingError(f"{where}: condition {name} = {value:g}: {what}")


def _bounds(parameter, initial, given, setup) -> tuple[float, float]:
    largest = parameter.scale.largest
    low, high = (_reach(parameter, initial, setup, end) for end in (-largest, largest))
    if given is None:
        return low, high
    ends = _given_bounds(parameter, initial, given)
    return max(ends[0], low), min(ends[1], high)


_HALVINGS = 40


def _reach(parameter: AbstractParameter, initial, setup: Setup, end: float) -> float:
    """How far theta may go towards `end` for the parameter to stay what it can be, such as a
    tendon within the section; all the way if it is not there from the start."""
    allowed = parameter.allowed
    at = lambda theta: parameter.put(setup, parameter.scale.value(initial, theta))
    if allowed is None or not allowed(setup) or allowed(at(end)):
        return end
    inside, outside = 0.0, end
    for _ in range(_HALVINGS):
        middle = (inside + outside) / 2
        inside, outside = (middle, outside) if allowed(at(middle)) else (inside, middle)
    return inside


def _given_bounds(parameter, initial, given) -> tuple[float, float]:
    try:
        low, high = (float(x) for x in given)
        ends = [parameter.scale.theta(initial, x) for x in (low, high)]
    except (TypeError, ValueError) as e:
        reason = str(e) if str(e).endswith("needed") else "a pair (low, high) is needed"
        raise ValueError(f"bounds: {parameter.name} = {given!r}: {reason}") from None
    if not ends[0] < 0 < ends[1]:
        raise ValueError(
            f"bounds: {parameter.name} = ({low:g}, {high:g}): the initial value, "
            f"{float(np.max(initial)):g} {parameter.unit}, must lie between them"
        )
    return ends[0], ends[1]
