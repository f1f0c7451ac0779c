"""One static equilibrium: the pose of the tip, and of markers, under its inputs.

Exit status 0 only if the solve converged; otherwise 1, with the reason and null for all poses.
"""

from calibration.cli.common import (
    actuation,
    add_actuation,
    add_grid,
    grid,
    note,
    note_self_contact,
    prepare_jax,
    print_json,
    reason,
)
from calibration.cli.waiting import waiting

UNSTABLE = (
    "this equilibrium is unstable: any disturbance takes the rod to another one; a small force or "
    "moment across it, in [tip_load], tells which"
)


def add_arguments(parser) -> None:
    parser.add_argument("scene", metavar="SCENE.toml", help="the scene file")
    add_actuation(parser)
    add_grid(
        parser, "refine the grid until the tip's estimated error is below X lengths of the rod"
    )
    parser.add_argument("--json", action="store_true", help="JSON, which is what comes anyway")


def run(args) -> int:
    prepare_jax()
    import softrod_jax as sr

    scene = sr.load_scene(args.scene)
    inputs = actuation(args, scene)
    with waiting("solving"):
        sol = sr.solve_static(scene, *inputs, throw=False, **grid(args))
        succeeded = int(sol.result) == 0
    names = ["tip", *(marker.name for marker in scene.markers or ())]
    stable = bool(sol.stats["stable"])
    print_json(
        {
            "result": reason(sol.result),
            "tip_position": sol.tip_position.tolist() if succeeded else None,
            "tip_quaternion": sol.tip_quaternion.tolist() if succeeded else None,
            "tensions": sol.tensions.tolist() if succeeded else None,
            "markers": {name: _pose(sol.markers[name], succeeded) for name in names},
            "contact_force": {
                name: x.tolist() if succeeded else None for name, x in sol.contact_force.items()
            },
            "stable": stable if succeeded else None,
            "error": float(sol.stats["error"]),
            "intervals": sol.method.intervals,
            "residual": float(sol.stats["residual"]),
            "iterations": int(sol.stats["iterations"]),
        }
    )
    if succeeded and not stable:
        note(UNSTABLE)
    if succeeded:
        note_self_contact(scene, sol)
    return 0 if succeeded else 1


def _pose(pose, known: bool) -> dict:
    values = {"position": pose.position, "quaternion": pose.quaternion}
    return {name: value.tolist() if known else None for name, value in values.items()}
