"""Checks of tensions and pressures: what can be known at once raises, the rest becomes a code."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from softrod_jax.rod import Rod
from softrod_jax.scene import Scene


def is_traced(*trees) -> bool:
    """Whether any number in them is known only when the program runs (jit, vmap, grad)."""
    return any(isinstance(x, jax.core.Tracer) for x in jax.tree.leaves(trees))


def actuation(who: str, scene: Scene, tensions, pressures, ndim: int):
    """Tensions and pressures as arrays, or `None`.

    `ndim` 1: one value an actuator; 2: one row a step. Raises `ValueError` for an actuator that
    the scene does not have, a wrong shape, a value that is not finite, or a negative tension.
    """
    tensions = _checked(who, "tensions", "tendons", scene.tendons, tensions, ndim)
    pressures = _checked(who, "pressures", "chambers", scene.chambers, pressures, ndim)
    if tensions is not None and not isinstance(tensions, jax.core.Tracer):
        lowest = float(np.min(np.asarray(tensions), initial=0.0))
        if lowest < 0:
            raise ValueError(
                f"{who}: tensions has a negative value, {lowest:g} N; a tendon can only pull"
            )
    return tensions, pressures


def _checked(who, name, part, actuators, values, ndim):
    if values is None:
        return None
    values = jnp.asarray(values, dtype=float)
    if actuators is None:
        raise ValueError(
            f"{who}: {name} given, but the scene has no {part}; leave {name} out, or add {part}"
        )
    count = actuators.count
    shape = f"({count},)" if ndim == 1 else f"(steps, {count})"
    if values.ndim != ndim or values.shape[-1] != count:
        raise ValueError(
            f"{who}: {name} has shape {values.shape}; the scene's {part} need {shape}"
        )
    if not isinstance(values, jax.core.Tracer) and not np.all(np.isfinite(values)):
        raise ValueError(f"{who}: {name} has a value that is not finite")
    return values


def valid_actuation(rod: Rod):
    """The rod with traced inputs that cannot be solved set to zero, and whether all were good.

    The zeros keep a bad sample's arithmetic finite; its result code says that it is no answer.
    """
    good = jnp.array(True)
    for x in (rod.tau, rod.n_ch, rod.m_ch):
        if x is not None:
            good &= jnp.all(jnp.isfinite(x))
    if rod.tau is not None:
        good &= jnp.all(rod.tau >= 0)
    names = [n for n in ("tau", "n_ch", "m_ch") if getattr(rod, n) is not None]
    pick = lambda r: [getattr(r, n) for n in names]
    if names:
        rod = eqx.tree_at(pick, rod, [jnp.where(good, x, jnp.zeros_like(x)) for x in pick(rod)])
    return rod, good
