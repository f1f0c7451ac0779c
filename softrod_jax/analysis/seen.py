"""Outputs of a linear model: what of a rod is seen, by names as in a log."""

from collections.abc import Callable, Sequence

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from softrod_jax.analysis.near_rest import Applied, NearRest
from softrod_jax.bvp.method import Guess
from softrod_jax.rod.constants import full_strain
from softrod_jax.rod.given_lengths import tensions_of
from softrod_jax.rod.markers import seen
from softrod_jax.rod.reduction import clamp_pose, make_rod
from softrod_jax.rod.rotations import conjugate, quaternion_product, to_base
from softrod_jax.rod.shape import Pose
from softrod_jax.scene.planes import in_space
from softrod_jax.scene.scene import Scene

_AXES = "xyz"
_STRAINS = "vx", "vy", "vz", "ux", "uy", "uz"
_WRENCH = [f"base_F{a}_N" for a in _AXES] + [f"base_M{a}_Nm" for a in _AXES]


def poses(near: NearRest, along: Guess, applied: Applied) -> dict[str, Pose]:
    """Those of the tip and of all markers, of a rod with these strains."""
    positions, quaternions, strain = shape(near, along, applied)
    method, nodes = near.method, near.method.outputs(near.method.grid(near.scene).s)
    return seen(near.scene, method.inside(strain), nodes, positions, quaternions)


def shape(near: NearRest, along: Guess, applied: Applied):
    """Positions (nodes, 3) and quaternions (nodes, 4), and (v, u) at all points."""
    grid = near.method.grid(near.scene)
    strain = full_strain(along.strain, make_rod(near.scene, applied.inputs, grid=grid))
    return *near.method.shape(strain, grid, *clamp_pose(near.scene)), strain


def moved(pose: Pose) -> Float[Array, "6"]:
    """The position and, with the derivative only, the rotation about the base's axes [rad]."""
    h = pose.quaternion
    back = jax.lax.stop_gradient(conjugate(h))
    return jnp.concatenate([pose.position, 2 * quaternion_product(h, back)[1:]])


def names_of(who: str, scene: Scene, outputs: Sequence[str], nodes: int) -> tuple[str, ...]:
    """A name for each number that `outputs` have. Raises `ValueError` for an unknown one."""
    places = ["tip", *(marker.name for marker in scene.markers or ())]
    names = []
    for output in outputs:
        if output in places:
            names += [f"{output}_{a}_m" for a in _AXES] + [f"{output}_r{a}_rad" for a in _AXES]
        elif output == "strains":
            names += [f"{name}_{k}" for k in range(nodes) for name in _STRAINS]
        elif output == "base_wrench":
            names += _WRENCH
        elif output == "tensions":
            count = 0 if scene.tendons is None else scene.tendons.count
            names += [f"tau{i + 1}_N" for i in range(count)]
        else:
            offered = ", ".join(f'"{x}"' for x in (*places, "strains", "base_wrench", "tensions"))
            raise ValueError(f"{who}: output {output!r} is not offered; use {offered}")
    return tuple(names)


def observed(near: NearRest, outputs: Sequence[str]) -> Callable:
    """The numbers of `outputs`, (p,), as a function of the rod at all points and what acts."""

    def values(along: Guess, applied: Applied) -> Float[Array, "p"]:
        every, parts = poses(near, along, applied), []
        for output in outputs:
            if output in every:
                parts.append(moved(every[output]))
            elif output == "strains":
                parts.append(near.method.outputs(shape(near, along, applied)[2]).ravel())
            elif output == "base_wrench":
                wrench = in_space(along.y[0, -near.layout.pair :], near.scene.plane)
                _, h = clamp_pose(near.scene)
                parts += [to_base(h, wrench[:3]), to_base(h, wrench[3:])]
            else:
                given = applied.inputs.tensions
                given = None if given is None else jnp.asarray(given)
                parts.append(tensions_of(near.scene, given, along.multipliers))
        return jnp.concatenate(parts)

    return values
