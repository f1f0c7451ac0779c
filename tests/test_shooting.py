"""Shooting against collocation, its own solvers against scipy, and where it has to give up."""

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import softrod_jax as sr
from softrod_jax.method import Defects
from softrod_jax.rod import make_rod
from softrod_jax.rod_ode import History, Layout, rod_ode
from softrod_jax.scene import as_arrays
from softrod_jax.shooting import Shooting


def robot(**changes):
    scene = sr.hybrid_robot(gravity=jnp.array([-9.81, 0.0, 0.0]))
    return as_arrays(sr.Scene(**{**vars(scene), **changes}))


FULL = robot(
    payload=sr.Payload(0.002),
    tip_load=sr.TipLoad(force=jnp.array([0.0, 0.003, 0.0])),
    shear_damping=1e-4,
)
TENSIONS, PRESSURES = jnp.array([0.1, 0.05, 0.0]), jnp.array([1e4])


# The integration along the rod


def smooth_history(s, c0=60.0):
    """A history as a bent, moving rod leaves it, given as functions of arc length (points,)."""
    phase = jnp.arange(6.0)
    wave = jnp.sin(jnp.asarray(s)[..., None] * 40.0 + phase)
    size = jnp.array([1e-3, 1e-3, 1e-3, 0.5, 0.5, 0.5])
    rest = jnp.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
    return History(jnp.array(c0), -c0 * (rest + size * wave), c0 * 0.01 * wave)


ROD, LAYOUT = make_rod(FULL, None, PRESSURES), Layout(attitude=True, dynamic=True)
START = jnp.array([1, 0, 0, 0] + [0.01] * 6 + [1e-3, 2e-3, 3e-3] + [1e-5, 2e-5, 3e-5], float)
STRAIGHT = jnp.array([0.0, 0, 1, 0, 0, 0])


@pytest.fixture(scope="module")
def integrated():
    """The state at the tip that follows from START at the base, by scipy to 1e-12."""
    ode = jax.jit(lambda s, y: rod_ode(s, y, ROD, LAYOUT, smooth_history(s), STRAIGHT).y_s)
    # In units of 1e-3 for the wrench, so that one tolerance fits all.
    units = np.r_[np.ones(10), np.full(3, 1e-3), np.full(3, 1e-5)]
    rates = lambda s, z: np.array(ode(s, z * units)) / units
    end = solve_ivp(rates, (0, float(ROD.L)), START / units, "DOP853", rtol=1e-12, atol=1e-12)
    return end.y[:, -1] * units, units


def propagated(method):
    points = method.points(ROD.L)
    guess = jnp.tile(STRAIGHT, (points.shape[0], 1))
    Y = jnp.zeros((method.intervals + 1, LAYOUT.size)).at[0].set(START)
    return method.defects(Y, ROD, LAYOUT, smooth_history(points), guess)


@pytest.mark.parametrize(
    "solver, order, steps",
    [
        (diffrax.Heun(), 2, 20),
        (diffrax.Bosh3(), 3, 20),
        (diffrax.Tsit5(), 5, 10),
        # The history is interpolated at order 6.
        (diffrax.Dopri8(), 6, 10),
        (diffrax.HalfSolver(diffrax.Euler()), 2, 40),
    ],
    ids=str,
)
def test_order_of_the_solver(integrated, solver, order, steps):
    tip, units = integrated
    errors, estimates = [], []
    for n in (steps, 2 * steps):
        found = propagated(Shooting(steps=n, solver=solver))
        errors.append(np.abs((-found.defect[0] - tip) / units).max())
        estimates.append(float(found.error))
    assert errors[0] < 0.1
    assert np.log2(errors[0] / errors[1]) > order - 0.5, errors
    assert np.isfinite(estimates).all() and estimates[1] < estimates[0] / 1.5
