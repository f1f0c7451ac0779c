"""Tendons whose length is given: their tensions are what holds the rod so.

The path of tendon i is l_i = integral of |v + u x r_i + r_i,s| ds over its part of the rod, and
l_i0 that of the unloaded rod. Pulled by d_i, a tendon of stiffness k_i has the tension

    tau_i = k_i (l_i - (l_i0 - d_i))   where that is positive, and else 0: it is slack.

In other words, the tendon under its tension, l_i0 - d_i + tau_i / k_i, is never shorter than its
path; it is longer only where the tension is zero. Without the last term it does not stretch.
"""

import dataclasses
from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from softrod_jax.rod.constants import Rod
from softrod_jax.rod.constitutive import local_problem, recover_strain
from softrod_jax.rod.constraint import AbstractConstraint
from softrod_jax.rod.energies import TendonPull
from softrod_jax.scene.scene import Scene
from softrod_jax.scene.tendons import Tendons, driven_by_length


class GivenLengths(AbstractConstraint):
    """The tendons `which`, (conditions,), of a rod, by their numbers.

    - `pulls` [m] and `pretensioned` [m], `None` where none is: by how much each is shorter, without
      tension, than its path in the unloaded rod.
    - `unloaded`, (conditions,) or (points, conditions): lengths of the paths per unit of unloaded
      rod.
    - `compliance` [m/N]: 1 / k, or 0; `None` where none stretches.
    - `there`, (points, conditions): whether each is at a point; `None` where all run all along.
    """

    pulls: Float[Array, "conditions"]
    pretensioned: Float[Array, "conditions"] | None
    unloaded: Float[Array, "... conditions"]
    compliance: Float[Array, "conditions"] | None
    there: Bool[Array, "points conditions"] | None
    which: tuple[int, ...] = eqx.field(static=True)

    @property
    def count(self) -> int:
        return len(self.which)

    @property
    def loads(self) -> list[Any]:
        return [self.pulls, self.pretensioned]

    def applied(self, rod: Rod, multipliers: Float[Array, "conditions"]) -> Rod:
        """With the tensions of these tendons beside those that are given."""
        assert rod.tau is not None and rod.r is not None, "a rod with tendons"
        tensions = multipliers
        if self.there is not None:
            tensions = jnp.where(self.there, multipliers, 0.0)
        none = jnp.zeros((*tensions.shape[:-1], rod.r.shape[-2]))
        return eqx.tree_at(lambda r: r.tau, rod, rod.tau + none.at[..., self.which].set(tensions))

    def gaps(
        self,
        rod: Rod,
        strain: Float[Array, "points strain"],
        multipliers: Float[Array, "conditions"],
        weights: Float[Array, "points"],
    ):
        """How much longer each tendon is than its path [m]."""
        shorter = self.unloaded - per_unit(rod, strain, self.which)
        if self.there is not None:
            shorter = jnp.where(self.there, shorter, 0.0)
        gaps = weights @ shorter - self.pulls
        if self.pretensioned is not None:
            gaps = gaps - self.pretensioned
        return gaps if self.compliance is None else gaps + self.compliance * multipliers

    def gaps_by_strain(
        self, rod: Rod, strain: Float[Array, "points strain"], weights: Float[Array, "points"]
    ):
        """As the interface has it, without differentiation."""
        slopes = _paths(rod, self.which).slopes(strain)
        if self.there is not None:
            slopes = jnp.where(self.there[..., None], slopes, 0.0)
        return -jnp.swapaxes(weights[:, None, None] * slopes, 0, 1)


def given_lengths(
    tendons: Tendons, rod: Rod, pulls: Float[Array, "conditions"], there
) -> GivenLengths:
    """The lengths that pulls [m] leave to the tendons of `rod`, which has all its other numbers.

    `there`, (points, tendons): whether each is at a point, or `None`. A pretension is the tension
    at pull 0 of the rod under the pretensions of all and no other load. Where tendons are all that
    acts there is no wrench anywhere, and the strains follow point by point.
    """
    which = tendons.by_length
    of_each = lambda values: [None if values is None else values[i] for i in which]
    stiffness, pretension = of_each(tendons.stiffness), of_each(tendons.pretension)
    compliance = None
    if any(k is not None for k in stiffness):
        compliance = jnp.stack([jnp.zeros(()) if k is None else 1.0 / k for k in stiffness])
    there = None if there is None else there[:, jnp.array(which)]
    unloaded = per_unit(rod, rod.rest_strain, which)
    lengths = GivenLengths(jnp.zeros_like(pulls), None, unloaded, compliance, there, which)
    pulled = lambda taken: dataclasses.replace(lengths, pulls=pulls, pretensioned=taken)
    if all(x is None for x in pretension):
        return pulled(None)
    tensions = jnp.stack([jnp.zeros(()) if x is None else jnp.asarray(x) for x in pretension])
    # The gap that is left at pull 0 under the pretensions is what they take off a tendon's length.
    strain = _pretensioned(rod, lengths, tensions)
    return pulled(lengths.gaps(rod, strain, tensions, rod.grid.weights))


def _pretensioned(rod: Rod, lengths: GivenLengths, tensions) -> Float[Array, "points strain"]:
    """The strains of the rod under these tensions alone."""
    assert rod.tau is not None, "a rod with tendons"
    without = ("n_ch", "m_ch", "energies", "dissipations", "front_viscosity", "B_se", "B_bt")
    alone = eqx.tree_at(
        lambda r: [getattr(r, name) for name in without],
        rod,
        [None] * len(without),
        is_leaf=lambda x: x is None,
    )
    alone = eqx.tree_at(lambda r: r.tau, alone, jnp.zeros_like(rod.tau))
    rest = rod.rest_strain
    rest = jnp.broadcast_to(rest, (rod.grid.s.shape[0], rest.shape[-1]))
    problem = local_problem(lengths.applied(alone, tensions), jnp.zeros_like(rest))
    strain, solved = recover_strain(problem, rest)
    # Pretensions that no rod withstands leave no number that can be.
    return jnp.where(solved, strain, jnp.nan)


def per_unit(rod: Rod, strain: Float[Array, "... strain"], which: tuple[int, ...]):
    """The lengths of these tendons' paths per unit of rod, (..., conditions)."""
    paths = _paths(rod, which)
    if paths.r.ndim > 2 and strain.ndim == 1:
        strain = jnp.broadcast_to(strain, (paths.r.shape[0], strain.shape[0]))
    return paths.paths(strain)[1]


def _paths(rod: Rod, which: tuple[int, ...]) -> TendonPull:
    assert rod.r is not None, "a rod with tendons"
    r, r_s = rod.r, rod.r_s
    if len(which) < r.shape[-2]:
        chosen = jnp.array(which)
        r, r_s = r[..., chosen, :], None if r_s is None else r_s[..., chosen, :]
    v = rod.v_star if rod.K_se is None else None
    return TendonPull(jnp.ones(len(which)), r, r_s, v)


def path_shortening(rod: Rod, strain: Float[Array, "points strain"], there) -> Float[Array, "_"]:
    """By how much the path of each tendon is shorter than in the unloaded rod [m].

    `there`, (points, tendons): whether each is at a point; `None` where all run all along.
    """
    assert rod.r is not None, "a rod with tendons"
    every = tuple(range(rod.r.shape[-2]))
    shorter = per_unit(rod, rod.rest_strain, every) - per_unit(rod, strain, every)
    return rod.grid.weights @ (shorter if there is None else jnp.where(there, shorter, 0.0))


def tensions_of(
    scene: Scene,
    given: Float[Array, "*rows _"] | None,
    found: Float[Array, "*rows _"] | None,
    rows: tuple[int, ...] = (),
) -> Float[Array, "*rows tendons"]:
    """Those of all tendons of a scene [N]: the ones that are inputs, and the ones that follow."""
    if scene.tendons is None:
        return jnp.zeros((*rows, 0))
    by_length = driven_by_length(scene.tendons)
    tensions = jnp.zeros((*rows, scene.tendons.count))
    if given is not None:
        others = [i for i in range(scene.tendons.count) if i not in by_length]
        tensions = tensions.at[..., jnp.array(others)].set(given)
    if found is None or not by_length:
        return tensions
    return tensions.at[..., jnp.array(by_length)].set(found[..., : len(by_length)])


def held_of(scene: Scene, found: Float[Array, "*rows _"] | None, rows: tuple[int, ...] = ()):
    """What holds the conditions of a scene, (*rows, conditions): multipliers after the tensions."""
    count = len(scene.conditions or ())
    if found is None or not count:
        return jnp.zeros((*rows, 0))
    return found[..., found.shape[-1] - count :]
