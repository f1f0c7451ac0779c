"""An independent judge of equilibria: multiple shooting in the base frame, numpy and scipy only.

    python benchmarks/judge_static.py SCENE.toml [--tensions 1,0,0] [--pressures 2e4]

It shares with the package the energy of a scene and nothing else. The package collocates the wrench
in the body frame on a fixed grid; here the unknowns are attitudes and moments in the base frame,
where the force of dead loads is known in closed form, N(s) = F + m g + rho A g (L - s), and
explicit Runge-Kutta steps of order 8 (Dormand and Prince's) join nodes that lie as close as the
solution turns and as its layers are thin. So neither coils of many turns nor layers of width
sqrt(EI/N) are beyond it, and halving all segments tells its own error, about 1e-10 of the length.

    h_s = 1/2 h o (0, u)     M_s = -(R v) x N     p_s = R v
    (v, u) minimises W_elastic(v, u) + W_act(v, u) - R^T N . v - R^T M . u

It starts from the shape of an answer, and ends at the equilibrium near it or says that there is
none. All quantities are in units of the length L and of the largest bending stiffness EI.
"""

import argparse
from typing import NamedTuple

import numpy as np
from judge_rod import (
    NoAnswer,
    Rod,
    conjugate,
    exponential,
    hat,
    logarithm,
    matrix,
    product,
    rod_of,
    strains,
    times,
)
from scipy.integrate import DOP853, cumulative_trapezoid
from scipy.interpolate import PchipInterpolator
from scipy.linalg import solve_banded

# Radians of bending, twisting and layers in one segment: steps of order 8 then keep about 1e-9.
PHASE = 0.6
MOST_SEGMENTS = 40_000


# ------------------------------------------------------------------------- along the segments
class Rates(NamedTuple):
    h: np.ndarray
    M: np.ndarray
    p: np.ndarray
    A: np.ndarray
    x: np.ndarray


def rates(rod, s, h, M, guess) -> Rates:
    """d(h, M, p)/ds at many points, and the matrix of small changes (turn in the body frame, M)."""
    R = matrix(h)
    Rt = np.swapaxes(R, -1, -2)
    N = rod.force + rod.weight * (1 - s)[:, None]
    n, m = times(Rt, N), times(Rt, M)
    x, C = strains(rod, np.concatenate([n, m], -1), guess)
    v, u = x[:, :3], x[:, 3:]
    p_s = times(R, v)
    h_s = 0.5 * product(h, np.concatenate([np.zeros_like(u[:, :1]), u], -1))
    # A turn t of the section: R^T a changes by a x t.
    by_turn = C @ np.concatenate([hat(n), hat(m)], -2)
    by_moment = C[..., 3:] @ Rt
    lever = hat(N) @ R
    A = np.empty((len(s), 6, 6))
    A[:, :3, :3], A[:, :3, 3:] = by_turn[:, 3:] - hat(u), by_moment[:, 3:]
    A[:, 3:, :3], A[:, 3:, 3:] = lever @ (by_turn[:, :3] - hat(v)), lever @ by_moment[:, :3]
    return Rates(h_s, -np.cross(p_s, N), p_s, A, x)


class Ends(NamedTuple):
    h: np.ndarray
    M: np.ndarray
    p: np.ndarray
    by_start: np.ndarray
    x: np.ndarray


def march(rod, s, width, h, M) -> Ends:
    """One Runge-Kutta step over each segment: state at its end, and derivative by its start."""
    stages, changes, x = [], [], np.broadcast_to(rod.rest, (len(s), 6)).copy()
    along = lambda row, of: sum(a * k for a, k in zip(row, of) if a != 0.0)
    w, eye, first = width[:, None], np.eye(6), None
    for a, c in zip(DOP853.A, DOP853.C):
        row = a[: len(stages)]
        at_h = h + w * along(row, [k.h for k in stages]) if stages else h
        at_M = M + w * along(row, [k.M for k in stages]) if stages else M
        stages.append(rates(rod, s + c * width, at_h, at_M, x))
        x = stages[-1].x
        first = x if first is None else first
        at = eye + w[..., None] * along(row, changes) if changes else eye
        changes.append(stages[-1].A @ at)
    row = DOP853.B
    return Ends(
        h + w * along(row, [k.h for k in stages]),
        M + w * along(row, [k.M for k in stages]),
        w * along(row, [k.p for k in stages]),
        eye + w[..., None] * along(row, changes),
        first,
    )


class Nodes(NamedTuple):
    """Ends of the segments, (nodes,), with attitudes (nodes, 4) and moments (nodes, 3)."""

    s: np.ndarray
    h: np.ndarray
    M: np.ndarray


def gaps(rod, nodes):
    """(segments, 6): by how much segments miss the next node; and the march."""
    ends = march(rod, nodes.s[:-1], np.diff(nodes.s), nodes.h[:-1], nodes.M[:-1])
    apart = product(conjugate(nodes.h[1:]), ends.h)
    apart /= np.linalg.norm(apart, axis=-1, keepdims=True)
    miss = np.concatenate([logarithm(apart), ends.M - nodes.M[1:]], -1)
    return miss, ends, apart


def correction(miss, ends, apart):
    """Newton's: turns (nodes, 3) and changes of moments (nodes, 3)."""
    K = len(miss)
    by_end = np.broadcast_to(-np.eye(6), (K, 6, 6)).copy()
    by_end[:, :3, :3] = -np.swapaxes(matrix(apart), -1, -2)
    # Unknown are M_0, then turn and M of each node, then the turn of the last.
    both = np.concatenate([ends.by_start, by_end], -1)
    band = np.zeros((17, 6 * K))
    row = np.arange(6)[:, None] + 6 * np.arange(K)[:, None, None]
    column = np.arange(12) - 3 + 6 * np.arange(K)[:, None, None]
    row, column = np.broadcast_arrays(row, column)
    inside = (column >= 0) & (column < 6 * K)
    band[(8 + row - column)[inside], column[inside]] = both[inside]
    z = solve_banded((8, 8), band, -miss.ravel(), check_finite=True)
    z = np.concatenate([np.zeros(3), z, np.zeros(3)]).reshape(K + 1, 6)
    return z[:, :3], z[:, 3:]


def moved(nodes, turn, change, part=1.0):
    return nodes._replace(h=product(nodes.h, exponential(part * turn)), M=nodes.M + part * change)


def newton(rod, nodes, target=0.0, most=40):
    """Nodes at which segments miss by `target` only; raises `NoAnswer`."""
    unit = np.concatenate([np.ones(3), np.full(3, 1 / (1 + np.max(np.abs(nodes.M))))])
    merit = lambda miss: np.linalg.norm((miss - target) * unit)
    miss, ends, apart = gaps(rod, nodes)
    for _ in range(most):
        turn, change = correction(miss - target, ends, apart)
        largest = np.max(np.abs(turn))
        part = min(1.0, 1.0 / largest) if largest > 0 else 1.0
        for _ in range(12):
            trial = moved(nodes, turn, change, part)
            try:
                new = gaps(rod, trial)
                if merit(new[0]) <= (1 - part / 4) * merit(miss) or merit(new[0]) < 1e-12:
                    break
            except (NoAnswer, np.linalg.LinAlgError):
                pass
            part /= 2
        else:
            if largest < 1e-7 and merit(miss) < 1e-9:
                return nodes, ends  # rounding
            raise NoAnswer("Newton's method stalls")
        nodes, (miss, ends, apart) = trial, new
        if part == 1.0 and largest < 1e-7:
            return nodes, ends
    raise NoAnswer("Newton's method takes too many iterations")


def follow(rod, nodes):
    """As `newton`, but the gaps of the start are closed bit by bit."""
    first, left, step = gaps(rod, nodes)[0], 1.0, 0.5
    while left > 0:
        part = max(0.0, left - step)
        try:
            nodes, ends = newton(rod, nodes, part * first, 10)
            left, step = part, 2 * step
        except (NoAnswer, np.linalg.LinAlgError, ValueError) as stopped:
            step /= 4
            if step < 1e-3:
                raise NoAnswer(f"no way to close the gaps: {1 - left:.3f} of it done") from stopped
    return nodes, ends


# ------------------------------------------------------------------------------ the judgement
def places(rod, s, u, phase):
    """Nodes in [0, 1], `phase` apart in turns and layers, from the strains u (n, 3) at s."""
    pull = np.linalg.norm(rod.force + rod.weight * (1 - s)[:, None], axis=1)
    rate = np.linalg.norm(u, axis=1) + np.sqrt(pull / np.min(rod.k[3:])) + 2.0
    total = cumulative_trapezoid(rate, s, initial=0.0)
    count = int(np.ceil(total[-1] / phase))
    if not count < MOST_SEGMENTS:
        raise NoAnswer(f"{total[-1] / phase:.3g} segments would be needed")
    return np.interp(np.linspace(0, total[-1], count + 1), total, s)


def nodes_from_shape(rod, s, strain, h, phase) -> Nodes:
    """Nodes on the shape of an answer: strains (n, 6) and quaternions (n, 4) at s [m]."""
    at = np.asarray(s, float) / rod.length
    strain, h = np.array(strain, float), np.array(h, float)
    strain[:, 3:] *= rod.length
    fine = np.unique(np.concatenate([np.linspace(a, b, 65) for a, b in zip(at, at[1:])]))
    x = PchipInterpolator(at, strain)(fine)
    # Attitudes from the strains, turned so as to meet those given at s.
    steps = exponential(np.diff(fine)[:, None] * (x[1:, 3:] + x[:-1, 3:]) / 2)
    turned = [rod.h_base]
    for step in steps:
        turned.append(product(turned[-1], step))
    turned = np.array(turned)
    where = np.searchsorted(fine, at)
    off = logarithm(product(conjugate(turned[where]), h))
    off = np.stack([np.interp(fine, at, c) for c in off.T], -1)
    turned = product(turned, exponential(off))
    # Moments from the balance: M(s) = M(1) + int_s^1 p_s x N.
    N = rod.force + rod.weight * (1 - fine)[:, None]
    torque = cumulative_trapezoid(np.cross(times(matrix(turned), x[:, :3]), N), fine, axis=0)
    torque = np.concatenate([np.zeros((1, 3)), torque])
    M = rod.moment + torque[-1] - torque
    s = places(rod, fine, x[:, 3:], phase)
    pick = lambda values: np.stack([np.interp(s, fine, c) for c in values.T], -1)
    h = pick(turned)
    nodes = Nodes(s, h / np.linalg.norm(h, axis=1, keepdims=True), pick(M))
    nodes.h[0], nodes.M[-1] = rod.h_base, rod.moment
    return nodes


def refined(rod, nodes, ends, phase) -> Nodes:
    """Nodes `phase` apart on a solution."""
    u = np.concatenate([ends.x[:, 3:], ends.x[-1:, 3:]])
    s = places(rod, nodes.s, u, phase)
    k = np.clip(np.searchsorted(nodes.s, s, side="right") - 1, 0, len(nodes.s) - 2)
    at = march(rod, nodes.s[k], s - nodes.s[k], nodes.h[k], nodes.M[k])
    fresh = Nodes(s, at.h / np.linalg.norm(at.h, axis=1, keepdims=True), at.M)
    fresh.h[0], fresh.M[-1] = rod.h_base, rod.moment
    return fresh


class Verdict(NamedTuple):
    """`tip` [m]; `error`: of the judge itself, in lengths of the rod; `stretch`: least v3."""

    tip: np.ndarray
    error: float
    segments: int
    stretch: float


def judge(rod: Rod, s, strain, quaternions) -> Verdict:
    """The equilibrium near a shape: strains (v, u), (n, 6), and quaternions (n, 4) at `s` [m].

    Raises `NoAnswer` if Newton's method finds none.
    """
    with np.errstate(all="ignore"):
        try:
            return _judge(rod, s, strain, quaternions)
        except (np.linalg.LinAlgError, ValueError, FloatingPointError) as stopped:
            raise NoAnswer(str(stopped)) from stopped


def _judge(rod, s, strain, quaternions):
    phase = PHASE
    nodes = nodes_from_shape(rod, s, strain, quaternions, phase)
    try:
        nodes, ends = newton(rod, nodes)
    except (NoAnswer, np.linalg.LinAlgError, ValueError):
        nodes, ends = follow(rod, nodes)
    tip = np.sum(ends.p, 0)
    for _ in range(4):
        phase /= 2
        nodes, ends = newton(rod, refined(rod, nodes, ends, phase))
        before, tip = tip, np.sum(ends.p, 0)
        error = float(np.linalg.norm(tip - before))
        if error < 1e-9:
            break
    return Verdict(rod.clamp + rod.length * tip, error, len(ends.p), float(np.min(ends.x[:, 2])))


def judge_answer(scene, answer, tensions=None, pressures=None) -> Verdict:
    """The equilibrium near an answer of the package's `solve_static`."""
    rod = rod_of(scene, tensions, pressures)
    return judge(rod, answer.arc_lengths, answer.strains, answer.quaternions)


def main():
    import jax

    jax.config.update("jax_enable_x64", True)
    import softrod_jax as sr

    parser = argparse.ArgumentParser()
    parser.add_argument("scene")
    numbers = lambda text: np.array([float(part) for part in text.split(",")])
    parser.add_argument("--tensions", type=numbers)
    parser.add_argument("--pressures", type=numbers)
    parser.add_argument("--intervals", type=int)
    options = parser.parse_args()
    scene = sr.load_scene(options.scene)
    inputs = options.tensions, options.pressures
    grid = {} if options.intervals is None else {"method": sr.Collocation(options.intervals)}
    answer = sr.solve_static(scene, *inputs, throw=False, **grid)
    verdict = judge_answer(scene, answer, *inputs)
    tip = np.asarray(answer.tip_position)
    off = np.linalg.norm(tip - verdict.tip) / float(scene.length)
    print(f"answer    {tip}  {sr.RESULTS(int(answer.result)).name}")
    print(f"estimate  {float(answer.stats['error']):.2e} lengths")
    print(f"judge     {verdict.tip}  own error {verdict.error:.1e}, {verdict.segments} segments")
    print(f"error     {off:.2e} lengths")


if __name__ == "__main__":
    main()
