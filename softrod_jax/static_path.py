"""Equilibria along a path of inputs: each one is reached from the one before it."""

from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Real

from softrod_jax.bvp.collocation import Collocation
from softrod_jax.bvp.equations import loads_of, scaled_loads
from softrod_jax.bvp.load_continuation import Reached
from softrod_jax.bvp.method import AbstractMethod
from softrod_jax.bvp.newton import NewtonOptions
from softrod_jax.bvp.unloaded import unloaded_guess
from softrod_jax.foundation.compiling import compiled
from softrod_jax.foundation.numbers import ManyLike
from softrod_jax.foundation.precision import require_float64
from softrod_jax.foundation.results import raise_unless_successful
from softrod_jax.rod.ode import layout_of
from softrod_jax.rod.reduction import make_rod
from softrod_jax.scene.checks import checked_scene
from softrod_jax.scene.inputs import Inputs, checked_inputs
from softrod_jax.scene.scene import Scene
from softrod_jax.statics import StaticSolution, solve_from


def solve_path(
    scene: Scene,
    tensions: Real[Array | np.ndarray, "rows by_tension"] | Sequence[ManyLike] | None = None,
    pressures: Real[Array | np.ndarray, "rows chambers"] | Sequence[ManyLike] | None = None,
    pulls: Real[Array | np.ndarray, "rows by_length"] | Sequence[ManyLike] | None = None,
    *,
    before: StaticSolution | None = None,
    method: AbstractMethod | None = None,
    newton: NewtonOptions = NewtonOptions(),
    throw: bool = True,
) -> StaticSolution:
    """Equilibria under one row of inputs after the other; all fields have a first axis of rows.

    Between rows inputs change slowly along a straight line. Tendons with friction, actuators with
    play and rods with several equilibria remember on which way they came: a row depends on those
    before it.

    - `tensions`, `pressures`, `pulls`: as of `solve_static`, one row an equilibrium.
    - `before`: the equilibrium before the first row; the unloaded rod if `None`.
    - `method`: on the grid as given; that of `before`, or `Collocation()`, if `None`.
    - `throw`: raise `SolveError` for the first row that has no answer; else rows have codes. The
      row after one without an answer starts from the last iterate.

    Works under `jit`, `vmap`, `grad` and `jacfwd`. Raises `ValueError` as `solve_static`.
    """
    require_float64("solve_path")
    given, scene = scene, checked_scene("solve_path", scene)
    inputs = checked_inputs("solve_path", scene, Inputs(tensions, pressures, pulls), ndim=2)
    rows = {x.shape[0] for x in jax.tree.leaves(inputs)}
    if len(rows) != 1 or 0 in rows:
        raise ValueError(f"solve_path: inputs of {sorted(rows)} rows; one row an equilibrium")
    if before is not None:
        if method is not None and method.fitted(given) != before.method:
            raise ValueError("solve_path: `before` was solved with another method; leave it out")
        method = before.method
    method = (Collocation() if method is None else method).fitted(given)
    past = None if before is None else before.reached
    path = _solve_path(scene, inputs, past, method, newton)
    if throw:
        bad = path.result != 0
        first = jnp.where(jnp.any(bad), path.result[jnp.argmax(bad)], 0)
        path = raise_unless_successful(first, path, "solve_path")
    return path


def row_of(path: StaticSolution, k: int) -> StaticSolution:
    """Equilibrium `k` of a path, such as the last one, -1, to go on from."""
    return jax.tree.map(lambda x: x[k], path)


@compiled
def _solve_path(scene, inputs, past, method, options):
    first = jax.tree.map(lambda x: x[0], inputs)
    past = _unloaded(scene, first, method) if past is None else past
    arrays, static = eqx.partition(past, eqx.is_array)

    def one(past, row):
        solution = solve_from(scene, row, eqx.combine(past, static), None, method, options)
        return eqx.filter(solution.reached, eqx.is_array), solution

    return jax.lax.scan(one, arrays, inputs)[1]


def _unloaded(scene, inputs, method) -> Reached:
    """The rod without any load, as far as the first equilibrium depends on it."""
    rod = make_rod(scene, inputs, dynamic=False, grid=method.grid(scene))
    guess = unloaded_guess(layout_of(rod, dynamic=False), rod)
    slid = None if rod.friction is None else rod.friction.slid
    none = None if inputs.pulls is None else jnp.zeros_like(inputs.pulls)
    return Reached(guess, loads_of(scaled_loads(rod, 0.0)), slid, none)
