"""How a log begins: told by all samples before the first movement, one of which may be wrong."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest

import softrod_jax as sr
from calibration import Recording
from calibration.data.onset import start_position
from calibration.experiment.beginning import beginning, hangs

LENGTH, G, NOISE = 0.12, 9.81, 2e-4
STRAIGHT = np.array([0.0, 0.0, LENGTH])
TIMES = np.arange(0, 0.8, 0.01)
SIDEWAYS, DOWNWARDS = jnp.array([G, 0.0, 0.0]), jnp.array([0.0, 0.0, G])


def robot(gravity):
    return sr.Scene(
        length=LENGTH,
        section=sr.Circle(6e-3),
        young_modulus=2e5,
        poisson_ratio=0.49,
        density=1070.0,
        gravity=gravity,
        tendons=sr.Tendons(jnp.array([[4e-3, 0.0], [-4e-3, 0.0]])),
    )


def log(start, leaves_at, towards, seed=0):
    """A tip that rests at `start`, and falls from there at `leaves_at` [s] by four centimetres."""
    fallen = np.minimum(0.5 * G * np.maximum(TIMES - leaves_at, 0.0) ** 2, 0.04)
    tip = start + fallen[:, None] * np.asarray(towards)
    tip = tip + NOISE * np.random.default_rng(seed).normal(size=tip.shape)
    tensions = np.stack([np.where(TIMES > 0.3, 0.1, 0.0), 0 * TIMES], axis=1)
    return Recording(TIMES, tensions, None, tip, name="log")


def spoiled(recording, sample, by):
    tip = recording.tip_positions.copy()
    tip[sample] += by
    return replace(recording, tip_positions=tip)


@pytest.mark.parametrize("leaves_at", [0.0, 0.2])
def test_one_wrong_sample_does_not_move_the_start(leaves_at):
    plain = log(STRAIGHT, leaves_at, [1, 0, 0])
    for sample in (0, 1, 3):
        for by in ([0, 0.01, 0], [0.03, 0, 0.01]):
            start, rests = start_position(spoiled(plain, sample, by))
            np.testing.assert_allclose(start, STRAIGHT, atol=8e-4)
            assert rests == (leaves_at > 0)
            assert not hangs(robot(SIDEWAYS), spoiled(plain, sample, by))


@pytest.mark.parametrize("by", np.vstack([np.eye(3), -np.eye(3)]))
def test_a_marker_that_is_off_does_not_make_a_rod_hang(by):
    """By 2.5 and 4 mm, more than 2 % of the length; falling from there at once tells the rest."""
    for size in (2.5e-3, 4e-3):
        recording = log(STRAIGHT + size * by, 0.0, [1, 0, 0])
        assert not hangs(robot(SIDEWAYS), recording)


def test_a_rod_that_hangs():
    """Far below the straight one, whether it rests there or is pulled at once; and where the first
    sample is wrong."""
    low = np.array([0.07, 0.0, 0.08])
    for leaves_at in (0.0, 0.3):
        recording = log(low, leaves_at, [0, 0, 1])
        assert hangs(robot(SIDEWAYS), recording)
        assert hangs(robot(SIDEWAYS), spoiled(recording, 0, STRAIGHT - low))


def test_a_rod_that_hangs_and_is_hardly_stretched():
    """Within 2 % of straight; that it rests tells that it was not let go then."""
    stretched = STRAIGHT + [0, 0, 4e-4]
    assert hangs(robot(DOWNWARDS), log(stretched, 0.3, [1, 0, 0]))
    assert not hangs(robot(DOWNWARDS), log(STRAIGHT, 0.0, [0, 0, 1]))


@pytest.mark.parametrize("unseen", [0, 1, 2])
def test_a_camera_that_sees_two_coordinates_sees_how_a_log_begins(unseen):
    """A coordinate that is NaN throughout says nothing, and not that the rod is straight."""
    blind = np.where(np.arange(3) == unseen, np.nan, 0.0)
    low = np.array([0.06, 0.0, 0.07])
    for leaves_at in (0.0, 0.3):
        for place, towards in ((low, [0, 1, 1]), (STRAIGHT, [1, 0, 1])):
            whole = log(place, leaves_at, towards)
            recording = replace(whole, tip_positions=whole.tip_positions + blind)
            assert hangs(robot(SIDEWAYS), recording) == (place is low)
            start, rests = start_position(recording)
            np.testing.assert_allclose(start, np.where(np.isnan(blind), 0.0, place), atol=8e-4)
            assert rests == (leaves_at > 0)


def test_what_was_assumed_is_told():
    recording = log(STRAIGHT, 0.2, [1, 0, 0])
    assert "straight" in beginning(recording, False)
    assert "equilibrium" in beginning(recording, True)
    assert "held" in beginning(replace(recording, tensions=None), False)
    told = replace(recording, starts_hanging=True)
    assert hangs(robot(SIDEWAYS), told) and "told" in beginning(told, True)
