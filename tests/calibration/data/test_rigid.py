"""Markers on one body give its pose."""

import numpy as np
import pytest

from calibration import RecordingError, load_recording
from calibration.data.rigid import rigid_pose, tip_of_body
from softrod_jax.scene.scene import Scene, as_arrays
from softrod_jax.scene.sections import Circle

SCENE = as_arrays(Scene(0.1, Circle(6e-3), 2e5, 0.49, 1070.0, gravity=[-9.81, 0.0, 0.0]))
# On the end face and beyond it, all on one side of the axis.
MEANT = np.array([[0.012, 0.0, 0.0], [0.006, 0.01, 0.0], [0.004, -0.008, 0.0], [0.01, 0.0, 0.006]])
ANGLES = np.linspace(0.0, 0.6, 30)


def bent():
    """A tip that turns about y as it moves, and its markers: (samples, markers, 3)."""
    c, s, o = np.cos(ANGLES), np.sin(ANGLES), np.zeros_like(ANGLES)
    R = np.stack([[c, o, s], [o, o + 1, o], [-s, o, c]]).transpose(2, 0, 1)
    tip = np.stack([0.05 * s, o, 0.1 - 0.05 * (1 - c)], axis=1)
    return R, tip, np.einsum("nij,mj->nmi", R, MEANT) + tip[:, None]


def test_the_pose_is_found_with_and_without_all_markers():
    R, tip, seen = bent()
    rotation, place = rigid_pose(seen, MEANT)
    np.testing.assert_allclose(rotation, R, atol=1e-12)
    np.testing.assert_allclose(place, tip, atol=1e-12)
    seen[5, 1], seen[6, :2], seen[7, 0, 2] = np.nan, np.nan, np.nan
    rotation, place = rigid_pose(seen, MEANT)
    assert np.flatnonzero(np.isnan(place[:, 0])).tolist() == [6]
    np.testing.assert_allclose(np.delete(place, 6, axis=0), np.delete(tip, 6, axis=0), atol=1e-12)
    np.testing.assert_allclose(np.linalg.det(rotation[[5, 7]]), 1.0)


def test_noise_is_shared_and_no_mirror_image_is_taken():
    R, tip, seen = bent()
    rng = np.random.default_rng(0)
    rotation, place = rigid_pose(seen + 1e-4 * rng.normal(size=seen.shape), MEANT)
    np.testing.assert_allclose(np.linalg.det(rotation), 1.0)
    assert np.max(np.abs(place - tip)) < 6e-4
    assert np.max(np.abs(np.einsum("nij,nkj->nik", rotation, R) - np.eye(3))) < 0.05


def test_a_mapping_gives_the_middle_of_the_tip(tmp_path):
    _, tip, seen = bent()
    names = [f"{m}{a}" for m in "abcd" for a in "xyz"]
    rows = [",".join(map(repr, [0.01 * k, *p.ravel().tolist()])) for k, p in enumerate(seen)]
    path, mapping = tmp_path / "log.csv", tmp_path / "log.map.toml"
    path.write_text("\n".join([",".join(["t", *names]), *rows]), encoding="utf-8")
    markers = [[f"{m}{a}" for a in "xyz"] for m in "abcd"]
    text = f"[time]\ncolumn = 't'\n[tip]\nmarkers = {markers}\n"
    mapping.write_text(f"{text}positions = {MEANT.tolist()}\n", encoding="utf-8")
    recording = load_recording(path, SCENE, mapping=mapping)
    np.testing.assert_allclose(recording.tip_positions, tip, atol=1e-9)
    assert any("tip fitted to 4 markers" in note for note in recording.notes)
    mapping.write_text(text, encoding="utf-8")
    mean = load_recording(path, SCENE, mapping=mapping).tip_positions
    assert np.max(np.linalg.norm(mean - tip, axis=1)) > 8e-3
    for given in ("[[0.0, 0.0, 0.0]]", "[1, 2, 3, 4]"):
        mapping.write_text(f"{text}positions = {given}\n", encoding="utf-8")
        with pytest.raises(RecordingError, match="3 finite numbers for each of the markers"):
            load_recording(path, SCENE, mapping=mapping)


def test_what_is_no_body_is_told():
    _, _, seen = bent()
    with pytest.raises(RecordingError, match="mm rms from them; check their order"):
        tip_of_body(seen, 3 * MEANT, "[tip] ")
    with pytest.raises(RecordingError, match="not on one line"):
        tip_of_body(seen[:, :3], np.outer([1.0, 2.0, 3.0], [1e-2, 0, 0]), "[tip] ")
    with pytest.raises(RecordingError, match="no sample has three"):
        tip_of_body(np.full_like(seen, np.nan), MEANT, "[tip] ")
