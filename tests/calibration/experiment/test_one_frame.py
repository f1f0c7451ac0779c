"""One frame for all recordings of a set-up, and not another for each."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest
from beams import FIT, TRUTH, beam, release

import softrod_jax as sr
from calibration import RecordingError, calibrate
from calibration.data.frames import in_one_frame, straight_tip

PAYLOAD = 0.05
TILT, SHIFT = np.array([0.0, 0.03, 0.0]), np.array([4e-4, -3e-4, 2e-4])


def loaded(mass):
    scene = beam()
    return replace(scene, payload=sr.Payload(jnp.array(mass)))


def seen(mass, name):
    """A release as a turned camera sees it, whose origin each recording lost."""
    recording = release(loaded(mass), name=name, seed=int(1e3 * mass))
    turned = recording.tip_positions + np.cross(TILT, recording.tip_positions)
    placed = straight_tip(beam()) - turned[0]
    return replace(
        recording, tip_positions=turned + placed + SHIFT, origin_known=False,
        placed=placed + SHIFT, conditions={"payload_mass": mass},
    )  # fmt: skip


@pytest.mark.long
def test_recordings_of_one_set_up_share_its_frame():
    recordings = [seen(0.0, "light"), seen(PAYLOAD, "heavy")]
    options = dict(fit=("young_modulus",), checks=False, window=(0.0, 1.0), progress=False, **FIT)
    scene = replace(beam(young_modulus=2.5e5), payload=sr.Payload(jnp.array(0.0)))
    fit = calibrate(scene, recordings, one_frame=True, **options)
    E = fit.parameters["young_modulus"]
    assert E.ci95[0] < TRUTH["young_modulus"] < E.ci95[1]
    assert fit.parameters["camera_rotation_y"].value == pytest.approx(TILT[1], abs=3e-3)
    assert all(r.tip_offset is None for r in fit.recordings)
    assert all("in the frame of light" in r.recording.notes[-1] for r in fit.recordings)
    assert max(fit.rmse_m.values()) < 5e-4


def test_what_is_put_in_place_together_stays_apart():
    first, second = seen(0.0, "light"), seen(PAYLOAD, "heavy")
    second = replace(second, placed=second.placed + [0.0, 0.0, 1e-3])
    (a, b), [] = in_one_frame([first, second], [])
    np.testing.assert_allclose(a.tip_positions, first.tip_positions, atol=1e-15)
    shift = first.placed - second.placed
    np.testing.assert_allclose(b.tip_positions, second.tip_positions + shift, atol=1e-15)
    with pytest.raises(RecordingError, match="light: knows where the clamp is"):
        in_one_frame(a, [])
