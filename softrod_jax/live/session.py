"""A rod in real time: what drives it changes while it moves, and what was done is kept as a log."""

import threading
from collections.abc import Mapping
from os import PathLike
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from softrod_jax.bvp.collocation import Collocation
from softrod_jax.foundation.results import RESULTS, result_message
from softrod_jax.learning.stepping import Action, RodView, Stepper
from softrod_jax.rod.reduction import make_rod
from softrod_jax.scene.inputs import KINDS
from softrod_jax.scene.logs import write_log
from softrod_jax.scene.scene import Scene, as_arrays

# An input passes through the range of its slider in this time [s]: no hand pulls faster, and no
# step has to follow a jump.
_THROUGH = 0.3
# The log keeps so much [s]; what is older is forgotten.
_KEPT = 600.0
_STANDARD_GRAVITY = 9.81


class Session:
    """A rod that is driven while it moves.

    - `dt` [s]: the time step. `method`: the grid along the rod; a coarse one, for speed.
    - `most`: how far each kind of inputs goes, in SI units, by name ("tensions", "pressures",
      "pulls"); by default about a quarter of a circle, or a stretch of a tenth.

    `wanted`: the inputs that are asked for, by kind, (actuators,), and `gravity` [m/s^2], (3,), or
    None where the scene has a plane. They may be changed at any time, from any thread.
    """

    def __init__(
        self,
        scene: Scene,
        dt: float = 1 / 60,
        *,
        method: Collocation = Collocation(6),  # noqa: B008
        most: Mapping[str, float] | None = None,
    ):
        scene = as_arrays(scene)
        if scene.gravity is None and scene.plane is None:
            # Absent, it could not be changed without compiling anew.
            scene = eqx.tree_at(lambda s: s.gravity, scene, jnp.zeros(3), is_leaf=_is_none)
        self.scene, self.dt = scene, float(dt)
        self._stepper = Stepper(scene, dt, method=method)
        grid = self._stepper.method.grid(scene)
        self._nodes = np.asarray(self._stepper.method.outputs(grid.s))
        self.counts = {kind.name: kind.count(scene) for kind in KINDS if kind.count(scene)}
        self.most = {**_ranges(scene, grid), **(most or {})}
        self.wanted = {name: np.zeros(count) for name, count in self.counts.items()}
        own = None if scene.gravity is None else np.array(scene.gravity, dtype=float)
        self.gravity = None if scene.plane is not None else own
        self._own_gravity = None if own is None else own.copy()
        self.message = ""
        self._lock = threading.Lock()
        self._rows: list[tuple] = []
        self.reset()

    def reset(self) -> None:
        """Back to rest, all inputs at zero; the log begins anew."""
        with self._lock:
            for values in self.wanted.values():
                values[:] = 0.0
            self._at = {name: np.zeros(count) for name, count in self.counts.items()}
            self._state = self._stepper.reset()
            self._rows.clear()
            self._seen = self._stepper.view(self._state)
            self._keep()

    @property
    def time(self) -> float:
        """Simulated time since the last reset [s]."""
        return float(self._state.time)

    @property
    def inputs(self) -> dict[str, np.ndarray]:
        """What acts now, by kind, on its way to what is wanted."""
        return {name: values.copy() for name, values in self._at.items()}

    @property
    def tip(self) -> np.ndarray:
        """Where the tip is [m], (3,)."""
        return np.asarray(self._seen.tip_position)

    @property
    def tensions(self) -> np.ndarray:
        """The tensions of all tendons [N]."""
        return np.asarray(self._seen.tensions)

    @property
    def shape(self) -> SimpleNamespace:
        """The rod as it is drawn: positions, quaternions and strains, at its arc lengths."""
        seen: RodView = self._seen
        return SimpleNamespace(
            positions=np.asarray(seen.positions),
            quaternions=np.asarray(seen.quaternions),
            strains=np.asarray(seen.strains),
            arc_lengths=self._nodes,
        )

    def step(self) -> bool:
        """One `dt` further, under what is wanted by then. False if there is no such motion: the rod
        is then back at rest, and `message` says why."""
        with self._lock:
            for name, at in self._at.items():
                reach = self.most[name] * self.dt / _THROUGH
                at += np.clip(self.wanted[name] - at, -reach, reach)
            stepper = self._stepper
            if self.gravity is not None:
                stepper = eqx.tree_at(
                    lambda s: s.scene.gravity, stepper, jnp.asarray(self.gravity, dtype=float)
                )
            action = Action(**{name: jnp.asarray(values) for name, values in self._at.items()})
            self._state = stepper.step(self._state, action)
            self._seen = stepper.view(self._state)
            code = int(self._state.result)
            # A grid that is a little coarse is seen by nobody.
            good = code in (int(RESULTS.successful), int(RESULTS.inaccurate))
            if good:
                self._keep()
                return True
        self.reset()
        self.message = f"no such motion, back at rest: {result_message(code)}"
        return False

    def _keep(self) -> None:
        self._rows.append((self.time, self.inputs, self.tip))
        del self._rows[: max(0, len(self._rows) - int(_KEPT / self.dt))]

    def save(self, path: str | PathLike) -> Path:
        """Write what was done since the last reset, the last ten minutes of it, as a log.

        It is one for `softrod plot`, `softrod simulate --log` and `softrod calibrate`. Gravity has
        no column in it: a log in which that was changed says so nowhere.
        """
        with self._lock:
            times, inputs, tips = zip(*self._rows, strict=True)
        columns: dict[str, Any] = {
            name: np.stack([row[name] for row in inputs]) for name in self.counts
        }
        write_log(path, np.asarray(times), **columns, tip_positions=np.stack(tips))
        return Path(path)

    @property
    def gravity_range(self) -> float:
        """How far gravity goes in each direction [m/s^2]."""
        own = 0.0 if self._own_gravity is None else float(np.max(np.abs(self._own_gravity)))
        return max(own, _STANDARD_GRAVITY)


def _ranges(scene: Scene, grid) -> dict[str, float]:
    """How far inputs go: a bend of a quarter of a circle, or a stretch of a tenth."""
    rod, length = make_rod(scene, grid=grid), float(scene.length)
    bending = float(np.max(np.asarray(rod.K_bt[..., 0])))
    moment = bending * 0.5 * np.pi / length
    ranges = {}
    if scene.tendons is not None:
        away = float(np.max(np.linalg.norm(np.asarray(_offsets(scene)), axis=-1)))
        away = max(away, 1e-4 * length)
        ranges["tensions"] = _round(moment / away)
        ranges["pulls"] = _round(away * 0.5 * np.pi)
    if scene.chambers is not None:
        area = float(np.max(np.asarray(scene.chambers.areas)))
        away = float(np.max(np.linalg.norm(np.asarray(scene.chambers.offsets), axis=-1)))
        found = [moment / (area * away)] if away > 1e-6 * length else []
        if rod.K_se is not None:
            found.append(0.1 * float(np.max(np.asarray(rod.K_se[..., -1]))) / area)
        ranges["pressures"] = _round(min(found, default=1e5))
    return ranges


def _offsets(scene: Scene):
    """Where tendons are at the base, (tendons, 2 or 3)."""
    tendons = scene.tendons
    assert tendons is not None, "asked only where there are any"
    if type(tendons).__name__ == "Tendons":
        return tendons.routing(jnp.zeros(()), scene.length)[0]
    return tendons.routing(jnp.zeros(()))[0]


def _round(value: float) -> float:
    """1, 2 or 5 times a power of ten, the next above."""
    power = 10.0 ** np.floor(np.log10(value))
    return float(min(x for x in (1.0, 2.0, 5.0, 10.0) if x * power >= value * (1 - 1e-9)) * power)


def _is_none(x) -> bool:
    return x is None
