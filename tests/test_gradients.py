"""Forward = reverse = central differences, for what users differentiate."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import softrod_jax as sr

SCENE = sr.hybrid_robot(gravity=jnp.array([-9.81, 0.0, 0.0]))
# Inputs: E, B_bt, C, tension, pressure; each at a typical size.
SIZES = jnp.array([5e4, 1e-6, 0.03, 0.1, 1e4])


def scene_of(x):
    names = ("young_modulus", "bending_damping", "drag_coefficient")
    return eqx.tree_at(lambda s: [getattr(s, n) for n in names], SCENE, list(x[:3]))


def static_tip(z):
    x = SIZES * z
    tension = x[3] * jnp.array([1.0, 0.5, 0.0])
    return sr.solve_static(scene_of(x), tension, x[4:5], throw=False).tip_position


def moving_tip(z, scheme=sr.BDFAlpha(), steps=40):
    x = SIZES * z
    tensions = jnp.tile(x[3] * jnp.array([1.0, 0.5, 0.0]), (steps, 1))
    pressures = jnp.full((steps, 1), 1.0) * x[4]
    motion = sr.simulate(scene_of(x), 0.01, tensions, pressures, scheme=scheme, throw=False)
    return motion.tip_positions[-1]


def at_rest_tip(z):
    """No load at all: straight, q = 0 throughout."""
    return sr.simulate(
        eqx.tree_at(lambda s: s.gravity, scene_of(SIZES * z), jnp.zeros(3)),
        0.01,
        jnp.zeros((5, 3)) * z[3],
        throw=False,
    ).tip_positions[-1]


CASES = {
    "static": (static_tip, [0, 3, 4]),
    "bdf_40_steps": (moving_tip, [0, 1, 2, 3, 4]),
}


@pytest.mark.parametrize("name", CASES)
def test_forward_reverse_and_differences_agree(name):
    f, inputs = CASES[name]
    f = jax.jit(f)
    one = jnp.ones(5)
    forward = jax.jit(jax.jacfwd(f))(one)
    reverse = jax.jit(jax.jacrev(f))(one)
    size = np.abs(forward).max()
    np.testing.assert_allclose(forward, reverse, atol=1e-9 * size)
    for i in inputs:
        # Fourth-order central differences: truncation and rounding both stay below 1e-6.
        d = 1e-3
        e = jnp.zeros(5).at[i].set(d)
        slope = (8 * (f(one + e) - f(one - e)) - (f(one + 2 * e) - f(one - 2 * e))) / (12 * d)
        np.testing.assert_allclose(forward[:, i], slope, atol=1e-6 * np.abs(forward[:, i]).max())


def test_finite_at_rest_and_straight():
    forward = jax.jacfwd(at_rest_tip)(jnp.ones(5))
    reverse = jax.jacrev(at_rest_tip)(jnp.ones(5))
    assert np.all(np.isfinite(forward)) and np.all(np.isfinite(reverse))
    np.testing.assert_allclose(forward, reverse, atol=1e-12)


def test_reverse_mode_reaches_every_number_of_the_scene():
    scene = eqx.tree_at(
        lambda s: (s.payload, s.tip_load, s.shear_damping),
        SCENE,
        (sr.Payload(0.002), sr.TipLoad(jnp.array([0.0, 0.001, 0.0])), jnp.array(1e-3)),
        is_leaf=lambda x: x is None,
    )
    tensions, pressures = jnp.full((10, 3), 0.02), jnp.full((10, 1), 1e4)

    @eqx.filter_jit
    @eqx.filter_grad
    def slope(scene):
        motion = sr.simulate(scene, 0.01, tensions, pressures, throw=False)
        return jnp.sum(motion.tip_positions[-1])

    leaves = jax.tree.leaves(slope(scene))
    assert len(leaves) == len(jax.tree.leaves(scene))
    assert all(np.all(np.isfinite(x)) for x in leaves)
    assert sum(bool(np.any(x != 0)) for x in leaves) >= len(leaves) - 1


def test_second_derivative_of_a_static_tip():
    f = lambda tau: sr.solve_static(
        sr.hybrid_robot(), jnp.stack([tau, 0.1, 0.0]), throw=False
    ).tip_position[0]
    second = jax.grad(jax.grad(f))(0.2)
    d = 1e-4
    slope = (jax.grad(f)(0.2 + d) - jax.grad(f)(0.2 - d)) / (2 * d)
    np.testing.assert_allclose(second, slope, rtol=1e-5)
