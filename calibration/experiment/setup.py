"""A scene and what surrounds it in an experiment: how inputs arrive, the clamp, the sensor.

A scene describes the robot. A recording is also shaped by the bench it was made on, and a fit
that ignores the bench pushes its errors into the material. What is `None` is not computed.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

import softrod_jax as sr
from softrod_jax.rod.rotations import quaternion_exp, quaternion_product, to_base
from softrod_jax.scene.inputs import KINDS, Inputs


class Setup(eqx.Module):
    """What a recording's simulation is made from; a pytree, any number of which can be fitted.

    - `scene`: the robot.
    - `tendon_efficiency` [1], (tendons driven by tension,): tension that arrives / commanded.
    - `pull_gain` [1] and `pull_offset` [m], (tendons driven by length,): the pull that arrives is
      gain * commanded + offset, as of a servo's drum and its zero.
    - `pressure_lag`, `tension_lag`, `pull_lag` [s]: of valves or servos between command and robot,
      of first order: what arrives follows the command with this time constant; in motions only.
    - `pressure_gain` [1/bar, 1/bar^2], (2,): how thrust grows faster than pressure, as of a chamber
      that widens: what acts at the pressure p is p (1 + g1 p + g2 p^2), with p in bar inside the
      parentheses.
    - `release_duration` [s]: how long a hand takes to let go, see `calibration.experiment.release`;
      of recordings without inputs only.
    - `hand_force` [N] and `hand_moment` [N m], (3,): with which a hand held the tip, in the base
      frame, until the motion begins, when it lets go at once, see `calibration.experiment.hand`.
    - `sensor_offset` [m], (3,): the marker seen from the tip, in the tip's own frame.
    - `payload_offset` [m], (3,): the payload's centre seen from the middle of the tip, in the frame
      of the straight rod's end. Of it only the moment of the weight is simulated, constant.
    - `gravity_tilt` [rad], (3,): rotation vector that turns the scene's gravity.
    - `clamp_rotation` [rad], (3,), and `clamp_shift` [m], (3,): how the clamp's pose differs from
      the scene's, in the base frame.
    - `camera_rotation` [rad], (3,), and `camera_shift` [m], (3,): how what is seen is turned about
      the origin and moved, by cameras whose frame is not the scene's. Unlike a clamp that is turned
      they see gravity turned, too.
    """

    scene: sr.Scene
    tendon_efficiency: Float[Array, "tendons"] | None = None
    pull_gain: Float[Array, "by_length"] | None = None
    pull_offset: Float[Array, "by_length"] | None = None
    pressure_lag: Float[Array, ""] | None = None
    tension_lag: Float[Array, ""] | None = None
    pull_lag: Float[Array, ""] | None = None
    pressure_gain: Float[Array, "2"] | None = None
    release_duration: Float[Array, ""] | None = None
    hand_force: Float[Array, "3"] | None = None
    hand_moment: Float[Array, "3"] | None = None
    sensor_offset: Float[Array, "3"] | None = None
    payload_offset: Float[Array, "3"] | None = None
    gravity_tilt: Float[Array, "3"] | None = None
    clamp_rotation: Float[Array, "3"] | None = None
    clamp_shift: Float[Array, "3"] | None = None
    camera_rotation: Float[Array, "3"] | None = None
    camera_shift: Float[Array, "3"] | None = None

    def __check_init__(self):
        if self.is_held and self.release_duration is not None:
            raise ValueError(
                "release_duration is how long a hand follows a rod that it held straight; one that "
                "holds it bent (hand_force, hand_moment) lets go at once: leave one of them out"
            )

    def simulated_scene(self) -> sr.Scene:
        """The scene with gravity and clamp as they are in this experiment."""
        scene = self.scene
        changes = {}
        if self.gravity_tilt is not None:
            assert scene.gravity is not None, "what is tilted is there"
            changes["gravity"] = to_base(quaternion_exp(self.gravity_tilt), scene.gravity)
        if self.clamp_rotation is not None:
            turned = quaternion_exp(self.clamp_rotation)
            was = scene.base_quaternion
            changes["base_quaternion"] = turned if was is None else quaternion_product(turned, was)
        if self.clamp_shift is not None:
            was = scene.base_position
            changes["base_position"] = self.clamp_shift if was is None else was + self.clamp_shift
        if self.payload_offset is not None:
            assert scene.payload is not None, "what is shifted is there"
            weight = scene.payload.mass * changes.get("gravity", scene.gravity)
            base = changes.get("base_quaternion", scene.base_quaternion)
            arm = self.payload_offset if base is None else to_base(base, self.payload_offset)
            load = sr.TipLoad() if scene.tip_load is None else scene.tip_load
            moment = jnp.cross(arm, weight) + (0.0 if load.moment is None else load.moment)
            changes["tip_load"] = sr.TipLoad(load.force, moment)
        for name, value in changes.items():
            scene = eqx.tree_at(
                lambda s, name=name: getattr(s, name), scene, value, is_leaf=lambda x: x is None
            )
        return scene

    def clamp_poses(self, poses: Float[Array, "rows 7"]) -> Float[Array, "rows 7"]:
        """Where the clamp is when a recording has it in `poses`, position and quaternion each."""
        p, h = poses[:, :3], poses[:, 3:]
        if self.clamp_rotation is not None:
            h = quaternion_product(quaternion_exp(self.clamp_rotation), h)
        if self.clamp_shift is not None:
            p = p + self.clamp_shift
        return jnp.concatenate([p, h], axis=1)

    @property
    def is_held(self) -> bool:
        """Whether a hand holds the tip until the motion begins."""
        return self.hand_force is not None or self.hand_moment is not None

    def held_scene(self, scene: sr.Scene) -> sr.Scene:
        """The scene as it is while a hand holds its tip."""
        load = sr.TipLoad() if scene.tip_load is None else scene.tip_load
        force, moment = (
            a if b is None else b if a is None else a + b
            for a, b in ((load.force, self.hand_force), (load.moment, self.hand_moment))
        )
        held = sr.TipLoad(force, moment)
        return eqx.tree_at(lambda s: s.tip_load, scene, held, is_leaf=lambda x: x is None)

    def seen_direction(self, a: Float[Array, "*#n 3"]) -> Float[Array, "*#n 3"]:
        """A vector of the base frame as the cameras see it."""
        rotation = self.camera_rotation
        return a if rotation is None else to_base(quaternion_exp(rotation), a)

    def seen_position(self, p: Float[Array, "*#n 3"]) -> Float[Array, "*#n 3"]:
        """A place [m] as the cameras see it."""
        p = self.seen_direction(p)
        return p if self.camera_shift is None else p + self.camera_shift

    def seen_attitude(self, h: Float[Array, "*#n 4"]) -> Float[Array, "*#n 4"]:
        """A unit quaternion as the cameras see it."""
        if self.camera_rotation is None:
            return h
        return quaternion_product(quaternion_exp(self.camera_rotation), h)

    def arriving(self, inputs: Inputs) -> Inputs:
        """The inputs that reach the robot when `inputs` are commanded."""
        if inputs.tensions is not None and self.tendon_efficiency is not None:
            tensions = self.tendon_efficiency * jnp.asarray(inputs.tensions)
            inputs = inputs._replace(tensions=tensions)
        if inputs.pulls is not None:
            pulls = jnp.asarray(inputs.pulls)
            pulls = pulls if self.pull_gain is None else self.pull_gain * pulls
            pulls = pulls if self.pull_offset is None else pulls + self.pull_offset
            inputs = inputs._replace(pulls=pulls)
        if inputs.pressures is not None and self.pressure_gain is not None:
            p = jnp.asarray(inputs.pressures)
            g1, g2 = self.pressure_gain
            inputs = inputs._replace(pressures=p * (1 + g1 * (p / BAR) + g2 * (p / BAR) ** 2))
        return inputs

    def arriving_in_time(self, inputs: Inputs, dt: Float[Array, ""]) -> Inputs:
        """The inputs that reach the robot in each step, (steps + 1, actuators) each; row 0 is held
        at the beginning, row k + 1 is commanded during step k of `dt` [s]."""
        for kind in KINDS:
            lag, values = getattr(self, f"{kind.one}_lag"), getattr(inputs, kind.name)
            if lag is not None and values is not None:
                inputs = inputs._replace(**{kind.name: lagged(values, lag, dt)})
        return self.arriving(inputs)


BAR = 1e5  # Pa


def lagged(
    commanded: Float[Array, "rows n"], lag: Float[Array, ""], dt: Float[Array, ""]
) -> Float[Array, "rows n"]:
    """What follows a command with a lag of first order [s]: its mean over each step of `dt` [s], in
    which the command is held. It has settled at row 0."""
    kept = jnp.exp(-dt / lag)
    mean = (1 - kept) * lag / dt

    def step(now, command):
        return command + kept * (now - command), command + mean * (now - command)

    _, means = jax.lax.scan(step, commanded[0], commanded[1:])
    return jnp.concatenate([commanded[:1], means])
