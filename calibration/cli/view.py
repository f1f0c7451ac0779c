"""A page in the browser on which the rod moves in real time, with sliders for what drives it.

Tensions, pressures, pulls and gravity; the button "Save log" writes what was done as a log, which
`softrod plot`, `simulate --log` and `calibrate` read. Ctrl-C ends it.
"""

from calibration.cli.common import UsageError, check_writable, positive, prepare_jax

_MOST = {"tension": "N", "pressure": "Pa", "pull": "m"}


def add_arguments(parser) -> None:
    parser.add_argument("scene", metavar="SCENE.toml", help="the scene file")
    parser.add_argument(
        "--log", default="view.csv", metavar="FILE.csv", help="where it is saved (view.csv)"
    )
    parser.add_argument("--port", type=int, default=8080, metavar="N", help="of the page (8080)")
    parser.add_argument(
        "--host", default="127.0.0.1", help="where it listens (127.0.0.1: this machine alone)"
    )
    parser.add_argument(
        "--dt", type=positive, default=1 / 60, metavar="S", help="time step [s] (1/60)"
    )
    for name, unit in _MOST.items():
        parser.add_argument(
            f"--most-{name}", type=positive, metavar="X", help=f"how far its sliders go [{unit}]"
        )


def run(args) -> int:
    check_writable(args.log, "--log")
    prepare_jax()
    import softrod_jax as sr

    scene = sr.load_scene(args.scene)
    given = {f"{name}s": getattr(args, f"most_{name}") for name in _MOST}
    most = {name: value for name, value in given.items() if value is not None}
    try:
        sr.view(scene, dt=args.dt, most=most, log=args.log, host=args.host, port=args.port)
    except ImportError as e:
        raise UsageError(str(e)) from None
    return 0
