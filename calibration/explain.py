"""What else would explain the residuals: parameters that were not fitted, one after the other.

At the optimum the sensitivities to further parameters say, to first order, by how much each would
lower the sum of squares if it were fitted, too, and to what value it would go. One evaluation tells
of all of them. Where a large part of the residuals goes away, the model leaves something out that
looks like that parameter; it need not be it.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from calibration.loss import Point
from calibration.parameters import catalogue
from calibration.recording import Recording
from calibration.scales import Factor
from calibration.setup import Setup
from calibration.unknowns import choose_unknowns

_GROUPS = (
    "poisson_ratio",
    "density",
    "length",
    "shear_damping",
    "drag_coefficient",
    "bending_damping",
    "payload_mass",
    "tendon_efficiency_each",
    "tendon_position",
    "chamber_area",
    "chamber_position",
    "sensor_offset",
    "gravity_tilt",
    "clamp_rotation",
)


@dataclass(frozen=True)
class Explanation:
    """One further parameter, or a group of them.

    - `rms` [m]: what would be left if it were fitted, too; to first order.
    - `values`: what its members would change to, by name, and their `units`.
    """

    name: str
    rms: float
    values: dict[str, float]
    units: dict[str, str]


def explain(
    best: Point,
    recordings: Sequence[Recording],
    labels: Sequence[str],
    per_recording: Sequence[str],
    bounds: Mapping,
) -> list[Explanation]:
    """Of every parameter that could be fitted and was not, the most telling first."""
    problem = best.problem
    scene = problem.scene
    fitted = problem.unknowns.names
    candidates = {g: m for g in _GROUPS if (m := _members(scene, problem, g, fitted))}
    if not candidates:
        return []
    names = [*fitted, *(n for members in candidates.values() for n in members)]
    setup, unknowns = choose_unknowns(scene, recordings, labels, names, per_recording, bounds)
    many = replace(problem, setup=setup, unknowns=unknowns)
    place = {u.label: i for i, u in enumerate(unknowns.items)}
    x = many.start()
    old = [place[u.label] for u in problem.unknowns.items]
    old += list(range(many.size, len(x)))
    x[old] = best.x
    point = many.at(x)
    if not point.ok:
        return []
    found = []
    for group, members in candidates.items():
        new = [i for i, u in enumerate(unknowns.items) if u.parameter.name in members]
        step, loss = _step(point, old + new)
        moved = dict(zip(old + new, step, strict=True))
        values, units = {}, {}
        for i in new:
            u = unknowns.items[i]
            _, change = u.parameter.scale.limited(moved[i])
            values[u.label] = float(np.max(u.value(change)))
            units[u.label] = u.parameter.unit
        found.append(Explanation(group, float(np.sqrt(loss / problem.samples)), values, units))
    return sorted(found, key=lambda e: e.rms)


def _members(scene, problem, group, fitted) -> tuple[str, ...]:
    """What of `group` can be fitted and is not."""
    known, groups = catalogue(scene)
    if group == "gravity_tilt" and scene.gravity is None:
        return ()
    members = []
    for name in groups.get(group, (group,)):
        if name in fitted or name not in known:
            continue
        parameter = known[name]
        value = parameter.get(parameter.prepare(Setup(scene)))
        conditions = problem.batch.conditions.get(name, 0.0)
        there = value is not None and (np.any(np.asarray(value)) or np.any(conditions))
        if value is not None and (there or not isinstance(parameter.scale, Factor)):
            members.append(name)
    return tuple(members)


def _step(point: Point, columns: list[int]):
    """The Gauss-Newton step in `columns`, and the loss it promises."""
    J, r = point.jacobian[:, columns], point.residuals
    size = np.sqrt(np.sum(J**2, axis=0)) + 1e-300
    # Directions that do nothing are left alone.
    step, *_ = np.linalg.lstsq(J / size, -r, rcond=1e-4)
    step = step / size
    return step, float(np.sum((r + J @ step) ** 2))
