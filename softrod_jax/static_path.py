"""Equilibria along a path of inputs: each one is reached from the one before it."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Real

from softrod_jax.bvp.collocation import Collocation
from softrod_jax.bvp.equations import loads_of, scaled_loads
from softrod_jax.bvp.grid_control import DEFAULT_TOLERANCE, first_grid, solve_within
from softrod_jax.bvp.load_continuation import Reached
from softrod_jax.bvp.method import AbstractMethod
from softrod_jax.bvp.newton import NewtonOptions
from softrod_jax.bvp.unloaded import unloaded_guess
from softrod_jax.foundation.compiling import compiled
from softrod_jax.foundation.numbers import ManyLike
from softrod_jax.foundation.precision import require_float64
from softrod_jax.foundation.results import RESULTS, raise_unless_successful
from softrod_jax.foundation.tracing import is_traced
from softrod_jax.rod.reduction import make_rod
from softrod_jax.rod.state import layout_of
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
    before it. Where the path of equilibria ends, as in snapping, no damped motion goes on: the row
    beyond has a code.

    - `tensions`, `pressures`, `pulls`: as of `solve_static`, one row an equilibrium.
    - `before`: the equilibrium before the first row; the unloaded rod if `None`.
    - `method`: on the grid as given; that of `before`, or `Collocation()`, refined until every
      row's tip is good to 1e-4 lengths of the rod, if `None`. Under `jit`, `vmap` and `grad` it is
      not refined.
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
    past = None if before is None else before.reached
    refined = method is None and not is_traced((scene, inputs))
    if method is None:
        method = first_grid(Collocation(), scene) if refined else Collocation()
    method = method.fitted(given)
    solve = lambda method: _solve_path(scene, inputs, past, method, newton)
    path = _refined(solve, method) if refined else solve(method)
    if throw:
        bad = path.result != 0
        first = jnp.where(jnp.any(bad), path.result[jnp.argmax(bad)], 0)
        path = raise_unless_successful(first, path, "solve_path")
    return path


def _refined(solve: Callable, method: AbstractMethod) -> StaticSolution:
    """On a grid so fine that every row is good enough, if there is one."""
    best = None

    def worst(method):
        nonlocal best
        best = solve(method)
        code = best.result[jnp.argmax(best.result != RESULTS.successful)]
        return _Worst(code, {"error": jnp.max(best.stats["error"])})

    solve_within(worst, method, DEFAULT_TOLERANCE)
    assert best is not None, "it is solved once at least"
    coarse = (best.result == RESULTS.successful) & (best.stats["error"] > DEFAULT_TOLERANCE)
    codes = jnp.where(coarse, RESULTS.inaccurate, best.result).astype(jnp.int32)
    return eqx.tree_at(lambda x: x.result, best, codes)


class _Worst(NamedTuple):
    """The first code of a path that is none of success, and its largest error."""

    result: Array
    stats: dict


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
