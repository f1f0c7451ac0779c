"""A motion one step at a time: `step(state, action) -> state`, a pure function.

For loops in which the next input depends on the motion so far: policies, controllers, learned
corrections. The steps are those of `simulate`. A state is a pytree: it goes through `jit`,
`vmap`, `grad` and `lax.scan`.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from softrod_jax.bvp.collocation import Collocation
from softrod_jax.bvp.method import AbstractMethod
from softrod_jax.bvp.newton import NewtonOptions
from softrod_jax.dynamics import beginning_in
from softrod_jax.foundation.compiling import compiled
from softrod_jax.foundation.numbers import ScalarLike
from softrod_jax.foundation.precision import require_float64
from softrod_jax.foundation.results import RESULTS, without_derivative
from softrod_jax.learning.bound import hashable
from softrod_jax.rod.constants import full_strain
from softrod_jax.rod.given_lengths import tensions_of
from softrod_jax.rod.reduction import clamp_pose, make_rod
from softrod_jax.rod.rotations import to_base
from softrod_jax.rod.shape import ORIGIN
from softrod_jax.rod.validity import usable, usable_in_time
from softrod_jax.scene.checks import checked_scene
from softrod_jax.scene.contacts import contact_names
from softrod_jax.scene.inputs import (
    Inputs,
    after_play,
    checked_inputs,
    filled,
    good_inputs,
    time_step,
    whole_number,
    zero_unless,
)
from softrod_jax.scene.planes import in_space
from softrod_jax.scene.poses import Poses, PosesLike, checked_pose, checked_poses
from softrod_jax.scene.scene import Scene
from softrod_jax.statics import StaticSolution
from softrod_jax.stepping.courses import Pasts, at_rest, go_on
from softrod_jax.stepping.marching import stepping_of
from softrod_jax.stepping.moving_rod import Progress, State
from softrod_jax.stepping.scheme import AbstractTimeScheme
from softrod_jax.stepping.sdirk import SDIRK
from softrod_jax.stepping.step_inputs import StepInputs, without_places

# The inputs, as learning calls them. Actuators that are `None` are at zero here.
Action = Inputs


class RodState(eqx.Module):
    """All that the next step depends on, and the code of the steps so far.

    - `time` [s] since the reset; `action`: what acts at this moment, behind the play of actuators.
    - `strains` (v, u) and `velocities` (q, omega), (points, 6) each, body frame, at all points
      of the method. Of a scene that is inextensible, or in a plane, only what is unknown there;
      `Stepper.view` has all.
    - `result`: a code of `RESULTS`; 0 is success. From the first step that has no solution on,
      the rod is held where it was, with the derivative zero, until it is reset.
    - `iterations` of Newton's method in the last step; `error` there of the discretisation along
      the rod, estimated, in lengths of the rod.

    `memory` is the time scheme's, `progress` what a step hands to the next: where Newton's method
    starts, the factors of its last Jacobian, the code. `past`: where what is carried has been.
    """

    time: Float[Array, ""]
    action: Action
    memory: Any
    progress: Progress
    first: Bool[Array, ""]
    jumps: Bool[Array, ""]
    past: Pasts
    made_by: tuple[AbstractTimeScheme, AbstractMethod] = eqx.field(static=True)

    @property
    def strains(self) -> Float[Array, "*batch points strain"]:
        return self.memory[0].strain

    @property
    def velocities(self) -> Float[Array, "*batch points pair"]:
        return self.memory[0].velocity

    @property
    def result(self) -> Int[Array, "*batch"]:
        progress, method = self.progress, self.made_by[1]
        coarse = (progress.result == RESULTS.successful) & (progress.from_grid > method.max_error)
        return jnp.where(coarse, RESULTS.inaccurate, progress.result).astype(jnp.int32)

    @property
    def iterations(self) -> Int[Array, "*batch"]:
        return self.progress.iterations

    @property
    def error(self) -> Float[Array, "*batch"]:
        return self.progress.from_grid


class RodView(eqx.Module):
    """What a state looks like from outside; the fields of `Trajectory` at one instant.

    - `time` [s]; `tip_position` [m], (3,), and `tip_velocity` [m/s], (3,), base frame.
    - `positions` [m], (outputs, 3); `quaternions` (w, x, y, z), (outputs, 4).
    - `strains` (v, u) and `velocities` (q, omega), (outputs, 6), body frame.
    - `tensions` [N], (tendons,): of all tendons, at the end where their actuator is.
    - `contact_forces`: by the name of each contact, (3,) [N], as in `Trajectory`.
    - `result`: a code of `RESULTS`.
    """

    time: Float[Array, "*steps"]
    tip_position: Float[Array, "*steps 3"]
    tip_velocity: Float[Array, "*steps 3"]
    positions: Float[Array, "*steps outputs 3"]
    quaternions: Float[Array, "*steps outputs 4"]
    strains: Float[Array, "*steps outputs 6"]
    velocities: Float[Array, "*steps outputs 6"]
    tensions: Float[Array, "*steps tendons"]
    contact_forces: dict[str, Float[Array, "*steps 3"]]
    result: Int[Array, "*steps"]


class Stepper(eqx.Module):
    """A scene and how it is stepped through time.

    - `dt` [s]: the length of a step; `substeps`: equal parts into which it is divided.
    - `scheme`, `method`, `newton`: as in `simulate`.

    A pytree, too: differentiate in `scene` and `dt`, or map over a batch of them.
    All its methods are pure and compiled; no failure of a step raises, see `RodState.result`.
    Raises `ValueError` for a step dt <= 0, fewer than one substep, numbers that a scene cannot
    have, and without float64.
    """

    scene: Scene
    dt: Float[Array, ""]
    scheme: AbstractTimeScheme
    method: AbstractMethod
    newton: NewtonOptions
    substeps: int = eqx.field(static=True)

    def __init__(
        self,
        scene: Scene,
        dt: ScalarLike,
        *,
        substeps: int = 1,
        scheme: AbstractTimeScheme = SDIRK(),  # noqa: B008
        method: AbstractMethod = Collocation(),  # noqa: B008
        newton: NewtonOptions = NewtonOptions(),  # noqa: B008
    ):
        require_float64("Stepper")
        self.scene, self.dt = checked_scene("Stepper", scene), time_step("Stepper", dt)
        self.substeps = whole_number("Stepper", "substeps", substeps)
        self.scheme, self.method, self.newton = scheme, method.fitted(scene), newton

    def reset(
        self,
        initial: StaticSolution | None = None,
        action: Action | None = None,
        *,
        carried: Sequence[str] = (),
    ) -> RodState:
        """The state of a rod at rest: unloaded, with all actuators at zero.

        - `initial`: in this equilibrium instead, found with the same `method` under `action`.
        - `carried`: what each step from here on takes a pose of: "base", and names of contacts.

        Raises `ValueError` for an `initial` of another method, an `action` without one, and a name
        that no contact has.
        """
        names = contact_names(self.scene.contacts)
        for name in carried:
            if name not in ("base", *names):
                raise ValueError(
                    f"Stepper.reset: carried has {name!r}; there are {', '.join(('base', *names))}"
                )
        if initial is None and action is not None:
            raise ValueError(
                "Stepper.reset: an action without `initial`; give the equilibrium under it, "
                "solve_static(scene, *action, method=stepper.method)"
            )
        if initial is not None and initial.method != self.method:
            raise ValueError(
                "Stepper.reset: `initial` was solved with another method; give both the same "
                "`method`"
            )
        action = self._checked("Stepper.reset", Action() if action is None else action, ndim=1)
        return _reset(self, initial, action, tuple(carried))

    @hashable
    def step(
        self,
        state: RodState,
        action: Action,
        jump=None,
        *,
        base: PosesLike | None = None,
        contacts: Mapping[str, PosesLike] | None = None,
    ) -> RodState:
        """The state one `dt` later.

        - `action`: reached linearly at the end of the step, from what acted before; the same
          again is constant.
        - `jump`: whether it acts from the beginning of the step instead, a bool or a traced one.
          By default only the first step of an unloaded rod jumps, as in `simulate`.
        - `base`, `contacts`: the poses at the end of the step, (7,), of what `reset` said is
          carried. Where `simulate` knows the next pose too, here slopes look back.

        An action or a pose that is not finite, or a negative tension, is the code `bad_input` where
        it is traced. Raises `ValueError` where it is not, for wrong shapes, for other poses than
        those of what is carried, and for a state that a stepper of another scheme or method made.
        """
        self._own("Stepper.step", state)
        action = self._checked("Stepper.step", action, ndim=1)
        poses = checked_pose("Stepper.step", self.scene, base, contacts)
        _same_carried("Stepper.step", self.scene, state, poses)
        jump = state.jumps if jump is None else jnp.asarray(jump)
        return _step(self, state, action, jump, poses)

    @hashable
    def rollout(
        self,
        state: RodState,
        actions: Action,
        jumps: Bool[Array | np.ndarray, "steps"] | None = None,
        *,
        base: PosesLike | None = None,
        contacts: Mapping[str, PosesLike] | None = None,
    ) -> tuple[RodState, RodView]:
        """Steps through `actions`, (steps, actuators) each, one row a step; poses (steps, 7), too.

        Returns the last state, and what is seen after each step, with a leading axis of steps.
        """
        self._own("Stepper.rollout", state)
        poses = checked_poses("Stepper.rollout", self.scene, base, contacts)
        _same_carried("Stepper.rollout", self.scene, state, poses)
        actions = self._checked("Stepper.rollout", actions, 2, jax.tree.leaves(poses))
        sizes = {x.shape[0] for x in jax.tree.leaves((actions, poses))}
        if len(sizes) != 1:
            raise ValueError(f"Stepper.rollout: lengths of {sizes}; one row a step is needed")
        if jumps is not None and jnp.shape(jumps) != (*sizes,):
            raise ValueError(
                f"Stepper.rollout: jumps has shape {jnp.shape(jumps)}; one a step is needed"
            )
        return _rollout(self, state, actions, jumps, poses)

    @hashable
    def view(self, state: RodState) -> RodView:
        """Where the rod is, and how it moves."""
        self._own("Stepper.view", state)
        return _view(self, state)

    def _own(self, who, state):
        if state.made_by != (self.scheme, self.method):
            raise ValueError(
                f"{who}: the state was made with {state.made_by}, and this stepper has "
                f"{(self.scheme, self.method)}; use one stepper from the reset on"
            )

    def _checked(self, who, action, ndim, beside=()) -> Action:
        """With arrays for all actuators that the scene has. `beside`: other rows of steps."""
        action = checked_inputs(who, self.scene, action, ndim)
        given = [x.shape[:-1] for x in (*jax.tree.leaves(action), *beside)]
        if ndim == 2 and not given:
            raise ValueError(f"{who}: no inputs to tell how many steps; give rows of zeros")
        return filled(self.scene, action, given[0] if given else ())


def reset_where(done: Bool[Array, ""], fresh: RodState, state: RodState) -> RodState:
    """`fresh` where `done`, else `state`; inside `vmap`, each sample by itself.

    `fresh` may be one state for the whole batch (`in_axes=(0, None, 0)`) or one for each.
    """
    return jax.tree.map(lambda a, b: jnp.where(done, a, b), fresh, state)


def _same_carried(who, scene: Scene, state: RodState, poses: Poses) -> None:
    names = ("base", *contact_names(scene.contacts))
    given = _named(names, poses)
    carried = _named(names, state.past)
    if given != carried:
        raise ValueError(
            f"{who}: poses of {', '.join(given) or 'nothing'}, and the state carries "
            f"{', '.join(carried) or 'nothing'}; give those, as `reset` said with `carried`"
        )


def _named(names, of: Poses | Pasts) -> list[str]:
    """The names of those that there are."""
    obstacles = of.obstacles or (None,) * (len(names) - 1)
    each = zip(names, (of.base, *obstacles), strict=True)
    return [name for name, one in each if one is not None]


def _stepping(stepper, action):
    """The steps of `marching.py`, and whether there can be such a scene."""
    scene, dt, good = usable_in_time(stepper.scene, stepper.dt)
    how = stepper.substeps, stepper.scheme, stepper.method, stepper.newton
    return stepping_of(scene, dt, action, *how), good


@compiled
def _reset(stepper, initial, action, carried):
    from_rest = initial is None
    begin = None if from_rest else beginning_in(initial, stepper.scene)
    stepping, good = _stepping(stepper, action)
    memory, progress = stepping.moving.at_rest(begin, good)
    true = jnp.array(True)
    made_by = (stepper.scheme, stepper.method)
    past = _at_rest(stepper.scene, carried)
    return RodState(jnp.zeros(()), action, memory, progress, true, true & from_rest, past, made_by)


def _at_rest(scene: Scene, carried) -> Pasts:
    """Of the base and the obstacles that are carried, by their names."""
    names = contact_names(scene.contacts)
    base = at_rest(clamp_pose(scene)) if "base" in carried else None
    each = tuple(at_rest(ORIGIN) if name in carried else None for name in names)
    return Pasts(base, each if set(names) & set(carried) else ())


@compiled
def _step(stepper, state, action, jump, poses=Poses()):
    past, courses = go_on(state.past, poses, state.first)
    good = good_inputs(action)
    good = good if courses.good is None else good & courses.good
    action = after_play(stepper.scene, zero_unless(good, action), state.action.pulls)
    jumps = jax.tree.map(lambda x: jnp.broadcast_to(jump, x.shape), action)
    inputs = StepInputs(state.action, action, without_places(jumps), good, courses)
    restart = state.first | jump
    stepping, possible = _stepping(stepper, action)
    dt = stepping.moving.dt
    length = dt / stepper.substeps
    coefficients = stepper.scheme.coefficients(length, restart[None])[0]
    progress = state.progress._replace(result=_unless_bad(possible, state.result))
    (memory, progress), _ = stepping.step(State(state.memory, progress), coefficients, inputs)
    no = jnp.array(False)
    return RodState(state.time + dt, action, memory, progress, no, no, past, state.made_by)


def _unless_bad(good, result):
    """The code so far, or of a stepper whose numbers have become such as cannot be."""
    bad = ~good & (result == RESULTS.successful)
    return jnp.where(bad, RESULTS.bad_input, result).astype(jnp.int32)


@compiled
def _rollout(stepper, state, actions, jumps, poses):
    def one(state, row):
        action, jump, pose = row
        state = _step(stepper, state, action, state.jumps if jump is None else jump, pose)
        return state, _view(stepper, state)

    return jax.lax.scan(one, state, (actions, jumps, poses))


@compiled
def _view(stepper, state):
    method, (scene, good) = stepper.method, usable(stepper.scene)
    result = _unless_bad(good, state.result)
    grid = method.grid(scene)
    strains = full_strain(state.strains, make_rod(scene, grid=grid))
    clamp = clamp_pose(scene) if state.past.base is None else state.past.base.pose
    positions, quaternions = method.shape(strains, grid, *clamp)
    pushes, names = state.progress.pushes, contact_names(scene.contacts)
    velocities = in_space(method.outputs(state.velocities), scene.plane)
    view = RodView(
        time=state.time,
        tip_position=positions[-1],
        tip_velocity=to_base(quaternions[-1], velocities[-1, :3]),
        positions=positions,
        quaternions=quaternions,
        strains=method.outputs(strains),
        velocities=velocities,
        tensions=tensions_of(scene, state.action.tensions, state.progress.multipliers),
        contact_forces={} if pushes is None else dict(zip(names, pushes, strict=True)),
        result=result,
    )
    return without_derivative(result != RESULTS.successful, view)
