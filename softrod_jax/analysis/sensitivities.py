"""How an equilibrium gives way to loads, and follows its actuators, to first order."""

from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Real

from softrod_jax.analysis.inputs_and_outputs import Chosen, applied_by, at_equilibrium
from softrod_jax.analysis.near_rest import NearRest
from softrod_jax.analysis.seen import observed
from softrod_jax.bvp.method import AbstractMethod
from softrod_jax.foundation.compiling import compiled
from softrod_jax.foundation.numbers import ScalarLike
from softrod_jax.scene.inputs import Inputs
from softrod_jax.scene.scene import Scene
from softrod_jax.statics import StaticSolution


def compliance(
    scene: Scene,
    tensions: Real[Array | np.ndarray, "by_tension"] | Sequence[ScalarLike] | None = None,
    pressures: Real[Array | np.ndarray, "chambers"] | Sequence[ScalarLike] | None = None,
    pulls: Real[Array | np.ndarray, "by_length"] | Sequence[ScalarLike] | None = None,
    *,
    of: str = "tip",
    before: StaticSolution | None = None,
    method: AbstractMethod | None = None,
    throw: bool = True,
) -> Float[Array, "6 6"]:
    """How the pose of the tip, or of the marker `of`, follows a force and a moment at the tip.

    Rows: position [m] and rotation [rad]; columns: force [N] and moment [N m]; all along the axes
    of the base. Tensions stay as they are, and so do the lengths of tendons driven by length: a
    robot that is held by lengths is stiffer. Other arguments: as of `solve_static`.

    Raises `ValueError` as `linearise` does.
    """
    chosen = Chosen("compliance", ("tip_force", "tip_moment"), (of,))
    solving = dict(before=before, method=method, throw=throw)
    near, names, _ = at_equilibrium(scene, Inputs(tensions, pressures, pulls), chosen, **solving)
    return _gain(near, names.inputs, names.outputs)


def actuation_jacobian(
    scene: Scene,
    tensions: Real[Array | np.ndarray, "by_tension"] | Sequence[ScalarLike] | None = None,
    pressures: Real[Array | np.ndarray, "chambers"] | Sequence[ScalarLike] | None = None,
    pulls: Real[Array | np.ndarray, "by_length"] | Sequence[ScalarLike] | None = None,
    *,
    of: str = "tip",
    before: StaticSolution | None = None,
    method: AbstractMethod | None = None,
    throw: bool = True,
) -> Float[Array, "6 inputs"]:
    """How the pose of the tip, or of the marker `of`, follows the inputs.

    Rows: position [m] and rotation [rad] about the axes of the base; columns: tensions, pressures
    and pulls, as far as the scene has them. Other arguments: as of `solve_static`.

    Raises `ValueError` as `linearise` does, and for a scene without actuators.
    """
    chosen = Chosen("actuation_jacobian", None, (of,))
    solving = dict(before=before, method=method, throw=throw)
    acting = Inputs(tensions, pressures, pulls)
    near, names, _ = at_equilibrium(scene, acting, chosen, **solving)
    if all(x is None for x in near.applied.inputs):
        raise ValueError("actuation_jacobian: the scene has no actuators; add tendons or chambers")
    return _gain(near, names.inputs, names.outputs)


@compiled
def _gain(near: NearRest, inputs: tuple[str, ...], outputs: tuple[str, ...]):
    applied, now = applied_by(near, inputs)
    values = observed(near, outputs)
    still = near.at_rest

    def seen(unknowns, rates, applied):
        return values(near.fields(unknowns, rates, applied)[1], applied)

    return near.along(jnp.eye(now.size), seen, near.following(), lambda z: still, applied).T
