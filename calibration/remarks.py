"""What a reader of a fit should know before believing it, in sentences."""

import numpy as np

from calibration.fit import Fit
from calibration.parameters import LARGEST_FACTOR, PARAMETERS

# Ranges of soft robots' materials, wide: a value outside is a sign, not a verdict.
_PLAUSIBLE = {
    "young_modulus": (1e3, 1e8),
    "density": (100.0, 3000.0),
    "poisson_ratio": (0.2, 0.5),
}
_AIR_DENSITY = 1.2  # kg/m^3
_BLUFF = 2.0  # drag coefficient of a flat plate or a square bar across the stream
_STRONG_CORRELATION = 0.95


def remarks(fit: Fit) -> list[str]:
    """Sentences, the most serious first; plain text."""
    return [
        *_not_converged(fit),
        *_not_identifiable(fit),
        *_time_step(fit),
        *_implausible(fit),
        *_correlated(fit),
        *_systematic(fit),
        *_frames(fit),
    ]


def _not_converged(fit):
    if fit.result != "converged":
        yield (
            f"The optimisation did not converge ({fit.result}): values and intervals are "
            "provisional."
        )


def _not_identifiable(fit):
    for name, estimate in fit.parameters.items():
        if estimate.identifiable:
            continue
        low, high = (None if end is None else _show(end, estimate.unit) for end in estimate.ci95)
        if low is None and high is None:
            what = "they fit as well with any value of it"
        elif low is None:
            what = f"anything from 0 to {high} fits as well"
        elif high is None:
            what = f"anything above {low} fits as well"
        else:
            what = f"anything from {low} to {high} fits as well"
        yield (
            f"{name} is not identifiable from these recordings: {what}. Do not use its value; "
            "fix it at one that is known, or record a motion that depends on it."
        )
        ratio = np.ravel(estimate.value)[0] / np.ravel(estimate.initial)[0]
        if ratio > 0.99 * LARGEST_FACTOR or ratio < 1.01 / LARGEST_FACTOR:
            yield f"{name} ran to the end of the range that is searched."


def _time_step(fit):
    for name, estimate in fit.parameters.items():
        shift = estimate.step_shift
        if shift is None:
            continue
        low, high = (None if end is None else np.ravel(end)[0] for end in estimate.ci95)
        if low is None or high is None:
            continue
        value = np.ravel(estimate.value)[0]
        if abs(shift) * value > 0.5 * (high - low) / 2:
            yield (
                f"With a time step twice as long, {name} would move by {shift:+.1%}, which is not "
                "small against its interval: fit again with a smaller dt."
            )


def _implausible(fit):
    for name, (low, high) in _PLAUSIBLE.items():
        if name in fit.parameters:
            estimate = fit.parameters[name]
            value = float(np.ravel(estimate.value)[0])
            if not low <= value <= high:
                yield (
                    f"{name} = {_show(value, estimate.unit)} is outside the range of soft "
                    f"materials, {low:g} to {_show(high, estimate.unit)}: check units, section and "
                    "length."
                )
    if "drag_coefficient" in fit.parameters:
        width = 2 * np.sqrt(float(fit.scene.section.area) / np.pi)
        air = 0.5 * _AIR_DENSITY * _BLUFF * width
        low = fit.parameters["drag_coefficient"].ci95[0]
        if low is not None and np.min(low) > 10 * air:
            yield (
                f"drag_coefficient is larger than air can cause on a body {1e3 * width:.3g} mm "
                f"wide (about {air:.2g} kg/m^2): unless the rod moves in a liquid, it stands for "
                "some other loss that grows with amplitude, such as friction or a damping of the "
                "material that is not viscous."
            )


def _correlated(fit):
    names = list(fit.parameters)
    for i, a in enumerate(names):
        for j in range(i):
            r = fit.correlation[i, j]
            if abs(r) > _STRONG_CORRELATION:
                yield (
                    f"{names[j]} and {a} are strongly correlated ({r:+.2f}): the recordings tell "
                    "a combination of them better than each."
                )


def _systematic(fit):
    total = sum(int(np.sum(np.isfinite(r.measured))) for r in fit.recordings)
    if fit.effective_samples < 0.5 * total:
        yield (
            f"Residuals are correlated in time: {total} coordinates are worth "
            f"{fit.effective_samples:.0f} independent ones. Intervals are widened accordingly. "
            "Usually the model leaves something out; see the residuals."
        )


def _frames(fit):
    for r in fit.recordings:
        if r.tip_offset is not None:
            x, y, z = 1e3 * r.tip_offset
            a, b, c = np.degrees(r.frame_rotation)
            yield (
                f"{r.name} does not know where the clamp is: a constant offset of the tip, "
                f"({x:.2f}, {y:.2f}, {z:.2f}) mm, and a small rotation of the recording's frame, "
                f"({a:.1f}, {b:.1f}, {c:.1f}) degrees about x, y, z, were fitted along with the "
                "parameters."
            )


def _show(value, unit: str) -> str:
    text = ", ".join(f"{v:.4g}" for v in np.ravel(value))
    return text if unit == PARAMETERS["poisson_ratio"].unit else f"{text} {unit}"
