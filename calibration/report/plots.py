"""Pictures: the data before a fit; of a fit, each recording, its residuals and the rod's motion."""

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib import colormaps
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.colors import ListedColormap, Normalize
from matplotlib.figure import Figure

from calibration.data.recording import Recording
from calibration.data.selection import select
from calibration.report.results import Fit, PosturesFit, RecordingFit
from calibration.report.spectra import amplitudes
from softrod_jax.pictures.body import line_along

_MEASURED, _SIMULATED, _QUIET = "#1f77b4", "#d62728", "#888888"
# Moments of a motion, places along the rod, and the colours from its begin to its end.
_SHAPES, _PLACES = 14, 60
_IN_TIME = ListedColormap(colormaps["plasma"](np.linspace(0.0, 0.88, 256)))  # yellow is not seen


def write_plots(fit: Fit, directory: Path) -> dict[str, Path]:
    """Write PNG files into `directory`; their paths by title."""
    paths = {}
    many = len(fit.recordings) + len(fit.held_out)
    for k, recording in enumerate((*fit.recordings, *fit.held_out)):
        stem = re.sub(r"[^A-Za-z0-9._-]+", "_", recording.name)
        stem = stem if many == 1 else f"{k + 1}_{stem}"
        kept_aside = k >= len(fit.recordings)
        title = recording.name + (", kept aside and predicted" if kept_aside else "")
        paths[title] = _save(recording_figure(recording), directory / f"fit_{stem}.png")
        paths[f"{title}: residuals"] = _save(
            residual_figure(recording), directory / f"residuals_{stem}.png"
        )
        if not kept_aside:
            paths[f"{title}: motion"] = _save(
                motion_figure(recording), directory / f"motion_{stem}.png"
            )
        if recording.drift:
            paths[f"{title}: drift"] = _save(
                drift_figure(recording), directory / f"drift_{stem}.png"
            )
    if fit.postures is not None:
        paths[f"{fit.postures.name}: equilibria"] = _save(
            postures_figure(fit.postures), directory / "equilibria.png"
        )
    for label in fit.profiles:
        stem = re.sub(r"[^A-Za-z0-9._-]+", "_", label)
        paths[f"Profile of {label}"] = _save(
            profile_figure(fit, label), directory / f"profile_{stem}.png"
        )
    paths["Convergence"] = _save(convergence_figure(fit), directory / "convergence.png")
    return paths


def write_data_plot(recordings: Sequence[Recording], window, path: Path) -> Path:
    """A look at the recordings before the fit: inputs, tips, and what of them is used."""
    figure = Figure(figsize=(9, 3.2 * len(recordings)), layout="constrained")
    grid = figure.subplots(len(recordings), 2, squeeze=False)
    for (inputs, tip), recording in zip(grid, recordings, strict=True):
        data_axes(inputs, tip, recording, window)
    return _save(figure, path)


def data_axes(inputs, tip, recording: Recording, window) -> None:
    """One recording: its inputs, and the three coordinates of its tip with the part in use."""
    t = recording.times
    for kind, values in recording.driven_by:
        unit, size = kind.shown
        for j, column in enumerate(values.T):
            inputs.plot(t, size * column, lw=1, label=f"{kind.one} {j + 1} [{unit}]")
    if inputs.lines:
        inputs.legend(fontsize=7)
    else:
        inputs.text(0.5, 0.5, "no inputs: a release", ha="center", transform=inputs.transAxes)
    inputs.set_xlabel("t [s]")
    inputs.set_title(recording.name, fontsize=10, parse_math=False)
    seen = recording.has_tip
    start = np.median(recording.track[1][:5], axis=0)
    for i, letter in enumerate("xyz"):
        tip.plot(t[seen], 1e3 * (recording.tip_positions[seen, i] - start[i]), ".", ms=2,
                 label=letter)  # fmt: skip
    selection = select(recording, window)
    tip.axvspan(selection.start, selection.end, color=_QUIET, alpha=0.15, label="used")
    tip.legend(fontsize=7, ncols=4)
    tip.set_xlabel("t [s]")
    tip.set_ylabel("tip, from its start [mm]")


def recording_figure(recording: RecordingFit) -> Figure:
    """Measured and simulated tip by axis, from where it started."""
    figure = Figure(figsize=(9, 7), layout="constrained")
    axes = figure.subplots(3, 1, sharex=True)
    start = recording.curve[0]
    outlier = np.any(recording.weights < 0.5, axis=1)
    for i, (axis, letter) in enumerate(zip(axes, "xyz", strict=True)):
        mm = lambda tip, i=i: 1e3 * (tip[:, i] - start[i])
        measured = mm(recording.measured)
        axis.plot(recording.times, measured, ".", ms=4, color=_MEASURED, label="measured")
        if np.any(outlier):
            axis.plot(
                recording.times[outlier], measured[outlier], "x", color=_QUIET, label="outlier"
            )
        if recording.band is not None:
            low, high = (mm(end) for end in recording.band)
            label = "95 % expected"
            axis.fill_between(
                recording.times, low, high, color=_SIMULATED, alpha=0.15, lw=0, label=label
            )
        axis.plot(
            recording.curve_times, mm(recording.curve), color=_SIMULATED, lw=1, label="simulated"
        )
        axis.set_ylabel(f"tip {letter} [mm]")
    axes[0].legend(loc="upper right", fontsize=8)
    axes[2].set_xlabel("time on the recording's clock [s]")
    title = f"{recording.name}: {1e3 * recording.rmse:.3g} mm rms"
    figure.suptitle(title, fontsize=11, parse_math=False)
    return figure


def postures_figure(postures: PosturesFit) -> Figure:
    """Equilibria that were fitted as well: markers in space, and how far off those of each row."""
    figure = Figure(figsize=(9, 3.8), layout="constrained")
    axes = figure.subplots(1, 3)
    simulated, measured = 1e3 * postures.simulated, 1e3 * postures.measured
    for axis, (i, j) in zip(axes, ((0, 2), (1, 2)), strict=False):
        axis.plot(measured[..., i].ravel(), measured[..., j].ravel(), "o", ms=4, mfc="none",
                  color=_MEASURED, label="measured")  # fmt: skip
        axis.plot(simulated[..., i].ravel(), simulated[..., j].ravel(), ".", ms=4,
                  color=_SIMULATED, label="simulated")  # fmt: skip
        axis.set_xlabel(f"{'xyz'[i]} [mm]")
        axis.set_ylabel(f"{'xyz'[j]} [mm]")
    axes[0].legend(fontsize=8)
    apart = np.linalg.norm(simulated - measured, axis=-1)
    for name, column in zip(postures.rmse_by_marker, apart.T, strict=True):
        axes[2].plot(np.arange(1, postures.rows + 1), column, ".", label=name)
    axes[2].set_xlabel("row")
    axes[2].set_ylabel("apart [mm]")
    axes[2].legend(fontsize=7)
    title = f"{postures.name}: {1e3 * postures.rmse_m:.3g} mm rms"
    figure.suptitle(title, fontsize=11, parse_math=False)
    return figure


def residual_figure(recording: RecordingFit) -> Figure:
    """Residuals in time, and how large they are at each frequency beside the motion itself."""
    figure = Figure(figsize=(9, 3.4), layout="constrained")
    in_time, in_frequency = figure.subplots(1, 2)
    residuals = 1e3 * (recording.simulated - recording.measured)
    for i, letter in enumerate("xyz"):
        in_time.plot(recording.times, residuals[:, i], ".-", ms=3, lw=0.7, label=letter)
    in_time.axhline(0, color=_QUIET, lw=0.7)
    in_time.set_ylabel("simulated - measured [mm]")
    in_time.set_xlabel("time on the recording's clock [s]")
    in_time.legend(ncols=3, fontsize=8)
    f, left = amplitudes(recording.times, residuals)
    _, motion = amplitudes(recording.times, 1e3 * recording.measured)
    together = lambda parts: np.sqrt(np.sum(parts**2, axis=1)) + 1e-12
    in_frequency.semilogy(f, together(motion), color=_QUIET, lw=1, label="motion")
    in_frequency.semilogy(f, together(left), color=_SIMULATED, lw=1, label="residuals")
    in_frequency.set_xlabel("frequency [Hz]")
    in_frequency.set_ylabel("amplitude [mm]")
    in_frequency.legend(fontsize=8)
    return figure


_DRIFTS = {  # by channel: unit, what one is in it, the names of its numbers
    "clock": ("ms", 1e3, ("clock, gained",)),
    "tip": ("mm", 1e3, ("tip x", "tip y", "tip z")),
    "inputs": ("%", 1e2, ("inputs",)),
}


def drift_figure(recording: RecordingFit) -> Figure:
    """What drifted, in time."""
    figure = Figure(figsize=(9, 2.8), layout="constrained")
    axes = figure.subplots(1, len(recording.drift), squeeze=False)[0]
    for axis, (channel, drift) in zip(axes, recording.drift.items(), strict=True):
        unit, one, names = _DRIFTS[channel]
        for name, values in zip(names, drift.values.T, strict=True):
            axis.plot(drift.edges, one * values, ".-", label=name)
        axis.set_ylabel(f"drift [{unit}]")
        axis.set_xlabel("time on the recording's clock [s]")
        axis.legend(fontsize=8)
    return figure


def motion_figure(recording: RecordingFit) -> Figure:
    """The rod at times of the motion, in the plane in which it moves most."""
    figure = Figure(figsize=(6, 4.5), layout="constrained")
    axis = figure.subplots()
    motion = recording.motion
    tip = 1e3 * motion.positions[:, -1]
    across = int(np.argmax(np.ptp(tip[:, :2], axis=0)))
    # Between the few nodes of a fit's grid, too.
    arc = np.linspace(0.0, np.max(motion.arc_lengths), _PLACES)
    shapes = 1e3 * line_along(motion, arc).p
    axis.plot(tip[:, 2], tip[:, across], color=_QUIET, lw=0.7)
    for k in np.unique(np.linspace(0, len(tip) - 1, _SHAPES).astype(int)):
        color = _IN_TIME(k / max(len(tip) - 1, 1))
        axis.plot(shapes[k, :, 2], shapes[k, :, across], color=color, lw=1.2)
    axis.set_xlabel("z [mm]")
    axis.set_ylabel(f"{'xy'[across]} [mm]")
    axis.set_aspect("equal", adjustable="datalim")
    span = Normalize(float(motion.ts[0]), float(motion.ts[-1]))
    figure.colorbar(ScalarMappable(span, _IN_TIME), ax=axis, label="time [s]", aspect=40)
    axis.set_title("the simulated rod in time; grey: the path of its tip", fontsize=9)
    return figure


def profile_figure(fit: Fit, label: str) -> Figure:
    """How much worse the best fit is at fixed values of one parameter."""
    profile, estimate = fit.profiles[label], fit.parameters[label]
    figure = Figure(figsize=(6, 3.4), layout="constrained")
    axis = figure.subplots()
    axis.plot(profile.values, np.minimum(profile.excess, 4), ".-", color=_SIMULATED)
    axis.axhline(1, color=_QUIET, lw=0.8, label="edge of the 95 % interval")
    if np.all(profile.values > 0):
        axis.set_xscale("log")
    axis.set_xlabel(f"{label} [{estimate.unit}]", parse_math=False)
    axis.set_ylabel("excess of the loss")
    axis.legend(fontsize=8)
    return figure


def convergence_figure(fit: Fit) -> Figure:
    """Distance between measured and simulated tip, for every evaluation of the fit."""
    figure = Figure(figsize=(9, 3), layout="constrained")
    axis = figure.subplots()
    rms = np.array([np.nan if h["rms_m"] is None else 1e3 * h["rms_m"] for h in fit.history])
    stages = [re.sub(r" \d+ of \d+$", "", h["stage"]) for h in fit.history]
    for stage in dict.fromkeys(stages):
        index = np.flatnonzero([s == stage for s in stages])
        axis.semilogy(index + 1, rms[index], ".", ms=4, label=stage)
    axis.set_xlabel("evaluation")
    axis.set_ylabel("rms distance [mm]")
    axis.legend(fontsize=8)
    return figure


def _save(figure: Figure, path: Path) -> Path:
    FigureCanvasAgg(figure)
    figure.savefig(path, dpi=110)
    return path
