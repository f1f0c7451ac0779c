"""Checks of inputs: what can be known at once raises, the rest becomes a code."""

import operator

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Bool, Float

from softrod_jax.scene.scene import Scene


def actuation(who: str, scene: Scene, tensions, pressures, ndim: int):
    """Tensions and pressures as arrays, or `None`.

    `ndim` 1: one value an actuator; 2: one row a step. Raises `ValueError` for an actuator that
    the scene does not have, a wrong shape, a value that is not finite, or a negative tension.
    """
    given = tensions
    tensions = _checked(who, "tensions", "tendons", scene.tendons, tensions, ndim)
    pressures = _checked(who, "pressures", "chambers", scene.chambers, pressures, ndim)
    if tensions is not None and _is_number(given):
        lowest = float(np.min(np.asarray(given), initial=0.0))
        if lowest < 0:
            raise ValueError(
                f"{who}: tensions has a negative value, {lowest:g} N; a tendon can only pull"
            )
    return tensions, pressures


def _checked(who, name, part, actuators, given, ndim):
    if given is None:
        return None
    try:
        values = jnp.asarray(given, dtype=float)
    except (TypeError, ValueError):
        raise ValueError(f"{who}: {name} = {given!r} is not an array of numbers") from None
    if actuators is None:
        raise ValueError(
            f"{who}: {name} given, but the scene has no {part}; leave {name} out, or add {part}"
        )
    count = actuators.count
    shape = f"({count},)" if ndim == 1 else f"(steps, {count})"
    if values.ndim != ndim or values.shape[-1] != count:
        raise ValueError(f"{who}: {name} has shape {values.shape}; the scene's {part} need {shape}")
    if _is_number(given) and not np.all(np.isfinite(np.asarray(given, dtype=float))):
        raise ValueError(f"{who}: {name} has a value that is not finite")
    return values


def _is_number(given) -> bool:
    """Whether it is known now; what becomes of it under `jit` is not."""
    return not any(isinstance(x, Tracer) for x in jax.tree.leaves(given))


def time_step(who: str, dt) -> Float[Array, ""]:
    """`dt` [s] as an array. Raises `ValueError` for a wrong shape, or unless it is above zero."""
    complaint = ValueError(f"{who}: dt={dt} s; a positive number is needed")
    try:
        step = jnp.asarray(dt, dtype=float)
    except (TypeError, ValueError):
        raise complaint from None
    if step.ndim != 0 or (_is_number(dt) and not 0 < float(dt) < np.inf):
        raise complaint
    return step


def whole_number(who: str, name: str, value) -> int:
    """`value` as Python's int. Raises `ValueError` unless it is a whole number from 1."""
    try:
        count = operator.index(value)
    except TypeError:
        count = 0
    if count < 1 or isinstance(value, bool):
        raise ValueError(f"{who}: {name}={value!r}; a whole number from 1 is needed")
    return count


def good_inputs(
    tensions: Float[Array, "*rows tendons"] | None, pressures: Float[Array, "*rows chambers"] | None
) -> Bool[Array, "*#rows"]:
    """Whether all are finite and no tendon pushes; of each row."""
    good = jnp.array(True)
    if tensions is not None:
        good &= jnp.all(jnp.isfinite(tensions) & (tensions >= 0), axis=-1)
    if pressures is not None:
        good &= jnp.all(jnp.isfinite(pressures), axis=-1)
    return good


def zero_unless(good: Bool[Array, "*rows"], inputs):
    """The inputs, (*rows, actuators) each, with zeros for rows that are not good.

    The zeros keep a bad sample's arithmetic finite; its result code says that it is no answer.
    """
    return jax.tree.map(lambda x: jnp.where(good[..., None], x, 0.0), inputs)
