"""Pictures of a fit: each recording with its residuals, and the way to the optimum."""

import re
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from calibration.fit import Fit, RecordingFit

_MEASURED, _SIMULATED, _QUIET = "#1f77b4", "#d62728", "#888888"


def write_plots(fit: Fit, directory: Path) -> dict[str, Path]:
    """Write PNG files into `directory`; their paths by title."""
    paths = {}
    for k, recording in enumerate(fit.recordings):
        stem = re.sub(r"[^A-Za-z0-9._-]+", "_", recording.name)
        name = f"fit_{stem}.png" if len(fit.recordings) == 1 else f"fit_{k + 1}_{stem}.png"
        paths[recording.name] = _save(recording_figure(recording), directory / name)
    paths["Convergence"] = _save(convergence_figure(fit), directory / "convergence.png")
    return paths


def recording_figure(recording: RecordingFit) -> Figure:
    """Measured and simulated tip by axis, from where it started, and the residuals below."""
    figure = Figure(figsize=(9, 9), layout="constrained")
    axes = figure.subplots(4, 1, sharex=True, height_ratios=[1, 1, 1, 1.1])
    start = recording.curve[0]
    for i, (axis, letter) in enumerate(zip(axes[:3], "xyz", strict=True)):
        mm = lambda tip, i=i: 1e3 * (tip[:, i] - start[i])
        axis.plot(
            recording.times, mm(recording.measured), ".", ms=4, color=_MEASURED, label="measured"
        )
        axis.plot(
            recording.curve_times, mm(recording.curve), color=_SIMULATED, lw=1, label="simulated"
        )
        axis.set_ylabel(f"tip {letter} [mm]")
    axes[0].legend(loc="upper right", fontsize=8)
    residuals = 1e3 * (recording.simulated - recording.measured)
    for i, letter in enumerate("xyz"):
        axes[3].plot(recording.times, residuals[:, i], ".-", ms=3, lw=0.7, label=letter)
    axes[3].axhline(0, color=_QUIET, lw=0.7)
    axes[3].set_ylabel("simulated - measured [mm]")
    axes[3].set_xlabel("time on the recording's clock [s]")
    axes[3].legend(loc="upper right", ncols=3, fontsize=8)
    figure.suptitle(f"{recording.name}: {1e3 * recording.rmse:.3g} mm rms", fontsize=11)
    return figure


def convergence_figure(fit: Fit) -> Figure:
    """Distance between measured and simulated tip, for every evaluation of the fit."""
    figure = Figure(figsize=(9, 3), layout="constrained")
    axis = figure.subplots()
    rms = np.array([np.nan if h["rms_m"] is None else 1e3 * h["rms_m"] for h in fit.history])
    stages = [h["stage"] for h in fit.history]
    for stage in dict.fromkeys(stages):
        index = np.flatnonzero([s == stage for s in stages])
        axis.semilogy(index + 1, rms[index], ".-", ms=4, lw=0.8, label=stage.replace("_", " "))
    axis.set_xlabel("evaluation")
    axis.set_ylabel("rms distance [mm]")
    axis.legend(fontsize=8)
    return figure


def _save(figure: Figure, path: Path) -> Path:
    FigureCanvasAgg(figure)
    figure.savefig(path, dpi=110)
    return path
