"""What else would explain the residuals: parameters that were not fitted, one after the other.

At the optimum the sensitivities to further parameters say, to first order, by how much each would
lower the sum of squares if it were fitted, too, and to what value it would go. One evaluation tells
of all of them. Where a large part of the residuals goes away, the model leaves something out that
looks like that parameter; it need not be it.

How long a hand took to let go (`calibration.experiment.release`) does not show like that: to first
order, a release that is slow is one that is late, which the clock has taken up. A few durations are
simulated, and a fit goes on from the most promising.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import jax
import numpy as np

from calibration.experiment.bulk import ring_frequency
from calibration.experiment.setup import Setup
from calibration.parameters.catalogue import as_names, catalogue
from calibration.parameters.scales import Factor
from calibration.parameters.unknowns import choose_unknowns
from calibration.problem.dataset import Dataset
from calibration.problem.problem import Point, Problem
from calibration.search.history import History
from calibration.search.optimise import levenberg_marquardt
from calibration.search.progress import Report

_GROUPS = (
    "poisson_ratio",
    "density",
    "length",
    "shear_damping",
    "damping_time",
    "drag_coefficient",
    "bending_damping",
    "material_c1",
    "material_c2",
    "material_mu",
    "stiffness_bending",
    "stiffness_torsion",
    "stiffness_axial",
    "stiffness_shear",
    "relaxation_part",
    "relaxation_time",
    "payload_mass",
    "payload_offset",
    "tendon_efficiency_each",
    "tendon_position",
    "chamber_area",
    "chamber_position",
    "sensor_offset",
    "gravity_tilt",
    "clamp_rotation",
)
_RELEASE = "release_duration"
_DURATIONS = (0.003, 0.03, 0.06, 0.1, 0.15)  # s: none to speak of, up to a slow hand
_ITERATIONS = 8
# What may differ from recording to recording though it is the rod's.
_OF_EACH = ("bending_damping", "young_modulus")
# A viscous damping is the same at all frequencies, and that of a loss which does not grow with
# frequency falls with its first power; between these powers it is told. Frequencies whose ratio is
# less than this do not tell.
_FALLS, _APART = (0.3, 1.7), 1.2
# A parameter that would take away this part of the residuals (rms) is worth a remark.
TELLING = 0.15


@dataclass(frozen=True)
class Explanation:
    """One further parameter, or a group of them.

    - `rms` [m]: what would be left if it were fitted, too; to first order, but for
      release_duration, which is fitted for a few iterations.
    - `values`: what its members would change to, by name, and their `units`.
    - `reading`: what that may mean, or "".
    """

    name: str
    rms: float
    values: dict[str, float]
    units: dict[str, str]
    reading: str = ""


def explain_residuals(
    best: Point,
    data: Dataset,
    per_recording: Sequence[str],
    bounds: Mapping | None,
    history: History,
) -> tuple[Explanation, ...]:
    """An explanation by every parameter that could be fitted and was not, the most telling first.

    `best`: where the fit of `data` ended, with `per_recording` and `bounds` as it had them.
    """
    history.stage("what else", None)
    wider = _Wider(best, data, as_names(per_recording), bounds)
    found = [*_to_first_order(wider), *_of_each(wider), *_slow_release(wider, history.add)]
    return tuple(sorted(found, key=lambda e: e.rms))


@dataclass(frozen=True)
class _Wider:
    """The fit that ended at `best`, to which parameters can be added."""

    best: Point
    data: Dataset
    per_recording: tuple[str, ...]
    bounds: Mapping | None

    def by(self, names, of_each=()) -> tuple[Problem, np.ndarray, list[int]]:
        """The problem with `names` as well, those in `of_each` by recording; x at the best place,
        and which of its entries were fitted there."""
        problem = self.best.problem
        names = [*problem.space.parameters.names, *names]
        own = (*self.per_recording, *of_each)
        setup, parameters = choose_unknowns(
            problem.scene,
            self.data.recordings,
            self.data.labels,
            names,
            own,
            self.bounds,
            places=problem.batch.conditions,
        )
        space = replace(problem.space, parameters=parameters)
        wider = replace(problem, setup=setup, space=space)
        if problem.beside is not None:
            wider = replace(wider, beside=problem.beside.among(wider))
        place = {u.label: i for i, u in enumerate(parameters.items)}
        x = space.origin()
        old = [place[u.label] for u in problem.space.parameters.items]
        old += list(range(space.parameter_count, len(x)))
        x[old] = self.best.x
        return wider, x, old


def _to_first_order(wider: _Wider) -> list[Explanation]:
    problem = wider.best.problem
    scene, fitted = problem.scene, problem.space.parameters.names
    candidates = {g: m for g in _GROUPS if (m := _members(scene, problem, g, fitted))}
    if not candidates:
        return []
    many, x, old = wider.by([n for members in candidates.values() for n in members])
    point = many.at(x)
    if not point.ok:
        return []
    found, items = [], many.space.parameters.items
    for group, members in candidates.items():
        new = [i for i, u in enumerate(items) if u.parameter.name in members]
        columns = old + new
        told, by_x = point.beliefs
        size = np.sqrt(many.variance)
        known = size * told, size * by_x[:, columns]
        step, loss = _step(point.jacobian[:, columns], point.residuals, known)
        moved = dict(zip(columns, step, strict=True))
        values, units = {}, {}
        for i in new:
            _, change = items[i].parameter.scale.limited(moved[i])
            values[items[i].label] = float(np.max(items[i].value(change)))
            units[items[i].label] = items[i].parameter.unit
        found.append(
            Explanation(group, float(np.sqrt(loss / problem.statistics.samples)), values, units)
        )
    return found


def _of_each(wider: _Wider) -> list[Explanation]:
    """What recordings share, as if each had its own; to first order, without a simulation."""
    best, found = wider.best, []
    problem, many = best.problem, len(best.problem.space.clocks)
    J = best.jacobian.reshape(many, -1, best.x.size)
    for i, item in enumerate(problem.space.parameters.items):
        if many < 2 or item.parameter.name not in _OF_EACH or item.recording is not None:
            continue
        own = np.zeros((*J.shape[:2], many))
        own[range(many), :, range(many)] = J[:, :, i]
        others = np.delete(J, i, axis=2)
        columns = np.concatenate([own, others], axis=2).reshape(best.residuals.size, -1)
        step, loss = _step(columns, best.residuals)
        thetas = [best.x[i] + item.parameter.scale.limited(s)[1] for s in step[:many]]
        values = [float(np.max(item.value(theta))) for theta in thetas]
        labels = [f"{item.label}@{wider.data.labels[k]}" for k in range(many)]
        found.append(
            Explanation(
                f"{item.label} of each recording",
                float(np.sqrt(loss / problem.statistics.samples)),
                dict(zip(labels, values, strict=True)),
                dict.fromkeys(labels, item.parameter.unit),
                _loss_law(problem, best.x, values) if item.label == "bending_damping" else "",
            )
        )
    return found


def _loss_law(problem: Problem, x, dampings: list[float]) -> str:
    """What dampings of recordings that ring at different frequencies say of the material."""
    rings = [ring_frequency(problem.fitted_setup(x, k).scene) for k in range(len(dampings))]
    slow, quick = int(np.argmin(rings)), int(np.argmax(rings))
    ratio = rings[quick] / rings[slow]
    if ratio < _APART:
        return ""
    falls = np.log(dampings[slow] / dampings[quick]) / np.log(ratio)
    if not _FALLS[0] < falls < _FALLS[1]:
        return ""
    return (
        f"the damping falls as the frequency grows, from {rings[slow]:.3g} to {rings[quick]:.3g} "
        f"Hz, by its power {falls:.1f}: as of a material whose loss does not grow with frequency "
        "(power 1), or grows less than that of a viscous one (power 0), which is simulated"
    )


def _slow_release(wider: _Wider, report: Report) -> list[Explanation]:
    """The explanation by a release's duration; none if there is none, or it is given or fitted."""
    problem, batch = wider.best.problem, wider.best.problem.batch
    parameters, _ = catalogue(problem.scene)
    told = _RELEASE in problem.space.parameters.names or _RELEASE in batch.conditions
    if told or jax.tree.leaves((batch.inputs, batch.carried)) or _RELEASE not in parameters:
        return []
    many, x, _ = wider.by([_RELEASE], of_each=[_RELEASE])
    space = many.space
    own = [i for i, u in enumerate(space.parameters.items) if u.parameter.name == _RELEASE]
    points = [many.at(_released_in(many, x, own, duration)) for duration in _DURATIONS]
    for point in points:
        report(point)
    points = [point for point in points if point.ok]
    if not points:
        return []
    mixed = x.copy()
    for recording, k in enumerate(_best_mix(points)):
        of_it = [own[recording]] + [space.parameter_count + recording] * space.time_offset
        mixed[of_it] = points[k].x[of_it]
    start = many.at(mixed)
    report(start)
    end = levenberg_marquardt(many, start, _ITERATIONS, report).best
    items = [space.parameters.items[i] for i in own]
    values = {u.label: float(u.value(end.x[i])) for i, u in zip(own, items, strict=True)}
    units = {u.label: u.parameter.unit for u in items}
    return [Explanation(_RELEASE, end.rms, values, units)] if end.ok else []


def _released_in(many: Problem, x, own: list[int], duration: float) -> np.ndarray:
    """x with that duration [s] of every release; half of it is a delay, which goes."""
    x, space = x.copy(), many.space
    for i in own:
        item = space.parameters.items[i]
        x[i] = item.parameter.scale.theta(item.initial, duration)
    if space.time_offset:
        x[space.delays] -= np.array([duration / 2 / c.interval for c in space.clocks])
    return x


def _best_mix(points: list[Point]) -> list[int]:
    """Which point to take for each recording, so that one Gauss-Newton step of all unknowns
    leaves least: one recording after the other, until none changes."""
    many = len(points[0].problem.space.clocks)
    J = [p.jacobian.reshape(many, -1, p.x.size) for p in points]
    r = [p.residuals.reshape(many, -1) for p in points]

    def left(mix):
        jacobian = np.concatenate([J[k][i] for i, k in enumerate(mix)])
        return _step(jacobian, np.concatenate([r[k][i] for i, k in enumerate(mix)]))[1]

    mix, before = [0] * many, None
    while mix != before:
        before = mix
        for i in range(many):
            tries = [[*mix[:i], k, *mix[i + 1 :]] for k in range(len(points))]
            mix = min(tries, key=left)
    return mix


def _members(scene, problem, group, fitted) -> tuple[str, ...]:
    """What of `group` can be fitted and is not."""
    parameters, groups = catalogue(scene)
    if group == "gravity_tilt" and scene.gravity is None:
        return ()
    members = []
    for name in groups.get(group, (group,)):
        if name in fitted or name not in parameters:
            continue
        parameter = parameters[name]
        value = parameter.get(parameter.prepare(Setup(scene)))
        conditions = problem.batch.conditions.get(name, 0.0)
        there = value is not None and (np.any(np.asarray(value)) or np.any(conditions))
        if value is not None and (there or not isinstance(parameter.scale, Factor)):
            members.append(name)
    return tuple(members)


def _step(J: np.ndarray, r: np.ndarray, known=None) -> tuple[np.ndarray, float]:
    """The Gauss-Newton step in the columns of `J`, and the sum of squares that it promises of the
    residuals `r`. `known`: residuals and derivatives of all that is told besides, which a step must
    not make worse than the residuals are made better."""
    mine, own = J, r
    if known is not None:
        J, r = np.concatenate([J, known[1]]), np.concatenate([r, known[0]])
    size = np.sqrt(np.sum(J**2, axis=0)) + 1e-300
    # Directions that do nothing are left alone.
    step, *_ = np.linalg.lstsq(J / size, -r, rcond=1e-4)
    step = step / size
    return step, float(np.sum((own + mine @ step) ** 2))
