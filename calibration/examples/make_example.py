"""Make the bundled recording: the robot of robot.toml, with another material, swung by tendons.

    python -m calibration.examples.make_example

The truth differs from the scene file, and the simulation here is finer in time and along the rod
than the fit's: a fit that finds the truth does not do so by repeating its own errors.
"""

import jax
import jax.numpy as jnp
import numpy as np

import softrod_jax as sr
from calibration.examples import example_paths
from calibration.experiment.setup import Setup
from calibration.parameters.catalogue import with_values
from calibration.problem.motion import Motion, tip_at
from softrod_jax.scene.logs import write_log

# The truth, as factors of the values in robot.toml.
TRUTH = {"young_modulus": 1.4, "bending_damping": 2.0, "drag_coefficient": 2.0}
# The tip's clock is late by this much.
TIME_OFFSET = 0.05  # s
NOISE = 3e-4  # m, standard deviation of each coordinate
MISSING = 0.02  # part of the samples in which the camera lost the marker

_DURATION, _INTERVAL, _DT = 2.0, 0.01, 0.0025  # s
_RISE = 0.12  # s


def inputs(t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Tensions [N], (T, 3), and pressures [Pa], (T, 1), at the times `t` [s].

    Each tendon is pulled and let go in turn, the rod being left to swing in between.
    """
    pulses = [(0.15, 0.45, 0.8), (0.75, 1.0, 0.6), (1.3, 1.55, 0.7)]  # from [s], to [s], N
    rise = lambda x: 0.5 - 0.5 * np.cos(np.pi * np.clip(x / _RISE, 0, 1))
    tensions = [peak * (rise(t - a) - rise(t - b)) for a, b, peak in pulses]
    pressures = 1e4 * rise((t - 0.5) / 4)
    return np.stack(tensions, axis=1), pressures[:, None]


def main() -> None:
    jax.config.update("jax_enable_x64", True)
    scene_path, (log_path,) = example_paths()
    scene = sr.load_scene(scene_path)
    factors = jnp.log(jnp.array(list(TRUTH.values())))
    truth = with_values(Setup(scene), tuple(TRUTH), factors).scene
    # Logged values are rounded, and are what acts.
    times = np.arange(0, _DURATION + _INTERVAL / 2, _INTERVAL).round(6)
    tensions, pressures = (x.round(6) for x in inputs(times))
    # An input that varies is given at the end of each step.
    ends = _DT * np.arange(1, round(_DURATION / _DT) + 1)
    resample = lambda x: np.stack([np.interp(ends, times, c) for c in x.T], axis=1)
    motion = sr.simulate(
        truth,
        _DT,
        resample(tensions),
        resample(pressures),
        scheme=sr.SDIRK(order=4),
        method=sr.Collocation(intervals=16, order=6),
    )
    seen = Motion(
        motion.tip_positions,
        motion.tip_velocities,
        motion.positions,
        motion.result,
        jnp.max(motion.stats["error"]),
    )
    tip = np.asarray(tip_at(seen, _DT, jnp.asarray(times - TIME_OFFSET)))
    random = np.random.default_rng(20240108)
    tip = tip + NOISE * random.standard_normal(tip.shape)
    tip[random.random(len(tip)) < MISSING] = np.nan
    write_log(log_path, times, tensions, pressures, tip.round(6))
    print(f"written to {log_path}")


if __name__ == "__main__":
    main()
