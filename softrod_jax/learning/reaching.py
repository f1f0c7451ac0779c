"""The task of the environments: bring the tip of a rod to a target, and hold it there."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from softrod_jax.bvp.method import AbstractMethod
from softrod_jax.foundation.compiling import compiled
from softrod_jax.learning.stepping import Action, RodState, RodView, Stepper, reset_where
from softrod_jax.scene.inputs import KINDS
from softrod_jax.scene.robots import hybrid_robot
from softrod_jax.scene.scene import Scene
from softrod_jax.statics import StaticSolution, solve_static
from softrod_jax.stepping.scheme import AbstractTimeScheme

# Bounds of what is observed: the tip and the target, and the tip's velocity, in lengths of the rod
# and lengths a second.
_REACH, _SPEED = 3.0, 100.0


class Reaching:
    """What actions do, what is observed, and where a rod begins.

    - `stepper`: of the rod.
    - `limits`, (actuators,): of tensions, pressures and pulls, in this order.
    - `sizes`, (observations,): bounds of what is observed.

    Raises `ValueError` for limits that are not positive, and for a scene without actuators.
    """

    def __init__(
        self,
        scene: Scene | None,
        dt: float,
        limits: tuple[float, float, float],
        scheme: AbstractTimeScheme,
        method: AbstractMethod,
    ):
        for kind, limit in zip(KINDS, limits, strict=True):
            if not 0 < limit < np.inf:
                raise ValueError(f"ReachEnv: {kind.one}_limit={limit}; a positive number is needed")
        if scene is None:
            scene = hybrid_robot(gravity=jnp.array([0.0, 0.0, 9.81]))
        self.stepper = Stepper(scene, dt, scheme=scheme, method=method)
        counts = [kind.count(scene) for kind in KINDS]
        if sum(counts) == 0:
            raise ValueError("ReachEnv: the scene has no tendons and no chambers; add actuators")
        self.limits, self._ends = np.repeat(limits, counts), np.cumsum(counts)
        sizes = np.array([_REACH, _SPEED, _REACH, 1], np.float32)
        self.sizes = np.repeat(sizes, [3, 3, 3, self.limits.size])
        self._fresh: RodState | None = None

    def action(self, numbers: np.ndarray) -> Any:
        """The `Action` of numbers in [-1, 1], (.., actuators)."""
        parts = np.split(0.5 * (numbers + 1.0) * self.limits, self._ends[:-1], axis=-1)
        return Action(*(part if part.shape[-1] else None for part in parts))

    def checked(self, numbers, batch: tuple[int, ...] = ()) -> np.ndarray:
        """An action of a user, cut to [-1, 1]. Raises `ValueError` for another shape."""
        numbers = np.clip(np.asarray(numbers, dtype=float), -1.0, 1.0)
        if numbers.shape != (*batch, *self.limits.shape):
            raise ValueError(
                f"ReachEnv.step: action has shape {numbers.shape}; "
                f"{(*batch, *self.limits.shape)} is needed"
            )
        return numbers

    def fresh(self) -> RodState:
        """A rod in the equilibrium without actuation."""
        if self._fresh is None:
            rest = self.action(-np.ones(self.limits.shape))
            initial = solve_static(self.stepper.scene, *rest, method=self.stepper.method)
            self._fresh = self.stepper.reset(initial, rest)
        return self._fresh

    def observed(self, view: RodView, target, numbers) -> tuple[np.ndarray, np.ndarray]:
        """What is observed, (.., observations), and the distance to the target [lengths]."""
        length, tip = float(self.stepper.scene.length), np.asarray(view.tip_position)
        parts = (tip, np.asarray(view.tip_velocity), target)
        seen = np.concatenate([*(x / length for x in parts), numbers], axis=-1)
        clipped = np.clip(seen, -self.sizes, self.sizes).astype(np.float32)
        return clipped, np.linalg.norm(target - tip, axis=-1) / length


@compiled
def equilibria(stepper: Stepper, actions: Action) -> tuple[Float[Array, "batch 3"], Array]:
    """The tips under a batch of actions, and their codes."""

    def one(action) -> StaticSolution:
        return solve_static(stepper.scene, *action, method=stepper.method, throw=False)

    found = jax.vmap(one)(actions)
    return found.tip_position, found.result


@compiled
def many_steps(
    stepper: Stepper, fresh: RodState, states: RodState, actions: Action, renew
) -> tuple[RodState, RodView]:
    """A batch of states one step later, or `fresh` where they are to `renew`, and how they look."""

    def one(state, action, renew):
        state = reset_where(renew, fresh, stepper.step(state, action))
        return state, stepper.view(state)

    return jax.vmap(one)(states, actions, renew)
