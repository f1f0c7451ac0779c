"""The sweeps solve their systems, whatever parts a state has, and without pivoting."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.flatten_util import ravel_pytree

import softrod_jax as sr
from softrod_jax.bvp.block_sweep import factorise, solve_sweeps
from softrod_jax.bvp.equations import Equations, Unknowns
from softrod_jax.bvp.unloaded import unloaded_guess
from softrod_jax.rod.reduction import make_rod
from softrod_jax.rod.state import History, layout_of
from softrod_jax.scene.inputs import Inputs
from softrod_jax.scene.scene import as_arrays

METHOD = sr.Collocation()
PLACES = 8


# In motions and at rest, with and without attitude, in space and in a plane; 7 is odd.
@pytest.mark.parametrize("n, a", [(16, 10), (12, 6), (10, 4), (7, 4), (6, 0), (2, 0)])
def test_solves_what_it_was_given(n, a):
    rng = np.random.default_rng(n)
    intervals, b = 8, n - a
    left = -np.eye(n) + 0.05 * rng.normal(size=(intervals, n, n))
    right = np.eye(n) + 0.05 * rng.normal(size=(intervals, n, n))
    slope, rhs = rng.normal(size=(b, a)), rng.normal(size=b)
    defect = rng.normal(size=(intervals, n))
    factors = factorise(*map(jnp.asarray, (left, right, slope)))
    d = np.asarray(solve_sweeps(factors, jnp.asarray(defect), jnp.asarray(rhs)))
    met = np.einsum("kij,kj->ki", left, d[:-1]) + np.einsum("kij,kj->ki", right, d[1:]) + defect
    np.testing.assert_allclose(met, 0.0, atol=1e-10 * np.abs(d).max())
    np.testing.assert_allclose(d[-1, a:], slope @ d[-1, :a] + rhs, atol=1e-10 * np.abs(d).max())
    np.testing.assert_array_equal(d[0, :a], 0.0)


@pytest.fixture(scope="module")
def accuracies():
    """Of corrections by the sweeps and by LAPACK, for a scene and a step in time.

    At several places, (PLACES,): rounding at a single one is a matter of luck for both.
    """
    robot = as_arrays(sr.hybrid_robot(gravity=jnp.array([-9.81, 0.0, 0.0])))

    @jax.jit
    def measure(young_modulus, dt):
        scene = dataclasses.replace(robot, young_modulus=young_modulus)
        grid = METHOD.grid(scene)
        inputs = Inputs(jnp.array([0.1, 0.0, 0.2]), jnp.array([1e4]))
        rod = make_rod(scene, inputs, grid=grid, spread_fronts=True)
        layout = layout_of(rod, dynamic=True)
        guess = unloaded_guess(layout, rod)
        history = History(1.5 / dt, -1.5 / dt * guess.strain, jnp.zeros_like(guess.strain))
        equations = Equations(METHOD, layout, rod, history, guess.strain)
        start = equations.start(guess)
        at = lambda key: errors(equations, layout, start, key)
        return jax.lax.map(at, jax.random.split(jax.random.key(0), PLACES))

    def errors(equations, layout, start, key):
        U, scale = start.along, equations.scale(start).along
        U = U + 1e-2 * scale * jax.random.normal(key, U.shape)
        U = U.at[0, : layout.base_size].set(equations.base())
        F = equations.residual(Unknowns(U))
        step = equations.correct(equations.factorise(Unknowns(U)), F).along

        flat = lambda U: ravel_pytree(equations.residual(Unknowns(U)))[0]
        J = jax.jacfwd(flat)(U).reshape(flat(U).size, -1)[:, layout.base_size :]
        dense = -jnp.linalg.solve(J, flat(U))
        # Both judged by the equations themselves, each in its own size.
        size = jnp.abs(J) @ jnp.abs(dense) + jnp.abs(flat(U))
        error = lambda x: jnp.max(jnp.abs(J @ x + flat(U)) / size)
        return error(step.ravel()[layout.base_size :]), error(dense)

    return measure


@pytest.mark.parametrize("young_modulus", [3e4, 1e5, 1e7, 2e11])
@pytest.mark.parametrize("dt", [1e-5, 1e-3, 5e-2])
def test_as_good_as_a_dense_solver_with_pivoting(accuracies, young_modulus, dt):
    by_sweeps, by_lapack = accuracies(young_modulus, dt)
    assert np.max(by_sweeps) < 3 * np.max(by_lapack)
    assert np.median(by_sweeps / by_lapack) < 1
