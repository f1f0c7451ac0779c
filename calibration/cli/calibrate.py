"""Fit a scene's material to recordings; without arguments, on the bundled example.

Writes DIR/parameters.json, a report and plots. A recording is a .csv log or a .c3d motion
capture.
"""

from pathlib import Path

from calibration.cli.common import UsageError, note, number, prepare_jax

_EXAMPLE = Path(__file__).parents[1] / "examples"
_DEFAULT_OUT = "softrod-calibration"


def add_arguments(parser) -> None:
    parser.add_argument("scene", nargs="?", metavar="SCENE.toml", help="the scene file")
    parser.add_argument("logs", nargs="*", metavar="LOG", help="recordings, .csv or .c3d")
    parser.add_argument(
        "--fit",
        metavar="NAME,..",
        help="parameters to fit (default: those of young_modulus, bending_damping and "
        "drag_coefficient that the scene has)",
    )
    parser.add_argument(
        "--no-time-offset",
        action="store_true",
        help="trust the recordings' clocks: do not fit when inputs or release really began",
    )
    parser.add_argument(
        "--out",
        default=_DEFAULT_OUT,
        metavar="DIR",
        help=f"where the results go (default: {_DEFAULT_OUT})",
    )
    parser.add_argument(
        "--window",
        type=number,
        nargs=2,
        metavar=("START", "END"),
        help="use this part of each recording only [s, on its own clock]",
    )
    parser.add_argument("--json", action="store_true", help="parameters.json on stdout as well")
    c3d = parser.add_argument_group("C3D files")
    c3d.add_argument(
        "--tip-markers", metavar="LABEL,..", help="how the tip markers' labels begin (tip)"
    )
    c3d.add_argument(
        "--base-markers",
        metavar="LABEL,..",
        help="how the clamp markers' labels begin (base); none: do not use them",
    )
    c3d.add_argument(
        "--axes",
        metavar="AXES",
        help="which axes of the file are the scene's x, y, z (x,y,z); with a leading minus, "
        "write --axes=-y,x,z",
    )


def run(args) -> int:
    scene_path, log_paths = (args.scene, args.logs) if args.scene else _example()
    if not log_paths:
        raise UsageError("no recordings: give at least one LOG after the scene (.csv or .c3d)")
    out = Path(args.out)
    if out.exists() and not out.is_dir():
        raise UsageError(f"--out {out}: is a file; give a directory")
    prepare_jax()
    import softrod_jax as sr

    try:
        from calibration import calibrate
        from calibration.report import summary, write_report
    except ImportError as e:
        raise UsageError(f"{e}: pip install 'softrod_jax[calibration]'") from None

    scene = sr.load_scene(scene_path)
    recordings = _recordings(args, log_paths, scene)
    out.mkdir(parents=True, exist_ok=True)
    fit = calibrate(
        scene,
        recordings,
        fit=None if args.fit is None else tuple(x.strip() for x in args.fit.split(",")),
        time_offset=not args.no_time_offset,
        progress=True,
    )
    write_report(fit, out)
    if args.json:
        print((out / "parameters.json").read_text(encoding="utf-8"))
    else:
        print(f"\n{summary(fit)}\nparameters, report and plots are in {out}")
    return 0


def _recordings(args, paths, scene):
    from calibration import load_recording

    options = {
        name: value
        for name, value in (
            ("tip_markers", args.tip_markers),
            ("base_markers", args.base_markers),
            ("axes", args.axes),
        )
        if value is not None
    }
    if options.get("base_markers", "").lower() == "none":
        options["base_markers"] = None
    is_c3d = [Path(path).suffix.lower() == ".c3d" for path in paths]
    if options and not any(is_c3d):
        names = ", ".join(f"--{name.replace('_', '-')}" for name in options)
        raise UsageError(f"{names}: for .c3d files only, and there is none; leave it out")
    recordings = [
        load_recording(path, scene, **(options if c3d else {}))
        for path, c3d in zip(paths, is_c3d, strict=True)
    ]
    for recording in recordings:
        for assumption in recording.notes:
            note(f"{recording.name}: {assumption}")
    return recordings if args.window is None else [r.window(*args.window) for r in recordings]


def _example():
    """The bundled scene and its logs."""
    return _EXAMPLE / "robot.toml", sorted(_EXAMPLE.glob("*.csv"))
