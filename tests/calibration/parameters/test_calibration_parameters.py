"""Every parameter: its value, its place, and its effect against finite differences."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest
from beams import SETTINGS

import softrod_jax as sr
from calibration import Recording
from calibration.experiment.setup import Setup
from calibration.parameters.catalogue import catalogue, choose, prepared, with_values
from calibration.parameters.scales import Between, Factor, Shift
from calibration.parameters.unknowns import choose_unknowns
from calibration.problem.dataset import datasets
from calibration.problem.evaluation import predict, reverse_pays
from calibration.problem.problem import make_problem
from softrod_jax.rod.rotations import to_base
from softrod_jax.scene.inputs import Inputs
from softrod_jax.scene.scene import as_arrays

CLAMP = np.array([0.9, 0.1, 0.3, -0.2]) / np.linalg.norm([0.9, 0.1, 0.3, -0.2])


def robot():
    scene = sr.hybrid_robot(gravity=jnp.array([-9.81, 0.5, 0.0]))
    return as_arrays(
        replace(
            scene,
            young_modulus=2e5,
            tendons=replace(scene.tendons, friction=(0.1, None, None)),
            shear_damping=1e-3,
            damping_time=1e-4,
            relaxation=((0.2, 0.05), (0.1, 0.5)),
            shear_correction=0.9,
            payload=sr.Payload(2e-3),
            chambers=sr.Chambers(jnp.array([7e-6]), jnp.array([[1e-3, 0.0]])),
            base_quaternion=jnp.asarray(CLAMP),
        )
    )


def test_scales_go_there_and_back():
    for scale, initial, value in (
        (Factor(), 2.0, 3.0),
        (Between(-1.0, 0.5), 0.3, 0.45),
        (Shift(0.01), 0.2, -0.1),
    ):
        assert float(scale.value(initial, 0.0)) == pytest.approx(initial)
        assert float(scale.value(initial, scale.theta(initial, value))) == pytest.approx(value)
        step, moved = scale.limited(1e-3)
        assert step == pytest.approx(moved, rel=1e-3)
    with pytest.raises(ValueError, match="above 0"):
        Factor().theta(1.0, -1.0)
    with pytest.raises(ValueError, match="between"):
        Between(-1.0, 0.5).theta(0.3, 0.5)


def test_at_theta_zero_nothing_changes():
    scene = robot()
    known, _ = catalogue(scene)
    setup = prepared(scene, known)
    moved = with_values(setup, tuple(known), np.zeros(len(known)))
    for name, parameter in known.items():
        np.testing.assert_allclose(parameter.get(moved), parameter.get(setup), err_msg=name)


def test_groups_stand_for_their_members():
    assert choose(robot(), ["sensor_offset"]) == tuple(f"sensor_offset_{a}" for a in "xyz")
    # A turn about gravity changes nothing, and is not fitted.
    assert choose(robot(), "gravity_tilt") == ("gravity_tilt_y", "gravity_tilt_z")
    assert choose(robot(), "tendon_position")[:3] == (
        "tendon_position_1_x", "tendon_position_1_y", "tendon_position_2_x",
    )  # fmt: skip


def test_a_setup_turns_gravity_and_clamp():
    scene = robot()
    setup = Setup(
        scene,
        gravity_tilt=jnp.array([0.0, 0.0, np.pi / 2]),
        clamp_rotation=jnp.array([0.0, np.pi / 2, 0.0]),
        clamp_shift=jnp.array([0.1, 0.0, 0.0]),
    )
    turned = setup.simulated_scene()
    np.testing.assert_allclose(turned.gravity, [-0.5, -9.81, 0.0], atol=1e-7)
    axis = to_base(scene.base_quaternion, jnp.array([0.0, 0.0, 1.0]))
    expected = [axis[2], axis[1], -axis[0]]
    np.testing.assert_allclose(
        to_base(turned.base_quaternion, jnp.array([0.0, 0.0, 1.0])), expected, atol=1e-7
    )
    np.testing.assert_allclose(turned.base_position, [0.1, 0.0, 0.0])
    inputs = Inputs(jnp.ones((2, 3)), jnp.ones((2, 1)))
    assert setup.arriving(inputs) is inputs
    weak = Setup(scene, tendon_efficiency=jnp.array([0.5, 1.0, 1.0]))
    np.testing.assert_allclose(weak.arriving(inputs).tensions[1], [0.5, 1.0, 1.0])
    np.testing.assert_array_equal(weak.arriving(inputs).pressures, inputs.pressures)


def problem(scene, names, inputs):
    steps = 10
    times = np.arange(steps + 1) / 100
    tip = np.zeros((steps + 1, 3)) + np.asarray([0.0, 0.0, 0.1])
    ramp = np.linspace(0, 1, steps + 1)[:, None]
    recording = Recording(
        times,
        0.2 * ramp * [1.0, 0.3, 0.2] if inputs else None,
        2e4 * ramp if inputs else None,
        tip,
    )
    setup, parameters = choose_unknowns(scene, [recording], ["a"], names)
    data, _ = datasets(scene, recording, window=(0.0, 0.1))
    # As in fits, a grid that is coarse is no failure: derivatives are those of this grid.
    method = sr.Collocation(intervals=2, order=6, max_error=0.1)
    settings = {**SETTINGS, "method": method}
    return make_problem(setup, parameters, data, time_offset=False, dt=None, **settings)


@pytest.mark.parametrize("inputs", [pytest.param(True, marks=pytest.mark.long), False])
def test_sensitivities_are_finite_differences(inputs):
    scene = robot()
    if not inputs:
        scene = replace(scene, tendons=None, chambers=None)
    known, _ = catalogue(scene)
    # The same, all together.
    others = ("tendon_offset", "tendon_efficiency", "chamber_area", "tendon_friction")
    names = tuple(n for n in known if n not in others)
    assert ("release_duration" in names) == (not inputs)
    if not inputs:
        names = ("release_duration", "payload_mass")
    fit = problem(scene, names, inputs)
    x = fit.space.origin() + 0.01
    point = fit.at(x)
    assert point.ok
    J = point.jacobian
    for i, name in enumerate(names):
        step = 1e-4 * np.eye(len(x))[i]
        ends = [
            np.asarray(
                predict(
                    fit.setup,
                    fit.batch,
                    jnp.asarray(fit.space.parameters.theta(x + sign * step)),
                    fit.space.nuisance(fit.space.origin()),
                    names,
                    fit.scheme,
                    fit.method,
                )[0]
            ).ravel()
            for sign in (1, -1)
        ]
        difference = (ends[0] - ends[1]) / 2e-4
        scale = np.max(np.abs(difference))
        np.testing.assert_allclose(J[:, i], difference, atol=1e-3 * scale + 1e-10, err_msg=name)
        # Each of them does something.
        assert scale > 1e-9, name


def test_reverse_mode_pays_for_many_parameters_of_few_numbers():
    assert not reverse_pays(parameters=3, outputs=1)
    assert reverse_pays(parameters=30, outputs=1)
    assert not reverse_pays(parameters=30, outputs=300)
