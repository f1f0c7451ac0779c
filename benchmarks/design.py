"""Which postures to record: the chosen ones against all other choices, on the tapered tentacle.

    python benchmarks/design.py tentacle=FOLDER

`tentacle`: `postures.csv`, as of `postures.py`. Two cases:

- what was measured: 3 of the 8 equilibria (8 of 22, by the ratio), with modulus and density to be
  fitted, and with the frame of the cameras as well. Of all 56 choices: what is expected at the
  scene's first numbers, the intervals of a fit to the 3, and how far the 5 others are from where
  that fit predicts them.
- 22 candidates, the 8 and 14 with both tendons pulled, of which none is measured: 8 of them. Of all
  319,770 choices the interval that is expected.
"""

import argparse
import csv
import itertools
from pathlib import Path

import numpy as np
from postures import FRAME, GRID, tentacle_robot
from report import machine

from calibration.postures.data import Postures
from calibration.postures.design import badness, design_postures, information, standard_errors
from calibration.postures.fitting import calibrate_postures, prepared_model
from softrod_jax.scene.inputs import Inputs

FIT = ("young_modulus", "density")
MARKERS = {"m1": "m1", "m2": "m2", "m3": "m3", "m4": "tip"}
STEP = 1.53846  # N, between the tensions that were recorded


def recorded(folder: Path) -> Postures:
    """The eight equilibria."""
    rows = list(csv.DictReader((folder / "postures.csv").open(encoding="utf-8")))
    table = lambda names: np.array([[float(row[n]) for n in names] for row in rows])
    positions = {k: table([f"{c}_{a}_m" for a in "xyz"]) for k, c in MARKERS.items()}
    return Postures(Inputs(tensions=table(["tau1_N", "tau2_N"])), positions)


def with_both_pulled(postures: Postures) -> Postures:
    """The recorded inputs, and 14 more with both tendons pulled, one to four steps each but for the
    two with least and most."""
    both = STEP * np.array(list(itertools.product(range(1, 5), repeat=2)), dtype=float)
    tensions = np.concatenate([postures.inputs.tensions, both[1:-1]])
    nothing = np.zeros((len(tensions), 3))
    return Postures(Inputs(tensions=tensions), dict.fromkeys(MARKERS, nothing))


def worse(values, own: float) -> float:
    """The part of all choices [%] that a choice is better than."""
    values = np.asarray(values)
    return 100 * float(np.mean(values > own * (1 + 1e-12)))


def expected(told, choices, criterion="D"):
    """What the criterion makes small, of each choice of rows."""
    which = [*range(told.start.shape[0])]
    return badness(told.start + told.each[choices].sum(1), which, criterion)


def unseen_error(model, fit, rows) -> float:
    """How far the markers of all other rows are from where the fit to `rows` predicts them [m]."""
    theta = [
        p.scale.theta(np.asarray(p.get(model.setup)), fit.parameters[p.name].value)
        for p in model.parameters
    ]
    seen = np.asarray(model.evaluate(np.array(theta)).seen.positions)
    apart = np.linalg.norm(seen - np.asarray(model.targets.positions), axis=-1)
    return float(np.sqrt(np.mean(np.delete(apart, rows, axis=0) ** 2)))


def measured_case(postures: Postures, fit, count: int) -> None:
    """The choice among what was measured, against all others."""
    scene = tentacle_robot()
    told, model = (
        make(scene, postures, fit, method=GRID) for make in (information, prepared_model)
    )
    names = [p.name for p in model.parameters]
    choices = np.array(list(itertools.combinations(range(postures.rows), count)))
    widths, errors = [], []
    for rows in choices:
        found = calibrate_postures(scene, postures.take(rows), fit=fit, method=GRID)
        # The noise that a handful of rows tells differs: widths are compared at 1 mm of all.
        widths.append(standard_errors(found.information * found.noise_scale**2))
        errors.append(unseen_error(model, found, rows))
    widths, errors = np.array(widths), np.array(errors)
    print(f"{count} of {postures.rows} measured, {len(names)} numbers, {len(choices)} choices")
    for criterion in ("D", "A"):
        at = expected(told, choices, criterion)
        chosen = design_postures(
            scene, postures, fit=fit, count=count, criterion=criterion, method=GRID
        )
        rows = np.sort(chosen.rows)
        k = int(np.flatnonzero((choices == rows).all(1))[0])
        print(
            f"  {criterion}: {(rows + 1).tolist()}, expected: better than {worse(at, at[k]):.0f} %"
        )
        for name in FIT:
            own = 196 * widths[:, names.index(name)]
            print(
                f"    {name}: {own[k]:.2f} % half width at 1 mm of noise, median "
                f"{np.median(own):.2f}, better than {worse(own, own[k]):.0f} %"
            )
        print(
            f"    the {postures.rows - count} others: {1e3 * errors[k]:.2f} mm rms, median "
            f"{1e3 * np.median(errors):.2f}, better than {worse(errors, errors[k]):.0f} %; "
            f"correlation with the criterion {np.corrcoef(at, errors)[0, 1]:.2f}"
        )


def imagined_case(candidates: Postures, count: int) -> None:
    """The choice among candidates that nobody has measured, against all others."""
    told = information(tentacle_robot(), candidates, FIT, method=GRID)
    choices = np.array(list(itertools.combinations(range(candidates.rows), count)))
    print(f"{count} of {candidates.rows}, {len(choices)} choices; {sum(~told.solved)} unsolved")
    parts = np.array_split(choices, 20)
    errors = np.concatenate([standard_errors(told.start + told.each[c].sum(1)) for c in parts])
    for criterion in ("D", "A"):
        chosen = design_postures(
            tentacle_robot(), candidates, fit=FIT, count=count, criterion=criterion, method=GRID
        )
        rows = np.sort(chosen.rows)
        at = np.concatenate([expected(told, c, criterion) for c in parts])
        k = int(np.flatnonzero((choices == rows).all(1))[0])
        print(
            f"  {criterion}: rows {(rows + 1).tolist()}: better than {worse(at, at[k]):.3f} % "
            f"of all; the best of all: {(choices[np.argmin(at)] + 1).tolist()}"
        )
        for j, name in enumerate(FIT):
            own, usual = errors[k, j], np.median(errors[:, j])
            print(
                f"    {name}: {usual / own:.2f} times narrower than the median, "
                f"better than {worse(errors[:, j], own):.1f} %"
            )


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("folder", metavar="tentacle=FOLDER")
    folder = Path(parser.parse_args().folder.partition("=")[2])
    print(machine())
    for fit in (FIT, (*FIT, *FRAME)):
        measured_case(recorded(folder), fit, 3)
    imagined_case(with_both_pulled(recorded(folder)), 8)
