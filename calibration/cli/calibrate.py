"""Fit a scene to recordings; without arguments, on the bundled example.

Writes DIR/parameters.json, a report, plots and the fitted scene. A recording is a .csv log or a
.c3d motion capture or, with a mapping file, any .csv, .mat, .h5, .parquet or .c3d. A mapping file
beside LOG whose name is LOG's with .map.toml in place of its ending is used for it.
"""

import argparse
import contextlib
import shlex
import sys
from dataclasses import replace
from pathlib import Path

from calibration.cli.common import (
    UsageError,
    add_mapping,
    bound_in,
    names_in,
    note,
    number,
    positive,
    prepare_jax,
    prior_in,
    priors_of,
)
from calibration.cli.exclusive import alone_in
from calibration.cli.waiting import waiting
from calibration.parameters.names import NAMES

_EXAMPLE = Path(__file__).parents[1] / "examples"
_DEFAULT_OUT = "softrod-calibration"
_CHECKPOINT = "checkpoint.json"
_RESUME = "interrupted; the same command with --resume goes on from here"
EPILOG = (
    "what can be fitted, of what the scene has, by name:\n"
    + "\n".join(f"  {name:24}{words}" for name, words in NAMES.items())
    + (
        "\nand any number of the scene by its path in the file, such as segments[1].young_modulus "
        "or tendons[*].friction"
    )
)


def _count(text: str) -> int:
    """A whole number from 1, for argparse."""
    value = number(text)
    if value < 1 or value != int(value):
        raise argparse.ArgumentTypeError(f"{text} is not a whole number from 1")
    return int(value)


def add_arguments(parser) -> None:
    _add_what(parser)
    _add_postures(parser.add_argument_group("postures instead of motions"))
    _add_search(parser.add_argument_group("search and checks"))
    _add_data(parser.add_argument_group("data"))
    _add_c3d(parser.add_argument_group("C3D files without a mapping"))


def _add_what(parser) -> None:
    """What is fitted to what, and where the results go."""
    parser.add_argument("scene", nargs="?", metavar="SCENE.toml", help="the scene file")
    parser.add_argument(
        "logs", nargs="*", metavar="LOG", help="recordings, or patterns such as 'run_*.csv'"
    )
    parser.add_argument(
        "--fit",
        metavar="NAME,..",
        help="parameters to fit, see below (default: those of young_modulus, bending_damping and "
        "drag_coefficient that the scene has)",
    )
    parser.add_argument(
        "--per-recording",
        metavar="NAME,..",
        help="those of them of which each recording has its own value",
    )
    parser.add_argument(
        "--bounds",
        metavar="NAME=LOW:HIGH",
        nargs="+",
        help="bounds of parameters, in their units",
    )
    parser.add_argument(
        "--no-time-offset",
        action="store_true",
        help="trust the recordings' clocks: do not fit when inputs or release really began",
    )
    parser.add_argument(
        "--held-out", metavar="LOG", nargs="+", help="recordings to predict and not to fit"
    )
    parser.add_argument(
        "--prior",
        metavar="NAME=MEAN:SPREAD",
        nargs="+",
        help="what is known beforehand, mean and standard deviation, such as density=1070:20",
    )
    parser.add_argument(
        "--priors-from",
        metavar="DIR",
        help="what another fit found, such as one to postures, of what is fitted here, as priors",
    )
    parser.add_argument(
        "--out",
        default=_DEFAULT_OUT,
        metavar="DIR",
        help=f"where the results go (default: {_DEFAULT_OUT})",
    )
    parser.add_argument("--json", action="store_true", help="parameters.json on stdout as well")
    parser.add_argument(
        "--resume", action="store_true", help="go on with an interrupted fit in DIR"
    )


def _add_postures(postures) -> None:
    """Equilibria instead of motions."""
    postures.add_argument(
        "--postures",
        metavar="LOG",
        nargs="*",
        help="logs of which each row is an equilibrium, not a moment of a motion",
    )
    postures.add_argument(
        "--folds",
        type=_count,
        metavar="N",
        help="keep trials aside in N parts, one after the other, and predict them",
    )
    postures.add_argument(
        "--posterior",
        choices=("laplace", "nuts"),
        help="draws of the posterior, by Laplace's approximation or by NUTS",
    )
    postures.add_argument(
        "--draws", type=_count, metavar="N", help="with --posterior: how many draws (1000)"
    )


def _add_search(search) -> None:
    """How it is searched, and how finely it is simulated."""
    search.add_argument(
        "--optimiser",
        help="levenberg_marquardt, or adam (gradient descent), which is usual for many parameters",
    )
    search.add_argument(
        "--loss", default="squares", help="squares, or huber or tukey, which outliers hardly move"
    )
    search.add_argument(
        "--starts", type=_count, default=1, metavar="N", help="search from N places (1)"
    )
    search.add_argument(
        "--profile", metavar="NAME,..", help="parameters of which to make the profile likelihood"
    )
    search.add_argument(
        "--explain", action="store_true", help="tell what else would explain the residuals"
    )
    search.add_argument(
        "--material", metavar="NAME", help="compare values with this material's range"
    )
    search.add_argument(
        "--no-checks",
        action="store_true",
        help="do not simulate the result again with half the step and twice the grid",
    )
    search.add_argument(
        "--dt",
        type=positive,
        metavar="S",
        help="time step [s] (default: found by simulating the recordings with finer ones)",
    )
    search.add_argument(
        "--intervals",
        type=_count,
        metavar="N",
        help="intervals along the rod (default: found in the same way)",
    )
    search.add_argument(
        "--tolerance",
        type=positive,
        metavar="PART",
        help="how far the simulated tip may be off by the time step, in lengths of the rod, and by "
        "the intervals, a tenth of that (1e-3)",
    )


def _add_data(data) -> None:
    """How the recordings are read, and what of them is used."""
    add_mapping(data)
    data.add_argument(
        "--condition",
        metavar="NAME=V1,V2,..",
        nargs="+",
        help="in what the recordings differ from the scene, such as payload_mass=0,0.052: a value "
        "for each recording, then for each of --held-out, or one for all",
    )
    data.add_argument(
        "--one-frame",
        action="store_true",
        help="recordings that do not know where the clamp is were made with one set-up: fit one "
        "frame to all, not another to each",
    )
    data.add_argument(
        "--look", action="store_true", help="plot the recordings to DIR/data.png, and stop there"
    )
    data.add_argument(
        "--window",
        type=number,
        nargs=2,
        metavar=("START", "END"),
        help="use this part of each recording only [s, on its own clock]",
    )
    data.add_argument(
        "--split",
        type=positive,
        nargs=2,
        metavar=("DURATION", "LEAD"),
        help="cut logs with inputs into windows [s], each with a lead to forget its beginning",
    )
    data.add_argument(
        "--drift",
        metavar="WHAT=DURATION",
        nargs="+",
        help="what may drift in long logs with inputs, of clock, tip and inputs, and the duration "
        "of the windows [s] in each of which it changes linearly, such as tip=2 inputs=5",
    )


def _add_c3d(c3d) -> None:
    """How the markers of a motion capture are told apart."""
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
    if args.postures is not None:
        from calibration.cli.postures import run_postures

        return run_postures(args)
    for name in ("folds", "posterior", "draws"):
        if getattr(args, name) is not None:
            raise UsageError(f"--{name}: for --postures only; leave it out")
    scene_path, log_paths = (args.scene, args.logs) if args.scene else _example()
    if not log_paths:
        raise UsageError("no recordings: give at least one LOG after the scene")
    out = Path(args.out)
    if out.exists() and not out.is_dir():
        raise UsageError(f"--out {out}: is a file; give a directory")
    # What can be told to be wrong is told before anything is computed.
    for text, reads in ((args.bounds, bound_in), (args.prior, prior_in), (args.drift, _drift)):
        for part in text or ():
            reads(part)
    prepare_jax()
    import softrod_jax as sr

    try:
        from calibration.report.plots import write_data_plot
        from calibration.report.writing import summary, write_report
    except ImportError as e:
        raise UsageError(f"{e}: pip install 'softrod_jax[calibration]'") from None

    scene = sr.load_scene(scene_path)
    recordings, held_out = _fitted_and_held_out(args, log_paths, scene)
    out.mkdir(parents=True, exist_ok=True)
    with alone_in(out):
        picture = write_data_plot([*recordings, *held_out], None, out / "data.png")
        if args.look:
            print(f"the recordings are in {picture}")
            return 0
        try:
            # Where there is a terminal, a bar tells more.
            said = contextlib.nullcontext() if sys.stderr.isatty() else waiting("fitting")
            with said:
                fit = _fitted(args, scene, recordings, held_out, out)
        except KeyboardInterrupt:
            if (out / _CHECKPOINT).exists():
                note(_RESUME)
            raise
        write_report(fit, out)
    if args.json:
        print((out / "parameters.json").read_text(encoding="utf-8"))
    else:
        print(f"\n{summary(fit)}\nparameters, report and plots are in {out}")
        print(f"next: softrod film {shlex.quote(str(out))}")
    if fit.result == "interrupted":
        note(_RESUME)
    return 0


def _fitted_and_held_out(args, log_paths, scene):
    """The recordings that are fitted and those that are predicted, with notes on them."""
    from calibration.data.trials import files_of

    log_paths, held_out_paths = files_of(log_paths), files_of(args.held_out or [])
    each = _recordings(args, [*log_paths, *held_out_paths], scene)
    read = _conditioned([r for own in each for r in own], args.condition or ())
    for recording in read:
        for assumption in recording.notes:
            note(f"{recording.name}: {assumption}")
    fitted = sum(map(len, each[: len(log_paths)]))
    return tuple(_cut(args, part) for part in (read[:fitted], read[fitted:]))


def _fitted(args, scene, recordings, held_out, out: Path):
    """The fit that the command line asks for."""
    from calibration import calibrate
    from calibration.problem.motion import METHOD

    method = None if args.intervals is None else replace(METHOD, intervals=args.intervals)
    return calibrate(
        scene,
        recordings,
        fit=names_in(args.fit) or None,
        per_recording=names_in(args.per_recording),
        bounds=dict(bound_in(text) for text in args.bounds or ()),
        priors=_priors(args, scene),
        one_frame=args.one_frame,
        held_out=held_out,
        time_offset=not args.no_time_offset,
        optimiser=args.optimiser,
        loss=args.loss,
        starts=args.starts,
        profiles=names_in(args.profile),
        checks=not args.no_checks,
        explain=args.explain,
        material=args.material,
        drift=dict(_drift(text) for text in args.drift or ()),
        dt=args.dt,
        tolerance=args.tolerance,
        method=method,
        checkpoint=out / _CHECKPOINT,
        resume=args.resume,
        progress=True,
    )


def _priors(args, scene) -> dict[str, tuple[float, float]]:
    """Those of --priors-from that are fitted here, and those of --prior, which go before."""
    from calibration.parameters.catalogue import choose

    fitted = choose(scene, names_in(args.fit) or None) if args.priors_from else ()
    found = {k: x for k, x in priors_of(args.priors_from).items() if k in fitted}
    return {**found, **dict(prior_in(text) for text in args.prior or ())}


def _drift(text: str) -> tuple[str, float]:
    name, _, duration = text.partition("=")
    try:
        return name.strip(), float(duration)
    except ValueError:
        raise UsageError(f"--drift {text}: expected WHAT=DURATION, such as clock=5 [s]") from None


def _recordings(args, paths, scene):
    """Those in each of the files: more than one where a mapping divides it into trials."""
    from calibration import load_recordings
    from calibration.data.loading import mapping_beside

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
    found = []
    for path, c3d in zip(paths, is_c3d, strict=True):
        mapping = args.mapping or mapping_beside(path)
        own = options if c3d and mapping is None else {}
        found.append(load_recordings(path, scene, mapping=mapping, **own))
    return found


def _conditioned(recordings, conditions):
    """The recordings with the conditions of the command line, a value for each of them."""
    for text in conditions:
        name, _, values = text.partition("=")
        try:
            numbers = [float(x) for x in values.split(",")]
        except ValueError:
            numbers = []
        if len(numbers) == 1:
            numbers *= len(recordings)
        if len(numbers) != len(recordings):
            raise UsageError(
                f"--condition {text}: expected NAME= and {len(recordings)} "
                f"number{'s'[: len(recordings) != 1]}, one for each recording, or one for all"
            )
        recordings = [
            replace(r, conditions={**r.conditions, name.strip(): value})
            for r, value in zip(recordings, numbers, strict=True)
        ]
    return recordings


def _cut(args, recordings):
    """The parts of the recordings that --window and --split ask for."""
    from calibration.data.windows import split

    if args.window is not None:
        recordings = [r.window(*args.window) for r in recordings]
    if args.split is not None:
        recordings = [part for r in recordings for part in split(r, *args.split)]
    return recordings


def _example():
    """The bundled scene and its logs."""
    return _EXAMPLE / "robot.toml", sorted(_EXAMPLE.glob("*.csv"))
