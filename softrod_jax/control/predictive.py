"""Model predictive control of a robot by linear models about equilibria.

Each model has an observer of its own, a stationary Kalman filter of the model and of what it does
not explain, a disturbance of each output; so in the end outputs are where they should be, however
wrong the model (Pannocchia & Rawlings, AIChE Journal 49, 2003). What the models predict is weighed
by how near their equilibria are to where the robot is: predictions can be, states cannot, for each
reduced model has its own. The inputs to come are polygons within limits, the minimum of a quadratic
cost, from those of the step before.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Real

from softrod_jax.analysis.least_effort import bounded_minimum
from softrod_jax.analysis.linear import LinearModel
from softrod_jax.control.local_models import Local, local_model, polygon, spacing
from softrod_jax.foundation.compiling import compiled
from softrod_jax.foundation.numbers import ScalarLike
from softrod_jax.scene.inputs import KINDS, whole_number

# The cost counts the outputs this many times within the horizon.
_SEEN = 15
# What an input costs, in terms of what a change of it does, as far as it moves no output. Where
# several inputs do the same, those of least effort are found within some cycles.
_LASTING = 0.1
_SINGULAR = 1e-10


class Control(NamedTuple):
    """What one cycle hands to the next.

    `x`: of each observer, as expected at the next measurement; `u`: the inputs in force then, and
    those decided on for later cycles; `plan`: the corners of the polygon.
    """

    x: Float[Array, "models n"]
    u: Float[Array, "queue m"]
    plan: Float[Array, "corners m"]


class Predictive(eqx.Module):
    """A controller that brings outputs along a reference within limits of the inputs.

    - `models`: one or several reduced models with the same inputs, outputs and number of states,
      about equilibria all over where the robot will be.
    - `dt` [s]: the time from one measurement to the next. `limits`: for each kind of inputs of the
      models, "tensions" [N], "pressures" [Pa] or "pulls" [m], a lowest and a highest value.
    - `outputs`: which outputs of the models are measured and controlled; `None`: all that are in
      metres.
    - `noise`: standard deviation of what is measured; `drift`: of the disturbance, in one second,
      in the unit of the outputs. Of `drift` / `noise` follows how fast the model's errors are
      learned.
    - `delay`: how many cycles after a measurement inputs begin to go to what was decided upon it,
      which they reach linearly within a cycle. 0: at once.
    - `horizon` [s] to which outputs are predicted; `corners` of the polygon of inputs.
    - `effort`: what a change of an input by its whole range from corner to corner costs, in terms
      of an error of the outputs in their unit.

    Raises `ValueError` for models that do not fit together or are not reduced, and for numbers
    that cannot be.
    """

    models: Local
    low: Float[Array, "m"]
    high: Float[Array, "m"]
    effort: Float[Array, ""]
    times: Float[Array, "ahead"]
    width: Float[Array, ""]
    outputs: tuple[int, ...] = eqx.field(static=True)
    inputs: tuple[str, ...] = eqx.field(static=True)
    delay: int = eqx.field(static=True)

    def __init__(
        self,
        models: LinearModel | Sequence[LinearModel],
        dt: ScalarLike,
        limits: Mapping[str, tuple],
        *,
        outputs: Sequence[str] | None = None,
        noise: ScalarLike = 3e-4,
        drift: ScalarLike = 1e-2,
        delay: int = 1,
        horizon: ScalarLike = 0.3,
        corners: int = 6,
        effort: ScalarLike = 3e-3,
    ):
        models = [models] if isinstance(models, LinearModel) else list(models)
        _check_alike(models)
        numbers = dict(dt=dt, noise=noise, drift=drift, horizon=horizon, effort=effort)
        for name, x in numbers.items():
            if not 0 < float(x) < np.inf:
                raise ValueError(f"Predictive: {name}={x}; a positive number is needed")
        names = models[0].outputs
        chosen = [x for x in names if x.endswith("_m")] if outputs is None else list(outputs)
        if not chosen:
            raise ValueError(f"Predictive: outputs={outputs}; at least one is needed of {names}")
        for name in chosen:
            if name not in names:
                raise ValueError(f"Predictive: output {name!r} is not one of the models: {names}")
        self.outputs = tuple(names.index(x) for x in chosen)
        self.inputs, self.delay = models[0].inputs, _delay(delay)
        self.low, self.high = _limits(self.inputs, limits)
        corners = whole_number("Predictive", "corners", corners)
        steps = round(float(horizon) / float(dt))
        if steps < max(corners, _SEEN):
            least = max(corners, _SEEN)
            raise ValueError(
                f"Predictive: horizon={horizon} is {steps} times dt={dt}; at least {least} are "
                "needed"
            )
        seen = np.unique(np.round(np.linspace(1, steps, _SEEN)).astype(int))
        self.times = jnp.asarray((self.delay + seen) * float(dt))
        between = polygon(steps, corners)
        how = float(dt), float(noise), float(drift)
        every = [local_model(model, list(self.outputs), how, seen, between) for model in models]
        self.models = jax.tree.map(lambda *x: jnp.asarray(np.stack(x)), *every)
        self.effort = jnp.asarray(effort, dtype=float)
        self.width = jnp.asarray(spacing(np.asarray(self.models.y0)))

    def begin(
        self,
        inputs: Real[Array | np.ndarray, "m"],
        measured: Real[Array | np.ndarray, "p"],
    ) -> Control:
        """At rest, with these inputs in force and these outputs.

        Raises `ValueError` for wrong shapes.
        """
        u, y = jnp.asarray(inputs, dtype=float), jnp.asarray(measured, dtype=float)
        if u.shape != self.low.shape or y.shape != (len(self.outputs),):
            raise ValueError(
                f"Predictive.begin: {u.shape} inputs and {y.shape} outputs; expected are "
                f"{self.low.shape}, {self.inputs}, and {(len(self.outputs),)}"
            )
        corners = self.models.forced.shape[-1] // u.size
        return Control(
            _at_rest(self, u, y), jnp.tile(u, (self.delay + 1, 1)), jnp.tile(u, (corners, 1))
        )

    def step(
        self,
        control: Control,
        measured: Real[Array | np.ndarray, "p"],
        reference: Real[Array | np.ndarray, "ahead p"],
    ) -> tuple[Float[Array, "m"], Control]:
        """The inputs to go to, from `delay` cycles after now on, and what the next cycle needs.

        - `measured`: the outputs now; where NaN, nothing has been measured.
        - `reference`: where the outputs should be, at the `times` of the controller from now on.
        """
        measured, reference = jnp.asarray(measured, float), jnp.asarray(reference, float)
        expected = (self.times.size, len(self.outputs))
        if reference.shape != expected or measured.shape != expected[1:]:
            raise ValueError(
                f"Predictive.step: measured has shape {measured.shape} and reference "
                f"{reference.shape}; {expected[1:]} and {expected} are needed"
            )
        return _step(self, control, measured, reference)


@compiled
def _at_rest(controller: Predictive, u, measured):
    """The states under constant inputs, and the disturbances that make the outputs right."""
    p = len(controller.outputs)

    def one(local: Local):
        n = local.F.shape[0] - p
        own = u - local.u0
        still = jnp.linalg.solve(jnp.eye(n) - local.F[:n, :n], local.G[:n] @ own)
        return jnp.concatenate(
            [still, measured - local.y0 - local.C[:, :n] @ still - local.D @ own]
        )

    return jax.vmap(one)(controller.models)


@compiled
def _step(controller: Predictive, control: Control, measured, reference):
    models, (x, queue, plan) = controller.models, control
    width = controller.high - controller.low
    along = lambda local, x, before, after: local.F @ x + local.G @ (0.5 * (before + after))

    def observed(local: Local, x):
        """The state now, the outputs with it, and the state where inputs can still be chosen."""
        own = queue - local.u0
        beyond = measured - local.y0 - local.C @ x - local.D @ own[0]
        x = x + local.gain @ jnp.where(jnp.isfinite(beyond), beyond, 0.0)
        y = local.y0 + local.C @ x + local.D @ own[0]
        later = x
        for before, after in zip(own[:-1], own[1:]):
            later = along(local, later, before, after)
        free = local.free @ jnp.concatenate([later, own[-1]])
        from_zero = local.forced @ jnp.tile(local.u0, plan.shape[0])
        return x, y, free - from_zero + jnp.tile(local.y0, len(controller.times))

    x, y, free = jax.vmap(observed)(models, x)
    weights = jax.nn.softmax(
        -0.5 * jnp.sum((jnp.mean(y, 0) - models.y0) ** 2, 1) / controller.width**2
    )
    forced = jnp.tensordot(weights, models.forced, 1)
    now = jnp.clip(plan, controller.low, controller.high)
    still = jnp.tensordot(weights, models.still, 1)
    missed = weights @ free - reference.ravel()
    u = _planned(controller, forced, still, missed, queue[-1] / width, now / width)
    u = u * width
    chosen = jnp.clip(u[0], controller.low, controller.high)
    queue = jnp.concatenate([queue, chosen[None]])
    before, after = queue[0], queue[1]
    go = lambda local, x: along(local, x, before - local.u0, after - local.u0)
    return chosen, Control(jax.vmap(go)(models, x), queue[1:], u)


def _planned(controller: Predictive, forced, still, missed, last, now):
    """The corners of least cost, in terms of ranges; `now`: where the search begins.

    `still`: the static gain.
    """
    corners, m = now.shape
    low, high = controller.low, controller.high
    J = forced * jnp.tile(high - low, corners) / np.sqrt(len(controller.times))
    r = missed / np.sqrt(len(controller.times)) + J @ now.ravel()
    change = np.kron(np.eye(corners) - np.eye(corners, k=-1), np.eye(m))
    steps = change @ now.ravel() - jnp.concatenate([last, jnp.zeros((corners - 1) * m)])
    weight = controller.effort**2
    # What no output follows from has its own cost, so that outputs are not off for the effort.
    K = still * (high - low)
    both = K @ K.T
    idle = K.T @ jnp.linalg.solve(both + _SINGULAR * jnp.trace(both) * np.eye(len(K)), K)
    idle = jnp.kron(np.eye(corners), _LASTING**2 * weight * (np.eye(m) - idle))
    rest = now - jnp.clip(0.0, low, high) / (high - low)
    H = J.T @ J + weight * change.T @ change + idle
    g = J.T @ r + weight * change.T @ steps + idle @ rest.ravel()
    ends = (jnp.tile(x / (high - low), corners) - now.ravel() for x in (low, high))
    scale = jnp.max(jnp.abs(jnp.diagonal(H)))
    return now + bounded_minimum(H / scale, g / scale, *ends).reshape(corners, m)


def _check_alike(models: list[LinearModel]) -> None:
    if not models:
        raise ValueError("Predictive: no models; give at least one, linearise(...).reduced(12)")
    for model in models:
        if model.descriptor:
            raise ValueError("Predictive: a model with a singular E; give model.reduced(12)")
        first = models[0]
        same = model.inputs == first.inputs and model.outputs == first.outputs
        if not same or model.A.shape != first.A.shape:
            raise ValueError(
                f"Predictive: models of {first.inputs} to {first.outputs} with {first.A.shape[0]} "
                f"states and of {model.inputs} to {model.outputs} with {model.A.shape[0]}; "
                "give them the same"
            )


def _limits(inputs: tuple[str, ...], limits: Mapping[str, tuple]):
    """Of each input, by the kind that its name begins with."""
    low, high = [], []
    kinds = {kind.name: kind for kind in KINDS}
    if not isinstance(limits, Mapping) or not set(limits) <= set(kinds):
        raise ValueError(
            f"Predictive: limits={limits!r}; a dictionary is needed with {list(kinds)}"
        )
    own = {name: [x for x in inputs if _is(x, kind)] for name, kind in kinds.items()}
    for name, found in own.items():
        if bool(found) != (name in limits):
            raise ValueError(
                f"Predictive: limits of {list(limits)}, but the models' inputs are {inputs}"
            )
        if found:
            try:
                pair = [np.broadcast_to(np.asarray(x, float), (len(found),)) for x in limits[name]]
                lowest, highest = pair
            except (TypeError, ValueError):
                raise ValueError(
                    f"Predictive: limits[{name!r}] = {limits[name]!r}; a lowest and a highest "
                    f"value are needed, each a number or {len(found)} of them"
                ) from None
            if not (np.all(np.isfinite(pair)) and np.all(lowest < highest)):
                raise ValueError(
                    f"Predictive: limits[{name!r}] = {limits[name]!r}; lowest < highest"
                )
            low += [(inputs.index(x), v) for x, v in zip(found, lowest)]
            high += [(inputs.index(x), v) for x, v in zip(found, highest)]
    if len(low) != len(inputs):
        raise ValueError(
            f"Predictive: the models' inputs {inputs} are not all actuators; give linearise "
            "actuators only"
        )
    return tuple(jnp.asarray([v for _, v in sorted(x)]) for x in (low, high))


def _is(name: str, kind) -> bool:
    """Whether an input of this name is one of the kind."""
    before, after = kind.column.split("{}")
    return (
        name.startswith(before)
        and name.endswith(after)
        and name[len(before) : -len(after)].isdigit()
    )


def _delay(delay) -> int:
    return (
        0 if isinstance(delay, int) and delay == 0 else whole_number("Predictive", "delay", delay)
    )
