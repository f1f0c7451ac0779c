"""A comparison of models as lines of text, as HTML and as plain numbers."""

import math
from html import escape

from calibration.inference.criteria import Candidate, Verdict
from calibration.report.tables import table

_METHOD = (
    "AICc and BIC relative to the lowest, for {n:.0f} independent of {all} coordinates: residuals "
    "are correlated, and only what they are worth is counted, as of the model that leaves least. "
    "Clocks and frames of recordings are among the numbers. A model with more numbers is asked for "
    "if its BIC is lower by more than 2, all that it adds is identified, and it does not predict "
    "what was kept aside worse."
)


def comparison_text(verdict: Verdict) -> list[str]:
    """The table and the verdict, as lines."""
    rows = [_HEAD[: len(_cells(verdict, 0))], *_rows(verdict)]
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    lines = ["  ".join(c.ljust(w) for c, w in zip(row, widths, strict=True)) for row in rows]
    return [*(line.rstrip() for line in lines), *verdict.sentences]


def comparison_html(verdict: Verdict | None) -> list[str]:
    """A section of a report; none without a comparison."""
    if verdict is None:
        return []
    said = "".join(f"<li>{escape(x)}</li>" for x in verdict.sentences)
    measured = verdict.candidates[0].measurements
    return [
        "<h2>Models compared</h2>",
        table(_HEAD[: len(_cells(verdict, 0))], _rows(verdict)),
        f"<ul>{said}</ul>",
        f"<p><small>{escape(_METHOD.format(n=verdict.effective, all=measured))}</small></p>",
    ]


def comparison_json(verdict: Verdict) -> dict:
    """Plain numbers: "chosen", "sentences", "effective_samples", and "models" by name."""
    number = lambda x: float(x) if x is not None and math.isfinite(x) else None
    one = lambda c, a, b: {
        "numbers": c.numbers,
        "rms_m": {k: number(x) for k, x in c.rms_m.items()},
        "held_out_rmse_m": {k: number(x) for k, x in c.held_out_m.items()},
        "aicc": number(a),
        "bic": number(b),
        "not_identified": list(c.vague),
        "trouble": c.trouble,
    }
    each = zip(verdict.candidates, verdict.aicc, verdict.bic, strict=True)
    return {
        "chosen": verdict.chosen,
        "sentences": list(verdict.sentences),
        "effective_samples": number(verdict.effective),
        "models": {c.name: one(c, a, b) for c, a, b in each},
    }


_HEAD = ("model", "numbers", "rms [mm]", "AICc", "BIC", "not identified", "kept aside [mm]")


def _rows(verdict: Verdict) -> list[tuple[str, ...]]:
    return [_cells(verdict, i) for i in range(len(verdict.candidates))]


def _cells(verdict: Verdict, i: int) -> tuple[str, ...]:
    """A row; without the last column where nothing was kept aside."""
    c: Candidate = verdict.candidates[i]
    star = " *" if c.name == verdict.chosen else ""
    vague = ", ".join([*c.vague, *([c.trouble] if c.trouble else [])]) or "-"
    cells = (
        c.name + star,
        str(c.numbers) if c.rms_m else "-",
        _millimetres(c.rms_m),
        f"{verdict.aicc[i]:.1f}",
        f"{verdict.bic[i]:.1f}",
        vague if c.rms_m else "no fit",
    )
    aside = any(c.held_out_m for c in verdict.candidates)
    return (*cells, _millimetres(c.held_out_m)) if aside else cells


def _millimetres(values) -> str:
    return ", ".join(f"{1e3 * x:.3f}" for x in values.values()) or "-"
