"""A C3D's markers on one body of the tip give its pose, and no mapping is needed."""

import numpy as np
import pytest
from test_recording import beam, write_c3d
from test_rigid import MEANT

from calibration import RecordingError, load_recording
from calibration.data.rigid import quaternions_of
from softrod_jax.rod.rotations import to_base

LABELS = [f"Tip - {k + 1}" for k in range(len(MEANT))]
ANGLES = 0.4 * np.concatenate([np.zeros(40), np.sin(0.15 * np.arange(120))])


def turning():
    """Rotations about y and x, the middle of the tip and its markers [m], at rest at first."""
    axis = np.array([0.6, 0.8, 0.0])
    K = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    s, c = np.sin(ANGLES)[:, None, None], 1 - np.cos(ANGLES)[:, None, None]
    R = np.eye(3) + s * K + c * K @ K
    tip = np.array([0.3, 0.2, 0.6]) + 0.03 * ANGLES[:, None] * [1.0, -0.5, -0.2]
    return R, tip, np.einsum("nij,mj->nmi", R, MEANT) + tip[:, None]


def read(tmp_path, points, labels=LABELS, **options):
    options = {"base_markers": None, "tip_body": True, **options}
    return load_recording(write_c3d(tmp_path / "a.c3d", 1e3 * points, labels), beam(), **options)


def test_the_pose_of_the_body(tmp_path):
    R, tip, seen = turning()
    hidden = seen.copy()
    hidden[60:80, 2] = np.nan
    hidden[90, :2] = np.nan
    found = read(tmp_path, hidden)
    turns = found.others["tip_attitude"]
    rows = np.arange(len(R)) != 90
    assert np.isnan(turns[90]).all() and np.isnan(found.tip_positions[90]).all()
    for axis in np.eye(3):
        there = np.asarray(to_base(turns, np.broadcast_to(axis, (len(R), 3))))
        np.testing.assert_allclose(there[rows], (R @ axis)[rows], atol=1e-5)
    # The middle of the markers, which is off the axis, moves as the body has it.
    middle = tip + R @ MEANT.mean(0)
    moved = found.tip_positions - found.tip_positions[0]
    np.testing.assert_allclose(moved[rows], (middle - middle[0])[rows], atol=1e-6)
    assert any("pose of the tip from 4 markers" in x and "20 samples" in x for x in found.notes)


def test_without_a_body_their_mean_is_the_tip_as_ever(tmp_path):
    _, _, seen = turning()
    seen[60:80, 2] = np.nan
    plain = read(tmp_path, seen, tip_body=False)
    assert not plain.others and np.sum(~plain.has_tip) == 20


def test_what_is_no_body_is_refused(tmp_path):
    _, _, seen = turning()
    with pytest.raises(RecordingError, match="2 markers tell no attitude"):
        read(tmp_path, seen[:, :2], LABELS[:2])
    loose = seen.copy()
    loose[60:, 1] += [0.0, 8e-3, 6e-3]
    with pytest.raises(RecordingError, match="not on one body"):
        read(tmp_path, loose)


def test_quaternions_of_turns_of_any_size():
    q = np.random.default_rng(0).normal(size=(200, 4))
    q[:8, 0] = 0.0
    q[:4, 1:] = [[1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 0]]
    q = q / np.linalg.norm(q, axis=1, keepdims=True)
    R = np.stack([np.asarray(to_base(q, np.broadcast_to(e, (200, 3)))) for e in np.eye(3)], axis=2)
    found = quaternions_of(R)
    np.testing.assert_allclose(np.abs(np.sum(found * q, axis=1)), 1.0, atol=1e-12)
    assert np.all(found[:, 0] >= 0)
