"""A rod's motion, the force at its tip and numbers of its scene, from what is seen of it.

An extended Kalman filter whose model is the rod itself: one step of a `Stepper`, whose exact
derivative along a direction costs a fraction of the step. A covariance of all strains and
velocities along the rod has few directions that are not small. It is kept as its root S, P = S S^T,
with few columns (Verlaan & Heemink, Stochastic Hydrology and Hydraulics 11, 1997): each goes
through the step as it is, and after what is measured is taken in, the smallest are left out.
"""

import dataclasses
import operator
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple, cast

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Bool, Float, Int, Real

from softrod_jax.analysis.near_rest import check_smooth
from softrod_jax.bvp.collocation import Collocation
from softrod_jax.bvp.method import AbstractMethod
from softrod_jax.control.low_rank import Weighed, beyond, moved_all, truncated, weighed
from softrod_jax.foundation.compiling import compiled
from softrod_jax.foundation.numbers import ScalarLike
from softrod_jax.foundation.precision import require_float64
from softrod_jax.foundation.results import RESULTS
from softrod_jax.learning.stepping import Action, RodState, Stepper
from softrod_jax.rod.constants import full_strain, inner_strain
from softrod_jax.rod.markers import seen
from softrod_jax.rod.reduction import clamp_pose, make_rod
from softrod_jax.rod.shape import Pose
from softrod_jax.scene.checks import checked_scene
from softrod_jax.scene.inputs import whole_number
from softrod_jax.scene.loads import TipLoad
from softrod_jax.scene.scene import PLANES, Scene
from softrod_jax.statics import StaticSolution, solve_static
from softrod_jax.stepping.scheme import AbstractTimeScheme
from softrod_jax.stepping.sdirk import SDIRK

# What is estimated beside the rod counts this many times more than the rod when directions are left
# out: it is what is asked for, and what nothing else tells of later.
_CHOSEN = 30.0
# A measurement is taken in once more, about what it says of the step, until that changes by less
# than so many standard deviations.
_ENOUGH, _MOST_PASSES = 0.3, 5


class Estimate(eqx.Module):
    """What is known of a rod after the last measurement.

    - `state`: of the `Stepper`, the mean. `force` [N], (3,): at the tip, base frame; zero where it
      is not estimated. `parameters`: by name, each relative to that of the scene.
    - `root`: (fields + chosen, rank), S of the covariance S S^T, of strains and velocities and then
      of what is estimated beside them: the force and the logarithms of the parameters.
    - `forces`: how many components of the force are estimated: all, those in the scene's plane, or
      none.
    - `surprise`: the squares of what the last measurement said beyond what was expected, in terms
      of its covariance; in the mean as many as were measured, where the model holds.
    """

    state: RodState
    force: Float[Array, "3"]
    parameters: dict[str, Float[Array, ""]]
    root: Float[Array, "n rank"]
    surprise: Float[Array, ""]
    forces: int = eqx.field(static=True)

    @property
    def covariance(self) -> Float[Array, "chosen chosen"]:
        """Of the force [N^2], where it is estimated, and of the logarithms of the parameters.

        In a plane the force has two components, across the rod and along z.
        """
        count = self.forces + len(self.parameters)
        own = self.root[self.root.shape[0] - count :]
        return own @ own.T

    @property
    def result(self) -> Int[Array, ""]:
        """The code of the steps so far; where it is not 0, begin anew."""
        return self.state.result


class Estimator(eqx.Module):
    """An extended Kalman filter of a rod that is seen at its tip, or at markers.

    - `scene`, `dt` [s]: the rod and the time from one measurement to the next. A force of the
      scene's own at the tip is added to what is estimated.
    - `sees`: "tip", or names of markers. `position_noise` [m] and `attitude_noise` [rad]: standard
      deviations for each axis of what is seen there.
    - `force` [N]: the standard deviation of each component of an unknown force at the tip when the
      filter begins; `None` for no such force. `force_walk` [N/sqrt(s)]: by how much it wanders.
    - `parameters`: by name, as "young_modulus" or "payload.mass", the standard deviation of each
      relative to the value in the scene. They are positive and constant.
    - `rank`: how many directions of the covariance are kept.
    - `substeps`, `scheme`, `method`: as in `simulate`; the defaults are fast rather than accurate.

    Raises `ValueError` for numbers that are not positive, unknown markers or parameters, a rank
    that is too small, a scheme of several steps, dry friction and backlash.
    """

    scene: Scene
    stepper: Stepper
    noise: Float[Array, "2"]
    force: Float[Array, ""] | None
    force_walk: Float[Array, ""]
    parameters: dict[str, Float[Array, ""]]
    sees: tuple[str, ...] = eqx.field(static=True)
    rank: int = eqx.field(static=True)

    def __init__(
        self,
        scene: Scene,
        dt: ScalarLike,
        *,
        sees: Sequence[str] = ("tip",),
        position_noise: ScalarLike = 3e-4,
        attitude_noise: ScalarLike = 5e-3,
        force: ScalarLike | None = 0.1,
        force_walk: ScalarLike = 0.2,
        parameters: Mapping[str, ScalarLike] | None = None,
        rank: int = 24,
        substeps: int = 1,
        scheme: AbstractTimeScheme = SDIRK(),  # noqa: B008
        method: AbstractMethod = Collocation(8, order=6),  # noqa: B008
    ):
        require_float64("Estimator")
        scene = checked_scene("Estimator", scene)
        check_smooth("Estimator", scene)
        if not scheme.one_step:
            raise ValueError(f"Estimator: scheme={scheme} has a memory of past steps; use SDIRK")
        self.scene, load = scene, scene.tip_load
        given, moment = (None, None) if load is None else (load.force, load.moment)
        at_tip = TipLoad(jnp.zeros(3) if given is None else given, moment)
        scene = dataclasses.replace(scene, tip_load=at_tip)
        self.stepper = Stepper(scene, dt, substeps=substeps, scheme=scheme, method=method)
        self.sees = (sees,) if isinstance(sees, str) else tuple(sees)
        offered = ["tip", *(marker.name for marker in scene.markers or ())]
        for name in self.sees or ("",):
            if name not in offered:
                shown = ", ".join(f'"{x}"' for x in offered)
                raise ValueError(f"Estimator: sees={name!r}; it is offered to see {shown}")
        self.noise = jnp.stack(
            [
                _positive("position_noise", position_noise),
                _positive("attitude_noise", attitude_noise),
            ]
        )
        self.force = None if force is None else _positive("force", force)
        self.force_walk = _positive("force_walk", force_walk, least=True)
        given = dict(parameters or {})
        self.parameters = {name: _positive(name, x) for name, x in given.items()}
        for name in given:
            _check_parameter(scene, name)
        self.rank = whole_number("Estimator", "rank", rank)
        if self.chosen == 0 or self.rank < self.chosen:
            raise ValueError(
                f"Estimator: rank={rank} with {self.chosen} numbers to estimate; at least one "
                "number and as many directions are needed"
            )

    @property
    def chosen(self) -> int:
        """How many numbers are estimated beside the rod's motion: the force's, parameters."""
        return self.axes.shape[0] + len(self.parameters)

    @property
    def axes(self) -> np.ndarray:
        """Along which the force has components, (components, 3): in the scene's plane, if any."""
        if self.force is None:
            return np.zeros((0, 3))
        return np.eye(3) if self.scene.plane is None else np.eye(3)[_in_plane(self.scene)[:2]]

    def begin(
        self, initial: StaticSolution | None = None, action: Action | None = None
    ) -> Estimate:
        """Before the first measurement: at rest, unloaded or in the equilibrium `initial`.

        As of `Stepper.reset`. The force begins to act now; the parameters have acted before, and
        the equilibrium is as uncertain as they are.
        """
        state = self.stepper.reset(initial, action)
        size = ravel_pytree(state.memory[0])[0].size
        deviations = jnp.concatenate([jnp.repeat(x, n) for x, n in self._deviations()])
        root = jnp.zeros((size + self.chosen, self.rank))
        root = root.at[size:, : self.chosen].set(jnp.diag(deviations))
        if initial is not None and self.parameters:
            first = self.chosen - len(self.parameters)
            slope = _slope(self, initial, state.action) * deviations[first:]
            root = root.at[: slope.shape[0], first : self.chosen].set(slope)
        ones = {name: jnp.ones(()) for name in self.parameters}
        zero = jnp.zeros(())
        return Estimate(state, jnp.zeros(3), ones, root, zero, self.axes.shape[0])

    def step(
        self,
        estimate: Estimate,
        action: Action,
        positions: Real[Array | np.ndarray, "markers 3"],
        quaternions: Real[Array | np.ndarray, "markers 4"] | None = None,
    ) -> Estimate:
        """What is known one `dt` later, when what is seen has been taken in.

        - `action`: reached linearly at the end of the step, as of `Stepper.step`.
        - `positions` [m] and, where attitudes are seen, `quaternions` (w, x, y, z): in the order of
          `sees`. Those that are NaN have not been seen. In a plane, what is off it does not count.

        Raises `ValueError` for wrong shapes.
        """
        count = len(self.sees)
        positions = jnp.asarray(positions, dtype=float)
        if positions.shape != (count, 3):
            raise ValueError(
                f"Estimator.step: positions has shape {positions.shape}; {(count, 3)} is needed"
            )
        if quaternions is None:
            quaternions = jnp.full((count, 4), jnp.nan)
        quaternions = jnp.asarray(quaternions, dtype=float)
        if quaternions.shape != (count, 4):
            raise ValueError(
                f"Estimator.step: quaternions has shape {quaternions.shape}; {(count, 4)} is needed"
            )
        return _step(self, estimate, action, Pose(positions, quaternions))

    def _deviations(self):
        """At first, with how many numbers have each."""
        own = [] if self.force is None else [(self.force, self.axes.shape[0])]
        return own + [(x, 1) for x in self.parameters.values()]


def _walk(estimator: Estimator) -> Float[Array, "chosen"]:
    """By how much, in a step, what is estimated wanders."""
    own, count = jnp.zeros(estimator.chosen), estimator.axes.shape[0]
    return own.at[:count].set(estimator.force_walk * jnp.sqrt(estimator.stepper.dt))


def _stepper_with(estimator: Estimator, chosen: Float[Array, "chosen"]) -> Stepper:
    """That of a rod with this force and these logarithms of parameters."""
    scene, axes = estimator.stepper.scene, estimator.axes
    count = len(axes)
    if count:
        load: Any = scene.tip_load
        changed = TipLoad(load.force + chosen[:count] @ axes, load.moment)
        scene = dataclasses.replace(scene, tip_load=changed)
    scene = _scaled(estimator, scene, chosen[count:])
    return dataclasses.replace(estimator.stepper, scene=scene)


def _scaled(estimator: Estimator, scene: Scene, logs: Float[Array, "parameters"]) -> Scene:
    """With parameters that are so many times as large, the logarithms of which are given."""
    for name, x in zip(estimator.parameters, logs, strict=True):
        pick = operator.attrgetter(name)
        scene = eqx.tree_at(pick, scene, pick(scene) * jnp.exp(x))
    return scene


def _poses(estimator: Estimator, stepper: Stepper, state: RodState) -> Pose:
    """Of what is seen, (markers, 3) and (markers, 4)."""
    scene, method = stepper.scene, stepper.method
    grid = method.grid(scene)
    strain = full_strain(state.strains, make_rod(scene, grid=grid))
    shape = method.shape(strain, grid, *clamp_pose(scene))
    every = seen(scene, method.inside(strain), method.outputs(grid.s), *shape)
    poses = [every[name] for name in estimator.sees]
    return jax.tree.map(lambda *x: jnp.stack(x), *poses)


@compiled
def _slope(estimator: Estimator, initial: StaticSolution, action: Action):
    """How the strains of an equilibrium follow the logarithms of the parameters."""
    method, acting = estimator.stepper.method, cast(Any, action)

    def strains(logs):
        scene = _scaled(estimator, estimator.scene, logs)
        found = solve_static(scene, *acting, before=initial, method=method, throw=False)
        return inner_strain(found.point_strains, make_rod(scene, grid=method.grid(scene))).ravel()

    return jax.jacfwd(strains)(jnp.zeros(len(estimator.parameters)))


class _Pass(NamedTuple):
    """The end of a step, linearised about the mean and so much of each column of the root.

    - `end`: the state there, and `fields` and `mean`: how it follows the columns, and where it is
      once the measurement is taken in. `change`: of what the weights are now.
    """

    end: RodState
    fields: Float[Array, "fields r"]
    mean: Float[Array, "fields"]
    found: Weighed
    change: Float[Array, ""]
    count: Int[Array, ""]

    @property
    def good(self) -> Bool[Array, ""]:
        # What is only too coarse a grid for a moment is no failure.
        return self.end.progress.result == RESULTS.successful


@compiled
def _step(estimator: Estimator, estimate: Estimate, action: Action, measured: Pose) -> Estimate:
    state, dim = estimate.state, estimator.chosen
    x, as_fields = ravel_pytree(state.memory[0])
    logs = [jnp.log(value)[None] for value in estimate.parameters.values()]
    axes = estimator.axes
    chosen = jnp.concatenate([axes @ estimate.force, *logs])
    walk = jnp.concatenate([jnp.zeros((x.size, dim)), jnp.diag(_walk(estimator))])
    root = jnp.concatenate([estimate.root, walk], 1)
    before, own = root[: x.size], root[x.size :]

    def after(weights):
        stepper = _stepper_with(estimator, chosen + own @ weights)
        end = stepper.step(_with_fields(state, as_fields(x + before @ weights)), action)
        pose = _poses(estimator, stepper, end)
        return (ravel_pytree(end.memory[0])[0], moved_all(pose)), (end, pose)

    def about(weights, count):
        _, along, (end, pose) = jax.linearize(after, weights, has_aux=True)
        fields, Y = jax.vmap(along, out_axes=1)(jnp.eye(weights.size))
        off = jnp.where(_sensed(estimator), beyond(pose, measured), jnp.nan)
        found = weighed(Y, off + Y @ weights, _precision(estimator))
        change = found.weights - weights
        mean = ravel_pytree(end.memory[0])[0] + fields @ change
        return _Pass(end, fields, mean, found, jnp.linalg.norm(change), count + 1)

    def again(last):
        new = about(last.found.weights, last.count)
        kept = jax.tree.map(lambda a, b: jnp.where(new.good, a, b), new, last)
        return kept._replace(change=jnp.where(new.good, new.change, 0.0), count=new.count)

    first = about(jnp.zeros(root.shape[1]), jnp.zeros((), jnp.int32))
    goes_on = lambda p: p.good & (p.change > _ENOUGH) & (p.count < _MOST_PASSES)
    last = jax.lax.while_loop(goes_on, again, first)
    wide = jnp.concatenate([last.fields, own])
    root = last.found.narrowed(wide)
    root = truncated(root, _sizes(root, dim, last.end.memory[0]), estimator.rank)
    keep = lambda a, b: jnp.where(last.good, a, b)
    chosen = keep(chosen + own @ last.found.weights, chosen)
    mean = keep(last.mean, ravel_pytree(last.end.memory[0])[0])
    count = len(axes)
    parameters = zip(estimator.parameters, jnp.exp(chosen[count:]), strict=True)
    return Estimate(
        state=_with_fields(last.end, as_fields(mean)),
        force=chosen[:count] @ axes if count else estimate.force,
        parameters=dict(parameters),
        root=keep(root, estimate.root),
        surprise=keep(last.found.surprise, 0.0),
        forces=estimate.forces,
    )


def _sizes(root, dim, fields) -> Float[Array, "n"]:
    """Of each row: that of all strains, or velocities, of its kind, and of what is chosen."""
    n = root.shape[0] - dim
    squares = jnp.sum(root**2, 1)
    count, parts = 0, []
    for leaf in jax.tree.leaves(fields):
        own = squares[count : count + leaf.size].reshape(-1, leaf.shape[-1])
        parts.append(jnp.broadcast_to(jnp.sum(own, 0), own.shape).ravel())
        count += leaf.size
    rod = jnp.sqrt(jnp.concatenate(parts))
    rod = jnp.maximum(rod, 1e-9 + 1e-3 * jnp.max(rod))
    own = jnp.sqrt(squares[n:])
    return jnp.concatenate([rod, jnp.where(own > 0, own, 1.0) / _CHOSEN])


def _with_fields(state: RodState, fields) -> RodState:
    return dataclasses.replace(state, memory=(fields, *state.memory[1:]))


def _in_plane(scene: Scene) -> list[int]:
    """Which of a position and a rotation vector, (6,), are in the scene's plane."""
    across = PLANES.index(cast(str, scene.plane))
    return [across, 2, 3 + 1 - across]


def _sensed(estimator: Estimator) -> np.ndarray:
    """Whether it counts, of each number of the poses that are seen: in a plane, three of six."""
    plane = estimator.scene.plane
    one = np.isin(np.arange(6), range(6) if plane is None else _in_plane(estimator.scene))
    return np.tile(one, len(estimator.sees))


def _precision(estimator: Estimator) -> Float[Array, "p"]:
    return jnp.tile(jnp.repeat(1 / estimator.noise, 3), len(estimator.sees))


def _positive(name: str, value, least: bool = False) -> Float[Array, ""]:
    number = np.asarray(value, dtype=float)
    if number.shape != () or not (0 < number < np.inf or (least and number == 0)):
        raise ValueError(f"Estimator: {name}={value}; a positive number is needed")
    return jnp.asarray(number)


def _check_parameter(scene: Scene, name: str) -> None:
    try:
        value = operator.attrgetter(name)(scene)
    except AttributeError:
        value = None
    if value is None or not eqx.is_inexact_array(value) or not np.all(np.asarray(value) > 0):
        raise ValueError(
            f"Estimator: the scene has no positive number {name!r}; name one that is there, such "
            'as "young_modulus" or "payload.mass"'
        )
