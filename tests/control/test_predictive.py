"""Predictive control: its quadratic problem, its observer, and loops with offsets and limits."""

import dataclasses
import sys
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.linalg
import scipy.optimize

import softrod_jax as sr
from softrod_jax.analysis.least_effort import bounded_minimum

sys.path.insert(0, str(Path(__file__).parents[2] / "benchmarks"))

import control as benchmark  # noqa: E402

METHOD = sr.Collocation(6)
DT, LIMITS = 0.01, {"tensions": (0.0, 0.2), "pressures": (-1e4, 1e4)}
PLACE = ("tip_x_m", "tip_z_m")


@pytest.fixture(scope="module")
def models():
    """In a plane, with a tendon on one side and a chamber on the other: at two equilibria."""
    robot = sr.Scene(
        length=0.1, section=sr.Circle(0.005), young_modulus=1e5, poisson_ratio=0.45, density=1e3,
        damping_time=0.01, gravity=jnp.array([3.0, 0.0, 0.0]), plane="xz", inextensible=True,
        tendons=sr.Tendons(jnp.array([[3e-3, 0.0]])),
        chambers=sr.Chambers(jnp.array([4e-6]), jnp.array([[-2.5e-3, 0.0]])),
        markers=[sr.Marker("half", 0.05, jnp.array([0.0, 0.0, 1e-3]))],
    )  # fmt: skip
    outputs = ("tip", "half", "strains", "base_wrench", "tensions")
    inputs = ("pressures", "tensions")
    how = dict(inputs=inputs, outputs=outputs, method=METHOD)
    whole = [sr.linearise(robot, (x,), **how) for x in (0.05, 0.1)]
    # What is not controlled does not matter to which states are kept.
    rows = [whole[0].outputs.index(name) for name in PLACE]
    few = lambda m: dataclasses.replace(
        m, C=m.C[jnp.array(rows)], D=m.D[jnp.array(rows)], y0=m.y0[jnp.array(rows)], outputs=PLACE
    )
    return [few(m).reduced(6) for m in whole]


def test_values_at_the_equilibrium(models):
    for model, tension in zip(models, (0.05, 0.1)):
        np.testing.assert_allclose(model.u0, [0.0, tension])
        tip = model.equilibrium.tip_position
        np.testing.assert_allclose(model.y0, [tip[0], tip[2]], atol=1e-14)


@pytest.mark.parametrize("seed", range(3))
def test_minimum_within_bounds(seed):
    rng = np.random.default_rng(seed)
    J, r = rng.standard_normal((15, 8)), rng.standard_normal(15)
    low, high = -0.1 * rng.random(8), 0.1 * rng.random(8)
    found = bounded_minimum(*map(jnp.array, (J.T @ J, J.T @ r, low, high)))
    known = scipy.optimize.lsq_linear(J, -r, (low, high), method="bvls", tol=1e-14)
    np.testing.assert_allclose(found, known.x, atol=1e-10)
    assert 0 < np.sum((known.x <= low) | (known.x >= high)) < 8


def test_far_from_limits_the_plan_is_that_of_least_squares(models):
    """From the model's own matrices, step by step, and numpy."""
    model = models[0]
    wide = {"tensions": (0.0, 1e3), "pressures": (-1e9, 1e9)}
    controller = sr.Predictive(model, DT, wide, effort=1e-2, horizon=0.15, corners=3, delay=0)
    F, G = model.discrete(DT)
    rng = np.random.default_rng(0)
    before, y = np.array([10.0, 0.06]), np.asarray(model.y0) + 1e-3 * rng.standard_normal(2)
    reference = model.y0 + 2e-3 * rng.standard_normal((15, 2))
    times = np.asarray(controller.times)
    np.testing.assert_allclose(times, DT * np.arange(1, 16))
    control = controller.begin(before, y)
    u, after = controller.step(control, y, reference)
    at, width = 1 + 14 * (np.arange(3) / 2) ** 2, np.array([2e9, 1e3])
    own = before - model.u0
    still = np.linalg.solve(np.eye(6) - F, G @ own)
    disturbance = y - model.y0 - model.C @ still - model.D @ own

    def residuals(z):
        """Of the outputs and of the changes of the plan, the roots of what they cost."""
        corners = z.reshape(3, 2) * width
        inputs = np.stack([np.interp(np.arange(1, 16), at, c) for c in corners.T], 1) - model.u0
        x, last, rows = still, own, []
        for k in range(15):
            x = F @ x + G @ (0.5 * (last + inputs[k]))
            last = inputs[k]
            rows.append(model.y0 + model.C @ x + model.D @ last + disturbance - reference[k])
        changes = np.diff(np.concatenate([before[None] / width, z.reshape(3, 2)]), axis=0)
        effort = z - np.tile([0.5, 0.0], 3)  # of zero pressure, in terms of ranges: at the middle
        effort = z
        return np.concatenate([np.ravel(rows) / np.sqrt(15), 1e-2 * changes.ravel(), 1e-3 * effort])

    J = np.stack([residuals(e) - residuals(np.zeros(6)) for e in np.eye(6)], 1)
    z = np.linalg.lstsq(J, -residuals(np.zeros(6)), rcond=None)[0]
    assert np.all(z.reshape(3, 2)[:, 1] > 0)  # no tension is at its limit
    np.testing.assert_allclose(after.plan, z.reshape(3, 2) * width, rtol=1e-6)
    np.testing.assert_allclose(u, after.plan[0])


def closed(controller, model, steps, reference, disturbance):
    """The model itself in a loop, with a cycle of delay and something else at its outputs."""
    F, G = model.discrete(DT)
    x, u = np.zeros(len(F)), np.asarray(model.u0)
    control = controller.begin(u, model.y0)
    late, outputs, inputs = u, [], []
    ahead = np.tile(reference, (controller.times.size, 1))
    for _ in range(steps):
        y = np.asarray(model.y0 + model.C @ x + model.D @ (u - model.u0)) + disturbance
        decided, control = controller.step(control, y, ahead)
        x = F @ x + G @ (0.5 * (u + late) - model.u0)
        u, late = late, np.asarray(decided)
        outputs.append(y)
        inputs.append(u)
    return np.array(outputs), np.array(inputs)


def test_no_offset_with_one_model_or_two_and_limits_hold(models):
    """Two outputs cannot be had with one that hardly moves: x alone is controlled."""
    model = models[0]
    reference = np.asarray(model.y0[:1]) + 4e-3
    for given in (model, models):
        controller = sr.Predictive(given, DT, LIMITS, outputs=("tip_x_m",), effort=1e-3)
        own = dataclasses.replace(
            model, C=model.C[:1], D=model.D[:1], y0=model.y0[:1], outputs=PLACE[:1]
        )
        y, u = closed(controller, own, 300, reference, 1e-3)
        np.testing.assert_allclose(y[-1], reference, atol=2e-6)
        assert np.abs(y[0] - reference) > 2e-3
        assert np.all(u >= [-1e4, 0.0]) and np.all(u <= [1e4, 0.2])
    far = np.asarray(model.y0[:1]) + 1.0
    y, u = closed(controller, own, 60, far, 0.0)
    np.testing.assert_allclose(np.abs(u[-1]), [1e4, 0.2])


def test_observer_is_kalmans(models):
    """Its gain follows from Riccati's equation of the model with a disturbance."""
    model = models[0]
    controller = sr.Predictive(model, DT, LIMITS, noise=1e-3, drift=2e-2)
    local = jax.tree.map(lambda x: np.asarray(x[0]), controller.models)
    closed_loop = local.F @ (np.eye(len(local.F)) - local.gain @ local.C)
    assert np.abs(np.linalg.eigvals(closed_loop)).max() < 1
    P = local.gain @ np.diag([1e-6, 1e-6]) @ np.linalg.inv(np.eye(2) - local.C @ local.gain)
    # L = P C^T (C P C^T + R)^-1, so C L (1 - C L)^-1 R = C P C^T, which is symmetric.
    seen = local.C @ P
    np.testing.assert_allclose(seen, seen.T, atol=1e-9 * np.abs(seen).max())


def test_bad_input(models, wrong_types):
    model = models[0]
    bad = [
        (([], DT, LIMITS), {}, "no models"),
        ((model, 0.0, LIMITS), {}, "dt=0.0; a positive number"),
        ((model, DT, {"tensions": (0, 1)}), {}, "limits of"),
        ((model, DT, {**LIMITS, "tensions": (1.0, 0.0)}), {}, "lowest < highest"),
        ((model, DT, {**LIMITS, "tensions": 1.0}), {}, "a lowest and a highest"),
        ((model, DT, LIMITS), dict(outputs=("tip_y_m",)), "'tip_y_m' is not one"),
        ((model, DT, LIMITS), dict(horizon=0.05), "5 times dt"),
        (([model, model.reduced(4)], DT, LIMITS), {}, "give them the same"),
        ((dataclasses.replace(model, descriptor=True), DT, LIMITS), {}, "singular E"),
    ]
    for args, others, message in bad:
        with pytest.raises(ValueError, match=message):
            sr.Predictive(*args, **others)
    controller = sr.Predictive(model, DT, LIMITS)
    with pytest.raises(ValueError, match="expected are"):
        controller.begin(np.zeros(3), np.zeros(2))
    control = controller.begin(model.u0, model.y0)
    with pytest.raises(ValueError, match=r"reference \(2,\)"):
        controller.step(control, np.zeros(2), np.zeros(2))


def test_what_it_is_compared_with(capsys):
    """PI asks for no tension more than it needs, and for none beyond the limit; errors in parts."""
    decide = benchmark.proportional_integral(1.0, 1.0, True)(0.02)
    tensions = [decide(k, np.zeros(2)) for k in range(50)]
    assert np.min(tensions) == 0.0 and 0.1 < np.max(tensions) <= benchmark.LIMIT
    assert np.all(np.min(tensions, 1) == 0.0)
    np.testing.assert_allclose(benchmark.eight([0.0, 0.5]), [[0, 0], [0.02, 0]], atol=1e-12)
    assert benchmark.percent(np.array([1e-3, 1e-3])) == "1.00 % rms, 1.00 % at most"
    benchmark.minimum(quick=True)
    assert "active sets" in capsys.readouterr().out
