"""Small linear complementarity problems, against a search through all choices."""

import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from softrod_jax.bvp.complementarity import conditions


@jax.jit
def solved(S, q, tight):
    return conditions(S, tight).multipliers(q)


def by_trial(S, q):
    """All x >= 0 with S x + q >= 0 of which one is zero for each condition."""
    m, found = len(q), []
    for choice in itertools.product([False, True], repeat=m):
        on = np.flatnonzero(choice)
        x = np.zeros(m)
        if len(on):
            x[on] = np.linalg.solve(S[np.ix_(on, on)], -q[on])
        if np.all(x >= -1e-12) and np.all(S @ x + q >= -1e-12):
            found.append(x)
    return found


@pytest.mark.parametrize("m", [1, 2, 3, 6])
def test_random_problems_have_the_one_answer(m):
    rng = np.random.default_rng(m)
    for _ in range(40):
        B = rng.normal(size=(m, m))
        S, q = B @ B.T + 0.05 * np.eye(m), rng.normal(size=m)
        (known,) = by_trial(S, q)
        for tight in (np.zeros(m, bool), rng.random(m) < 0.5, known > 0):
            x = solved(S, q, jnp.array(tight))
            np.testing.assert_allclose(x, known, atol=1e-7 * max(1.0, np.abs(known).max()))
            assert np.all(np.asarray(x)[known == 0] == 0)


def test_units_do_not_matter():
    """Gaps in metres beside gaps in radians: conditions of different kinds on one rod."""
    rng = np.random.default_rng(7)
    unit = np.array([1e-5, 1.0, 1e4])
    for _ in range(20):
        B = rng.normal(size=(3, 3))
        S, q = B @ B.T + 0.05 * np.eye(3), rng.normal(size=3)
        (known,) = by_trial(S, q)
        x = solved(unit[:, None] * S * unit, unit * q, jnp.zeros(3, bool)) * unit
        np.testing.assert_allclose(x, known, atol=1e-7 * max(1.0, np.abs(known).max()))
    against = unit[:2, None] * np.array([[1.0, -1.0], [-1.0, 1.0]]) * unit[:2]
    assert np.all(np.isnan(solved(against, -unit[:2], jnp.zeros(2, bool))))


def test_conditions_that_are_the_same_share():
    """Four tendons in one section: three directions, and one tension too many."""
    B = np.array([[1.0, 0, 1], [0, 1, 1], [-1, 0, 1], [0, -1, 1]])
    x = solved(B @ B.T, -np.ones(4), jnp.ones(4, bool))
    np.testing.assert_allclose(x, 0.25, rtol=1e-6)


def test_a_contradiction_is_no_number():
    """Two that pull against each other, and both want to be shorter."""
    S = np.array([[1.0, -1.0], [-1.0, 1.0]])
    assert np.all(np.isnan(solved(S, np.array([-1.0, -1.0]), jnp.zeros(2, bool))))
    assert np.all(np.isfinite(solved(S, np.array([-1.0, 1.0]), jnp.zeros(2, bool))))


def test_what_is_no_number_stays_none():
    for tight in (jnp.zeros(2, bool), jnp.ones(2, bool)):
        assert np.any(np.isnan(solved(np.eye(2), np.array([np.nan, 1.0]), tight)))
