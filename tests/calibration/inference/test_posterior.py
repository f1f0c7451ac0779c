"""Draws of posteriors: those of a known density, and of a fit that is not Gaussian."""

import json
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import softrod_jax as sr
from calibration.inference.posterior import Posterior, laplace_draws, nuts
from calibration.postures.data import Postures
from calibration.postures.fitting import calibrate_postures, prepared_model
from calibration.postures.posterior import log_density
from calibration.postures.report import posture_json, write_posture_report
from softrod_jax.scene.inputs import Inputs

GRID = sr.Collocation(intervals=2)


def test_draws_of_a_known_density():
    """A crescent: x is normal, and y about x^2."""
    pytest.importorskip("blackjax")
    density = lambda x: -0.5 * x[0] ** 2 - 0.5 * (x[1] - 0.5 * x[0] ** 2) ** 2
    chains = nuts(density, np.zeros(2), np.eye(2), 3000, 0)
    assert chains.theta.shape == (2, 1500, 2) and chains.divergent <= 3
    x, y = chains.theta.reshape(-1, 2).T
    assert chains.mixed < 1.05 and chains.effective > 100
    assert np.mean(x) == pytest.approx(0.0, abs=0.15)
    assert np.var(x) == pytest.approx(1.0, rel=0.2)
    # The mean of x^2 is 1, and its variance 2; y is skewed, as no Gaussian is.
    assert np.mean(y) == pytest.approx(0.5, abs=0.15)
    assert np.var(y) == pytest.approx(1.5, rel=0.2)
    assert np.mean((y - np.mean(y)) ** 3) > 0.3


def test_draws_of_the_gaussian_stay_inside_the_bounds():
    covariance = np.array([[0.04, 0.03], [0.03, 0.09]])
    inside = lambda x: np.clip(x, [-0.1, -9.0], [9.0, 9.0])
    x = laplace_draws(np.array([0.5, 1.0]), covariance, inside, 20000, 1)
    assert np.cov(x.T) == pytest.approx(covariance, rel=0.05)
    assert x[:, 0].min() >= -0.1
    drawn = Posterior("laplace", x, {"a": np.exp(x[:, 0])}, 20000.0, 1.0, 0)
    low, high = drawn.ci95["a"]
    np.testing.assert_allclose(np.log([low, high]), 0.5 + 0.2 * np.array([-1.96, 1.96]), atol=0.02)
    assert not drawn.remarks
    poor = replace(drawn, mixed=1.2, divergent=3)
    assert "have not settled" in poor.remarks[0] and "3 draws diverged" in poor.remarks[1]


def robot(E=4e5):
    return sr.Scene(
        length=0.1,
        section=sr.Circle(6e-3),
        young_modulus=jnp.array(E),
        poisson_ratio=0.45,
        density=1070.0,
        gravity=jnp.array([-9.81, 0.0, 0.0]),
        tendons=sr.Tendons(np.array([[5e-3, 0.0]])),
    )


PRIOR = {"young_modulus": (5e5, 4e5)}
NOISE = 4e-3


@pytest.fixture(scope="module")
def postures():
    """Few and bad: the rod sags about as much as it is seen to move by itself."""
    tensions = np.array([[0.0], [0.02], [0.04]])
    tips = [sr.solve_static(robot(), tensions=row, method=GRID).tip_position for row in tensions]
    noise = NOISE * np.random.default_rng(4).normal(size=(3, 3))
    return Postures(Inputs(tensions=tensions), {"tip": np.array(tips) + noise})


def fitted(postures, **options):
    given = {"fit": "young_modulus", "priors": PRIOR, "method": GRID, **options}
    return calibrate_postures(robot(), postures, **given)


def test_the_density_is_that_of_residuals_and_priors(postures):
    """Against residuals and forward derivatives as the fit has them, and by differences."""
    model = prepared_model(robot(), postures, "young_modulus", GRID)
    mean, spread = PRIOR["young_modulus"]
    believed = lambda theta: jnp.sum(((4e5 * jnp.exp(theta) - mean) / spread) ** 2)
    density = log_density(model, believed, 9, (np.array([-1.0]), np.array([1.0])))
    at = np.array([0.3])
    here = model.evaluate(at)
    squares = np.sum(here.residuals**2)
    vague = (2.0 / model.parameters[0].scale.largest * 0.3) ** 2
    expected = -0.5 * (9 * np.log(squares) + float(believed(jnp.asarray(at))) + vague)
    compiled = jax.jit(jax.value_and_grad(density))
    value, reverse = compiled(jnp.asarray(at))
    assert float(value) == pytest.approx(expected, rel=1e-9)
    slope = 2 * np.sum(here.residuals * here.jacobian[..., 0])
    E = 4e5 * np.exp(0.3)
    forward = -0.5 * (9 * slope / squares + 2 * (E - mean) / spread**2 * E + 2 * vague / 0.3)
    ends = [float(compiled(jnp.asarray(at + h))[0]) for h in (1e-4, -1e-4)]
    np.testing.assert_allclose(forward, reverse[0], rtol=1e-7)
    np.testing.assert_allclose(reverse[0], (ends[0] - ends[1]) / 2e-4, rtol=1e-5)
    assert float(compiled(jnp.array([1.5]))[0]) == -np.inf


def test_a_fit_hands_draws_back(postures, tmp_path):
    fit = fitted(postures, posterior="laplace", draws=4000)
    estimate, drawn = fit.parameters["young_modulus"], fit.posterior
    assert drawn.values["young_modulus"].shape == (4000,)
    # The interval is by Student's t, and the draws are normal.
    spread = np.std(drawn.theta[:, 0])
    assert spread == pytest.approx(estimate.standard_error, rel=0.05)
    assert np.mean(drawn.theta) == pytest.approx(np.log(estimate.value / 4e5), abs=0.05 * spread)
    assert posture_json(fit)["posterior"]["draws"] == 4000
    write_posture_report(fit, tmp_path)
    with np.load(tmp_path / "posterior.npz") as draws:
        np.testing.assert_array_equal(draws["young_modulus"], drawn.values["young_modulus"])
    told = json.loads((tmp_path / "parameters.json").read_text(encoding="utf-8"))
    assert told["posterior"]["method"] == "laplace"


def test_a_prior_weighs_as_the_noise_that_is_found(postures):
    """Stated noise of 1 mm, found to be about 4: the prior's weight is of what was found."""
    fit = fitted(postures)
    other = fitted(replace(postures, noise={"tip": 1e-4}))
    value = lambda f: f.parameters["young_modulus"].value
    assert value(other) == pytest.approx(value(fit), rel=0.01)
    assert other.noise_scale == pytest.approx(10 * fit.noise_scale, rel=0.01)


def test_what_cannot_be_drawn_is_told(postures):
    with pytest.raises(ValueError, match="expected one of laplace, nuts"):
        fitted(postures, posterior="gibbs")
    with pytest.raises(ValueError, match="at least 2"):
        fitted(postures, posterior="laplace", draws=1)


def test_without_blackjax_it_is_said_what_to_install(monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "blackjax", None)
    with pytest.raises(ImportError, match=r"pip install 'softrod_jax\[posterior\]'"):
        nuts(lambda x: -jnp.sum(x**2), np.zeros(1), np.eye(1), 10, 0)
    assert jax.config.jax_enable_x64
