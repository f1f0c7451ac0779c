"""Limits of inputs, by the names of their kinds, and inputs all over them."""

from collections.abc import Mapping

import jax.numpy as jnp
import numpy as np

from softrod_jax.scene.inputs import KINDS, Inputs
from softrod_jax.scene.scene import Scene

Limits = Mapping[str, tuple]


def checked_limits(who: str, scene: Scene, limits: Limits) -> tuple[Inputs, Inputs]:
    """The lowest and the highest inputs, of those kinds that have limits.

    Raises `ValueError` for what is no limit, or of no actuator of the scene.
    """
    kinds = {kind.name: kind for kind in KINDS}
    if not isinstance(limits, Mapping) or not limits:
        offered = ", ".join(f'"{name}"' for name, kind in kinds.items() if kind.count(scene))
        raise ValueError(f"{who}: limits={limits!r}; a dictionary is needed, with {offered}")
    low, high = {}, {}
    for name, given in limits.items():
        kind = kinds.get(name)
        if kind is None or not kind.count(scene):
            raise ValueError(f"{who}: limits for {name!r}, of which the scene has none")
        count = kind.count(scene)
        try:
            pair = [np.asarray(x, dtype=float) for x in given]
            lowest, highest = (np.broadcast_to(x, (count,)) for x in pair)
        except (TypeError, ValueError):
            raise ValueError(
                f"{who}: limits[{name!r}] = {given!r}; a lowest and a highest value are needed, "
                f"each a number or {count} of them"
            ) from None
        if not np.all(highest > lowest) or not np.all(np.isfinite([lowest, highest])):
            raise ValueError(f"{who}: limits[{name!r}] = {given!r}; expected lowest < highest")
        if np.min(lowest) < kind.at_least:
            raise ValueError(
                f"{who}: limits[{name!r}] = {given!r}; {kind.reason}: at least {kind.at_least:g}"
            )
        low[name], high[name] = jnp.asarray(lowest), jnp.asarray(highest)
    return Inputs(**low), Inputs(**high)


def spread_out(count: int, m: int) -> np.ndarray:
    """Points in [0, 1]^m, (count, m): multiples of powers of a root of x^(m+1) = x + 1."""
    root = 1.5
    for _ in range(60):
        root = (1 + root) ** (1 / (m + 1))
    return (0.5 + np.arange(1, count + 1)[:, None] * root ** -np.arange(1.0, m + 1)) % 1.0
