"""The posterior of what is fitted: Gaussian about the best place (Laplace), or drawn by NUTS.

Both are of theta, in which positive parameters are logarithms (`calibration.parameters.scales`),
with priors as they were given and nothing else known inside the bounds. NUTS (Hoffman and Gelman
2014, as `blackjax` has it) needs no shape of the posterior, and hundreds of evaluations with their
gradients for it.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

METHODS = ("laplace", "nuts")
_CHAINS, _WARM_UP = 2, 200
# Chains that have not mixed, by the ratio of Gelman and Rubin, and too few independent draws.
_MIXED, _FEW = 1.05, 100


def check_posterior(method: str | None, draws: int) -> None:
    """Raises `ValueError` for a method that is none, and for too few draws."""
    if method is not None and method not in METHODS:
        raise ValueError(f"posterior: {method!r}; expected one of {', '.join(METHODS)}")
    if draws < 2:
        raise ValueError(f"draws={draws}; at least 2 are needed")


@dataclass(frozen=True, eq=False)
class Posterior:
    """Draws of the posterior.

    - `method`: "laplace" or "nuts". `theta`, (draws, parameters); `values`: by parameter, (draws,)
      or (draws, numbers), in its unit.
    - `effective`: independent draws that the fewest of the parameters' draws are worth.
      `mixed`: the largest ratio of Gelman and Rubin of any parameter, near 1 if chains agree.
      `divergent`: draws at which the integration failed.
    - `whole`: draws of all unknowns of a fit to motions, those of its clocks among them.
    """

    method: str
    theta: Float[np.ndarray, "draws parameters"]
    values: Mapping[str, np.ndarray]
    effective: float
    mixed: float
    divergent: int
    whole: Float[np.ndarray, "draws unknowns"] | None = None

    @property
    def ci95(self) -> dict[str, tuple]:
        """Between the quantiles of 2.5 and 97.5 %."""
        ends = {k: np.quantile(x, (0.025, 0.975), axis=0) for k, x in self.values.items()}
        return {name: (low, high) for name, (low, high) in ends.items()}

    @property
    def remarks(self) -> list[str]:
        """What to know before the draws are used."""
        said = []
        if self.mixed > _MIXED or self.effective < _FEW:
            said.append(
                f"The draws have not settled (ratio of Gelman and Rubin {self.mixed:.2f}, "
                f"{self.effective:.0f} independent ones): ask for more."
            )
        if self.divergent:
            said.append(
                f"{self.divergent} draws diverged: the posterior is sharper somewhere than the "
                "steps; a prior or a bound may help."
            )
        return said


def laplace_draws(
    theta: Float[np.ndarray, "parameters"],
    covariance: Float[np.ndarray, "parameters parameters"],
    inside: Callable,
    draws: int,
    seed: int,
) -> Float[np.ndarray, "draws parameters"]:
    """Of the Gaussian about `theta`; those outside the bounds are put `inside` them."""
    rng = np.random.default_rng(seed)
    x = rng.multivariate_normal(theta, covariance, size=draws, method="cholesky")
    return np.stack([inside(row) for row in x])


@dataclass(frozen=True, eq=False)
class Chains:
    """Draws of NUTS, (chains, draws, parameters), and how good they are, as in `Posterior`."""

    theta: Float[np.ndarray, "chains draws parameters"]
    effective: float
    mixed: float
    divergent: int


def nuts(
    log_density: Callable[[Float[Array, "parameters"]], Float[Array, ""]],
    theta: Float[np.ndarray, "parameters"],
    covariance: Float[np.ndarray, "parameters parameters"],
    draws: int,
    seed: int,
) -> Chains:
    """At least `draws` draws of NUTS in two chains, which begin at draws of the Gaussian.

    `log_density`: of theta, differentiable. `covariance`: of the Gaussian, by which the space is
    scaled, so that steps are as long as they should be in all directions.

    Raises `ImportError` that says what to install.
    """
    try:
        import blackjax  # pyright: ignore[reportMissingImports]  # an extra
    except ImportError:
        raise ImportError(
            "draws of the posterior by NUTS need blackjax: pip install 'softrod_jax[posterior]'"
        ) from None
    root = jnp.asarray(np.linalg.cholesky(covariance))
    middle = jnp.asarray(theta)
    scaled = lambda z: log_density(middle + root @ z)
    each = -(-draws // _CHAINS)

    def chain(key):
        first, second, third = jax.random.split(key, 3)
        start = 0.5 * jax.random.normal(first, middle.shape)
        adapt: Any = blackjax.window_adaptation(blackjax.nuts, scaled)
        (state, found), _ = adapt.run(second, start, num_steps=_WARM_UP)
        step: Any = blackjax.nuts(scaled, **found).step

        def once(state, key):
            state, info = step(key, state)
            return state, (state.position, info.is_divergent)

        return jax.lax.scan(once, state, jax.random.split(third, each))[1]

    # One after the other: side by side each would wait for the longest path of all.
    keys = jax.random.split(jax.random.key(seed), _CHAINS)
    z, divergent = jax.jit(lambda keys: jax.lax.map(chain, keys))(keys)
    own = lambda f: np.asarray(f(z, chain_axis=0, sample_axis=1))
    effective = own(blackjax.diagnostics.effective_sample_size)
    mixed = own(blackjax.diagnostics.potential_scale_reduction)
    x = np.asarray(middle + z @ root.T)
    return Chains(x, float(np.min(effective)), float(np.max(mixed)), int(np.sum(divergent)))
