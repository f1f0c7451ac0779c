"""What is not quadratic in the strains, per unit of rod: tendons, energies and damping of users.

Per unit of rod, tendons store `tau_i |v + u x r_i + r_i,s|`, convex for tensions >= 0.

A tension that jumps sends a front along the rod, in theory of no width. Where the grid has
nothing between two points, the strains behind a front ring, and a ringing tendon path may shrink
to nothing though the true one does not. So in motions each tendon has an artificial viscosity,
`viscosity_i |l_t| l_t` for the rate of its path (von Neumann & Richtmyer, J. Appl. Phys. 21, 1950):
it spreads a front over a few points, and vanishes with the square of their distance elsewhere.
"""

import abc

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from softrod_jax.foundation.products import product_in_components
from softrod_jax.rod.rotations import cross, hats
from softrod_jax.scene.acting import AbstractDissipation, AbstractEnergy
from softrod_jax.scene.planes import in_space

# (v, u), or u where v is given: 6, 3, or in a plane 3 and 1 numbers.
Strain = Float[Array, "*points strain"]


class AbstractTerm(eqx.Module):
    """An energy as a function of the unknown strains x, (*points, n), of all points at once."""

    @abc.abstractmethod
    def value(self, x: Strain) -> Float[Array, "*points"]:
        """The energy per unit of rod [N]."""

    @abc.abstractmethod
    def gradient(self, x: Strain) -> Strain:
        """Its derivative by x: [N] and [N m]."""

    @abc.abstractmethod
    def hessian(self, x: Strain) -> Float[Array, "*points strain strain"]:
        """Its second derivative."""

    @property
    @abc.abstractmethod
    def reach(self) -> Float[Array, ""]:
        """A distance from the axis [m]: curvatures matter where they bend this far."""


class TendonPull(AbstractTerm):
    """sum_i tau_i |l_i| with the paths l_i = v + u x r_i + r_i,s.

    `tau` (tendons,), `r` (tendons, 3), `r_s` (tendons, 3) or None; with a first axis of points
    where they vary along the rod. With artificial viscosity: plus
    sum_i viscosity_i |l_t|^3 / (3 c0), l_t = c0 l_i + l_h. Where `v` (3,) is given, x = u.
    """

    tau: Float[Array, "... tendons"]
    r: Float[Array, "... tendons vector"]
    r_s: Float[Array, "... tendons vector"] | None = None
    v: Float[Array, "... vector"] | None = None
    viscosity: Float[Array, "... tendons"] | None = None
    c0: Float[Array, ""] | None = None
    l_h: Float[Array, "*points tendons vector"] | None = None

    @property
    def reach(self) -> Float[Array, ""]:
        return jnp.max(jnp.abs(self.r))

    def paths(self, x: Strain):
        """l_i, (*points, tendons, 3), and |l_i|."""
        l = self.linear_paths(x)
        if self.r_s is not None:
            l = l + self.r_s
        # The floor keeps derivatives finite on the kink; no converged answer sits there.
        return l, jnp.sqrt(jnp.sum(l * l, -1) + 1e-30)

    def linear_paths(self, x: Strain):
        """v + u x r_i, (*points, tendons, 3)."""
        r = self.r
        if self.v is None:
            n = r.shape[-1]
            v, u = x[..., None, :n], x[..., None, n:]
        else:
            v, u = self.v[..., None, :], x[..., None, :]
        return v + cross(u, jnp.broadcast_to(r, (*x.shape[:-1], *r.shape[-2:])))

    def slopes(self, x: Strain) -> Float[Array, "*points tendons strain"]:
        """The derivatives of the |l_i| by the strains."""
        l, length = self.paths(x)
        return self._by_strain(l / length[..., None])

    def _by_strain(self, pull):
        """Forces and moments of pulls along the paths, (*points, tendons, strain)."""
        moment = cross(jnp.broadcast_to(self.r, pull.shape), pull)
        return moment if self.v is not None else jnp.concatenate([pull, moment], -1)

    def _rates(self, l):
        """l_t and |l_t| from the paths l_i."""
        # A path that varies with s does not vary with time: r_i,s is not in the rate.
        change = l if self.r_s is None else l - self.r_s
        l_t = self.c0 * change + self.l_h
        return l_t, jnp.sqrt(jnp.sum(l_t * l_t, -1) + 1e-30)

    def value(self, x):
        l, length = self.paths(x)
        energy = jnp.sum(self.tau * length, -1)
        if self.viscosity is None or self.c0 is None:
            return energy
        _, rate = self._rates(l)
        return energy + jnp.sum(self.viscosity * rate**3, -1) / (3 * self.c0)

    def gradient(self, x):
        l, length = self.paths(x)
        pull = (self.tau / length)[..., None] * l
        if self.viscosity is not None:
            l_t, rate = self._rates(l)
            pull = pull + (self.viscosity * rate)[..., None] * l_t
        moment = jnp.sum(cross(jnp.broadcast_to(self.r, pull.shape), pull), -2)
        if self.v is not None:
            return moment
        return jnp.concatenate([jnp.sum(pull, -2), moment], -1)

    def hessian(self, x):
        """sum_i B_i^T M_i B_i, with l_i = B_i x and B_i = [1, -r_i^]."""
        l, length = self.paths(x)
        eye, outer = jnp.eye(l.shape[-1]), lambda a: a[..., :, None] * a[..., None, :]
        t = l / length[..., None]
        M = (self.tau / length)[..., None, None] * (eye - outer(t))
        if self.viscosity is not None and self.c0 is not None:
            l_t, rate = self._rates(l)
            rate = rate[..., None, None]
            drag = self.c0 * self.viscosity[..., None, None]
            M = M + drag * (rate * eye + outer(l_t) / rate)
        turn = -hats(self.r)[1]
        turn = jnp.broadcast_to(turn, (*M.shape[:-1], turn.shape[-1]))
        M_turn = product_in_components(M, turn)
        by_turn = product_in_components(jnp.swapaxes(turn, -1, -2), M_turn)
        if self.v is not None:
            return jnp.sum(by_turn, -3)
        upper = jnp.concatenate([M, M_turn], -1)
        lower = jnp.concatenate([jnp.swapaxes(M_turn, -1, -2), by_turn], -1)
        return jnp.sum(jnp.concatenate([upper, lower], -2), -3)


class Part(AbstractEnergy):
    """A part of the energy of another."""

    whole: AbstractEnergy
    part: Float[Array, ""]

    def density(self, v, u, s):
        """As the interface has it."""
        return self.part * self.whole.density(v, u, s)


class Density(AbstractTerm):
    """`factor` times an energy of a user, by automatic differentiation.

    `s` [m], (points,); `v` (3,) where it is given and x = u; `radius` [m]: see `reach`.
    """

    energy: AbstractEnergy
    s: Float[Array, "..."]
    radius: Float[Array, ""]
    factor: Float[Array, ""] | None = None
    v: Float[Array, "... vector"] | None = None
    plane: str | None = eqx.field(static=True, default=None)

    @property
    def reach(self) -> Float[Array, ""]:
        return self.radius

    def _at_point(self, x, v, s):
        strain = in_space(x if self.v is None else jnp.concatenate([v, x]), self.plane)
        W = self.energy.density(strain[:3], strain[3:], s)
        return W if self.factor is None else self.factor * W

    def _each(self, function, shape: str, x):
        v = jnp.zeros(0) if self.v is None else self.v
        return jnp.vectorize(function, signature=f"(n),(m),()->{shape}")(x, v, self.s)

    def value(self, x):
        return self._each(self._at_point, "()", x)

    def gradient(self, x):
        return self._each(jax.grad(self._at_point), "(n)", x)

    def hessian(self, x):
        return self._each(jax.hessian(self._at_point), "(n,n)", x)


class Dissipated(AbstractTerm):
    """Psi(x_t) / c0 with x_t = c0 x + x_h: its derivative by x is that of Psi by the rates.

    `s` [m], (points,); `x_h` as x; `radius` [m]: see `reach`. Where `stretches` is not so, x = u.
    """

    dissipation: AbstractDissipation
    s: Float[Array, "..."]
    radius: Float[Array, ""]
    c0: Float[Array, ""]
    x_h: Strain
    stretches: bool = eqx.field(static=True)
    plane: str | None = eqx.field(static=True, default=None)

    @property
    def reach(self) -> Float[Array, ""]:
        return self.radius

    def _at_point(self, rate, s):
        if not self.stretches:
            rate = jnp.concatenate([jnp.zeros(3 if self.plane is None else 2), rate])
        rate = in_space(rate, self.plane)
        return self.dissipation.potential(rate[:3], rate[3:], s)

    def _each(self, function, shape: str, x):
        rate = self.c0 * x + self.x_h
        return jnp.vectorize(function, signature=f"(n),()->{shape}")(rate, self.s)

    def value(self, x):
        # Where c0 is zero, rates are given and the rod can do nothing about them.
        there = self.c0 != 0
        return jnp.where(
            there, self._each(self._at_point, "()", x) / jnp.where(there, self.c0, 1.0), 0.0
        )

    def gradient(self, x):
        return self._each(jax.grad(self._at_point), "(n)", x)

    def hessian(self, x):
        return self.c0 * self._each(jax.hessian(self._at_point), "(n,n)", x)


def stiffness_at_rest(energy: AbstractEnergy, v: Float[Array, "3"], u: Float[Array, "3"]):
    """Diagonals of the second derivatives at the strains of the unloaded rod, K_se and K_bt."""
    x = jnp.concatenate([v, u])
    H = jax.hessian(lambda x: energy.density(x[:3], x[3:], jnp.zeros(())))(x)
    K = jnp.diagonal(H)
    return K[:3], K[3:]
