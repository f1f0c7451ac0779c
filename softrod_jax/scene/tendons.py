"""Tendons: where they run in the section, and over which part of the rod.

A tendon runs at `offset + path(s)`. A path is a class of its own: a new one says where it is as a
function of the arc length, and its slope follows by differentiation.
"""

import abc
from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from softrod_jax.foundation.numbers import Given, PairLike, RowsLike, ScalarLike
from softrod_jax.scene.ranges import number, one_for_each

Scalar = Float[Array, ""]

GUIDES = ("rod", "disks")
CONTROLS = ("tension", "length")
# Numbers that single tendons or chambers have, or not.
Each = Sequence[ScalarLike | None]


class AbstractPath(eqx.Module):
    """A way through the sections, from where a tendon begins to where it ends."""

    @abc.abstractmethod
    def place(self, s: Scalar, start: Scalar, end: Scalar) -> Float[Array, "2"]:
        """x and y [m] in the section at arc length `s` [m], between `start` and `end`."""


class Helix(AbstractPath):
    """A helix about the rod's axis.

    - `radius` [m]; `angle` [rad]: where it begins, from the x axis; `turns`: right-handed about z,
      over the tendon's whole part.
    """

    radius: Given[ScalarLike] = number("m", at_least=0, harmless=0.01)
    angle: Given[ScalarLike] = number("rad", default=0.0)
    turns: Given[ScalarLike] = number(default=1.0)

    def place(self, s, start, end):
        angle = self.angle + 2 * jnp.pi * self.turns * (s - start) / (end - start)
        return self.radius * jnp.stack([jnp.cos(angle), jnp.sin(angle)])


class Line(AbstractPath):
    """A straight line from one place in the section to another, `begin` and `end` [m], (2,)."""

    begin: Given[PairLike] = number("m", sizes=(2,))
    end: Given[PairLike] = number("m", sizes=(2,))

    def place(self, s, start, end):
        x = (s - start) / (end - start)
        return (1 - x) * self.begin + x * self.end


class Points(AbstractPath):
    """A cubic spline with continuous curvature through `points` (s, x, y) [m], (points, 3).

    It has no third derivative jump next to its ends ("not a knot"); two or three points give a
    line or a parabola. Beyond the first and the last point the outermost polynomials go on.
    """

    points: Given[RowsLike] = number(
        "m", sizes=(3,), rows=2, harmless=((0.0, 0.0, 0.0), (1.0, 0.0, 0.0))
    )

    def relations(self):
        """What must hold besides the ranges: a field, whether it does, and what is expected."""
        s = self.points[:, 0]
        yield "points", s[1:] > s[:-1], lambda: "expected s to rise from point to point"

    def place(self, s, start, end):
        del start, end
        knots, values = self.points[:, 0], self.points[:, 1:]
        scale = knots[-1] - knots[0]
        x, at = (knots - knots[0]) / scale, (s - knots[0]) / scale
        slopes = _spline_slopes(x, values)
        k = jnp.clip(jnp.searchsorted(x, at, side="right") - 1, 0, len(x) - 2)
        h = x[k + 1] - x[k]
        t = (at - x[k]) / h
        y0, y1, d0, d1 = values[k], values[k + 1], h * slopes[k], h * slopes[k + 1]
        cubic = t * (1 - t) * ((1 - t) * (d0 - (y1 - y0)) + t * ((y1 - y0) - d1))
        return (1 - t) * y0 + t * y1 + cubic


def _spline_slopes(x: Float[Array, "n"], y: Float[Array, "n 2"]) -> Float[Array, "n 2"]:
    """Slopes at the knots of the cubic spline with continuous second derivatives."""
    n = x.shape[0]
    h = jnp.diff(x)
    rise = jnp.diff(y, axis=0) / h[:, None]
    if n == 2:
        return jnp.concatenate([rise, rise])
    if n == 3:
        bend = (rise[1] - rise[0]) / (x[2] - x[0])
        return jnp.stack([rise[0] - h[0] * bend, rise[0] + h[0] * bend, rise[1] + h[1] * bend])
    A, b = jnp.zeros((n, n)), jnp.zeros((n, 2))
    i = np.arange(1, n - 1)
    A = A.at[i, i - 1].set(h[1:]).at[i, i].set(2 * (h[1:] + h[:-1])).at[i, i + 1].set(h[:-1])
    b = b.at[i].set(3 * (h[1:, None] * rise[:-1] + h[:-1, None] * rise[1:]))
    # The first two and the last two polynomials are one each.
    A = A.at[0, 0].set(h[1]).at[0, 1].set(h[0] + h[1])
    A = A.at[-1, -1].set(h[-2]).at[-1, -2].set(h[-1] + h[-2])
    first = (h[0] + 2 * (h[0] + h[1])) * h[1] * rise[0] + h[0] ** 2 * rise[1]
    last = (h[-1] + 2 * (h[-1] + h[-2])) * h[-2] * rise[-1] + h[-1] ** 2 * rise[-2]
    b = b.at[0].set(first / (h[0] + h[1])).at[-1].set(last / (h[-1] + h[-2]))
    return jnp.linalg.solve(A, b)


def _words(words):
    """One word where it is the same for all."""
    words = (words,) if isinstance(words, str) else tuple(words)
    return words[0] if words and all(word == words[0] for word in words) else words


class Tendons(eqx.Module):
    """Tendons that run in the sections, and what drives them.

    - `offsets` [m], (tendons, 2): x and y of each in the section.
    - `paths`: for each a path that is added to its offset, or `None` for one parallel to the rod.
    - `starts_at`, `ends_at` [m]: for each the arc length where it begins and where it is fixed;
      `None` for the base and for the tip.
    - `guided`: "rod", inside the sections, or "disks", which may carry it outside; one for each or
      one for all.
    - `control`: what drives it, "tension" [N] or "length": a pull [m], by which its actuator
      shortens it; one for each or one for all. One driven by its length goes slack rather than
      push.
    - `stiffness` [N/m]: of a tendon driven by its length, all of it; `None` for one that does not
      stretch. `pretension` [N]: its tension at pull 0, in the rod without loads; `None` for 0.
    - `friction`: the Coulomb coefficient of each along its path, `None` for none; see
      `rod/friction.py`.
    - `backlash` [m]: of a tendon driven by length, the play of its actuator: so far the pull goes
      on a return before the tendon follows; `None` for none.
    """

    offsets: Given[RowsLike] = number(
        "m", sizes=(2,), per_actuator=True, harmless=0.01, converter=jnp.asarray
    )
    paths: Sequence[AbstractPath | None] | None = eqx.field(default=None, converter=one_for_each)
    starts_at: Each | None = number("m", each=True, at_least=0)
    ends_at: Each | None = number("m", each=True, above=0, harmless=1.0)
    guided: str | Sequence[str] = eqx.field(static=True, default="rod", converter=_words)
    control: str | Sequence[str] = eqx.field(static=True, default="tension", converter=_words)
    stiffness: Each | None = number("N/m", each=True, above=0, harmless=1.0)
    pretension: Each | None = number("N", each=True, at_least=0)
    friction: Each | None = number(each=True, at_least=0)
    backlash: Each | None = number("m", each=True, at_least=0)

    def __check_init__(self):
        own = ("paths", "starts_at", "ends_at", "stiffness", "pretension", "friction", "backlash")
        for name in own:
            check_each("Tendons", name, getattr(self, name), self.count, "tendon")
        for name, offered in (("guided", GUIDES), ("control", CONTROLS)):
            words = self.words(name)
            for word in words:
                if word not in offered:
                    either = " or ".join(f'"{x}"' for x in offered)
                    raise ValueError(f"Tendons: {name}={word!r} is not offered; use {either}")
            check_each("Tendons", name, words, self.count, "tendon")
        for path in self.paths or ():
            if not (path is None or isinstance(path, AbstractPath)):
                raise ValueError(f"Tendons: a path {path!r}; use Helix, Line, Points or None")

    @property
    def count(self) -> int:
        return self.offsets.shape[0] if hasattr(self.offsets, "shape") else len(self.offsets)

    @property
    def guides(self) -> tuple[str, ...]:
        """By what each is guided."""
        return self.words("guided")

    @property
    def rubbing(self) -> tuple[int, ...]:
        """The numbers of those with friction."""
        return tuple(i for i, x in enumerate(self.friction or ()) if x is not None)

    @property
    def by_length(self) -> tuple[int, ...]:
        """The numbers of those whose length is given."""
        return tuple(i for i, x in enumerate(self.words("control")) if x == "length")

    def words(self, name: str) -> tuple[str, ...]:
        """For each what it says as `guided` or `control`."""
        words = getattr(self, name)
        return (words,) * self.count if isinstance(words, str) else tuple(words)

    def part(self, i: int, length) -> tuple[ScalarLike, ScalarLike]:
        """Where tendon `i` of a rod of this `length` begins and ends [m]."""
        return part_of(self, i, length)

    def path(self, i: int) -> AbstractPath | None:
        """The path of tendon `i`, or `None` if it is parallel to the rod."""
        return None if self.paths is None else self.paths[i]

    def place(self, i: int, s: Float[Array | np.ndarray, "n"], length) -> Float[Array, "n 2"]:
        """x and y [m] of tendon `i` at arc lengths `s` [m] of a rod of this `length`."""
        # A path computes with JAX, also where its numbers are numpy's.
        path, ends = jax.tree.map(jnp.asarray, self.path(i)), self.part(i, length)
        at = jnp.zeros(2) if path is None else jax.vmap(lambda s: path.place(s, *ends))(s)
        return jnp.broadcast_to(self.offsets[i] + at, (s.shape[0], 2))

    def routing(self, s, length=None):
        """Tendon positions r_i [m] and slopes r_i,s [-] in the section at arc length `s`.

        Both (tendons, 3), or (*points, tendons, 3) for `s` (*points,) if they vary along the rod.
        The slope is `None` where all are straight: its terms vanish. `length` [m] of the rod,
        which paths need.
        """
        r = jnp.concatenate([self.offsets, jnp.zeros_like(self.offsets[:, :1])], axis=1)
        if self.straight:
            return r, None
        place, slope = self._along(s, length, _with_slope)
        return r + place, slope

    @property
    def straight(self) -> bool:
        """Whether all are parallel to the rod."""
        return self.paths is None or all(path is None for path in self.paths)

    def bends(self, s, length) -> Float[Array, "*points tendons 3"] | None:
        """Second derivatives r_i,ss [1/m]; `None` where all are straight."""
        if self.straight:
            return None
        slope = lambda place: lambda x: _with_slope(place)(x)[1]
        return self._along(s, length, lambda place: _with_slope(slope(place)))[1]

    def _along(self, s, length, derived):
        """`derived(place)(s)`, two values, of the paths of all, (*points, tendons, 3) each."""
        s = jnp.asarray(s)
        values = []
        for i in range(self.count):
            path = self.path(i)
            pair = (jnp.zeros((*s.shape, 2)),) * 2
            if path is not None:
                ends = self.part(i, length)
                place = lambda x, path=path, ends=ends: path.place(x, *ends)
                inside = jnp.clip(s, *ends)
                pair = jnp.vectorize(derived(place), signature="()->(n),(n)")(inside)
            values.append(pair)
        flat = lambda a: jnp.concatenate([a, jnp.zeros_like(a[..., :1])], -1)
        return tuple(flat(jnp.stack(x, -2)) for x in zip(*values))


def _with_slope(place):
    return lambda x: jax.jvp(place, (x,), (jnp.ones_like(x),))


def driven_by_length(tendons) -> tuple[int, ...]:
    """The numbers of the tendons whose length is given; another class of tendons has none."""
    return tendons.by_length if type(tendons) is Tendons else ()


def rubbing(tendons) -> tuple[int, ...]:
    """The numbers of the tendons with friction; another class of tendons has none."""
    return tendons.rubbing if type(tendons) is Tendons else ()


def part_of(actuators, i: int, length):
    """Where actuator `i` begins and ends [m]: at the base and at the tip where nothing is said."""
    start = None if actuators.starts_at is None else actuators.starts_at[i]
    end = None if actuators.ends_at is None else actuators.ends_at[i]
    return jnp.zeros(()) if start is None else start, length if end is None else end


def check_each(who: str, name: str, values, count: int, of: str):
    """Raises `ValueError` unless there is one of `values` for each of `count`, or none at all."""
    if values is None:
        return
    if not isinstance(values, tuple) and not hasattr(values, "__len__"):
        raise ValueError(f"{who}: {name}={values!r}; expected {count} of them, one for each {of}")
    if len(values) != count:
        raise ValueError(f"{who}: {len(values)} of {name}; expected {count}, one for each {of}")
