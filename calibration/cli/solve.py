"""One static equilibrium: the pose of the tip under tensions and pressures.

Exit status 0 only if the solve converged; otherwise 1, with the reason and null for the tip.
"""

from calibration.cli.common import actuation, add_actuation, prepare_jax, print_json


def add_arguments(parser) -> None:
    parser.add_argument("scene", metavar="SCENE.toml", help="the scene file")
    add_actuation(parser)
    parser.add_argument("--json", action="store_true", help="JSON, which is what comes anyway")


def run(args) -> int:
    prepare_jax()
    import softrod_jax as sr

    scene = sr.load_scene(args.scene)
    tensions, pressures = actuation(args, scene)
    sol = sr.solve_static(scene, tensions, pressures, throw=False)
    succeeded = int(sol.result) == 0
    print_json(
        {
            "result": sr.result_message(sol.result),
            "tip_position": sol.tip_position.tolist() if succeeded else None,
            "tip_quaternion": sol.tip_quaternion.tolist() if succeeded else None,
            "residual": float(sol.stats["residual"]),
            "iterations": int(sol.stats["iterations"]),
        }
    )
    return 0 if succeeded else 1
