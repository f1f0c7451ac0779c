"""A fit of postures as files, for people and for programs."""

import base64
import json
from html import escape
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

import softrod_jax as sr
from calibration.inference.criteria import Verdict
from calibration.postures.fitting import PostureFit
from calibration.report.comparison import comparison_html, comparison_json
from calibration.report.numbers import estimate_as_json, others_json, plain, posterior_json
from calibration.report.page import STYLE
from calibration.report.provenance import provenance
from calibration.report.tables import table
from calibration.report.text import as_rows, others_text, posterior_text
from calibration.report.writing import write_text

_MEASURED, _SIMULATED = "#1f77b4", "#d62728"
_WORST = 8


def write_posture_report(
    fit: PostureFit, out_dir: str | PathLike, compared: Verdict | None = None
) -> Path:
    """Write `parameters.json`, `report.html`, `scene.toml` and pictures into `out_dir`, and
    `posterior.npz`, the draws by the name of the parameter, where there are any.

    `compared`: the verdict on the models of which this one was chosen
    (`calibration.postures.compare`).

    Raises `OSError` if a file cannot be written.
    """
    out = Path(out_dir)
    out.mkdir(parents=True, exist_ok=True)
    text = json.dumps(posture_json(fit, compared), indent=2, allow_nan=False)
    write_text(out / "parameters.json", text + "\n")
    pictures = {}
    if fit.markers:
        pictures["Markers in space"] = _saved(_in_space(fit), out / "markers.png")
        pictures["Errors along the body"] = _saved(_errors(fit), out / "errors.png")
    if fit.others:
        pictures["Other measurements"] = _saved(_others(fit), out / "others.png")
    write_text(out / "report.html", _html(fit, pictures, compared))
    sr.save_scene(fit.setup.simulated_scene(), out / "scene.toml")
    if fit.posterior is not None:
        draws: dict[str, Any] = dict(fit.posterior.values)
        np.savez(out / "posterior.npz", **draws)
    return out


def posture_json(fit: PostureFit, compared: Verdict | None = None) -> dict:
    """The fit as plain numbers, lists and strings; "parameters" as of a fit of motions."""
    return {
        "result": "converged" if fit.converged else "not converged",
        "parameters": {name: estimate_as_json(e) for name, e in fit.parameters.items()},
        "rmse_m": {name: plain(_rms(fit, rows)) for name, rows in _logs(fit).items()},
        "rmse_by_marker_m": {name: plain(x) for name, x in fit.rmse_by_marker.items()},
        "others": others_json(fit.others),
        "held_out_rmse_m": plain(fit.held_out_m),
        "comparison": None if compared is None else comparison_json(compared),
        "posterior": posterior_json(fit.posterior),
        "rows": fit.postures.rows,
        "unsolved_rows": fit.unsolved,
        "effective_samples": fit.effective,
        "noise_scale": plain(fit.noise_scale),
        "priors_contradicted": fit.conflicts,
        "correlation": plain(fit.correlation),
        "evaluations": fit.evaluations,
        "seconds": fit.seconds,
        "remarks": posture_remarks(fit),
        "made_by": provenance(fit.postures.source.split("\n")),
    }


def posture_summary(fit: PostureFit) -> str:
    """Parameters and what is left of the markers, as lines of text."""
    lines = as_rows(fit.parameters)
    lines += [f"{n}: {1e3 * x:.3g} mm rms" for n, x in fit.rmse_by_marker.items()]
    if fit.markers:
        lines.append(f"all: {1e3 * fit.rmse_m:.3g} mm rms over {fit.postures.rows} postures")
    lines += others_text(fit.others)
    lines += posterior_text(fit.posterior)
    if fit.held_out_m is not None:
        lines.append(f"kept aside and predicted: {1e3 * fit.held_out_m:.3g} mm rms")
    return "\n".join([*lines, *posture_remarks(fit)])


def posture_remarks(fit: PostureFit) -> list[str]:
    """What to know before the numbers are used."""
    said = []
    if not fit.converged:
        said.append("The search has not converged; raise the number of evaluations.")
    if fit.unsolved:
        said.append(f"{fit.unsolved} rows have no equilibrium with these numbers.")
    vague = [name for name, e in fit.parameters.items() if not e.identifiable]
    if vague:
        said.append(f"The postures do not tell {', '.join(vague)}; fix them, or give priors.")
    for name, apart in fit.conflicts.items():
        said.append(
            f"The prior of {name} is contradicted: without it the value would be {apart:.1f} "
            "standard deviations away."
        )
    names, C = list(fit.parameters), np.abs(fit.correlation)
    pairs = [(i, j) for j in range(len(names)) for i in range(j) if C[i, j] > 0.95]
    said += [f"{names[i]} and {names[j]} are told apart badly ({C[i, j]:.3f})." for i, j in pairs]
    return said + (fit.posterior.remarks if fit.posterior is not None else [])


def _logs(fit: PostureFit) -> dict[str, np.ndarray]:
    """The rows of each log, by its name."""
    rows, sizes = {}, fit.postures.parts or ((fit.postures.name, fit.postures.rows),)
    start = 0
    for name, count in sizes:
        rows[name] = np.arange(start, start + count)
        start += count
    return rows


def _apart(fit: PostureFit):
    """Distances [m], (rows, markers)."""
    return np.linalg.norm(fit.simulated - fit.measured, axis=-1)


def _rms(fit: PostureFit, rows):
    if not np.any(np.isfinite(_apart(fit)[rows])):
        return None
    return np.sqrt(np.nanmean(_apart(fit)[rows] ** 2))


def _by_row(fit: PostureFit):
    """Root mean square distance [m] of the markers of each row; nan where none was seen whole."""
    squares = _apart(fit) ** 2
    seen = np.sum(np.isfinite(squares), axis=1)
    return np.sqrt(np.where(seen > 0, np.nansum(squares, axis=1) / np.maximum(seen, 1), np.nan))


def _in_space(fit: PostureFit) -> Figure:
    figure = Figure(figsize=(10, 4.2), layout="constrained")
    for k, (a, b) in enumerate(((0, 2), (1, 2)), 1):
        axes = figure.add_subplot(1, 2, k)
        for name, x, colour in (
            ("measured", fit.measured, _MEASURED),
            ("simulated", fit.simulated, _SIMULATED),
        ):
            flat = 1e3 * x.reshape(-1, 3)
            axes.plot(flat[:, a], flat[:, b], ".", ms=3, color=colour, alpha=0.6, label=name)
        lines = 1e3 * np.stack([fit.measured, fit.simulated]).reshape(2, -1, 3)
        axes.plot(lines[..., a], lines[..., b], "-", lw=0.4, color="#888888", alpha=0.6)
        axes.set(xlabel=f"{'xyz'[a]} [mm]", ylabel=f"{'xyz'[b]} [mm]")
        axes.set_aspect("equal", adjustable="datalim")
        axes.legend(loc="best")
    return figure


def _errors(fit: PostureFit) -> Figure:
    figure = Figure(figsize=(10, 3.6), layout="constrained")
    left, right = figure.subplots(1, 2)
    apart = 1e3 * _apart(fit)
    left.boxplot([x[np.isfinite(x)] for x in apart.T], tick_labels=list(fit.markers))
    left.set(ylabel="distance [mm]", title="by marker")
    right.plot(apart, ".", ms=3)
    right.set(xlabel="row", ylabel="distance [mm]", title="by row")
    right.legend(fit.markers, loc="best")
    return figure


def _others(fit: PostureFit) -> Figure:
    figure = Figure(figsize=(10, 3.2 * len(fit.others)), layout="constrained")
    for axes, (key, x) in zip(
        figure.subplots(len(fit.others), 1, squeeze=False)[:, 0], fit.others.items()
    ):
        for j, colour in enumerate(("#1f77b4", "#2ca02c", "#9467bd")[: x.measured.shape[1]]):
            axes.plot(x.measured[:, j], ".", ms=4, color=colour, label=f"measured {'xyz'[j]}")
            axes.plot(x.simulated[:, j], "-", lw=0.8, color=colour)
        axes.set(xlabel="row", ylabel=f"{key} [{x.unit}]")
        axes.legend(loc="best")
    return figure


def _saved(figure: Figure, path: Path) -> Path:
    FigureCanvasAgg(figure)
    figure.savefig(path, dpi=110)
    return path


def _html(fit: PostureFit, pictures, compared: Verdict | None) -> str:
    apart = _by_row(fit)
    worst = [k for k in np.argsort(apart)[::-1] if np.isfinite(apart[k])][:_WORST]
    labels = fit.postures.labels
    parts = [
        "<!doctype html><html lang='en'><meta charset='utf-8'><title>Calibration</title>",
        f"<style>{STYLE}</style><h1>Calibration to postures</h1>",
        *comparison_html(compared),
        f"<pre>{escape(posture_summary(fit))}</pre>",
    ]
    if fit.markers:
        rows = [(str(k + 1), labels[k], f"{1e3 * apart[k]:.2f}") for k in worst]
        parts += ["<h2>Worst postures</h2>", table(("row", "trial", "distance [mm]"), rows)]
    for title, path in pictures.items():
        data = base64.b64encode(path.read_bytes()).decode()
        parts.append(f"<h2>{title}</h2><img alt='{title}' src='data:image/png;base64,{data}'>")
    return "\n".join([*parts, "</html>"])
