"""Natural frequencies, damping ratios and shapes of a robot about an equilibrium.

With x = X x_t (`near_rest.py`), a motion x exp(lambda t) has X x = x / lambda: the slow modes are
the largest eigenvalues of X, of which rounding spoils least.

The derivative of an eigenvalue is by the change of X between its left and its right eigenvector,
and that of X by the equations it follows from, with the equilibrium: no derivative of an
eigenvector, or of X as a whole, is needed.
"""

from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Complex, Float, Int, Real

from softrod_jax.analysis.near_rest import NearRest, check_smooth, near_rest
from softrod_jax.analysis.seen import shape
from softrod_jax.bvp.method import AbstractMethod
from softrod_jax.bvp.newton import NewtonOptions
from softrod_jax.foundation.compiling import compiled
from softrod_jax.foundation.numbers import ScalarLike
from softrod_jax.foundation.precision import require_float64
from softrod_jax.scene.checks import checked_scene
from softrod_jax.scene.inputs import Inputs, checked_inputs, filled, whole_number
from softrod_jax.scene.scene import Scene
from softrod_jax.statics import StaticSolution, solve_static

# More are computed than are asked for, so that what coincides with the last of these is complete.
_SPARE = 4


class Modes(eqx.Module):
    """Small motions about an equilibrium, each a shape times exp(lambda t), the slowest first.

    - `eigenvalues` lambda [1/s], (modes,), complex. Of a pair that is conjugate, the one with the
      positive imaginary part; a motion that creeps or runs away without turning has a real one.
    - `frequencies` [Hz], (modes,): |lambda| / 2 pi, that of the same mode without damping where
      damping is light. `damping_ratios`: -Re lambda / |lambda|, 1 for what creeps, below 0 for
      what grows.
    - `shapes`, (modes, outputs, 3): the displacement of the axis, complex, its largest 1; of what
      only twists, and of what only creeps inside, zero. Shapes have no derivatives.
    - `arc_lengths` [m], (outputs,), of the shapes; `equilibrium`: the `StaticSolution`; `result`:
      its code.
    """

    eigenvalues: Complex[Array, "modes"]
    shapes: Complex[Array, "modes outputs 3"]
    arc_lengths: Float[Array, "outputs"]
    equilibrium: StaticSolution
    result: Int[Array, ""]

    @property
    def frequencies(self) -> Float[Array, "modes"]:
        """[Hz]."""
        return jnp.abs(self.eigenvalues) / (2 * jnp.pi)

    @property
    def damping_ratios(self) -> Float[Array, "modes"]:
        """[-]."""
        return -self.eigenvalues.real / jnp.abs(self.eigenvalues)


def modes(
    scene: Scene,
    tensions: Real[Array | np.ndarray, "by_tension"] | Sequence[ScalarLike] | None = None,
    pressures: Real[Array | np.ndarray, "chambers"] | Sequence[ScalarLike] | None = None,
    pulls: Real[Array | np.ndarray, "by_length"] | Sequence[ScalarLike] | None = None,
    *,
    count: int = 6,
    before: StaticSolution | None = None,
    method: AbstractMethod | None = None,
    newton: NewtonOptions = NewtonOptions(),
    throw: bool = True,
) -> Modes:
    """The `count` slowest modes of `scene` about its equilibrium under these inputs.

    The other arguments are those of `solve_static`. Actuators hold what is given: the tension of a
    tendon driven by tension, the length of one driven by length (at pull 0 where none is given).

    Works under `jit`, `grad` and `jacfwd` (eigenvalues only, the first derivative only). Of
    eigenvalues that coincide, the derivative is right where they go on to coincide, as the two of a
    round rod do when its modulus changes. Raises `ValueError` as `linearise` does, and for a
    `count` below 1 or above what the grid has.
    """
    require_float64("modes")
    count = whole_number("modes", "count", count)
    given, scene = scene, checked_scene("modes", scene)
    check_smooth("modes", scene)
    given_inputs = checked_inputs("modes", scene, Inputs(tensions, pressures, pulls), ndim=1)
    inputs: Any = given_inputs._replace(pulls=filled(scene, given_inputs).pulls)
    solution = solve_static(
        given, *inputs, before=before, method=method, newton=newton, throw=throw
    )
    near = near_rest(scene, inputs, solution)
    most = sum(x.size for x in near.at_rest if x is not None) // 4
    if count > most:
        raise ValueError(
            f"modes: count={count}; this grid has {most} that mean anything; take more intervals"
        )
    eigenvalues, shapes = _slowest(near, count)
    return Modes(eigenvalues, shapes, solution.arc_lengths, solution, solution.result)


@compiled
def _slowest(near: NearRest, count: int):
    """Eigenvalues, with their derivatives, and displacements, (count, outputs, 3)."""
    ravel = lambda x: ravel_pytree(x)[0]
    rest, still = ravel(near.at_rest), jax.lax.stop_gradient(near)
    as_rates, as_unknowns = ravel_pytree(near.at_rest)[1], ravel_pytree(near.unknowns)[1]
    fields = lambda near, U, z: ravel(near.fields(U, as_rates(z), near.applied)[0])
    residual = lambda near, U, z: near.residual(U, as_rates(z), near.applied)
    follow = still.following()

    def seen(U, rates, applied):
        return ravel(still.fields(U, rates, applied)[0]), ravel(U)

    X, unknowns = still.along(jnp.eye(rest.size), seen, follow, as_rates, lambda z: still.applied)
    mu, left, right = _largest(X.T, count)

    def pulled(row):
        """The change of the fields along `row`, by that of the equations."""

        def answer(F):
            at, dU = still.unknowns, follow(F)
            return jax.jvp(lambda U: fields(still, U, rest), (at,), (dU,))[1]

        F = jax.tree.map(jnp.zeros_like, residual(still, still.unknowns, rest))
        return jax.linear_transpose(answer, F)(row)[0]

    def displaced(dU):
        def axis(U):
            return shape(still, still.fields(U, still.at_rest, still.applied)[1], still.applied)[0]

        return jax.jvp(axis, (still.unknowns,), (dU,))[1]

    def of_one(vectors):
        mu, left, right = vectors
        parts, rows = (jnp.stack([x.real, x.imag]) for x in (right, left))
        forces = jax.lax.map(pulled, rows)

        def changed(part):
            """The change of X along the vector, seen by both parts of the left one, (2,)."""
            at, along = (near.unknowns, rest), (as_unknowns(part @ unknowns), part)
            F = jax.jvp(lambda U, z: residual(near, U, z), at, along)[1]
            x = jax.jvp(lambda U, z: fields(near, U, z), at, along)[1]
            sums = jax.tree.map(lambda a, b: jnp.sum(a * b, range(1, a.ndim)), forces, F)
            return rows @ x + sum(jax.tree.leaves(sums))

        (a, b), (c, d) = jax.lax.map(changed, parts)
        change = (a - d) + 1j * (b + c)
        x, y = jax.lax.map(lambda part: displaced(as_unknowns(part @ unknowns)), parts)
        # The change itself is no number of interest; its derivative is that of mu.
        return 1 / (mu + (change - jax.lax.stop_gradient(change))), _scaled(x + 1j * y, still)

    return jax.lax.map(of_one, (mu, left, right))


def _largest(X, count: int):
    """The `count` largest eigenvalues mu, one of each pair, and left and right vectors, (count, n).

    A left vector times the right one that belongs to it is 1.
    """
    mu, left, right = jax.lax.linalg.eig(
        X, compute_left_eigenvectors=True, compute_right_eigenvectors=True
    )
    # 1 / mu has the other sign of the imaginary part.
    chosen = jnp.argsort(jnp.where(mu.imag <= 0, -jnp.abs(mu), 0.0))[: count + _SPARE]
    left, right = jnp.conj(left[:, chosen]).T, right[:, chosen]
    # Vectors of eigenvalues that coincide are any of their space: each left one belongs to one.
    left = jnp.linalg.solve(left @ right, left)
    return mu[chosen[:count]], left[:count], right.T[:count]


def _scaled(displacement, near: NearRest):
    """Its largest component 1; zero where nothing is displaced."""
    flat = displacement.ravel()
    largest = flat[jnp.argmax(jnp.abs(flat))]
    moves = jnp.abs(largest) > 1e-9 * near.method.grid(near.scene).length
    return jnp.where(moves, displacement / jnp.where(moves, largest, 1.0), 0.0)
