"""Priors of motions: they weigh as one measurement each, and a wrong one is told."""

import json

import jax.numpy as jnp
import numpy as np
import pytest
from beams import FIT, TRUTH, beam, release

from calibration import calibrate
from calibration.parameters.priors import checked_pairs, contradictions, prior_rows
from calibration.report.numbers import as_json
from calibration.report.writing import summary, write_report

NAMES = ("young_modulus", "density")
OPTIONS = dict(fit=NAMES, checks=False, window=(0.0, 1.0), progress=False, **FIT)


@pytest.fixture(scope="module")
def recording():
    return release(beam(bending_damping=0.0))


def fitted(recording, priors, E=2.5e5):
    scene = beam(young_modulus=E, bending_damping=0.0)
    return calibrate(scene, [recording], priors=priors, **OPTIONS)


def test_a_weighed_density_makes_the_modulus_known(recording):
    # Only the modulus over the density moves the tip; that is known well.
    fit = fitted(recording, {"density": (1070.0, 20.0)})
    E, density = (fit.parameters[name] for name in NAMES)
    assert E.identifiable and density.identifiable and not fit.conflicts
    assert density.value == pytest.approx(1070.0, abs=1.0)
    half = (density.ci95[1] - density.ci95[0]) / 2
    assert half == pytest.approx(1.96 * 20.0, rel=0.1)
    relative = np.log(E.ci95[1] / E.ci95[0]) / 2
    assert 1.96 * 20 / 1070 < relative < 1.3 * 1.96 * 20 / 1070
    assert E.ci95[0] < TRUTH["young_modulus"] < E.ci95[1]


def test_a_prior_draws_as_one_measurement(recording):
    # Two priors that disagree, of what the recording does not tell: their weighted mean.
    ratio = TRUTH["young_modulus"] / 1070.0
    priors = {"density": (1070.0, 40.0), "young_modulus": (1.1 * TRUTH["young_modulus"], 4e3)}
    fit = fitted(recording, priors)
    by_modulus, its_spread = 1.1 * 1070.0, 4e3 / ratio
    weights = np.array([40.0, its_spread]) ** -2.0
    mean = weights @ [1070.0, by_modulus] / weights.sum()
    assert fit.parameters["density"].value == pytest.approx(mean, rel=5e-3)


def test_a_wrong_prior_is_told(recording, tmp_path):
    wrong = {"density": (1070.0, 5.0), "young_modulus": (2.0e5, 5e3)}
    fit = fitted(recording, wrong)
    assert set(fit.conflicts) == set(NAMES)
    told = as_json(fit)
    assert told["priors"]["density"] == [1070.0, 5.0]
    # From 2e5, by the spreads of both and next to nothing of the recording's own.
    spread = np.hypot(5e3, 5.0 * TRUTH["young_modulus"] / 1070.0)
    apart = (TRUTH["young_modulus"] - 2.0e5) / spread
    assert told["priors_contradicted"]["young_modulus"] == pytest.approx(apart, rel=0.1)
    assert any("prior of young_modulus is contradicted" in text for text in told["remarks"])
    assert "standard deviations apart" in summary(fit)
    write_report(fit, tmp_path)
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert "known beforehand" in page
    json.loads((tmp_path / "parameters.json").read_text(encoding="utf-8"))


def test_closed_forms():
    # One number, measured as 3 with variance 1/4, believed to be 1 with variance 1.
    posterior = (4 * 3.0 + 1.0) / 5
    r, J = np.array([posterior - 1.0]), np.ones((1, 1))
    apart = contradictions(r, J, np.array([[4.0]]))
    np.testing.assert_allclose(apart, 2.0 / np.sqrt(1 + 1 / 4))
    rows = [(1, lambda x: 2.0 * jnp.exp(x), 1.0, 0.5)]
    r, J = prior_rows(rows, np.array([7.0, np.log(2.0)]))
    np.testing.assert_allclose(r, [6.0])
    np.testing.assert_allclose(J, [[0.0, 8.0]])


@pytest.mark.parametrize(
    "priors, message",
    [
        ({"poisson_ratio": (0.4, 0.1)}, "is not fitted"),
        ({"density": (1070.0, 0.0)}, "mean, standard deviation"),
        ({"density": (np.nan, 1.0)}, "mean, standard deviation"),
    ],
)
def test_bad_priors_are_told(recording, priors, message):
    with pytest.raises(ValueError, match=message):
        fitted(recording, priors)
    with pytest.raises(ValueError, match=message):
        checked_pairs("priors", priors, NAMES)
