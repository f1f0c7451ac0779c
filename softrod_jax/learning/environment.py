"""A gymnasium environment: bring the tip of a rod to a target, and hold it there.

    gymnasium.make("softrod_jax.learning.environment:softrod/Reach-v0")

Many at once, in one compiled program, are in `vector_environment.py`.
"""

from typing import Any

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
from softrod_jax.learning.reaching import Reaching
from softrod_jax.learning.rendering import frame
from softrod_jax.learning.stepping import RodState
from softrod_jax.scene.scene import Scene
from softrod_jax.statics import solve_static
from softrod_jax.stepping.bdf_alpha import BDFAlpha
from softrod_jax.stepping.scheme import AbstractTimeScheme

# Draws of a target before the limits are called to blame.
_DRAWS = 20


class ReachEnv(gymnasium.Env):
    """Reach a random target with the tip, from rest.

    - `scene`: with tendons or chambers; the hanging `hybrid_robot` if `None`.
    - `dt` [s]: the length of a step. `max_steps`: after so many an episode is truncated.
    - `tension_limit` [N], `pressure_limit` [Pa] and `pull_limit` [m]: of each actuator.
    - `scheme`, `method`: as in `simulate`; the defaults are fast rather than accurate.
    - `render_mode`: "rgb_array" for pictures by `render`, which need the extra `plots`.

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

    metadata = {"render_modes": ["rgb_array"], "render_fps": 25}

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
        if render_mode not in (None, "rgb_array"):
            raise ValueError(
                f"ReachEnv: render_mode={render_mode!r}; 'rgb_array' gives pictures, None nothing"
            )
        limits = (tension_limit, pressure_limit, pull_limit)
        self.task = Reaching(scene, dt, limits, scheme, method)
        self.render_mode, self.max_steps = render_mode, max_steps
        sizes = self.task.sizes
        self.action_space = gymnasium.spaces.Box(-1.0, 1.0, self.task.limits.shape, np.float32)
        self.observation_space = gymnasium.spaces.Box(-sizes, sizes, dtype=np.float32)
        self._state: RodState | None = None

    def reset(
        self, *, seed: int | None = None, options: dict | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Begin an episode; `options={"target": (x, y, z)}` [m] sets the target."""
        super().reset(seed=seed)
        self._state, self._steps = self.task.fresh(), 0
        self._last = -np.ones(self.task.limits.shape)
        target = (options or {}).get("target")
        self._target = self._random_target() if target is None else np.asarray(target, float)
        if self._target.shape != (3,) or not np.all(np.isfinite(self._target)):
            raise ValueError(f"ReachEnv.reset: target={target}; three numbers [m] are needed")
        return self._observed(self._state)[:2]

    def step(self, action) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """One step of the rod; see the class."""
        if self._state is None:
            raise gymnasium.error.ResetNeeded("ReachEnv.step: call reset first")
        action = self.task.checked(action)
        self._state = self.task.stepper.step(self._state, self.task.action(action))
        self._steps, self._last = self._steps + 1, action
        observation, info, distance = self._observed(self._state)
        truncated = info["failed"] or self._steps >= self.max_steps
        return observation, -distance, False, truncated, info

    def render(self) -> np.ndarray | None:
        """A picture of the rod and its target, (height, width, 3); needs the extra `plots`."""
        if self.render_mode is None:
            return None
        if self._state is None:
            raise gymnasium.error.ResetNeeded("ReachEnv.render: call reset first")
        stepper = self.task.stepper
        return frame(stepper.scene, stepper.view(self._state), self._target)

    def _random_target(self) -> np.ndarray:
        code, stepper = None, self.task.stepper
        for _ in range(_DRAWS):
            action = self.task.action(self.np_random.uniform(-1.0, 1.0, self.task.limits.shape))
            solution = solve_static(stepper.scene, *action, method=stepper.method, throw=False)
            code = solution.result
            if code == RESULTS.successful:
                return np.asarray(solution.tip_position)
        raise ValueError(no_target(_DRAWS, code))

    def _observed(self, state: RodState):
        view = self.task.stepper.view(state)
        observation, distance = self.task.observed(view, self._target, self._last)
        info = {
            "result": int(view.result),
            "message": result_message(view.result),
            "failed": bool(view.result != RESULTS.successful),
            "distance": float(distance * float(self.task.stepper.scene.length)),
        }
        return observation, info, float(distance)


def no_target(draws: int, code) -> str:
    """What is said where no random action has an equilibrium."""
    return (
        f"ReachEnv.reset: {draws} random actions have no equilibrium, the last one: "
        f"{result_message(code)}; lower the limits of its inputs"
    )


gymnasium.register(
    "softrod/Reach-v0",
    entry_point=f"{__name__}:ReachEnv",
    vector_entry_point="softrod_jax.learning.vector_environment:ReachVectorEnv",
)
