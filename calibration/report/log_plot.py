"""A picture of one log: its inputs, its tip in time, and the path of the tip or the rod itself."""

import numpy as np
from matplotlib.figure import Figure

from calibration.data.recording import Recording

_MEASURED, _SIMULATED = "#1f77b4", "#d62728"
_STILLS = 6


def log_figure(recording: Recording, scene=None, trajectory=None) -> Figure:
    """The tip's x, y and z and the inputs against time, and beside them the tip's path.

    With a `scene` and the `trajectory` simulated from the log's inputs, the rod is drawn at some
    moments instead, and the simulated tip over the log's, on the log's clock; and the sizes of the
    forces of obstacles, where the scene has them.
    """
    inputs = recording.driven_by
    forces = {} if trajectory is None else trajectory.contact_forces
    panels = len(inputs) + bool(forces)
    figure = Figure(figsize=(10, 4.6 + 0.7 * panels))
    place = {"left": 0.62, "right": 0.95, "top": 0.94, "bottom": 0.09, "hspace": 0.25}
    rows = figure.subplots(3 + panels, 1, sharex=True, gridspec_kw=place)
    _draw_tip(rows[:3], recording, trajectory)
    for row, (kind, values) in zip(rows[3:], inputs, strict=False):
        unit, size = kind.shown
        for j, column in enumerate(values.T):
            row.plot(recording.times, size * column, lw=1, label=f"{j + 1}")
        row.set_ylabel(f"{kind.one} [{unit}]")
        if values.shape[1] > 1:
            _name_curves(row)
    if forces:
        _draw_forces(rows[-1], recording, scene, trajectory)
    for row in rows:
        row.grid(alpha=0.3)
    rows[-1].set_xlabel("time [s]")
    figure.align_ylabels(rows)

    left = figure.add_gridspec(1, 1, left=0.0, right=0.5, top=1.0, bottom=0.0)[0]
    if trajectory is None:
        _draw_path(figure.add_subplot(left, projection="3d"), recording)
    else:
        _draw_rod(figure, left, recording, scene, trajectory)
    return figure


def _draw_forces(row, recording, scene, trajectory) -> None:
    from softrod_jax.scene.contacts import contact_names  # imports JAX

    ts = recording.times[0] + np.asarray(trajectory.ts)
    for name in contact_names(scene.contacts):
        size = np.linalg.norm(trajectory.contact_forces[name], axis=-1)
        row.plot(ts, size, lw=1, label=name)
    row.set_ylabel("force [N]")
    _name_curves(row)


def _name_curves(row) -> None:
    row.legend(fontsize=7, loc="center left", bbox_to_anchor=(1, 0.5), frameon=False)


def _draw_tip(rows, recording, trajectory) -> None:
    t, tip = recording.times, 1e3 * recording.tip_positions
    for i, (row, letter) in enumerate(zip(rows, "xyz", strict=True)):
        seen = np.isfinite(tip[:, i])
        row.plot(t[seen], tip[seen, i], ".-", ms=3, lw=0.8, color=_MEASURED, label="log")
        if trajectory is not None:
            ts = recording.times[0] + np.asarray(trajectory.ts)
            simulated = 1e3 * np.asarray(trajectory.tip_positions[:, i])
            row.plot(ts, simulated, lw=1.2, color=_SIMULATED, label="simulated")
        row.set_ylabel(f"tip {letter} [mm]")
    if trajectory is not None and len(t):
        rows[0].legend(fontsize=8, ncols=2, loc="lower right", bbox_to_anchor=(1, 1), frameon=False)


def _draw_path(axes, recording) -> None:
    # A coordinate that no camera saw is drawn as zero.
    tip = 1e3 * recording.track[1]
    axes.plot(*tip.T, lw=1, color=_MEASURED)
    axes.plot(*tip[:1].T, "o", ms=5, color="black", label="start")
    axes.plot(*tip[-1:].T, "s", ms=5, color=_SIMULATED, label="end")
    for name in "xyz":  # far enough from the numbers
        getattr(axes, f"set_{name}label")(f"{name} [mm]", labelpad=10)
    # A tip that moves in a plane, or along a line, needs room across it.
    middle = (tip.min(axis=0) + tip.max(axis=0)) / 2
    room = np.maximum(np.ptp(tip, axis=0), 0.5 * np.ptp(tip, axis=0).max() + 1e-3) * 0.55
    for name, centre, half in zip("xyz", middle, room, strict=True):
        axes.set(**{f"{name}lim": (centre - half, centre + half)})
        axes.locator_params(axis=name, nbins=3)
    axes.set_box_aspect(room, zoom=0.8)
    axes.legend(fontsize=8, loc="upper left", bbox_to_anchor=(0.05, 0.95), title="path of the tip")


def _draw_rod(figure, place, recording, scene, trajectory) -> None:
    from softrod_jax.pictures import draw_stills, rod_axes  # imports JAX

    axes = rod_axes(figure, scene, trajectory, place=place)
    draw_stills(axes, scene, trajectory, _STILLS, measured_tip=recording.tip_positions)
