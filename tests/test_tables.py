"""Motions as tables of pandas and data sets of xarray: the same numbers, with names and units."""

from types import SimpleNamespace

import numpy as np
import pytest

from softrod_jax.tables import motion_dataset, motion_frame

rng = np.random.default_rng(0)
MOTION = SimpleNamespace(
    ts=0.1 * np.arange(4),
    arc_lengths=np.linspace(0, 0.1, 3),
    tip_positions=rng.normal(size=(4, 3)),
    tip_velocities=rng.normal(size=(4, 3)),
    positions=rng.normal(size=(4, 3, 3)),
    quaternions=rng.normal(size=(4, 3, 4)),
    strains=rng.normal(size=(4, 3, 6)),
    velocities=rng.normal(size=(4, 3, 6)),
    tensions=rng.normal(size=(4, 2)),
    base_wrenches=rng.normal(size=(4, 6)),
    markers={name: SimpleNamespace(positions=rng.normal(size=(4, 3))) for name in ("tip", "m1")},
)


def test_a_frame_has_a_row_for_each_time():
    pytest.importorskip("pandas")
    frame = motion_frame(MOTION)
    assert frame.index.name == "t_s" and list(frame.index) == list(MOTION.ts)
    assert np.array_equal(frame[["tip_x_m", "tip_y_m", "tip_z_m"]], MOTION.tip_positions)
    assert np.array_equal(frame["tip_vy_m_s"], MOTION.tip_velocities[:, 1])
    assert np.array_equal(frame["tension2_N"], MOTION.tensions[:, 1])
    assert np.array_equal(frame["m1_z_m"], MOTION.markers["m1"].positions[:, 2])
    wrench = [f"base_{q}{a}" for q in "fm" for a in "xyz"]
    columns = [f"{name}_{'N' if name[5] == 'f' else 'Nm'}" for name in wrench]
    assert np.array_equal(frame[columns], MOTION.base_wrenches)
    assert len(frame.columns) == 3 + 3 + 3 + 2 + 6


def test_a_data_set_has_the_whole_rod():
    pytest.importorskip("xarray")
    data = motion_dataset(MOTION)
    assert data["strain"].dims == ("time", "s", "strain_component")
    picked = data["strain"].sel(strain_component="u2", s=0.05, method=None)
    assert np.array_equal(picked, MOTION.strains[:, 1, 4])
    tip = data["position"].sel(s=0.1).interp(time=0.15)
    np.testing.assert_allclose(tip, (MOTION.positions[1, 2] + MOTION.positions[2, 2]) / 2)
    assert np.array_equal(
        data["base_wrench"].sel(wrench_component="mx"), MOTION.base_wrenches[:, 3]
    )
    assert data["position"].attrs["units"] == "m"
