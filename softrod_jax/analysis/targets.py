"""How far a rod is from a target, as a function of its inputs, and the derivative of that.

An equilibrium is found from that of inputs nearby by Newton's method alone, and its last factors
give the derivative. Where that fails, the search takes a shorter step.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float, Int

from softrod_jax.analysis.least_effort import Evaluated
from softrod_jax.bvp.boundary_value import search_directly
from softrod_jax.bvp.equations import Equations
from softrod_jax.bvp.method import AbstractMethod, Guess
from softrod_jax.bvp.newton import NewtonOptions
from softrod_jax.foundation.compiling import compiled, on_cpu
from softrod_jax.foundation.results import RESULTS
from softrod_jax.rod.constants import full_strain
from softrod_jax.rod.markers import seen
from softrod_jax.rod.reduction import clamp_pose, make_rod
from softrod_jax.rod.rotations import turn_between
from softrod_jax.rod.shape import Pose
from softrod_jax.rod.state import layout_of
from softrod_jax.scene.inputs import Inputs
from softrod_jax.scene.scene import Scene
from softrod_jax.statics import solve_from


class Known(NamedTuple):
    """Equilibria under inputs at parts `x` of the limits; `guess`: states and strains of them."""

    x: Float[Array, "samples m"]
    pose: Pose
    result: Int[Array, "samples"]
    guess: Guess


class Problem(eqx.Module):
    """What all targets share; `tolerance` in lengths of the rod and radians."""

    scene: Scene
    low: Inputs
    high: Inputs
    tolerance: Float[Array, ""]
    of: str = eqx.field(static=True)
    method: AbstractMethod = eqx.field(static=True)
    newton: NewtonOptions

    @property
    def rest(self) -> Float[Array, "m"]:
        """Where effort is zero, in parts of the limits."""
        low, high = ravel_pytree(self.low)[0], ravel_pytree(self.high)[0]
        return (jnp.clip(0.0, low, high) - low) / (high - low)

    def inputs(self, x: Float[Array, "m"]) -> Inputs:
        """Those at parts `x` of the limits."""
        low, as_inputs = ravel_pytree(self.low)
        return as_inputs(low + x * (ravel_pytree(self.high)[0] - low))

    def solved(self, x: Float[Array, "samples m"]) -> Known:
        """The equilibria that `solve_static` finds."""
        return _solved(self, x)

    def evaluate(self, x: Float[Array, "m"], guess: Guess, target, quaternion) -> Evaluated:
        """What is missed at `x`, from the equilibrium `guess` of inputs nearby."""
        U, found, factors = search_directly(
            self._equations(x, guess), self.newton, self._equations(x, guess).start(guess)
        )
        tight = None if U.multipliers is None else U.multipliers > 0
        length = self.scene.length

        def residual(U, x):
            fields = self._equations(x, guess).fields(U)
            return missed(self.pose(x, fields), target, quaternion, length)

        def along(direction):
            changed = lambda x: self._equations(x, guess).equalities(U, tight)
            F = jax.jvp(changed, (x,), (direction,))[1]
            dU = self._equations(x, guess).correct_equalities(factors, F, tight)
            return jax.jvp(residual, (U, x), (dU, direction))[1]

        eye = jnp.eye(x.shape[0])
        J = (jax.lax.map(along, eye) if on_cpu() else jax.vmap(along)(eye)).T
        solved = (found.result == RESULTS.successful) & jnp.all(jnp.isfinite(J))
        return Evaluated(residual(U, x), J, solved, self._equations(x, guess).fields(U))

    def _equations(self, x, guess: Guess) -> Equations:
        grid = self.method.grid(self.scene)
        rod = make_rod(self.scene, self.inputs(x), dynamic=False, grid=grid)
        return Equations(self.method, layout_of(rod, dynamic=False), rod, None, guess.strain)

    def pose(self, x, fields: Guess) -> Pose:
        """Of what is to be brought to a target, in the equilibrium `fields`."""
        scene, method, grid = self.scene, self.method, self.method.grid(self.scene)
        rod = make_rod(scene, self.inputs(x), dynamic=False, grid=grid)
        strain = full_strain(fields.strain, rod)
        positions, quaternions = method.shape(strain, grid, *clamp_pose(scene))
        nodes = method.outputs(grid.s)
        return seen(scene, method.inside(strain), nodes, positions, quaternions)[self.of]


@compiled
def _solved(problem: Problem, x):
    def one(x):
        inputs = problem.inputs(x)
        end = solve_from(problem.scene, inputs, None, None, problem.method, problem.newton)
        return Known(x, end.markers[problem.of], end.result, end.reached.guess)

    return jax.lax.map(one, x) if on_cpu() else jax.vmap(one)(x)


def missed(pose: Pose, target, quaternion, length) -> Float[Array, "r"]:
    """Distances in lengths of the rod and, where asked for, twice the sines of half the angles."""
    r = (pose.position - target) / length
    if quaternion is None:
        return r
    return jnp.concatenate([r, 2 * turn_between(pose.quaternion, quaternion)])


def answered(result):
    """Whether there is an equilibrium, be it on too coarse a grid."""
    return (result == RESULTS.successful) | (result == RESULTS.inaccurate)
