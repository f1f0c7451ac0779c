"""The rod as a layer of a larger model: actuation sequences in, tip paths out."""

import operator
from collections.abc import Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float, Int, Real

from softrod_jax.bvp.collocation import Collocation
from softrod_jax.bvp.method import AbstractMethod
from softrod_jax.bvp.newton import NewtonOptions
from softrod_jax.dynamics import simulate
from softrod_jax.foundation.numbers import ManyLike, ScalarLike
from softrod_jax.foundation.precision import require_float64
from softrod_jax.scene.checks import checked_scene
from softrod_jax.scene.inputs import time_step, whole_number
from softrod_jax.scene.scene import Scene
from softrod_jax.statics import StaticSolution
from softrod_jax.stepping.scheme import AbstractTimeScheme
from softrod_jax.stepping.sdirk import SDIRK


class RodPath(NamedTuple):
    """`tip_positions` [m], (steps, 3), at the end of each step; `result`: a code of `RESULTS`.

    Where it is not 0, the tip is held where it was, with the derivative zero.
    """

    tip_positions: Float[Array, "steps 3"]
    result: Int[Array, ""]


class RodLayer(eqx.Module):
    """A scene, parts of which are trained.

    - `positive`: parts that are trained as logarithms, so that they stay above zero and a learning
      rate is a relative change, as "young_modulus"; a dot leads on to a part of a part, as in
      "payload.mass".
    - `free`: parts that may have either sign, as "rest_curvature"; trained as they are.
    - the other arguments are those of `simulate`.

    What is not named has the gradient zero. An optimiser that changes numbers without a gradient,
    as weight decay does, has to be kept from them: `eqx.partition(model, ...)`.
    Raises `ValueError` for a part that the scene does not have, or a `positive` one that is not.
    """

    logarithms: dict[str, Array]
    values: dict[str, Array]
    untrained: Scene
    dt: Float[Array, ""]
    scheme: AbstractTimeScheme
    method: AbstractMethod
    newton: NewtonOptions
    substeps: int = eqx.field(static=True)

    def __init__(
        self,
        scene: Scene,
        dt: ScalarLike,
        *,
        positive: Sequence[str] = (),
        free: Sequence[str] = (),
        substeps: int = 1,
        scheme: AbstractTimeScheme = SDIRK(),  # noqa: B008
        method: AbstractMethod = Collocation(),  # noqa: B008
        newton: NewtonOptions = NewtonOptions(),  # noqa: B008
    ):
        require_float64("RodLayer")
        self.untrained = scene = checked_scene("RodLayer", scene)
        self.logarithms = {name: jnp.log(_positive(scene, name)) for name in positive}
        self.values = {name: _part(scene, name) for name in free}
        both = set(positive) & set(free)
        if both:
            raise ValueError(f"RodLayer: {sorted(both)} in `positive` and in `free`; name it once")
        self.dt = time_step("RodLayer", dt)
        self.substeps = whole_number("RodLayer", "substeps", substeps)
        self.scheme, self.method, self.newton = scheme, method, newton

    @property
    def scene(self) -> Scene:
        """The scene as it is now; save it with `save_scene`."""
        parts = {**self.values, **{name: jnp.exp(x) for name, x in self.logarithms.items()}}
        scene = jax.lax.stop_gradient(self.untrained)
        if not parts:
            return scene
        pick = lambda scene: [operator.attrgetter(name)(scene) for name in parts]
        return eqx.tree_at(pick, scene, list(parts.values()))

    def __call__(
        self,
        tensions: Real[Array | np.ndarray, "steps by_tension"] | Sequence[ManyLike] | None = None,
        pressures: Real[Array | np.ndarray, "steps chambers"] | Sequence[ManyLike] | None = None,
        pulls: Real[Array | np.ndarray, "steps by_length"] | Sequence[ManyLike] | None = None,
        *,
        initial: StaticSolution | None = None,
    ) -> RodPath:
        """The path of the tip from rest, as in `simulate`, without an error where it fails.

        The steps are taken as they are: no code says that they are too long for the motion.
        For one sequence; use `jax.vmap` for a batch. Raises `ValueError` as `simulate` does.
        """
        motion = simulate(
            self.scene,
            jax.lax.stop_gradient(self.dt),
            tensions,
            pressures,
            pulls,
            substeps=self.substeps,
            initial=initial,
            scheme=self.scheme,
            method=self.method,
            newton=self.newton,
            # The steps are a part of the model: what they miss is learned like the rest.
            max_time_error=jnp.inf,
            throw=False,
        )
        return RodPath(motion.tip_positions[1:], motion.result)


def _part(scene, name) -> Array:
    try:
        value = operator.attrgetter(name)(scene)
    except AttributeError:
        value = None
    if value is None or not eqx.is_inexact_array(value):
        raise ValueError(
            f"RodLayer: the scene has no number or array {name!r}; name a part of it that is "
            'there, such as "young_modulus" or "payload.mass"'
        )
    return value


def _positive(scene, name) -> Array:
    value = _part(scene, name)
    if not isinstance(value, Tracer) and not np.all(np.asarray(value) > 0):
        raise ValueError(
            f"RodLayer: {name} = {value} is not above zero and has no logarithm; name it in "
            "`free`, or start from a positive value"
        )
    return value
