"""`calibrate`: from a scene and recordings to fitted numbers with intervals."""

import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from os import PathLike

import jax
import jax.numpy as jnp
import numpy as np

import softrod_jax as sr
from calibration import materials, optimise, robust, uncertainty
from calibration.assemble import estimates, recording_fit
from calibration.checkpoint import Checkpoint
from calibration.checks import Refined, hold_out, refine
from calibration.drift import durations
from calibration.explain import explain as what_else
from calibration.loss import Point, Problem, reverse_pays
from calibration.model import METHOD, SCHEME, make_batch
from calibration.optimise import Outcome
from calibration.parameters import catalogue
from calibration.progress import Bar, Meter, Silent
from calibration.recording import Recording
from calibration.results import Fit, RecordingFit, Start
from calibration.scales import Factor
from calibration.selection import select
from calibration.unknowns import Unknowns, check_conditions, choose_unknowns

# Half the width of the span from which the starts of a multi-start are drawn: one decade.
_SPAN = np.log(10.0)
_SPAN_OTHERS = 2.0


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
    window: tuple[float, float] | None = None,
    drift: Mapping[str, float] | None = None,
    checkpoint: str | PathLike | None = None,
    resume: bool = False,
    scheme=SCHEME,
    method=METHOD,
) -> Fit:
    """Fit numbers of `scene`, and of the bench around it, so that its tip moves as recorded.

    - `fit`: names out of `calibration.parameters.catalogue`; by default those of
      young_modulus, bending_damping and drag_coefficient that the scene has. The search starts
      from their values in the scene; everything else stays as it is.
    - `per_recording`: those of them of which each recording has its own value.
    - `bounds`: (low, high) by name, in the parameter's unit.
    - `held_out`: recordings to predict with what was fitted; of them only the clock is.
    - `time_offset`: also fit, for each recording, when its inputs or its release really began.
    - `optimiser`: "levenberg_marquardt", or "adam" (gradient descent), which goes by reverse mode
      if each recording depends on many parameters (`calibration.loss.reverse_pays`); by default
      the first for up to `calibration.optimise.MANY` parameters, and the second for more.
    - `loss`: "squares", or "huber" or "tukey", which outliers hardly move.
    - `starts`: search from so many places, the scene's own and others drawn from one decade
      around it on either side (with `seed`), and keep the best.
    - `profiles`: parameters of which the profile likelihood is wanted.
    - `checks`: simulate the result again with half the time step and with twice the grid.
    - `explain`: tell what else, if it were fitted, would explain the residuals.
    - `material`: compare the values with the range of a material out of
      `calibration.materials.MATERIALS`.
    - `progress`: show a bar on stderr.
    - `max_iterations`: evaluations by the optimiser, of each start.
    - `dt` [s]: the time step; by default the sample interval, or the multiple or fraction of it
      that is nearest below 10 ms.
    - `window`: use the samples from start to end [s, the recordings' clocks]; by default
      the rule `calibration.selection.RULE`.
    - `drift`: what may drift in logs with inputs, out of "clock", "tip" and "inputs", and the
      duration [s] of the windows in each of which it changes linearly (`calibration.drift`); by
      default nothing does.
    - `checkpoint`: a file in which the state is kept while the fit runs; `resume`: go on from it.
    - `scheme`, `method`: in time and along the rod, as for `softrod_jax.simulate`.

    A recording without inputs is a release: the rod is held straight until it is let go. One
    with inputs starts straight, or hanging in equilibrium if its first sample is elsewhere.
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
    drift = durations(drift)
    labels = _labels([*recordings, *held_out])
    check_conditions(scene, [*recordings, *held_out])
    differing = {name for r in (*recordings, *held_out) for name in r.conditions}
    setup, unknowns = choose_unknowns(
        scene, recordings, labels, fit, own, bounds or {}, differing
    )
    profiled = _indices(unknowns, profiles)
    optimiser = optimiser or optimise.usual(len(unknowns.names))
    if max_iterations is None:
        _, max_iterations = optimise.OPTIMISERS[optimiser]

    selections = [select(r, window) for r in recordings]
    known_parameters, _ = catalogue(setup.scene)
    defaults = {name: known_parameters[name].get(setup) for name in differing}
    batch, clocks = make_batch(scene, recordings, selections, time_offset, dt, defaults, drift)
    problem = Problem(setup, batch, clocks, unknowns, time_offset, scheme, method)
    descends = optimiser == "adam" and reverse_pays(len(unknowns.names), outputs=1)
    searched = replace(problem, reverse=descends)
    saved = Checkpoint(checkpoint, problem, resume, (optimiser, loss, starts, seed))
    with Bar() if progress else Silent() as meter:
        log = _Log(meter, saved)
        outcome, ends = _search(searched, optimiser, max_iterations, starts, seed, log)
        if not outcome.best.ok:
            raise CalibrationError(
                "the scene cannot be simulated, neither at its own values nor at others nearby: "
                f"{sr.result_message(outcome.best.result)}"
            )
        if descends:
            # What follows needs the sensitivities of every residual.
            outcome = replace(outcome, best=problem.at(outcome.best.x))
        outcome = _reweighted(outcome, loss, max_iterations, log)
        best = outcome.best
        log.stage("intervals", None)
        known = uncertainty.estimate(best, log.add)
        if profiled:
            log.stage("profiles", None)
        curves = {
            unknowns.items[i].label: uncertainty.profile(best, known, i, log.add)
            for i in profiled
        }
        finer = Refined(None, None, None)
        if checks:
            log.stage("checks", None)
            half = _half_step(problem, recordings, selections, defaults, drift)
            finer = refine(best, known, half)
        explanations = None
        if explain:
            log.stage("what else", None)
            explanations = tuple(
                what_else(best, recordings, labels, own, bounds or {}, log.add)
            )
        others = _held_out(best, held_out, labels[len(recordings) :], window, dt, defaults)
    if outcome.result != "interrupted":
        saved.remove()
    n = problem.size
    return Fit(
        scene=problem.fitted_setup(best.x).scene,
        setup=problem.fitted_setup(best.x),
        parameters=estimates(problem, best, known, finer, labels),
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
        dt=dict(zip(labels, (c.dt for c in clocks), strict=False)),
        seconds=time.perf_counter() - begun,
    )


class _Log:
    """Every evaluation of a fit: for the meter, the checkpoint, the history, and the best."""

    def __init__(self, meter: Meter, saved: Checkpoint):
        self.meter, self.saved, self.history, self.title = meter, saved, [], ""
        self.best = None

    def stage(self, title: str, total: int | None) -> None:
        self.title = title
        self.meter.stage(title, total)

    def add(self, point: Point) -> None:
        values = {name: v.tolist() for name, v in point.problem.values(point.x).items()}
        rms = point.rms if point.ok else None
        self.history.append({"stage": self.title, "rms_m": rms, **values})
        self.meter.show(point)

    def search(self, point: Point) -> None:
        """An evaluation of the search itself, whose best is kept."""
        self.add(point)
        self.saved.point(point)
        if point.ok and (self.best is None or point.loss < self.best.loss):
            self.best = point


def _check_choice(name: str, value, choices) -> None:
    if value not in choices:
        raise ValueError(f"{name}={value!r}: choose from {', '.join(choices)}")


def _indices(unknowns: Unknowns, names: Sequence[str]) -> list[int]:
    """The unknowns of the parameters or labels `names`."""
    names = (names,) if isinstance(names, str) else tuple(names)
    found = []
    for name in names:
        matching = [
            i for i, u in enumerate(unknowns.items) if name in (u.label, u.parameter.name)
        ]
        if not matching:
            raise ValueError(f"profiles: {name!r} is not fitted; add it to fit, or leave it out")
        found += matching
    return found


def _search(problem, optimiser, max_iterations, starts, seed, log) -> tuple[Outcome, tuple]:
    """The best outcome of all starts, and how each of them ended, the best first."""
    random = np.random.default_rng(seed)
    low, high = (b[: problem.size] for b in problem.bounds)
    spans = [
        _SPAN if isinstance(u.parameter.scale, Factor) else _SPAN_OTHERS
        for u in problem.unknowns.items
    ]
    outcomes, begun, interrupted = [], [], False
    for k in range(starts):
        x = problem.start()
        if k:
            x[: problem.size] = np.clip(random.uniform(-1, 1, problem.size) * spans, low, high)
        begun.append(x)
        if k < len(log.saved.done):
            done = log.saved.done[k]
            outcomes.append(Outcome(problem.at(np.array(done["x"])), done["result"], 0))
            continue
        if k == len(log.saved.done) and log.saved.x is not None:
            x = log.saved.x
        number = f" {k + 1} of {starts}" if starts > 1 else ""
        stage = lambda title, total, number=number: log.stage(title + number, total)
        log.best = None
        try:
            outcome = optimise.minimise(problem, optimiser, max_iterations, log.search, stage, x)
        except KeyboardInterrupt:
            if log.best is None and not outcomes:
                raise
            interrupted = True
            if log.best is not None:
                outcomes.append(Outcome(log.best, "interrupted", 0))
            break
        outcomes.append(outcome)
        if outcome.best.ok:
            log.saved.finish(outcome.best.x, outcome.best.loss, outcome.result)
    order = sorted(
        range(len(outcomes)), key=lambda k: outcomes[k].best.loss if outcomes[k].best.ok else np.inf
    )
    plain = lambda x: {k: float(np.max(v)) for k, v in problem.values(x).items()}
    ends = tuple(
        Start(plain(begun[k]), plain(b.x), b.rms if b.ok else np.inf, outcomes[k].result)
        for k in order
        for b in [outcomes[k].best]
    )
    best = outcomes[order[0]]
    return (replace(best, result="interrupted") if interrupted else best), ends


def _reweighted(outcome: Outcome, loss: str, max_iterations: int, log) -> Outcome:
    """The outcome with outliers taken out; the same for "squares"."""
    if loss == "squares":
        return outcome
    point, iterations = outcome.best, outcome.iterations
    log.stage(f"{loss} weights", None)
    for k in range(robust.ROUNDS):
        weights = robust.weights(point, loss, k)
        if robust.settled(point.problem.weights, weights):
            break
        problem = point.problem.weighted(weights)
        point = replace(point, problem=problem)
        done = optimise.levenberg_marquardt(problem, point, max_iterations, log.add)
        point, iterations = done.best, iterations + done.iterations
    return Outcome(point, outcome.result, iterations)


def _half_step(problem, recordings, selections, defaults, drift):
    """The batch with half the time step."""
    half = [c.dt / 2 for c in problem.clocks]
    return make_batch(
        problem.scene, recordings, selections, problem.time_offset, half, defaults, drift
    )[0]


def _held_out(best: Point, recordings, labels, window, dt, defaults) -> tuple[RecordingFit, ...]:
    """Predictions of `recordings`, through the program of the fit: as many at a time."""
    found, many = [], len(best.problem.clocks)
    for first in range(0, len(recordings), many):
        some = recordings[first : first + many]
        selections = [select(r, window) for r in some]
        fill = many - len(some)
        problem = best.problem
        batch, clocks = make_batch(
            problem.scene,
            some + some[-1:] * fill,
            selections + selections[-1:] * fill,
            problem.time_offset,
            dt,
            defaults,
            steps=problem.batch.steps,
            samples=problem.batch.times.shape[1],
            windows={name: x.shape[-1] for name, x in problem.batch.ramps.items()},
        )
        unknowns = problem.unknowns.shared(many)
        point = hold_out(replace(problem, batch=batch, clocks=clocks, unknowns=unknowns), best)
        found += [
            recording_fit(point, k, labels[first + k], r, s)
            for k, (r, s) in enumerate(zip(some, selections, strict=True))
        ]
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
