"""The posterior of a fit to motions: draws about the best place, or of the posterior itself.

Samples of a recording are not independent of each other, so that their number is no number of
measurements. The residuals of the fit tell how many independent ones they are worth
(`calibration.inference.noise`), n; how large the noise is is not known, and integrated over, each
magnitude being as likely as another, which leaves the sum of squares to the power of -n / 2. A
draw of NUTS takes some tens of simulations with their derivatives.
"""

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from calibration.inference.posterior import Posterior, laplace_draws, nuts
from calibration.inference.uncertainty import PRIOR_DELAY, Uncertainty
from calibration.problem.evaluation import predict, traced
from calibration.problem.problem import Point, Problem

# Draws that are simulated for the bands of a prediction.
_SIMULATED = 40
_QUANTILE = 1.959964  # of the normal distribution, 97.5 %


def check_problem(problem: Problem, method: str | None) -> None:
    """Raises `ValueError` for what NUTS cannot draw."""
    if method == "nuts" and problem.beside is not None:
        raise ValueError("posterior='nuts': not with postures beside motions; use 'laplace'")
    if method is not None and problem.reverse:
        raise ValueError("posterior: not with so many parameters that the fit goes by reverse mode")


def posterior_of(
    best: Point, uncertainty: Uncertainty, method: str, draws: int, seed: int
) -> Posterior:
    """Draws by "laplace" or "nuts". Raises `ImportError` for NUTS without blackjax."""
    space, n = best.problem.space, best.problem.space.parameter_count
    errors = uncertainty.standard_errors
    covariance = uncertainty.correlation * np.outer(errors, errors)
    low, high = space.bounds
    if method == "laplace":
        inside = lambda x: np.clip(x, low, high)
        x = laplace_draws(best.x, covariance, inside, draws, seed)
        quality = float(len(x)), 1.0, 0
    else:
        density = log_density(best.problem, uncertainty.effective_samples)
        chains = nuts(density, best.x, _within(covariance, high - low), draws, seed)
        x = chains.theta.reshape(-1, best.x.size)
        quality = chains.effective, chains.mixed, chains.divergent
    values = {u.label: np.stack([u.value(t) for t in x[:, i]]) for i, u in enumerate(_items(best))}
    return Posterior(method, x[:, :n], values, *quality, whole=x)


def _items(best: Point):
    return best.problem.space.parameters.items


def _within(covariance, widths) -> Float[np.ndarray, "unknowns unknowns"]:
    """The covariance, of unknowns of which little is known no wider than a bounded space is."""
    errors = np.sqrt(np.diag(covariance))
    scale = np.minimum(1.0, 0.25 * widths / errors)
    return covariance * np.outer(scale, scale)


def log_density(
    problem: Problem, independent: float
) -> Callable[[Float[Array, "unknowns"]], Float[Array, ""]]:
    """Of x, where the recordings are worth so many `independent` measurements. Its slope is that of
    the forward derivatives of all residuals, with which it is computed at once."""
    space, items = problem.space, problem.space.parameters.items
    low, high = (jnp.asarray(x) for x in space.bounds)
    vague = np.zeros(space.drifts.stop)
    vague[: len(items)] = [2.0 / u.parameter.scale.largest for u in items]
    vague[space.delays] = 1 / PRIOR_DELAY
    vague[space.drifts] = 1.0
    squares = squares_of(problem)

    def density(x):
        known = jnp.sum((vague * x) ** 2)
        for i, value, mean, spread in problem.prior_places:
            known = known + ((value(x[i]) - mean) / spread) ** 2
        inside = jnp.all((low <= x) & (x <= high))
        whole = independent * jnp.log(squares(x)) + known
        return jnp.where(inside, -0.5 * whole, -jnp.inf)

    return density


def squares_of(problem: Problem) -> Callable[[Float[Array, "unknowns"]], Float[Array, ""]]:
    """The misfit [m^2] as a function of x that can be differentiated once, by forward mode."""
    space, batch = problem.space, problem.batch
    columns = jnp.asarray(space.parameters.columns)
    places = {k: (jnp.asarray(p), jnp.asarray(s)) for k, (p, s) in space.nuisance_columns.items()}
    pick = lambda place, x: jnp.where(place < 0, 0.0, x[jnp.maximum(place, 0)])

    def both(x):
        nuisance = {name: pick(place, x) * size for name, (place, size) in places.items()}
        found = traced(
            problem.setup,
            batch,
            pick(columns, x),
            nuisance,
            space.parameters.names,
            problem.scheme,
            problem.method,
        )
        r = batch.weights * found.residuals
        pull = 2 * batch.weights * r
        slope = jnp.zeros_like(x)
        add = lambda slope, place, by: slope.at[jnp.maximum(place, 0)].add(
            jnp.where(place < 0, 0.0, by)
        )
        slope = add(slope, columns, jnp.einsum("ksa,ksap->kp", pull, found.by_parameter))
        for name, (place, size) in places.items():
            by = jnp.einsum("ksa,ksa...->k...", pull, found.by_nuisance[name])
            slope = add(slope, place, size * by)
        return jnp.sum(r**2), slope

    @jax.custom_vjp
    def squares(x):
        return both(x)[0]

    squares.defvjp(both, lambda slope, pull: (pull * slope,))
    return squares


def bands(
    best: Point, posterior: Posterior
) -> list[tuple[Float[np.ndarray, "samples 3"], Float[np.ndarray, "samples 3"]]]:
    """For each recording between which ends a sample of the tip [m] is expected with 95 %: by the
    spread of simulations at draws of the posterior, and by the noise that the residuals show."""
    problem, space = best.problem, best.problem.space
    draws = posterior.theta if posterior.whole is None else posterior.whole
    chosen = draws[np.linspace(0, len(draws) - 1, min(_SIMULATED, len(draws))).astype(int)]
    tips = []
    for x in chosen:
        r, motion = predict(
            problem.setup,
            problem.batch,
            jnp.asarray(space.parameters.theta(x)),
            space.nuisance(x),
            space.parameters.names,
            problem.scheme,
            problem.method,
        )
        if not np.any(np.asarray(motion.result)):
            tips.append(np.asarray(r)[..., :3])
    used = np.asarray(problem.batch.used)[..., :3]
    own = np.asarray(best.evaluation.residuals)[..., :3]
    counts = np.maximum(np.sum(used, axis=1, keepdims=True), 1)
    noise = np.sum(np.where(used, own**2, 0.0), axis=1, keepdims=True) / counts
    spread = np.var(tips, axis=0) if len(tips) > 1 else np.zeros_like(own)
    half = _QUANTILE * np.sqrt(spread + noise)
    seen = own + np.asarray(problem.batch.tip)
    return [(a, b) for a, b in zip(seen - half, seen + half, strict=True)]
