"""A rod near an equilibrium: what it is, as a function of how fast that changes and of what acts.

A time scheme replaces rates by y_t = c0 y + y_h, and the rod's equations know no other rates. With
c0 = 0 the history y_h is the rate itself. So the equations of one step are, as they stand, those
between the fields x that have a history (strains, velocities, what dashpots have crept), their
rates and the applied inputs a. To first order about an equilibrium

    x = X x_t + Y a,

which is exact for the discretisation along the rod: `simulate` solves the same equations with
x_t = c0 x + x_h in each stage. X is a compliance times inertia and damping. It has no inverse, as
some of the fields follow from others at once, but its large eigenvalues are those of slow motions.
"""

import dataclasses
from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from softrod_jax.bvp.equations import Equations, Residual, Unknowns
from softrod_jax.bvp.method import AbstractMethod, Guess
from softrod_jax.foundation.compiling import on_cpu
from softrod_jax.rod.constants import inner_strain
from softrod_jax.rod.reduction import make_rod
from softrod_jax.rod.state import History, Layout, layout_of
from softrod_jax.scene.inputs import Inputs
from softrod_jax.scene.loads import TipLoad
from softrod_jax.scene.scene import Scene
from softrod_jax.scene.tendons import rubbing
from softrod_jax.statics import StaticSolution
from softrod_jax.stepping.moving_rod import Fields


class Applied(NamedTuple):
    """What acts on a rod: inputs of its actuators, and a force and a moment at its tip.

    `tip_force` [N] and `tip_moment` [N m], (3,), in the base frame; `None`: those of the scene.
    """

    inputs: Inputs
    tip_force: Float[Array, "3"] | None = None
    tip_moment: Float[Array, "3"] | None = None


class NearRest(eqx.Module):
    """The equations of a scene in motion, at an equilibrium of it.

    `unknowns` and `strain`: those of the equilibrium; `tight`: which conditions of a constraint
    hold, such as tendons of given length that are not slack.
    """

    scene: Scene
    applied: Applied
    unknowns: Unknowns
    strain: Float[Array, "points strain"]
    tight: Bool[Array, "conditions"] | None
    method: AbstractMethod = eqx.field(static=True)
    layout: Layout = eqx.field(static=True)

    @property
    def at_rest(self) -> Fields:
        """Rates of zero."""
        points, size = self.strain.shape
        scene, crept = self.scene, None
        relaxation = make_rod(scene, grid=self.method.grid(scene)).relaxation
        if relaxation is not None:
            crept = jnp.zeros((points, relaxation.parts.shape[-1], size))
        return Fields(jnp.zeros((points, size)), jnp.zeros((points, self.layout.pair)), crept)

    def equations(self, rates: Fields, applied: Applied) -> Equations:
        """Those of an instant with these rates."""
        scene, load = self.scene, self.scene.tip_load
        if load is not None:
            force = load.force if applied.tip_force is None else applied.tip_force
            moment = load.moment if applied.tip_moment is None else applied.tip_moment
            scene = dataclasses.replace(scene, tip_load=TipLoad(force, moment))
        rod = make_rod(scene, applied.inputs, grid=self.method.grid(scene))
        history = History(jnp.zeros(()), *rates)
        return Equations(self.method, self.layout, rod, history, self.strain)

    def residual(self, unknowns: Unknowns, rates: Fields, applied: Applied) -> Residual:
        """What is zero at such an instant."""
        return self.equations(rates, applied).equalities(unknowns, self.tight)

    def fields(self, unknowns: Unknowns, rates: Fields, applied: Applied) -> tuple[Fields, Guess]:
        """What has a history, and the rod at all points."""
        equations = self.equations(rates, applied)
        along, rod = equations.fields(unknowns), equations.rod
        _, q, w, _, _ = self.layout.split(along.y)
        crept = None
        if rod.relaxation is not None and rates.crept is not None:
            e = along.strain - rod.rest_strain
            crept = rod.relaxation.crept(jnp.zeros(()), rates.crept, e)
        return Fields(along.strain, jnp.concatenate([q, w], -1), crept), along

    def following(self) -> Callable[[Residual], Unknowns]:
        """How the unknowns follow a change of the equations, linearly."""
        equations = self.equations(self.at_rest, self.applied)
        factors = equations.factorise(self.unknowns)
        return lambda F: equations.correct_equalities(factors, F, self.tight)

    def along(self, directions, seen: Callable, follow: Callable, rates_of, applied_of):
        """The derivative of `seen(unknowns, rates, applied)` along each of `directions`, (n, m).

        `rates_of` and `applied_of`: the rates and what is applied, of m numbers. `follow`: see
        `following`.
        """
        zero = jnp.zeros(directions.shape[-1])
        given_by = lambda z: (rates_of(z), applied_of(z))

        def one(direction):
            given, moved = jax.jvp(given_by, (zero,), (direction,))
            F = jax.jvp(lambda given: self.residual(self.unknowns, *given), (given,), (moved,))[1]
            at, following = (self.unknowns, given), (follow(F), moved)
            return jax.jvp(lambda U, given: seen(U, *given), at, following)[1]

        # Several right-hand sides in lockstep take longer than in turn on a CPU.
        return jax.lax.map(one, directions) if on_cpu() else jax.vmap(one)(directions)


def near_rest(scene: Scene, inputs: Inputs, solution: StaticSolution) -> NearRest:
    """At the equilibrium `solution` of a checked `scene` under these `inputs`."""
    method = solution.method
    rod = make_rod(scene, inputs, grid=method.grid(scene))
    layout = layout_of(rod, dynamic=True)
    reached = solution.reached.guess
    pose, others = jnp.split(reached.y, [layout.pose_size], axis=-1)
    still = jnp.zeros((reached.y.shape[0], layout.pair))
    y = jnp.concatenate([pose, still, others], -1)
    strain = inner_strain(solution.point_strains, rod)
    multipliers, tight = reached.multipliers, None
    if multipliers is not None:
        tight = multipliers > 0
    along = method.unknowns(Guess(y, strain, multipliers), rod)
    load = scene.tip_load
    applied = Applied(inputs, *((None, None) if load is None else (load.force, load.moment)))
    return NearRest(scene, applied, Unknowns(along, multipliers), strain, tight, method, layout)


def check_smooth(who: str, scene: Scene) -> None:
    """Raises `ValueError` for what has no derivative at rest, and says what to leave out."""
    tendons = scene.tendons
    if tendons is not None and rubbing(tendons):
        raise ValueError(
            f"{who}: tendons with friction stick at rest, and slide one way or the other: there is "
            "no linear model of both; leave tendons.friction out"
        )
    if tendons is not None and any(x is not None for x in getattr(tendons, "backlash", None) or ()):
        raise ValueError(
            f"{who}: a tendon with backlash does not follow its actuator in the play, and does "
            "beyond: there is no linear model of both; leave tendons.backlash out"
        )
    for i, contact in enumerate(scene.contacts or ()):
        if contact.friction is not None:
            raise ValueError(
                f"{who}: contacts[{i}] has dry friction, which sticks at rest and slides beyond: "
                "there is no linear model of both; leave its friction out"
            )
