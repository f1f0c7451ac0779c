"""The article's robot, solved: limits, moduli, experiments, motions, loads at the tip.

Numbers in `TABLE_1` and `TABLE_2` are the article's; `ASSUMED` is what it does not say.
"""

import dataclasses
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

import softrod_jax as sr

TABLE_1 = {  # SI units
    "Backbone radius": 6e-3,
    "Air chamber diameter": 3e-3,
    "Tendon passages diameter": 1.5e-3,
    "Tendons offset": 4e-3,
    "Young's modulus": 0.05e6,
    "Density": 1070.0,
    "Poisson's ratio": 0.49,
    "Viscous damping coefficients (bt)": 1e-6,
    "Drag damping coefficient": 0.03,
    "Time increment": 0.015,
    "Coefficient of BDF-alpha method": -0.2,
}
TABLE_2 = {"P": np.array([0.0, 10.0, 20.0, 30.0, 40.0]) * 1e3, "tension": 3.0}  # Pa, N
FIGURE_6_PRESSURE = 10e3  # Pa

ASSUMED = {
    "length": 0.1,  # m
    "pull": 2.0,  # s, a tension's rise from nothing, and its fall
    "pause": 0.5,  # s, between two pulls, and the rise of the pressure
    "gravity": 9.81,  # m/s^2
}

PRINTED_E, HIGHEST = TABLE_1["Young's modulus"], TABLE_2["tension"]


class Size(NamedTuple):
    """How much is computed."""

    workspace: int = 21  # tensions of each tendon
    cube: int = 1000  # random tensions at the printed modulus
    levels: int = 31  # tensions of an experiment
    loads: bool = True  # gravity, and forces at the tip
    method: sr.Collocation = sr.Collocation(12, order=6)


FULL = Size()
QUICK = Size(5, 20, 7, False, sr.Collocation(6, order=6))
CHUNK = 128  # samples of one program, whatever the size of a batch


def solid():
    """A and I of the article's section: a full circle."""
    section = sr.Circle(TABLE_1["Backbone radius"])
    return float(section.area), float(section.second_moments[0])


def net():
    """A and I without the chamber and the tendons' passages."""
    area, moment = solid()
    chamber, passage = (TABLE_1[f"{x} diameter"] / 2 for x in ("Air chamber", "Tendon passages"))
    area -= np.pi * (chamber**2 + 3 * passage**2)
    moment -= np.pi / 4 * (chamber**4 + 3 * passage**4)
    # Of the three passages, the mean of x^2 is half the offset's square.
    moment -= 3 * np.pi * passage**2 * TABLE_1["Tendons offset"] ** 2 / 2
    return area, moment


class Rest(NamedTuple):
    tip: np.ndarray
    positions: np.ndarray
    quaternions: np.ndarray
    strains: np.ndarray
    result: np.ndarray


class Statics:
    """Equilibria without gravity, any number at once, by one compiled program."""

    def __init__(self, method):
        robot = sr.hybrid_robot()

        def solve(E, section, tensions, pressure, length):
            A, I = section
            section = sr.GeneralSection(A, I * jnp.ones(2), 2 * I)
            scene = dataclasses.replace(robot, young_modulus=E, section=section, length=length)
            x = sr.solve_static(scene, tensions, pressure[None], method=method, throw=False)
            return Rest(x.tip_position, x.positions, x.quaternions, x.strains, x.result)

        self._solve = jax.jit(jax.vmap(solve))

    def __call__(self, E, tensions, pressure, section=None, length=ASSUMED["length"]) -> Rest:
        """All arguments broadcast; `tensions` has the three tendons in its last axis."""
        section = np.array(solid() if section is None else section)
        tensions = np.asarray(tensions, float)
        shape = np.broadcast_shapes(
            np.shape(E), tensions.shape[:-1], np.shape(pressure), np.shape(length)
        )
        rows = lambda x, *last: np.broadcast_to(x, (*shape, *last)).reshape(-1, *last)
        columns = rows(E), rows(section, 2), rows(tensions, 3), rows(pressure), rows(length)
        missing = -len(columns[0]) % CHUNK
        columns = [np.concatenate([x, x[:1].repeat(missing, 0)]) for x in columns]
        columns[2][len(columns[2]) - missing :] = 0.0  # unloaded: solved at once
        parts = [
            self._solve(
                columns[0][k], tuple(columns[1][k].T), columns[2][k], columns[3][k], columns[4][k]
            )
            for k in np.arange(len(columns[0])).reshape(-1, CHUNK)
        ]
        out = [np.concatenate([np.asarray(part) for part in x]) for x in zip(*parts, strict=True)]
        return Rest(*(x[: len(x) - missing].reshape(*shape, *x.shape[1:]) for x in out))


def threshold(holds, low, high, rounds=4, points=17):
    """Where `holds(values)` turns from false at `low` to true at `high`, each an array."""
    low, high = (np.array(x, float) for x in np.broadcast_arrays(low, high))
    for _ in range(rounds):
        values = np.linspace(low, high, points)
        first = np.argmax(np.array(holds(values), bool) | (values == high), axis=0)
        pick = lambda k: np.take_along_axis(values, k[None], 0)[0]  # noqa: B023
        low, high = pick(np.maximum(first - 1, 0)), pick(first)
    return high


def one_by_one(tension):
    """Tensions (3, .., 3): each tendon alone."""
    return (
        np.asarray(tension, float)[..., None] * np.eye(3)[(slice(None), *[None] * np.ndim(tension))]
    )


def strongest_pull(statics, pressures):
    """The largest tension of one tendon with an equilibrium at the printed E [N]."""

    def fails(tension):
        return statics(PRINTED_E, one_by_one(tension)[0], pressures).result != 0

    return threshold(fails, np.zeros(len(pressures)), HIGHEST)


def smallest_modulus(statics, count, section, pressure):
    """The smallest E [Pa] with an equilibrium for `count` tendons at the highest tension."""
    tensions = HIGHEST * (np.arange(3) < count)

    def holds(E):
        return statics(E, tensions, pressure, section).result == 0

    return float(threshold(holds, PRINTED_E / 2, 4 * PRINTED_E))


def monotone_modulus(statics):
    """The smallest E [Pa] at which the tip moves along x up to the highest tension.

    Softer, it comes back before 3 N: the rod curls up.
    """
    # Below, with several turns, the tip goes to and fro: search from where a turn is a half.
    return float(threshold(lambda E: moves_out(statics, E), 6 * PRINTED_E, 20 * PRINTED_E))


def monotone_length(statics, E, curvature):
    """The longest robot [m] of which the tip does so, for each E [Pa]; curvatures at 3 N [1/m]."""
    comes_back = lambda length: ~moves_out(statics, E, length)
    return threshold(comes_back, 0.5 / curvature, 4 / curvature)


def moves_out(statics, E, length=ASSUMED["length"]):
    """Whether the tip moves along x with one tendon's tension, at 3 N and 10 kPa."""
    less, more = (
        statics(E, one_by_one(tension)[0], FIGURE_6_PRESSURE, length=length)
        for tension in HIGHEST * np.array([1 - 1e-4, 1 + 1e-4])
    )
    return (more.tip[..., 0] > less.tip[..., 0]) & (more.result == 0)


def schedule(dt):
    """Times [s], tensions (steps, 3) [N] and the pressure's part (steps,) of one row of Table 2."""
    pull, pause = ASSUMED["pull"], ASSUMED["pause"]
    period = 2 * pull + pause
    t = dt * np.arange(1, round((pause + 3 * period) / dt) + 1)
    since = t[:, None] - pause - period * np.arange(3)
    phase = np.clip(since / (2 * pull), 0, 1)
    return t, HIGHEST * np.sin(np.pi * phase) ** 2, np.clip(t / pause, 0, 1)


def motions(E, pressures, dt, scheme, method):
    """The tendons pulled in turn at each pressure: tips (pressures, steps + 1, 3) [m]."""
    robot = dataclasses.replace(sr.hybrid_robot(ASSUMED["length"]), young_modulus=E)
    _, tensions, part = schedule(dt)

    def move(pressure):
        air = pressure * jnp.asarray(part)[:, None]
        options = dict(scheme=scheme, method=method, max_time_error=jnp.inf)
        return sr.simulate(robot, dt, jnp.asarray(tensions), air, **options)

    trajectories = jax.vmap(move)(jnp.asarray(pressures))
    return np.asarray(trajectories.ts[0]), np.asarray(trajectories.tip_positions)


def hysteresis(ts, tips):
    """Largest distance [m] of the tip on the way up from the way down, at equal tension."""
    largest = 0.0
    for i in range(3):
        middle = ASSUMED["pause"] + ASSUMED["pull"] + i * (2 * ASSUMED["pull"] + ASSUMED["pause"])
        offsets = np.linspace(0, ASSUMED["pull"], 200)
        at = lambda t, tip: np.stack([np.interp(t, ts, x) for x in tip.T], axis=1)
        for tip in tips:
            gap = np.linalg.norm(at(middle - offsets, tip) - at(middle + offsets, tip), axis=1)
            largest = max(largest, gap.max())
    return largest


class Loaded:
    """Equilibria with gravity along the rod and a force at the tip, and the tip's compliance."""

    def __init__(self, method):
        def tip(force, E, length, gravity, tensions, pressure):
            scene = dataclasses.replace(
                sr.hybrid_robot(length, gravity * jnp.array([0.0, 0.0, 1.0])),
                young_modulus=E,
                tip_load=sr.TipLoad(force=force),
            )
            x = sr.solve_static(scene, tensions, pressure[None], method=method, throw=False)
            return x.tip_position, (x.tip_position, x.result, x.stats["stable"])

        self._solve = jax.jit(jax.vmap(jax.jacfwd(tip, has_aux=True)))

    def __call__(self, force, E, length, gravity, tensions, pressure, size=17):
        """(compliance [m/N], (tip [m], result, stable)); a row for each of `size` samples."""
        rows = lambda x, *last: jnp.broadcast_to(jnp.asarray(x, float), (size, *last))
        arguments = rows(force, 3), rows(E), rows(length), rows(gravity), rows(tensions, 3)
        return jax.tree.map(np.asarray, self._solve(*arguments, rows(pressure)))


def blocked_force(loaded, E):
    """The force [N] across the tip that holds it on the axis against one tendon at 3 N.

    By Newton's method, while the tension rises; NaN where that fails.
    """
    force = np.zeros(3)
    for tension in np.linspace(0, HIGHEST, 9)[1:]:
        for _ in range(8):
            pull = tension * np.eye(3)[0]
            compliance, (tip, result, _) = loaded(force, E, ASSUMED["length"], 0.0, pull, 0.0)
            if result[0] != 0:
                return np.nan
            change = -tip[0, 0] / compliance[0, 0, 0]
            force = force + np.array([change, 0, 0])
            if abs(change) < 1e-6:
                break
        else:
            return np.nan
    return -force[0]


class Study(NamedTuple):
    """All that was computed, for the table and the figures."""

    printed_E: float
    length: float
    radius: float
    offset: float
    limits: np.ndarray  # (pressures,) N, of one tendon at the printed E
    moduli: dict  # smallest E [Pa] by what it allows
    stated_E: float
    levels: np.ndarray  # (levels,) N
    printed: Rest  # (tendons, pressures, levels): the experiments at the printed E
    stated: Rest  # and at the stated E
    cube_share: float  # of all tensions up to 3 N, with an equilibrium at the printed E
    workspace: Rest  # (n, n, n), at the stated E
    ts: np.ndarray
    tips: np.ndarray  # (pressures, times, 3)
    step_error: float  # m, of the printed step and scheme; NaN in quick mode
    bending: tuple  # moduli [Pa]; curvature [1/m] of one tendon at 3 N; `monotone_length` [m]
    weak_gaps: np.ndarray  # (pressures,) m, tips of the printed E under a part of the tension
    loads: dict  # gravity, stiffness, contact force; empty in quick mode


def study(size: Size = FULL) -> Study:
    statics = Statics(size.method)
    pressures = TABLE_2["P"]
    limits = strongest_pull(statics, pressures)
    moduli = {
        (count, name): smallest_modulus(statics, count, section, 0.0)
        for name, section in (("solid", solid()), ("net", net()))
        for count in (1, 2, 3)
    }
    E = monotone_modulus(statics)
    levels = np.linspace(0, HIGHEST, size.levels)
    tensions = one_by_one(np.broadcast_to(levels, (len(pressures), size.levels)))
    printed, stated = (statics(x, tensions, pressures[:, None]) for x in (PRINTED_E, E))
    cube = HIGHEST * np.random.default_rng(0).uniform(size=(size.cube, 3))
    cube_share = float(np.mean(statics(PRINTED_E, cube, FIGURE_6_PRESSURE).result == 0))
    grid_E = np.geomspace(1.01 * moduli[1, "solid"], 24 * PRINTED_E, 40)
    bent = statics(grid_E, one_by_one(HIGHEST)[0], 0.0)
    curvature = np.linalg.norm(bent.strains[:, 0, 3:], axis=-1)
    bending = grid_E, curvature, monotone_length(statics, grid_E, curvature)
    axis = np.linspace(0, HIGHEST, size.workspace)
    grid = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1)
    workspace = statics(E, grid, FIGURE_6_PRESSURE)
    weak = statics(PRINTED_E, one_by_one(HIGHEST * PRINTED_E / E)[0], pressures)
    weak_gaps = np.linalg.norm(weak.tip - stated.tip[0, :, -1], axis=-1)
    scheme = sr.BDFAlpha(TABLE_1["Coefficient of BDF-alpha method"])
    dt = TABLE_1["Time increment"]
    ts, tips = motions(E, pressures, dt, scheme, size.method)
    step_error, loads = np.nan, {}
    if size.loads:
        fine = motions(E, pressures, dt, sr.SDIRK(4), size.method)[1]
        step_error = np.linalg.norm(tips - fine, axis=-1).max()
        loads = tip_loads(E, size.method)
    return Study(
        PRINTED_E, ASSUMED["length"], TABLE_1["Backbone radius"], TABLE_1["Tendons offset"],
        limits, moduli, E, levels, printed, stated, cube_share, workspace,
        ts, tips, step_error, bending, weak_gaps, loads,
    )  # fmt: skip


def tip_loads(E, method) -> dict:
    """Gravity, stiffness across the tip, and the force of a tip that is held, at modulus E."""
    loaded, length, g = Loaded(method), ASSUMED["length"], ASSUMED["gravity"]
    pull = HIGHEST * np.eye(3)[0]
    none, zero = np.zeros(3), np.zeros(3)
    pressures = np.resize(TABLE_2["P"], 17)
    compliance, _ = loaded(zero, E, length, 0.0, none, pressures)
    stiffness = 1 / compliance[:5, 0, 0]
    soft, _ = loaded(zero, PRINTED_E, length, 0.0, none, pressures)
    _, (hanging, *_) = loaded(zero, E, length, [g, 0.0, -g] + 14 * [0.0], pull, FIGURE_6_PRESSURE)
    upright = {
        modulus: float(
            threshold(
                lambda L: ~loaded(zero, modulus, L, -g, none, 0.0)[1][2],  # noqa: B023
                length / 10,
                4 * length,
            )
        )
        for modulus in (PRINTED_E, E)
    }
    return {
        "stiffness": stiffness,
        "printed stiffness": 1 / soft[:5, 0, 0],
        "hanging": np.linalg.norm(hanging[0] - hanging[1]),
        "upright": np.linalg.norm(hanging[2] - hanging[1]),
        "upright length": upright,
        "blocked": blocked_force(loaded, E),
    }
