"""The judges of the stress test against closed forms and solutions that others computed."""

import dataclasses
import sys
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest
from problems import CLOSED_FORMS, beam
from scipy.integrate import quad_vec
from scipy.spatial.transform import Rotation

import softrod_jax as sr

sys.path.insert(0, str(Path(__file__).parents[2] / "benchmarks"))

import judge_rod  # noqa: E402
import judge_static  # noqa: E402
import judge_stress  # noqa: E402


def judged(scene, tensions=None, pressures=None, start=None):
    """The verdict from the unloaded rod, or from `start`: curvatures (n, 3) [1/m] along it."""
    rod = judge_rod.rod_of(scene, tensions, pressures)
    strain = np.broadcast_to(rod.rest, (33, 6)).copy()
    strain[:, 3:] = strain[:, 3:] / rod.length if start is None else start
    s = np.linspace(0, rod.length, 33)
    turned = [rod.h_base]
    for u in (strain[1:, 3:] + strain[:-1, 3:]) / 2:
        turned.append(judge_rod.product(turned[-1], judge_rod.exponential(u * s[1])))
    return judge_static.judge(rod, s, strain, np.array(turned))


@pytest.mark.parametrize("problem", CLOSED_FORMS, ids=repr)
def test_closed_forms(problem):
    verdict = judged(problem.scene, problem.tensions, problem.pressures)
    error = np.max(np.abs(verdict.tip - np.array(problem.tip)))
    assert error < max(problem.tolerance, 1e-9 * float(problem.scene.length))
    assert verdict.error < 1e-8


@pytest.mark.parametrize("a, b", [(10, 30), (1, 60), (30, 70)])
def test_moment_that_twists_and_bends(a, b):
    """Under a dead moment m the frames are exp(s m) exp(s (1/GJ - 1/EI) m_3 e3), EI = 1."""
    m, nu = np.array([a, 0.0, b]), 0.3
    scene = beam(tip_load=sr.TipLoad(moment=jnp.array(m)))
    turn = lambda s, axis: Rotation.from_rotvec(s * axis)
    spin = np.array([0.0, 0.0, nu * m[2]])
    tangent = lambda s: (turn(s, m) * turn(s, spin)).apply([0.0, 0.0, 1.0])
    tip, _ = quad_vec(tangent, 0, 1, epsabs=1e-12, limit=2000)
    start = (m + spin) * np.array([0.9, 1.0, 0.97])  # turns by two radians too few
    verdict = judged(scene, start=np.broadcast_to(start, (33, 3)))
    np.testing.assert_allclose(verdict.tip, tip, atol=1e-9)


def tube(radius):
    return sr.Scene(1.0, sr.Circle(radius), 1e6, 0.3, 1100.0, gravity=jnp.array([9.81, 0.0, 0.0]))


def test_layer_at_the_clamp():
    """Heavy tubes; the answers are scipy's solve_bvp of the planar equations, tolerance 1e-9."""
    start = np.zeros((33, 3))
    start[:4, 1] = np.pi / 2 / 0.1  # hanging down behind a bend at the clamp
    for radius, tip in ((5e-3, (0.99137673, 0.03460752)), (2.5e-3, (0.9984349, 0.01711767))):
        verdict = judged(tube(radius), start=start)
        np.testing.assert_allclose(verdict.tip, (tip[0], 0.0, tip[1]), atol=1e-7)
        assert verdict.error < 1e-9


@pytest.mark.parametrize("tensions, gravity, tip", [
    ((1.0, 0, 0), None, (0.010531281502810087, 0.0, 0.010473290582383844)),
    ((0.2, 0.05, 0.1), None, (0.04319842000624676, -0.014964371651503841, 0.07987267580495529)),
    ((0.1, 0, 0), (-9.81, 0, 0), (-0.08042432855603669, 0.0, 0.051468352349980866)),
    ((0.1, 0, 0), (0, 0, 9.81), (0.01179940260177042, 0.0, 0.09797535348838424)),
])  # fmt: skip
def test_tendons_and_pressure(tensions, gravity, tip):
    """The article's robot, by single shooting at a relative tolerance of 1e-13."""
    gravity = None if gravity is None else jnp.array(gravity)
    scene = sr.hybrid_robot(gravity=gravity)
    pressure = 20e3 if tensions[1] else 0.0
    coarse = sr.solve_static(
        scene, jnp.array(tensions), jnp.array([pressure]), method=sr.Collocation(6)
    )
    verdict = judge_static.judge_answer(scene, coarse, tensions, (pressure,))
    np.testing.assert_allclose(verdict.tip, tip, atol=1e-10)


def test_sections():
    for section in (sr.Annulus(2e-3, 1.5e-3), sr.Rectangle(1e-3, 3e-3), sr.Rectangle(2.0, 2.0)):
        numbers = judge_rod.section_numbers(section)
        for ours, its in zip(
            numbers, (section.area, section.second_moments, section.torsion_constant)
        ):
            np.testing.assert_allclose(ours, its, rtol=1e-7)


def test_no_equilibrium_is_said():
    """Beyond 2.036 N the article's rod has no smooth equilibrium under one tendon."""
    with pytest.raises(judge_rod.NoAnswer):
        judged(sr.hybrid_robot(), (2.2, 0.0, 0.0), (0.0,))


def test_motions_of_a_curved_rod_in_any_pose():
    """It rests on its arc where nothing acts; a dead force at its tip sets it going as ours."""
    turn = np.array([0.3, -0.5, 0.2, 0.8])
    scene = sr.Scene(
        length=0.2,
        section=sr.Rectangle(4e-3, 6e-3),
        young_modulus=1e6,
        poisson_ratio=0.3,
        density=1200.0,
        bending_damping=2e-7,
        rest_curvature=jnp.array([0.0, 1.0 / 0.2, 0.0]),
        base_quaternion=jnp.array(turn / np.linalg.norm(turn)),
    )
    case = judge_stress.case_of(scene, None, None, 5e-3)
    assert case is not None
    still = judge_stress.follow([case], 32)[0]
    np.testing.assert_allclose(still, [[1 - np.cos(1.0), 0.0, np.sin(1.0)]] * 21, atol=1e-4)
    pushed = dataclasses.replace(scene, tip_load=sr.TipLoad(jnp.array([2e-3, 1e-3, 0.0])))
    case = judge_stress.case_of(pushed, None, None, 5e-3)
    coarse, fine = (judge_stress.follow([case], n)[0] for n in (16, 32))
    motion = sr.simulate(pushed, 5e-3, steps=20)
    ours = judge_stress.in_frame(pushed, motion.tip_positions)
    assert np.max(np.linalg.norm(ours - still[0], axis=1)) > 0.05
    np.testing.assert_allclose(ours, fine + (fine - coarse) / 3, atol=1e-3)
