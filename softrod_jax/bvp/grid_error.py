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

from softrod_jax.rod.grid import Division, Grid
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
    division: Division | None = None,
) -> Wide:
    """What the ODE leaves of `Y_{k+1} - Y_k = integral of dy/ds` by wider formulas.

    - `rates`: dy/ds at the nodes; `rates_at(y)`: dy/ds at all points, (points, n).
    - `h` [m]: the length of an interval, or of each, (intervals, 1). No polynomial reaches from one
      part of the `division` into the next.
    """
    counts = (nodes.shape[0] - 1,) if division is None else division.counts
    index, by_value, by_rate = _between_nodes(counts, stride)
    inner = jnp.einsum("kcw,kwn->kcn", by_value, nodes[index])
    lengths = h[..., None] if jnp.ndim(h) else h
    inner = inner + lengths * jnp.einsum("kcw,kwn->kcn", by_rate, rates[index])
    body = jnp.concatenate([nodes[:-1, None], inner], axis=1)
    y = jnp.concatenate([body.reshape(-1, nodes.shape[-1]), nodes[-1:]])
    index, weights = _across_intervals(counts, stride)
    increment = h * jnp.einsum("kp,kpn->kn", weights, rates_at(y)[index])
    defect = nodes[1:] - nodes[:-1] - increment
    # What a gap between parts does is exact.
    return Wide(y, defect if division is None else defect.at[division.gaps].set(0.0))


def wide_weights(grid: Grid) -> Float[Array, "points"]:
    """Weights [m] of the integral along the rod by a quadrature over several intervals."""
    counts = (grid.intervals,) if grid.division is None else grid.division.counts
    index, weights = _across_intervals(counts, grid.stride)
    h = jnp.broadcast_to(grid.h, (grid.intervals,))[:, None]
    return jnp.zeros(grid.s.shape[0]).at[index].add(h * weights)


def tip_of(strain: Float[Array, "points 6"], grid: Grid) -> Float[Array, "3"]:
    """The tip of a rod clamped at the origin, with the spacing of its points halved."""
    counts = (grid.intervals,) if grid.division is None else grid.division.counts
    index, weights = _halfway(counts, grid.stride)
    middle = jnp.einsum("pw,pwk->pk", weights, strain[index])
    pairs = jnp.stack([strain[:-1], middle], axis=1).reshape(-1, strain.shape[-1])
    fine = jnp.concatenate([pairs, strain[-1:]])
    # Four halves of a spacing for one of Boole's rules.
    h = grid.h * (2 / grid.stride)
    if grid.division is not None:
        h = jnp.repeat(h, grid.stride // 2)
    return integrate_shape(fine, h, *ORIGIN, np.arange(5) / 4, BOOLE)[0][-1]


def roughness(
    bend: Float[Array, "points turn"],
    stretch: Float[Array, "points vector"] | None,
    order: int,
    grid: Grid,
) -> Float[Array, ""]:
    """Differences of the strains along the rod of this order, as the tip sees them, in lengths.

    Their mean along the rod: a front of stretch that runs along it moves the tip little. In each
    part of the rod by itself.
    """
    rough = lambda x: jnp.max(jnp.abs(jnp.diff(x, order, axis=0)), -1)
    total = jnp.zeros(())
    for part in grid.parts():
        points = part.stop - part.start
        # A turn of a section moves the tip by its distance from it.
        if grid.division is None:
            arm, share = np.linspace(1.0, 0.0, points) * grid.length, 1.0
        else:
            arm = grid.length - grid.s[part]
            share = (grid.s[part.stop - 1] - grid.s[part.start]) / grid.length
        arm = jnp.convolve(arm, np.ones(order + 1) / (order + 1), "valid")
        moved = arm * rough(bend[part])
        moved = moved if stretch is None else rough(stretch[part]) + moved
        total = total + share * jnp.mean(moved)
    return total


def hidden_turns(bend: Float[Array, "points turn"], grid: Grid) -> Float[Array, ""]:
    """A lower bound for the estimate where intervals turn too far; else zero."""
    size = jnp.sqrt(jnp.sum(bend**2, -1))
    if grid.division is None:
        turn = grid.h * jnp.mean(size)
    else:
        inside = size[:-1].reshape(-1, grid.stride)
        turn = jnp.max(grid.h * jnp.mean(inside, axis=1))
    return jnp.where(turn > _MOST_TURN, _HIDDEN * (turn / _MOST_TURN) ** 6, 0.0)


def _joined(counts: tuple[int, ...], of_part: Callable, of_gap: Callable):
    """Tables of parts and of the gaps between them, one after the other.

    `of_part(n)`: index and weights of a part of n intervals, the last axis of both as wide as
    its formula; `of_gap()` likewise. Indices count from the beginning of the part, and rows are
    filled up with weights of zero. `advance`, the first of each, is how far the next one is.
    """
    rows, first = [], 0
    for k, n in enumerate(counts):
        if k:
            advance, index, *weights = of_gap()
            rows.append((first + index, *weights))
            first += advance
        if n:
            advance, index, *weights = of_part(n)
            rows.append((first + index, *weights))
            first += advance
    width = max(row[0].shape[-1] for row in rows)
    fill = lambda x: np.pad(x, [(0, 0)] * (x.ndim - 1) + [(0, width - x.shape[-1])])
    return tuple(np.concatenate([fill(x) for x in column]) for column in zip(*rows))


@functools.cache
def _between_nodes(counts: tuple[int, ...], stride: int):
    """Hermite interpolation at the inner points of each interval.

    The nodes that it uses, (n, w), and the weights (n, stride - 1, w) of states and of h dy/ds.
    """
    one = np.ones((1, stride - 1, 1))
    gap = lambda: (1, np.zeros((1, 1), int), one, 0 * one)
    return _joined(counts, lambda n: (n, *_hermite(n, stride)), gap)


@functools.cache
def _across_intervals(counts: tuple[int, ...], stride: int):
    """Quadrature over each interval from points beyond it: the points, (n, w), and weights."""
    gap = lambda: (stride, np.zeros((1, 1), int), np.zeros((1, 1)))
    return _joined(counts, lambda n: (n * stride, *_quadrature(n, stride)), gap)


@functools.cache
def _halfway(counts: tuple[int, ...], stride: int):
    """Lagrange interpolation half-way between points: those it uses, and its weights."""
    gap = lambda: (stride, np.arange(stride)[:, None], np.ones((stride, 1)))
    return _joined(counts, lambda n: (n * stride, *_lagrange(n * stride + 1)), gap)


def _hermite(n: int, stride: int):
    """`_between_nodes` of one part."""
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


def _quadrature(n: int, stride: int):
    """`_across_intervals` of one part."""
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


def _lagrange(points: int):
    """`_halfway` of one part."""
    width = min(_STRAINS, points)
    gap = np.arange(points - 1)
    first = np.clip(gap - (width // 2 - 1), 0, points - width)
    power = np.arange(width)
    x = first[:, None] + np.arange(width) - gap[:, None] - 0.5
    at = (power == 0).astype(float)
    weights = np.stack([np.linalg.solve(row[None] ** power[:, None], at) for row in x])
    return first[:, None] + np.arange(width), weights
