"""Films of a fit: the fitted rod beside what was measured, and the motions on disk for more."""

import re
from dataclasses import dataclass
from os import PathLike
from pathlib import Path

import numpy as np

import softrod_jax as sr
from calibration.data.carried import moves_of
from calibration.report.results import Fit, RodMotion
from softrod_jax.foundation.whole_files import whole_file
from softrod_jax.pictures import film
from softrod_jax.scene.inputs import KINDS, Inputs

MOTIONS = "motions.npz"
# Files do not grow without end: so many moments of each motion, and pages, at most.
_MOMENTS, _PAGES = 600, 12
_CARRIED = "_carried_"
_ARRAYS = ("ts", "positions", "quaternions", "strains", "arc_lengths", "seen_times", "seen")


class FilmError(ValueError):
    """A directory of which no film can be made: the message says why and what to do."""


@dataclass(frozen=True)
class Filmed:
    """The motion of a recording by its `name`; `kept_aside`: it was predicted and not fitted."""

    name: str
    kept_aside: bool
    motion: RodMotion

    @property
    def title(self) -> str:
        return self.name + (", kept aside and predicted" if self.kept_aside else "")

    @property
    def inputs(self) -> Inputs:
        return Inputs(**self.motion.inputs)

    @property
    def moves(self) -> dict:
        """Where the base and obstacles are carried in its steps, as `simulate` is told."""
        return moves_of({name: poses[1:] for name, poses in self.motion.carried.items()})


def filmed(fit: Fit) -> list[Filmed]:
    """The motions of a fit, of the recordings that were kept aside last."""
    return [
        Filmed(r.name, aside, _thinned(r.motion))
        for aside, recordings in ((False, fit.recordings), (True, fit.held_out))
        for r in recordings
    ]


def write_films(fit: Fit, directory: Path) -> dict[str, Path]:
    """Write an HTML page of each recording, of the first twelve, and `motions.npz`; the pages by
    title. `softrod film` makes those of others."""
    motions = filmed(fit)
    write_motions(motions, directory / MOTIONS)
    scene = fit.setup.simulated_scene()
    return {
        moved.title: write_film(scene, moved, directory / film_name(motions, k))
        for k, moved in enumerate(motions[:_PAGES])
    }


def film_name(motions: list[Filmed], k: int) -> str:
    """What the page of the `k`-th of them is called."""
    stem = re.sub(r"[^A-Za-z0-9._-]+", "_", motions[k].name)
    return f"film_{stem}.html" if len(motions) == 1 else f"film_{k + 1}_{stem}.html"


def write_film(scene: sr.Scene, moved: Filmed, path: Path) -> Path:
    """The page of one motion."""
    motion = moved.motion
    measured = {"measured tip": (motion.seen_times, motion.seen)}
    return film(
        scene,
        motion,
        path,
        moved.inputs,
        measured=measured,
        title=moved.title,
        contacts=moved.moves["contacts"],
    )


def write_motions(motions: list[Filmed], path: Path) -> None:
    """Keep motions in `path`, an .npz, as `read_motions` reads them."""
    arrays: dict[str, np.ndarray] = {
        "names": np.array([moved.name for moved in motions]),
        "kept_aside": np.array([moved.kept_aside for moved in motions]),
    }
    for k, moved in enumerate(motions):
        arrays |= {f"{k}_{name}": getattr(moved.motion, name) for name in _ARRAYS}
        arrays |= {f"{k}_{name}": values for name, values in moved.motion.inputs.items()}
        arrays |= {f"{k}{_CARRIED}{name}": x for name, x in moved.motion.carried.items()}
    with whole_file(path, "wb") as file:
        np.savez_compressed(file, allow_pickle=False, **arrays)


def read_motions(directory: str | PathLike) -> tuple[sr.Scene, list[Filmed]]:
    """The fitted scene and the motions in a directory that `write_report` has written.

    Raises `FilmError` if there are none.
    """
    path = Path(directory) / MOTIONS
    try:
        with np.load(path, allow_pickle=False) as stored:
            arrays = {name: stored[name] for name in stored.files}
        motions = [
            Filmed(str(name), bool(aside), _motion(arrays, k))
            for k, (name, aside) in enumerate(
                zip(arrays["names"], arrays["kept_aside"], strict=True)
            )
        ]
    except OSError as e:
        raise FilmError(
            f"{path}: {e.strerror or e}; give a directory of `softrod calibrate`, or a scene and a "
            "motion"
        ) from None
    except Exception as e:  # whatever a damaged archive raises
        raise FilmError(f"{path}: holds no motions ({e}); fit again") from None
    return sr.load_scene(Path(directory) / "scene.toml"), motions


def _motion(arrays, k: int) -> RodMotion:
    kinds = [kind.name for kind in KINDS if f"{k}_{kind.name}" in arrays]
    return RodMotion(
        **{name: arrays[f"{k}_{name}"] for name in _ARRAYS},
        inputs={name: arrays[f"{k}_{name}"] for name in kinds},
        carried={
            name.removeprefix(f"{k}{_CARRIED}"): values
            for name, values in arrays.items()
            if name.startswith(f"{k}{_CARRIED}")
        },
    )


def _thinned(motion: RodMotion) -> RodMotion:
    """Every second, third, .. moment of a long motion, in evenly spaced steps."""
    every = slice(None, None, max(1, -(-len(motion.ts) // _MOMENTS)))
    return RodMotion(
        ts=motion.ts[every],
        positions=motion.positions[every].astype(np.float32),
        quaternions=motion.quaternions[every].astype(np.float32),
        strains=motion.strains[every].astype(np.float32),
        arc_lengths=motion.arc_lengths,
        seen_times=motion.seen_times,
        seen=motion.seen,
        inputs={name: values[every] for name, values in motion.inputs.items()},
        carried={name: poses[every] for name, poses in motion.carried.items()},
    )
