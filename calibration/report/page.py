"""A fit as a page to read, `report.html`, with its plots inside."""

import base64
from html import escape
from pathlib import Path

import numpy as np

from calibration.inference.criteria import Verdict
from calibration.report.comparison import comparison_html
from calibration.report.granted import taken_for_granted
from calibration.report.remarks import remarks
from calibration.report.results import Estimate, Fit
from calibration.report.tables import Html, table
from calibration.report.text import interval_text, postures_text, sampled, show_number

STYLE = """
body { font: 15px/1.5 system-ui, sans-serif; max-width: 60em; margin: 2em auto; padding: 0 1em; }
table { border-collapse: collapse; margin: 1em 0; }
th, td { border-bottom: 1px solid #ccc; padding: .3em .8em; text-align: right; }
th:first-child, td:first-child { text-align: left; }
img { max-width: 100%; } .no { color: #b00; } li { margin: .4em 0; } small { color: #555; }
"""


def page(
    fit: Fit, pictures: dict[str, Path], films: dict[str, Path], compared: Verdict | None
) -> str:
    """The whole page. `pictures` and `films`: their files, by title."""
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
