"""How a recording with inputs begins: straight, or in equilibrium under its loads.

A simulation starts from one of them, and a log does not say from which. Two things tell: where the
tip is at first, by all samples before it first moves, and whether it rests there although loads
act. A marker is seldom quite where it is said to be, and a stiffness is not known beforehand, so
that neither is asked for more than it can tell.
"""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

import softrod_jax as sr
from calibration.data.carried import at_first
from calibration.data.frames import straight_tip
from calibration.data.onset import start_position, white_noise
from calibration.data.recording import Recording
from calibration.experiment.bulk import bulk
from calibration.experiment.hand import held
from softrod_jax.rod.rotations import to_base
from softrod_jax.scene.tendons import driven_by_length

# A tip this part of the length from the straight rod's may be the straight one's, seen by a marker
# that is off; from the second on it is certainly not.
_NEAR, _FAR = 0.02, 0.1
# Which part of the way to the equilibrium, as linear theory has it with the scene's values, a tip
# must be to be taken for one that hangs: if it rests, and if it moves from the start.
_PART_RESTING, _PART_MOVING = 0.1, 0.25
# Deflections do not grow beyond this part of the length, whatever linear theory says.
_LARGEST = 0.6
# A deflection below so many standard deviations of the noise, of so many samples, is not seen.
_SIGMAS, _FEW = 4.0, 20
# Through the tendons, one by one, to the tensions that hold all their lengths.
_SWEEPS = 200


def hangs(scene: sr.Scene, recording: Recording) -> bool:
    """Whether the rod begins in equilibrium under its loads, and not straight."""
    if held(recording):
        return True
    if recording.starts_hanging is not None:
        return recording.starts_hanging
    if not recording.has_inputs or np.count_nonzero(recording.has_tip) < 3:
        return False
    scene = at_first(scene, recording.carried)
    start, rests = start_position(recording)
    seen = recording.coordinates
    moved = np.where(seen, start - straight_tip(scene), 0.0) / float(scene.length)
    away = float(np.linalg.norm(moved))
    if away > _FAR:
        return True
    expected = np.where(seen, _linear_deflection(scene, recording), 0.0) / float(scene.length)
    size = float(np.linalg.norm(expected))
    if size == 0:
        return away > _NEAR
    if size > _LARGEST:
        expected, size = expected * _LARGEST / size, _LARGEST
    if rests and size < _NEAR:
        # Either place could be meant; not in equilibrium it would not rest.
        return True
    noise = white_noise(recording.track[1][:_FEW])
    if not rests and size * float(scene.length) < _SIGMAS * noise:
        # No place could tell, and what rings then is no larger than the noise.
        return False
    part = float(moved @ expected) / size**2
    return part > (_PART_RESTING if rests else _PART_MOVING)


def beginning(recording: Recording, hanging: bool) -> str:
    """What is assumed of how a recording begins, in words."""
    if held(recording):
        return "bent, held by a hand at the tip until it lets go at once"
    if not recording.has_inputs:
        return "straight, held until it is let go"
    told = "" if recording.starts_hanging is None else ", as it was told"
    if hanging:
        return f"in equilibrium under its first inputs{told}"
    return f"straight and at rest, all loads acting from then on{told}"


def _holding(
    tendons, needed: Float[np.ndarray, "pulled"], per_newton: Float[np.ndarray, "pulled pulled"]
) -> Float[np.ndarray, "pulled"]:
    """The tensions [N] of the tendons driven by length, none of which pushes.

    `needed` [m]: by how much each is still to become shorter; `per_newton` [m/N]: how much shorter
    the path of each is under the tension of each.
    """
    of_each = lambda values: [0.0 if values is None else values[i] for i in tendons.by_length]
    before = np.array([0.0 if x is None else float(x) for x in of_each(tendons.pretension)])
    own = [0.0 if not x else 1 / float(x) for x in of_each(tendons.stiffness)]
    per_newton = per_newton + np.diag(own)
    needed = needed + per_newton @ before
    tension = np.zeros_like(needed)
    for _ in range(_SWEEPS):
        for i, row in enumerate(per_newton):
            tension[i] = max(0.0, tension[i] + (needed[i] - row @ tension) / row[i])
    return tension


def _linear_deflection(scene: sr.Scene, recording: Recording) -> Float[np.ndarray, "3"]:
    """The deflection of the tip [m] under all loads and the first inputs, by linear beam theory, in
    the base frame."""
    L = float(scene.length)
    rod = bulk(scene)
    EI, EA = np.asarray(rod.EI), float(rod.EA)
    h = None if scene.base_quaternion is None else np.asarray(scene.base_quaternion)

    def seen(vector, sense):
        """The vector in the frame of the clamp (-1), or back in the base frame (1)."""
        vector = jnp.zeros(3) if vector is None else jnp.asarray(vector, dtype=float)
        own = None if h is None else jnp.array(h * [1, sense, sense, sense])
        return np.asarray(vector if own is None else to_base(own, vector))

    gravity = seen(scene.gravity, -1)
    weight = float(rod.mass) * gravity
    mass = 0.0 if scene.payload is None else float(scene.payload.mass)
    tip = mass * gravity
    moment = np.zeros(2)  # that bends towards x and y
    if scene.tip_load is not None:
        couple = seen(scene.tip_load.moment, -1)
        tip, moment = tip + seen(scene.tip_load.force, -1), moment + [couple[1], -couple[0]]
    tendons, chambers = scene.tendons, scene.chambers
    thrusts = []
    by_length = () if tendons is None else driven_by_length(tendons)
    if tendons is not None and recording.tensions is not None:
        given = [i for i in range(tendons.count) if i not in by_length]
        thrusts.append((-np.asarray(recording.tensions[0]), np.asarray(tendons.offsets)[given]))
    if chambers is not None and recording.pressures is not None:
        thrust = np.asarray(recording.pressures[0]) * np.asarray(chambers.areas)
        thrusts.append((thrust, np.asarray(chambers.offsets)))
    for thrust, offsets in thrusts:
        tip = tip + [0.0, 0.0, np.sum(thrust)]
        moment = moment - thrust @ offsets
    if tendons is not None and recording.pulls is not None:
        # What the other loads turn the tip by, and lengthen the rod.
        turn = (weight[:2] * L**2 / 6 + tip[:2] * L**2 / 2 + moment * L) / EI[::-1]
        longer = (weight[2] / 2 + tip[2]) * L / EA
        offsets = np.asarray(tendons.offsets)[list(by_length)]
        needed = np.asarray(recording.pulls[0]) - offsets @ turn + longer
        per_newton = L * (1 / EA + offsets / EI[::-1] @ offsets.T)
        tension = _holding(tendons, needed, per_newton)
        tip = tip - [0.0, 0.0, np.sum(tension)]
        moment = moment + tension @ offsets
    # I_y bends towards x, I_x towards y, here and above.
    bend = (weight[:2] * L**3 / 8 + tip[:2] * L**3 / 3 + moment * L**2 / 2) / EI[::-1]
    return seen(np.append(bend, (weight[2] / 2 + tip[2]) * L / EA), 1)
