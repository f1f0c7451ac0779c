"""Where solvers are tempted to return a number that is none: large loads, short steps, jumps."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from problems import beam
from scipy.integrate import solve_ivp
from scipy.special import ellipe, ellipk

import softrod_jax as sr
from softrod_jax.scene.scene import as_arrays

ROBOT = sr.hybrid_robot()
EA, EI = 5e4 * np.pi * 6e-3**2, 5e4 * np.pi * 6e-3**4 / 4


def with_(scene, **changes):
    return as_arrays(sr.Scene(**{**vars(scene), **changes}))


@pytest.mark.parametrize("direction", [(-1.0, 0.0, 0.0), (-0.6, 0.5, -0.6245)], ids=str)
def test_a_very_heavy_rod(direction):
    """rho A g L^3 / EI = 50, across and partly upward: within 1e-5 lengths on the default grid."""
    weight = 50 * EI / 0.1**3 / (1070 * np.pi * 6e-3**2)
    scene = sr.hybrid_robot(gravity=weight * jnp.array(direction))
    coarse, fine = (sr.solve_static(scene, method=sr.Collocation(n)) for n in (12, 36))
    assert int(coarse.stats["load_steps"]) > 1
    np.testing.assert_allclose(coarse.tip_position, fine.tip_position, atol=1e-6)


def test_a_column_pressed_past_buckling():
    """Euler's elastica: P / P_cr = 1.5 and a small push to one side."""
    load = 1.5 * np.pi**2 / 4
    force = jnp.array([1e-3 * load, 0.0, -load])
    solution = sr.solve_static(beam(tip_load=sr.TipLoad(force=force)))
    low, high = 1e-6, 1 - 1e-6  # k = sin(half the tip's angle): K(k) = L sqrt(P / EI)
    for _ in range(60):
        k = (low + high) / 2
        low, high = (k, high) if ellipk(k**2) < np.sqrt(load) else (low, k)
    tip = 2 * k / np.sqrt(load), 0.0, 2 * ellipe(k**2) / np.sqrt(load) - 1
    assert bool(solution.stats["stable"])
    # The push, a thousandth of the load, bends it a little more.
    np.testing.assert_allclose(solution.tip_position, tip, atol=2e-3)


def test_a_payload_a_thousand_times_over_buckling():
    """It falls over and hangs: the clamp bends the rod back within 2 sqrt(EI / P) (a soliton)."""
    load, tilt, L, g = 5000.0, 0.02, 0.5, 9.81
    EI = 1e6 * np.pi * 5e-3**4 / 4
    scene = sr.Scene(
        length=L,
        section=sr.Circle(5e-3),
        young_modulus=1e6,
        poisson_ratio=0.3,
        density=1e-9,
        inextensible=True,
        gravity=g * np.array([np.sin(tilt), 0.0, -np.cos(tilt)]),
        payload=sr.Payload(load * EI / L**2 / g),
    )
    solution = sr.solve_static(scene, method=sr.Collocation(96))
    # The angle to the force is 4 arctan exp(-(s + s0) / size), and pi - tilt at the clamp.
    size = L / np.sqrt(load)
    s0 = -size * np.log(np.tan((np.pi - tilt) / 4))
    far, near = (L + s0) / size, s0 / size
    along = L - 2 * size * (np.tanh(far) - np.tanh(near))
    across = 2 * size * (1 / np.cosh(near) - 1 / np.cosh(far))
    down = np.array([np.sin(tilt), 0.0, -np.cos(tilt)])
    aside = np.array([np.cos(tilt), 0.0, np.sin(tilt)])
    assert int(solution.stats["transient_steps"]) > 0
    # In a layer of one interval and a half.
    np.testing.assert_allclose(solution.tip_position, along * down + across * aside, atol=2e-5)


def test_a_load_path_of_many_turns():
    """A dead moment of 60 EI / L: M is the same everywhere, so R_s = R (K^-1 R^T M)^ tells all."""
    L, E = 0.5, 1e6
    EI = E * np.pi * 5e-3**4 / 4
    M = 60 * EI / L * np.array([0.3, 0.2, 0.9327])
    scene = sr.Scene(
        length=L,
        section=sr.Circle(5e-3),
        young_modulus=E,
        poisson_ratio=0.3,
        density=1000.0,
        inextensible=True,
        tip_load=sr.TipLoad(moment=M),
    )
    solution = sr.solve_static(scene)

    def rates(_, y):
        R = y[3:].reshape(3, 3)
        u = (R.T @ M) / (EI * np.array([1.0, 1.0, 1 / 1.3]))
        return np.concatenate([R[:, 2], np.cross(R, u).ravel()])

    start = np.concatenate([np.zeros(3), np.eye(3).ravel()])
    tip = solve_ivp(rates, (0, L), start, rtol=1e-11, atol=1e-12, method="DOP853").y[:3, -1]
    assert int(solution.stats["load_steps"]) > 50
    np.testing.assert_allclose(solution.tip_position, tip, atol=1e-5)


@pytest.mark.parametrize("part", [0.5, 0.9, 0.99])
def test_three_tendons_at_once_up_to_the_limit(part):
    """They shorten the rod to 1 - 3 tau / EA: to nothing at tau = EA / 3."""
    solution = sr.solve_static(ROBOT, [part * EA / 3] * 3)
    np.testing.assert_allclose(solution.tip_position, [0, 0, 0.1 * (1 - part)], atol=1e-12)


def test_three_tendons_beyond_the_limit():
    solution = sr.solve_static(ROBOT, [1.05 * EA / 3] * 3, throw=False)
    assert int(solution.result) == sr.RESULTS.no_equilibrium


@pytest.mark.parametrize("turns", [1.5, 5.0, 12.0])
def test_curls_of_several_turns_from_the_straight_rod(turns):
    """A tendon bends a long rod to a circle: u = tau r / EI, v = 1 - tau / EA."""
    length, offset = 1.0, 4e-3
    tension = 2 * np.pi * turns / length * EI / offset
    u, v = 2 * np.pi * turns / length, 1 - tension / EA
    solution = sr.solve_static(with_(ROBOT, length=length), (tension, 0.0, 0.0))
    tip = v / u * np.array([1 - np.cos(u * length), 0.0, np.sin(u * length)])
    np.testing.assert_allclose(solution.tip_position, tip, atol=1e-12)


@pytest.mark.parametrize("scheme", [sr.SDIRK(), sr.BDFAlpha()], ids=str)
def test_the_shortest_steps(scheme):
    """dt = 1e-5 s: until a wave comes from the clamp, the tip falls freely."""
    scene = sr.hybrid_robot(gravity=jnp.array([-9.81, 0.0, 0.0]))
    motion = sr.simulate(scene, 1e-5, steps=200, scheme=scheme)
    fall = -9.81 / 2 * np.array(motion.ts) ** 2
    # BDF-alpha is of second order, and its first step of first: one dt^2 g / 2 for each step.
    np.testing.assert_allclose(motion.tip_positions[:, 0], fall, atol=1e-7)
    np.testing.assert_allclose(motion.tip_positions[:, 1:], [[0.0, 0.1]] * 201, atol=1e-9)


@pytest.mark.long
@pytest.mark.parametrize("scheme", [sr.SDIRK(), sr.BDFAlpha()], ids=str)
def test_the_error_along_the_rod_does_not_depend_on_the_step(scheme):
    """Within a tenth, from 20 ms to 0.1 ms: 10 intervals of order 4."""
    scene = sr.hybrid_robot(gravity=jnp.array([-9.81, 0.0, 0.0]))
    errors = []
    for dt in (20e-3, 1e-4):
        tips = [
            sr.simulate(
                scene, dt, steps=round(0.2 / dt), scheme=scheme, method=sr.Collocation(n, order=4)
            ).tip_positions[:: round(20e-3 / dt)]
            for n in (10, 20)
        ]
        errors.append(float(jnp.max(jnp.linalg.norm(tips[0] - tips[1], axis=1))))
    assert abs(errors[1] / errors[0] - 1) < 0.1, errors


def test_a_tension_jumps_to_the_limit():
    """1 N at once, half the limit: the front of the wave, thinner than an interval, is borne."""
    tensions = np.zeros((40, 3))
    tensions[:, 0] = 1.0
    for dt in (1e-4, 1e-3):
        assert sr.simulate(ROBOT, dt, tensions, throw=False).result == 0
    # 2 N is 98 % of what the rod bears at rest, and it swings beyond that.
    motion = sr.simulate(ROBOT, 5e-3, 2 * tensions, throw=False)
    assert int(motion.result) != 0 and int(motion.failed_step) > 5
    assert np.all(np.isfinite(motion.tip_positions))


@pytest.mark.long
def test_energy_over_a_thousand_periods():
    """Released from a bent shape, alpha = -0.5, nothing that damps: 40,000 steps.

    The first step, backward Euler, takes 4 % (the fast modes' share); then nothing is lost.
    """
    bare = with_(ROBOT, bending_damping=None, drag_coefficient=None, tendons=None, chambers=None)
    pulled = with_(bare, tip_load=sr.TipLoad(force=jnp.array([0.05 * EI / 0.01, 0.0, 0.0])))
    start = sr.solve_static(pulled)
    rho_A = 1070 * np.pi * 6e-3**2
    period = 2 * np.pi / (3.516 * np.sqrt(EI / rho_A) / 0.01)
    # The phase is lost by then, and the tip with it.
    as_given = dict(substeps=1, max_time_error=jnp.inf)
    motion = sr.simulate(
        bare, period / 40, steps=40_000, initial=start, scheme=sr.BDFAlpha(-0.5), **as_given
    )
    area, I, G = np.pi * 6e-3**2, np.pi * 6e-3**4 / 4, 5e4 / 2.98
    stiffness = np.array([G * area, G * area, EA, EI, EI, 2 * G * I])
    inertia = 1070 * np.array([area, area, area, I, I, 2 * I])
    strain = np.array(motion.strains) - np.array([0, 0, 1, 0, 0, 0])
    density = (stiffness * strain**2 + inertia * np.array(motion.velocities) ** 2).sum(-1) / 2
    energy = density @ np.array([1, *[4, 2] * 5, 4, 1]) * 0.1 / 36
    assert np.abs(energy[1:] / energy[1] - 1).max() < 1e-3
    assert abs(energy[-20_000:].mean() / energy[1:20_001].mean() - 1) < 1e-5
    lengths = np.linalg.norm(np.array(motion.quaternions[-1]), axis=-1)
    np.testing.assert_allclose(lengths, 1.0, atol=1e-14)


def test_float32_is_refused():
    with jax.enable_x64(False), pytest.raises(ValueError, match="float64"):
        sr.solve_static(ROBOT)
    with jax.enable_x64(False), pytest.raises(ValueError, match="float64"):
        sr.simulate(ROBOT, 0.01, steps=2)
