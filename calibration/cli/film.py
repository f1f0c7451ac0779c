"""Film a rod that moves: a page to turn and play, or a GIF or MP4.

  softrod film RESULTS               the fitted rod over the measured tip, of a fit's directory
  softrod film SCENE.toml LOG.csv    the motion under the inputs of a log, beside its tip

The page (.html) holds all that it needs and opens without a network: drag to turn, wheel to zoom.
An .mp4 needs ffmpeg.
"""

from pathlib import Path

from calibration.cli.common import (
    UsageError,
    add_grid,
    add_mapping,
    check_writable,
    positive,
    prepare_jax,
)
from calibration.cli.waiting import waiting

_KINDS = (".html", ".gif", ".mp4")


def add_arguments(parser) -> None:
    parser.add_argument(
        "files", nargs="+", metavar="FILE", help="RESULTS, a directory; or SCENE.toml and LOG"
    )
    parser.add_argument(
        "--out", metavar="FILE", help="the film (.html, .gif, .mp4); the default is a page"
    )
    parser.add_argument("--recording", metavar="NAME", help="of several in RESULTS (the first)")
    parser.add_argument("--speed", type=positive, metavar="X", help="of a .gif or .mp4 (1)")
    parser.add_argument("--fps", type=positive, metavar="N", help="of a .gif or .mp4 (25)")
    motion = parser.add_argument_group("a scene and a log")
    add_mapping(motion)
    motion.add_argument("--dt", type=positive, metavar="S", help="time step [s]")
    motion.add_argument(
        "--from-static", action="store_true", help="start from the equilibrium, not straight"
    )
    add_grid(motion, "divide the steps, and refine the grid, until the tip's error is below X")


def run(args) -> int:
    results = [f for f in args.files if Path(f).is_dir()]
    if results and len(args.files) > 1:
        raise UsageError(f"{' '.join(args.files)}: give RESULTS, or SCENE.toml and LOG")
    if args.out is not None:
        kind = Path(args.out).suffix.lower()
        if kind not in _KINDS:
            raise UsageError(f"--out {args.out}: the name ends in {kind!r}; expected one of "
                             f"{', '.join(_KINDS)}")  # fmt: skip
        check_writable(args.out)
        given = [f"--{n}" for n in ("speed", "fps") if getattr(args, n) is not None]
        if kind == ".html" and given:
            raise UsageError(f"{', '.join(given)}: of a .gif or .mp4 only; leave it out")
    try:
        import matplotlib  # noqa: F401
    except ImportError as e:
        raise UsageError(f"{e}: pip install 'softrod_jax[plots]'") from None
    prepare_jax()
    return _of_fit(args, results[0]) if results else _of_log(args)


def _of_fit(args, directory: str) -> int:
    from calibration.report.films import film_name, read_motions, write_film

    names = ("mapping", "dt", "from_static", "intervals", "tolerance")
    given = [f"--{name.replace('_', '-')}" for name in names if getattr(args, name)]
    if given:
        raise UsageError(f"{', '.join(given)}: for a scene and a log only; leave it out")
    scene, motions = read_motions(directory)
    names = [moved.name for moved in motions]
    if args.recording is not None and args.recording not in names:
        raise UsageError(f"--recording {args.recording}: there are {', '.join(names)}")
    k = 0 if args.recording is None else names.index(args.recording)
    if len(motions) > 1 and args.recording is None:
        print(f"{names[0]}, of {', '.join(names)}: --recording chooses another")
    out = Path(args.out) if args.out else Path(directory) / film_name(motions, k)
    moved = motions[k]
    if out.suffix.lower() == ".html":
        write_film(scene, moved, out)
    else:
        inputs = {name: values[1:] for name, values in moved.motion.inputs.items()}
        moves = moved.moves["contacts"]
        _animate(args, scene, moved.motion, out, inputs, moved.motion.seen, moves)
    print(f"written to {out}")
    return 0


def _animate(args, scene, motion, out, inputs: dict, measured, moves) -> None:
    """`inputs`: by kind, a row for each step; `moves`: of obstacles, by name."""
    import numpy as np

    from softrod_jax.pictures import animate

    tensions = inputs.get("tensions")
    if tensions is not None and tensions.shape[1] != scene.tendons.count:
        tensions = None  # those of tendons that are driven by length are not there
    with waiting("drawing"):
        animate(
            scene,
            motion,
            out,
            None if tensions is None else np.asarray(tensions),
            inputs.get("pressures"),
            speed=args.speed or 1.0,
            fps=args.fps or 25.0,
            measured_tip=measured,
            contacts=moves,
        )


def _of_log(args) -> int:
    from calibration.cli.plot import moved_by_log
    from softrod_jax.pictures import film

    scenes = [f for f in args.files if f.lower().endswith(".toml")]
    logs = [f for f in args.files if f not in scenes]
    if len(scenes) != 1 or len(logs) != 1:
        raise UsageError(
            f"{' '.join(args.files)}: give RESULTS, a directory, or SCENE.toml and LOG"
        )
    if args.recording is not None:
        raise UsageError("--recording: of RESULTS only; leave it out")
    out = Path(args.out) if args.out else Path(f"{Path(logs[0]).stem}.html")
    check_writable(str(out))
    found = moved_by_log(args, scenes[0], logs[0])
    if found is None:
        return 1
    scene, log, motion = found
    if out.suffix.lower() == ".html":
        seen = {"log's tip": (log.times - log.times[0], log.tip_positions)}
        film(
            scene,
            motion.trajectory,
            out,
            motion.inputs,
            measured=seen if log.has_tip.any() else None,
            title=log.name,
            contacts=motion.moves["contacts"],
        )
    else:
        given = motion.inputs._asdict()
        inputs = {name: values[1:] for name, values in given.items() if values is not None}
        moves = motion.moves["contacts"]
        _animate(args, scene, motion.trajectory, out, inputs, log.tip_positions, moves)
    print(f"written to {out}")
    return 0
