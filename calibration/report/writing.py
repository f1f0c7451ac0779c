"""`write_report`: a fit as files that can be read, by people and by programs."""

import json
import os
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

import softrod_jax as sr
from calibration.inference.criteria import Verdict
from calibration.report.comparison import comparison_text
from calibration.report.films import write_films
from calibration.report.numbers import as_json
from calibration.report.page import page
from calibration.report.plots import write_plots
from calibration.report.results import Fit


def write_report(fit: Fit, out_dir: str | PathLike, compared: Verdict | None = None) -> Path:
    """Write the fit into the directory `out_dir`, made if it is not there; returns its path.

    `compared`: the verdict on the models of which this one was chosen (`calibration.comparison`).

    - `parameters.json`: what `as_json` gives.
    - `report.html`: the same for reading, with the plots inside.
    - `scene.toml`: the scene with the fitted values, for `softrod simulate`.
    - `film_*.html`: the rod over the measured tip, to be turned and played; `motions.npz`: what
      `softrod film` makes others from.
    - `posterior.npz`: draws of the posterior by label, where there are any.
    - `fit_*.png`, `residuals_*.png`, `motion_*.png`, `profile_*.png`, `convergence.png`.

    Raises `OSError` if a file cannot be written. The numbers are written first, and the fit's
    checkpoint, if it has one and the fit came to its end, is removed last.
    """
    out = Path(out_dir)
    out.mkdir(parents=True, exist_ok=True)
    text = json.dumps(as_json(fit, compared), indent=2, allow_nan=False)
    write_text(out / "parameters.json", text + "\n")
    if fit.posterior is not None:
        draws: dict[str, Any] = dict(fit.posterior.values)
        np.savez(out / "posterior.npz", **draws)
    pictures = write_plots(fit, out)
    films = write_films(fit, out)
    write_text(out / "report.html", page(fit, pictures, films, compared))
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
