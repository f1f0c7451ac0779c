"""The error of the tip from the steps in time, estimated while a motion is marched.

Every step makes a local error, in modes of the rod that it resolves and in those that it does not.
An oscillation turns a local error about but does not undo it: local errors are added up by
their size, and not as vectors. What damping makes a rod forget is forgotten, and what a force that
presses the rod together or a moment in space makes grow has grown. The estimate is thus a cautious
one, and costs a few operations along the rod a step.

Errors of the speed are not counted beside those of the place: a motion that swings has both, of
about the same size, and to add them made the estimate six times as large in the median, and the
least ratios to the error no larger.
"""

import jax.numpy as jnp
from jaxtyping import Array, Float

from softrod_jax.bvp.method import AbstractMethod
from softrod_jax.rod.constants import Rod, full_strain
from softrod_jax.rod.rotations import cross, to_base, to_body
from softrod_jax.rod.shape import ORIGIN
from softrod_jax.scene.planes import in_space
from softrod_jax.stepping.scheme import LocalErrors

# An error of this many lengths doubles: it changes the motion in which later errors are made. The
# estimate without that and the true error had ratios from 0.38 on, in the median 2.8, below 1 where
# errors were large (motions of `benchmarks/judge_motion.py`, judged by an independent code).
_DOUBLES = 0.1
# Of 144 judged motions the least estimate without this factor was 0.32 of the error.
_CAUTION = 1.3
# Of the slowest decay of a bending mode, the part that is believed.
_BELIEVED = 0.7
# The slope at the tip of a cantilever's first mode, in tip displacements per length.
_SLOPE = 1.3765
# The part of a rod's mass that counts at the tip in the first mode of a cantilever.
EFFECTIVE_MASS = 0.2427


def tip_mass(rod: Rod) -> Float[Array, ""]:
    """The mass [kg] at the tip of a cantilever without mass that swings as slowly."""
    return EFFECTIVE_MASS * rod.mass + (0.0 if rod.payload is None else rod.payload)


def accumulated(total, errors: LocalErrors, dt, strain, rod: Rod, method: AbstractMethod):
    """The estimate after a step of `dt`, in lengths, from the one before it, `total`.

    `strain` (points, n): at the end of the step; `errors`: local ones of (strains, velocities).
    Of the estimates of one local error the smallest is taken: each is about as large as the
    error, or larger.
    """
    clamp = rod.h_base if rod.plane is None else ORIGIN[1]
    _, attitude = method.shape(full_strain(strain, rod), rod.grid, ORIGIN[0], clamp)
    tangent = to_base(attitude, method.outputs(full_strain(strain, rod))[:, :3])
    moved = [
        largest_displacement(error[0], tangent, attitude, rod, method)
        for error in (errors.lower, errors.difference)
        if error is not None
    ]
    # What grows by more in a step is an oscillation that the scheme damps out.
    changed = jnp.exp(jnp.minimum(rate_of_change(rod, tangent, method) * dt, 1.0))
    return changed * total + jnp.min(jnp.stack(moved), axis=0)


def grown(total) -> Float[Array, ""]:
    """The estimate with what the local errors of `accumulated` have become since they were made."""
    return _CAUTION * total * (1 + total / _DOUBLES)


def largest_displacement(
    change, tangent, attitude, rod: Rod, method: AbstractMethod
) -> Float[Array, ""]:
    """How far a small `change` of the strains (points, n) moves a point of the rod, in lengths.

    `tangent` (nodes, 3) and `attitude` (nodes, 4) of the rod are in the base frame.

    The maximum along the rod and not the tip's: modes whose displacements of the tip cancel now
    do not cancel later.
    """
    if rod.K_se is None:
        stretch = jnp.zeros((change.shape[0], rod.v_star.shape[-1]))
        change = jnp.concatenate([stretch, change], -1)
    change = method.outputs(in_space(change, rod.plane))
    grid = rod.grid
    spacing = rod.L / (change.shape[0] - 1)
    if grid.division is not None:
        spacing = jnp.diff(method.outputs(grid.s))[:, None]
    turned = _integral(to_base(attitude, change[:, 3:]), spacing)
    moved = _integral(to_base(attitude, change[:, :3]) + cross(turned, tangent), spacing)
    return jnp.sqrt(jnp.max(jnp.sum(moved * moved, -1))) / rod.L


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
    if rod.B_bt is None:
        swings = decay = jnp.zeros(())
    else:
        damping = jnp.min(rod.B_bt[..., :2])
        swings = _BELIEVED * 1.5 * damping / (rod.L**3 * tip_mass(rod))
        # Where the mode creeps, the rate at which it does.
        creeps = jnp.min(rod.K_bt[..., :2]) / jnp.maximum(damping, 1e-300)
        decay = jnp.minimum(swings, _BELIEVED * creeps)
    unit = tangent / jnp.sqrt(jnp.sum(tangent * tangent, -1, keepdims=True))
    moments = [] if rod.plane is not None else _moments_along(rod, unit)
    presses = _has_dead_force(rod)
    if not moments and not presses:
        return -decay
    along = sum(moments, jnp.zeros(()))
    kappa = 0.5 * _SLOPE**2 * along / (rod.L**2 * tip_mass(rod))
    softer = jnp.maximum(_softening(rod, unit, method), 0.0) if presses else 0.0
    stiffness = 3 * jnp.min(rod.K_bt[..., :2]) / rod.L**3 - softer
    square = swings**2 - stiffness / tip_mass(rod)
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
    """The sum [N] of all forces of fixed direction beyond each node, in the frame of `accumulated`.

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


def _integral(f: Float[Array, "nodes 3"], spacing) -> Float[Array, "nodes 3"]:
    """From the clamp to every node, by the trapezoidal rule."""
    parts = 0.5 * spacing * (f[1:] + f[:-1])
    return jnp.concatenate([jnp.zeros_like(f[:1]), jnp.cumsum(parts, axis=0)])
