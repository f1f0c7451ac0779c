"""Tendons that rub in their channels, and actuators with play, against closed forms.

A tendon at the distance r of the axis bends a rod in a circle, u = r tau / EI, and turns with it:
theta_s = (r tau / EI), tau = T exp(-mu theta) while it is pulled, so that
exp(mu theta) = 1 + mu r T s / EI. Where it is released, exp(-mu theta) = 1 - mu r T s / EI.
"""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import softrod_jax as sr
from softrod_jax.foundation.results import RESULTS

TENDON, LENGTH = 4e-3, 0.1


def robot(mu, **tendons):
    """One tendon on a straight rod; `mu`: its coefficient."""
    scene = sr.hybrid_robot(gravity=None)
    one = sr.Tendons(jnp.array([[TENDON, 0.0]]), friction=(mu,), **tendons)
    return dataclasses.replace(scene, tendons=one, chambers=None)


SCENE = robot(0.2)
EI = float(SCENE.young_modulus) * float(SCENE.section.second_moments[0])
ARCS = [(0.05, 0.3), (0.3, 0.1), (0.3, 0.6), (1.0, 0.8)]
CASES = [(sr.Collocation(), *arc) for arc in ARCS]
CASES += [(sr.Shooting(segments=4, steps=12), *arc) for arc in ARCS[:3]]


def turn_of(solution):
    """The angle of the tip [rad], up to half a turn."""
    q = solution.tip_quaternion
    return 2 * jnp.arctan2(jnp.linalg.norm(q[..., 1:], axis=-1), q[..., 0])


def pulled_turn(mu, tension, s=LENGTH):
    return np.log1p(mu * TENDON * tension * s / EI) / mu


@pytest.mark.parametrize(
    "method, mu, tension", CASES, ids=[f"{type(m).__name__}-{mu}-{T}" for m, mu, T in CASES]
)
def test_a_pulled_tendon_loses_what_the_capstan_says(method, mu, tension):
    solution = sr.solve_static(robot(mu), tensions=[tension], method=method)
    turn = pulled_turn(mu, tension)
    assert abs(turn_of(solution) - turn) < 1e-7
    along = solution.tensions_along[:, 0]
    assert along[0] == tension == solution.tensions[0]
    assert abs(along[-1] / tension - np.exp(-mu * turn)) < 1e-7


def test_a_tendon_that_is_let_out_gains_what_the_capstan_says():
    mu, tension = 0.2, 0.2
    solution = sr.solve_static(robot(mu), tensions=[tension], sliding=[-1])
    turn = -np.log1p(-mu * TENDON * tension * LENGTH / EI) / mu
    assert abs(turn_of(solution) - turn) < 1e-6
    along = solution.tensions_along[:, 0]
    assert abs(along[-1] / tension - np.exp(mu * turn)) < 1e-6


def test_where_a_release_stops_the_tendon_sticks():
    mu, high, low = 0.3, 0.4, 0.22
    fine = sr.Collocation(intervals=48)
    path = sr.solve_path(robot(mu), tensions=[[high], [low]], method=fine)
    front = (high - low) * EI / (2 * mu * TENDON * high * low)
    assert 0.2 * LENGTH < front < 0.8 * LENGTH
    released = -np.log1p(-mu * TENDON * low * front / EI) / mu
    stuck = pulled_turn(mu, high) - pulled_turn(mu, high, front)
    # What sticks gives by 1e-4 of the tendon's length.
    assert abs(turn_of(path)[1] - (released + stuck)) < 2e-3 * stuck
    before, after = path.tensions_along[:, :, 0]
    outboard = path.arc_lengths[1] > 1.3 * front
    assert np.allclose(before[outboard], after[outboard], rtol=3e-3)
    inboard = (path.arc_lengths[1] > 0) & (path.arc_lengths[1] < front)
    assert np.all(after[inboard] > low)


def test_a_tendon_that_winds_about_a_stiff_rod_turns_as_a_helix():
    mu, radius, turns = 0.2, 3e-3, 1.5
    helix = sr.Helix(radius=radius, turns=turns)
    scene = robot(mu, paths=(helix,))
    tendons = dataclasses.replace(scene.tendons, offsets=jnp.zeros((1, 2)))
    scene = dataclasses.replace(scene, tendons=tendons, young_modulus=jnp.array(5e13))
    solution = sr.solve_static(scene, tensions=[0.5], sliding=[1])
    pitch = 2 * np.pi * turns / LENGTH
    per_unit = radius * pitch**2 / np.sqrt(1 + (radius * pitch) ** 2)
    along = solution.tensions_along[:, 0]
    assert np.isclose(along[-1] / along[0], np.exp(-mu * per_unit * LENGTH), rtol=1e-6)


def cycle(mu, rows=60, low=0.05, high=0.5):
    """Up, down and up again, on a grid that sees the front of what slides."""
    up = np.linspace(low, high, rows)
    tensions = np.concatenate([up, up[::-1][1:], up[1:]])[:, None]
    path = sr.solve_path(robot(mu), tensions=tensions, method=sr.Collocation(intervals=24))
    # The closed loop of what comes after the first way up.
    return jax.tree.map(lambda x: x[rows - 1 :], path)


def enclosed(path):
    """The work that the actuator leaves in a cycle [J]."""
    pulled, tension = path.reached.slid.slip[:, 0, 0], path.tensions[:, 0]
    return float(jnp.sum(0.5 * (tension[1:] + tension[:-1]) * jnp.diff(pulled)))


def rubbed(path):
    """The work of friction [J]: by how much tensions fall, times how far tendons slide there."""
    slip = path.reached.slid.slip[:, ::4, 0]
    mean = lambda x: 0.5 * (x[1:] + x[:-1])
    fall = -jnp.diff(mean(path.tensions_along[:, :, 0]), axis=1)
    slides = 0.5 * (jnp.diff(slip, axis=0)[:, 1:] + jnp.diff(slip, axis=0)[:, :-1])
    return float(jnp.sum(fall * slides))


def test_a_cycle_costs_the_work_of_friction():
    path = cycle(0.2)
    assert np.allclose(path.tip_position[0], path.tip_position[-1], atol=1e-6)
    assert enclosed(path) > 0
    assert np.isclose(enclosed(path), rubbed(path), rtol=1e-2)


def test_the_loop_vanishes_with_friction():
    areas = [enclosed(cycle(mu)) for mu in (0.04, 0.01, 0.0025)]
    assert areas[0] > 3 * areas[1] > 9 * areas[2] > 0
    assert abs(enclosed(cycle(0.0))) < 1e-12


def test_derivatives_along_a_path_of_inputs():
    rows = jnp.array([[0.2], [0.4], [0.33], [0.35]])

    def seen(x):
        scene = dataclasses.replace(robot(x[0]), young_modulus=x[1])
        path = sr.solve_path(scene, tensions=rows * x[2], method=sr.Collocation(), throw=False)
        return jnp.concatenate([path.tip_position[-1], path.tensions_along[-1, -1]])

    x = jnp.array([0.25, 5e4, 1.0])
    forward, reverse = jax.jacfwd(seen)(x), jax.jacrev(seen)(x)
    step = jnp.diag(1e-5 * x)
    central = jnp.stack([(seen(x + h) - seen(x - h)) / (2 * h.sum()) for h in step], 1)
    assert np.allclose(forward * x, reverse * x, rtol=1e-9, atol=1e-12)
    assert np.allclose(forward * x, central * x, rtol=1e-5, atol=1e-8)


@pytest.mark.long
def test_a_slow_motion_goes_along_the_path_of_equilibria():
    t = np.linspace(0.0, 1.0, 101)[1:]
    tensions = 0.4 * (0.5 - 0.5 * np.cos(3 * np.pi * t))[:, None]
    scene = dataclasses.replace(robot(0.3), bending_damping=jnp.full(3, 2e-7))
    motion = sr.simulate(scene, 1.6, tensions=tensions, throw=False)
    path = sr.solve_path(scene, tensions=tensions)
    apart = jnp.linalg.norm(motion.tip_positions[1:] - path.tip_position, axis=-1)
    assert jnp.max(apart) < 3e-3 * LENGTH
    # Without memory the way back would be the way there.
    there, back = path.tip_position[20], path.tip_position[45]
    assert np.isclose(tensions[20, 0], tensions[45, 0], rtol=5e-2)
    assert jnp.linalg.norm(there - back) > 0.05 * LENGTH


def test_a_motion_with_friction_settles_with_the_step():
    tip = {}
    for dt in (8e-3, 2e-3, 5e-4):
        t = dt * np.arange(1, round(0.6 / dt) + 1)
        tensions = 0.3 * (0.5 - 0.5 * np.cos(2 * np.pi * t / 0.3))[:, None]
        motion = sr.simulate(robot(0.2), dt, tensions=tensions, substeps=1)
        tip[dt] = motion.tip_positions[:: round(8e-3 / dt)]
    off = [float(jnp.max(jnp.abs(tip[dt] - tip[5e-4]))) for dt in (8e-3, 2e-3)]
    assert off[1] < 1e-3 * LENGTH and off[0] > 2 * off[1]


def test_a_motion_begins_where_tendons_have_slid():
    scene = dataclasses.replace(robot(0.3), bending_damping=jnp.full(3, 3e-6))
    path = sr.solve_path(scene, tensions=[[0.4], [0.3]])
    held = sr.simulate(scene, 0.01, tensions=[[0.3]] * 20, initial=sr.row_of(path, -1))
    assert jnp.max(jnp.abs(held.tip_positions - path.tip_position[-1])) < 1e-7


def test_steps_of_a_stepper_are_those_of_a_motion():
    scene, dt = robot(0.3, control="length", backlash=(4e-4,)), 4e-3
    pulls = 3e-3 * np.sin(np.linspace(0.0, 5.0, 40))[:, None]
    motion = sr.simulate(scene, dt, pulls=pulls, substeps=1)
    from softrod_jax.learning import Action, Stepper

    stepper = Stepper(scene, dt)
    _, seen = stepper.rollout(stepper.reset(), Action(pulls=pulls))
    assert np.allclose(seen.tip_position, motion.tip_positions[1:], atol=1e-9)


def test_given_lengths_with_friction_give_back_the_tensions():
    pulled = sr.solve_static(robot(0.3), tensions=[0.4])
    pulls = sr.tendon_pulls(robot(0.3), pulled)
    held = sr.solve_static(robot(0.3, control="length"), pulls=pulls)
    assert np.isclose(held.tensions[0], 0.4, rtol=1e-8)
    assert np.allclose(held.tip_position, pulled.tip_position, atol=1e-9)


def test_play_of_an_actuator_is_a_dead_band():
    play = 6e-4
    scene, plain = robot(None, control="length", backlash=(play,)), robot(None, control="length")
    pulls = jnp.array([2e-4, 1e-3, 2e-3, 1.7e-3, 1.4e-3, 1.2e-3, 2e-3])
    followed = jnp.array([0.0, 0.7e-3, 1.7e-3, 1.7e-3, 1.7e-3, 1.5e-3, 1.7e-3])
    path = sr.solve_path(scene, pulls=pulls[:, None])
    assert np.allclose(path.pulls[:, 0], followed, atol=1e-12)
    expected = sr.solve_path(plain, pulls=followed[:, None])
    assert np.allclose(path.tip_position, expected.tip_position, atol=1e-9)


def test_an_equilibrium_goes_on_from_the_one_before():
    scene = robot(0.3)
    grid = sr.Collocation()
    whole = sr.solve_path(scene, tensions=[[0.2], [0.4], [0.3]], method=grid)
    last = None
    for tension in (0.2, 0.4, 0.3):
        last = sr.solve_static(scene, tensions=[tension], before=last, method=grid)
    assert np.allclose(last.tip_position, whole.tip_position[-1], atol=1e-9)


@pytest.mark.long
def test_a_bad_sample_of_a_batch_of_paths_spoils_no_other():
    batch = jnp.array([[[0.2], [0.3]], [[0.2], [jnp.nan]], [[0.3], [0.25]]])
    solve = lambda scene, rows: sr.solve_path(scene, tensions=rows, throw=False)
    paths = jax.vmap(solve, (None, 0))(SCENE, batch)
    assert paths.result.tolist() == [[0, 0], [0, RESULTS.bad_input], [0, 0]]

    def total(mu):
        scene = robot(mu)
        good = lambda rows: jnp.sum(solve(scene, rows).tip_position)
        return jnp.sum(jax.vmap(good)(batch))

    alone = lambda mu: (
        sum(jnp.sum(sr.solve_path(robot(mu), tensions=rows).tip_position) for rows in batch[::2])
        + jnp.sum(sr.solve_static(robot(mu), tensions=[0.2], method=sr.Collocation()).tip_position)
    )
    assert np.isclose(jax.grad(total)(0.2), jax.grad(alone)(0.2), rtol=1e-8)


@pytest.mark.parametrize(
    "arguments, message",
    [
        ({"sliding": [0.5]}, "sliding"),
        ({"sliding": [1, 1]}, "1 tendons with friction"),
    ],
)
def test_directions_that_cannot_be_are_refused(arguments, message):
    with pytest.raises(ValueError, match=message):
        sr.solve_static(SCENE, tensions=[0.1], **arguments)


def test_friction_below_zero_is_refused():
    with pytest.raises(ValueError, match="friction"):
        sr.solve_static(robot(-0.1), tensions=[0.1])
