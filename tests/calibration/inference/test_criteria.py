"""Which of several models is asked for, by numbers that are known."""

import numpy as np
import pytest

from calibration.inference.criteria import Candidate, judged


def model(name, numbers, square, **more):
    parts = dict(measurements=300, effective=120.0, rms_m={"a": np.sqrt(square)})
    return Candidate(name=name, numbers=numbers, mean_square=square, **{**parts, **more})


def test_criteria_are_those_of_independent_gaussian_residuals():
    """Against the log likelihood itself, at its maximum in the variance."""
    rng = np.random.default_rng(0)
    t, n = np.linspace(-1, 1, 40), 40
    y = 1 + 2 * t + 0.3 * rng.normal(size=n)
    likelihood, models = [], []
    for degree in (0, 1, 2):
        r = y - np.polyval(np.polyfit(t, y, degree), t)
        v = np.mean(r**2)
        likelihood.append(np.sum(-(r**2) / (2 * v) - np.log(2 * np.pi * v) / 2))
        models.append(model(f"p{degree}", degree + 1, v, measurements=n, effective=float(n)))
    k = np.array([2, 3, 4])
    aicc = -2 * np.array(likelihood) + 2 * k + 2 * k * (k + 1) / (n - k - 1)
    bic = -2 * np.array(likelihood) + k * np.log(n)
    found = judged(models)
    np.testing.assert_allclose(found.aicc, aicc - aicc.min(), atol=1e-9)
    np.testing.assert_allclose(found.bic, bic - bic.min(), atol=1e-9)
    # By chance the parabola is hardly worse; that is said.
    assert (
        found.chosen == "p1" and found.bic[2] < 2 and "p2 is not told apart" in found.sentences[1]
    )


def test_only_what_the_best_residuals_are_worth_is_counted():
    poor, rich = model("poor", 2, 1.1e-6, effective=9.0), model("rich", 3, 1e-6)
    assert judged([poor, rich]).chosen == "rich"
    correlated = model("rich", 3, 1e-6, effective=12.0)
    found = judged([poor, correlated])
    assert found.effective == 12.0 and found.chosen == "poor"
    apart = 12 * np.log(1e-6 / 1.1e-6) + np.log(12)
    assert found.bic[1] - found.bic[0] == pytest.approx(apart)


def test_a_number_that_is_not_identified_is_not_asked_for():
    plain = model("plain", 2, 1e-6)
    vague = model("vague", 3, 5e-7, vague=("relaxation_time_2",))
    found = judged([vague, plain])
    assert found.chosen == "plain" and found.bic[0] == 0
    assert any("BIC would prefer vague" in x and "relaxation_time_2" in x for x in found.sentences)
    # What the simpler one does not tell either is no reason.
    both = model("plain", 2, 1e-6, vague=("relaxation_time_2",))
    assert judged([vague, both]).chosen == "vague"


def test_what_was_kept_aside_has_a_say():
    plain = model("plain", 2, 1e-6, held_out_m={"b": 1e-3})
    rich = model("rich", 4, 5e-7, held_out_m={"b": 1.3e-3})
    found = judged([plain, rich])
    assert found.chosen == "plain"
    assert any("1.3 mm, worse than 1 mm" in x for x in found.sentences)
    # The simpler one is asked for by its BIC, and predicts worse: that is said.
    other = model("other", 4, 9.9e-7, held_out_m={"b": 0.7e-3})
    found = judged([plain, other])
    assert found.chosen == "plain" and any("contradicts" in x for x in found.sentences)


def test_models_with_trouble_are_not_chosen():
    best = model("best", 3, 1e-7, trouble="stopped after 60 iterations")
    none = model("none", 0, np.inf, rms_m={}, trouble="it cannot be simulated")
    found = judged([none, best, model("plain", 2, 1e-6)])
    assert found.chosen == "plain"
    assert any("best is not chosen, though its BIC" in x for x in found.sentences)
    assert judged([none, best]).chosen == "best"
    with pytest.raises(ValueError, match="at least two"):
        judged([best])


def test_too_few_measurements_for_the_numbers():
    a, b = model("a", 8, 1e-6, effective=6.0), model("b", 9, 1e-7, effective=6.0)
    found = judged([a, b])
    assert np.isinf(found.aicc[0]) and found.chosen == "a"
    assert any("fewer than there are numbers" in x for x in found.sentences)
