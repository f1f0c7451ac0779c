"""Fits of data with holes: markers at zero, coordinates that no camera saw, rows that were lost."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest
from beams import AS_FITTED, FIT, RATE, RELEASE, TRUTH, beam, release
from test_recording import write_c3d

import softrod_jax as sr
from calibration import calibrate, load_recording, write_log


def fitted(recording, scene=None, **options):
    start = beam(young_modulus=2e5, bending_damping=1.5e-4) if scene is None else scene
    return calibrate(start, [recording], checks=False, progress=False, **FIT, **options)


def check(fit, truth=TRUTH):
    for name, value in truth.items():
        estimate = fit.parameters[name]
        assert estimate.identifiable
        assert estimate.ci95[0] < value < estimate.ci95[1]
    assert abs(fit.parameters["young_modulus"].value / truth["young_modulus"] - 1) < 0.02


@pytest.mark.parametrize("seen", [[0, 2], [0]])
def test_coordinates_that_no_camera_saw_are_not_needed(seen):
    recording = release(beam())
    tip = np.full_like(recording.tip_positions, np.nan)
    tip[:, seen] = recording.tip_positions[:, seen]
    fit = fitted(replace(recording, tip_positions=tip))
    check(fit)
    assert abs(fit.time_offset_s["release"] - RELEASE) < 5e-3


def test_frames_at_zero_do_not_move_the_fit(tmp_path):
    tip = release(beam(), noise=1e-5).tip_positions
    points = np.stack([1e3 * tip, 0 * tip], axis=1)
    points[[9, 10, 17, 18, 19], 0] = 0
    path = write_c3d(tmp_path / "a.c3d", points, ["tip", "base"], rate=RATE)
    recording = load_recording(path, beam())
    assert np.sum(~recording.has_tip) == 5
    fit = fitted(recording)
    assert abs(fit.parameters["young_modulus"].value / TRUTH["young_modulus"] - 1) < 0.02
    assert fit.rmse_m["a"] < 1e-4


@pytest.mark.long
def test_rows_that_were_lost_do_not_move_the_fit(tmp_path):
    # Two tendons pull in turn; rows are missing where the second lets go.
    tendons = sr.Tendons(jnp.array([[8e-3, 0.0], [-8e-3, 0.0]]))
    truth = {"young_modulus": 1.5e5, "bending_damping": 1e-4}
    scene = beam(**truth, tendons=tendons)
    times = np.arange(60) / RATE
    tensions = np.maximum(6 * np.sin(9 * times)[:, None] * [1, -1], 0)
    motion = sr.simulate(scene, 1 / RATE, tensions[1:], **AS_FITTED)
    tip = np.asarray(motion.tip_positions)
    tip = tip + 2e-5 * np.random.default_rng(0).normal(size=tip.shape)
    keep = (times < 0.395) | (times > 0.505)
    write_log(tmp_path / "a.csv", times[keep], tensions[keep], None, tip[keep])
    start = beam(young_modulus=1.2e5, bending_damping=2e-4, tendons=tendons)
    recording = load_recording(tmp_path / "a.csv", start)
    assert any("no samples of tau2_N from 0.39 to 0.51 s" in note for note in recording.notes)
    fit = fitted(recording, start, time_offset=False)
    assert abs(fit.parameters["young_modulus"].value / truth["young_modulus"] - 1) < 0.005
    assert fit.rmse_m["a"] < 1e-4
    assert "gap" in fit.recordings[0].selection.rule
