"""Which inputs and outputs a model has, by their names, and the equilibrium that it is about."""

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax.numpy as jnp
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float

from softrod_jax.analysis.near_rest import Applied, NearRest, check_smooth, near_rest
from softrod_jax.analysis.seen import names_of
from softrod_jax.foundation.precision import require_float64
from softrod_jax.scene.checks import checked_scene
from softrod_jax.scene.inputs import KINDS, Inputs, checked_inputs, filled
from softrod_jax.scene.loads import TipLoad
from softrod_jax.scene.scene import Scene
from softrod_jax.statics import StaticSolution, solve_static

_TIP = {"tip_force": "tip_F{}_N", "tip_moment": "tip_M{}_Nm"}


class Chosen(NamedTuple):
    """The inputs and outputs that `who` is asked for; `None`: all actuators, or the tip force."""

    who: str
    inputs: Sequence[str] | None
    outputs: Sequence[str]


class Names(NamedTuple):
    """Inputs and outputs, and a name with its unit for each number of them."""

    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    of_inputs: tuple[str, ...]
    of_outputs: tuple[str, ...]


def at_equilibrium(
    scene: Scene, inputs: Inputs, chosen: Chosen, **solving
) -> tuple[NearRest, Names, StaticSolution]:
    """The equations about the equilibrium of `scene` under `inputs`, zero where none are given.

    `solving`: what else `solve_static` takes. Raises `ValueError` for what has no derivative at
    rest, and for inputs and outputs that the scene does not have.
    """
    who = chosen.who
    require_float64(who)
    given, scene = scene, checked_scene(who, scene)
    check_smooth(who, scene)
    values: Any = filled(scene, checked_inputs(who, scene, inputs, ndim=1))
    kinds = _kinds(who, scene, chosen.inputs)
    if any(kind in _TIP for kind in kinds):
        given, scene = _with_tip_load(given), _with_tip_load(scene)
    solution = solve_static(given, *values, **solving)
    outputs = _words(chosen.outputs)
    of_outputs = names_of(who, scene, outputs, solution.arc_lengths.shape[0])
    names = Names(kinds, outputs, _names_of(scene, kinds), of_outputs)
    return near_rest(scene, values, solution), names, solution


def applied_by(near: NearRest, kinds: tuple[str, ...]) -> tuple[Callable, Float[Array, "m"]]:
    """What acts as a function of the changes of these inputs, (m,), and what they are now."""
    applied = near.applied
    values = [getattr(applied if x in _TIP else applied.inputs, x) for x in kinds]
    now, as_values = ravel_pytree(values)

    def changed(u) -> Applied:
        new = dict(zip(kinds, as_values(now + u), strict=True))
        at_tip = {name: x for name, x in new.items() if name in _TIP}
        others = {name: x for name, x in new.items() if name not in _TIP}
        return applied._replace(inputs=applied.inputs._replace(**others), **at_tip)

    return changed, now


def _with_tip_load(scene: Scene) -> Scene:
    """With a force and a moment at the tip, zero where there are none."""
    load = scene.tip_load
    force, moment = (None, None) if load is None else (load.force, load.moment)
    zero = lambda x: jnp.zeros(3) if x is None else x
    return dataclasses.replace(scene, tip_load=TipLoad(zero(force), zero(moment)))


def _words(names: Sequence[str]) -> tuple[str, ...]:
    return (names,) if isinstance(names, str) else tuple(names)


def _kinds(who: str, scene: Scene, inputs: Sequence[str] | None) -> tuple[str, ...]:
    own = tuple(kind.name for kind in KINDS if kind.count(scene))
    if inputs is None:
        return own or ("tip_force",)
    offered = (*own, *_TIP)
    for name in _words(inputs):
        if name not in offered:
            shown = ", ".join(f'"{x}"' for x in offered)
            raise ValueError(f"{who}: input {name!r} is not one of this scene: {shown}")
    return _words(inputs)


def _names_of(scene: Scene, kinds: tuple[str, ...]) -> tuple[str, ...]:
    counts = {kind.name: (kind.column, kind.count(scene)) for kind in KINDS}
    names = []
    for name in kinds:
        if name in _TIP:
            names += [_TIP[name].format(axis) for axis in "xyz"]
        else:
            column, count = counts[name]
            names += [column.format(i + 1) for i in range(count)]
    return tuple(names)
