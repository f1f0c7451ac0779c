"""What no search can mend is refused at the first look, with the likely remedy."""

from dataclasses import replace

import pytest
from beams import FIT, beam, release

from calibration import RecordingError, calibrate

OPTIONS = dict(fit=("young_modulus",), checks=False, window=(0.0, 1.0), progress=False, **FIT)


@pytest.fixture(scope="module")
def recording():
    return release(beam())


@pytest.mark.parametrize(
    "axes, words",
    [
        ((2, 0, 1), "axes y,z,x"),
        ((0, 2, 1), "axes x,z,y"),
        ((2, 1, 0), "axes z,y,x"),
    ],
)
def test_axes_that_are_swapped(recording, axes, words):
    swapped = replace(recording, tip_positions=recording.tip_positions[:, axes])
    with pytest.raises(RecordingError, match=words):
        calibrate(beam(), [swapped], **OPTIONS)


def test_an_axis_that_is_reversed(recording):
    upside_down = replace(recording, tip_positions=recording.tip_positions * [1, 1, -1])
    with pytest.raises(RecordingError, match="axes x,y,-z"):
        calibrate(beam(), [upside_down], **OPTIONS)


def test_a_modulus_that_is_far_off_is_no_swap(recording):
    """A hundred times too soft, it falls and stays down, where a stiff one was seen to ring."""
    soft = beam(young_modulus=2.9e3, bending_damping=1e-4)
    assert calibrate(soft, [recording], **OPTIONS).parameters["young_modulus"].value > 1e5


def test_a_tip_that_begins_elsewhere(recording):
    moved = replace(recording, tip_positions=recording.tip_positions * 0.3 + [0.05, 0.05, 0])
    with pytest.raises(RecordingError, match="the tip begins .* decimal sign"):
        calibrate(beam(), [moved], **OPTIONS)
