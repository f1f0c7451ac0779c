"""`softrod calibrate --postures`: each row of a log is an equilibrium."""

import contextlib
import os
from pathlib import Path

from calibration.cli.common import (
    UsageError,
    bound_in,
    check_posterior_options,
    names_in,
    prepare_jax,
    prior_in,
)
from calibration.cli.exclusive import alone_in
from calibration.cli.waiting import waiting

_FOR_MOTIONS = ("per_recording", "held_out", "resume", "optimiser", "profile", "explain", "dt")
_FOR_MOTIONS += (
    "mapping",
    "condition",
    "one_frame",
    "priors_from",
    "look",
    "window",
    "split",
    "drift",
    "tolerance",
    "with_postures",
)


def run_postures(args) -> int:
    """As `calibration.cli.calibrate.run`."""
    scene_path, logs = _what(args)
    for name in _FOR_MOTIONS:
        if getattr(args, name):
            raise UsageError(f"--{name.replace('_', '-')}: for motions only; leave it out")
    check_posterior_options(args)
    if not args.fit and args.compare is None:
        raise UsageError("--fit: name what to fit, such as young_modulus,tendons[*].friction")
    bounds = dict(bound_in(text) for text in args.bounds or ())
    priors = dict(prior_in(text) for text in args.prior or ())
    out = Path(args.out)
    if out.exists() and not out.is_dir():
        raise UsageError(f"--out {out}: is a file; give a directory")
    import jax

    prepare_jax()
    # Rows do not wait for each other: all cores work, unless JAX has begun with fewer.
    with contextlib.suppress(RuntimeError):
        jax.config.update("jax_num_cpu_devices", os.cpu_count() or 1)
    import softrod_jax as sr

    try:
        from calibration.postures.report import posture_summary, write_posture_report
    except ImportError as e:
        raise UsageError(f"{e}: pip install 'softrod_jax[calibration]'") from None
    from calibration.data.trials import files_of
    from calibration.postures.data import joined, load_postures
    from calibration.report.comparison import comparison_text

    scene = sr.load_scene(scene_path)
    postures = joined([load_postures(log, scene) for log in files_of(logs)])
    method = sr.Collocation() if args.intervals is None else sr.Collocation(args.intervals)
    out.mkdir(parents=True, exist_ok=True)
    with alone_in(out):
        options = dict(
            priors=priors,
            bounds=bounds,
            folds=args.folds,
            method=method,
            posterior=args.posterior,
            draws=args.draws or 1000,
        )
        with waiting("fitting"):
            fit, verdict = _fitted(args, scene, postures, options)
        write_posture_report(fit, out, verdict)
    if args.json:
        print((out / "parameters.json").read_text(encoding="utf-8"))
    else:
        for line in [] if verdict is None else comparison_text(verdict):
            print(line)
        print(f"{posture_summary(fit)}\nparameters, report and plots are in {out}")
    return 0


def _fitted(args, scene, postures, options):
    """The fit, and the verdict on several models or None."""
    from calibration.postures.fitting import calibrate_postures

    if args.compare is None:
        return calibrate_postures(scene, postures, fit=names_in(args.fit), **options), None
    from calibration.cli.comparing import models_in, told
    from calibration.postures.compare import compare_postures

    models = models_in(args.compare, scene, args.fit, motions=False)
    found = compare_postures(models, postures, told=told, **options)
    return found.best, found.verdict


def _what(args):
    """The scene and the logs, wherever the option stands among them."""
    given = [x for x in (args.scene, *args.logs, *args.postures) if x]
    scenes = [x for x in given if x.lower().endswith(".toml")]
    logs = [x for x in given if x not in scenes]
    if len(scenes) != 1 or not logs:
        raise UsageError("--postures: give one SCENE.toml, and at least one LOG")
    return scenes[0], logs
