"""Linear models against motions, equilibria and closed forms."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import softrod_jax as sr

METHOD = sr.Collocation(6)
L, R, E, RHO = 0.1, 0.005, 1e5, 1000.0
TENSION, PULL = 0.05, 4e-3


def robot(control="tension", **parts):
    """In a plane, with a tendon on one side and a chamber on the other."""
    own = dict(
        length=L, section=sr.Circle(R), young_modulus=E, poisson_ratio=0.45, density=RHO,
        damping_time=0.01, gravity=jnp.array([3.0, 0.0, 0.0]), plane="xz", inextensible=True,
        tendons=sr.Tendons(jnp.array([[3e-3, 0.0]]), control=control),
        chambers=sr.Chambers(jnp.array([4e-6]), jnp.array([[-2.5e-3, 0.0]])),
        markers=[sr.Marker("half", 0.5 * L, jnp.array([0.0, 0.0, 1e-3]))],
    )  # fmt: skip
    return sr.Scene(**{**own, **parts})


OUTPUTS = ("tip", "half", "strains", "base_wrench", "tensions")


@pytest.fixture(scope="module")
def model():
    inputs = ("pressures", "tensions", "tip_force", "tip_moment")
    return sr.linearise(robot(), (TENSION,), inputs=inputs, outputs=OUTPUTS, method=METHOD)


def test_names(model):
    assert model.inputs[:3] == ("p1_Pa", "tau1_N", "tip_Fx_N") and len(model.inputs) == 8
    nodes = model.equilibrium.arc_lengths.shape[0]
    assert model.outputs[:4] == ("tip_x_m", "tip_y_m", "tip_z_m", "tip_rx_rad")
    assert len(model.outputs) == 6 + 6 + 6 * nodes + 6 + 1 == model.C.shape[0]
    assert model.outputs[-2:] == ("base_Mz_Nm", "tau1_N")


def perturbed(name, step):
    """The equilibrium after a step of one input, as outputs see it, but for rotations."""
    force = jnp.array([step if name == "tip_Fx_N" else 0.0, 0.0, 0.0])
    tension = TENSION + (step if name == "tau1_N" else 0.0)
    pressure = step if name == "p1_Pa" else 0.0
    scene = robot(tip_load=sr.TipLoad(force, jnp.zeros(3)))
    found = sr.solve_static(scene, (tension,), (pressure,), method=METHOD)
    wrench = found.wrenches[0]  # the clamp is not turned
    positions = found.tip_position, found.markers["half"].position
    return np.concatenate([*positions, found.strains.ravel(), wrench, found.tensions])


@pytest.mark.parametrize("name, step", [("tau1_N", 1e-3), ("p1_Pa", 20.0), ("tip_Fx_N", 1e-4)])
def test_static_gain_is_the_slope_of_equilibria(model, name, step):
    gain = model.static_gain[:, model.inputs.index(name)]
    turned = [i for i, x in enumerate(model.outputs) if x.endswith("_rad")]
    shown = np.delete(np.asarray(gain), turned)
    slope = (perturbed(name, step) - perturbed(name, -step)) / (2 * step)
    np.testing.assert_allclose(shown, slope, rtol=1e-4, atol=1e-4 * np.abs(shown[:6]).max())


def test_a_small_step_is_a_motion(model):
    """To 1e-4 of its size, from the first sample on."""
    dt, steps, size = 2e-3, 150, 1e-4
    u = np.zeros((steps, len(model.inputs)))
    u[:, model.inputs.index("tau1_N")] = size
    found = model.reduced(24).response(dt, u)[:, :3]
    scene = robot()
    options = dict(method=METHOD, newton=sr.NewtonOptions(tolerance=1e-12), max_time_error=1.0)

    def moved(change):
        tensions = np.full((steps, 1), TENSION + change)
        begin = sr.solve_static(scene, (TENSION,), (0.0,), method=METHOD)
        pressures = np.zeros((steps, 1))
        motion = sr.simulate(scene, dt, tensions, pressures, initial=begin, substeps=2, **options)
        return np.asarray(motion.tip_positions)

    expected = (moved(size) - moved(-size)) / 2
    assert np.abs(found - expected).max() < 1e-4 * np.abs(expected).max()


def test_reductions(model):
    omega = np.array([1.0, 20.0])
    # Of x of the tip, which every input but those off the plane moves.
    moves = np.asarray(model.static_gain[0]) != 0
    response = lambda model: np.asarray(model.frequency_response(omega)[:, 0, moves])
    whole = response(model)
    for by, states, close in (("balance", 24, 1e-5), ("speed", 40, 2e-2)):
        small = model.reduced(states, by)
        assert states - 1 <= small.A.shape[0] <= states
        np.testing.assert_allclose(small.static_gain, model.static_gain, rtol=1e-6, atol=1e-9)
        np.testing.assert_allclose(response(small), whole, rtol=close)
        assert np.linalg.eigvals(small.A).real.max() < 0


def test_a_swing_against_its_closed_form():
    """A cantilever under a force at the tip that swings, without damping: Euler and Bernoulli."""
    r = 2e-4 * L
    slender = sr.Scene(
        length=L, section=sr.Circle(r), young_modulus=E, poisson_ratio=0.45, density=RHO,
        inextensible=True, plane="xz",
    )  # fmt: skip
    model = sr.linearise(slender, inputs="tip_force", method=sr.Collocation(10))
    EI, rho_A = E * np.pi * r**4 / 4, RHO * np.pi * r**2
    omega = np.array([0.5, 2.0, 3.0]) * np.sqrt(EI / rho_A) / L**2 * 3.0
    x = np.sqrt(omega * np.sqrt(rho_A / EI)) * L
    expected = np.cosh(x) * np.sin(x) - np.sinh(x) * np.cos(x)
    expected = expected * L**3 / (EI * x**3 * (1 + np.cosh(x) * np.cos(x)))
    found = model.frequency_response(omega)[:, 0, 0]
    np.testing.assert_allclose(found, expected, rtol=1e-5)
    for by in ("balance", "speed"):
        small = model.reduced(8, by).frequency_response(omega[:2])[:, 0, 0]
        np.testing.assert_allclose(small, expected[:2], rtol=1e-3)


def test_tendons_of_given_length():
    """The tip and the tensions follow pulls."""
    scene = robot("length")
    model = sr.linearise(scene, pulls=(PULL,), outputs=("tip", "tensions"), method=METHOD)
    assert model.inputs == ("p1_Pa", "pull1_m")
    solve = lambda d: sr.solve_static(scene, None, (0.0,), (PULL + d,), method=METHOD)
    more, less, d = solve(1e-5), solve(-1e-5), 1e-5
    assert less.tensions[0] > 0
    gain = model.static_gain[:, 1]
    slope = (more.tip_position - less.tip_position) / (2 * d)
    np.testing.assert_allclose(gain[:3], slope, rtol=1e-4, atol=1e-5)
    np.testing.assert_allclose(gain[6], (more.tensions - less.tensions)[0] / (2 * d), rtol=1e-4)


def test_compliance_of_a_cantilever():
    """Timoshenko, in space: bending, shear, stretch and twist."""
    rod = sr.Scene(length=L, section=sr.Circle(R), young_modulus=E, poisson_ratio=0.25, density=RHO)
    found = np.asarray(sr.compliance(rod, method=METHOD))
    A, I, G = np.pi * R**2, np.pi * R**4 / 4, E / 2.5
    bend, turn = L**3 / (3 * E * I) + L / (G * A), L**2 / (2 * E * I)
    expected = np.diag([bend, bend, L / (E * A), L / (E * I), L / (E * I), L / (2 * G * I)])
    expected[0, 4] = expected[4, 0] = turn
    expected[1, 3] = expected[3, 1] = -turn
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-9 * bend)


def test_actuation_jacobian(model):
    found = sr.actuation_jacobian(robot(), (TENSION,), of="half", method=METHOD)
    rows = [i for i, x in enumerate(model.outputs) if x.startswith("half")]
    columns = [model.inputs.index(x) for x in ("tau1_N", "p1_Pa")]
    expected = model.static_gain[np.ix_(rows, columns)]
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-12)


def test_refusals(model):
    with pytest.raises(ValueError, match='output \'hand\' is not offered; use "tip", "half"'):
        sr.linearise(robot(), outputs="hand", method=METHOD)
    with pytest.raises(ValueError, match="input 'pulls' is not one of this scene"):
        sr.linearise(robot(), inputs=("pulls",), method=METHOD)
    with pytest.raises(ValueError, match="E is singular; take model.reduced"):
        model.response(0.01, np.zeros((3, 8)))
    with pytest.raises(ValueError, match='by=\'size\'; use "balance" or "speed"'):
        model.reduced(4, by="size")
    with pytest.raises(ValueError, match="no actuators"):
        sr.actuation_jacobian(robot(tendons=None, chambers=None), method=METHOD)
    assert jax.tree.leaves(model)
