"""Laws by which a rod loses energy, put into a scene, for a comparison of them."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import jax.numpy as jnp
import numpy as np

import softrod_jax as sr
from calibration.experiment.bulk import bulk, ring_frequency
from calibration.parameters.catalogue import choose
from calibration.parameters.names import LAWS

# Where searches start: what of the stiffness relaxes in a branch, and a damping ratio.
_PART, _RATIO = 0.1, 0.05
# A branch of no more than this is none: less than rounding errors, where a scene needs more than 0.
_NO_PART = 1e-12
_OF_DAMPING = ("bending_damping", "damping_time", "relaxation")


@dataclass(frozen=True)
class Model:
    """A scene, and the names of what is fitted of it; None: the usual ones."""

    scene: sr.Scene
    fit: tuple[str, ...] | None = None

    @property
    def names(self) -> tuple[str, ...]:
        """What is fitted, groups by their members. Raises `ValueError` for an unknown name."""
        return choose(self.scene, self.fit)


def damped(model: Model, laws: Sequence[str]) -> dict[str, Model]:
    """By each of `laws`, out of `LAWS`: the model with that damping, which is fitted instead of
    what the scene has.

    Branches start where the rod rings, those of two a factor of ten apart, unless the scene has as
    many. What a law lacks is there as next to nothing, so that all of them have scenes of one form
    (`without_nothing`). Raises `ValueError` for an unknown law, and where segments have a damping
    of their own.
    """
    for law in laws:
        if law not in LAWS:
            raise ValueError(f"compare: {law!r} is no law of damping; known: {', '.join(LAWS)}")
    for i, segment in enumerate(model.scene.segments or ()):
        for name in _OF_DAMPING:
            if getattr(segment, name, None) is not None:
                raise ValueError(
                    f"compare: segments[{i}].{name}: laws of damping are compared for the whole "
                    "rod; give it in [rod], or compare scene files"
                )
    rows = max((LAWS[law][0] for law in laws), default=0)
    anywhere = any(LAWS[law][1] for law in laws)
    return {law: _damped(model, *LAWS[law], rows, anywhere) for law in laws}


def _damped(model: Model, branches: int, viscous: bool, rows: int, anywhere: bool) -> Model:
    scene = model.scene
    none = 0.0 * jnp.asarray(_viscous(scene)) if anywhere else None
    changed = replace(
        scene,
        bending_damping=jnp.asarray(_viscous(scene)) if viscous else none,
        damping_time=None,
        relaxation=_branches(scene, branches, rows),
    )
    kept = [n for n in model.names if not n.removeprefix("rod.").startswith(_OF_DAMPING)]
    own = ["bending_damping"] if viscous else []
    numbers = [str(k + 1) for k in range(branches)]
    own += [f"relaxation_{what}_{k}" for what in ("part", "time") for k in numbers]
    return Model(changed, (*kept, *own))


def without_nothing(scene: sr.Scene) -> sr.Scene:
    """The scene without branches that are no part of the stiffness, and without a damping of 0."""
    damping, branches = scene.bending_damping, scene.relaxation
    if branches is not None:
        kept = np.asarray(branches)[np.asarray(branches)[:, 0] > 2 * _NO_PART]
        branches = jnp.asarray(kept) if len(kept) else None
    if damping is not None and not np.any(np.asarray(damping)):
        damping = None
    return replace(scene, bending_damping=damping, relaxation=branches)


def _viscous(scene: sr.Scene):
    """The scene's B_bt [N m^2 s], or that of a small damping ratio."""
    if scene.bending_damping is not None:
        return scene.bending_damping
    stiffness = float(np.mean(np.asarray(bulk(scene).EI)))
    return 2 * _RATIO * stiffness / (2 * np.pi * ring_frequency(scene))


def _branches(scene: sr.Scene, count: int, rows: int):
    """The scene's own branches if they are so many, or others, then rows without a part up to
    `rows`, (rows, 2); None without any."""
    if not rows:
        return None
    middle = 1 / (2 * np.pi * ring_frequency(scene))
    times = middle * 10.0 ** (np.arange(rows) - (max(count, 1) - 1) / 2)
    found = np.stack([np.where(np.arange(rows) < count, _PART, _NO_PART), times], axis=1)
    own = scene.relaxation
    if own is not None and np.shape(own)[0] == count:
        found[:count] = np.asarray(own)
    return jnp.asarray(found)
