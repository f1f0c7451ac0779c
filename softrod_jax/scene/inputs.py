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
from softrod_jax.scene.tendons import driven_by_length


class Inputs(NamedTuple):
    """What drives a rod: one value for each actuator or, in a motion, one row a step.

    `tensions` [N] of the tendons driven by tension, `pressures` [Pa], (chambers,), and `pulls` [m]
    of the tendons driven by length: by how much each is shorter than at rest. `None`: those
    actuators are left out of the program. What handles inputs handles this pytree; only their
    physics knows names.
    """

    tensions: ManyLike | RowsLike | None = None
    pressures: ManyLike | RowsLike | None = None
    pulls: ManyLike | RowsLike | None = None


class Kind(NamedTuple):
    """A kind of inputs: all that is said of it anywhere by its name.

    - `name` in `Inputs`; `part`: what of a scene it drives; `control`: of those of that part whose
      `control` is this word only, where it is one.
    - `quantity`, `unit`; `column`: of a log, with its number instead of "{}". `shown`: the unit in
      pictures, and the size of the unit in it.
    - `at_least`: how low it may be, for what `reason`.
    - `is_place`: whether it says where an actuator is, which cannot jump.
    """

    name: str
    part: str
    control: str | None
    quantity: str
    unit: str
    column: str
    shown: tuple[str, float]
    at_least: float = -np.inf
    reason: str = ""
    is_place: bool = False

    @property
    def one(self) -> str:
        """Its name in the singular."""
        return self.name.removesuffix("s")

    def of(self, scene: Scene) -> str:
        """What of a scene it drives, in the plural, for messages."""
        if self.control is None or (self.control == "tension" and not _any_by_length(scene)):
            return self.part
        return f"{self.part} driven by {self.control}"

    def count(self, scene: Scene) -> int:
        """How many actuators of a scene it drives."""
        actuators = getattr(scene, self.part)
        if actuators is None:
            return 0
        if self.control is None:
            return actuators.count
        by_length = len(driven_by_length(actuators))
        return by_length if self.control == "length" else actuators.count - by_length


def _any_by_length(scene: Scene) -> bool:
    return scene.tendons is not None and bool(driven_by_length(scene.tendons))


# Those of the inputs, in their order.
KINDS = (
    Kind(
        name="tensions",
        part="tendons",
        control="tension",
        quantity="force",
        unit="N",
        column="tau{}_N",
        shown=("N", 1.0),
        at_least=0.0,
        reason="a tendon can only pull",
    ),
    Kind(
        name="pressures",
        part="chambers",
        control=None,
        quantity="pressure",
        unit="Pa",
        column="p{}_Pa",
        shown=("kPa", 1e-3),
    ),
    Kind(
        name="pulls",
        part="tendons",
        control="length",
        quantity="length",
        unit="m",
        column="pull{}_m",
        shown=("mm", 1e3),
        is_place=True,
    ),
)


def checked_inputs(who: str, scene: Scene, inputs: Inputs, ndim: int) -> Inputs:
    """The inputs as arrays, or `None`.

    `ndim` 1: one value an actuator; 2: one row a step. Raises `ValueError` for an actuator that
    the scene does not have, a wrong shape, a value that is not finite, or a negative tension.
    """
    each = zip(KINDS, inputs, strict=True)
    return Inputs(*(_checked(who, scene, kind, given, ndim) for kind, given in each))


def _checked(who, scene, kind, given, ndim):
    if given is None:
        return None
    count, name, part = kind.count(scene), kind.name, kind.of(scene)
    try:
        values = jnp.asarray(given, dtype=float)
    except (TypeError, ValueError):
        raise ValueError(f"{who}: {name} = {given!r} is not an array of numbers") from None
    if count == 0:
        raise ValueError(
            f"{who}: {name} given, but the scene has no {part}; leave {name} out, or add {part}"
            + _other_input(scene, kind)
        )
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


def _other_input(scene: Scene, kind: Kind) -> str:
    """What drives a scene's tendons instead, where it has any."""
    if scene.tendons is None or kind.control is None:
        return ""
    given = "tension" if kind.control == "length" else "length"
    return f' (the scene\'s tendons have control = "{given}")'


def filled(scene: Scene, inputs: Inputs, rows: tuple[int, ...] = ()) -> Inputs:
    """The inputs with zeros, (*rows, actuators), for actuators of the scene that have none."""

    def one(kind, values):
        count = kind.count(scene)
        return jnp.zeros((*rows, count)) if values is None and count else values

    return Inputs(*map(one, KINDS, inputs))


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
    for kind, values in zip(KINDS, inputs, strict=True):
        if values is not None:
            values = jnp.asarray(values)
            good &= jnp.all(jnp.isfinite(values) & (values >= kind.at_least), axis=-1)
    return good


def zero_unless(good: Bool[Array, "*rows"], inputs: Inputs) -> Inputs:
    """The inputs, (*rows, actuators) each, with zeros for rows that are not good.

    The zeros keep a bad sample's arithmetic finite; its result code says that it is no answer.
    """
    return jax.tree.map(lambda x: jnp.where(good[..., None], x, 0.0), inputs)


def after_play(
    scene: Scene, inputs: Inputs, before: Float[Array, "by_length"] | None = None
) -> Inputs:
    """Constant inputs, the pulls as tendons follow them: behind the play of their actuators.

    `before` [m]: how far tendons had followed; not at all if `None`. A tendon stays where it is
    while the pull moves within the play, half of it to either side.
    """
    play = _play(scene)
    if play is None or inputs.pulls is None:
        return inputs
    pulls, (has, play) = jnp.asarray(inputs.pulls), play
    before = jnp.zeros_like(pulls) if before is None else before
    behind = jnp.clip(before, pulls - 0.5 * play, pulls + 0.5 * play)
    return inputs._replace(pulls=jnp.where(has, behind, pulls))


def after_play_in_time(
    scene: Scene, inputs: Inputs, before: Float[Array, "by_length"] | None = None
) -> Inputs:
    """The same of inputs in time, (steps, actuators) each."""
    if _play(scene) is None or inputs.pulls is None:
        return inputs
    pulls = jnp.asarray(inputs.pulls)
    start = jnp.zeros_like(pulls[0]) if before is None else before

    def follow(before, row):
        now = after_play(scene, Inputs(pulls=row), before).pulls
        return now, now

    return inputs._replace(pulls=jax.lax.scan(follow, start, pulls)[1])


def _play(scene: Scene):
    """Of each tendon driven by length, whether its actuator has play, and how much [m]."""
    tendons = scene.tendons
    by_length = driven_by_length(tendons)
    if not by_length or tendons is None or tendons.backlash is None:
        return None
    own = [tendons.backlash[i] for i in by_length]
    if all(x is None for x in own):
        return None
    has = np.array([x is not None for x in own])
    return has, jnp.stack(
        [jnp.zeros(()) if x is None else jnp.asarray(x, dtype=float) for x in own]
    )
