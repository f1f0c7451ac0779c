"""Motions as tables of pandas and data sets of xarray, which are extras."""

from typing import Any

import numpy as np


def motion_frame(motion) -> Any:
    """A `pandas.DataFrame` of a `Trajectory`: a row for each time, `t_s` as its index.

    Columns as in a log: `tip_x_m`, .., `tip_vx_m_s`, .., the `tension1_N`, .. of all tendons,
    `NAME_x_m`, .. of markers, and `base_fx_N`, .. `base_mz_Nm`, about the clamp. Raises
    `ImportError` without pandas.
    """
    try:
        import pandas
    except ImportError as e:
        raise ImportError(f"to_pandas: {e}: pip install 'softrod_jax[tables]'") from None
    columns = _vector("tip_{}_m", motion.tip_positions)
    columns |= _vector("tip_v{}_m_s", motion.tip_velocities)
    for name, track in motion.markers.items():
        if name != "tip":
            columns |= _vector(f"{name}_{{}}_m", track.positions)
    tensions = np.asarray(motion.tensions)
    columns |= {f"tension{i + 1}_N": tensions[:, i] for i in range(tensions.shape[1])}
    columns |= _vector("base_f{}_N", motion.base_wrenches[:, :3])
    columns |= _vector("base_m{}_Nm", motion.base_wrenches[:, 3:])
    return pandas.DataFrame(columns, index=pandas.Index(np.asarray(motion.ts), name="t_s"))


def motion_dataset(motion) -> Any:
    """An `xarray.Dataset` of a `Trajectory`, with the coordinates `time` [s] and `s` [m].

    The rod's `position` (time, s, xyz), `quaternion` (time, s, wxyz), `strain` (time, s,
    component) and `velocity`; `tip`, `tension` (time, tendon) and `base_wrench` (time, component).
    Raises `ImportError` without
    xarray.
    """
    try:
        import xarray
    except ImportError as e:
        raise ImportError(f"to_xarray: {e}: pip install 'softrod_jax[tables]'") from None
    along = ("time", "s")
    data = {
        "tip": (("time", "xyz"), motion.tip_positions, "m"),
        "position": ((*along, "xyz"), motion.positions, "m"),
        "quaternion": ((*along, "wxyz"), motion.quaternions, "1"),
        "strain": ((*along, "strain_component"), motion.strains, "1, 1/m"),
        "velocity": ((*along, "velocity_component"), motion.velocities, "m/s, rad/s"),
        "tension": (("time", "tendon"), motion.tensions, "N"),
        "base_wrench": (("time", "wrench_component"), motion.base_wrenches, "N, N m"),
    }
    return xarray.Dataset(
        {
            name: (axes, np.asarray(values), {"units": unit})
            for name, (axes, values, unit) in data.items()
        },
        coords={
            "time": ("time", np.asarray(motion.ts), {"units": "s"}),
            "s": ("s", np.asarray(motion.arc_lengths), {"units": "m"}),
            "xyz": list("xyz"),
            "wxyz": list("wxyz"),
            "strain_component": ["v1", "v2", "v3", "u1", "u2", "u3"],
            "wrench_component": ["fx", "fy", "fz", "mx", "my", "mz"],
            "velocity_component": ["q1", "q2", "q3", "w1", "w2", "w3"],
        },
    )


def _vector(form: str, values) -> dict[str, np.ndarray]:
    """Three columns by their names."""
    return {form.format(axis): np.asarray(values)[:, i] for i, axis in enumerate("xyz")}
