"""The search for a fit to postures, and what it tells of the noise and of theta."""

from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np

from calibration.inference.posterior import Posterior
from calibration.parameters.priors import prior_rows
from calibration.postures.posterior import draw_posterior, log_density
from calibration.postures.prediction import Evaluation, Model
from calibration.search.minimum import CalibrationError

# A search ends where the next step promises less than this part of the loss.
_CONVERGED = 1e-7
# The largest change of a parameter in one step, most of which are logarithms; and the damping from
# which on a step leads nowhere.
_LARGEST, _STIFFEST = 2.0, 1e9
# Of the noise, as a part of what was stated: a perfect fit leaves rounding errors.
LEAST_SCALE = 1e-12


@dataclass(frozen=True, eq=False)
class Search:
    """Levenberg and Marquardt's method for the residuals of a model and its priors."""

    model: Model
    priors: dict[str, tuple[float, float]]
    bounds: dict[str, tuple[float, float]]
    weight: float = 1.0

    def run(self, theta, most: int):
        """theta, the evaluation there, how many there were, and whether the search converged."""
        model = self.model
        best = model.evaluate(theta)
        if not np.any(best.solved):
            raise CalibrationError(
                "postures: no row has an equilibrium at the scene's values; see the inputs' units "
                "and signs, and `softrod solve` for one of them"
            )
        count, damping, converged = 1, 1e-3, False
        loss, J, r = self._system(theta, best)
        while count < most and not converged:
            H, g = J.T @ J, J.T @ r
            step = -np.linalg.solve(H + damping * np.diag(np.diag(H) + 1e-12), g)
            # As a whole: of a step between numbers that go together, a part may lead uphill.
            tried = self._inside(theta + step * _LARGEST / max(_LARGEST, np.max(np.abs(step))))
            promise = -(g @ (tried - theta)) - 0.5 * np.sum((J @ (tried - theta)) ** 2)
            if promise <= _CONVERGED * loss:
                # Where a bound has cut the step, a more careful one may promise more.
                converged = np.allclose(tried, theta + step) or damping > _STIFFEST
                damping *= 10
                continue
            new = model.evaluate(tried)
            count += 1
            new_loss, new_J, new_r = self._system(tried, new)
            if new_loss < loss:
                theta, best, loss, J, r = tried, new, new_loss, new_J, new_r
                damping = max(damping / 10, 1e-9)
            else:
                damping *= 10
                converged = damping > _STIFFEST
        return theta, best, count, converged

    def _system(self, theta, evaluation: Evaluation):
        """Half the sum of squares, the Jacobian, and all residuals, those of priors last."""
        r, J = self.prior_rows(theta)
        size = np.sqrt(self.weight)
        residuals = np.concatenate([size * evaluation.residuals.ravel(), r])
        jacobian = np.concatenate([size * evaluation.jacobian.reshape(-1, len(theta)), J])
        return 0.5 * float(residuals @ residuals), jacobian, residuals

    def prior_rows(self, theta):
        """(value - mean) / standard deviation, and the derivatives."""
        names = [p.name for p in self.model.parameters]
        place = {name: i for i, name in enumerate(names)}
        rows = [(place[n], self._value(place[n]), *pair) for n, pair in self.priors.items()]
        return prior_rows(rows, theta)

    def _value(self, i: int):
        """The mean of what a parameter stands for, as a function of theta."""
        parameter = self.model.parameters[i]
        initial = parameter.get(self.model.setup)
        return lambda theta: jnp.mean(jnp.asarray(parameter.scale.value(initial, theta)))

    def _inside(self, theta):
        return np.clip(theta, *self.ends())

    def ends(self):
        """Lowest and highest theta, (parameters,) each."""
        ends = np.array([[-p.scale.largest, p.scale.largest] for p in self.model.parameters])
        for i, parameter in enumerate(self.model.parameters):
            if parameter.name in self.bounds:
                initial = np.asarray(parameter.get(self.model.setup))
                own = [parameter.scale.theta(initial, x) for x in self.bounds[parameter.name]]
                ends[i] = max(ends[i, 0], own[0]), min(ends[i, 1], own[1])
        return ends.T

    def posterior(self, theta, best: Evaluation, method: str, draws: int, seed: int) -> Posterior:
        """Draws about the best place."""
        names = [p.name for p in self.model.parameters]
        rows = [(names.index(n), self._value(names.index(n)), *x) for n, x in self.priors.items()]
        believed = lambda theta: sum(((f(theta[i]) - m) / s) ** 2 for i, f, m, s in rows)
        density = log_density(self.model, believed, numbers_of(best), self.ends())
        covariance = covariance_of(self, theta, best)
        options = method, draws, seed
        return draw_posterior(self.model, density, theta, covariance, self.ends(), *options)


def numbers_of(best: Evaluation) -> int:
    """How many residuals there are."""
    return int(np.sum(np.any(best.jacobian != 0, -1) | (best.residuals != 0)))


def noise_scale_of(best: Evaluation) -> float:
    """How many times larger residuals are than the noise that was stated."""
    freedom = max(numbers_of(best) - best.jacobian.shape[-1], 1)
    return float(np.sqrt(np.sum(best.residuals**2) / freedom))


def effective_of(model: Model, best: Evaluation) -> float:
    """How many independent numbers residuals are worth: their count over how much larger sums over
    what is wrong together are than they would be of independent ones (Kish 1965)."""
    r, count = best.residuals, numbers_of(best)
    rows, markers = len(r), len(model.markers)
    places = r[:, : 6 * markers].reshape(rows, 2, markers, 3).sum(2)
    each = np.concatenate([places.reshape(rows, -1), r[:, 6 * markers :]], axis=1)
    names, trial = np.unique(model.postures.labels, return_inverse=True)
    sums = np.zeros((len(names), each.shape[1]))
    np.add.at(sums, trial.ravel(), each)
    total = max(float(np.sum(r**2)), 1e-300)
    together = [float(np.sum(x**2)) / total for x in (each, sums)[: 1 + (len(names) > 1)]]
    return count / max(1.0, *together)


def covariance_of(search: Search, theta, best: Evaluation):
    """Of theta, by linear least squares; (parameters, parameters)."""
    flat = best.jacobian.reshape(-1, len(theta))
    _, prior_J = search.prior_rows(theta)
    information = flat.T @ flat / max(noise_scale_of(best), LEAST_SCALE) ** 2 + prior_J.T @ prior_J
    vague = np.diag([(2.0 / x.scale.largest) ** 2 for x in search.model.parameters])
    return np.linalg.inv(information + vague)
