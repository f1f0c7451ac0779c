"""Fit a scene to recordings; without arguments, on the bundled example.

Writes DIR/parameters.json, a report, plots and the fitted scene. A recording is a .csv log or a
.c3d motion capture or, with a mapping file, any .csv, .mat, .h5, .parquet or .c3d. A mapping file
beside LOG whose name is LOG's with .map.toml in place of its ending is used for it.
"""

import contextlib
import shlex
import sys
from dataclasses import replace
from pathlib import Path

from calibration.cli.calibrate_options import EPILOG as EPILOG
from calibration.cli.calibrate_options import add_arguments as add_arguments
from calibration.cli.common import (
    UsageError,
    bound_in,
    check_posterior_options,
    names_in,
    note,
    prepare_jax,
    prior_in,
    priors_of,
)
from calibration.cli.exclusive import alone_in
from calibration.cli.waiting import waiting

_EXAMPLE = Path(__file__).parents[1] / "examples"
_CHECKPOINT = "checkpoint.json"
_RESUME = "interrupted; the same command with --resume goes on from here"


def run(args) -> int:
    if args.postures is not None:
        from calibration.cli.postures import run_postures

        return run_postures(args)
    if args.folds is not None:
        raise UsageError("--folds: for --postures only; leave it out")
    check_posterior_options(args)
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
    if args.compare is not None and args.with_postures:
        raise UsageError("--with-postures: not with --compare, which does not count them")
    if args.compare is not None and args.posterior is not None:
        raise UsageError("--posterior: not with --compare: ask for that of the model it chooses")
    if args.compare is not None and args.resume:
        raise UsageError("--resume: not with --compare, which keeps no checkpoints; leave one out")
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
                fit, verdict = _fitted(args, scene, recordings, held_out, out)
        except KeyboardInterrupt:
            if (out / _CHECKPOINT).exists():
                note(_RESUME)
            raise
        write_report(fit, out, verdict)
    if args.json:
        print((out / "parameters.json").read_text(encoding="utf-8"))
    else:
        print(f"\n{summary(fit, verdict)}\nparameters, report and plots are in {out}")
        print(f"next: softrod film {shlex.quote(str(out))}")
    if fit.result == "interrupted" and verdict is None:
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
    """The fit that the command line asks for, and the verdict on several models or None."""
    from calibration import calibrate

    options = _options(args, held_out)
    if args.compare is None:
        kept = dict(checkpoint=out / _CHECKPOINT, resume=args.resume)
        kept |= dict(postures=_postures(args, scene))
        kept |= dict(posterior=args.posterior, draws=args.draws or 1000)
        priors = _priors(args, scene)
        names = names_in(args.fit) or None
        return calibrate(scene, recordings, fit=names, priors=priors, **kept, **options), None
    from calibration.cli.comparing import models_in, told
    from calibration.comparison import compare

    models = models_in(args.compare, scene, args.fit)
    fitted = {name for model in models.values() for name in model.names}
    found = compare(models, recordings, told=told, priors=_known(args, fitted), **options)
    return found.best, found.verdict


def _postures(args, scene):
    """Those that are fitted together with the motions."""
    from calibration.data.trials import files_of
    from calibration.postures.data import joined, load_postures

    if not args.with_postures:
        return None
    return joined([load_postures(log, scene) for log in files_of(args.with_postures)])


def _options(args, held_out) -> dict:
    """Of `calibration.calibrate`, but for what is fitted."""
    from calibration.problem.motion import METHOD

    return dict(
        per_recording=names_in(args.per_recording),
        bounds=dict(bound_in(text) for text in args.bounds or ()),
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
        method=None if args.intervals is None else replace(METHOD, intervals=args.intervals),
        progress=True,
    )


def _priors(args, scene) -> dict[str, tuple[float, float]]:
    """Those of --priors-from that are fitted here, and those of --prior, which go before."""
    from calibration.parameters.catalogue import choose

    return _known(args, choose(scene, names_in(args.fit) or None) if args.priors_from else ())


def _known(args, fitted) -> dict[str, tuple[float, float]]:
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
            ("tip_body", args.tip_body or None),
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
