"""Conditions on the whole rod that exist only here: a stop, and a cord that may not be longer."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from plain_rod import E, L, R, rod

import softrod_jax as sr

EI = E * np.pi * R**4 / 4
METHOD = sr.Collocation(6)
MOMENT = 1.2 * EI / L


class Stop(sr.AbstractCondition):
    """The rod bends about x by no more than `limit` [rad] in all."""

    limit: jax.Array

    def density(self, v, u, s):
        return u[0]


class Cord(sr.AbstractCondition):
    """A cord along the rod at `place` [m], (2,), of length `limit` [m], which does not stretch."""

    limit: jax.Array
    place: jax.Array

    def density(self, v, u, s):
        return jnp.linalg.norm(v + jnp.cross(u, jnp.append(self.place, 0.0)))


def stopped(limit, modulus=E, **changes):
    load = sr.TipLoad(moment=[MOMENT, 0.0, 0.0])
    return rod(conditions=[Stop(limit)], tip_load=load, young_modulus=modulus, **changes)


def bend(solution):
    """About x, of the tip."""
    h = solution.tip_quaternion
    return 2 * jnp.arctan2(h[1], h[0])


def bend_and_force(limit, modulus):
    solution = sr.solve_static(stopped(limit, modulus), method=METHOD, throw=False)
    return jnp.concatenate([bend(solution)[None], solution.held / MOMENT])


def test_a_stop_has_its_closed_form_in_a_batch_and_its_derivatives():
    """What the moment would bend beyond it, the stop holds; one beyond that holds nothing."""
    limits = jnp.array([0.4, 0.9, 2.0])
    moduli = jnp.array([E, 0.8 * E, E])
    free = 1.2 * E / np.asarray(moduli)
    known = np.minimum(limits, free)
    both = jax.jit(
        jax.vmap(lambda *x: (bend_and_force(*x), jax.jacfwd(bend_and_force, (0, 1))(*x)))
    )
    found, slopes = both(limits, moduli)
    np.testing.assert_allclose(found[:, 0], known, rtol=1e-9)
    np.testing.assert_allclose(found[:, 1], 1 - known / free, rtol=0, atol=1e-9)
    holds = np.array([1.0, 1.0, 0.0])
    by_limit = np.stack([holds, -holds / free], 1)
    by_modulus = np.stack([(holds - 1) * free / moduli, -holds * known / free / moduli], 1)
    np.testing.assert_allclose(slopes[0], by_limit, rtol=0, atol=1e-7)
    np.testing.assert_allclose(slopes[1] * E, by_modulus * E, rtol=0, atol=1e-7)
    reverse = jax.jit(jax.jacrev(bend_and_force, (0, 1)))(limits[0], moduli[0])
    for a, b in zip(reverse, slopes, strict=True):
        np.testing.assert_allclose(a, b[0], rtol=1e-9, atol=1e-14)


def test_a_stop_holds_a_rod_in_motion():
    """It swings up to the stop and comes to rest there, never beyond it."""
    scene = stopped(0.6, bending_damping=5e-6)

    def last(limit):
        held = dataclasses.replace(scene, conditions=(Stop(limit),))
        motion = sr.simulate(held, 0.05, steps=60, method=METHOD, max_time_error=1.0, throw=False)
        angles = 2 * jnp.arctan2(motion.quaternions[:, -1, 1], motion.quaternions[:, -1, 0])
        return angles[-1], (angles, motion.held, motion.result)

    (_, (angles, held, result)), slope = jax.jit(jax.value_and_grad(last, has_aux=True))(0.6)
    assert result == 0
    assert np.max(angles) < 0.6 + 1e-8
    assert held[0, 0] == 0 and held[1, 0] == 0 and np.all(held >= 0)
    np.testing.assert_allclose(angles[-1], 0.6, rtol=1e-6)
    np.testing.assert_allclose(held[-1], MOMENT - EI * 0.6 / L, rtol=1e-3)
    np.testing.assert_allclose(slope, 1.0, rtol=1e-6)


def corded(**changes):
    cord = Cord(L - 5e-3, jnp.array([0.0, 4e-3]))
    return rod(conditions=[cord], **changes)


def pulled(**changes):
    return rod(tendons=sr.Tendons([[0.0, 4e-3]], control="length"), **changes)


@pytest.mark.parametrize("plane", [None, "yz"])
def test_a_cord_is_a_tendon_written_again(plane):
    changes = dict(gravity=[0.0, 3.0, 2.0], plane=plane)
    scene = corded(**changes)
    one = sr.solve_static(scene, method=METHOD)
    other = sr.solve_static(pulled(**changes), pulls=[5e-3], method=METHOD)
    np.testing.assert_allclose(one.tip_position, other.tip_position, atol=1e-11)
    np.testing.assert_allclose(one.held, other.tensions, rtol=1e-8)
    assert one.held > 0 and one.stats["stable"]
    if plane is None:
        return
    heavy = dict(gravity=[0.0, -9.81, 2.0], plane=plane)
    options = dict(method=METHOD, max_time_error=1.0)
    one = sr.simulate(corded(**heavy), 5e-3, steps=6, initial=one, **options)
    rows = np.full((6, 1), 5e-3)
    other = sr.simulate(pulled(**heavy), 5e-3, pulls=rows, initial=other, **options)
    np.testing.assert_allclose(one.tip_positions, other.tip_positions, atol=1e-7)
    np.testing.assert_allclose(one.held, other.tensions, rtol=0, atol=1e-4)


def test_conditions_hold_beside_tendons_of_given_length():
    """A stop on a rod that its tendon would bend further: its moment and the tendon's balance."""
    opposite = sr.Tendons([[0.0, -4e-3]], control="length")
    scene = rod(tendons=opposite, conditions=[Stop(0.5)])
    solution = sr.solve_static(scene, pulls=[4e-3], method=METHOD)
    np.testing.assert_allclose(bend(solution), 0.5, rtol=1e-9)
    tension = float(solution.tensions[0])
    np.testing.assert_allclose(4e-3 * tension, EI * 0.5 / L + solution.held, rtol=1e-9)
    # The path is shorter by the bend and by the shortening.
    shortening = tension * L / (E * np.pi * R**2)
    np.testing.assert_allclose(0.5 * 4e-3 + shortening, 4e-3, rtol=1e-9)
