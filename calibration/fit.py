"""`calibrate`: from a scene and recordings to fitted numbers with intervals."""

import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from os import PathLike

import jax
import jax.numpy as jnp

import softrod_jax as sr
from calibration.data.recording import Recording
from calibration.data.selection import select
from calibration.experiment.drift import durations
from calibration.inference import uncertainty
from calibration.inference.checks import predicted
from calibration.inference.explain import explain as what_else
from calibration.inference.first_look import check_axes
from calibration.inference.resolution import (
    REFITS,
    TOLERANCE,
    Refined,
    Resolution,
    finer_problem,
    first_choice,
    first_steps,
    refine,
)
from calibration.parameters import materials
from calibration.parameters.catalogue import catalogue
from calibration.parameters.unknowns import Unknowns, check_conditions, choose_unknowns
from calibration.problem.evaluation import reverse_pays
from calibration.problem.motion import METHOD, SCHEME, make_batch
from calibration.problem.problem import Point, Problem
from calibration.report.assemble import estimates, recording_fit, setup_with
from calibration.report.results import Fit, RecordingFit
from calibration.search import optimise, robust
from calibration.search.checkpoint import Checkpoint, read_checkpoint
from calibration.search.multistart import Log, polished, reweighted, search
from calibration.search.optimise import Outcome
from calibration.search.progress import Bar, Silent


class CalibrationError(ValueError):
    """A calibration that cannot be done: the message says why and what to try."""


def calibrate(
    scene: sr.Scene,
    recordings: Sequence[Recording],
    *,
    fit: Sequence[str] | None = None,
    per_recording: Sequence[str] = (),
    bounds: Mapping[str, tuple[float, float]] | None = None,
    held_out: Sequence[Recording] = (),
    time_offset: bool = True,
    optimiser: str | None = None,
    loss: str = "squares",
    starts: int = 1,
    seed: int = 0,
    profiles: Sequence[str] = (),
    checks: bool = True,
    explain: bool = False,
    material: str | None = None,
    progress: bool = True,
    max_iterations: int | None = None,
    dt: float | None = None,
    tolerance: float | None = None,
    window: tuple[float, float] | None = None,
    drift: Mapping[str, float] | None = None,
    checkpoint: str | PathLike | None = None,
    resume: bool = False,
    scheme=SCHEME,
    method: sr.Collocation | None = None,
) -> Fit:
    """Fit numbers of `scene`, and of the bench around it, so that its tip moves as recorded.

    - `fit`: names out of `calibration.parameters.catalogue.catalogue`; by default those of
      young_modulus, bending_damping and drag_coefficient that the scene has. The search starts
      from their values in the scene; everything else stays as it is.
    - `per_recording`: those of them of which each recording has its own value.
    - `bounds`: (low, high) by name, in the parameter's unit.
    - `held_out`: recordings to predict with what was fitted; of them only the clock is, and where a
      recording does not know where the clamp is, its frame, once more for comparison. They have
      the mean of what each fitted recording has for itself.
    - `time_offset`: also fit, for each recording, when its inputs or its release really began.
    - `optimiser`: "levenberg_marquardt", or "adam" (gradient descent), which goes by reverse mode
      if each recording depends on many parameters (`calibration.problem.evaluation.reverse_pays`);
      by default the first for up to `calibration.search.optimise.MANY` parameters, and the second
      for more.
    - `loss`: "squares", or "huber" or "tukey", which outliers hardly move.
    - `starts`: search from so many places, the scene's own and others drawn from one decade
      around it on either side (with `seed`), and keep the best.
    - `profiles`: parameters of which the profile likelihood is wanted.
    - `checks`: simulate the result again with half the time step and with twice the grid, and fit
      again with those where they lead elsewhere.
    - `explain`: tell what else, if it were fitted, would explain the residuals.
    - `material`: compare the values with the range of a material out of
      `calibration.parameters.materials.MATERIALS`.
    - `progress`: show a bar on stderr.
    - `max_iterations`: evaluations by the optimiser, of each start.
    - `dt` [s]: the time step; by default it is found by simulating the recordings at the scene's
      values with finer and finer ones, from a sample's, or a few of a long recording.
    - `tolerance`: how far the simulated tip may be off because of the time step, rms, in lengths of
      the rod (1e-3), and because of the grid along it, a tenth of that.
    - `window`: use the samples from start to end [s, the recordings' clocks]; by default
      the rule `calibration.data.selection.RULE`.
    - `drift`: what may drift in logs with inputs, out of "clock", "tip" and "inputs", and the
      duration [s] of the windows in each of which it changes linearly
      (`calibration.experiment.drift`); by default nothing does.
    - `checkpoint`: a file in which the state is kept until
      `calibration.report.writing.write_report` has written the fit; `resume`: go on from it.
    - `scheme`, `method`: in time and along the rod, as for `softrod_jax.simulate`; by default the
      grid along the rod is found like `dt`.

    A recording without inputs is a release: the rod is held straight until it is let go. One
    with inputs starts straight, or hanging in equilibrium, as its samples before the first
    movement tell (`calibration.experiment.beginning`).
    Ctrl-C ends the optimisation early and keeps the best point.

    Recordings are simulated on all devices that JAX has, as by `softrod_jax.spread`. Several
    processes, of like machines and after `jax.distributed.initialize`, share them if all call with
    the same arguments; each gets the whole fit.

    Raises `ValueError` for bad arguments, `RecordingError` for recordings that cannot be used,
    `CalibrationError` if nothing can be simulated from the scene's values.
    """
    begun = time.perf_counter()
    scene = jax.tree.map(jnp.asarray, scene)
    recordings = [recordings] if isinstance(recordings, Recording) else list(recordings)
    if not recordings:
        raise ValueError("recordings: none given; at least one is needed")
    own = (per_recording,) if isinstance(per_recording, str) else tuple(per_recording)
    held_out = [held_out] if isinstance(held_out, Recording) else list(held_out)
    if optimiser is not None:
        _check_choice("optimiser", optimiser, optimise.OPTIMISERS)
    _check_choice("loss", loss, robust.LOSSES)
    if material is not None:
        _check_choice("material", material, materials.MATERIALS)
    for name, value in (("max_iterations", max_iterations), ("starts", starts)):
        if value is not None and value < 1:
            raise ValueError(f"{name}={value}: at least 1 is needed")
    if tolerance is not None and not 0 < tolerance < 1:
        raise ValueError(f"tolerance={tolerance!r}: a part of the rod's length in (0, 1) is needed")
    if resume:
        read_checkpoint(checkpoint)  # before anything is simulated
    drift = durations(drift)
    labels = _labels([*recordings, *held_out])
    check_conditions(scene, [*recordings, *held_out])
    differing = {name for r in (*recordings, *held_out) for name in r.conditions}
    setup, unknowns = choose_unknowns(scene, recordings, labels, fit, own, bounds or {}, differing)
    profiled = _indices(unknowns, profiles)
    optimiser = optimiser or optimise.usual(len(unknowns.names))
    if max_iterations is None:
        _, max_iterations = optimise.OPTIMISERS[optimiser]

    selections = [select(r, window) for r in recordings]
    known_parameters, _ = catalogue(setup.scene)
    defaults = {name: known_parameters[name].get(setup) for name in differing}
    resolution = Resolution(
        recordings, selections, defaults, drift, tolerance or TOLERANCE,
        steps_fixed=dt is not None, grid_fixed=method is not None,
    )  # fmt: skip
    steps = first_steps(recordings, selections) if dt is None else dt
    batch, clocks = make_batch(scene, recordings, selections, time_offset, steps, defaults, drift)
    problem = Problem(setup, batch, clocks, unknowns, time_offset, scheme, method or METHOD)
    descends = optimiser == "adam" and reverse_pays(len(unknowns.names), outputs=1)
    with Bar() if progress else Silent() as meter:
        meter.stage("steps and grid", None)
        problem = first_choice(problem, resolution)
        check_axes(problem.at(problem.start()), recordings)
        searched = replace(problem, reverse=descends)
        saved = Checkpoint(checkpoint, problem, resume, (optimiser, loss, starts, seed))
        log = Log(meter, saved)
        outcome, ends = search(searched, optimiser, max_iterations, starts, seed, log)
        if not outcome.best.ok:
            raise CalibrationError(
                "the scene cannot be simulated, neither at its own values nor at others nearby: "
                f"{sr.result_message(outcome.best.result)}"
            )
        if descends:
            # What follows needs the sensitivities of every residual.
            outcome = replace(outcome, best=problem.at(outcome.best.x))
        outcome = reweighted(outcome, loss, max_iterations, log)
        outcome, known, finer = _settled(outcome, resolution, checks, max_iterations, log)
        best, problem = outcome.best, outcome.best.problem
        if profiled:
            log.stage("profiles", None)
        curves = {
            unknowns.items[i].label: uncertainty.profile(best, known, i, log.add) for i in profiled
        }
        explanations = None
        if explain:
            log.stage("what else", None)
            explanations = tuple(what_else(best, recordings, labels, own, bounds or {}, log.add))
        others = _held_out(best, held_out, labels[len(recordings) :], window, dt, defaults)
        log.result(best)
    n = problem.size
    parameters = estimates(problem, best, known, finer, labels)
    final = setup_with(problem, best, known)
    return Fit(
        scene=final.scene,
        setup=final,
        parameters=parameters,
        recordings=tuple(
            recording_fit(best, k, label, r, s, known, finer.motions)
            for k, (label, r, s) in enumerate(zip(labels, recordings, selections, strict=False))
        ),
        held_out=others,
        result=outcome.result,
        optimiser=optimiser,
        loss=loss,
        iterations=outcome.iterations,
        evaluations=len(log.history),
        history=log.history,
        correlation=known.correlation[:n, :n],
        samples=known.samples,
        effective_samples=known.effective_samples,
        profiles=curves,
        starts=ends,
        explanations=explanations,
        material=material,
        dt=dict(zip(labels, (c.dt for c in problem.clocks), strict=False)),
        method=problem.method,
        resolution_note=finer.note,
        checkpoint=saved,
        seconds=time.perf_counter() - begun,
    )


def _settled(outcome: Outcome, resolution: Resolution, checks: bool, max_iterations: int, log):
    """The outcome, fitted again with finer simulations as long as they say something else; its
    intervals, and what still finer ones say."""
    known = finer = None
    for attempt in range(REFITS + 1):
        best = outcome.best
        log.stage("intervals", None)
        known, finer = uncertainty.estimate(best, log.add), Refined()
        if not checks:
            break
        log.stage("checks", None)
        finer = refine(best, known, resolution)
        if not finer.again or attempt == REFITS or outcome.result == "interrupted":
            break
        again = polished(best, finer_problem(best.problem, finer, resolution), max_iterations, log)
        if not again.best.ok:
            break
        result = again.result if outcome.result == "converged" else outcome.result
        outcome = Outcome(again.best, result, outcome.iterations + again.iterations)
    return outcome, known, finer


def _check_choice(name: str, value, choices) -> None:
    if value not in choices:
        raise ValueError(f"{name}={value!r}: choose from {', '.join(choices)}")


def _indices(unknowns: Unknowns, names: Sequence[str]) -> list[int]:
    """The unknowns of the parameters or labels `names`."""
    names = (names,) if isinstance(names, str) else tuple(names)
    found = []
    for name in names:
        matching = [i for i, u in enumerate(unknowns.items) if name in (u.label, u.parameter.name)]
        if not matching:
            raise ValueError(f"profiles: {name!r} is not fitted; add it to fit, or leave it out")
        found += matching
    return found


def _held_out(best: Point, recordings, labels, window, dt, defaults) -> tuple[RecordingFit, ...]:
    """Predictions of `recordings`, through the program of the fit: as many at a time."""
    found, problem = [], best.problem
    many = len(problem.clocks)
    for first in range(0, len(recordings), many):
        some = recordings[first : first + many]
        selections = [select(r, window) for r in some]
        fill = many - len(some)
        batch, clocks = make_batch(
            problem.scene,
            some + some[-1:] * fill,
            selections + selections[-1:] * fill,
            problem.time_offset,
            dt or min(c.dt for c in problem.clocks),
            defaults,
            steps=problem.batch.steps,
            samples=problem.batch.times.shape[1],
            windows={name: x.shape[-1] for name, x in problem.batch.ramps.items()},
        )
        unknowns, x = problem.unknowns.shared(best.x, many)
        own_frame, fitted_frame = predicted(
            replace(problem, batch=batch, clocks=clocks, unknowns=unknowns), x, best
        )
        for k, (r, s) in enumerate(zip(some, selections, strict=True)):
            shown = own_frame if fitted_frame is None else fitted_frame
            fit = recording_fit(shown, k, labels[first + k], r, s)
            if not r.origin_known:
                own = recording_fit(own_frame, k, labels[first + k], r, s).rmse
                fit = replace(fit, rmse_own_frame=own, frame_fitted=fitted_frame is None)
            found.append(fit)
    return tuple(found)


def _labels(recordings) -> list[str]:
    """The recordings' names, told apart by numbers where they are the same."""
    labels: list[str] = []
    for recording in recordings:
        label, number = recording.name, 2
        while label in labels:
            label, number = f"{recording.name}-{number}", number + 1
        labels.append(label)
    return labels
