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
    ],
    ids=["Heun", "Bosh3", "Tsit5", "Dopri8"],
)
def test_order_of_the_solver(integrated, solver, order, steps):
    tip, units = integrated
    errors, estimates = [], []
    for n in (steps, 2 * steps):
        found = propagated(Shooting(steps=n, solver=solver))
        errors.append(np.abs((found.defect[0] + tip) / units).max())
        estimates.append(float(found.error))
    assert np.log2(errors[0] / errors[1]) > order - 0.5, errors
    assert 0 < estimates[1] < 0.6 * estimates[0]


def test_adaptive_steps_meet_their_tolerance(integrated):
    tip, units = integrated
    errors = []
    for tolerance in (1e-4, 1e-6):
        controller = diffrax.PIDController(rtol=tolerance, atol=tolerance)
        found = propagated(
            Shooting(steps=20, solver=diffrax.Bosh3(), stepsize_controller=controller)
        )
        assert np.isnan(found.error)
        errors.append(np.abs((found.defect[0] + tip) / units).max())
    assert errors[1] < 0.05 * errors[0], errors
    hurried = Shooting(stepsize_controller=controller, solver=diffrax.Bosh3(), max_substeps=1)
    assert np.all(np.isnan(propagated(hurried).defect))


@pytest.mark.parametrize(
    "method",
    [
        Shooting(segments=2, steps=4),
        Shooting(2, 4, stepsize_controller=diffrax.PIDController(rtol=1e-9, atol=1e-9)),
    ],
    ids=["constant", "adaptive"],
)
def test_derivatives_of_the_defects(method):
    rod, points = make_rod(FULL, TENSIONS, PRESSURES), method.points(ROD.L)
    guess = jnp.tile(STRAIGHT, (points.shape[0], 1))
    Y = jnp.tile(START, (3, 1)).at[2, 4].add(0.01)

    @jax.jit
    def f(z, Y):
        scaled = eqx.tree_at(lambda r: (r.L, r.tau), rod, (z[0] * rod.L, z[1] * rod.tau))
        history = smooth_history(points)
        history = history._replace(strain=z[2] * history.strain)
        return method.defects(Y, scaled, LAYOUT, history, guess).defect

    one, tolerance = jnp.ones(3), 1e-6
    forward = jax.jit(jax.jacfwd(f))(one, Y)
    weights = jnp.cos(jnp.arange(forward[..., 0].size, dtype=float)).reshape(Y[1:].shape)
    reverse = jax.jit(jax.grad(lambda z: jnp.sum(weights * f(z, Y))))(one)
    np.testing.assert_allclose(jnp.tensordot(weights, forward, 2), reverse, rtol=1e-9)
    slope = lambda f, e: (8 * (f(e) - f(-e)) - (f(2 * e) - f(-2 * e))) / 12
    for i, e in enumerate(1e-3 * np.eye(3)):
        difference = slope(lambda e: f(one + e, Y), e) / 1e-3
        size = np.abs(difference).max(0)
        np.testing.assert_allclose(forward[..., i] / size, difference / size, atol=tolerance)

    at = Defects(None, jnp.repeat(Y, 4, axis=0)[: points.shape[0]], guess, None)
    left, right = method.blocks(at, rod, LAYOUT, smooth_history(points))
    np.testing.assert_array_equal(right, np.tile(np.eye(16), (2, 1, 1)))
    for i in range(16):
        e = jnp.zeros(16).at[i].set(1e-4 * max(1e-3, float(jnp.abs(START[i]))))
        difference = slope(lambda e: f(one, Y.at[:-1].add(e)), e) / e[i]
        size = 1e-12 + np.abs(difference).max()
        np.testing.assert_allclose(left[..., i] / size, difference / size, atol=tolerance)


# Statics and dynamics


def test_single_shooting_finds_a_known_equilibrium():
    # shared/reference/static.json, g_tau0.3: solved apart from this project, to 1e-15.
    rod = sr.solve_static(robot(), [0.3, 0.0, 0.0], [0.0], method=Shooting())
    tip = [-0.05950139883669897, 0.0, 0.07027684856429334]
    np.testing.assert_allclose(rod.tip_position, tip, atol=1e-6)
    np.testing.assert_allclose(rod.wrenches[0, 4], -0.004080425122861935, atol=1e-8)
    assert 1e-7 < float(rod.stats["error"]) < 1e-4
    assert rod.arc_lengths.shape == (21,) and rod.positions.shape == (21, 3)
    np.testing.assert_array_equal(rod.positions[-1], rod.tip_position)


@pytest.fixture(scope="module")
def motions():
    """A robot with everything, moved by collocation and by multiple shooting."""
    tensions, pressures = jnp.tile(TENSIONS, (15, 1)), jnp.tile(PRESSURES, (15, 1))
    return [
        sr.simulate(FULL, 0.01, tensions, pressures, method=method)
        for method in (sr.Collocation(20, 6), Shooting(5, 4))
    ]


def test_agrees_with_collocation(motions):
    expected, motion = motions
    size = lambda x: np.abs(x).max((0, 1))
    for name in ("positions", "quaternions", "strains", "velocities"):
        a, b = getattr(expected, name), getattr(motion, name)
        np.testing.assert_allclose(a / size(a), b / size(a), atol=1e-4, err_msg=name)
    np.testing.assert_allclose(motion.tip_positions, expected.tip_positions, atol=1e-5)
    # The estimate is of the size of the difference.
    error = np.abs(motion.tip_positions - expected.tip_positions).max() / 0.1
    assert 0.1 * error < motion.stats["error"].max() < 100 * error
    assert np.all(np.isnan(expected.stats["error"]))


STEPS = 6
MULTIPLE, SINGLE = Shooting(20, 1), Shooting()


def gravity_step(young_modulus, dt, method):
    scene = robot(young_modulus=young_modulus)
    return sr.simulate(scene, dt, steps=STEPS, method=method, throw=False)


def test_gradients():
    tip = lambda E: gravity_step(E, 0.01, MULTIPLE).tip_positions[-1]
    forward, reverse = jax.jacfwd(tip)(5e4), jax.jacrev(tip)(5e4)
    np.testing.assert_allclose(forward, reverse, atol=1e-9 * np.abs(forward).max())
    d = 50.0
    slope = (8 * (tip(5e4 + d) - tip(5e4 - d)) - (tip(5e4 + 2 * d) - tip(5e4 - 2 * d))) / 12 / d
    np.testing.assert_allclose(forward, slope, atol=1e-6 * np.abs(slope).max())


def test_what_shooting_cannot_do_is_reported():
    # Both are at home in long steps.
    slow = gravity_step(5e4, 0.015, SINGLE)
    assert slow.result == 0
    np.testing.assert_allclose(
        slow.tip_positions, gravity_step(5e4, 0.015, MULTIPLE).tip_positions, atol=1e-8
    )
    # exp(c0 L / c) is too much for single shooting, here 1e17; multiple shooting goes on, ...
    fast = gravity_step(5e4, 1e-3, SINGLE)
    assert fast.result == sr.RESULTS.diverged and fast.failed_step == 0
    assert np.all(np.isfinite(fast.tip_positions))
    assert gravity_step(5e4, 1e-3, MULTIPLE).result == 0
    # ... until its steps are longer than a wave travels.
    faster = gravity_step(5e4, 0.7e-3, MULTIPLE)
    assert faster.result == sr.RESULTS.inaccurate
    assert faster.stats["error"].max() > MULTIPLE.max_error


def test_a_failure_leaves_gradients_finite():
    tips = jax.vmap(lambda E, dt: gravity_step(E, dt, SINGLE).tip_positions[-1], (None, 0))
    loss = lambda E: jnp.sum(tips(E, jnp.array([0.015, 1e-3])) ** 2)
    alone = lambda E: jnp.sum(gravity_step(E, 0.015, SINGLE).tip_positions[-1] ** 2)
    np.testing.assert_allclose(jax.grad(loss)(5e4), jax.grad(alone)(5e4), rtol=1e-8)


@pytest.mark.parametrize(
    "arguments, words",
    [
        (dict(segments=0), "segments=0"),
        (dict(steps=0), "steps=0"),
        (dict(max_substeps=0), "max_substeps=0"),
        (dict(solver="Tsit5"), "diffrax.AbstractSolver"),
    ],
)
def test_bad_arguments(arguments, words):
    with pytest.raises(ValueError, match=words):
        Shooting(**arguments)
