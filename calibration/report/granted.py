"""What a fit takes for granted: numbers that were not fitted, on which all others depend."""

import numpy as np


def taken_for_granted(fit) -> list[str]:
    """Each with its value where it is one number, in words. `fit`: a `Fit`."""
    scene = fit.scene
    fitted = {e.name for e in fit.parameters.values()}
    fitted |= {name for r in fit.recordings for name in r.recording.conditions}
    found = ["the section"]
    for name, unit in (("length", "m"), ("density", "kg/m^3")):
        if name not in fitted:
            found.insert(-1, f"{name} {float(getattr(scene, name)):.4g} {unit}")
    if scene.payload is not None and "payload_mass" not in fitted:
        found.append(f"payload {float(scene.payload.mass):.4g} kg")
    if scene.gravity is not None and not any(n.startswith("gravity_tilt") for n in fitted):
        found.append(f"gravity {float(np.linalg.norm(scene.gravity)):.4g} m/s^2 and its direction")
    places = ("tendon_offset", "tendon_position")
    driven = _given(fit, "tensions") or _given(fit, "pulls")
    if driven and not any(n.startswith(places) for n in fitted):
        found.append("the tendons' places")
    if _given(fit, "tensions"):
        if not any(n.startswith("tendon_efficiency") for n in fitted):
            found.append("the tensions")
    if _given(fit, "pressures"):
        if not any(n.startswith("chamber_area") for n in fitted):
            found.append("the chambers' areas")
        found.append("the pressures")
    if _given(fit, "pulls"):
        found.append("the pulls")
        if _stretch(scene) and "tendon_stiffness" not in fitted:
            found.append("the tendons' stiffness")
    if scene.tip_load is not None:
        found.append("the tip load")
    return found


def scale_of_forces(fit) -> str:
    """What an error of a number that is taken for granted does, in a sentence, or "".

    Forces have one common scale that no motion shows.
    """
    moved = ("young_modulus", "bending_damping", "shear_damping", "drag_coefficient")
    names = [k for k, e in fit.parameters.items() if e.name in moved]
    if not names or "density" in {e.name for e in fit.parameters.values()}:
        return ""
    scene, those = fit.scene, ", ".join(names)
    fitted = {e.name for e in fit.parameters.values()}
    others = [
        what
        for there, what in (
            (scene.payload is not None, "payload"),
            (_given(fit, "tensions"), "tensions"),
            (_given(fit, "pressures"), "pressures"),
            (
                _given(fit, "pulls") and _stretch(scene) and "tendon_stiffness" not in fitted,
                "the tendons' stiffness",
            ),
            (scene.tip_load is not None, "tip load"),
        )
        if there
    ]
    if not others:
        return (
            f"{those}: in proportion to the density, which was taken for granted. If it is 10 % "
            "too large, so are they, whatever their intervals say."
        )
    return (
        f"{those}: in proportion to density, {', '.join(others)} together, which were taken for "
        "granted. If all of these are 10 % too large, so are they, whatever their intervals say."
    )


def _stretch(scene) -> bool:
    """Whether any tendons that are driven by their length do."""
    return scene.tendons is not None and any(x is not None for x in scene.tendons.stiffness or ())


def _given(fit, inputs: str) -> bool:
    return any(getattr(r.recording, inputs) is not None for r in fit.recordings)
