"""Where markers are in the equilibria of a setup, and how far that is from what was measured."""

import functools
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

import softrod_jax as sr
from calibration.data.quantities import quantities_of, unit_noise
from calibration.experiment.quantities import simulated
from calibration.experiment.setup import Setup
from calibration.parameters.catalogue import moved, parameters_of
from calibration.parameters.parameter import AbstractParameter
from calibration.postures.data import NOISE, TURN, Postures, attitude_of
from softrod_jax.rod.rotations import to_base, turn_between
from softrod_jax.scene.inputs import Inputs
from softrod_jax.scene.tendons import rubbing

# Grids that a search passes may be coarse: the error along the rod counts at its end.
_ANY_ERROR = 0.1
# What a row without an equilibrium counts for, in lengths of the rod.
_FAILED = 0.5
# Where no marker tells, in standard deviations.
_FAILED_OTHERS = 100.0


class Seen(NamedTuple):
    """Markers in the order of their names: positions [m] and quaternions; all numbers of what else
    was measured, in the order of their keys; and a code."""

    positions: Float[Array, "markers 3"]
    quaternions: Float[Array, "markers 4"]
    others: Float[Array, "others"]
    result: Array
    error: Array


class Targets(NamedTuple):
    """What was measured, with zeros where it was not; the same order."""

    positions: Float[Array, "rows markers 3"]
    quaternions: Float[Array, "rows markers 4"]
    others: Float[Array, "rows others"]
    has_position: Bool[Array, "rows markers 3"]
    has_attitude: Bool[Array, "rows markers"]
    has_others: Bool[Array, "rows others"]


class Noise(NamedTuple):
    """Standard deviations: of positions [m], attitudes [rad], and what else was measured."""

    positions: Float[Array, "markers"]
    attitudes: Float[Array, "markers"]
    others: Float[Array, "others"]


@dataclass(frozen=True, eq=False)
class Evaluation:
    """At one place theta: residuals in terms of the noise, (rows, numbers), zero where nothing was
    measured, their derivatives, and what was seen, with a first axis of rows."""

    residuals: Float[np.ndarray, "rows numbers"]
    jacobian: Float[np.ndarray, "rows numbers parameters"]
    seen: Any

    @property
    def solved(self) -> Bool[np.ndarray, "rows"]:
        return np.asarray(self.seen.result) == int(sr.RESULTS.successful)


@dataclass(frozen=True, eq=False)
class Model:
    """A setup, postures and the parameters that are sought: from theta to an `Evaluation`.

    `followed`: whether rows are on a path of inputs, each reached from the one before it in its
    trial, as where tendons rub or actuators have play.
    """

    setup: Setup
    postures: Postures
    parameters: tuple[AbstractParameter, ...]
    method: sr.Collocation

    @property
    def followed(self) -> bool:
        tendons = self.setup.scene.tendons
        return bool(rubbing(tendons)) or getattr(tendons, "backlash", None) is not None

    @cached_property
    def markers(self) -> tuple[str, ...]:
        names = {**self.postures.positions, **self.postures.quaternions}
        return tuple(names)

    @cached_property
    def targets(self) -> Targets:
        rows, m = self.postures.rows, len(self.markers)
        p, q = np.full((rows, m, 3), np.nan), np.full((rows, m, 4), np.nan)
        for j, name in enumerate(self.markers):
            p[:, j] = self.postures.positions.get(name, np.nan)
            q[:, j] = self.postures.quaternions.get(name, np.nan)
        has, turned = np.isfinite(p), np.all(np.isfinite(q), -1)
        q = np.where(turned[..., None], q, [1.0, 0.0, 0.0, 0.0])
        q = q / np.linalg.norm(q, axis=-1, keepdims=True)
        more = [np.zeros((rows, 0)), *(self.postures.others[key] for key in self.others)]
        others = np.concatenate(more, axis=1)
        numbers = np.nan_to_num(p), q, np.nan_to_num(others), has, turned, np.isfinite(others)
        return Targets(*map(jnp.asarray, numbers))

    @property
    def others(self) -> tuple[str, ...]:
        """The keys of what was measured besides markers."""
        return tuple(self.postures.others)

    @cached_property
    def noise(self) -> Noise:
        """Raises `ValueError` for a key that the scene does not have."""
        said = self.postures.noise
        others = unit_noise(quantities_of(self.setup.scene), self.others, said)
        positions = [said.get(name, NOISE) for name in self.markers]
        attitudes = [said.get(attitude_of(name), TURN) for name in self.markers]
        return Noise(*(jnp.asarray(x, dtype=float) for x in (positions, attitudes, others)))

    def at(self, theta) -> Setup:
        """The setup with the parameters at theta."""
        return moved(self.setup, self.parameters, theta)

    def evaluate(self, theta: Float[np.ndarray, "parameters"]) -> Evaluation:
        """Residuals and derivatives of all rows, on all devices."""
        seen = self.markers, self.others
        program = _program(self._names, *seen, self.method, self.followed)
        rows, order = self.postures.rows, None
        samples = self._inputs, self.targets, jnp.ones(rows, bool)
        if self.followed:
            order, samples = self._trials
        count = samples[2].shape[0]
        same = lambda x: jnp.broadcast_to(jnp.asarray(x), (count, *jnp.shape(x)))
        shared = jax.tree.map(same, (jnp.asarray(theta), self.setup, self.noise))
        out = program(*shared, *samples)
        if order is not None:
            there, back = np.asarray(samples[2]).ravel(), np.argsort(order)
            flat = lambda x: np.concatenate(list(np.asarray(x)))[there][back]
            out = jax.tree.map(flat, out)
        residuals, jacobian, seen = jax.tree.map(np.asarray, out)
        return Evaluation(residuals, jacobian, seen)

    def squares(self, theta: Float[Array, "parameters"]) -> Float[Array, ""]:
        """The sum of squares of all residuals, which can be traced and differentiated in theta."""
        compare = _comparison(self._names, self.markers, self.others, self.method, self.followed)
        samples = self._inputs, self.targets, jnp.ones(self.postures.rows, bool)
        if self.followed:
            _, samples = self._trials
        of_one = lambda sample: jnp.sum(compare(theta, self.setup, self.noise, *sample)[0] ** 2)
        return jnp.sum(jax.vmap(of_one)(samples))

    @property
    def _names(self) -> tuple[str, ...]:
        return tuple(parameter.name for parameter in self.parameters)

    @cached_property
    def _inputs(self) -> Inputs:
        return Inputs(*(None if x is None else jnp.asarray(x) for x in self.postures.inputs))

    @cached_property
    def _trials(self):
        """The rows trial by trial, and their inputs and targets, padded to the same length."""
        labels = self.postures.labels
        trials = [np.flatnonzero(labels == x) for x in dict.fromkeys(labels.tolist())]
        longest = max(len(rows) for rows in trials)
        # The last row again costs next to nothing.
        index = np.stack([np.append(r, np.full(longest - len(r), r[-1])) for r in trials])
        there = np.stack([np.arange(longest) < len(r) for r in trials])
        blocks = jax.tree.map(lambda x: x[index], (self._inputs, self.targets))
        return np.concatenate(trials), (*blocks, jnp.asarray(there))


@functools.cache
def _comparison(names, markers, others, method, followed: bool):
    """From theta, setup, noise, inputs, targets and whether a row is there to residuals and what
    was seen: of one row, or of a path."""

    def compare(theta, setup, noise, inputs, target, there):
        here = moved(setup, parameters_of(setup.scene, names), theta)
        scene = here.simulated_scene()
        given: Any = here.arriving(inputs)
        if not followed:
            solution = sr.solve_static(scene, *given, method=method, throw=False)
            seen = _seen(here, solution, markers, others)
            return _residual(seen, target, noise, scene.length), seen
        path = sr.solve_path(scene, *given, method=method, throw=False)
        seen = jax.vmap(lambda solution: _seen(here, solution, markers, others))(path)
        residual = lambda seen, target: _residual(seen, target, noise, scene.length)
        return jnp.where(there[:, None], jax.vmap(residual)(seen, target), 0.0), seen

    return compare


@functools.cache
def _program(names, markers, others, method, followed: bool):
    """The program that all models share whose numbers alone differ: residuals, their derivatives
    and what was seen, as `_comparison` has them."""
    compare = _comparison(names, markers, others, method, followed)

    def one(theta, *rest):
        return _with_jacobian(lambda theta: compare(theta, *rest), theta)

    return sr.spread(one)


def _seen(setup: Setup, solution, markers, others) -> Seen:
    poses = [solution.markers[name] for name in markers]
    stacked = lambda numbers, n: jnp.stack(numbers) if numbers else jnp.zeros((0, n))
    positions = stacked([pose.position for pose in poses], 3)
    quaternions = stacked([pose.quaternion for pose in poses], 4)
    if setup.sensor_offset is not None and "tip" in markers:
        tip = markers.index("tip")
        at = positions[tip] + to_base(quaternions[tip], setup.sensor_offset)
        positions = positions.at[tip].set(at)
    positions, quaternions = setup.seen_position(positions), setup.seen_attitude(quaternions)
    more = [jnp.zeros(0), *(simulated(setup.scene, solution, key) for key in others)]
    result, error = solution.result, solution.stats["error"]
    return Seen(positions, quaternions, jnp.concatenate(more), result, error)


def _residual(seen: Seen, target: Targets, noise: Noise, length) -> Float[Array, "numbers"]:
    """Of one row, simulated minus measured, in terms of the noise."""
    failed = seen.result != sr.RESULTS.successful
    apart = jnp.where(failed, 0.0, seen.positions - target.positions)
    apart = jnp.where(target.has_position, apart, 0.0) / noise.positions[:, None]
    lost = jax.lax.stop_gradient(_FAILED * length) / noise.positions[:, None]
    apart = jnp.where(failed & target.has_position, lost, apart)
    turn = 2.0 * turn_between(seen.quaternions, target.quaternions)
    turn = jnp.where(target.has_attitude[:, None] & ~failed, turn, 0.0)
    others = jnp.where(failed, 0.0, seen.others - target.others) / noise.others
    others = jnp.where(failed, _FAILED_OTHERS, others)
    others = jnp.where(target.has_others, others, 0.0)
    return jnp.concatenate([apart.ravel(), (turn / noise.attitudes[:, None]).ravel(), others])


def _with_jacobian(compared, theta):
    """Residuals, their forward derivatives and what was seen."""
    doubled = lambda theta: (lambda r, seen: (r, (r, seen)))(*compared(theta))
    jacobian, (residual, seen) = jax.jacfwd(doubled, has_aux=True)(theta)
    return residual, jacobian, seen


def coarse(method: sr.Collocation) -> sr.Collocation:
    """The grid for a search: one that is too coarse somewhere is no failure."""
    return sr.Collocation(
        method.intervals, method.order, max(method.max_error, _ANY_ERROR), method.division
    )
