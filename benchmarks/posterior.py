"""Intervals of a fit that is not Gaussian: the fit's own, a profile, Laplace, NUTS and quadrature.

    python benchmarks/posterior.py [--draws 1200]

A soft rod that sags by its own weight and under one tendon, three equilibria, the tip seen with an
error of 4 mm, as large as what the tendon does; and again of 0.1 mm. Young's modulus is fitted, and
0.5 +- 0.4 MPa is known of it beforehand. Quadrature and profile use residuals at 221 places, and
nothing of what the others are made of.
"""

import argparse

import jax

jax.config.update("jax_enable_x64", True)

import numpy as np
from report import machine

import softrod_jax as sr
from calibration.postures.data import Postures
from calibration.postures.fitting import calibrate_postures, prepared_model
from softrod_jax.scene.inputs import Inputs
from softrod_jax.scene.scene import as_arrays

E, PRIOR, GRID = 4e5, (5e5, 4e5), sr.Collocation(intervals=2)
TENSIONS = np.array([[0.0], [0.02], [0.04]])


def robot() -> sr.Scene:
    """A rod of silicone, clamped horizontally, with a tendon."""
    return as_arrays(
        sr.Scene(
            length=0.1,
            section=sr.Circle(6e-3),
            young_modulus=E,
            poisson_ratio=0.45,
            density=1070.0,
            gravity=[-9.81, 0.0, 0.0],
            tendons=sr.Tendons(np.array([[5e-3, 0.0]])),
        )
    )


def measured(noise: float) -> Postures:
    """The three equilibria, seen with that error [m]."""
    solve = lambda row: sr.solve_static(robot(), tensions=row, method=GRID).tip_position
    tips = np.array([solve(row) for row in TENSIONS])
    tips = tips + noise * np.random.default_rng(4).normal(size=tips.shape)
    return Postures(Inputs(tensions=TENSIONS), {"tip": tips})


def by_quadrature(postures: Postures, centre: float, reach: float):
    """The ends of the interval of the posterior, and of the profile likelihood with the prior."""
    model = prepared_model(robot(), postures, "young_modulus", GRID)
    theta = centre + np.linspace(-reach, reach, 221)
    squares = np.array([np.sum(model.evaluate(np.array([t])).residuals ** 2) for t in theta])
    known = ((E * np.exp(theta) - PRIOR[0]) / PRIOR[1]) ** 2
    numbers = 3 * len(TENSIONS)
    log = -0.5 * (numbers * np.log(squares) + known)
    density = np.exp(log - log.max())
    parts = np.concatenate([[0.0], (density[1:] + density[:-1]) / 2])
    ends = np.interp([0.025, 0.975], np.cumsum(parts) / parts.sum(), theta)
    # By the t distribution of 8 degrees of freedom, as noise is estimated too.
    least = np.argmax(log)
    scale = squares[least] / (numbers - 1)
    excess = (squares - squares[least]) / scale + known - known[least]
    inside = theta[excess < 2.306**2]
    return E * np.exp(ends), E * np.exp(inside[[0, -1]])


def told(noise: float, draws: int) -> None:
    """All intervals of one case."""
    postures = measured(noise)
    fits = {
        method: calibrate_postures(
            robot(), postures, fit="young_modulus", priors={"young_modulus": PRIOR}, method=GRID,
            posterior=method, draws=draws if method == "nuts" else 20000,
        )
        for method in ("laplace", "nuts")
    }  # fmt: skip
    own = fits["laplace"].parameters["young_modulus"]
    centre, error = np.log(own.value / E), own.standard_error
    exact, profile = by_quadrature(postures, centre, min(8 * error, 4.0))
    name = "young_modulus"
    print(f"noise {1e3 * noise:g} mm: best {1e-3 * own.value:.1f} kPa")
    rows = {"the fit's own": own.ci95, "profile": profile}
    rows |= {method: fit.posterior.ci95[name] for method, fit in fits.items()}
    for what, (low, high) in {**rows, "quadrature": exact}.items():
        print(f"  {what}: {1e-3 * low:.1f} to {1e-3 * high:.1f} kPa")
    nuts = fits["nuts"].posterior
    print(
        f"  NUTS: {len(nuts.theta)} draws worth {nuts.effective:.0f}, Gelman and Rubin "
        f"{nuts.mixed:.3f}, {nuts.divergent} divergent, {fits['nuts'].seconds:.0f} s; Laplace "
        f"{fits['laplace'].seconds:.0f} s",
        flush=True,
    )


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("--draws", type=int, default=1200)
    draws = parser.parse_args().draws
    print(machine())
    for noise in (4e-3, 1e-4):
        told(noise, draws)
