"""A rod that a hand held bent, and let go."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest
from beams import AS_FITTED, FIT, RATE, TRUTH, beam

import softrod_jax as sr
from calibration import Recording, calibrate
from calibration.experiment.hand import HAND, hand_loads, held_by_hands
from calibration.experiment.setup import Setup

FORCES = HAND[:3]
HELD = np.array([[0.4, 0.1, -0.1], [-0.2, 0.3, 0.0], [0.1, -0.4, -0.05]])  # N
MOMENT = np.array([0.004, -0.006, 0.0])  # N m
MIDDLE = sr.Marker("middle", 0.05)
BEFORE, STEPS = 8, 56


def rod(**values):
    return replace(beam(**values), markers=(MIDDLE,))


def let_go(force, name, moment=None, noise=2e-5) -> Recording:
    """What cameras see of a release from under these loads at the tip."""
    scene = rod()
    held = replace(scene, tip_load=sr.TipLoad(jnp.array(force), moment))
    start = sr.solve_static(held, method=AS_FITTED["method"])
    motion = sr.simulate(scene, 1 / RATE, steps=STEPS, initial=start, **AS_FITTED)
    rng = np.random.default_rng(len(name))
    seen = []
    for places in (motion.tip_positions, motion.markers["middle"].positions):
        track = np.concatenate([np.repeat(np.asarray(places)[:1], BEFORE, axis=0), places])
        seen.append(track + noise * rng.normal(size=track.shape))
    times = np.arange(BEFORE + STEPS + 1) / RATE
    return Recording(times, None, None, seen[0], name=name, others={"middle_position": seen[1]})


def test_where_the_rod_was_held_tells_with_which_loads():
    recording = let_go(HELD[0], "one", jnp.array(MOMENT), noise=0.0)
    found = hand_loads(Setup(rod()), recording, HAND)
    np.testing.assert_allclose([found[n] for n in HAND[:3]], HELD[0], rtol=0, atol=8e-3)
    np.testing.assert_allclose([found[n] for n in HAND[3:5]], MOMENT[:2], rtol=0, atol=4e-4)
    # Half as stiff a rod is held with half the force, as far as its weight does not matter.
    light = rod(young_modulus=TRUTH["young_modulus"] / 2)
    force = hand_loads(Setup(light), replace(recording, others={}), FORCES)
    assert tuple(force) == FORCES
    given = replace(recording, conditions={"hand_force_x": 0.1})
    assert held_by_hands(lambda r: Setup(rod()), [given], HAND) == [given]


@pytest.mark.long
def test_releases_from_any_pose_are_fitted_and_predicted():
    recordings = [let_go(force, f"run{'+' * k}") for k, force in enumerate(HELD)]
    start = rod(young_modulus=1.2 * TRUTH["young_modulus"], bending_damping=9e-5)
    names = ("young_modulus", "bending_damping", *FORCES)
    found = calibrate(
        start,
        recordings[:2],
        held_out=recordings[2:],
        fit=names,
        checks=False,
        progress=False,
        **FIT,
    )
    for name in names[:2]:
        low, high = found.parameters[name].ci95
        assert low < TRUTH[name] < high < 1.1 * low, (name, low, high)
    for name, force in zip(("run", "run+"), HELD):
        for axis, value in zip("xyz", force):
            low, high = found.parameters[f"hand_force_{axis}@{name}"].ci95
            assert low - 1e-3 < value < high + 1e-3
    assert max(found.rmse_m.values()) < 5e-5
    # Of what was kept aside only where it was held is looked at, and when it was let go.
    (unseen,) = found.held_out
    assert unseen.rmse < 4e-4
    assert "held by a hand" in unseen.beginning


def test_a_hand_either_follows_a_straight_rod_or_lets_a_bent_one_go():
    with pytest.raises(ValueError, match="release_duration is how long a hand follows"):
        Setup(rod(), release_duration=jnp.array(0.03), hand_force=jnp.zeros(3))
