"""What is computed in one process and in several, to be compared."""

import jax.numpy as jnp
import numpy as np

import softrod_jax as sr
from calibration import Recording, calibrate

PULLS = np.linspace(0.0, 0.3, 5)
_ROBOT = sr.hybrid_robot()
SCENE = sr.Scene(
    **{
        name: getattr(_ROBOT, name)
        for name in ("length", "section", "young_modulus", "poisson_ratio", "density", "tendons")
    }
)
METHOD = sr.Collocation(3)


def bend(pull):
    """Tip, stretch at the base and code of an equilibrium; without one from 2 N on."""
    tensions = pull * jnp.array([1.0, 0.5, 0.0])
    solution = sr.solve_static(SCENE, tensions, method=METHOD, throw=False)
    return {"tip": solution.tip_position, "at": (solution.strains[0, 2], solution.result)}


def wave(x):
    """Something cheap."""
    return jnp.sin(x) * jnp.sum(x**2), jnp.sum(x)


def ringing(duration, frequency):
    """A recording of the tip of a beam that was let go: its first mode [Hz], by Euler."""
    t, omega = np.arange(0.0, duration, 0.02), 2 * np.pi * frequency
    sag = 3.516**2 / 8 * 9.81 / omega**2
    x = -sag * (1 - np.cos(omega * t))
    tip = np.stack([x, 0 * t, 0.1 - 0.6 * x**2 / 0.1], axis=1)
    return Recording(t, None, None, tip, name=f"{frequency}")


def fit():
    """Of three recordings, which neither two nor four devices share evenly."""
    beam = sr.Scene(
        length=0.1,
        section=sr.Rectangle(0.03, 0.03),
        young_modulus=1.5e5,
        poisson_ratio=0.49,
        density=1070.0,
        bending_damping=2e-5,
        gravity=jnp.array([-9.81, 0.0, 0.0]),
    )
    found = calibrate(
        beam,
        [ringing(0.3, 5.9), ringing(0.26, 6.0), ringing(0.2, 6.1)],
        fit=("young_modulus",),
        time_offset=False,
        checks=False,
        progress=False,
        max_iterations=5,
        dt=0.02,
        scheme=sr.BDFAlpha(),
        method=METHOD,
    )
    return {
        "history": np.array([[h["rms_m"], h["young_modulus"]] for h in found.history]),
        "ci95": np.array(found.parameters["young_modulus"].ci95),
        "residuals": np.concatenate([r.simulated - r.measured for r in found.recordings]),
    }
