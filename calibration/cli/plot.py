"""Draw a log, a rod at rest, or a rod that moves under the inputs of a log.

  softrod plot LOG.csv              the tip and the inputs against time, the path of the tip
  softrod plot SCENE.toml           the equilibrium under --tension, --pressure and --pull, in 3D;
                                    with --modes N, the N slowest small motions about it
  softrod plot SCENE.toml LOG.csv   simulates the inputs of the log, and draws the rod in 3D beside
                                    the simulated tip and the log's; with --out FILE.gif or
                                    FILE.html, a film

Pictures are .png, .pdf or .svg. A film in HTML is one file and needs no network. Exit status 1 if
the rod could not be solved; nothing is written then.
"""

import sys
from pathlib import Path

from calibration.cli.common import (
    UsageError,
    actuation,
    add_actuation,
    add_grid,
    add_mapping,
    check_writable,
    given_inputs,
    grid,
    intervals,
    note,
    positive,
    prepare_jax,
    reason,
)
from calibration.cli.simulate import simulated
from calibration.cli.solve import UNSTABLE
from calibration.cli.waiting import waiting

_PICTURES, _FILMS = (".png", ".pdf", ".svg"), (".gif", ".html")
# A log whose tip starts further from the straight rod's, in lengths of the rod, deserves a note.
_FAR = 0.05


def add_arguments(parser) -> None:
    parser.add_argument(
        "files", nargs="+", metavar="FILE", help="SCENE.toml, LOG.csv, or one of each"
    )
    add_mapping(parser)
    parser.add_argument(
        "--out",
        metavar="FILE",
        help="the picture (.png, .pdf, .svg) or film (.gif, .html); the default is a .png here, "
        "named after the log or the scene",
    )
    add_actuation(parser)
    add_grid(
        parser,
        "refine the grid, and divide the steps of a motion, until the tip's estimated error is "
        "below X lengths of the rod",
    )
    parser.add_argument(
        "--modes",
        type=intervals,
        metavar="N",
        help="of an equilibrium: the shapes of its N slowest modes, as softrod modes lists them",
    )
    motion = parser.add_argument_group("motions: a scene and a log")
    motion.add_argument(
        "--dt", type=positive, metavar="S", help="time step [s] (default: the log's median one)"
    )
    motion.add_argument(
        "--from-static",
        action="store_true",
        help="start from the equilibrium under the first inputs, not from the straight rod",
    )
    motion.add_argument("--speed", type=positive, metavar="X", help="of a film: 1 is real time (1)")
    motion.add_argument(
        "--fps", type=positive, metavar="N", help="frames a second of a film, up to 50 (25)"
    )


def run(args) -> int:
    scene_path, log_path = _files(args.files)
    out = args.out if args.out is not None else f"{Path(log_path or scene_path or '').stem}.png"
    kind = Path(out).suffix.lower()
    _check_options(args, scene_path, log_path, out, kind)
    check_writable(out)
    try:
        import matplotlib  # noqa: F401
    except ImportError as e:
        raise UsageError(f"{e}: pip install 'softrod_jax[plots]'") from None
    if scene_path is None:
        assert log_path is not None, "one file at least"
        from calibration.data.loading import load_recording
        from calibration.report.log_plot import log_figure

        _save(log_figure(load_recording(log_path, mapping=args.mapping)), out)
        return _written(out)
    prepare_jax()
    import softrod_jax as sr

    if log_path is None:
        return _draw_equilibrium(args, sr.load_scene(scene_path), out)
    return _draw_motion(args, scene_path, log_path, out, kind)


def _files(files) -> tuple[str | None, str | None]:
    """The scene and the log among the arguments."""
    scenes = [f for f in files if Path(f).suffix.lower() == ".toml"]
    logs = [f for f in files if f not in scenes]
    for what, found in (("scene", scenes), ("log", logs)):
        if len(found) > 1:
            raise UsageError(
                f"{' '.join(found)}: {len(found)} {what}s; give one SCENE.toml, one LOG.csv, or "
                "one of each"
            )
    return scenes[0] if scenes else None, logs[0] if logs else None


def _check_options(args, scene_path, log_path, out, kind) -> None:
    if kind not in _PICTURES + _FILMS:
        raise UsageError(
            f"--out {out}: the name ends in {kind!r}; expected {', '.join(_PICTURES)} for a "
            f"picture, {' or '.join(_FILMS)} for a film"
        )
    moves = scene_path is not None and log_path is not None
    if kind in _FILMS and not moves:
        raise UsageError(
            f"--out {out}: a film needs the scene and a log: softrod plot SCENE.toml LOG.csv; or "
            f"draw a picture, {Path(out).stem}.png"
        )
    inputs = dict.fromkeys(given_inputs(args), True)
    steps = {
        "--dt": args.dt,
        "--from-static": args.from_static or None,
    }
    rests, modes = scene_path is not None and log_path is None, {"--modes": args.modes}
    rods = {"--intervals": args.intervals, "--tolerance": args.tolerance}
    film = {"--speed": args.speed, "--fps": args.fps}
    mapping = {"--mapping": args.mapping}
    for allowed, options, remedy in (
        (log_path is not None, mapping, "for a log only"),
        (log_path is None, inputs, "the log gives the inputs, or is drawn as it is"),
        (rests, modes, "for a scene without a log only"),
        (moves, steps, "for a scene and a log only"),
        (scene_path is not None, rods, "for a scene only"),
        (kind in _FILMS, film, "for films only, --out FILE.gif or FILE.html"),
    ):
        given = [name for name, value in options.items() if value is not None]
        if given and not allowed:
            raise UsageError(f"{', '.join(given)}: {remedy}: leave it out")
    if args.fps is not None and args.fps > 50:
        raise UsageError(f"--fps {args.fps:g}: more than 50 frames a second; give less")


def _draw_equilibrium(args, scene, out) -> int:
    import softrod_jax as sr
    from softrod_jax.pictures import modes_picture, picture

    inputs = actuation(args, scene)
    with waiting("solving"):
        solution = sr.solve_static(scene, *inputs, throw=False, **grid(args))
        solved = int(solution.result) == 0
    if not solved:
        return _failed(reason(solution.result))
    if not bool(solution.stats["stable"]):
        note(UNSTABLE)
    if args.modes is not None:
        found = sr.modes(scene, *inputs, count=args.modes, method=solution.method)
        _save(modes_picture(scene, found), out)
        return _written(out)
    _save(picture(scene, solution, _shown(inputs, solution.tensions), inputs.pressures), out)
    return _written(out)


def _draw_motion(args, scene_path, log_path, out, kind) -> int:
    from calibration.report.log_plot import log_figure
    from softrod_jax.pictures import animate

    found = moved_by_log(args, scene_path, log_path)
    if found is None:
        return 1
    scene, log, motion = found
    trajectory = motion.trajectory
    if kind in _FILMS:
        tensions = _shown(motion.inputs, trajectory.tensions)
        with waiting("drawing"):
            animate(
                scene,
                trajectory,
                out,
                None if tensions is None else tensions[1:],
                None if motion.inputs.pressures is None else motion.inputs.pressures[1:],
                speed=args.speed or 1.0,
                fps=args.fps or 25.0,
                measured_tip=log.tip_positions,
                contacts=motion.moves["contacts"],
            )
    else:
        _save(log_figure(log, scene, trajectory), out)
    return _written(out)


def moved_by_log(args, scene_path, log_path):
    """The scene, the log, and what `simulated` makes of its inputs; None if that failed, which is
    then said."""
    import numpy as np

    import softrod_jax as sr
    from calibration.data.loading import load_recording

    scene = sr.load_scene(scene_path)
    log = load_recording(log_path, scene, mapping=args.mapping, need_tip=False)
    if len(log.times) < 2:
        raise UsageError(f"{log_path}: one row is no motion; to draw a rod at rest, leave it out")
    if args.dt is None:
        args.dt = float(np.median(np.diff(log.times)))
    args.log, args.duration, args.alpha = log_path, None, None
    motion = simulated(args, scene)
    trajectory = motion.trajectory
    if trajectory is None or int(trajectory.result) != 0:
        step = 0 if trajectory is None else int(trajectory.failed_step)
        _failed(f"step {step}, from {step * args.dt:g} s: {motion.reason}")
        return None
    _compare(args, log, trajectory, float(scene.length))
    return motion.scene, log, motion


def _shown(inputs, tensions):
    """The tensions of all tendons, where anything drives them."""
    return None if inputs.tensions is None and inputs.pulls is None else tensions


def _compare(args, log, trajectory, length) -> None:
    """How far the simulated tip is from the log's, where that has one."""
    import numpy as np

    known = log.has_tip
    if not np.any(known):
        return
    clock, tip = log.times[known] - log.times[0], log.tip_positions[known]
    ts, path = np.asarray(trajectory.ts), np.asarray(trajectory.tip_positions)
    there = np.stack([np.interp(clock, ts, column) for column in path.T], axis=1)
    # Coordinates that were not measured say nothing.
    distance = np.linalg.norm(np.nan_to_num(there - tip), axis=1)
    if distance[0] > _FAR * length and not args.from_static:
        note(
            f"the log's tip starts {1e3 * distance[0]:.3g} mm from where the rod does: if that was "
            "in equilibrium, give --from-static"
        )
    rms = np.sqrt(np.mean(distance**2))
    print(f"the simulated tip is {1e3 * rms:.3g} mm rms from the log's")


def _save(figure, out) -> None:
    figure.savefig(out, dpi=130)


def _written(out) -> int:
    print(f"written to {out}")
    return 0


def _failed(reason: str) -> int:
    print(f"softrod: failed: {reason}", file=sys.stderr)
    return 1
