"""The interface of a method along the rod: equations between nodes, and their linearisation.

Both methods, `Collocation` and `Shooting`, turn the rod ODE into one equation per interval,
`defect_k(Y_k, Y_{k+1}) = 0`, between the states at the nodes. A method may have more unknowns
inside its intervals and eliminate them from the linear equations by itself. Newton's method, the
sweeps, the time stepping and the gradients are written once, on top of this interface.
"""

import abc
from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
from jaxtyping import Array, Float

from softrod_jax.rod.constants import Rod
from softrod_jax.rod.grid import Grid
from softrod_jax.rod.state import History, Layout
from softrod_jax.scene.scene import Scene


class Guess(NamedTuple):
    """States and strains at the points of the method: of an answer, or where Newton starts.

    `multipliers`: those of the rod's constraint, where it has one.
    """

    y: Float[Array, "points n"]
    strain: Float[Array, "points strain"]
    multipliers: Float[Array, "conditions"] | None = None


class Linear(NamedTuple):
    """d(defect_k)/dY_k and d(defect_k)/dY_{k+1}, and what a method needs for its inner unknowns."""

    left: Float[Array, "intervals n n"]
    right: Float[Array, "intervals n n"]
    inner: Any


class AbstractMethod(eqx.Module):
    """A way to solve the rod ODE along the rod; `intervals` between `intervals + 1` nodes.

    `order`: by which power of the spacing the error falls. `max_error`: the estimated error, in
    lengths of the rod, up to which a solution counts as one.

    The unknowns are an array (rows, columns) whose shape is up to the method. `guess` holds
    strains (points, 6) from which pointwise solves start, where a method needs any.
    """

    intervals: eqx.AbstractVar[int]
    order: eqx.AbstractVar[int]
    max_error: eqx.AbstractVar[float]

    @abc.abstractmethod
    def finer(self) -> "AbstractMethod":
        """The same method on a grid of half the spacing."""

    @abc.abstractmethod
    def fitted(self, scene: Scene) -> "AbstractMethod":
        """The same method with nodes where segments, tendons and chambers end and loads act."""

    @abc.abstractmethod
    def grid(self, scene: Scene) -> Grid:
        """Where strains and velocities are kept, of a method that is fitted to the scene."""

    @abc.abstractmethod
    def outputs(self, points: Float[Array, "points *rest"]) -> Float[Array, "outputs *rest"]:
        """The entries of a points array that a user gets to see; both ends are among them."""

    @abc.abstractmethod
    def shape(
        self, strain: Float[Array, "points 6"], grid: Grid, base_position, base_quaternion
    ) -> tuple[Float[Array, "outputs 3"], Float[Array, "outputs 4"]]:
        """Positions (outputs, 3) and quaternions (outputs, 4) from the strains at the points."""

    @abc.abstractmethod
    def inside(self, points: Float[Array, "points *rest"]) -> Float[Array, "intervals k *rest"]:
        """Values at equally spaced points between one output and the next, with both of them."""

    @abc.abstractmethod
    def unknowns(self, guess: Guess, rod: Rod) -> Float[Array, "rows columns"]:
        """The unknowns, at a guess."""

    @abc.abstractmethod
    def states(self, U: Float[Array, "rows columns"], layout: Layout) -> Float[Array, "nodes n"]:
        """The states at the nodes."""

    @abc.abstractmethod
    def fields(self, U, rod: Rod, layout: Layout, history, guess) -> Guess:
        """The rod at all points."""

    @abc.abstractmethod
    def error(self, U, rod: Rod, layout: Layout, guess, correct: Callable) -> Float[Array, ""]:
        """The estimated error of an equilibrium's tip from the grid, in lengths of the rod.

        `correct(residual)`: the correction of the unknowns for a residual along the rod.
        """

    @abc.abstractmethod
    def error_in_motion(
        self, fields: Guess, rod: Rod, layout: Layout, history: History, guess
    ) -> Float[Array, ""]:
        """The same at an instant of a motion: the error if the rod were held in this state."""

    @abc.abstractmethod
    def residual(self, U, rod: Rod, layout: Layout, history, guess) -> Any:
        """What is zero at the solution: a pytree. Not finite where it does not exist."""

    @abc.abstractmethod
    def linearise(
        self, U, rod: Rod, layout: Layout, history, guess, single: bool = False
    ) -> Linear:
        """The derivative of `residual`, the inner unknowns eliminated; `single`: in float32."""

    @abc.abstractmethod
    def condense(self, inner, residual) -> tuple[Float[Array, "intervals n"], Any]:
        """The right-hand side of the equations between nodes, and what `expand` needs."""

    @abc.abstractmethod
    def expand(self, inner, condensed, dY: Float[Array, "nodes n"]) -> Float[Array, "rows columns"]:
        """The correction of all unknowns, from that of the nodes."""
