"""Where the points along the rod are: nodes stand where something jumps.

Sections, materials, tendons and chambers may begin and end along the rod, and loads act there. N
and M are known on both sides of such a place, and strains jump. So two nodes stand at it, with an
interval of no length between them: what acts there is what this interval changes.

How many intervals each part gets is part of the program; where they are is a number that can be
traced. If the places are traced, too, their order is not known, and each is a place by itself.
"""

import dataclasses
import math
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float, Int

from softrod_jax.scene.scene import Scene

Scalar = Float[Array, ""]

# Places that are closer than this part of the rod's length are one.
_TOGETHER = 1e-9
# Intervals of a part at least.
_LEAST = 2


@dataclasses.dataclass(frozen=True)
class Division:
    """How a rod is divided. Static: part of the program.

    - `counts`: intervals of each part; between one part and the next is an interval of no length.
    - `places`: which of the scene's places (`places_of`) lie between the parts, in their order;
      `None` where that is known only when the program runs: then all do.
    - `at`: for each of the scene's places the number of the gap between parts that it is, or -1
      where nothing jumps. Unknown with `places`.
    """

    counts: tuple[int, ...]
    places: tuple[int, ...] | None = None
    at: tuple[int, ...] | None = None

    @property
    def intervals(self) -> int:
        """All intervals, with those of no length."""
        return sum(self.counts) + len(self.counts) - 1

    @property
    def gaps(self) -> np.ndarray:
        """The numbers of the intervals of no length."""
        return np.cumsum(self.counts)[:-1] + np.arange(len(self.counts) - 1)

    def fits(self, other: "Division") -> bool:
        """Whether both divide at the same places, or this one knows more about them."""
        same = (self.places, self.at) == (other.places, other.at)
        return same or (self.at is not None and other.at is None)

    def finer(self) -> "Division":
        """With twice as many intervals in each part."""
        return dataclasses.replace(self, counts=tuple(2 * n for n in self.counts))

    def part_of_interval(self) -> np.ndarray:
        """The part that each interval belongs to; one of no length, to the part after it."""
        sizes = [n + (k > 0) for k, n in enumerate(self.counts)]
        owner = np.arange(len(self.counts))
        # Parts of no length, beside a load at an end, are like their neighbours.
        if self.counts[-1] == 0:
            owner[-1] = owner[-2]
        if self.counts[0] == 0:
            owner[0] = owner[1]
        return np.repeat(owner, sizes)

    def part_of_point(self, stride: int) -> np.ndarray:
        """The part that each point belongs to, with `stride` points to an interval."""
        owner = self.part_of_interval()
        part = np.append(np.repeat(owner, stride), owner[-1])
        for gap in self.gaps:  # its left node ends the part before it
            if gap > 0:
                part[gap * stride] = owner[gap - 1]
        return part


class Grid(eqx.Module):
    """The points along a rod.

    - `length` [m]; `s` [m], (points,); `h` [m]: the length of the intervals, one for all or, with
      a `division`, (intervals,). `stride`: points to an interval.
    - `rule`: weights of a quadrature, in lengths of an interval: of all points of the rod or, with
      a `division`, of those of an interval with both of its ends.
    """

    length: Scalar
    s: Float[Array, "points"]
    h: Float[Array, "..."]
    stride: int = eqx.field(static=True)
    rule: tuple[float, ...] = eqx.field(static=True)
    division: Division | None = eqx.field(static=True, default=None)

    @property
    def intervals(self) -> int:
        return (self.s.shape[0] - 1) // self.stride

    @property
    def gaps(self) -> np.ndarray:
        """The numbers of the intervals of no length, where something jumps."""
        return np.arange(0) if self.division is None else self.division.gaps

    @property
    def widest(self) -> Scalar:
        """The largest distance of two points [m]."""
        return jnp.max(self.h) / self.stride

    @property
    def weights(self) -> Float[Array, "points"]:
        """Of the quadrature along the rod [m]."""
        rule = np.array(self.rule)
        if self.division is None:
            return self.h * rule
        of_each = self.h[:, None] * rule
        weights = jnp.append(of_each[:, :-1].ravel(), 0.0)
        return weights.at[self.stride :: self.stride].add(of_each[:, -1])

    def mean(self, values: Float[Array, "points n"]) -> Float[Array, "n"]:
        """Along the rod, of what is at the points."""
        if self.division is None:
            return jnp.mean(values, axis=0)
        return self.weights @ values / self.length

    def parts(self) -> list[slice]:
        """The points of each part that has any intervals."""
        if self.division is None:
            return [slice(0, self.s.shape[0])]
        slices, first = [], 0
        for count in self.division.counts:
            if count:
                slices.append(slice(first * self.stride, (first + count) * self.stride + 1))
            first += count + 1
        return slices


class Places(NamedTuple):
    """Arc lengths [m] where something may jump, and whether a load or a mass is there."""

    values: list
    loaded: list[bool]


def places_of(scene: Scene) -> Places:
    """All places of a scene, in this order: segments, tendons, chambers, loads, masses."""
    values, loaded = [], []
    end = 0.0
    for segment in (scene.segments or ())[:-1]:
        end = end + segment.length
        values.append(end)
    for actuators in (scene.tendons, scene.chambers):
        for ends in () if actuators is None else (actuators.starts_at, actuators.ends_at):
            values += [x for x in ends or () if x is not None]
    loaded = [False] * len(values)
    for load in (*(scene.loads or ()), *(scene.masses or ())):
        values.append(load.at)
        loaded.append(True)
    return Places(values, loaded)


def divide(scene: Scene, intervals: int) -> Division | None:
    """The division of a scene's rod into about this many intervals; `None` if nothing jumps."""
    places = places_of(scene)
    if not places.values and not _has_own_intervals(scene):
        return None
    if any(isinstance(x, Tracer) for x in (*places.values, scene.length)):
        count = max(_LEAST, math.ceil(intervals / (len(places.values) + 1)))
        return Division((count,) * (len(places.values) + 1))
    length = float(scene.length)
    values = [float(x) for x in places.values]
    chosen, at = [], [-1] * len(values)
    for i in sorted(range(len(values)), key=lambda i: (values[i], i)):
        x = values[i]
        inside = _TOGETHER * length < x < (1 - _TOGETHER) * length
        if not inside and not places.loaded[i]:
            continue
        if not chosen or abs(x - values[chosen[-1]]) > _TOGETHER * length:
            chosen.append(i)
        at[i] = len(chosen) - 1
    ends = [0.0, *(values[i] for i in chosen), length]
    counts = _counts(scene, ends, intervals, length)
    return Division(counts, tuple(chosen), tuple(at))


def _has_own_intervals(scene: Scene) -> bool:
    return any(segment.intervals is not None for segment in scene.segments or ())


def _counts(scene: Scene, ends: list[float], intervals: int, length: float) -> tuple[int, ...]:
    """Intervals of each part: by its length, or as its segment asks for."""
    counts = []
    edges = np.cumsum([0.0, *(float(x.length) for x in scene.segments or ())])
    for a, b in zip(ends[:-1], ends[1:]):
        density = intervals / length
        for segment, low, high in zip(scene.segments or (), edges[:-1], edges[1:]):
            if segment.intervals is not None and low <= 0.5 * (a + b) <= high:
                density = segment.intervals / (high - low)
        # A part of no length ends at a load on the tip.
        short = b - a <= _TOGETHER * length
        counts.append(0 if short else max(_LEAST, math.ceil(density * (b - a) - 1e-6)))
    return tuple(counts)


def uniform_grid(length, intervals: int, inner: np.ndarray, rule: np.ndarray) -> Grid:
    """Equal intervals with points at `inner`, (stride,), in [0, 1) of each; `rule`: see `Grid`."""
    grid = (np.arange(intervals)[:, None] + inner).ravel() / intervals
    s = length * jnp.array(np.append(grid, 1.0))
    return Grid(length, s, length / intervals, len(inner), tuple(rule.tolist()))


def divided_grid(scene: Scene, division: Division, inner: np.ndarray, rule: np.ndarray) -> Grid:
    """As `uniform_grid`, in each part of a scene's rod."""
    ends = ends_of_parts(scene, division)
    spacing = [(b - a) / max(n, 1) for n, a, b in zip(division.counts, ends[:-1], ends[1:])]
    s, h = [], []
    for k, (n, a, d) in enumerate(zip(division.counts, ends[:-1], spacing)):
        if k:  # the interval of no length before this part
            s.append(jnp.broadcast_to(a, (len(inner),)))
            h.append(jnp.zeros(1))
        s.append((a + d * (np.arange(n)[:, None] + inner)).ravel())
        h.append(jnp.broadcast_to(d, (n,)))
    s.append(jnp.reshape(jnp.asarray(scene.length), 1))
    s, h, rule_of_each = jnp.concatenate(s), jnp.concatenate(h), tuple(rule.tolist())
    return Grid(scene.length, s, h, len(inner), rule_of_each, division)


def ends_of_parts(scene: Scene, division: Division) -> list:
    """Arc lengths [m] of the ends of all parts."""
    values = places_of(scene).values
    if division.places is not None:
        between = [values[i] for i in division.places]
    else:
        between = list(jnp.sort(jnp.stack([jnp.asarray(x) for x in values])))
    return [0.0, *between, scene.length]


def gap_of_places(scene: Scene, division: Division) -> Int[Array, "places"]:
    """At which gap each place of the scene is; -1 where nothing jumps."""
    if division.at is not None:
        return jnp.array(division.at, dtype=int)
    values = jnp.stack([jnp.asarray(x) for x in places_of(scene).values])
    return jnp.argsort(jnp.argsort(values))


def division_of(grid: Grid) -> Division:
    """Where parts of the rod begin and end. Raises `ValueError` for a grid without nodes there."""
    if grid.division is None:
        raise ValueError(
            "this method along the rod has no nodes where segments, tendons or chambers end; "
            "use Collocation"
        )
    return grid.division
