"""The inputs that drive a rod, and their checks: errors where they are known, else a code."""

import operator
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Bool, Float

from softrod_jax.foundation.numbers import ManyLike, RowsLike
from softrod_jax.scene.scene import Scene


class Inputs(NamedTuple):
    """What drives a rod: one value for each actuator or, in a motion, one row a step.

    `tensions` [N], (tendons,), and `pressures` [Pa], (chambers,). `None`: those actuators are left
    out of the program. What handles inputs handles this pytree; only their physics knows names.
    """

    tensions: ManyLike | RowsLike | None = None
    pressures: ManyLike | RowsLike | None = None


class _Kind(NamedTuple):
    """Which part of a scene an input drives, its unit, and how low it may be and why."""

    part: str
    unit: str
    at_least: float = -np.inf
    reason: str = ""


# Those of the inputs, in their order.
_KINDS = (
    _Kind("tendons", "N", 0.0, "a tendon can only pull"),
    _Kind("chambers", "Pa"),
)


def checked_inputs(who: str, scene: Scene, inputs: Inputs, ndim: int) -> Inputs:
    """The inputs as arrays, or `None`.

    `ndim` 1: one value an actuator; 2: one row a step. Raises `ValueError` for an actuator that
    the scene does not have, a wrong shape, a value that is not finite, or a negative tension.
    """
    each = zip(Inputs._fields, _KINDS, inputs, strict=True)
    return Inputs(*(_checked(who, scene, name, kind, given, ndim) for name, kind, given in each))


def _checked(who, scene, name, kind, given, ndim):
    if given is None:
        return None
    actuators, part = getattr(scene, kind.part), kind.part
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
    if not _is_number(given):
        return values
    known = np.asarray(given, dtype=float)
    if not np.all(np.isfinite(known)):
        raise ValueError(f"{who}: {name} has a value that is not finite")
    lowest = np.min(known, initial=np.inf)
    if lowest < kind.at_least:
        raise ValueError(
            f"{who}: {name} has a negative value, {lowest:g} {kind.unit}; {kind.reason}"
        )
    return values


def filled(scene: Scene, inputs: Inputs, rows: tuple[int, ...] = ()) -> Inputs:
    """The inputs with zeros, (*rows, actuators), for actuators of the scene that have none."""

    def one(kind, values):
        actuators = getattr(scene, kind.part)
        if values is not None or actuators is None:
            return values
        return jnp.zeros((*rows, actuators.count))

    return Inputs(*map(one, _KINDS, inputs))


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


def good_inputs(inputs: Inputs) -> Bool[Array, "*rows"]:
    """Whether all inputs are finite and none is too low, such as a tension below zero; by row."""
    good = jnp.array(True)
    for kind, values in zip(_KINDS, inputs, strict=True):
        if values is not None:
            values = jnp.asarray(values)
            good &= jnp.all(jnp.isfinite(values) & (values >= kind.at_least), axis=-1)
    return good


def zero_unless(good: Bool[Array, "*rows"], inputs: Inputs) -> Inputs:
    """The inputs, (*rows, actuators) each, with zeros for rows that are not good.

    The zeros keep a bad sample's arithmetic finite; its result code says that it is no answer.
    """
    return jax.tree.map(lambda x: jnp.where(good[..., None], x, 0.0), inputs)
