"""Before the search: can this recording be of that scene at all?

A search goes on for minutes where nothing can be found. What no value of a parameter mends shows in
the first simulation: a tip that begins where the rod does not, or that would fit along other axes.
"""

import itertools
from collections.abc import Callable, Sequence

import numpy as np
from jaxtyping import Float

from calibration.data.frames import straight_tip
from calibration.data.recording import Recording, RecordingError
from calibration.experiment.beginning import beginning
from calibration.problem.batch import recording_of
from calibration.problem.motion import tip_at
from calibration.problem.problem import Point

# Nothing is said of a tip that is nearer to the simulated one than this part of the length, rms.
_FAR = 0.3
# Other axes are named if they leave less than this part of that.
_CLEARLY = 1 / 3
# No equilibrium whose stiffness is off is so far from both the straight rod and the scene's own.
_ELSEWHERE = 0.5


def check_axes(point: Point, recordings: Sequence[Recording]) -> None:
    """Raises `RecordingError` for a recording that begins elsewhere than the rod, or whose tip
    would be where it is simulated, were its axes others."""
    problem = point.problem
    length = float(problem.scene.length)
    for k, recording in enumerate(recordings):
        motion = recording_of(point.evaluation.motion, k)
        if not (recording.origin_known and np.all(recording.coordinates)) or motion.result != 0:
            continue
        used = np.all(np.asarray(problem.batch.used)[k, :, :3], axis=1)
        measured = np.asarray(problem.batch.tip)[k, used]
        simulated = np.asarray(
            tip_at(motion, problem.space.clocks[k].dt, problem.batch.times[k][used])
        )
        left = _rms(simulated - measured)
        if left < _FAR * length:
            continue
        where = recording.source or recording.name
        begins = np.median(measured[:5], axis=0)
        places = [straight_tip(problem.scene), simulated[0]]
        away = lambda tip, places=places: min(float(np.linalg.norm(tip - p)) for p in places)
        axes, least = _best_axes(simulated, measured, begins, away, length)
        if least < _CLEARLY * left:
            raise RecordingError(
                f"{where}: the tip is {left:.3g} m rms from where a rod of {length:g} m is, and "
                f"{least:.3g} m with the axes {axes}: are its coordinates swapped, or reversed? "
                f'Say which are which in a mapping (axes = "{axes}"), or turn the scene\'s clamp'
            )
        if away(begins) > _ELSEWHERE * length:
            said = beginning(recording, bool(problem.batch.hanging[k]))
            raise RecordingError(
                f"{where}: the tip begins {away(begins):.3g} m from where a rod of {length:g} m "
                f"would, {said}; no parameter mends that: check axes, unit and decimal sign of "
                "the tip, its origin, and the scene's clamp"
            )


def _best_axes(
    simulated: Float[np.ndarray, "samples 3"],
    measured: Float[np.ndarray, "samples 3"],
    begins: Float[np.ndarray, "3"],
    away: Callable,
    length: float,
) -> tuple[str, float]:
    """Which axes of the recording, with which signs, would leave least, and how much [m].

    A modulus that is far off may look like a rotation, too. So other axes must bring a tip that
    begins elsewhere, `away(begins)`, to where it should, or leave it where it is.
    """
    found = [(np.inf, 0, "")]
    lost = away(begins) > _FAR * length
    for order in itertools.permutations(range(3)):
        for signs in itertools.product((1, -1), repeat=3):
            name = ",".join(
                ("-" if s < 0 else "") + "xyz"[i] for i, s in zip(order, signs, strict=True)
            )
            along = lambda tip, order=order, signs=signs: tip[..., order] * np.array(signs)
            mended = (
                away(along(begins)) < _FAR * length
                if lost
                else (np.linalg.norm(along(begins) - begins) < _FAR * length)
            )
            if not mended:
                continue
            seen = along(measured)
            found.append((_rms(simulated - seen), sum(s < 0 for s in signs), name))
    left, _, name = min(found)
    return name, left


def _rms(distance: Float[np.ndarray, "samples 3"]) -> float:
    return float(np.sqrt(np.mean(np.sum(distance**2, axis=1))))
