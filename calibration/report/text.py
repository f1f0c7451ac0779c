"""A fit as lines of text, and as a table of HTML for notebooks."""

from collections.abc import Mapping
from html import escape
from typing import Any

import numpy as np

from calibration.report.granted import taken_for_granted


def summary_text(fit) -> str:
    """The parameters of a `Fit` and what is left of each recording, as lines of text."""
    text = as_rows(fit.parameters)
    text += [
        f"{r.name}: {1e3 * r.rmse:.3g} mm rms over {sampled(r)} samples, "
        f"{r.selection.start:.2f} to {r.selection.end:.2f} s; time offset {r.time_offset:.4f} s"
        for r in fit.recordings
    ]
    text += [_predicted(r) for r in fit.held_out]
    for r in (*fit.recordings, *fit.held_out):
        text += [f"{r.name}, {line}" for line in others_text(r.others)]
    if fit.postures is not None:
        text.append(postures_text(fit.postures))
    text += posterior_text(fit.posterior)
    text += [
        f"{name}: its prior and the recordings are {apart:.1f} standard deviations apart"
        for name, apart in fit.conflicts.items()
    ]
    text.append(f"intervals take for granted: {', '.join(taken_for_granted(fit))}")
    return "\n".join(line.rstrip() for line in [*text, fit.result])


def as_rows(parameters: Mapping[str, Any]) -> list[str]:
    """The parameters as lines of a table."""
    lines = [("parameter", "value", "95 % interval", "initial", "verdict")]
    for name, e in parameters.items():
        unit = "" if e.unit == "1" else f" {e.unit}"
        lines.append(
            (name, show_number(e.value) + unit, interval_text(e), show_number(e.initial), e.verdict)
        )
    widths = [max(len(line[i]) for line in lines) for i in range(len(lines[0]))]
    return ["  ".join(c.ljust(w) for c, w in zip(line, widths, strict=True)) for line in lines]


def others_text(others) -> list[str]:
    """What is left of what else was measured, by key: lines of text."""
    return [
        f"{key}: {x.rms:.3g} {x.unit} rms, {x.rms / x.noise:.2g} times the noise"
        for key, x in others.items()
    ]


def posterior_text(posterior) -> list[str]:
    """What 95 % of the draws are in, by parameter; nothing of None."""
    if posterior is None:
        return []
    return [
        f"{name}: 95 % of the posterior ({posterior.method}) in "
        + " .. ".join(show_number(end) for end in ends)
        for name, ends in posterior.ci95.items()
    ]


def postures_text(postures) -> str:
    """What is left of equilibria that were fitted, too."""
    failed = f", {postures.unsolved} without one in the simulation" if postures.unsolved else ""
    return (
        f"{postures.name}: {postures.rows} equilibria, {1e3 * postures.rmse_m:.3g} mm rms, "
        f"{postures.noise_scale:.2g} times the noise that was stated{failed}"
    )


def _predicted(r) -> str:
    text = f"{r.name}: predicted to {1e3 * r.rmse:.3g} mm rms"
    if r.rmse_own_frame is None:
        return text
    if r.frame_fitted:
        return f"{text} in a frame fitted to it"
    return f"{text} in the frame of the fit, {1e3 * r.rmse_own_frame:.3g} in one fitted to it"


def html_table(fit) -> str:
    """The same of a `Fit` for a notebook."""
    head = ("parameter", "value", "unit", "95 % interval", "initial", "verdict")
    rows = [
        (name, show_number(e.value), e.unit, interval_text(e), show_number(e.initial), e.verdict)
        for name, e in fit.parameters.items()
    ]
    row = lambda cells, tag: (
        "<tr>" + "".join(f"<{tag}>{escape(x)}</{tag}>" for x in cells) + "</tr>"
    )
    recordings = [
        f"{r.name}: {1e3 * r.rmse:.3g} mm rms over {sampled(r)} samples" for r in fit.recordings
    ] + [_predicted(r) for r in fit.held_out]
    lines = "<br>".join(map(escape, [*recordings, fit.result]))
    body = "".join(row(cells, "td") for cells in rows)
    return f"<table>{row(head, 'th')}{body}</table><p>{lines}</p>"


def sampled(recording) -> int:
    """How many samples of a `RecordingFit` have a coordinate of the tip."""
    return int(np.sum(np.any(np.isfinite(recording.measured), axis=1)))


def interval_text(estimate) -> str:
    """The 95 % interval of an `Estimate`."""
    ends = estimate.ci95
    return " .. ".join("open" if end is None else show_number(end) for end in ends)


def show_number(value) -> str:
    """A number or several, in 4 digits."""
    return ", ".join(f"{x:.4g}" for x in np.ravel(value))
