"""The filter against Riccati's equation, and its errors against its covariances."""

import dataclasses
import sys
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.linalg
from scipy.stats import chi2

import softrod_jax as sr
from softrod_jax.control.low_rank import beyond, truncated, weighed
from softrod_jax.learning import Action, Stepper
from softrod_jax.rod.rotations import quaternion_exp, quaternion_product
from softrod_jax.rod.shape import Pose

sys.path.insert(0, str(Path(__file__).parents[2] / "benchmarks"))

import control  # noqa: E402

ROBOT, GRID = control.ROBOT, sr.Collocation(4, order=6)


def test_narrow_roots_end_in_the_solution_of_riccatis_equation():
    """Of a system that four directions are enough for, though it has twelve states."""
    rng = np.random.default_rng(0)
    F = np.zeros((12, 12))
    F[:4, :4] = 0.9 * np.linalg.qr(rng.standard_normal((4, 4)))[0]
    turn = np.linalg.qr(rng.standard_normal((12, 12)))[0]
    F = turn @ F @ turn.T
    L = 0.3 * turn[:, :4] @ rng.standard_normal((4, 2))
    H, R = rng.standard_normal((3, 12)), np.diag([0.04, 0.09, 0.01])
    root = jnp.zeros((12, 4))
    for _ in range(200):
        wide = jnp.concatenate([F @ root, L], 1)
        precision = 1 / np.sqrt(np.diag(R))
        found = weighed(H @ wide, jnp.array([1.0, 2.0, 3.0]), precision)
        change, root = wide @ found.weights, truncated(found.narrowed(wide), jnp.ones(12), 4)
    P = scipy.linalg.solve_discrete_are(F.T, H.T, L @ L.T, R)
    gain = P @ H.T @ np.linalg.inv(H @ P @ H.T + R)
    np.testing.assert_allclose(root @ root.T, P - gain @ H @ P, atol=1e-10)
    np.testing.assert_allclose(change, gain @ [1.0, 2.0, 3.0], atol=1e-9)


def test_surprise_is_the_square_in_terms_of_the_covariance_and_what_is_missing_counts_nothing():
    rng = np.random.default_rng(1)
    root, H = rng.standard_normal((5, 3)), rng.standard_normal((4, 5))
    r, R = rng.standard_normal(4), np.diag([0.5, 1.0, 2.0, 3.0])
    precision = 1 / np.sqrt(np.diag(R))
    given = jnp.array(H @ root), jnp.array(r), jnp.array(precision)
    every = weighed(*given)
    S = H @ root @ root.T @ H.T + R
    np.testing.assert_allclose(every.surprise, r @ np.linalg.solve(S, r), rtol=1e-12)
    missing = np.where(np.arange(4) == 1, np.nan, r)
    rows = [0, 2, 3]
    some = weighed(given[0], jnp.array(missing), given[2])
    few = weighed(*(x[np.array(rows)] for x in given))
    narrow = [x.narrowed(jnp.array(root)) for x in (every, some, few)]
    np.testing.assert_allclose(some.weights, few.weights, rtol=1e-10, atol=1e-12)
    np.testing.assert_allclose(some.surprise, few.surprise, rtol=1e-10)
    np.testing.assert_allclose(narrow[1] @ narrow[1].T, narrow[2] @ narrow[2].T, atol=1e-12)
    assert np.sum(narrow[0] ** 2) < np.sum(narrow[1] ** 2) < np.sum(root**2)


@pytest.mark.parametrize("angle", [0.0, 1e-9, 0.3, 3.0])
def test_differences_of_attitudes_are_rotation_vectors(angle):
    turn = angle * jnp.array([0.6, 0.0, -0.8])
    h = quaternion_exp(jnp.array([0.3, -2.0, 1.0]))
    measured = -1.7 * quaternion_product(quaternion_exp(turn), h)  # of any sign and size
    p = jnp.array([[0.1, 0.2, 0.3]])
    found = beyond(Pose(p, h[None]), Pose(p + 1e-3, measured[None]))
    np.testing.assert_allclose(found, np.append([1e-3] * 3, turn), atol=1e-14)


@pytest.fixture(scope="module")
def estimator():
    given = dict(force=0.03, force_walk=0.05, parameters={"young_modulus": 0.1})
    noise = dict(position_noise=control.NOISE, attitude_noise=control.TURNED)
    return sr.Estimator(ROBOT, 0.01, method=GRID, **noise, **given)


def test_errors_are_as_large_as_said(estimator):
    """Normalised squares of them, of four runs of a rod with other steps and grid: in 99 %."""
    runs, steps, every = 4, 15, []
    for run in range(runs):
        rng = np.random.default_rng(run)
        modulus = np.exp(0.1 * rng.standard_normal())
        walk = np.cumsum(0.05 * 0.1 * rng.standard_normal((steps, 3)), 0)
        forces = 0.03 * rng.standard_normal(3) + walk
        found, failed = control.estimated(estimator, forces, rng, modulus)
        assert not failed
        every.append(found[-1])
    every = np.array(every)
    low, high = chi2.ppf([0.005, 0.995], 4 * runs)
    assert low < every[:, 0].sum() < high, every[:, 0]
    low, high = chi2.ppf([0.005, 0.995], 6 * runs)
    assert low < every[:, 1].sum() < high, every[:, 1]
    off = np.sqrt(np.mean(every[:, 2:] ** 2, 0))
    assert np.all(off[:3] < 0.02) and off[3] < 0.08, off


def test_a_sudden_force_is_the_one_that_explains_best_what_is_seen(estimator):
    """Not the one by the slope at no force: the minimum of all squares, by differences."""
    still, begun = Action(jnp.zeros(3), jnp.zeros(1)), estimator.begin()
    names, deviations = ["young_modulus"], np.array([*[np.hypot(0.03, 0.05 * 0.1)] * 3, 0.1])

    @jax.jit
    def end(chosen):
        scene = dataclasses.replace(
            ROBOT,
            young_modulus=ROBOT.young_modulus * jnp.exp(chosen[3]),
            tip_load=sr.TipLoad(chosen[:3]),
        )
        view = Stepper(scene, 0.01, method=GRID)
        view = view.view(view.step(view.reset(), still))
        return Pose(view.tip_position[None], view.quaternions[-1:])

    seen = end(jnp.array([0.06, -0.05, 0.02, 0.1]))

    def squares(chosen):
        off = np.asarray(beyond(end(jnp.asarray(chosen)), seen)).reshape(2, 3)
        off = off / np.array([[control.NOISE], [control.TURNED]])
        return np.sum(off**2) + np.sum((chosen / deviations) ** 2)

    after = estimator.step(begun, still, seen.position, seen.quaternion)
    chosen = np.append(after.force, [np.log(after.parameters[name]) for name in names])
    # In terms of what is then known, along the axes of that.
    values, axes = np.linalg.eigh(after.covariance)
    steps = 0.05 * axes * np.sqrt(values)
    slopes = [(squares(chosen + d) - squares(chosen - d)) / 0.1 for d in steps.T]
    np.testing.assert_allclose(slopes, 0.0, atol=0.2)
    np.testing.assert_allclose(after.surprise, squares(chosen), rtol=0.02)


def test_nothing_seen_changes_nothing_but_widens(estimator):
    still = Action(jnp.zeros(3), jnp.zeros(1))
    begun = sr.solve_static(ROBOT, (0.0, 0.0, 0.0), (0.0,), method=GRID)
    first = estimator.begin(begun, still)
    after = estimator.step(first, still, jnp.full((1, 3), jnp.nan), jnp.full((1, 4), jnp.nan))
    np.testing.assert_allclose(after.force, 0.0, atol=1e-12)
    grown = np.diag(after.covariance - first.covariance)
    np.testing.assert_allclose(grown, [25e-6, 25e-6, 25e-6, 0.0], rtol=1e-6, atol=1e-12)
    assert after.surprise == 0.0


def test_bad_input(estimator):
    bad = [
        (dict(position_noise=0.0), "position_noise=0.0; a positive number"),
        (dict(force=None), "0 numbers to estimate"),
        (dict(parameters={"stiffness": 0.1}), "no positive number 'stiffness'"),
        (dict(sees=("elbow",)), "sees='elbow'; it is offered"),
        (dict(rank=2), "rank=2 with 3 numbers"),
        (dict(scheme=sr.BDFAlpha()), "memory of past steps; use SDIRK"),
    ]
    for given, message in bad:
        with pytest.raises(ValueError, match=message):
            sr.Estimator(ROBOT, 0.01, **given)
    begun = estimator.begin()
    with pytest.raises(ValueError, match=r"positions has shape \(3,\); \(1, 3\) is needed"):
        estimator.step(begun, Action(), np.zeros(3))
    with pytest.raises(ValueError, match=r"quaternions has shape \(4,\)"):
        estimator.step(begun, Action(), np.zeros((1, 3)), np.zeros(4))


def test_a_rod_in_a_plane_is_estimated_as_the_same_one_in_space():
    """Two tendons and a base that is turned in the plane; what is off it counts nothing."""
    half = 0.15
    robot = sr.Scene(
        length=0.1, section=sr.Circle(5e-3), young_modulus=1e5, poisson_ratio=0.45, density=1e3,
        damping_time=0.02, gravity=jnp.array([0.0, 0.0, 9.81]),
        base_quaternion=jnp.array([np.cos(half), np.sin(half), 0.0, 0.0]),
        tendons=sr.Tendons(jnp.array([[0.0, 3e-3], [0.0, -3e-3]])),
        markers=[sr.Marker("half", 0.05)],
    )  # fmt: skip
    flat, pulls = dataclasses.replace(robot, plane="yz"), (0.05, 0.0)
    given = dict(sees=("half", "tip"), force=0.05, force_walk=0.02, method=GRID)
    force, rng = jnp.array([0.0, 0.02, -0.01]), np.random.default_rng(5)
    pulled = dataclasses.replace(flat, tip_load=sr.TipLoad(force))
    truth = Stepper(pulled, 0.01, method=GRID)
    begun = sr.solve_static(flat, pulls, method=GRID)
    filters = [sr.Estimator(scene, 0.01, rank=40, **given) for scene in (flat, robot)]
    estimates = [f.begin(begun, Action(pulls)) for f in filters]
    state = truth.reset(begun, Action(pulls))
    for _ in range(15):
        state = truth.step(state, Action(pulls))
        view, nodes = truth.view(state), np.array([2, 4])  # the marker and the tip are nodes
        positions = view.positions[nodes] + 3e-4 * rng.standard_normal((2, 3))
        quaternions = view.quaternions[nodes]
        # In space, what is off the plane has not been seen; in the plane it may be anything.
        seen = [positions.at[:, 0].set(x) for x in (1.0, np.nan)]
        estimates = [
            f.step(e, Action(pulls), p, quaternions) for f, e, p in zip(filters, estimates, seen)
        ]
    assert not any(int(e.result) for e in estimates)
    plane, space = estimates
    assert plane.covariance.shape == (2, 2) and space.covariance.shape == (3, 3)
    np.testing.assert_allclose(plane.force, space.force, atol=1e-6)
    np.testing.assert_allclose(plane.covariance, space.covariance[1:, 1:], rtol=1e-3, atol=1e-9)
    np.testing.assert_allclose(plane.force, force, atol=4 * np.sqrt(plane.covariance[0, 0]))
    assert plane.force[0] == 0.0 and np.sqrt(plane.covariance[0, 0]) < 0.01
