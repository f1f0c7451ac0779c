"""The interface of a method along the rod: nodes, defects between them, and their derivative.

Both methods, `Collocation` and `Shooting`, turn the rod ODE into one equation per interval,
`defect_k(Y_k, Y_{k+1}) = 0`, between the states at the nodes. Newton's method, the linear
algebra, the time stepping and the gradients are written once, on top of this interface.
"""

import abc
from typing import NamedTuple, Optional

import equinox as eqx
from jaxtyping import Array, Bool, Float

from softrod_jax.rod import Rod
from softrod_jax.rod_ode import Layout


class Defects(NamedTuple):
    """A method at given node states: the defects, and the rod at all its points.

    - `solvable`: whether the strains exist at every point (see `constitutive.py`).
    - `error`: estimated error of the states, in sizes of the problem: about the error of the
      tip in lengths of the rod. `None`: the method has no estimate.
    """

    defect: Float[Array, "intervals n"]
    y: Float[Array, "points n"]
    strain: Float[Array, "points 6"]
    solvable: Bool[Array, ""]
    error: Optional[Float[Array, ""]] = None


class Method(eqx.Module):
    """A way to solve the rod ODE along the rod; `intervals` between `intervals + 1` nodes.

    `max_error`: the estimated error up to which a solution counts as one.
    """

    intervals: eqx.AbstractVar[int]
    max_error: eqx.AbstractVar[float]

    @abc.abstractmethod
    def points(self, length) -> Float[Array, "points"]:
        """Arc lengths [m], evenly refined, where strains and velocities are kept."""

    @abc.abstractmethod
    def nodes(self, points: Float[Array, "points *rest"]) -> Float[Array, "nodes *rest"]:
        """The entries of a points array that belong to nodes."""

    @abc.abstractmethod
    def outputs(self, points: Float[Array, "points *rest"]) -> Float[Array, "outputs *rest"]:
        """The entries of a points array that a user gets to see; both ends are among them."""

    @abc.abstractmethod
    def shape(self, strain: Float[Array, "points 6"], length, base_position, base_quaternion):
        """Positions (outputs, 3) and quaternions (outputs, 4) from the strains at the points."""

    @abc.abstractmethod
    def defects(
        self, Y: Float[Array, "nodes n"], rod: Rod, layout: Layout, history, guess
    ) -> Defects:
        """Defects of the node states `Y`; `guess` (points, 6): strains to start from."""

    @abc.abstractmethod
    def blocks(self, at: Defects, rod: Rod, layout: Layout, history):
        """d(defect_k)/dY_k and d(defect_k)/dY_{k+1}, each (intervals, n, n)."""
