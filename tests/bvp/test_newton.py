"""Newton's method: convergence, damping, and factors reused from another problem."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import softrod_jax as sr
from softrod_jax.bvp.newton import NewtonOptions, ReusedFactors, newton, newton_with


def equations(x):
    """Zero at (1, 2); far from linear."""
    a, b = x
    return jnp.stack([a**3 + a * b - 3, jnp.exp(b - 2) * a - 1])


def solve(y, reused=None, evaluate=equations, **options):
    return newton(
        evaluate,
        jax.jacfwd(evaluate),
        lambda J, F: -jnp.linalg.solve(J, F),
        jnp.array(y),
        1.0,
        NewtonOptions(**options),
        reused=reused,
    )


def factors_at(at, usable=True):
    return ReusedFactors(jax.jacfwd(equations)(jnp.array(at)), jnp.array(usable))


@pytest.mark.parametrize(
    "reused",
    [
        None,
        factors_at([1.0, 2.0]),
        factors_at([1.05, 1.9]),
        factors_at([2.0, -1.0]),  # of little use
        ReusedFactors(-factors_at([1.0, 2.0]).factors, jnp.array(True)),  # leads away
        ReusedFactors(jnp.zeros((2, 2)), jnp.array(True)),  # gives no numbers
        ReusedFactors(jnp.zeros((2, 2)), jnp.array(False)),  # says so itself
    ],
    ids=["none", "exact", "near", "far", "wrong", "singular", "not_usable"],
)
def test_reused_factors_change_the_way_and_not_the_answer(reused):
    end = solve([1.2, 1.7], reused)
    assert int(end.result) == sr.RESULTS.successful
    np.testing.assert_allclose(end.y, [1.0, 2.0], atol=1e-9)


def test_factors_that_serve_are_kept():
    end = solve([1.001, 1.999], factors_at([1.0, 2.0]))
    np.testing.assert_array_equal(end.factors, factors_at([1.0, 2.0]).factors)
    assert float(end.contraction) < 1e-2


def test_reused_factors_do_not_make_a_start_the_solution():
    """A huge Jacobian makes the first correction tiny wherever it is."""
    end = solve([1.2, 1.7], ReusedFactors(1e13 * jnp.eye(2), jnp.array(True)))
    assert int(end.result) != sr.RESULTS.successful or np.allclose(end.y, [1.0, 2.0], atol=1e-9)


@pytest.mark.parametrize("column", [[1.0, 1.0], [-1.0, -1.5], [0.0, 0.0], [np.nan, 0.0]])
def test_parts_that_do_not_serve_are_made_again(column):
    """Of new factors the second column is kept, which is anything."""

    def factorise(y, kept):
        J = jax.jacfwd(equations)(y)
        return J.at[:, 1].set(jnp.where(kept.alike, kept.factors[:, 1], J[:, 1]))

    given = ReusedFactors(jnp.array([[1.0, 1.0], column]).T, jnp.array(False), jnp.array(True))
    solution = lambda J, F: -jnp.linalg.solve(J, F)
    options = NewtonOptions()
    end = newton(
        equations,
        factorise,
        solution,
        jnp.array([1.2, 1.7]),
        1.0,
        options,
        reused=given,
        keeping=True,
    )
    assert int(end.result) == sr.RESULTS.successful
    np.testing.assert_allclose(end.y, [1.0, 2.0], atol=1e-9)


def test_a_batch_is_a_loop():
    starts = jnp.array([[1.2, 1.7], [0.9, 2.2], [3.0, 0.0]])
    batch = jax.vmap(lambda y: solve(y, factors_at([1.0, 2.0])))(starts)
    for k, y in enumerate(starts):
        one = solve(y, factors_at([1.0, 2.0]))
        assert int(batch.result[k]) == int(one.result)
        np.testing.assert_allclose(batch.y[k], one.y, atol=1e-12)


def test_no_solution_is_no_answer():
    end = solve([0.5], evaluate=lambda x: x**2 + 1)
    assert int(end.result) in (sr.RESULTS.diverged, sr.RESULTS.max_iterations)


def solve_with(factors, y, **options):
    correct = lambda J, F: -jnp.linalg.solve(J, F)
    return newton_with(factors, equations, correct, jnp.array(y), 1.0, NewtonOptions(**options))


@pytest.mark.parametrize("at", [[1.0, 2.0], [1.05, 1.9]])
@pytest.mark.parametrize("kind", ["float64", "float32"])
def test_given_factors_that_serve_find_the_solution(at, kind):
    """Those in float32 find it as exactly: the equations are in float64."""
    factors = factors_at(at).factors.astype(kind).astype(float)
    end = solve_with(factors, [1.1, 1.9])
    assert int(end.result) == sr.RESULTS.successful
    np.testing.assert_allclose(end.y, [1.0, 2.0], atol=1e-9)
    assert 0 < float(end.contraction) < 0.5 and float(end.correction) < 1e-8
    assert int(solve_with(factors, [1.1, 1.9], tolerance=1e-4).iterations) < int(end.iterations)


@pytest.mark.parametrize(
    "factors",
    [
        -factors_at([1.0, 2.0]).factors,  # lead away
        jnp.zeros((2, 2)),  # give no numbers
        1e4 * jnp.eye(2),  # make corrections small wherever they are
    ],
    ids=["wrong", "singular", "huge"],
)
def test_given_factors_that_do_not_serve_find_nothing(factors):
    end = solve_with(factors, [1.3, 1.6])
    assert int(end.result) == sr.RESULTS.diverged
    assert np.all(np.isfinite(end.y))


def test_a_start_that_is_the_solution_takes_two_evaluations_with_given_factors():
    end = solve_with(factors_at([1.05, 1.9]).factors, [1.0, 2.0])
    assert (int(end.result), int(end.iterations)) == (sr.RESULTS.successful, 2)
