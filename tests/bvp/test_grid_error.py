"""The estimated error along the rod is an error: against closed forms and an independent solver.

Problems of which every one was once answered wrongly without a word: layers at the clamp, turns
that a grid does not see, forces that leave a bend as short as an interval.
"""

from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import quad_vec
from scipy.spatial.transform import Rotation

import softrod_jax as sr

E, NU, RADIUS, L = 5e4, 0.49, 6e-3, 0.1
EI = E * np.pi * RADIUS**4 / 4
GJ = EI / (1 + NU)


def tube(radius):
    return sr.Scene(
        length=1.0,
        section=sr.Circle(radius),
        young_modulus=1e6,
        poisson_ratio=0.3,
        density=1100.0,
        gravity=jnp.array([9.81, 0.0, 0.0]),
    )


def twisted(a, b):
    moment = np.array([a, 0.0, b]) * EI / L
    scene = sr.Scene(
        length=L,
        section=sr.Circle(RADIUS),
        young_modulus=E,
        poisson_ratio=NU,
        density=1000.0,
        tip_load=sr.TipLoad(moment=jnp.array(moment)),
    )

    def axis(s):
        twist = Rotation.from_rotvec([0, 0, s * (1 / GJ - 1 / EI) * moment[2]])
        return (Rotation.from_rotvec(s * moment / EI) * twist).apply([0, 0, 1.0])

    return scene, quad_vec(axis, 0, L, epsabs=1e-13, limit=2000)[0]


def coil(turns):
    """A helix of rest curvature that hangs askew; the tips by an independent solver."""
    size = np.array([147.78051, 0.0, 30.159289]) * turns / 24
    return sr.Scene(
        length=1.0,
        section=sr.Circle(1e-3),
        young_modulus=2e9,
        poisson_ratio=0.3,
        density=1200.0,
        gravity=jnp.array([1.5, 0.0, 4.905]),
        rest_curvature=jnp.array(size),
    )


@dataclass(frozen=True)
class Problem:
    """`known`: to how many lengths `tip` is known."""

    scene: sr.Scene
    tip: np.ndarray
    known: float = 1e-8


PROBLEMS = {
    # scipy's solve_bvp on the planar equations (theta, m, x, z), n(s) in closed form, to 1e-9.
    "heavy tube": Problem(tube(5e-3), np.array([0.99137673, 0.0, 0.03460752])),
    "heavy thin tube": Problem(tube(2.5e-3), np.array([0.9984349, 0.0, 0.01711767])),
    "twist of 30": Problem(*twisted(10, 30)),
    "twist of 40": Problem(*twisted(1, 40)),
    "twist of 60": Problem(*twisted(1, 60)),
    # Known to the digits that are printed.
    "coil of 24 turns": Problem(coil(24), np.array([0.1788, 0.0, 0.0881]), 7e-5),
}


def error_of(solution, problem):
    distance = np.linalg.norm(np.array(solution.tip_position) - problem.tip)
    return distance / float(problem.scene.length)


@pytest.mark.parametrize("name", PROBLEMS)
def test_the_answer_as_called_is_good_to_a_ten_thousandth(name):
    problem = PROBLEMS[name]
    solution = sr.solve_static(problem.scene)
    error, estimate = error_of(solution, problem), float(solution.stats["error"])
    assert error < 1e-4 + problem.known
    assert estimate < 1e-4
    assert error < 3 * estimate + 1e-5 + problem.known
    assert solution.method.intervals > sr.Collocation().intervals


@pytest.mark.parametrize("intervals", [12, 24])
@pytest.mark.parametrize("name", ["heavy tube", "twist of 30", "twist of 60", "coil of 24 turns"])
def test_the_estimate_on_a_grid_that_is_given(name, intervals):
    problem, method = PROBLEMS[name], sr.Collocation(intervals)
    solve = jax.jit(lambda scene: sr.solve_static(scene, method=method, throw=False))
    solution = solve(problem.scene)
    error, estimate = error_of(solution, problem), float(solution.stats["error"])
    solved = int(solution.result) == 0
    assert not solved or error < 1e-2
    if int(solution.result) in (sr.RESULTS.successful, sr.RESULTS.inaccurate):
        assert error < 3 * estimate
    if not solved:
        assert solution.stats["needed_intervals"] > intervals


@pytest.mark.parametrize("method", [sr.Collocation(6, 4), sr.Collocation(8), sr.Shooting(4, 3)])
def test_where_the_order_is_reached_the_estimate_is_the_error(method):
    scene = sr.hybrid_robot(gravity=jnp.array([9.81, 0.0, 0.0]))
    tensions = jnp.array([0.1, 0.05, 0.0])
    rough = sr.solve_static(scene, tensions, method=method)
    fine = sr.solve_static(scene, tensions, method=sr.Collocation(48))
    error = np.linalg.norm(rough.tip_position - fine.tip_position) / scene.length
    assert 1.0 < float(rough.stats["error"]) / error < 4.0


def test_no_estimate_is_no_success():
    scene = sr.hybrid_robot(gravity=jnp.array([9.81, 0.0, 0.0]))
    alone = sr.solve_static(scene, method=sr.Collocation(1), throw=False)
    assert alone.result == sr.RESULTS.inaccurate
    refined = sr.solve_static(scene, method=sr.Collocation(1), tolerance=1e-5)
    best = sr.solve_static(scene)
    assert np.linalg.norm(refined.tip_position - best.tip_position) < 3e-5 * scene.length


def test_a_motion_on_a_grid_that_hides_turns_is_inaccurate():
    scene = replace(coil(6), bending_damping=3e-4)
    motion = sr.simulate(scene, 0.01, steps=2, method=sr.Collocation(12), throw=False)
    assert motion.result == sr.RESULTS.inaccurate
