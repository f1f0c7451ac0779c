"""Which few strains describe a rod best: of equilibria under its inputs, and of small motions.

Strains of many equilibria and of the slowest modes about some of them are taken together, and those
directions kept that hold most of their energy (proper orthogonal decomposition). Of these, modes
about the first equilibrium are made, so that what is slow and what is fast are apart.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from softrod_jax.analysis.strain_coordinates import (
    Motion,
    StrainBasis,
    imbalances,
    laws,
    strain_basis,
)
from softrod_jax.analysis.targets import Problem, answered
from softrod_jax.bvp.collocation import Collocation
from softrod_jax.foundation.compiling import compiled
from softrod_jax.rod.constants import full_strain, joined
from softrod_jax.rod.reduction import make_rod

# Of the slowest mode, its energy in terms of the mean of those of the equilibria.
_OF_MODES = 0.005


class Snapshots(NamedTuple):
    """Strains beyond those of the unloaded rod, (.., points, 6), of equilibria and of modes."""

    equilibria: Float[Array, "samples points 6"]
    solved: Float[Array, "samples"]
    modes: Float[Array, "about modes points 6"]


class Few(NamedTuple):
    """Strains, (n, points, 6), the largest of each 1, curvatures in terms of the length.

    `left`: what part of the energy of all that was looked at they do not hold.
    """

    shapes: Float[Array, "n points 6"]
    left: Float[Array, ""]


@compiled
def snapshots(problem: Problem, x: Float[Array, "samples m"], about: int, count: int) -> Snapshots:
    """Equilibria under inputs at parts `x` of the limits, and modes about the first few of them."""
    scene, method = problem.scene, problem.method
    grid = method.grid(scene)
    known = problem.solved(x)
    rod = make_rod(scene, problem.inputs(x[0]), dynamic=False, grid=grid)
    beyond = full_strain(known.guess.strain, rod) - full_strain(
        jnp.broadcast_to(rod.rest_strain, known.guess.strain.shape[1:]), rod
    )
    solved = answered(known.result) & jnp.all(jnp.isfinite(beyond), (1, 2))
    found = jax.lax.map(
        lambda at: _modes(problem, at[0], at[1], count), (x[:about], beyond[:about])
    )
    good = jnp.where(solved[:, None, None], beyond, 0.0)
    return Snapshots(good, solved.astype(float), found)


def _modes(problem: Problem, x, beyond, count: int) -> Float[Array, "modes points 6"]:
    """The slowest about an equilibrium; strains at all points are the coordinates."""
    grid = problem.method.grid(problem.scene)
    rod = make_rod(problem.scene, problem.inputs(x), dynamic=False, grid=grid)
    size, free = grid.s.shape[0], slice(None) if rod.K_se is not None else slice(3, None)
    own = jnp.eye(6 * size).reshape(size, 6, size, 6)[:, free].reshape(-1, size, 6)
    basis = strain_basis(own, grid)
    modes = _slowest(basis, rod, beyond[:, free].ravel())[:, :count]
    return jnp.tensordot(modes.T, own, 1)


def _slowest(basis: StrainBasis, rod, q) -> Float[Array, "n n"]:
    """Modes about the coordinates q, in columns, the slowest first.

    With M q_tt + K q = 0 they are the largest eigenvalues of K^-1/2 M K^-1/2.
    """
    still = jnp.zeros_like(q)
    at = lambda q, a: imbalances(basis, laws(basis, rod, None), Motion(q, still, a))
    K, M = jax.jacfwd(at, (0, 1))(q, still)
    # Loads that follow the rod have no potential; what is wanted here are shapes.
    values, vectors = jnp.linalg.eigh(0.5 * (K + K.T))
    root = vectors / jnp.sqrt(jnp.maximum(values, 1e-9 * values[-1]))
    _, modes = jnp.linalg.eigh(root.T @ (0.5 * (M + M.T)) @ root)
    return root @ modes[:, ::-1]


def fewest(problem: Problem, seen: Snapshots, order: int) -> Few:
    """The `order` strains that hold most of the energy of all that has been seen, slowest first."""
    return jax.tree.map(jax.lax.stop_gradient, _fewest(problem, seen, order))


@compiled
def _fewest(problem: Problem, seen: Snapshots, order: int) -> Few:
    scene, method = problem.scene, problem.method
    assert isinstance(method, Collocation)
    grid = method.grid(scene)
    rod = make_rod(scene, dynamic=False, grid=grid)
    K = jnp.concatenate([jnp.ones_like(rod.K_bt), rod.K_bt], -1)
    if rod.K_se is not None:
        K = joined(rod.K_se, rod.K_bt)
    # A point of no weight, beside another at a place where something jumps, is its neighbour's.
    weight = jnp.maximum(grid.weights, 1e-6 * grid.length)
    weights = jnp.sqrt(weight[:, None] * K)
    a, b = (weights * x for x in (seen.equilibria, seen.modes))
    size = jnp.sqrt(jnp.sum(a**2) / jnp.maximum(jnp.sum(seen.solved), 1.0))
    each = jnp.linalg.norm(b, axis=(2, 3), keepdims=True)
    own = jnp.sqrt(_OF_MODES) * jnp.where(size > 0, size, 1.0)
    # The slower, the more: of modes that count alike any mixture would be kept.
    own = own / jnp.arange(1, b.shape[1] + 1)[:, None, None] / jnp.sqrt(b.shape[0])
    a = a / jnp.sqrt(jnp.maximum(jnp.sum(seen.solved), 1.0))
    together = jnp.concatenate([a, (own * b / each).reshape(-1, *a.shape[1:])])
    _, values, vectors = jnp.linalg.svd(
        together.reshape(together.shape[0], -1), full_matrices=False
    )
    shapes = vectors[:order].reshape(-1, *weights.shape) / weights
    # About the first equilibrium, the slowest come first.
    q = jnp.sum(shapes * (weights**2 * seen.equilibria[0]), (1, 2))
    rod = make_rod(scene, problem.inputs(problem.rest), dynamic=False, grid=grid)
    slowest = _slowest(strain_basis(shapes, grid), rod, q)
    shapes = jnp.tensordot(slowest.T, shapes, 1)
    scale = jnp.array([1.0] * 3 + [grid.length] * 3)
    shapes = shapes / jnp.max(jnp.abs(shapes * scale), (1, 2), keepdims=True)
    return Few(shapes, jnp.maximum(1 - jnp.sum(values[:order] ** 2) / jnp.sum(values**2), 0.0))
