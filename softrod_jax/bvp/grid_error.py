"""How far the grid along the rod moves the tip: the defect of a wider formula, and what it does.

Every interval is solved by a formula that sees this interval alone. Here polynomials through the
nodes of several intervals say what the states are in between, and a quadrature over several
intervals what the rod ODE makes of them: both are of higher order than the method. What the ODE
leaves there is the defect of the solution. Carried through the equations' own linearisation, as
one more correction of Newton's method, it becomes the error of the solution (defect correction;
Stetter, Numer. Math. 29, 1978), and an integration on half the spacing the error of the tip.

All points of a method are equally spaced here, `stride` spacings to an interval.
"""

import functools
from collections.abc import Callable
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from softrod_jax.rod.shape import BOOLE, ORIGIN, integrate_shape

# Where the order is reached, a correction is the error; where an interval is longer than a layer
# of bending, it is half of that at the least.
CAUTION = 2.0
# Nodes of the polynomial through states and rates, and points of the wider quadrature on either
# side of an interval.
_NODES, _BESIDE = 4, 2
# Points of the polynomial through the strains that halves their spacing.
_STRAINS = 8
# Where intervals turn by more than this [rad] on average, they may hide whole turns from every
# formula that knows the rod at a few points only. On coils of 6 and 24 turns the estimate without
# caution was four fifths of the error at 0.8, a seventh of it at 1.6, and anything at 6. There, the
# errors were 2e-4 and 4e-4 at 1.6, 7e-3 and 2e-2 at 3.1.
_MOST_TURN, _HIDDEN = 1.2, 1e-3


class Wide(NamedTuple):
    """States at all points by polynomials through the nodes, and the defects of the intervals."""

    y: Float[Array, "points n"]
    defect: Float[Array, "intervals n"]


def wide_defect(
    nodes: Float[Array, "nodes n"],
    rates: Float[Array, "nodes n"],
    h,
    stride: int,
    rates_at: Callable,
) -> Wide:
    """What the ODE leaves of `Y_{k+1} - Y_k = integral of dy/ds` by wider formulas.

    - `rates`: dy/ds at the nodes; `rates_at(y)`: dy/ds at all points, (points, n).
    - `h` [m]: the length of an interval.
    """
    n = nodes.shape[0] - 1
    index, by_value, by_rate = _between_nodes(n, stride)
    inner = jnp.einsum("kcw,kwn->kcn", by_value, nodes[index])
    inner = inner + h * jnp.einsum("kcw,kwn->kcn", by_rate, rates[index])
    body = jnp.concatenate([nodes[:-1, None], inner], axis=1)
    y = jnp.concatenate([body.reshape(-1, nodes.shape[-1]), nodes[-1:]])
    index, weights = _across_intervals(n, stride)
    increment = h * jnp.einsum("kp,kpn->kn", weights, rates_at(y)[index])
    return Wide(y, nodes[1:] - nodes[:-1] - increment)


def tip_of(strain: Float[Array, "points 6"], length) -> Float[Array, "3"]:
    """The tip of a rod clamped at the origin, with the spacing of its points halved."""
    index, weights = _halfway(strain.shape[0])
    middle = jnp.einsum("pw,pwk->pk", weights, strain[index])
    pairs = jnp.stack([strain[:-1], middle], axis=1).reshape(-1, strain.shape[-1])
    fine = jnp.concatenate([pairs, strain[-1:]])
    return integrate_shape(fine, length, *ORIGIN, np.arange(5) / 4, BOOLE)[0][-1]


def roughness(
    bend: Float[Array, "points k"], stretch: Float[Array, "points k"] | None, order: int, length
) -> Float[Array, ""]:
    """Differences of the strains along the rod of this order, as the tip sees them, in lengths.

    Their mean along the rod: a front of stretch that runs along it moves the tip little.
    """
    rough = lambda x: jnp.max(jnp.abs(jnp.diff(x, order, axis=0)), -1)
    # A turn of a section moves the tip by its distance from it.
    arm = np.linspace(1.0, 0.0, bend.shape[0])
    arm = np.convolve(arm, np.ones(order + 1) / (order + 1), "valid") * length
    moved = arm * rough(bend)
    return jnp.mean(moved if stretch is None else rough(stretch) + moved)


def hidden_turns(bend: Float[Array, "points k"], h) -> Float[Array, ""]:
    """A lower bound for the estimate where intervals of length `h` turn too far; else zero."""
    turn = h * jnp.mean(jnp.sqrt(jnp.sum(bend**2, -1)))
    return jnp.where(turn > _MOST_TURN, _HIDDEN * (turn / _MOST_TURN) ** 6, 0.0)


@functools.cache
def _between_nodes(n: int, stride: int):
    """Hermite interpolation at the inner points of each interval.

    The nodes that it uses, (n, w), and the weights (n, stride - 1, w) of states and of h dy/ds.
    """
    width = min(_NODES, n + 1)
    at = np.arange(1, stride) / stride
    first = np.clip(np.arange(n) - (width // 2 - 1), 0, n + 1 - width)
    by_value, by_rate = np.zeros((2, n, stride - 1, width))
    power = np.arange(2 * width)
    for k in range(n):
        x = first[k] + np.arange(width) - k - 0.5
        values = x[:, None] ** power
        slopes = power * x[:, None] ** np.maximum(power - 1, 0)
        conditions = np.concatenate([values, slopes]).T
        weights = np.linalg.solve(conditions, (at - 0.5) ** power[:, None])
        by_value[k], by_rate[k] = weights[:width].T, weights[width:].T
    return first[:, None] + np.arange(width), by_value, by_rate


@functools.cache
def _across_intervals(n: int, stride: int):
    """Quadrature over each interval from points beyond it: the points, (n, w), and weights."""
    points = n * stride + 1
    width = min(stride + 1 + 2 * _BESIDE, points)
    start = np.arange(n) * stride
    first = np.clip(start - _BESIDE, 0, points - width)
    power = np.arange(width)
    integral = (0.5 ** (power + 1) - (-0.5) ** (power + 1)) / (power + 1)
    weights = []
    for k in range(n):
        x = (first[k] + np.arange(width) - start[k]) / stride - 0.5
        weights.append(np.linalg.solve(x[None] ** power[:, None], integral))
    return first[:, None] + np.arange(width), np.array(weights)


@functools.cache
def _halfway(points: int):
    """Lagrange interpolation half-way between points: those it uses, and its weights."""
    width = min(_STRAINS, points)
    gap = np.arange(points - 1)
    first = np.clip(gap - (width // 2 - 1), 0, points - width)
    power = np.arange(width)
    x = first[:, None] + np.arange(width) - gap[:, None] - 0.5
    at = (power == 0).astype(float)
    weights = np.stack([np.linalg.solve(row[None] ** power[:, None], at) for row in x])
    return first[:, None] + np.arange(width), weights
