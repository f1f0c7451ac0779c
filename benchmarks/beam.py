"""Laws of damping on a real beam: Kelvin-Voigt, and branches that relax, on motion capture.

    python benchmarks/beam.py FOLDER

FOLDER has beam_gravity_V2_a.c3d and beam_load52_V2_a.c3d of
https://github.com/srl-ethz/diffPD_sim2real: a silicone beam that is let go by hand, bare and with
52 g at its tip. Each law is fitted to both recordings together, and to each of them, from which the
other one is then predicted, but for how long the hand took to let go, which is fitted to it. AIC
and BIC count the samples that the residuals of the richest law are worth, as they are correlated in
time; the lower, the better.

Then, with the branch that both recordings tell, the modulus is fitted to one of them alone and the
other one predicted; five branches from 4 ms to 1 s have their parts fitted, among which any law of
a fractional order is; and it is said how the markers at the base moved.
"""

import sys
from dataclasses import replace
from pathlib import Path

import jax
import numpy as np

jax.config.update("jax_enable_x64", True)

import softrod_jax as sr  # noqa: E402
from calibration import calibrate, load_recording  # noqa: E402
from calibration.experiment.setup import Setup  # noqa: E402
from calibration.parameters.catalogue import parameters_of  # noqa: E402
from softrod_jax.scene.scene import as_arrays  # noqa: E402

VISCOUS = ("young_modulus", "bending_damping")
RELEASE = "release_duration"
BRANCHES = {1: [[0.1, 0.1]], 2: [[0.1, 0.02], [0.1, 0.3]]}
BY_NAME = ("relaxation_part", "relaxation_time")
# Name: branches, and what is fitted.
LAWS = {
    "Kelvin-Voigt": (0, VISCOUS),
    "one branch and viscous": (1, (*VISCOUS, *BY_NAME)),
    "one branch": (1, ("young_modulus", *BY_NAME)),
    "two branches": (2, ("young_modulus", *BY_NAME)),
}


def scene(branches: int, names) -> sr.Scene:
    """The beam before any fit."""
    return as_arrays(
        sr.Scene(
            length=0.1,
            section=sr.Rectangle(0.03, 0.03),
            young_modulus=3e5,
            poisson_ratio=0.49,
            density=1070.0,
            bending_damping=5e-5 if "bending_damping" in names else None,
            relaxation=BRANCHES.get(branches),
            gravity=[-9.81, 0.0, 0.0],
        )
    )


def recorded(folder: Path):
    """Both recordings, each with the weight at its tip."""
    for name, mass in (("gravity", 0.0), ("load52", 0.052)):
        recording = load_recording(folder / f"beam_{name}_V2_a.c3d", scene(0, VISCOUS))
        yield replace(recording, name=name, conditions={"payload_mass": mass})


def at(fit, start: sr.Scene) -> sr.Scene:
    """The scene with all that was fitted of the material, identified or not."""
    setup, values = Setup(start), fit.parameters
    own = [name for name, e in values.items() if e.name != RELEASE]
    for parameter, name in zip(parameters_of(start, own), own, strict=True):
        setup = parameter.put(setup, values[name].value)
    return setup.scene


def with_the_branch_of_both(branch, recordings, options) -> None:
    """What one recording tells of the other where the branch is known."""
    known = as_arrays(replace(scene(1, ()), young_modulus=3.6e5, relaxation=[branch]))
    for i, other in ((0, 1), (1, 0)):
        own = calibrate(known, [recordings[i]], fit=("young_modulus", RELEASE), **options)
        unseen = calibrate(at(own, known), [recordings[other]], fit=(RELEASE,), **options)
        (rms,), (predicted,) = own.rmse_m.values(), unseen.rmse_m.values()
        print(f"modulus of {recordings[i].name} alone: {1e3 * rms:.3f} mm, ", end="")
        print(f"the other one predicted to {1e3 * predicted:.3f} mm", flush=True)


def spectrum(recordings, options) -> None:
    """The parts of many branches."""
    many = [[0.05, time] for time in (0.004, 0.016, 0.064, 0.256, 1.0)]
    start = as_arrays(replace(scene(1, ()), young_modulus=3.6e5, relaxation=many))
    fit = calibrate(start, recordings, fit=("young_modulus", BY_NAME[0], RELEASE), **options)
    print("five branches", {k: f"{1e3 * x:.3f} mm" for k, x in fit.rmse_m.items()})
    for (_, time), k in zip(many, range(len(many)), strict=True):
        e = fit.parameters[f"{BY_NAME[0]}_{k + 1}"]
        print(f"    {1e3 * time:g} ms: {e.value:.3g} {e.ci95}, {e.verdict}", flush=True)


def base_markers(folder: Path) -> None:
    """How the markers at the base move along the beam [mm], the upper one and the lower two, and by
    what that turns them [degrees]: the upper edge is pulled as the beam falls."""
    import ezc3d

    for name in ("gravity", "load52"):
        points = ezc3d.c3d(str(folder / f"beam_{name}_V2_a.c3d"))["data"]["points"]
        x, z = 1e3 * points[0, 3:], 1e3 * points[2, 3:]
        moved = z - np.nanmean(z[:, 5:35], axis=1)[:, None]
        upper, lower = moved[1], (moved[0] + moved[2]) / 2
        turn = np.degrees((upper - lower) / np.nanmean(x[1] - (x[0] + x[2]) / 2))
        step = np.abs(turn[4:] - turn[:-4])
        print(
            f"{name}: at the end {np.nanmean(upper[-50:]):.2f} and {np.nanmean(lower[-50:]):.2f} "
            f"mm, {np.nanmean(turn[-50:]):.2f} degrees, of them {np.max(step):.2f} within the four "
            f"samples before frame {int(np.argmax(step)) + 4}"
        )


def main(folder: Path, laws) -> None:
    recordings = list(recorded(folder))
    # As fine as a search for them finds: 0.1 mm.
    fine = dict(dt=5e-3, method=sr.Collocation(4))
    options = dict(per_recording=(RELEASE,), checks=False, progress=False, **fine)
    found = {}
    for law in laws:
        branches, names = LAWS[law]
        start, names = scene(branches, names), (*names, RELEASE)
        fit = calibrate(start, recordings, fit=names, **options)
        found[law] = fit
        print(law, {k: f"{1e3 * x:.3f} mm" for k, x in fit.rmse_m.items()}, flush=True)
        for name, e in fit.parameters.items():
            print(f"    {name} = {e.value:.4g} {e.unit} {e.ci95}, {e.verdict}", flush=True)
        for i, other in ((0, 1), (1, 0)):
            own = calibrate(start, [recordings[i]], fit=names, **options)
            unseen = calibrate(at(own, start), [recordings[other]], fit=(RELEASE,), **options)
            (rms,), (predicted,) = own.rmse_m.values(), unseen.rmse_m.values()
            print(f"    {recordings[i].name} alone: {1e3 * rms:.3f} mm, ", end="")
            print(f"the other one predicted to {1e3 * predicted:.3f} mm", flush=True)
    samples = max(fit.effective_samples for fit in found.values())
    for law, fit in found.items():
        parts = [np.isfinite(r.measured).all(-1).sum() * r.rmse**2 for r in fit.recordings]
        spread = samples * np.log(sum(parts) / fit.samples)
        k = len(fit.parameters)
        aic, bic = spread + 2 * k, spread + k * np.log(samples)
        print(f"{law}: {k} numbers, AIC {aic:.1f}, BIC {bic:.1f} ({samples:.0f} samples)")
    if "one branch" in found:
        of_both = found["one branch"].parameters
        branch = [of_both[name].value for name in of_both if name.startswith("relaxation")]
        with_the_branch_of_both(branch, recordings, options)
    spectrum(recordings, options)
    base_markers(folder)


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2:] or LAWS)
