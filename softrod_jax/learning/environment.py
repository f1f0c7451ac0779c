"""A gymnasium environment: bring the tip of a rod to a target, and hold it there.

gymnasium.make("softrod_jax.learning.environment:softrod/Reach-v0")
"""

from typing import Any

import jax.numpy as jnp
import numpy as np

try:
    import gymnasium
except ModuleNotFoundError as error:
    raise ModuleNotFoundError(
        "softrod_jax.learning.environment needs gymnasium, which the extra `learning` brings: "
        'pip install "softrod_jax[learning]"'
    ) from error

from softrod_jax.bvp.collocation import Collocation
from softrod_jax.bvp.method import AbstractMethod
from softrod_jax.foundation.results import RESULTS, result_message
from softrod_jax.learning.stepping import Action, RodState, Stepper
from softrod_jax.scene.inputs import KINDS
from softrod_jax.scene.robots import hybrid_robot
from softrod_jax.scene.scene import Scene
from softrod_jax.statics import solve_static
from softrod_jax.stepping.bdf_alpha import BDFAlpha
from softrod_jax.stepping.scheme import AbstractTimeScheme

# Bounds of what is observed: the tip and the target, and the tip's velocity, in lengths of the rod
# and lengths a second.
_REACH, _SPEED = 3.0, 100.0
# Draws of a target before the limits are called to blame.
_DRAWS = 20


class ReachEnv(gymnasium.Env):
    """Reach a random target with the tip, from rest.

    - `scene`: with tendons or chambers; the hanging `hybrid_robot` if `None`.
    - `dt` [s]: the length of a step. `max_steps`: after so many an episode is truncated.
    - `tension_limit` [N], `pressure_limit` [Pa] and `pull_limit` [m]: of each actuator.
    - `scheme`, `method`: as in `simulate`; the defaults are fast rather than accurate.

    Actions, in [-1, 1], are tensions, pressures and pulls, in this order, from zero to their
    limits, reached at the end of the step; values outside are clipped. Observed are, in this
    order, the tip's position and velocity and the target's position, in lengths of the rod (and
    second), and the action now in force. That is not the whole state of a rod, which has many
    modes.

    An episode begins in the equilibrium without actuation. The target is the tip in the
    equilibrium under a random action, so that it can be reached and held. The reward of a step
    is minus the distance to it, in lengths of the rod. An episode does not terminate. It is
    truncated after `max_steps`, and where the solve of a step fails.

    `info`: "result", a code of `RESULTS`; "message", what it means; "failed", whether that ended
    the episode; "distance" [m] to the target.

    Raises `ValueError` for limits that are not positive, a scene without actuators, an action
    that is not finite, and where no random action has an equilibrium.
    """

    metadata = {"render_modes": []}

    def __init__(
        self,
        scene: Scene | None = None,
        *,
        dt: float = 0.02,
        max_steps: int = 50,
        tension_limit: float = 0.2,
        pressure_limit: float = 2e4,
        pull_limit: float = 4e-3,
        scheme: AbstractTimeScheme = BDFAlpha(),  # noqa: B008
        method: AbstractMethod = Collocation(6, order=6),  # noqa: B008
        render_mode: str | None = None,
    ):
        if render_mode is not None:
            raise ValueError(f"ReachEnv: render_mode={render_mode!r}; it draws nothing, use None")
        limits = (tension_limit, pressure_limit, pull_limit)
        for kind, limit in zip(KINDS, limits, strict=True):
            if not 0 < limit < np.inf:
                raise ValueError(f"ReachEnv: {kind.one}_limit={limit}; a positive number is needed")
        if scene is None:
            scene = hybrid_robot(gravity=jnp.array([0.0, 0.0, 9.81]))
        self.stepper = Stepper(scene, dt, scheme=scheme, method=method)
        self.render_mode, self.max_steps = None, max_steps
        counts = [kind.count(scene) for kind in KINDS]
        if sum(counts) == 0:
            raise ValueError("ReachEnv: the scene has no tendons and no chambers; add actuators")
        self._limits, self._ends = np.repeat(limits, counts), np.cumsum(counts)
        self.action_space = gymnasium.spaces.Box(-1.0, 1.0, self._limits.shape, np.float32)
        sizes = np.array([_REACH, _SPEED, _REACH, 1], np.float32)
        sizes = np.repeat(sizes, [3, 3, 3, self._limits.size])
        self._sizes = sizes
        self.observation_space = gymnasium.spaces.Box(-sizes, sizes, dtype=np.float32)
        self._fresh: RodState | None = None
        self._state: RodState | None = None

    def reset(
        self, *, seed: int | None = None, options: dict | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Begin an episode; `options={"target": (x, y, z)}` [m] sets the target."""
        super().reset(seed=seed)
        if self._fresh is None:
            rest = self._action(-np.ones(self._limits.shape))
            initial = solve_static(self.stepper.scene, *rest, method=self.stepper.method)
            self._fresh = self.stepper.reset(initial, rest)
        self._state, self._steps = self._fresh, 0
        self._last = -np.ones(self._limits.shape)
        target = (options or {}).get("target")
        self._target = self._random_target() if target is None else np.asarray(target, float)
        if self._target.shape != (3,) or not np.all(np.isfinite(self._target)):
            raise ValueError(f"ReachEnv.reset: target={target}; three numbers [m] are needed")
        return self._observed(self._state)[:2]

    def step(self, action) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """One step of the rod; see the class."""
        if self._state is None:
            raise gymnasium.error.ResetNeeded("ReachEnv.step: call reset first")
        action = np.clip(np.asarray(action, dtype=float), -1.0, 1.0)
        if action.shape != self._limits.shape:
            raise ValueError(
                f"ReachEnv.step: action has shape {action.shape}; {self._limits.shape} is needed"
            )
        self._state = self.stepper.step(self._state, self._action(action))
        self._steps, self._last = self._steps + 1, action
        observation, info, distance = self._observed(self._state)
        truncated = info["failed"] or self._steps >= self.max_steps
        return observation, -distance, False, truncated, info

    def _action(self, action) -> Any:
        """The `Action` of numbers in [-1, 1]."""
        parts = np.split(0.5 * (action + 1.0) * self._limits, self._ends[:-1])
        return Action(*(part if part.size else None for part in parts))

    def _random_target(self) -> np.ndarray:
        code = None
        for _ in range(_DRAWS):
            action = self._action(self.np_random.uniform(-1.0, 1.0, self._limits.shape))
            solution = solve_static(
                self.stepper.scene, *action, method=self.stepper.method, throw=False
            )
            code = solution.result
            if code == RESULTS.successful:
                return np.asarray(solution.tip_position)
        raise ValueError(
            f"ReachEnv.reset: {_DRAWS} random actions have no equilibrium, the last one: "
            f"{result_message(code)}; lower the limits of its inputs"
        )

    def _observed(self, state: RodState):
        view, length = self.stepper.view(state), float(self.stepper.scene.length)
        parts = (view.tip_position, view.tip_velocity, self._target)
        observed = np.concatenate([*(np.asarray(x) / length for x in parts), self._last])
        distance = float(np.linalg.norm(self._target - np.asarray(view.tip_position)))
        info = {
            "result": int(view.result),
            "message": result_message(view.result),
            "failed": bool(view.result != RESULTS.successful),
            "distance": distance,
        }
        clipped = np.clip(observed, -self._sizes, self._sizes).astype(np.float32)
        return clipped, info, distance / length


gymnasium.register("softrod/Reach-v0", entry_point=f"{__name__}:ReachEnv")
