"""The search for parameters of postures, on problems whose answer is known."""

from types import SimpleNamespace

import numpy as np
import pytest

import softrod_jax as sr
from calibration.postures.prediction import Evaluation
from calibration.postures.search import Search


def searched(residual, jacobian, largest, start):
    """Where the search ends for residuals of theta, and whether it says that it has converged."""
    seen = SimpleNamespace(result=np.full(1, int(sr.RESULTS.successful)))
    names = [f"p{i}" for i in range(len(start))]
    scale = SimpleNamespace(largest=largest)
    parameters = [SimpleNamespace(name=name, scale=scale) for name in names]
    evaluate = lambda theta: Evaluation(residual(theta)[None], jacobian(theta)[None], seen)
    model = SimpleNamespace(evaluate=evaluate, parameters=parameters)
    theta, _, _, converged = Search(model, {}, {}).run(np.array(start), 200)
    return theta, converged


@pytest.mark.parametrize("apart", [1e-2, 1e-3])
def test_two_numbers_that_go_together(apart):
    """Only their sum is told well: both have far to go, and the sum must not be lost on the way."""
    A = np.array([[1.0, 10.0], [1.0, 10.0 + apart]])
    b = A @ [30.0, -2.5]
    theta, converged = searched(lambda x: A @ x - b, lambda x: A, 50.0, [0.0, 0.0])
    assert converged
    np.testing.assert_allclose(A @ theta, b, atol=1e-2 * apart)


def test_a_bound_that_is_in_the_way():
    """Along it the search goes on, to the place where the gradient leads out of it."""
    A = np.array([[1.0, 2.0], [2.0, 1.0], [0.0, 0.5]])
    b = np.array([8.0, 3.0, 1.0])
    theta, converged = searched(lambda x: A @ x - b, lambda x: A, 1.0, [-0.9, -0.9])
    # The second number is at its bound, and the first is then where its own slope is zero.
    first = A[:, 0] @ (b - A[:, 1]) / (A[:, 0] @ A[:, 0])
    assert converged
    np.testing.assert_allclose(theta, [np.clip(first, -1.0, 1.0), 1.0], atol=1e-3)
