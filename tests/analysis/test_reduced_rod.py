"""The model of few coordinates against closed forms, the whole rod, and laws that it must keep."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.linalg

import softrod_jax as sr
from softrod_jax.analysis.strain_coordinates import Motion, imbalances, laws, strain_basis
from softrod_jax.learning import Action
from softrod_jax.rod.reduction import make_rod

METHOD = sr.Collocation(4, order=4)
ROBOT = sr.hybrid_robot(gravity=jnp.array([0.0, 0.0, 9.81]))
LIMITS = {"tensions": (0.0, 0.2)}
SMALL = dict(samples=12, modes=4)


@pytest.fixture(scope="module")
def reduced():
    return sr.reduce_nonlinear(ROBOT, LIMITS, 6, following=4, **SMALL)


def circle(steps, dt=0.02, period=2.0, largest=0.2):
    """Three tendons in turn, after a ramp of half a second."""
    t = dt * np.arange(1, steps + 1)[:, None]
    phase = 2 * np.pi * (t / period - np.arange(3) / 3)
    return np.minimum(t / 0.5, 1.0) * 0.5 * largest * (1 + np.cos(phase))


def test_frequencies_of_a_cantilever():
    """Euler and Bernoulli's first three, each of them twice: those of its equations at rest."""
    L, r, E, rho = 0.3, 0.3e-3, 1e6, 1000.0
    rod = sr.Scene(L, sr.Circle(r), E, 0.4, rho, inextensible=True)
    model = sr.reduce_nonlinear(rod, None, 6, following=0, modes=8, method=sr.Collocation(16))
    grid = model.method.grid(rod)
    law = laws(strain_basis(model.shapes, grid), make_rod(rod, dynamic=False, grid=grid), None)
    basis, still = strain_basis(model.shapes, grid), jnp.zeros(6)
    K, M = jax.jit(
        jax.jacfwd(lambda q, a: imbalances(basis, law, Motion(q, 0 * q, a)), argnums=(0, 1))
    )(still, still)
    squares = scipy.linalg.eigh((K + K.T) / 2, (M + M.T) / 2, eigvals_only=True)
    roots = np.repeat([1.8751040687119611, 4.694091132974175, 7.854757438237613], 2)
    right = (roots / L) ** 2 * np.sqrt(E * r**2 / 4 / rho)
    np.testing.assert_allclose(np.sqrt(squares), right, rtol=1e-4)


def test_the_tip_follows_that_of_the_whole_rod(reduced):
    steps, dt = 75, 0.02
    tensions, none = circle(steps, dt), np.zeros((steps, 1))
    begun = sr.solve_static(ROBOT, np.zeros(3), np.zeros(1), method=METHOD)
    whole = sr.simulate(ROBOT, dt, tensions, none, initial=begun, method=METHOD, throw=False)
    few = reduced.simulate(
        dt, tensions, none, initial=reduced.equilibrium(np.zeros(3), np.zeros(1))
    )
    off = np.linalg.norm(np.asarray(few.tip_positions - whole.tip_positions), axis=1) / 0.1
    assert off.max() < 0.01
    assert np.ptp(np.asarray(whole.tip_positions)[:, 0]) > 0.02
    np.testing.assert_allclose(few.markers["tip"].position, few.tip_positions)


def test_equilibria_converge_with_the_number_of_coordinates():
    inputs = np.array([0.15, 0.05, 0.0]), np.array([5e3])
    whole = sr.solve_static(ROBOT, *inputs, method=METHOD).tip_position
    errors = []
    for following in (0, 6, 12):
        limits = {**LIMITS, "pressures": (0.0, 10e3)}
        model = sr.reduce_nonlinear(ROBOT, limits, 4, following=following, samples=24, modes=4)
        tip = model.poses(model.equilibrium(*inputs))["tip"].position
        errors.append(np.linalg.norm(tip - whole) / 0.1)
    assert errors[0] < 0.05 and errors[1] < 5e-3 and errors[2] < 5e-4, errors
    assert errors[2] < 0.2 * errors[0]


def test_energy_is_kept_and_damping_takes_it():
    """A rod in free swing, bent far: what it has is what gravity has given."""
    free = sr.Scene(
        0.3, sr.Circle(4e-3), 1e6, 0.4, 1000.0, inextensible=True, payload=sr.Payload(0.005),
        tip_load=sr.TipLoad(force=jnp.array([0.0, 0.0, 0.0])),
    )  # fmt: skip
    model = sr.reduce_nonlinear(free, None, 4, following=0, method=sr.Collocation(12))
    model = dataclasses.replace(model, scheme=sr.SDIRK(4), tolerance=jnp.array(1e-11))
    loaded = eqx.tree_at(lambda m: m.scene.tip_load.force, model, jnp.array([0.3, 0.1, 0.0]))
    damped = dataclasses.replace(model, scene=dataclasses.replace(free, damping_time=0.02))
    begun = loaded.equilibrium()
    bend = loaded.poses(begun)["tip"].position
    assert np.linalg.norm(bend[:2]) > 0.1
    first, lost = sum(model.energies(begun)), {}
    for name, one in (("free", model), ("damped", damped)):
        state = begun
        step = jax.jit(lambda s, one=one: one.step(s, 2e-3, begun.inputs))
        for _ in range(100):
            state = step(state)
        lost[name] = float((first - sum(one.energies(state))) / first)
    assert abs(lost["free"]) < 2e-5, lost
    assert 0.04 < lost["damped"] < 1.0


def test_derivatives_agree(reduced):
    """By the modulus and the tensions: forward, reverse, differences.

    The shapes stay as they are, so differences are those of the same model.
    """
    steps = 6

    def tip(z):
        scene = eqx.tree_at(lambda s: s.young_modulus, reduced.scene, 5e4 * z[0])
        model = dataclasses.replace(reduced, scene=scene, tolerance=jnp.array(1e-13))
        tensions = circle(steps) * z[1]
        return model.simulate(0.02, tensions, np.zeros((steps, 1)), throw=False).tip_positions[-1]

    tip, one = jax.jit(tip), jnp.ones(2)
    forward, reverse = jax.jacfwd(tip)(one), jax.jacrev(tip)(one)
    np.testing.assert_allclose(forward, reverse, atol=1e-9 * np.abs(forward).max())
    for i in range(2):
        h = 1e-4 * np.eye(2)[i]
        central = (tip(one + h) - tip(one - h)) / 2e-4
        np.testing.assert_allclose(forward[:, i], central, atol=1e-5 * np.abs(forward[:, i]).max())


def test_steps_are_those_of_a_motion(reduced):
    steps, dt = 5, 0.02
    tensions = circle(steps)
    begun = reduced.equilibrium(np.zeros(3), np.zeros(1))
    motion = reduced.simulate(dt, tensions, np.zeros((steps, 1)), initial=begun)
    # The first row of a motion jumps where it is not zero, and nothing is known before it.
    state = eqx.tree_at(lambda s: s.inputs.tensions, begun, jnp.asarray(tensions[0]))
    for row in tensions:
        state = reduced.step(state, dt, Action(row, np.zeros(1)))
    np.testing.assert_allclose(state.coordinates, motion.coordinates[-1], atol=1e-5)
    nearest = reduced.nearest(
        sr.solve_static(ROBOT, np.zeros(3), np.zeros(1), method=METHOD).point_strains
    )
    np.testing.assert_allclose(nearest, begun.coordinates, atol=3e-3)


def test_what_cannot_be_is_refused_and_reported(reduced):
    with pytest.raises(ValueError, match="at most in all"):
        sr.reduce_nonlinear(ROBOT, LIMITS, 200, samples=2, modes=1)
    with pytest.raises(ValueError, match="limits"):
        sr.reduce_nonlinear(ROBOT, {"pulls": (0.0, 1e-3)})
    by_length = sr.Tendons(jnp.array([[4e-3, 0.0]]), control="length")
    with pytest.raises(ValueError, match="stiffness"):
        sr.reduce_nonlinear(dataclasses.replace(ROBOT, tendons=by_length))
    bad = np.full((3, 3), np.nan)
    found = jax.jit(lambda x: reduced.simulate(0.02, x, np.zeros((3, 1)), throw=False))(bad)
    assert int(found.result) == sr.RESULTS.bad_input
    assert np.all(np.isfinite(found.tip_positions))
