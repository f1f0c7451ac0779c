"""The energy of fibres that are rubber, by sections: closed forms of disks, quadrature of boxes.

What bends and stretches a rod of rubber is one number at each place of its section, the stretch
l = a + p y - q x, linear across the section: a = v3 and p, q = u1, u2, in a plane that bends one
way a - q x. Over a disk of radius R about the axis, with t = R^2 (p^2 + q^2) and
s = sqrt(a^2 - t), whose square is the product of the largest and the smallest stretch,

    integral of l^2:    pi R^2 (a^2 + t/4)
    integral of 1/l:    2 pi R^2 / (a + s)
    integral of 1/l^2:  2 pi R^2 / (s (a + s)).

A disk beside the axis has the stretch of its own centre for a. A tube is a disk without another,
and so are holes. Stretches must be above zero: where the least is not, nothing here is a number.
"""

import functools
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from softrod_jax.rod.energies import AbstractTerm, Strain
from softrod_jax.scene.sections import Annulus, Circle, Rectangle, Section

# Of Gauss, in each direction of a box. The fibres' energy is as good as 1e-10 while the largest
# stretch is five times the smallest.
_FIBRES = 12
# Where the constants of the fibres' places, (R, x, y, sign) and (width, height, sign), have a row.
DISK, BOX = 4, 3


class Fibres(eqx.Module):
    """The fibres of a section; with a first axis of points where they vary along the rod.

    - `constants` (2,): C1 and C2 [Pa]; zero where the rod is not of rubber.
    - `disks` (disks, 4): radius, x and y of the centre [m], and 1, or -1 where there is nothing.
    - `boxes` (boxes, 3): width along x and height along y [m], about the axis, and 1 or 0.
    """

    constants: Float[Array, "... 2"]
    disks: Float[Array, "... disks 4"]
    boxes: Float[Array, "... boxes 3"]


def fibres_of(section: Section, constants: Float[Array, "2"]) -> Fibres | None:
    """Those of a section; `None` where its shape is not known."""
    none, one = jnp.zeros(()), jnp.ones(())
    rows = lambda rows, size: jnp.stack([jnp.stack(r) for r in rows]) if rows else jnp.zeros(size)
    disks, boxes = [], []
    match section:
        case Circle():
            disks = [(section.radius, none, none, one)]
            holes = () if section.holes is None else section.holes
            disks += [(a, x, y, -one) for x, y, a in holes]
        case Annulus():
            disks = [(section.outer_radius, none, none, one)]
            disks.append((section.inner_radius, none, none, -one))
        case Rectangle():
            boxes = [(section.width, section.height, one)]
        case _:
            return None
    return Fibres(constants, rows(disks, (0, DISK)), rows(boxes, (0, BOX)))


class FibreEnergy(AbstractTerm):
    """What the energy of fibres is more than that of the linear law with the same small strains.

    `rest`: the strains of the unloaded rod, like the unknowns x; where v is given, `stretches` is
    false and x = u. `radius` [m]: see `reach`. `plane`: that of the rod.
    """

    fibres: Fibres
    rest: Float[Array, "... strain"]
    radius: Float[Array, ""]
    stretches: bool = eqx.field(static=True)
    plane: str | None = eqx.field(static=True, default=None)

    @property
    def reach(self) -> Float[Array, ""]:
        return self.radius

    def value(self, x):
        return self._slopes(x).value

    def gradient(self, x):
        _, before, after = self._slots
        own = self._slopes(x).gradient
        return jnp.pad(own, [(0, 0)] * (own.ndim - 1) + [(before, after)])

    def hessian(self, x):
        _, before, after = self._slots
        own = self._slopes(x).hessian
        return jnp.pad(own, [(0, 0)] * (own.ndim - 2) + [(before, after)] * 2)

    def least_stretch(self, x: Strain) -> Float[Array, "*points"]:
        """That of the fibre which is shortest; below zero where sections have changed sides."""
        z = self._stretch_and_bend(x)
        bend, least = z[..., 1:], []
        disks, boxes = self.fibres.disks, self.fibres.boxes
        if disks.shape[-2]:
            centre = jnp.sum(self._arms(disks[..., 1:3]) * z[..., None, :], -1)
            size = jnp.sqrt(jnp.sum(bend**2, -1, keepdims=True))
            # Where there is nothing, no stretch is the least.
            edge = jnp.where(disks[..., 3] > 0, centre - disks[..., 0] * size, jnp.inf)
            least.append(jnp.min(edge, -1))
        if boxes.shape[-2]:
            arms = jnp.abs(self._arms(0.5 * boxes[..., :2])[..., 1:])
            edge = z[..., :1] - jnp.sum(arms * jnp.abs(bend)[..., None, :], -1)
            least.append(jnp.min(jnp.where(boxes[..., 2] > 0, edge, jnp.inf), -1))
        return functools.reduce(jnp.minimum, least)

    @property
    def _slots(self) -> tuple[slice, int, int]:
        """Where (a, p, q) are among the unknowns, and how many of these are before and after."""
        bends = 2 if self.plane is None else 1
        before, after = (bends if self.stretches else 0), (1 if self.plane is None else 0)
        return slice(before, before + self.stretches + bends), before, after

    def _stretch_and_bend(self, x: Strain) -> Float[Array, "*points m"]:
        """z = (a, p, q), or (a, q) in a plane."""
        e = (x - self.rest)[..., self._slots[0]]
        if self.stretches:
            return e + _ONE[: e.shape[-1]]
        return jnp.concatenate([jnp.ones_like(e[..., :1]), e], -1)

    def _arms(self, places: Float[Array, "... 2"]) -> Float[Array, "... m"]:
        """k, with the stretch k.z at places (x, y) of the section."""
        x, y = places[..., 0], places[..., 1]
        one = jnp.ones_like(x)
        if self.plane is None:
            return jnp.stack([one, y, -x], -1)
        # A turn leads from z to the first axis of the plane, whichever that is.
        return jnp.stack([one, -x if self.plane == "xz" else -y], -1)

    def _slopes(self, x: Strain) -> "_Slopes":
        z = self._stretch_and_bend(x)
        parts = [
            of(z, c)
            for of, c in ((self._disks, self.fibres.disks), (self._boxes, self.fibres.boxes))
            if c.shape[-2]
        ]
        total = jax.tree.map(lambda *x: sum(x), *parts)
        if self.stretches:
            return total
        return _Slopes(total.value, total.gradient[..., 1:], total.hessian[..., 1:, 1:])

    def _disks(self, z, disks) -> "_Slopes":
        c1, c2 = (self.fibres.constants[..., i, None] for i in range(2))
        square, sign = disks[..., 0] ** 2, disks[..., 3]
        k = self._arms(disks[..., 1:3])
        bend = z * _BEND[: z.shape[-1]]
        a, t = jnp.sum(k * z[..., None, :], -1), square * jnp.sum(bend**2, -1, keepdims=True)
        s = jnp.sqrt(jnp.where(a > 0, a * a - t, jnp.nan))
        f, g = 1 / (a + s), 1 / s  # integrals of 1/l and 1/l^2 are 2 area times f and f g
        area = jnp.pi * square * sign
        w = c1 * (a * a + 0.25 * t + 4 * f - 3) + c2 * (2 * a + 2 * f * g - 3)
        w_a = c1 * (2 * a - 4 * f * g) + c2 * (2 - 2 * g**3)
        w_t = c1 * (0.25 + 2 * f**2 * g) + c2 * (a + 2 * s) * g**3 * f**2
        w_aa = c1 * (2 + 4 * g**3) + c2 * 6 * a * g**5
        w_at = -c1 * 2 * (a + 2 * s) * g**3 * f**2 - c2 * 3 * g**5
        w_tt = (c1 * (a + 3 * s) + c2 * 0.5 * (3 * a * a + 9 * a * s + 8 * s * s) * g * g) * (
            g * f
        ) ** 3
        # By z: of a it is k, of t twice R^2 times what bends.
        by_t = 2 * square[..., None] * bend[..., None, :]
        column = lambda w: (area * w)[..., None]
        matrix = lambda w: (area * w)[..., None, None]
        own = _BEND[: z.shape[-1]]
        gradient = column(w_a) * k + column(w_t) * by_t
        crossed = _outer(k, by_t)
        hessian = (
            matrix(w_aa) * _outer(k, k)
            + matrix(w_at) * (crossed + jnp.swapaxes(crossed, -1, -2))
            + matrix(w_tt) * _outer(by_t, by_t)
            + matrix(2 * w_t * square) * np.diag(own)
        )
        moments = area[..., None] * (k * k + 0.25 * square[..., None] * own)
        total = _Slopes(jnp.sum(area * w, -1), jnp.sum(gradient, -2), jnp.sum(hessian, -3))
        return self._beyond_linear(total, z, jnp.sum(moments, -2))

    def _boxes(self, z, boxes) -> "_Slopes":
        c1, c2 = (self.fibres.constants[..., i, None, None] for i in range(2))
        half = self._arms(0.5 * boxes[..., :2])  # of a corner
        scaled = half * z[..., None, :]
        K, weights = _PLACES[z.shape[-1] - 1]
        least = scaled[..., 0] - jnp.sum(jnp.abs(scaled[..., 1:]), -1)
        l = jnp.where(least[..., None] > 0, scaled @ K.T, jnp.nan)
        r = 1 / l
        psi = c1 * (l * l + 2 * r - 3) + c2 * (2 * l + r * r - 3)
        slope = c1 * 2 * (l - r * r) + c2 * 2 * (1 - r**3)
        curve = c1 * (2 + 4 * r**3) + c2 * 6 * r**4
        area = boxes[..., 0] * boxes[..., 1] * boxes[..., 2]
        gradient = area[..., None] * half * (slope @ (weights[:, None] * K))
        own = (curve @ (weights[:, None] * _outer(K, K).reshape(len(K), -1))).reshape(
            *curve.shape[:-1], *2 * K.shape[-1:]
        )
        hessian = area[..., None, None] * _outer(half, half) * own
        moments = area[..., None] * half**2 * _THIRD[: z.shape[-1]]
        total = _Slopes(
            jnp.sum(area * (psi @ weights), -1), jnp.sum(gradient, -2), jnp.sum(hessian, -3)
        )
        return self._beyond_linear(total, z, jnp.sum(moments, -2))

    def _beyond_linear(self, total: "_Slopes", z, moments) -> "_Slopes":
        """Without the linear law's, whose `moments` are the area and the second moments."""
        k, e = 6 * jnp.sum(self.fibres.constants, -1)[..., None] * moments, z - _ONE[: z.shape[-1]]
        return _Slopes(
            total.value - 0.5 * jnp.sum(k * e * e, -1),
            total.gradient - k * e,
            total.hessian - k[..., None, :] * np.eye(z.shape[-1]),
        )


class _Slopes(NamedTuple):
    """An energy as a function of z = (a, p, q) or (a, q), and its derivatives."""

    value: Float[Array, "*points"]
    gradient: Float[Array, "*points m"]
    hessian: Float[Array, "*points m m"]


def _outer(a, b):
    return a[..., :, None] * b[..., None, :]


def _gauss(bends: int):
    """Places (1, y, x) or (1, x) in a box from -1 to 1, and weights whose sum is 1."""
    x, w = np.polynomial.legendre.leggauss(_FIBRES)
    grids = np.meshgrid(*[x] * bends, indexing="ij")
    weights = functools.reduce(np.multiply.outer, [0.5 * w] * bends).ravel()
    return np.stack([np.ones(weights.size), *(g.ravel() for g in grids)], -1), weights


_PLACES = {bends: _gauss(bends) for bends in (1, 2)}
# Of z: its value in the unloaded rod, what of it bends, and the mean square of a box's places.
_ONE, _BEND = np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 1.0])
_THIRD = np.array([1.0, 1 / 3, 1 / 3])
