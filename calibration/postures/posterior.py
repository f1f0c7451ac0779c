"""The posterior of a fit to postures, with draws by Laplace's approximation or by NUTS.

How large the noise is is not known: it is integrated over, each magnitude being as likely as
another (Jeffreys), which leaves the sum of squares to the power of minus half the number of
residuals.
Residuals are taken for independent; where trials share errors, the fit's own intervals are wider.
"""

from collections.abc import Callable

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from calibration.inference.posterior import Posterior, laplace_draws, nuts
from calibration.postures.prediction import Model


def log_density(
    model: Model, believed: Callable, numbers: int, bounds
) -> Callable[[Float[Array, "parameters"]], Float[Array, ""]]:
    """Of theta. `believed`: the sum of squares of the priors; `numbers`: how many residuals there
    are; `bounds`: lowest and highest theta, outside of which it is minus infinity."""
    low, high = (jnp.asarray(x) for x in bounds)
    vague = jnp.array([2.0 / p.scale.largest for p in model.parameters])

    def density(theta):
        known = believed(theta) + jnp.sum((vague * theta) ** 2)
        of_data = numbers * jnp.log(model.squares(theta))
        inside = jnp.all((low <= theta) & (theta <= high))
        return jnp.where(inside, -0.5 * (of_data + known), -jnp.inf)

    return density


def draw_posterior(
    model: Model,
    density: Callable,
    theta: Float[np.ndarray, "parameters"],
    covariance: Float[np.ndarray, "parameters parameters"],
    bounds,
    method: str,
    draws: int,
    seed: int,
) -> Posterior:
    """Draws about the best place `theta`. Raises `ImportError` for NUTS without blackjax."""
    if method == "laplace":
        inside = lambda x: np.clip(x, *bounds)
        x = laplace_draws(theta, covariance, inside, draws, seed)
        quality = float(len(x)), 1.0, 0
    else:
        chains = nuts(density, theta, covariance, draws, seed)
        x = chains.theta.reshape(-1, len(theta))
        quality = chains.effective, chains.mixed, chains.divergent
    values = {}
    for i, p in enumerate(model.parameters):
        initial = np.asarray(p.get(model.setup))
        at = x[:, i].reshape(-1, *[1] * initial.ndim)
        values[p.name] = np.asarray(p.scale.value(initial, at))
    return Posterior(method, x, values, *quality)
