"""What the benchmark of the filter takes for chance, against sets that are drawn anew."""

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[2] / "benchmarks"))

from consistency import bounds, inside, nees_if_right  # noqa: E402

RUNS, STEPS, N = 40, 60, 2


def drawn(rho, rng):
    """Errors of the covariance one, (runs, steps, n), of which neighbours in time have `rho`."""
    noise = rng.standard_normal((STEPS, RUNS, N))
    for k in range(1, STEPS):
        noise[k] = rho * noise[k - 1] + np.sqrt(1 - rho**2) * noise[k]
    return noise.swapaxes(0, 1)


def share(nees):
    return inside(nees, RUNS, N).mean(-1)


def measured(off):
    return (off**2).sum(2).mean(0)


@pytest.mark.parametrize("rho", [0.0, 0.95])
def test_scatter_of_the_share_is_that_of_sets_drawn_anew(rho):
    """From the errors of one set alone, in other units and other axes at each time."""
    rng = np.random.default_rng(0)
    anew = np.array([measured(drawn(rho, rng)) for _ in range(1000)])
    mixed = np.einsum("kij,rkj->rki", rng.standard_normal((STEPS, N, N)), drawn(rho, rng))
    found = nees_if_right(mixed, rng, sets=1000)
    assert found.shape == anew.shape == (1000, STEPS)
    independent = np.sqrt(0.95 * 0.05 / STEPS)
    assert (share(anew).std() > 2 * independent) == (rho > 0)
    np.testing.assert_allclose(share(found).std(), share(anew).std(), rtol=0.15)
    np.testing.assert_allclose(share(np.array([found, anew])).mean(1), 0.95, atol=0.01)


def test_the_share_tells_of_covariances_that_are_a_fifth_too_small():
    off = drawn(0.3, np.random.default_rng(1))
    right = nees_if_right(off, np.random.default_rng(2), sets=500)
    least = np.quantile(share(right), 0.025)
    assert share(measured(off)) > least > share(1.25 * measured(off))


def test_bounds_are_those_of_tables():
    """Of 50 runs and two numbers: 74.22 and 129.56 of chi-square with 100 degrees of freedom."""
    np.testing.assert_allclose(bounds(50, 2), [1.484, 2.591], atol=1e-3)
