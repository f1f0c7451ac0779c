"""Targets made by known inputs, closed forms, and the conditions of the least effort."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import softrod_jax as sr
from softrod_jax.analysis.least_effort import bounded_minimum

METHOD = sr.Collocation(4)
ROBOT = sr.hybrid_robot()
HIGHEST = np.array([0.5, 0.5, 0.5, 40e3])
LIMITS = {"tensions": (0.0, 0.5), "pressures": (0.0, 40e3)}
# Farther along the axis than the chamber can make the robot.
BEYOND = [0.0, 0.0, 0.2]
COUNT = 100


@pytest.fixture(scope="module")
def made():
    """Targets, the last one out of reach, and the inputs that the others are made by."""
    inputs = np.random.default_rng(3).uniform(size=(COUNT - 1, 4)) * HIGHEST

    def tip(u):
        return sr.solve_static(ROBOT, u[:3], u[3:], method=METHOD, throw=False).tip_position

    tips = np.asarray(jax.jit(lambda u: jax.lax.map(tip, u))(inputs))
    return np.concatenate([tips, [BEYOND]]), inputs


@pytest.fixture(scope="module")
def found(made):
    return sr.inverse(ROBOT, made[0], LIMITS, method=METHOD, throw=False)


def test_reachable_targets_are_reached(made, found):
    targets, inputs = made
    assert np.all(found.result[:-1] == 0) and np.all(found.distance[:-1] < 1e-6)
    tensions, pressures = np.asarray(found.tensions), np.asarray(found.pressures)
    assert np.all((tensions >= 0) & (tensions <= 0.5)) and np.all(pressures <= 40e3)
    for k in range(0, COUNT - 1, 25):
        again = sr.solve_static(ROBOT, tensions[k], pressures[k], method=METHOD)
        np.testing.assert_allclose(again.tip_position, targets[k], atol=1e-6)
    # With no more effort than those that the targets are made by, nearly always.
    efforts = np.sum((inputs / HIGHEST) ** 2, axis=1)
    assert np.mean(found.effort[:-1] <= efforts + 1e-6) > 0.97


def test_effort_is_least(made, found):
    """Karush, Kuhn and Tucker: x = J^T multipliers, but for inputs at a bound that they push on."""
    checked = 0
    for k in range(0, COUNT - 1, 12):
        u = np.append(found.tensions[k], found.pressures[k])
        J = sr.actuation_jacobian(ROBOT, u[:3], u[3:], method=METHOD)[:3] * HIGHEST
        x = u / HIGHEST
        free = (x > 1e-6) & (x < 1 - 1e-6)
        if free.sum() < 3:
            continue
        multipliers = np.linalg.lstsq(np.asarray(J)[:, free].T, x[free], rcond=None)[0]
        slope = x - np.asarray(J).T @ multipliers
        np.testing.assert_allclose(slope[free], 0.0, atol=2e-3)
        assert np.all(slope[x <= 1e-6] >= -2e-3) and np.all(slope[x >= 1 - 1e-6] <= 2e-3)
        checked += 1
    assert checked >= 3


def test_the_nearest_point_to_one_out_of_reach(found):
    """On the axis, as long as the highest pressure makes it."""
    assert found.result[-1] == sr.RESULTS.unreachable
    E, A = 0.05e6, np.pi * 6e-3**2
    length = 0.1 * (1 + 40e3 * np.pi * 1.5e-3**2 / (E * A))
    np.testing.assert_allclose(found.position[-1], [0.0, 0.0, length], atol=1e-6)
    np.testing.assert_allclose(found.distance[-1], 0.2 - length, atol=1e-6)
    np.testing.assert_allclose(found.tensions[-1], 0.0, atol=1e-6)


def test_what_is_not_reached_raises(made):
    # Of as many targets as elsewhere: the same program.
    with pytest.raises(sr.SolveError, match="out of reach within the limits"):
        sr.inverse(ROBOT, made[0], LIMITS, method=METHOD)


def test_a_path_of_poses_of_a_marker():
    """One tendon of given length: the pulls that made the poses come back."""
    robot = sr.Scene(
        length=0.1, section=sr.Circle(5e-3), young_modulus=1e5, poisson_ratio=0.45, density=1e3,
        plane="xz", inextensible=True,
        tendons=sr.Tendons(jnp.array([[3e-3, 0.0]]), control="length"),
        markers=[sr.Marker("half", 0.05)],
    )  # fmt: skip
    pulls = np.linspace(1e-3, 5e-3, 5)
    poses = [sr.solve_static(robot, pulls=(d,), method=METHOD).markers["half"] for d in pulls]
    targets, turns = (np.stack(x) for x in zip(*((p.position, p.quaternion) for p in poses)))
    answer = sr.inverse(
        robot, targets, {"pulls": (0.0, 8e-3)}, quaternion=turns, of="half", path=True,
        method=METHOD, samples=16,
    )  # fmt: skip
    np.testing.assert_allclose(answer.pulls[:, 0], pulls, rtol=1e-6)
    assert answer.tensions is None and np.max(answer.angle) < 1e-6


def test_minimum_within_bounds():
    """Where a component is free its slope is zero, and elsewhere it pushes on its bound."""
    draw = np.random.default_rng(1)
    solve = jax.jit(bounded_minimum)
    for _ in range(300):
        J = draw.normal(size=(3, 4))
        H = J.T @ J + 10.0 ** draw.uniform(-10, 0) * np.eye(4)
        g, x = draw.normal(size=4), np.round(draw.uniform(size=4), 1)
        d = np.asarray(solve(H, g, -x, 1 - x))
        slope = H @ d + g
        wrong = np.where(d <= -x, np.minimum(slope, 0), slope)
        wrong = np.where(d >= 1 - x, np.maximum(slope, 0), wrong)
        np.testing.assert_allclose(wrong, 0.0, atol=1e-12)


def test_refusals(wrong_types):
    ask = lambda *args, **options: sr.inverse(ROBOT, *args, **options)
    place = np.array([0.0, 0.0, 0.1])
    with pytest.raises(ValueError, match="limits for 'pulls', of which the scene has none"):
        ask(place, {"pulls": (0.0, 1e-3)})
    with pytest.raises(ValueError, match="a lowest and a highest value are needed"):
        ask(place, {"tensions": (0.0, [1.0, 2.0])})
    with pytest.raises(ValueError, match="expected lowest < highest"):
        ask(place, {"tensions": (1.0, 1.0)})
    with pytest.raises(ValueError, match="a tendon can only pull: at least 0"):
        ask(place, {"tensions": (-1.0, 1.0)})
    with pytest.raises(ValueError, match="target has shape"):
        ask(np.array([0.0, 0.1]), LIMITS)
    with pytest.raises(ValueError, match="quaternion has shape"):
        ask(place, LIMITS, quaternion=np.array([1.0, 0.0, 0.0]))
    with pytest.raises(ValueError, match="of='hand' is not a marker"):
        ask(place, LIMITS, of="hand")


@pytest.mark.long
def test_inputs_follow_targets_and_the_scene():
    """Forward = reverse = central differences of searches of their own.

    With all inputs free, so that effort decides in one direction; with one at its bound, so that
    the target says all; and for the nearest point to a target out of reach.
    """
    targets = np.array([[0.005, 0.003, 0.095], [0.02, 0.004, 0.1], [0.06, 0.01, 0.095]])
    limits = {"tensions": (0.0, 0.5), "pressures": (-40e3, 40e3)}

    def answers(z):
        robot = dataclasses.replace(ROBOT, young_modulus=z[0] * ROBOT.young_modulus)
        found = sr.inverse(
            robot, targets + 0.01 * z[1:], limits, method=METHOD, samples=16, throw=False
        )
        inputs = jnp.concatenate([found.tensions / 0.5, found.pressures / 40e3], 1)
        rest = 10 * found.distance[:, None], 10 * found.position, found.effort[:, None]
        return jnp.concatenate([inputs, *rest], 1), found

    z, values = jnp.array([1.0, 0.0, 0.0, 0.0]), jax.jit(answers)
    inputs, found = values(z)
    np.testing.assert_array_equal(found.result, [0, 0, sr.RESULTS.unreachable])
    free = (inputs[:, :4] != 0) & (np.abs(inputs[:, :4]) != 1)
    np.testing.assert_array_equal(free.sum(1), [4, 3, 2])
    forward = jax.jit(jax.jacfwd(lambda z: answers(z)[0]))(z)
    reverse = jax.jit(jax.jacrev(lambda z: answers(z)[0]))(z)
    np.testing.assert_allclose(forward, reverse, atol=1e-11)
    steps = 2e-3 * np.eye(4)
    apart = lambda n: np.stack([values(z + n * d)[0] - values(z - n * d)[0] for d in steps], -1)
    slopes = (8 * apart(1) - apart(2)) / (12 * 2e-3)
    np.testing.assert_allclose(forward, slopes, atol=2e-5 * np.abs(forward).max())
    # A modulus of all times as much asks for as much of all inputs, where they are free.
    np.testing.assert_allclose(forward[0, :4, 0], inputs[0, :4], atol=1e-6)


def test_there_are_first_derivatives_only():
    ask = lambda x: sr.inverse(ROBOT, x, LIMITS, method=METHOD, samples=4, throw=False).effort
    place = jnp.array([0.02, 0.0, 0.1])
    with pytest.raises(ValueError, match="has first derivatives only"):
        jax.eval_shape(jax.hessian(ask), place)
