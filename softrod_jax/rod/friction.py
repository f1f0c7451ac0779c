"""Tendons that rub in their channels: tensions that fall along the path, with a memory.

Where tendon i slides on its channel its tension changes by (capstan)

    tau_s = -+ mu_i kappa_i tau,   kappa_i: by how much its path turns per unit of rod,

minus where it slides towards its actuator. Two states for each such tendon follow from that, the
loss psi with tau(s) = tau(0) exp(-psi), psi(0) = 0, and the slip d, by how much the path beyond s
is shorter than in the unloaded rod, d(L) = 0: as far it has slid there towards the actuator.

    psi_s = mu sigma kappa,   d_s = |l| - |l|_unloaded

The direction sigma, in [-1, 1], follows the slip itself: between full friction one way and the
other a tendon sticks, and gives by a ten-thousandth of its length (an element of Prandtl, made
smooth). No rate is needed: statics along a path of inputs and motions have the same law, and a rod
that is held creeps nowhere.
"""

import dataclasses
from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from softrod_jax.rod.energies import TendonPull
from softrod_jax.rod.rotations import cross

# By what part of what is beyond a point a tendon slides until friction acts in full. Tendons
# stretch by more; the front between what sticks and what slides is then some millimetres thick on
# the paper's rod, and a grid sees it.
STICK = 1e-4
# Turns of a path [rad, over the whole rod] below which friction vanishes with their square.
_STRAIGHT = 1e-4


class Slid(NamedTuple):
    """How far tendons with friction have slid, at all points of the rod; (points, rubbing) each.

    - `loss`: psi, of tension so far along the rod.
    - `slip` [m], towards the actuator since the rod was unloaded; `path`: |l| per unit of rod.
    - `direction`: -1 to 1, how far each has gone from full friction one way to full friction the
      other way; 1 towards the actuator.
    """

    loss: Float[Array, "points rubbing"]
    slip: Float[Array, "points rubbing"]
    path: Float[Array, "points rubbing"]
    direction: Float[Array, "points rubbing"]


class Friction(eqx.Module):
    """Of the tendons `which`, by their numbers; arrays have these alone.

    - `coefficient`, (rubbing,). `r` [m], `r_s` [-] and `r_ss` [1/m]: as of the rod's tendons.
    - `there`: whether each is at a point, or `None`. `to_end` [m]: from a point to where it ends.
    - `slid`: what has been so far. `stick`: the part by which a tendon gives until it slides.
    """

    coefficient: Float[Array, "rubbing"]
    r: Float[Array, "... rubbing vector"]
    r_s: Float[Array, "... rubbing vector"] | None
    r_ss: Float[Array, "... rubbing vector"] | None
    there: Bool[Array, "... rubbing"] | None
    to_end: Float[Array, "... rubbing"]
    unloaded: Float[Array, "... rubbing"]
    slid: Slid
    stick: Float[Array, ""]
    which: tuple[int, ...] = eqx.field(static=True)

    @property
    def count(self) -> int:
        return len(self.which)

    def map_points(self, function) -> "Friction":
        """With `function` of everything that varies along the rod."""
        axes = {"r": 2, "r_s": 2, "r_ss": 2, "there": 1, "to_end": 1, "unloaded": 1}
        own = {name: getattr(self, name) for name in axes}
        varies = [n for n, x in own.items() if x is not None and x.ndim > axes[n]]
        changed = {name: function(own[name]) for name in varies}
        return dataclasses.replace(self, **changed, slid=Slid(*map(function, self.slid)))

    def rates(self, v, u, slip: Float[Array, "*points rubbing"]):
        """psi_s and d_s, (*points, rubbing) each, where strains are v and u."""
        length, turn = self._path(v, u)
        x = self._direction(length, slip)
        # Smooth where sliding begins, or Newton's method finds no way there.
        psi_s = self.coefficient * (0.5 * x * (3.0 - x * x)) * turn
        d_s = length - self.unloaded
        if self.there is None:
            return psi_s, d_s
        return jnp.where(self.there, psi_s, 0.0), jnp.where(self.there, d_s, 0.0)

    def after(self, v, u, loss, slip: Float[Array, "points rubbing"]) -> Slid:
        """What has been, once the rod has come to these strains, losses and slips."""
        length, _ = self._path(v, u)
        return Slid(loss, slip, length, self._direction(length, slip))

    def _direction(self, length, slip):
        # The mean of what lies beyond a point has a limit at the tendon's end, where slip has none.
        before, inside = self.slid, self.to_end > 1e-9
        mean = (slip - before.slip) / jnp.where(inside, self.to_end, 1.0)
        mean = jnp.where(inside, mean, before.path - length)
        return jnp.clip(before.direction + mean / self.stick, -1.0, 1.0)

    def _path(self, v, u):
        """|l| and by how much the path turns, per unit of rod.

        With the rates of strain left out, which turn it by a section's radius over the length on
        which strains change.
        """
        l, length = TendonPull(self.coefficient, self.r, self.r_s, v).paths(u)
        u, l_s = u[..., None, :], 0.0
        if self.r_s is not None and self.r_ss is not None:
            l_s = cross(u, jnp.broadcast_to(self.r_s, l.shape)) + self.r_ss
        t = l / length[..., None]
        t_s = l_s / length[..., None]
        if self.r_s is not None:
            t_s = t_s - jnp.sum(t_s * t, -1, keepdims=True) * t
        turn = cross(u, t) + t_s
        squared = jnp.sum(turn * turn, -1)
        straight = (_STRAIGHT / jnp.max(self.to_end)) ** 2
        return length, squared / jnp.sqrt(squared + straight)


def unslid(unloaded: Float[Array, "points rubbing"]) -> Slid:
    """That of a rod which was never loaded, its paths per unit of rod `unloaded`."""
    none = jnp.zeros_like(unloaded)
    return Slid(none, none, unloaded, none)


def sliding_throughout(slid: Slid, directions: Float[Array, "rubbing"]) -> Slid:
    """With friction in full in these directions, 1 or -1, wherever the rod goes from here."""
    far = 1e12 * jnp.broadcast_to(directions, slid.direction.shape)
    return slid._replace(direction=far)


def by_each_point(function: Callable, x: Float[Array, "*points n"]):
    """The derivative, (*points, m, n), of a function of points that do not see each other."""
    n = x.shape[-1]
    tangents = jnp.broadcast_to(jnp.eye(n).reshape(n, *[1] * (x.ndim - 1), n), (n, *x.shape))
    along = jax.vmap(lambda e: jax.jvp(function, (x,), (e,))[1])(tangents)
    return jnp.moveaxis(along, 0, -1)
