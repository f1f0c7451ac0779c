"""`calibrate`: from a scene and recordings to fitted numbers with intervals."""

import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from os import PathLike

import jax
import jax.numpy as jnp

import softrod_jax as sr
from calibration.data.frames import in_one_frame
from calibration.data.recording import Recording
from calibration.experiment.hand import held_by_hands
from calibration.inference.explain import explain_residuals
from calibration.inference.first_look import check_axes
from calibration.inference.motion_posterior import check_problem, posterior_of
from calibration.inference.posterior import check_posterior
from calibration.inference.profile import profile_likelihoods
from calibration.inference.refinement import refine_until_resolved
from calibration.parameters.catalogue import choose, prepared
from calibration.parameters.materials import check_material
from calibration.parameters.priors import checked_pairs
from calibration.parameters.unknowns import choose_unknowns, conditioned, with_frame
from calibration.postures.beside import equilibria_fit, with_equilibria
from calibration.postures.data import Postures
from calibration.problem.dataset import datasets
from calibration.problem.motion import SCHEME
from calibration.problem.resolution import Resolution, choose_resolution
from calibration.report.assemble import assemble_fit
from calibration.report.recordings import held_out_fits
from calibration.report.results import Fit
from calibration.search.checkpoint import Checkpoint, read_checkpoint
from calibration.search.history import History
from calibration.search.minimum import find_minimum
from calibration.search.progress import Bar, Silent
from calibration.search.settings import SearchOptions


def calibrate(
    scene: sr.Scene,
    recordings: Sequence[Recording],
    *,
    fit: Sequence[str] | None = None,
    per_recording: Sequence[str] = (),
    bounds: Mapping[str, tuple[float, float]] | None = None,
    priors: Mapping[str, tuple[float, float]] | None = None,
    one_frame: bool = False,
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
    scheme: sr.SDIRK | sr.BDFAlpha = SCHEME,
    method: sr.Collocation | None = None,
    program: Sequence[str] | None = None,
    postures: Postures | None = None,
    posterior: str | None = None,
    draws: int = 1000,
) -> Fit:
    """Fit numbers of `scene`, and of the bench around it, so that its tip moves as recorded.

    - `fit`: names out of `calibration.parameters.catalogue.catalogue`, or paths of numbers in the
      scene (`calibration.parameters.paths`); by default those of young_modulus,
      bending_damping and drag_coefficient that the scene has. The search starts
      from their values in the scene; everything else stays as it is.
    - `per_recording`: those of them of which each recording has its own value.
    - `bounds`: (low, high) by name, in the parameter's unit.
    - `priors`: what is known beforehand, (mean, standard deviation) by name, in the parameter's
      unit. A prior counts as one independent measurement; one that the recordings contradict is
      told.
    - `one_frame`: recordings that do not know where the clamp is were made with one set-up: camera
      and clamp stayed where they were. Then one frame is fitted to all, by the parameters
      camera_shift and camera_rotation, and not another to each.
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
    - `postures`: equilibria of the same robot, fitted together with the recordings, to the
      parameters that all of these share. How large the noise of each is its residuals tell.
    - `posterior`: "laplace" or "nuts" for so many `draws` of the posterior, with `seed`
      (`calibration.inference.motion_posterior`), and bands of what samples are expected in.
    - `program`: names, those of `fit` among them, of which further fits of the same scene will fit
      others (`calibration.comparison`): they share a compiled program.

    A recording without inputs is a release: the rod is held straight until it is let go, or, where
    hand_force is fitted, and hand_moment, in an equilibrium under these at its tip. One
    with inputs starts straight, or hanging in equilibrium, as its samples before the first
    movement tell (`calibration.experiment.beginning`).
    Ctrl-C ends the optimisation early and keeps the best point.

    Recordings are simulated on all devices that JAX has, as by `softrod_jax.spread`. Several
    processes, of like machines and after `jax.distributed.initialize`, share them if all call with
    the same arguments; each gets the whole fit.

    Raises `ValueError` for bad arguments, `RecordingError` for recordings that cannot be used,
    `ImportError` for NUTS without blackjax, `CalibrationError` if nothing can be simulated from the
    scene's values.
    """
    begun = time.perf_counter()
    check_posterior(posterior, draws)
    options = SearchOptions(optimiser, loss, starts, seed, max_iterations)
    check_material(material)
    if resume:
        read_checkpoint(checkpoint)  # before anything is simulated
    scene = jax.tree.map(jnp.asarray, scene)
    if one_frame:
        recordings, held_out = in_one_frame(recordings, held_out)
        fit = with_frame(scene, fit)
        program = None if program is None else tuple(dict.fromkeys((*program, *fit)))
    as_told = lambda r: conditioned(prepared(scene, r.conditions), r.conditions)
    names = choose(scene, fit, {name for r in recordings for name in r.conditions})
    recordings, held_out = (held_by_hands(as_told, part, names) for part in (recordings, held_out))
    data, unseen = datasets(scene, recordings, held_out, window, drift)
    resolution = Resolution(data, dt, method, tolerance)
    setup, parameters = choose_unknowns(
        scene,
        data.recordings,
        data.labels,
        fit,
        per_recording,
        bounds,
        places=data.conditions,
        program=program,
    )
    settings = options.settings(len(parameters.names))
    profiled = parameters.indices(profiles)
    known = {name for u in parameters.items for name in (u.label, u.parameter.name)}
    problem = resolution.first_problem(setup, parameters, time_offset, scheme)
    problem = replace(problem, priors=checked_pairs("priors", priors, known))
    problem = with_equilibria(problem, postures, method)
    check_problem(problem, posterior)
    with Bar() if progress else Silent() as meter:
        meter.stage("steps and grid", None)
        problem = choose_resolution(problem, resolution)
        check_axes(problem.at(problem.space.origin()), data.recordings)
        history = History(meter, Checkpoint(checkpoint, problem, resume, settings))
        outcome, ends = find_minimum(problem, settings, history)
        resolved = refine_until_resolved(
            outcome, resolution, checks, settings.max_iterations, history
        )
        best = resolved.best
        curves = profile_likelihoods(best, resolved.uncertainty, profiled, history)
        reasons = explain_residuals(best, data, per_recording, bounds, history) if explain else None
        predicted = held_out_fits(best, unseen, dt)
        drawn = None
        if posterior is not None:
            history.stage("posterior", None)
            drawn = posterior_of(best, resolved.uncertainty, posterior, draws, seed)
        history.result(best)
    return assemble_fit(
        resolved,
        data,
        settings,
        history,
        starts=ends,
        profiles=curves,
        explanations=reasons,
        held_out=predicted,
        material=material,
        postures=equilibria_fit(resolved.best),
        posterior=drawn,
        seconds=time.perf_counter() - begun,
    )
