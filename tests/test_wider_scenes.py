"""Robots of segments, tapers, tendon paths, parts of chambers and loads along the rod.

The numbers in `references/wider_static.json` are from independent programs: "equilibria" minimise a
discrete energy (extrapolated, each with its own error), "sorosim" is a part of the equilibria that
the repository ContinuumRoboticsLab/opencr-mujoco (MIT) has from SoRoSim, rounded to 0.1 mm.
"""

import json
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import softrod_jax as sr
from softrod_jax.scene.scene import as_arrays

KNOWN = json.loads((Path(__file__).parent / "references" / "wider_static.json").read_text("utf-8"))
PAPER = dict(
    length=0.1, section=sr.Circle(6e-3), young_modulus=5e4, poisson_ratio=0.49, density=1070.0
)
TAPER = dict(
    length=0.12,
    section=sr.Circle(8e-3),
    section_at_end=sr.Circle(5e-3),
    young_modulus=1e5,
    poisson_ratio=0.49,
    density=1070.0,
    gravity=[-9.81, 0.0, 0.0],
)
ALONG = [0.0, 0.0, 9.81]
FIRST = sr.Segment(
    length=0.06, section=sr.Circle(6e-3), young_modulus=2e5, poisson_ratio=0.49, density=1070.0
)
SECOND = sr.Segment(
    length=0.05, section=sr.Circle(5e-3), young_modulus=8e4, poisson_ratio=0.45, density=1000.0
)
TWO = sr.Scene(
    segments=(FIRST, SECOND),
    gravity=[0.0, -9.81, 0.0],
    tendons=sr.Tendons([[4e-3, 0.0], [0.0, 4e-3]], ends_at=(0.06, None)),
    loads=(sr.Load(at=0.06, force=[0.0, 0.0, 5e-3]),),
)


def with_path(path, **parts):
    return sr.Scene(**parts, tendons=sr.Tendons([[0.0, 0.0]], paths=(path,)))


# Scene, tensions, pressures.
EQUILIBRIA = {
    "taper": (sr.Scene(**TAPER, tendons=sr.Tendons([[3e-3, 0.0]])), [0.4], None),
    "taper_converging": (with_path(sr.Line([3e-3, 0.0], [1.875e-3, 0.0]), **TAPER), [0.4], None),
    "two_segments": (TWO, [0.5, 0.12], None),
    "helix": (with_path(sr.Helix(4e-3, 0.0, 1.0), gravity=ALONG, **PAPER), [0.3], None),
    "part_chamber": (
        sr.Scene(
            **PAPER, gravity=ALONG, chambers=sr.Chambers([7e-6], [[2e-3, 1e-3]], ends_at=(0.06,))
        ),
        None,
        [2e4],
    ),
}


@pytest.mark.parametrize("name", EQUILIBRIA)
def test_independent_equilibria(name):
    scene, tensions, pressures = EQUILIBRIA[name]
    known = KNOWN["equilibria"][name]
    tip = sr.solve_static(scene, tensions, pressures).tip_position
    np.testing.assert_allclose(tip, known["tip"], rtol=0, atol=max(1e-6, known["error"]))


@pytest.mark.parametrize(
    "tendon, tip",
    [
        (dict(offsets=[[15.06e-3, 0.0]]), (0.1822117, 0.0, 0.4532293)),
        (dict(paths=(sr.Helix(15.06e-3, 0.0, 1.0),)), (0.0122099, 0.0581888, 0.4933483)),
        (dict(paths=(sr.Line([15.06e-3, 0.0], [0.0, 0.0]),)), (0.1292735, 0.0, 0.4795202)),
    ],
    ids=["straight", "helix", "converging"],
)
def test_tills_rods(tendon, tip):
    """Steel under one tendon on disks; tips by an independent shooting code."""
    scene = sr.Scene(
        length=0.5,
        section=sr.Circle(1e-3),
        young_modulus=200e9,
        poisson_ratio=0.25,
        density=8000.0,
        gravity=[9.81, 0.0, 0.0],
        tendons=sr.Tendons(**({"offsets": [[0.0, 0.0]]} | tendon), guided="disks"),
    )
    solution = sr.solve_static(scene, [15.0])
    np.testing.assert_allclose(solution.tip_position, tip, rtol=0, atol=2e-7)


@pytest.mark.parametrize("name, most", [("tpu", 3e-4), ("steel", 5e-4)])
def test_wrenches_at_the_middle_in_one_batch(name, most):
    rod, stations = KNOWN["sorosim"][name]["rod"], jnp.array(KNOWN["sorosim"][name]["stations"])
    shapes = KNOWN["sorosim"][name]["shapes"]
    keys = "gravity", "mid_force", "mid_moment", "tip_force", "tip_moment"
    loads = [np.array([shape[key] for shape in shapes]) for key in keys]

    @jax.jit
    @jax.vmap
    def solved(gravity, force, moment, tip_force, tip_moment):
        scene = sr.Scene(
            length=rod["L"],
            section=sr.Circle(rod["radius"]),
            young_modulus=rod["young_modulus"],
            poisson_ratio=rod["poisson_ratio"],
            density=rod["density"],
            gravity=gravity,
            loads=(sr.Load(at=rod["L"] / 2, force=force, moment=moment),),
            tip_load=sr.TipLoad(tip_force, tip_moment),
        )
        solution = sr.solve_static(scene, throw=False)
        return jax.vmap(lambda s: solution.at(s).position)(stations), solution.result

    positions, results = solved(*loads)
    assert not np.any(results)
    known = np.array([shape["positions"] for shape in shapes])
    assert np.linalg.norm(positions - known, axis=-1).max() < most


def test_a_release_from_sorosim():
    """Held by wrenches at the middle and the tip, and let go: both are followed for half a second.

    The one number that the data give for damping is B / K [s]: with it the motion agrees to the
    rounding of the loads, and of 5 % more or less it is twice as far off.
    """
    path = Path(__file__).parent / "references" / "release.json"
    known = json.loads(path.read_text("utf-8"))
    rod = KNOWN["sorosim"]["tpu"]["rod"]
    E, r, L = rod["young_modulus"], rod["radius"], rod["L"]
    I, A, G = np.pi * r**4 / 4, np.pi * r**2, E / (2 * (1 + rod["poisson_ratio"]))

    def scene(damping, held):
        part = lambda name: held * np.array(known[name])
        return sr.Scene(
            length=L,
            section=sr.Circle(r),
            young_modulus=E,
            poisson_ratio=rod["poisson_ratio"],
            density=rod["density"],
            gravity=known["gravity"],
            bending_damping=damping * np.array([E * I, E * I, 2 * G * I]),
            shear_damping=damping * np.array([G * A, G * A, E * A]),
            loads=(sr.Load(at=L / 2, force=part("mid_force"), moment=part("mid_moment")),),
            tip_load=sr.TipLoad(part("tip_force"), part("tip_moment")),
            markers=(sr.Marker("middle", L / 2),),
        )

    @jax.jit
    def motion(damping):
        method = sr.Collocation(12)
        start = sr.solve_static(scene(damping, 1.0), method=method, throw=False)
        moved = sr.simulate(scene(damping, 0.0), 5e-3, steps=100, initial=start, throw=False)
        return moved.markers["middle"].positions, moved.tip_positions

    off = lambda a, b: np.sqrt(np.mean(np.sum((np.array(a) - np.array(b)) ** 2, axis=1)))
    middle, tip = motion(known["damping"])
    distance = off(tip, known["tip"])
    assert off(middle, known["middle"]) < 2e-4 and distance < 3e-4
    for factor in (0.95, 1.05):
        assert off(motion(factor * known["damping"])[1], known["tip"]) > 2 * distance


def test_derivatives_by_places_and_lengths():
    """Forward, reverse and central differences, where a segment, a tendon and a load end."""
    # Apart from each other, so that each can move by itself.
    scene = as_arrays(
        eqx.tree_at(lambda s: (s.loads[0].at, s.tendons.ends_at[0]), TWO, (0.03, 0.08))
    )
    method = sr.Collocation(24).fitted(scene)
    pick = lambda s: (s.segments[0].length, s.loads[0].at, s.tendons.ends_at[0])

    @jax.jit
    def tip(x):
        moved = eqx.tree_at(pick, scene, tuple(a * b for a, b in zip(x, pick(scene))))
        return sr.solve_static(moved, [0.5, 0.12], method=method, throw=False).tip_position

    one, d = jnp.ones(3), 1e-4
    forward, reverse = jax.jit(jax.jacfwd(tip))(one), jax.jit(jax.jacrev(tip))(one)
    slopes = [(tip(one + d * e) - tip(one - d * e)) / (2 * d) for e in jnp.eye(3)]
    assert np.abs(forward).max(axis=0).min() > 1e-4
    np.testing.assert_allclose(forward, reverse, rtol=0, atol=1e-10)
    np.testing.assert_allclose(forward, np.stack(slopes, 1), rtol=0, atol=1e-7)


def test_places_that_are_traced_give_the_same():
    """Their order is not known then, and which of them are one."""
    known = sr.solve_static(TWO, [0.5, 0.12]).tip_position
    traced = jax.jit(lambda scene: sr.solve_static(scene, [0.5, 0.12], throw=False))
    solution = traced(as_arrays(TWO))
    assert int(solution.result) == 0
    np.testing.assert_allclose(solution.tip_position, known, rtol=0, atol=2e-6)


@pytest.mark.long
def test_parts_that_change_nothing_change_nothing():
    """A uniform rod cut into segments, with a mass of nothing and tendons in two halves."""
    robot = as_arrays(sr.Scene(**PAPER, gravity=ALONG, tendons=sr.Tendons([[4e-3, 0.0]])))
    parts = {k: PAPER[k] for k in ("section", "young_modulus", "poisson_ratio", "density")}
    cut = sr.Scene(
        segments=tuple(sr.Segment(length=x, **parts) for x in (0.03, 0.07)),
        gravity=ALONG,
        tendons=sr.Tendons([[4e-3, 0.0]] * 2, starts_at=(None, 0.045), ends_at=(0.045, None)),
        masses=(sr.Mass(at=0.08, mass=0.0),),
    )
    pulls = jnp.array([0.2])
    still = [sr.solve_static(robot, pulls), sr.solve_static(cut, [0.2, 0.2])]
    np.testing.assert_allclose(still[0].tip_position, still[1].tip_position, rtol=0, atol=1e-9)
    rows = jnp.tile(pulls, (8, 1))
    moving = [
        sr.simulate(robot, 5e-3, rows, substeps=1, max_time_error=0.5),
        sr.simulate(cut, 5e-3, jnp.tile(rows, (1, 2)), substeps=1, max_time_error=0.5),
    ]
    np.testing.assert_allclose(moving[0].tip_positions, moving[1].tip_positions, rtol=0, atol=2e-6)


@pytest.mark.long
def test_loads_and_masses_at_the_tip_are_those_of_the_tip():
    force, moment = np.array([0.004, 0.002, 0.001]), np.array([1e-4, -1e-4, 2e-4])
    at_tip = sr.Scene(
        **PAPER,
        gravity=[0.0, -3.0, 9.0],
        tip_load=sr.TipLoad(force, moment),
        payload=sr.Payload(2e-3),
    )
    along = sr.Scene(
        **PAPER,
        gravity=[0.0, -3.0, 9.0],
        loads=(sr.Load(at=0.1, force=force, moment=moment),),
        masses=(sr.Mass(at=0.1, mass=2e-3),),
    )
    still = [sr.solve_static(x).tip_position for x in (at_tip, along)]
    np.testing.assert_allclose(still[0], still[1], rtol=0, atol=1e-9)
    run = lambda x: sr.simulate(x, 4e-3, steps=8, substeps=1, max_time_error=0.5).tip_positions
    np.testing.assert_allclose(run(at_tip), run(along), rtol=0, atol=1e-9)


def test_markers_are_where_the_rod_is():
    """Rolled up to an arc by a moment at the tip: a circle's points, and an offset across it."""
    EI = 5e4 * np.pi * 6e-3**4 / 4
    u, s = 8.0, 0.037
    scene = sr.Scene(
        **PAPER,
        tip_load=sr.TipLoad(moment=[0.0, EI * u, 0.0]),
        markers=(sr.Marker("m1", s), sr.Marker("side", s, [2e-3, 0.0, 0.0])),
    )
    solution = sr.solve_static(scene)
    arc = np.array([(1 - np.cos(u * s)) / u, 0.0, np.sin(u * s) / u])
    across = 2e-3 * np.array([np.cos(u * s), 0.0, -np.sin(u * s)])
    np.testing.assert_allclose(solution.markers["m1"].position, arc, rtol=0, atol=1e-9)
    np.testing.assert_allclose(solution.markers["side"].position, arc + across, atol=1e-9)
    np.testing.assert_allclose(solution.markers["tip"].position, solution.tip_position)
    np.testing.assert_allclose(solution.at(s).position, arc, rtol=0, atol=1e-9)
