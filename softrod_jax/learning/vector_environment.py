"""Many environments at once, in one compiled program: for learning from thousands of rods.

gymnasium.make_vec("softrod_jax.learning.environment:softrod/Reach-v0", num_envs=256)
"""

import jax
import jax.numpy as jnp
import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from softrod_jax.bvp.collocation import Collocation
from softrod_jax.bvp.method import AbstractMethod
from softrod_jax.foundation.results import RESULTS
from softrod_jax.learning.environment import gymnasium, no_target
from softrod_jax.learning.reaching import Reaching, equilibria, many_steps
from softrod_jax.learning.stepping import RodState
from softrod_jax.scene.scene import Scene
from softrod_jax.stepping.bdf_alpha import BDFAlpha
from softrod_jax.stepping.scheme import AbstractTimeScheme

# Targets that are drawn together at least, and batches without one before limits are to blame.
_POOL, _DRAWS = 64, 3


class ReachVectorEnv(VectorEnv):
    """`num_envs` rods that each reach a target of their own; see `ReachEnv`, also for arguments.

    An episode that has ended begins anew in the next step, whose action is not used and whose
    reward is 0 (`AutoresetMode.NEXT_STEP`), while the other ones go on. Of `info`, "result",
    "failed" and "distance" are arrays, (num_envs,).

    `reset(options={"targets": ..})` sets the targets, (num_envs, 3) [m], of the first episodes.
    """

    metadata = {"autoreset_mode": AutoresetMode.NEXT_STEP, "render_modes": []}

    def __init__(
        self,
        num_envs: int = 1,
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
        if num_envs < 1:
            raise ValueError(f"ReachVectorEnv: num_envs={num_envs}; at least 1 is needed")
        if render_mode is not None:
            raise ValueError(f"ReachVectorEnv: render_mode={render_mode!r}; ReachEnv draws")
        limits = (tension_limit, pressure_limit, pull_limit)
        self.task = Reaching(scene, dt, limits, scheme, method)
        self.num_envs, self.max_steps, self.render_mode = num_envs, max_steps, None
        shape, sizes = self.task.limits.shape, self.task.sizes
        self.single_action_space = gymnasium.spaces.Box(-1.0, 1.0, shape, np.float32)
        self.single_observation_space = gymnasium.spaces.Box(-sizes, sizes, dtype=np.float32)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self._pool = np.zeros((0, 3))
        self._states: RodState | None = None

    def reset(self, *, seed: int | None = None, options: dict | None = None):
        """Begin all episodes."""
        super().reset(seed=seed)
        if seed is not None:
            self._pool = np.zeros((0, 3))
        fresh, n = self.task.fresh(), self.num_envs
        states = jax.tree.map(lambda x: jnp.broadcast_to(x, (n, *jnp.shape(x))), fresh)
        self._states = states
        self._ended, self._steps = np.zeros(n, dtype=bool), np.zeros(n, dtype=int)
        self._last = -np.ones((n, *self.task.limits.shape))
        targets = (options or {}).get("targets")
        self._targets = self._draw(n) if targets is None else np.array(targets, dtype=float)
        if self._targets.shape != (n, 3) or not np.all(np.isfinite(self._targets)):
            raise ValueError(f"ReachVectorEnv.reset: targets need shape {(n, 3)}, in metres")
        view = jax.vmap(self.task.stepper.view)(states)
        observation, distance = self.task.observed(view, self._targets, self._last)
        return observation, self._info(view, distance)

    def step(self, actions):
        """One step of every rod; see the class."""
        if self._states is None:
            raise gymnasium.error.ResetNeeded("ReachVectorEnv.step: call reset first")
        task, renew = self.task, self._ended
        numbers = task.checked(actions, (self.num_envs,))
        if not np.all(np.isfinite(numbers)):
            raise ValueError("ReachVectorEnv.step: an action is not finite")
        numbers = np.where(renew[:, None], -1.0, numbers)
        self._states, view = many_steps(
            task.stepper, task.fresh(), self._states, task.action(numbers), jnp.asarray(renew)
        )
        if np.any(renew):
            self._targets[renew] = self._draw(int(np.sum(renew)))
        self._steps, self._last = np.where(renew, 0, self._steps + 1), numbers
        observation, distance = task.observed(view, self._targets, numbers)
        info = self._info(view, distance)
        self._ended = info["failed"] | (self._steps >= self.max_steps)
        reward = np.where(renew, 0.0, -distance)
        return observation, reward, np.zeros(self.num_envs, dtype=bool), self._ended.copy(), info

    def _info(self, view, distance) -> dict[str, np.ndarray]:
        code = np.asarray(view.result)
        length = float(self.task.stepper.scene.length)
        return {"result": code, "failed": code != RESULTS.successful, "distance": distance * length}

    def _draw(self, count: int) -> np.ndarray:
        """So many random targets, from batches of equilibria of one size: one program."""
        size, batches = max(_POOL, self.num_envs), 0
        while len(self._pool) < count:
            numbers = self.np_random.uniform(-1.0, 1.0, (size, *self.task.limits.shape))
            found = equilibria(self.task.stepper, self.task.action(numbers))
            tips, codes = (np.asarray(x) for x in found)
            self._pool = np.concatenate([self._pool, tips[codes == RESULTS.successful]])
            batches += 1
            if batches >= _DRAWS and len(self._pool) < count:
                raise ValueError(no_target(batches * size, codes[codes != RESULTS.successful][-1]))
        drawn, self._pool = self._pool[:count], self._pool[count:]
        return drawn
