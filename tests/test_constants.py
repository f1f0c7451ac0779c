"""Constants inside of traced programs: a scene that is known, and a program that is not run yet."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import softrod_jax as sr
from softrod_jax.learning import RodLayer, Stepper
from softrod_jax.learning.stepping import Action

METHOD = sr.Collocation(6)
TENSION = np.array([0.1, 0.0, 0.0])
DT, STEPS = 5e-3, 3


@pytest.fixture(scope="module")
def scene():
    return sr.hybrid_robot(gravity=[0.0, 0.0, 9.81])


def under_jit(function):
    return jax.jit(lambda x: function() * x)(1.0)


def under_vmap(function):
    return jax.vmap(lambda x: function() * x)(jnp.ones(2))[1]


def under_scan(function):
    return jax.lax.scan(lambda c, x: (c, function() * x), 0.0, jnp.ones(2))[1][1]


def under_grad(function):
    return jax.jacfwd(lambda x: function() * x)(1.0)


def in_a_branch(function):
    return jax.lax.cond(True, function, lambda: jnp.zeros(3))


TRACED = [under_jit, under_vmap, under_scan, under_grad, in_a_branch]


@pytest.mark.parametrize("traced", TRACED)
def test_equilibrium(scene, traced):
    outside = sr.solve_static(scene, TENSION, method=METHOD).tip_position
    for throw in (True, False):
        inside = traced(
            lambda throw=throw: (
                sr.solve_static(scene, TENSION, method=METHOD, throw=throw).tip_position
            )
        )
        np.testing.assert_allclose(inside, outside, rtol=1e-12)


@pytest.mark.parametrize("traced", [under_jit, under_scan])
def test_motion_from_an_equilibrium(scene, traced):
    def tip():
        initial = sr.solve_static(scene, TENSION, method=METHOD)
        rows = np.zeros((STEPS, 3))
        return sr.simulate(scene, DT, rows, initial=initial, method=METHOD).tip_positions[-1]

    np.testing.assert_allclose(traced(tip), tip(), rtol=1e-9)


def test_what_needs_numbers_says_so(scene):
    with pytest.raises(ValueError, match="tolerance"):
        under_jit(lambda: sr.solve_static(scene, TENSION, tolerance=1e-4).tip_position)
    with pytest.raises(ValueError, match="tolerance"):
        under_jit(lambda: sr.simulate(scene, DT, steps=2, tolerance=1e-4).tip_positions[-1])


def test_bad_constants_are_refused_at_once(scene):
    with pytest.raises(ValueError, match="only pull"):
        under_jit(lambda: sr.solve_static(scene, -TENSION).tip_position)
    with pytest.raises(ValueError, match="not finite"):
        under_jit(lambda: sr.solve_static(scene, [np.nan, 0.0, 0.0]).tip_position)
    with pytest.raises(ValueError, match="dt"):
        under_jit(lambda: sr.simulate(scene, -DT, steps=2).tip_positions[-1])


def test_stepper_and_layer(scene):
    def tip():
        stepper = Stepper(scene, DT, method=METHOD)
        initial = sr.solve_static(scene, TENSION, (0.0,), method=METHOD)
        action = Action(TENSION, np.zeros(1))
        state = stepper.reset(initial, action)
        return stepper.view(stepper.step(state, action)).tip_position

    np.testing.assert_allclose(under_jit(tip), tip(), rtol=1e-9)

    def path():
        layer = RodLayer(scene, DT, positive=["young_modulus"], method=METHOD)
        return layer(np.zeros((STEPS, 3))).tip_positions[-1]

    np.testing.assert_allclose(under_jit(path), path(), rtol=1e-9)


def test_scene_files(scene, tmp_path):
    sr.save_scene(scene, tmp_path / "robot.toml")
    loaded = under_jit(lambda: sr.load_scene(tmp_path / "robot.toml").gravity)
    np.testing.assert_array_equal(loaded, scene.gravity)
    save = lambda: sr.save_scene(scene, tmp_path / "again.toml") or jnp.zeros(())
    under_jit(save)
    assert (tmp_path / "again.toml").read_text() == (tmp_path / "robot.toml").read_text()
    with pytest.raises(sr.SceneError, match="traced"):
        jax.jit(lambda scene: sr.save_scene(scene, tmp_path / "no.toml"))(scene)


def test_batches(scene):
    pulls = np.outer([0.1, 0.2], [1.0, 0.0, 0.0])
    tip = lambda pull: sr.solve_static(scene, pull, method=METHOD).tip_position
    inside = under_jit(lambda: sr.spread(tip)(pulls))
    np.testing.assert_allclose(inside, sr.spread(tip)(pulls), rtol=1e-12)
