"""Time schemes on scalar equations whose answers are known: order, damping, restarts."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import softrod_jax as sr
from softrod_jax.stepping.step_inputs import jumps


class Carry(NamedTuple):
    guess: jax.Array


def integrate(scheme, matrix, y0, dt, steps, start_is_jump=True):
    """y_t = matrix y by `scheme`; every implicit stage solved exactly."""

    def solve(c0, history, at, carry):
        return jnp.linalg.solve(matrix - c0 * jnp.eye(len(y0)), history), carry

    restart = jnp.zeros(steps, bool).at[0].set(start_is_jump)

    def step(memory, coefficients):
        memory, _, _ = scheme.step(memory, coefficients, solve, Carry(y0))
        return memory, memory[0]

    _, y = jax.lax.scan(step, scheme.start(y0, y0), scheme.coefficients(jnp.array(dt), restart))
    return y


@pytest.mark.parametrize(
    "scheme, order",
    [
        (sr.BDFAlpha(alpha=0.0), 2),
        (sr.BDFAlpha(alpha=-0.2), 2),
        (sr.BDFAlpha(alpha=-0.45), 2),
        (sr.BDFAlpha(alpha=-0.5), 2),
        (sr.SDIRK(order=2), 2),
        (sr.SDIRK(order=3), 3),
        (sr.SDIRK(order=3, stages=6), 3),
        (sr.SDIRK(order=4), 4),
    ],
    ids=str,
)
def test_order(scheme, order):
    matrix, y0 = jnp.array([[-0.1, 3.0], [-3.0, -0.2]]), jnp.array([1.0, 0.5])
    exact = jax.scipy.linalg.expm(matrix) @ y0
    errors = [
        float(jnp.abs(integrate(scheme, matrix, y0, 1 / n, n)[-1] - exact).max())
        for n in (40, 80, 160)
    ]
    observed = np.log2(np.array(errors[:-1]) / errors[1:])
    assert np.all(observed > order - 0.25), observed
    assert scheme.order == order


@pytest.mark.parametrize("order, stages", [(2, 2), (3, 4), (3, 6), (4, 5)])
def test_the_local_error_falls_with_the_order(order, stages):
    """It is that of a scheme one order lower, for the fields and for their integrals."""
    matrix, y0 = jnp.array([[-0.1, 3.0], [-3.0, -0.2]]), jnp.array([1.0, 0.5])
    scheme = sr.SDIRK(order, stages)
    solve = lambda c0, history, at, carry: (
        jnp.linalg.solve(matrix - c0 * jnp.eye(2), history),
        carry,
    )
    sizes = []
    for dt in (0.02, 0.01):
        coefficients = scheme.coefficients(jnp.array(dt), jnp.zeros(1, bool))[0]
        (y, *_), _, errors = scheme.step(scheme.start(y0, y0), coefficients, solve, Carry(y0))
        sizes.append([float(jnp.linalg.norm(e)) for e in (errors.lower, errors.of_integral)])
        exact = jax.scipy.linalg.expm(dt * matrix) @ y0
        assert jnp.linalg.norm(y - exact) < 0.2 * sizes[-1][0]
    fall = np.log2(np.array(sizes[0]) / sizes[1])
    np.testing.assert_allclose(fall, order, atol=0.1)


@pytest.mark.parametrize("order, stages", [(2, 2), (3, 4), (3, 6), (4, 5)])
def test_local_errors_of_an_oscillation(order, stages):
    """The smaller estimate is about the error, or more, whether steps resolve it or not."""
    scheme = sr.SDIRK(order, stages)
    A, ones, true = scheme._table(diagonal=True), np.ones(stages), 0.0
    for x in np.geomspace(0.1, 100, 40):
        inner = np.linalg.solve(np.eye(stages) - 1j * x * A, ones)
        # The amplitude is lost in the end, but at single frequencies by chance is not.
        true = max(true, min(abs(inner[-1] - np.exp(1j * x)), 1.0))
        errors = scheme._local_errors(1.0, jnp.array(1j * x), jnp.array(1j * x * inner))
        estimate = min(abs(complex(errors.lower)), abs(complex(errors.difference)))
        assert 0.4 * true < estimate < 3.5 * true, (x, estimate / true)


@pytest.mark.parametrize("order, stages", [(2, 2), (3, 4), (3, 6), (4, 5)])
def test_sdirk_is_l_stable(order, stages):
    """From the tables: |R(iy)| <= 1, no pole on the left, R = 0 at infinity; order 3 in full."""
    A = sr.SDIRK(order, stages)._table(diagonal=True)
    b, c = A[-1], A.sum(1)
    conditions = [b.sum() - 1, b @ c - 1 / 2, b @ c**2 - 1 / 3, b @ A @ c - 1 / 6]
    np.testing.assert_allclose(conditions[: 2 ** (order - 1)], 0.0, atol=1e-14)
    y = np.logspace(-3, 5, 4001)
    system = np.eye(stages) - 1j * y[:, None, None] * A
    R = np.linalg.solve(system, np.ones((len(y), stages, 1)))[:, -1, 0]
    assert np.abs(R).max() <= 1 + 1e-13
    assert np.diag(A).min() > 0 and abs(R[-1]) < 1e-3


@pytest.mark.parametrize(
    "alpha, zeta",
    [
        (0.0, (2.45e-4, 1.84e-3, 2.06e-2)),
        (-0.2, (1.18e-4, 9.1e-4, 1.12e-2)),
        (-0.48, (5e-6, 4e-5, 5.8e-4)),
        (-0.5, (0.0, 0.0, 0.0)),
    ],
)
def test_numerical_damping_of_bdf_alpha(alpha, zeta):
    """An undamped oscillator loses amplitude at the damping ratio the scheme adds."""
    oscillator = jnp.array([[0.0, 1.0], [-1.0, 0.0]])
    for dt, expected in zip((0.1, 0.2, 0.5), zeta, strict=True):
        steps = int(400 / dt)
        y = integrate(sr.BDFAlpha(alpha=alpha), oscillator, jnp.array([1.0, 0.0]), dt, steps)
        amplitude = np.linalg.norm(y, axis=1)
        first, last = int(40 / dt), steps - 1
        phase = np.unwrap(np.arctan2(-y[:, 1], y[:, 0]))
        measured = -np.log(amplitude[last] / amplitude[first]) / (phase[last] - phase[first])
        np.testing.assert_allclose(measured, expected, rtol=0.12, atol=1e-8)


def test_a_restart_keeps_second_order_after_a_jump():
    """y_t = A y + b switched on at t = 0: the history before the jump knows nothing of b."""
    matrix = jnp.array([[0.0, 1.0, 0.0], [-9.0, -0.1, 1.0], [0.0, 0.0, 0.0]])
    y0 = jnp.array([0.0, 0.0, 1.0])
    exact = jax.scipy.linalg.expm(matrix) @ y0

    def errors(restart):
        return np.array(
            [
                float(
                    jnp.abs(
                        integrate(sr.BDFAlpha(alpha=-0.2), matrix, y0, 1 / n, n, restart)[-1]
                        - exact
                    ).max()
                )
                for n in (40, 80, 160)
            ]
        )

    np.testing.assert_allclose(np.log2(errors(False)[:-1] / errors(False)[1:]), 1.0, atol=0.1)
    np.testing.assert_allclose(np.log2(errors(True)[:-1] / errors(True)[1:]), 2.0, atol=0.15)


def test_jumps():
    step = np.r_[np.zeros(5), np.ones(5)][:, None]
    assert jumps(jnp.array(step))[:, 0].tolist() == [True] + [False] * 4 + [True] + [False] * 4
    ramp = np.clip(np.arange(20) - 5, 0, 8)[:, None] / 8.0
    assert jumps(jnp.array(ramp))[:, 0].tolist() == [True] + [False] * 19
    assert jumps(jnp.ones((3, 2))).tolist() == [[True] * 2, [False] * 2, [False] * 2]
    both = np.hstack([ramp, np.roll(step, 3).repeat(2, 0)])
    found = jumps(jnp.array(both))
    assert int(found[:, 0].sum()) == 1 and int(found[:, 1].sum()) >= 2


@pytest.mark.parametrize(
    "bad",
    [
        lambda: sr.BDFAlpha(alpha=0.1),
        lambda: sr.SDIRK(order=5),
        lambda: sr.SDIRK(3, stages=5),
    ],
)
def test_bad_schemes(bad):
    with pytest.raises(ValueError, match="alpha|order|stages"):
        bad()
