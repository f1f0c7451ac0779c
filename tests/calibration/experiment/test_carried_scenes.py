"""Scenes whose base or obstacles are carried are not fitted as if they stood still."""

import dataclasses

import numpy as np
import pytest

import softrod_jax as sr
from calibration import Recording, calibrate
from calibration.postures.data import Postures
from calibration.postures.fitting import calibrate_postures
from softrod_jax.scene.inputs import Inputs

WALL = sr.Contact(sr.Plane([0.0, 0.0, 0.1], [0.0, 0.0, -1.0]), 1e4, moves=True)
SCENES = {
    r"base\.moves": dataclasses.replace(sr.hybrid_robot(), base_moves=True),
    r"contacts\[0\].moves": dataclasses.replace(sr.hybrid_robot(), contacts=(WALL,)),
}


@pytest.mark.parametrize("key", SCENES)
def test_motions(key):
    times = 0.01 * np.arange(30)
    tip = np.stack([1e-3 * np.sin(20 * times), 0 * times, 0.1 + 0 * times], -1)
    recording = Recording(times, np.zeros((30, 3)), np.zeros((30, 1)), tip)
    with pytest.raises(ValueError, match=f"{key} = true: a fit knows nothing that is carried"):
        calibrate(SCENES[key], [recording], progress=False)


@pytest.mark.parametrize("key", SCENES)
def test_postures(key):
    rows = Postures(Inputs(np.zeros((2, 3)), np.zeros((2, 1))), {"tip": np.zeros((2, 3))})
    with pytest.raises(ValueError, match=f"{key} = true: a fit knows nothing that is carried"):
        calibrate_postures(SCENES[key], rows, fit=("young_modulus",))
