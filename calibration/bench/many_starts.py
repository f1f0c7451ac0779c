"""From how many of twenty starting points, drawn from two decades, the truth is found.

    python -m calibration.bench.many_starts

The bundled example: modulus, damping and drag from 2 s of a tendon-driven log with 0.3 mm noise.
"""

import time

import jax
import jax.numpy as jnp

import softrod_jax as sr
from calibration.data.loading import load_recording
from calibration.examples import example_paths
from calibration.examples.make_example import TRUTH
from calibration.experiment.setup import Setup
from calibration.fit import calibrate
from calibration.parameters.catalogue import with_values


def main() -> None:
    jax.config.update("jax_enable_x64", True)
    scene_path, (log,) = example_paths()
    scene = sr.load_scene(scene_path)
    factors = jnp.log(jnp.array(list(TRUTH.values())))
    truth = with_values(Setup(scene), tuple(TRUTH), factors).scene
    begun = time.perf_counter()
    fit = calibrate(
        truth, [load_recording(log, scene)], starts=21, checks=False, progress=False, seed=1
    )
    # The first start is the truth itself.
    others = [s for s in fit.starts if any(s.initial[n] != getattr(truth, n) for n in TRUTH)]
    found = 0
    for s in others:
        inside = all(e.ci95[0] <= s.values[name] <= e.ci95[1] for name, e in fit.parameters.items())
        found += inside
        ratios = ", ".join(
            f"{n} {s.initial[n] / float(getattr(truth, n)):.2f} -> "
            f"{s.values[n] / float(getattr(truth, n)):.3f}"
            for n in TRUTH
        )
        print(f"{'found' if inside else 'LOST '}  {1e3 * s.rms:.4f} mm  {ratios}")
    print(f"{found} of {len(others)} in {time.perf_counter() - begun:.0f} s with compiling")


if __name__ == "__main__":
    main()
