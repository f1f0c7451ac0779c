"""A hand that held the rod bent before it let go: with which force, by where the rod was held.

A release from any pose is one from an equilibrium under a force and a moment at the tip that nobody
measured. They are numbers of the bench, another set for each recording. A search begins with those
under which the scene's rod is where it was seen at rest before it was let go; where markers along
the rod were seen, too, they tell the moment.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

import softrod_jax as sr
from calibration.data.onset import last_rest_sample, start_position
from calibration.data.quantities import PLACE
from calibration.data.recording import Recording
from calibration.experiment.bulk import bulk
from calibration.experiment.setup import Setup

# The loads of a hand, by the names of their parameters.
HAND = tuple(f"hand_{what}_{axis}" for what in ("force", "moment") for axis in "xyz")
# On the way from the free equilibrium to where the rod is held: so many parts, so many steps each.
_PARTS, _STEPS = 8, 6
# A place is as good as this part of the length; loads beyond so many of the size that bends the
# rod by its length are not sought where nothing asks for them.
_CLOSE, _LARGE = 1e-2, 10.0
_METHOD = sr.Collocation(intervals=4, order=6, max_error=0.1)


def held(recording: Recording) -> bool:
    """Whether a hand held the rod, as far as it is known by how much."""
    return any(name in HAND for name in recording.conditions)


def held_by_hands(
    setup_of: Callable[[Recording], Setup], recordings: Sequence[Recording], names: Iterable[str]
) -> list[Recording]:
    """The recordings, with the loads `names` of a hand as conditions of those that are releases, at
    which the rod of the setup of each rests where it did. Loads that are given stay."""
    names = tuple(n for n in HAND if n in names)
    if not names:
        return list(recordings)
    found = []
    for r in recordings:
        if not r.has_inputs and not held(r):
            loads = hand_loads(setup_of(r), r, names)
            r = replace(r, conditions={**r.conditions, **loads})
        found.append(r)
    return found


def hand_loads(setup: Setup, recording: Recording, names: Sequence[str]) -> dict[str, float]:
    """Those loads of a hand [N, N m] under which the setup's rod is where it was held."""
    places = _held_places(recording)
    setup = eqx.tree_at(
        lambda s: (s.hand_force, s.hand_moment),
        setup,
        (jnp.zeros(3), jnp.zeros(3)),
        is_leaf=lambda x: x is None,
    )
    free = np.array([name in names for name in HAND])
    length = float(setup.scene.length)
    stiff = float(np.max(np.asarray(bulk(setup.scene).EI)))
    unit = np.repeat([stiff / length**2, stiff / length], 3) * free
    keys = tuple(places)
    target = np.stack([places[key] for key in keys])
    x = np.zeros(6)
    start, _, _ = map(np.asarray, _seen(setup, x, unit, keys))
    missing = ~np.isfinite(target)
    for part in np.linspace(0, 1, _PARTS + 1)[1:]:
        wanted = np.where(missing, start, start + part * (target - start))
        x = _solved(setup, x, unit, keys, wanted, length * _CLOSE)
    return {name: float(v) for name, v in zip(HAND, unit * x) if name in names}


def _held_places(recording: Recording) -> dict[str, np.ndarray]:
    """Where the tip and the other markers were [m] before the tip first moved, by key."""
    place, _ = start_position(recording)
    found = {"tip": np.where(recording.coordinates, place, np.nan)}
    index = last_rest_sample(recording.track[1])
    times = recording.track[0]
    rest = recording.times <= times[0 if index is None else index]
    for key, values in recording.others.items():
        there = key.endswith(PLACE) and np.any(np.isfinite(values[rest]), axis=0).all()
        if there:
            found[key] = np.nanmedian(values[rest], axis=0)
    return found


def _solved(setup, x, unit, keys, wanted, close: float) -> np.ndarray:
    """Loads, in terms of `unit`, that bring the places `keys` near those `wanted`, by damped steps
    of least squares; what does not help stays small."""

    def at(x):
        seen, slopes, result = (np.asarray(a) for a in _seen(setup, x, unit, keys))
        r = np.append((seen - wanted).ravel() / close, x / _LARGE)
        J = np.concatenate([slopes.reshape(-1, 6) / close, np.eye(6) / _LARGE])
        return r, J, float(r @ r) if result == 0 and np.all(np.isfinite(r)) else np.inf

    r, J, loss = at(x)
    damping = 1e-3
    for _ in range(_STEPS):
        A = J.T @ J
        step = np.linalg.solve(A + damping * np.diag(np.diag(A)), -J.T @ r)
        trial = at(x + step)
        if trial[2] < loss:
            x, (r, J, loss), damping = x + step, trial, damping / 5
        else:
            damping *= 10
    return x


@partial(jax.jit, static_argnums=3)
def _seen(setup: Setup, x: Float[Array, "6"], unit: Float[Array, "6"], keys: tuple[str, ...]):
    """Where the markers are, (keys, 3) [m], derivatives by x, (keys, 3, 6), and the result code."""

    def places(x):
        load = unit * x
        own = eqx.tree_at(lambda s: (s.hand_force, s.hand_moment), setup, (load[:3], load[3:]))
        scene = own.held_scene(own.simulated_scene())
        pulls = jnp.zeros(len(scene.tendons.by_length)) if _pulled(scene) else None
        still = sr.solve_static(scene, pulls=pulls, method=_METHOD, throw=False)
        where = [
            still.tip_position if k == "tip" else still.markers[k.removesuffix(PLACE)].position
            for k in keys
        ]
        return own.seen_position(jnp.stack(where)), still.result

    seen, result = places(x)
    return seen, jax.jacfwd(lambda x: places(x)[0])(x), result


def _pulled(scene: sr.Scene) -> bool:
    return scene.tendons is not None and bool(scene.tendons.by_length)
