"""How long the fit of modulus, damping and drag to one recording takes.

    python -m calibration.bench.fit_time

One release of a silicone beam, 0.9 s at 100 Hz with 0.3 mm noise, from starting values 30 to 70 %
off. First with nothing compiled, then three times more. Set JAX_COMPILATION_CACHE_DIR to an empty
directory for a first time that is one.
"""

import time

import jax
import jax.numpy as jnp
import numpy as np

import softrod_jax as sr
from calibration.data.recording import Recording
from calibration.fit import calibrate
from softrod_jax.scene.scene import as_arrays

_RATE, _REST, _SAMPLES, _NOISE = 100.0, 6, 90, 3e-4


def beam(young_modulus, bending_damping, drag_coefficient) -> sr.Scene:
    """A square silicone beam, clamped horizontally, in air or in something thicker."""
    return as_arrays(
        sr.Scene(
            length=0.1,
            section=sr.Rectangle(0.03, 0.03),
            young_modulus=young_modulus,
            poisson_ratio=0.49,
            density=1070.0,
            bending_damping=bending_damping,
            drag_coefficient=drag_coefficient,
            gravity=jnp.array([-9.81, 0.0, 0.0]),
        )
    )


def recording() -> Recording:
    """The release, held for the first samples."""
    motion = sr.simulate(beam(2.9e5, 6e-5, 10.0), 1 / _RATE, steps=_SAMPLES - _REST)
    tip = np.asarray(motion.tip_positions)
    tip = np.concatenate([np.repeat(tip[:1], _REST - 1, axis=0), tip])
    tip = tip + _NOISE * np.random.default_rng(0).normal(size=tip.shape)
    return Recording(np.arange(_SAMPLES) / _RATE, None, None, tip, name="release")


def main() -> None:
    jax.config.update("jax_enable_x64", True)
    data, start = recording(), beam(2e5, 1e-4, 3.0)
    fits = []
    for k in range(4):
        begun, used = time.perf_counter(), time.process_time()
        fits.append(calibrate(start, [data], checks=False, progress=False))
        seconds, used = time.perf_counter() - begun, time.process_time() - used
        stages = [h["stage"] for h in fits[-1].history]
        print(
            f"{'with' if k == 0 else 'without'} compiling: {seconds:.2f} s, {used:.2f} s of "
            f"processor time; {len(stages)} "
            f"evaluations, of which {stages.count('intervals')} for intervals"
        )
    for name, e in fits[-1].parameters.items():
        ends = " .. ".join("open" if end is None else f"{end:.4g}" for end in e.ci95)
        print(f"{name} {e.value:.4g} {e.unit} ({ends}), {e.verdict}")


if __name__ == "__main__":
    main()
