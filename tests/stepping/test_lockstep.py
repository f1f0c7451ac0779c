"""Batches as a GPU has them, in lockstep with shared factors in float32, against one by one."""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import softrod_jax as sr
from softrod_jax.foundation.compiling import in_lockstep

DT, STEPS = 20e-3, 4
SCENE = sr.hybrid_robot(gravity=jnp.array([-9.81, 0.0, 0.0]))
METHOD = sr.Collocation(4)
OK, BAD = int(sr.RESULTS.successful), int(sr.RESULTS.bad_input)


def tensions():
    """(rods, STEPS, 3): two ordinary rods, no number, what no rod withstands, a jump and back."""
    most = 0.3 * np.random.default_rng(0).uniform(size=(5, 1, 3))
    given = most * np.minimum(1.0, np.arange(STEPS) / 3)[:, None]
    given[2, 2, 1] = np.nan
    given[3, 2:] = 1e6
    given[4, 1] = [0.9, 0.0, 0.0]
    given[4, 2:] = 0.0
    return jnp.array(given)


def motion(young, tensions, scheme):
    scene = dataclasses.replace(SCENE, young_modulus=young)
    moved = sr.simulate(
        scene, DT, tensions, scheme=scheme, method=METHOD, max_time_error=jnp.inf, throw=False
    )
    return moved.tip_positions, moved.result, moved.failed_step, moved.stats["iterations"]


def loss(young, tensions, scheme):
    tips, *_ = motion(young, tensions, scheme)
    return jnp.sum(tips[-1] ** 2)


def in_both_ways(function):
    """Of the batch in lockstep, and of one rod after the other."""
    batch = jnp.full(len(tensions()), SCENE.young_modulus), tensions()
    with in_lockstep():
        together = jax.jit(jax.vmap(function))(*batch)
    apart = jax.jit(functools.partial(jax.lax.map, lambda x: function(*x)))(batch)
    return jax.tree.map(np.asarray, (together, apart))


@pytest.mark.long
@pytest.mark.parametrize("scheme", [sr.SDIRK(3), sr.BDFAlpha(-0.3)], ids=["stages", "one"])
def test_motions_and_codes_are_those_of_one_after_the_other(scheme):
    together, apart = in_both_ways(functools.partial(motion, scheme=scheme))
    tips, codes, failed, iterations = together
    np.testing.assert_array_equal(codes, apart[1])
    np.testing.assert_array_equal(failed, apart[2])
    assert list(codes[[0, 1, 2, 4]]) == [OK, OK, BAD, OK] and codes[3] not in (OK, BAD)
    np.testing.assert_allclose(tips, apart[0], atol=1e-9 * float(SCENE.length))
    assert np.all(np.isfinite(tips)) and np.all(iterations > 0)


@pytest.mark.parametrize(
    "derivative",
    [pytest.param(jax.grad, marks=pytest.mark.long), jax.jacfwd],
    ids=["reverse", "forward"],
)
def test_gradients_are_those_of_one_after_the_other(derivative):
    slope = derivative(functools.partial(loss, scheme=sr.SDIRK(3)))
    together, apart = in_both_ways(slope)
    np.testing.assert_allclose(together, apart, rtol=1e-7, atol=1e-18)
    assert np.all(together[[2, 3]] == 0.0) and np.all(together[[0, 1, 4]] != 0.0)
