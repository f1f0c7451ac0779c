"""The first bending mode of a rod as it is: what it makes of errors of place and of speed.

A trial shape stands for it, that of a cantilever (Rayleigh): so it is stiff, heavy and damped to
within a few percent where the rod is straight, and about so where it is bent.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from softrod_jax.bvp.method import AbstractMethod
from softrod_jax.rod.constants import Rod, full_strain
from softrod_jax.rod.rotations import to_base, to_body
from softrod_jax.rod.shape import ORIGIN
from softrod_jax.scene.planes import in_space

# Of the slowest decay of a bending mode, the part that is believed.
_BELIEVED = 0.7
# The slope at the tip of a cantilever's first mode, in tip displacements per length.
_SLOPE = 1.3765
# The part of a rod's mass that counts at the tip in the first mode of a cantilever.
EFFECTIVE_MASS = 0.2427
# A mode that hardly resists any more is taken to be this stiff, in parts of the unloaded one.
_SOFTEST = 0.1


class Axis(NamedTuple):
    """Of a bent rod: `tangent` p_s and `attitude`, of a rod in a plane as seen from its clamp."""

    tangent: Float[Array, "nodes 3"]
    attitude: Float[Array, "nodes 4"]


def axis_of(strain: Float[Array, "points strain"], rod: Rod, method: AbstractMethod) -> Axis:
    """That of a rod with these strains."""
    strain = full_strain(strain, rod)
    clamp = rod.h_base if rod.plane is None else ORIGIN[1]
    _, attitude = method.shape(strain, rod.grid, ORIGIN[0], clamp)
    return Axis(to_base(attitude, method.outputs(strain)[:, :3]), attitude)


def tip_mass(rod: Rod) -> Float[Array, ""]:
    """The mass [kg] at the tip of a cantilever without mass that swings as slowly."""
    return EFFECTIVE_MASS * rod.mass + (0.0 if rod.payload is None else rod.payload)


def moved_by_speed(
    speed: Float[Array, "nodes 3"],
    tangent: Float[Array, "nodes 3"],
    rod: Rod,
    method: AbstractMethod,
) -> Float[Array, ""]:
    """How far a wrong `speed` across the rod will have moved its tip at most, in lengths.

    It is what the first mode has of it, by its momentum, over that mode's frequency. What higher
    modes have goes by sooner and moves less; what points along the rod is stretch.
    """
    unit = _unit(tangent)
    across = speed - jnp.sum(speed * unit, -1, keepdims=True) * unit
    x = method.outputs(rod.grid.s) / rod.L
    f = _shape(x)[:, None] * across
    momentum = rod.mass * jnp.sum(0.5 * jnp.diff(x)[:, None] * (f[1:] + f[:-1]), 0)
    if rod.payload is not None:
        momentum = momentum + rod.payload * across[-1]
    at_tip, rod = momentum / tip_mass(rod), rod.relaxed
    # Damping brings a rod to rest before it is as far as it would swing.
    square = _left_stiffness(rod, unit, method) / tip_mass(rod) + 4 * _decay(rod) ** 2
    return jnp.sqrt(jnp.sum(at_tip * at_tip) / square) / rod.L


class Swing(NamedTuple):
    """The first mode as a mass at the tip.

    `stiffness` [N/m], `frequency` [rad/s] without damping, `decay` [1/s] of its swings; `across`
    (intervals, 3, 3): what a force on each interval is as one on that mass.
    """

    stiffness: Float[Array, ""]
    frequency: Float[Array, ""]
    decay: Float[Array, ""]
    across: Float[Array, "intervals 3 3"]

    def force_at_tip(self, forces: Float[Array, "intervals 3"]) -> Float[Array, "3"]:
        """The force [N] at the tip that moves it as these do."""
        return jnp.einsum("kij,kj->i", self.across, forces)

    def stiffness_at_tip(self, held: Float[Array, "intervals 3 3"]) -> Float[Array, "3 3"]:
        """That [N/m] which springs on the intervals add."""
        return jnp.einsum("kij,kjl,kml->im", self.across, held, self.across)


def first_swing(tangent: Float[Array, "nodes 3"], rod: Rod, method: AbstractMethod) -> Swing:
    """That of a rod with this `tangent`. Forces along it do not count."""
    rod, unit = rod.relaxed, _unit(tangent)
    stiffness = _left_stiffness(rod, unit, method)
    x = method.outputs(rod.grid.s) / rod.L
    middle, along = 0.5 * (x[1:] + x[:-1]), _unit(unit[1:] + unit[:-1])
    across = jnp.eye(3) - along[:, :, None] * along[:, None, :]
    frequency = jnp.sqrt(stiffness / tip_mass(rod))
    return Swing(stiffness, frequency, _decay(rod), _shape(middle)[:, None, None] * across)


def _shape(x):
    """Of a cantilever with a force at its tip, by its places in lengths."""
    return 0.5 * x**2 * (3 - x)


def _left_stiffness(rod: Rod, unit, method: AbstractMethod) -> Float[Array, ""]:
    """What forces of fixed direction leave of the mode's stiffness [N/m]."""
    own = _stiffness(rod)
    left = own - _softening(rod, unit, method) if _has_dead_force(rod) else own
    return jnp.maximum(jnp.abs(left), _SOFTEST * own)


def _unit(tangent):
    return tangent / jnp.sqrt(jnp.sum(tangent * tangent, -1, keepdims=True))


def _stiffness(rod: Rod) -> Float[Array, ""]:
    """Of the mode without loads, at the tip [N/m]."""
    return 3 * jnp.min(rod.K_bt[..., :2]) / rod.L**3


def _decay(rod: Rod) -> Float[Array, ""]:
    """The rate [1/s] at which the mode's swings become less by damping, as far as believed."""
    if rod.B_bt is None:
        return jnp.zeros(())
    return _BELIEVED * 1.5 * jnp.min(rod.B_bt[..., :2]) / (rod.L**3 * tip_mass(rod))


def rate_of_change(
    rod: Rod, tangent: Float[Array, "nodes 3"], method: AbstractMethod
) -> Float[Array, ""]:
    """The rate [1/s] at which an error in the first bending mode grows or, below 0, is forgotten.

    Forces of fixed direction that press the rod together make that mode less stiff, and one that
    gives way falls on: with the shape of the mode for a trial one (Rayleigh), it is found unstable
    only where it is.

    A moment of fixed direction has no potential in space (Ziegler, Principles of Structural
    Stability, 1968). What of it points along the rod's `tangent` couples that mode in two planes
    by a skew matrix: a rod that is not damped flutters under any. With x in one plane and y in the
    other, (x + iy)_tt + 2 a (x + iy)_t + (omega^2 - i kappa) (x + iy) = 0. A moment on the way
    counts as if it were at the tip, which is cautious.
    """
    rod = rod.relaxed
    swings = decay = _decay(rod)
    if rod.B_bt is not None:
        # Where the mode creeps, the rate at which it does.
        damping = jnp.maximum(jnp.min(rod.B_bt[..., :2]), 1e-300)
        decay = jnp.minimum(swings, _BELIEVED * jnp.min(rod.K_bt[..., :2]) / damping)
    unit = _unit(tangent)
    moments = [] if rod.plane is not None else _moments_along(rod, unit)
    presses = _has_dead_force(rod)
    if not moments and not presses:
        return -decay
    along = sum(moments, jnp.zeros(()))
    kappa = 0.5 * _SLOPE**2 * along / (rod.L**2 * tip_mass(rod))
    softer = jnp.maximum(_softening(rod, unit, method), 0.0) if presses else 0.0
    square = swings**2 - (_stiffness(rod) - softer) / tip_mass(rod)
    root = jnp.sqrt(jnp.maximum(0.5 * (jnp.sqrt(square**2 + kappa**2) + square), 0.0))
    return jnp.maximum(root - swings, -decay)


def _has_dead_force(rod: Rod) -> bool:
    at_gaps = rod.at_gaps or ()
    along = any(load.F is not None and load.frame == "base" for load in at_gaps)
    return rod.F_tip is not None or rod.gravity is not None or along


def _softening(rod: Rod, unit: Float[Array, "nodes 3"], method: AbstractMethod) -> Float[Array, ""]:
    """By how much forces of fixed direction lower the first mode's stiffness [N/m].

    The integral of what presses along the rod times the mode's slope squared, that of a cantilever
    with a force at its tip; its displacement there is 1.
    """
    x = method.outputs(rod.grid.s) / rod.L
    pressed = -jnp.sum(_forces_beyond(rod, x, method) * unit, -1)
    slope = 3 * x * (1 - x / 2) / rod.L
    f = pressed * slope**2
    return jnp.sum(0.5 * jnp.diff(x) * (f[1:] + f[:-1])) * rod.L


def _forces_beyond(rod: Rod, x, method: AbstractMethod) -> Float[Array, "nodes 3"]:
    """The sum [N] of all forces of fixed direction beyond each node, in the frame of `tangent`.

    `x` (nodes,): where the nodes are, in lengths.
    """
    force = jnp.zeros((*x.shape, rod.v_star.shape[-1]))
    if rod.F_tip is not None:
        force += rod.F_tip
    if rod.weight is not None and rod.gravity is not None:
        weight = jnp.broadcast_to(rod.weight, (*rod.grid.s.shape, rod.weight.shape[-1]))
        weight = method.outputs(weight)
        parts = 0.5 * jnp.diff(x)[:, None] * rod.L * (weight[1:] + weight[:-1])
        force = force.at[:-1].add(jnp.cumsum(parts[::-1], axis=0)[::-1])
        force += 0.0 if rod.payload is None else rod.payload * rod.gravity
    for load in rod.at_gaps or ():
        before = jnp.arange(x.shape[0])[:, None] <= rod.grid.gaps
        there = (before @ load.here)[:, None]
        if load.F is not None and load.frame == "base":
            force += there * load.F
        if load.mass is not None and rod.gravity is not None:
            force += there * load.mass * rod.gravity
    if rod.plane is None:
        return force
    return _vector_in_space(to_body(rod.h_base, force), rod.plane)


def _vector_in_space(a: Float[Array, "nodes 2"], plane: str) -> Float[Array, "nodes 3"]:
    return in_space(jnp.pad(a, ((0, 0), (0, 1))), plane)[:, :3]


def _moments_along(rod: Rod, unit: Float[Array, "nodes 3"]) -> list[Float[Array, ""]]:
    """The size of what each moment of fixed direction has along the rod where it acts [N m]."""
    moments = [] if rod.M_tip is None else [rod.M_tip @ unit[-1]]
    for load in rod.at_gaps or ():
        if load.M is not None and load.frame == "base":
            moments.append(load.here @ (unit[rod.grid.gaps] @ load.M))
    return [jnp.abs(moment) for moment in moments]
