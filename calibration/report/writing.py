"""`write_report`: a fit as files that can be read, by people and by programs."""

import base64
import json
import os
from collections.abc import Mapping
from html import escape
from os import PathLike
from pathlib import Path

import numpy as np

import softrod_jax as sr
from calibration.inference.criteria import Verdict
from calibration.report.comparison import comparison_html, comparison_json, comparison_text
from calibration.report.films import write_films
from calibration.report.granted import taken_for_granted
from calibration.report.plots import write_plots
from calibration.report.provenance import provenance
from calibration.report.remarks import remarks
from calibration.report.results import Compared, Estimate, Fit, PosturesFit
from calibration.report.tables import Html, table
from calibration.report.text import interval_text, postures_text, sampled, show_number


def write_report(fit: Fit, out_dir: str | PathLike, compared: Verdict | None = None) -> Path:
    """Write the fit into the directory `out_dir`, made if it is not there; returns its path.

    `compared`: the verdict on the models of which this one was chosen (`calibration.comparison`).

    - `parameters.json`: what `as_json` gives.
    - `report.html`: the same for reading, with the plots inside.
    - `scene.toml`: the scene with the fitted values, for `softrod simulate`.
    - `film_*.html`: the rod over the measured tip, to be turned and played; `motions.npz`: what
      `softrod film` makes others from.
    - `fit_*.png`, `residuals_*.png`, `motion_*.png`, `profile_*.png`, `convergence.png`.

    Raises `OSError` if a file cannot be written. The numbers are written first, and the fit's
    checkpoint, if it has one and the fit came to its end, is removed last.
    """
    out = Path(out_dir)
    out.mkdir(parents=True, exist_ok=True)
    text = json.dumps(as_json(fit, compared), indent=2, allow_nan=False)
    write_text(out / "parameters.json", text + "\n")
    pictures = write_plots(fit, out)
    films = write_films(fit, out)
    write_text(out / "report.html", _html(fit, pictures, films, compared))
    sr.save_scene(fit.setup.simulated_scene(), out / "scene.toml")
    if fit.result != "interrupted":
        fit.checkpoint.remove()
    return out


def write_text(path: Path, text: str) -> None:
    """All of it or nothing: a full disk leaves what was there before."""
    partial = path.with_name(path.name + ".new")
    try:
        partial.write_text(text, encoding="utf-8")
        os.replace(partial, path)
    finally:
        partial.unlink(missing_ok=True)


def summary(fit: Fit, compared: Verdict | None = None) -> str:
    """As `fit.summary()`, after the comparison of models, if there was one."""
    lines = [] if compared is None else [*comparison_text(compared), "", f"{compared.chosen}:"]
    return "\n".join([*lines, fit.summary()])


def as_json(fit: Fit, compared: Verdict | None = None) -> dict:
    """The fit as plain numbers, lists and strings.

    "parameters", by name: value, ci95 = [low, high] (null on a side without a bound), initial,
    unit, identifiable, verdict, recording (null: all), step_shift and grid_shift (change with half
    the time step and twice the grid, in half widths of the interval). "rmse_m" and "time_offset_s",
    by recording; "held_out_rmse_m", in the frame of the fit, and "held_out_rmse_own_frame_m", in
    one fitted to the recording, where it does not know its own (else null); "drift", by recording
    and channel (`calibration.experiment.drift`), at the edges of the windows; "comparison", of
    models (`calibration.report.comparison.comparison_json`), or null; "others", by recording, what
    is left of what else was measured; and how the fit was made.
    """
    return {
        "result": fit.result,
        "parameters": {name: estimate_as_json(e) for name, e in fit.parameters.items()},
        "rmse_m": fit.rmse_m,
        "held_out_rmse_m": {r.name: r.rmse for r in fit.held_out},
        "held_out_rmse_own_frame_m": {r.name: r.rmse_own_frame for r in fit.held_out},
        "rmse_axes_m": {r.name: plain(r.rmse_axes) for r in fit.recordings},
        "postures": None if fit.postures is None else _postures_json(fit.postures),
        "others": {r.name: others_json(r.others) for r in (*fit.recordings, *fit.held_out)},
        "samples": {r.name: sampled(r) for r in fit.recordings},
        "window_s": {r.name: [r.selection.start, r.selection.end] for r in fit.recordings},
        "time_offset_s": fit.time_offset_s,
        "time_offset_ci95_s": {r.name: plain(r.time_offset_ci95) for r in fit.recordings},
        "drift": {
            r.name: {
                name: {"edges_s": plain(d.edges), "values": plain(d.values)}
                for name, d in r.drift.items()
            }
            for r in fit.recordings
            if r.drift
        },
        "tip_offset_m": {r.name: plain(r.tip_offset) for r in fit.recordings},
        "frame_rotation_rad": {r.name: plain(r.frame_rotation) for r in fit.recordings},
        "conditions": {r.name: dict(r.recording.conditions) for r in fit.recordings},
        "priors": {name: list(pair) for name, pair in fit.priors.items()},
        "priors_contradicted": dict(fit.conflicts),
        "correlation": plain(fit.correlation),
        "samples_of_coordinates": fit.samples,
        "effective_samples": fit.effective_samples,
        "profiles": {
            label: {"values": plain(p.values), "excess": plain(p.excess)}
            for label, p in fit.profiles.items()
        },
        "starts": [
            {"initial": s.initial, "values": s.values, "rms_m": plain(s.rms), "result": s.result}
            for s in fit.starts
        ],
        "explanations": [
            {"name": e.name, "rms_m": e.rms, "values": e.values, "reading": e.reading}
            for e in fit.explanations or ()
        ],
        "comparison": None if compared is None else comparison_json(compared),
        "material": fit.material,
        "loss": fit.loss,
        "optimiser": fit.optimiser,
        "iterations": fit.iterations,
        "evaluations": fit.evaluations,
        "beginning": {r.name: r.beginning for r in (*fit.recordings, *fit.held_out)},
        "taken_for_granted": taken_for_granted(fit),
        "dt_s": fit.dt,
        "intervals": fit.method.intervals,
        "seconds": fit.seconds,
        "remarks": remarks(fit),
        "made_by": provenance(_sources(fit)),
    }


def estimate_as_json(e: Estimate) -> dict:
    """One parameter, as `as_json` has it."""
    return {
        "value": plain(e.value),
        "ci95": [plain(end) for end in e.ci95],
        "initial": plain(e.initial),
        "unit": e.unit,
        "identifiable": e.identifiable,
        "verdict": e.verdict,
        "recording": e.recording,
        "step_shift": plain(e.step_shift),
        "grid_shift": plain(e.grid_shift),
    }


def _sources(fit: Fit) -> list[str]:
    own = [r.recording.source for r in (*fit.recordings, *fit.held_out)]
    return own if fit.postures is None else [*own, *fit.postures.source.split("\n")]


def _postures_json(postures: PosturesFit) -> dict:
    return {
        "rows": postures.rows,
        "unsolved": postures.unsolved,
        "rmse_m": plain(postures.rmse_m),
        "rmse_by_marker_m": {name: plain(x) for name, x in postures.rmse_by_marker.items()},
        "noise_scale": plain(postures.noise_scale),
    }


def others_json(others: Mapping[str, Compared]) -> dict:
    """What is left of what else was measured, by key."""
    return {
        key: {"rms": plain(x.rms), "unit": x.unit, "rms_by_noise": plain(x.rms / x.noise)}
        for key, x in others.items()
    }


def plain(value):
    """Lists and floats; None for what is absent or not a number."""
    if value is None:
        return None
    array = np.asarray(value, dtype=float)
    if array.ndim == 0:
        return float(array) if np.isfinite(array) else None
    return [plain(x) for x in array]


STYLE = """
body { font: 15px/1.5 system-ui, sans-serif; max-width: 60em; margin: 2em auto; padding: 0 1em; }
table { border-collapse: collapse; margin: 1em 0; }
th, td { border-bottom: 1px solid #ccc; padding: .3em .8em; text-align: right; }
th:first-child, td:first-child { text-align: left; }
img { max-width: 100%; } .no { color: #b00; } li { margin: .4em 0; } small { color: #555; }
"""


def _html(
    fit: Fit, pictures: dict[str, Path], films: dict[str, Path], compared: Verdict | None
) -> str:
    parts = [
        "<!doctype html><html lang='en'><meta charset='utf-8'><title>Calibration</title>",
        f"<style>{STYLE}</style><h1>Calibration</h1>",
        f"<p>{_headline(fit)}</p>",
        *comparison_html(compared),
        "<h2>Parameters</h2>",
        table(
            (
                "parameter",
                "value",
                "95 % interval",
                "unit",
                "initial",
                "verdict",
                "half step",
                "twice the grid",
            ),
            [_row(name, e) for name, e in fit.parameters.items()],
        ),
        "<p><small>Half step, twice the grid: how far the value would move if the simulation were "
        "finer, in half widths of its interval. Intervals take for granted what was not fitted: "
        f"{escape(', '.join(taken_for_granted(fit)))}.</small></p>",
        *_priors(fit),
        "<h2>Before you use them</h2><ul>",
        *(f"<li>{escape(r)}</li>" for r in remarks(fit) or ["Nothing stands out."]),
        "</ul><h2>Recordings</h2>",
        table(
            ("recording", "rms [mm]", "x, y, z [mm]", "samples", "window [s]", "time offset [s]"),
            [_recording_row(r) for r in fit.recordings],
        ),
        "<p><small>rms: root mean square distance between measured and simulated tip. "
        "Time offset: for a release, when it happened on the recording's clock; with inputs, how "
        "much later than the inputs the tip's clock says they began. Samples used: "
        + "; ".join(sorted({escape(r.selection.rule) for r in fit.recordings}))
        + ".</small></p>",
        *_others(fit),
        *([] if fit.postures is None else [f"<p>{escape(postures_text(fit.postures))}</p>"]),
        *_notes(fit),
        *_held_out(fit),
        *_starts(fit),
        *_explanations(fit),
    ]
    links = (f"<a href='{escape(p.name)}'>{escape(t)}</a>" for t, p in films.items())
    parts += ["<h2>Films</h2>", f"<p>The rod in space, to be turned: {', '.join(links)}.</p>"]
    for title, path in pictures.items():
        data = base64.b64encode(path.read_bytes()).decode()
        alt = escape(title, quote=True)
        parts += [
            f"<h2>{escape(title)}</h2>",
            f"<img alt='{alt}' src='data:image/png;base64,{data}'>",
        ]
    if len(fit.parameters) > 1:
        names = list(fit.parameters)
        rows = [
            (name, *(f"{r:+.2f}" for r in row))
            for name, row in zip(names, fit.correlation, strict=True)
        ]
        parts += ["<h2>Correlations</h2>", table(("", *names), rows)]
    parts += ["<h2>How it was made</h2>", f"<p>{_method(fit)}</p>", "</html>"]
    return "\n".join(parts)


def _headline(fit: Fit) -> str:
    worst = max(fit.rmse_m.values())
    many = "recording" if len(fit.recordings) == 1 else "recordings"
    return (
        f"{len(fit.recordings)} {many}; {escape(fit.result)}; the simulated tip is "
        f"{1e3 * worst:.3g} mm rms from the measured one"
        + (" in the worst of them." if len(fit.recordings) > 1 else ".")
    )


def _others(fit: Fit) -> list[str]:
    """What else was measured."""
    rows = [
        (r.name, key, f"{x.rms:.4g}", x.unit, f"{x.rms / x.noise:.2f}")
        for r in (*fit.recordings, *fit.held_out)
        for key, x in r.others.items()
    ]
    head = ("recording", "measured, too", "rms left", "unit", "times the noise stated")
    return [table(head, rows)] if rows else []


def _notes(fit: Fit) -> list[str]:
    """What readers assumed, and in what recordings differ from the scene."""
    lines = []
    for r in (*fit.recordings, *fit.held_out):
        conditions = [f"{k} = {v:g}" for k, v in r.recording.conditions.items()]
        said = (*r.recording.notes, *conditions, f"taken to begin {r.beginning}")
        lines += [f"<li>{escape(r.name)}: {escape(text)}</li>" for text in said]
    return ["<ul>", *lines, "</ul>"] if lines else []


def _priors(fit: Fit) -> list[str]:
    """What was known beforehand, beside what was found."""
    rows = []
    for label, e in fit.parameters.items():
        pair = fit.priors.get(label, fit.priors.get(e.name))
        if pair is not None:
            away = (float(np.mean(e.value)) - pair[0]) / pair[1]
            prior = f"{show_number(pair[0])} \N{PLUS-MINUS SIGN} {show_number(pair[1])}"
            apart = f"{fit.conflicts[label]:.1f}" if label in fit.conflicts else ""
            rows.append((label, prior, show_number(e.value), f"{away:+.2f}", apart))
    head = ("known beforehand", "prior", "value", "away [deviations]", "contradicted by")
    return [table(head, rows)] if rows else []


def _held_out(fit: Fit) -> list[str]:
    if not fit.held_out:
        return []
    head = ("kept aside", "rms [mm]", "x, y, z [mm]", "samples", "window [s]", "time offset [s]")
    rows, what = [_recording_row(r) for r in fit.held_out], "Of these only the clock was fitted."
    if any(r.rmse_own_frame is not None for r in fit.held_out):
        head = (*head, "in a frame of its own [mm]")
        own = [r.rmse_own_frame for r in fit.held_out]
        rows = [
            (*row, Html("&ndash;") if x is None else f"{1e3 * x:.3f}")
            for row, x in zip(rows, own, strict=True)
        ]
        what = (
            "Of these the clock was fitted. A recording that does not know where the clamp is is "
            "seen in the frame of the fitted ones, if those have one; in the last column in one "
            "that was fitted to it, three offsets and three rotations: kinder than a prediction."
        )
    return [
        "<h2>Predictions of recordings that were kept aside</h2>",
        table(head, rows),
        f"<p><small>{what}</small></p>",
    ]


def _starts(fit: Fit) -> list[str]:
    if len(fit.starts) < 2:
        return []
    names = list(fit.starts[0].values)
    rows = [
        (
            str(k + 1),
            f"{1e3 * s.rms:.4g}",
            *(f"{s.initial[n]:.3g} \N{RIGHTWARDS ARROW} {s.values[n]:.4g}" for n in names),
            s.result,
        )
        for k, s in enumerate(fit.starts)
    ]
    return ["<h2>Starts</h2>", table(("", "rms [mm]", *names, "result"), rows)]


def _explanations(fit: Fit) -> list[str]:
    if not fit.explanations:
        return []
    rows = [
        (
            e.name,
            f"{1e3 * e.rms:.3f}",
            ", ".join(f"{k} = {v:.4g} {e.units[k]}" for k, v in e.values.items()),
        )
        for e in fit.explanations
    ]
    return [
        "<h2>What else would explain the residuals</h2>",
        table(("if fitted, too", "rms left [mm]", "at about"), rows),
        "<p><small>To first order, one at a time; release_duration by a short fit. A parameter "
        "that takes much away need not be the cause; something that looks like it is missing."
        "</small></p>",
    ]


def _method(fit: Fit) -> str:
    steps = ", ".join(f"{1e3 * dt:.3g} ms" for dt in sorted(set(fit.dt.values())))
    loss = "least squares" if fit.loss == "squares" else f"{fit.loss} weights"
    return (
        f"{escape(fit.optimiser.replace('_', ' '))}, {loss}: {fit.evaluations} "
        f"simulations, {fit.seconds:.1f} s. Time step {steps}, {fit.method.intervals} intervals "
        "along the rod. Positive parameters were fitted as "
        "logarithms. Intervals: linearised least squares, noise estimated by recording and axis "
        "and taken at the frequency where it is largest "
        f"({fit.effective_samples:.0f} independent of {fit.samples} coordinates); bounds of "
        "parameters that are not well determined were looked for by simulation."
    )


def _row(name: str, e: Estimate) -> tuple:
    verdict = e.verdict
    if not e.identifiable:
        verdict = Html(f"<span class='no'>{escape(e.verdict)}</span>")
    shift = lambda x: Html("&ndash;") if x is None else f"{x:+.3f}"
    return (
        name,
        show_number(e.value),
        interval_text(e),
        "" if e.unit == "1" else e.unit,
        show_number(e.initial),
        verdict,
        shift(e.step_shift),
        shift(e.grid_shift),
    )


def _recording_row(r) -> tuple:
    offset = f"{r.time_offset:.4f}"
    if r.time_offset_ci95 is not None:
        offset += f" \N{PLUS-MINUS SIGN} {(r.time_offset_ci95[1] - r.time_offset_ci95[0]) / 2:.4f}"
    return (
        r.name,
        f"{1e3 * r.rmse:.3f}",
        ", ".join(f"{1e3 * x:.3f}" for x in r.rmse_axes),
        str(sampled(r)),
        f"{r.selection.start:.3f} .. {r.selection.end:.3f}",
        offset,
    )
