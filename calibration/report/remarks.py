"""What a reader of a fit should know before believing it, in sentences."""

import numpy as np

from calibration.experiment.bulk import bulk
from calibration.inference.explain import TELLING
from calibration.parameters.materials import MATERIALS, SOFT
from calibration.parameters.scales import LARGEST_FACTOR
from calibration.report.granted import scale_of_forces
from calibration.report.results import Fit
from calibration.report.spectra import amplitudes

_AIR_DENSITY = 1.2  # kg/m^3
_BLUFF = 2.0  # drag coefficient of a flat plate or a square bar across the stream
_STRONG_CORRELATION = 0.95
# A shift by finer simulation is not small above this part of the interval's half width,
_SMALL_SHIFT = 0.25
# .. a prediction is worse than the fit above this ratio of their residuals,
_WORSE = 1.5
# .. and starts ended in the same place if their residuals agree to this part.
_SAME_END = 0.01
# Residuals at a frequency are the simulation's own if they are so much larger than the motion.
_OF_ITS_OWN = 5.0


def remarks(fit: Fit) -> list[str]:
    """Sentences, the most serious first; plain text."""
    return [
        *_not_converged(fit),
        *_not_identifiable(fit),
        *_contradicted(fit),
        *_starts(fit),
        *_numerics(fit),
        *_implausible(fit),
        *_held_out(fit),
        *_correlated(fit),
        *_systematic(fit),
        *_ringing(fit),
        *_explained(fit),
        *_outliers(fit),
        *_granted(fit),
        *_frames(fit),
        *_drifts(fit),
        *(fit.posterior.remarks if fit.posterior is not None else ()),
        *_beside_the_scene(fit),
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
            "fix it at one that is known, or record a motion that depends on it. The fitted scene "
            "keeps the value it had, or the end of this range nearest to it."
        )
        start, end = (float(np.max(np.abs(v))) for v in (estimate.initial, estimate.value))
        ratio = end / start if start else 1.0
        if ratio > 0.99 * LARGEST_FACTOR or ratio < 1.01 / LARGEST_FACTOR:
            yield f"{name} ran to the end of the range that is searched."


def _contradicted(fit):
    for name, apart in fit.conflicts.items():
        yield (
            f"The prior of {name} is contradicted: it and the recordings are {apart:.1f} standard "
            "deviations apart. One of them is wrong, or the model is; the value lies between them "
            "and is neither."
        )


def _granted(fit):
    said = scale_of_forces(fit)
    if said:
        yield said


def _starts(fit):
    if len(fit.starts) > 1:
        best = fit.starts[0].rms
        same = sum(s.rms <= (1 + _SAME_END) * best for s in fit.starts)
        yield f"{same} of {len(fit.starts)} starts ended in the same place as the best of them." + (
            "" if same > 1 else " The others did not find it: start from more places."
        )


def _numerics(fit):
    if fit.resolution_note:
        yield fit.resolution_note
        return
    for name, e in fit.parameters.items():
        for shift, what, remedy in (
            (e.step_shift, "half the time step", "a smaller dt"),
            (e.grid_shift, "twice the grid along the rod", "a finer method"),
        ):
            if shift is not None and abs(shift) > _SMALL_SHIFT:
                yield (
                    f"With {what}, {name} would move by {shift:+.0%} of the half width of its "
                    f"interval, which is not small: fit again with {remedy}."
                )


def _implausible(fit):
    material = SOFT if fit.material is None else MATERIALS[fit.material]
    whose = "soft materials" if fit.material is None else fit.material
    for label, estimate in fit.parameters.items():
        if not hasattr(material, estimate.name):
            continue
        low, high = getattr(material, estimate.name)
        value = float(np.ravel(estimate.value)[0])
        if not low <= value <= high:
            yield (
                f"{label} = {_show(value, estimate.unit)} is outside the range of {whose}, "
                f"{low:.3g} to {_show(high, estimate.unit)} ({material.source}): check units, "
                "section, length and what the tip carries."
            )
    if "drag_coefficient" in fit.parameters:
        width = 2 * np.sqrt(float(bulk(fit.scene).area) / np.pi)
        air = 0.5 * _AIR_DENSITY * _BLUFF * width
        low = fit.parameters["drag_coefficient"].ci95[0]
        if low is not None and np.min(low) > 10 * air:
            yield (
                f"drag_coefficient is larger than air can cause on a body {1e3 * width:.3g} mm "
                f"wide (about {air:.2g} kg/m^2): unless the rod moves in a liquid, it stands for "
                "some other loss that grows with amplitude: friction, a damping of the material "
                "that is not viscous or, after a release by hand, fingers that followed the rod "
                "(fit release_duration)."
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


def _held_out(fit):
    if not fit.held_out:
        return
    fitted = max(r.rmse for r in fit.recordings)
    own = sorted({e.name for e in fit.parameters.values() if e.recording})
    if own:
        yield (
            "Recordings that were kept aside are predicted with the mean of what each fitted one "
            f"has for itself of {', '.join(own)}."
        )
    for r in fit.held_out:
        if r.rmse_own_frame is not None and r.rmse_own_frame < r.rmse / _WORSE:
            yield (
                f"{r.name}, which was kept aside, is predicted to {1e3 * r.rmse:.3g} mm rms in the "
                f"frame of the fitted recordings, to {1e3 * r.rmse_own_frame:.3g} in one fitted to "
                "it: if the camera stood elsewhere, the second is meant; if not, the first."
            )
        elif r.rmse_own_frame is not None and r.frame_fitted:
            yield (
                f"{r.name}, which was kept aside, is predicted in a frame that was fitted to it, "
                "as none of the fitted recordings has one to take: kinder than a prediction."
            )
        if r.rmse > _WORSE * fitted:
            yield (
                f"{r.name}, which was kept aside, is predicted to {1e3 * r.rmse:.3g} mm rms, and "
                f"the recordings of the fit to {1e3 * fitted:.3g} mm or better: what was fitted "
                "does not hold for it."
            )


def _systematic(fit):
    if fit.effective_samples < 0.5 * fit.samples:
        yield (
            f"Residuals are correlated in time: {fit.samples} coordinates are worth "
            f"{fit.effective_samples:.0f} independent ones. Intervals are widened accordingly. "
            "Usually the model leaves something out; see the residuals."
            + (" `explain` looks for what it may be." if fit.explanations is None else "")
        )


def _ringing(fit):
    for r in fit.recordings:
        f, left = amplitudes(r.times, r.simulated - r.measured)
        _, motion = amplitudes(r.times, r.measured)
        for axis, letter in enumerate("xyz"):
            k = int(np.argmax(left[:, axis]))
            if left[k, axis] > _OF_ITS_OWN * motion[k, axis] > 0:
                yield (
                    f"{r.name}: along {letter} the simulation rings at {f[k]:.3g} Hz, "
                    f"{1e3 * left[k, axis]:.2g} mm large, and the robot does not. A damping is "
                    "missing; waves along the rod are damped by shear_damping."
                )


def _explained(fit):
    if fit.explanations is None:
        return
    left = np.sqrt(np.mean([r.rmse**2 for r in fit.recordings]))
    least = min((e.rms for e in fit.explanations), default=left)
    if least >= (1 - TELLING) * left:
        tried = ", ".join(e.name for e in fit.explanations) or "nothing"
        yield (
            f"There is no candidate for what is left: of all that was tried ({tried}) none would "
            f"leave less than {1e3 * least:.3g} of {1e3 * left:.3g} mm rms. It is noise, or "
            "something that no parameter of this model stands for."
        )
    for e in fit.explanations:
        if e.rms < (1 - TELLING) * left:
            reading = f" {e.reading[0].upper()}{e.reading[1:]}." if e.reading else ""
            values = ", ".join(f"{k} = {_show(v, e.units[k])}" for k, v in e.values.items())
            yield (
                f"If {e.name} were fitted, too, about {1e3 * e.rms:.3g} mm rms would be left of "
                f"{1e3 * left:.3g} ({values}): it, or something that looks like it, is "
                f"missing.{reading}"
            )


def _outliers(fit):
    for r in fit.recordings:
        count = int(np.sum(np.any(np.isfinite(r.measured) & (r.weights < 0.5), axis=1)))
        if count:
            yield f"{r.name}: {count} of {len(r.times)} samples were taken for outliers."


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


def _drifts(fit):
    for r in fit.recordings:
        said = []
        for name, drift in r.drift.items():
            most = drift.values[np.argmax(np.linalg.norm(drift.values, axis=1))]
            if name == "clock":
                verb = "gained" if most[0] > 0 else "lost"
                said.append(f"its clock {verb} {1e3 * abs(most[0]):.3g} ms against the inputs'")
            elif name == "tip":
                x, y, z = 1e3 * most
                said.append(f"the tip was seen up to ({x:.2f}, {y:.2f}, {z:.2f}) mm aside")
            else:
                said.append(f"what arrives of the inputs changed by up to {most[0]:+.1%}")
        if said:
            yield f"{r.name} drifted: {'; '.join(said)}. Look for the cause."


def _beside_the_scene(fit):
    beside = ("tendon_efficiency", "sensor_offset", "release_duration", "camera_")
    beside += ("pressure_lag", "tension_lag", "pull_lag", "pressure_gain")
    names = [k for k, e in fit.parameters.items() if e.name.startswith(beside) or e.recording]
    if names:
        yield (
            f"{', '.join(names)}: not part of the fitted scene file, which holds what belongs to "
            "the robot and to all recordings."
        )


def _show(value, unit: str) -> str:
    text = ", ".join(f"{v:.4g}" for v in np.ravel(value))
    return text if unit == "1" else f"{text} {unit}"
