"""The posterior of fits to motions: its slope, its draws, and what is made of them."""

import json
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from beams import FIT, NOISE, TRUTH, beam, release

import softrod_jax as sr
from calibration import calibrate
from calibration.cli.main import main
from calibration.inference.motion_posterior import check_problem, log_density, squares_of
from calibration.parameters.unknowns import choose_unknowns
from calibration.problem.dataset import datasets
from calibration.problem.problem import make_problem
from calibration.report.numbers import as_json
from calibration.report.writing import write_report

NAMES = ("young_modulus", "bending_damping")
START = {"young_modulus": 2.7e5, "bending_damping": 7e-5}
PRIOR = {"young_modulus": (2.5e5, 5e4)}


@pytest.fixture(scope="module")
def recording():
    return release(beam())


@pytest.fixture(scope="module")
def problem(recording):
    scene = jax.tree.map(jnp.asarray, beam(**START))
    data, _ = datasets(scene, [recording], window=(0.0, 1.0))
    setup, parameters = choose_unknowns(scene, data.recordings, data.labels, NAMES)
    made = make_problem(setup, parameters, data, True, FIT["dt"], method=FIT["method"])
    return replace(made, priors=PRIOR)


def fitted(recording, **options):
    given = {"fit": NAMES, "window": (0.0, 1.0), "checks": False, "progress": False, **FIT}
    return calibrate(beam(**START), [recording], **{**given, **options})


def test_the_density_and_its_slope(problem):
    """The misfit that a search sees, and Student's density of what it leaves."""
    x = np.array([0.02, -0.1, 0.3])
    point = problem.at(x)
    squares, slope = jax.value_and_grad(squares_of(problem))(jnp.asarray(x))
    np.testing.assert_allclose(squares, point.misfit, rtol=1e-12)
    np.testing.assert_allclose(slope, 2 * point.jacobian.T @ point.residuals, rtol=1e-9)
    density = log_density(problem, 50.0)
    E = START["young_modulus"] * np.exp(x[0])
    known = ((E - PRIOR["young_modulus"][0]) / PRIOR["young_modulus"][1]) ** 2
    vague = [2 / u.parameter.scale.largest for u in problem.space.parameters.items] + [1 / 7]
    known += np.sum((np.array(vague) * x) ** 2)
    expected = -0.5 * (50 * np.log(point.misfit) + known)
    np.testing.assert_allclose(density(jnp.asarray(x)), expected, rtol=1e-9)
    assert density(jnp.array([99.0, 0.0, 0.0])) == -np.inf


def test_draws_of_laplace_and_the_band_of_a_prediction(recording, tmp_path):
    found = fitted(recording, posterior="laplace", draws=400)
    for name in NAMES:
        # Draws are of the normal distribution, intervals of Student's.
        ends, own = np.log(found.posterior.ci95[name]), np.log(found.parameters[name].ci95)
        np.testing.assert_allclose(ends, own, atol=0.15 * np.ptp(own))
    (r,) = found.recordings
    low, high = r.band
    inside = np.mean((low <= r.measured) & (r.measured <= high))
    assert 0.9 < inside < 0.99
    np.testing.assert_allclose((low + high) / 2, r.simulated, atol=1e-12)
    assert np.all(high - low > 2 * 1.9 * NOISE * 0.8)
    told = as_json(found)["posterior"]
    assert told["method"] == "laplace" and told["draws"] == 400
    assert "95 % of the posterior (laplace)" in found.summary()
    write_report(found, tmp_path)
    with np.load(tmp_path / "posterior.npz") as draws:
        assert draws["young_modulus"].shape == (400,)
    json.loads((tmp_path / "parameters.json").read_text())


@pytest.mark.long
def test_nuts_agrees_where_the_posterior_is_gaussian(recording):
    pytest.importorskip("blackjax")
    found = fitted(recording, posterior="nuts", draws=300)
    drawn = found.posterior
    assert drawn.mixed < 1.1 and drawn.divergent <= 3
    for name in NAMES:
        low, high = np.log(found.parameters[name].ci95)
        ends = np.log(drawn.ci95[name])
        np.testing.assert_allclose(ends, [low, high], atol=0.3 * (high - low))
        assert ends[0] < np.log(TRUTH[name]) < ends[1]


def test_what_is_refused(problem, recording, tmp_path, capsys):
    with pytest.raises(ValueError, match="reverse mode"):
        check_problem(replace(problem, reverse=True), "laplace")
    with pytest.raises(ValueError, match="not with postures beside"):
        check_problem(replace(problem, beside=object()), "nuts")
    with pytest.raises(ValueError, match="posterior: 'gibbs'"):
        fitted(recording, posterior="gibbs")
    scene, log = tmp_path / "robot.toml", tmp_path / "log.csv"
    sr.save_scene(beam(), scene)
    log.write_text("t_s,tip_x_m,tip_y_m,tip_z_m\n0,0,0,0.1\n")
    call = ["calibrate", str(scene), str(log), "--out", str(tmp_path / "out")]
    assert main([*call, "--draws", "10"]) == 2
    assert "--draws: of --posterior" in capsys.readouterr().err
    assert main([*call, "--posterior", "laplace", "--compare"]) == 2
    assert "--posterior: not with --compare" in capsys.readouterr().err
