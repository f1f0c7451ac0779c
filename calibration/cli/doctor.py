"""Check the installation: versions, devices, float64 and one solve against a closed form.

Exit status 0 if the tip is right to 1e-8 m, otherwise 1.
"""

import math
import platform
from importlib.metadata import PackageNotFoundError, version

from calibration.cli.common import cache_directory, prepare_jax, print_json

_PACKAGES = ("softrod_jax", "jax", "jaxlib", "equinox", "diffrax", "optimistix", "optax", "numpy")
_TOLERANCE = 1e-8  # m
_TENSION = 0.1  # N: bends the paper's robot by 45 degrees


def add_arguments(parser) -> None:
    parser.add_argument("--json", action="store_true", help="JSON on stdout")


def run(args) -> int:
    prepare_jax()
    import jax

    error, message = _solve_error()
    healthy = error is not None and error < _TOLERANCE
    findings = {
        "python": platform.python_version(),
        **{name: _version(name) for name in _PACKAGES},
        "devices": [str(device) for device in jax.devices()],
        "float64": jax.config.values["jax_enable_x64"],
        "cache": jax.config.values["jax_compilation_cache_dir"]
        or f"none: cannot write {cache_directory()}",
        "solve": message,
        "solve_error_m": error,
        "healthy": healthy,
    }
    if args.json:
        print_json(findings)
    else:
        for name, value in findings.items():
            text = ", ".join(value) if isinstance(value, list) else value
            print(f"{name:14} {text}")
    return 0 if healthy else 1


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "not installed"


def _solve_error():
    """Distance [m] of the tip from the closed form of one pulled tendon, and the solver's word.

    A straight tendon r off the axis bends the rod to a circle: u = tau r / (E I) about the axis
    across it, and stretch v3 = 1 - tau / (E A).
    """
    import numpy as np

    import softrod_jax as sr

    scene = sr.hybrid_robot()
    sol = sr.solve_static(scene, tensions=(_TENSION, 0.0, 0.0), throw=False)
    message = sr.result_message(sol.result)
    if int(sol.result) != 0:
        return None, message
    tendons, section, E = scene.tendons, scene.section, scene.young_modulus
    assert tendons is not None and section is not None and E is not None, "it has all of them"
    E, L, offset = float(E), float(scene.length), float(tendons.offsets[0, 0])
    u = _TENSION * offset / (E * float(section.second_moments[1]))
    v3 = 1 - _TENSION / (E * float(section.area))
    tip = v3 / u * np.array([1 - math.cos(u * L), 0.0, math.sin(u * L)])
    return float(np.linalg.norm(np.asarray(sol.tip_position) - tip)), message
