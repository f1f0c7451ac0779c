"""What is known of parameters beforehand: a mean and a standard deviation, in their units."""

from collections.abc import Callable, Iterable, Mapping

import jax
import numpy as np
from jaxtyping import Float

# A prior is contradicted if the data alone would be so many standard deviations away.
CONTRADICTED = 3.0
Priors = Mapping[str, tuple[float, float]]


def checked_pairs(what: str, given: Priors | None, names: Iterable[str]) -> dict:
    """`priors` or `bounds`: two finite numbers for each name, the second above zero or above the
    first. Raises `ValueError` for others, and for a name that is not fitted."""
    out, known = {}, list(names)
    for name, pair in (given or {}).items():
        if name not in known:
            raise ValueError(f"{what}: {name!r} is not fitted; add it to fit, or leave it out")
        meant = "(mean, standard deviation)" if what == "priors" else "(low, high)"
        try:
            first, second = (float(x) for x in pair)
        except (TypeError, ValueError):
            raise ValueError(f"{what}: {name} = {pair!r}; expected {meant}") from None
        least = 0.0 if what == "priors" else first
        if not (np.isfinite(first) and least < second < np.inf):
            raise ValueError(f"{what}: {name} = {pair!r}; expected {meant}")
        out[name] = (first, second)
    return out


def prior_rows(
    priors: Iterable[tuple[int, Callable, float, float]], theta: Float[np.ndarray, "parameters"]
) -> tuple[Float[np.ndarray, "priors"], Float[np.ndarray, "priors parameters"]]:
    """(value - mean) / standard deviation of each prior, and the derivatives.

    `priors`: the index of the parameter in theta, its value as a function of its own coordinate,
    the mean and the standard deviation.
    """
    rows = [*priors]
    r, J = np.zeros(len(rows)), np.zeros((len(rows), len(theta)))
    for k, (i, value, mean, spread) in enumerate(rows):
        at = float(theta[i])
        r[k] = (float(value(at)) - mean) / spread
        J[k, i] = float(jax.grad(value)(at)) / spread
    return r, J


def contradictions(
    r: Float[np.ndarray, "priors"],
    J: Float[np.ndarray, "priors parameters"],
    information: Float[np.ndarray, "parameters parameters"],
) -> Float[np.ndarray, "priors"]:
    """How many standard deviations, of the two together, the data and the other priors are from
    each prior. `information`: that of the data alone, in terms of their noise."""
    apart = np.zeros(len(r))
    for k in range(len(r)):
        others = np.delete(np.arange(len(r)), k)
        tiny = 1e-12 * np.eye(len(information))
        without = information + J[others].T @ J[others] + tiny
        variance = float(J[k] @ np.linalg.solve(without, J[k]))
        # What is left of the pull of a prior tells how far the data alone would be.
        apart[k] = abs(r[k]) * np.sqrt(1 + variance)
    return apart
