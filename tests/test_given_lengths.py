"""Tendons driven by their length: tensions that follow from pulls, and tendons that go slack.

"equilibria" in `references/wider_static.json` are by an independent program that minimises a
discrete energy.
"""

import dataclasses
import json
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import softrod_jax as sr
from softrod_jax.scene.scene import as_arrays

KNOWN = json.loads((Path(__file__).parent / "references" / "wider_static.json").read_text("utf-8"))
OFFSETS = 4e-3 * np.array([[1.0, 0.0], [-0.5, 0.75**0.5], [-0.5, -(0.75**0.5)]])
PAPER = sr.Scene(
    length=0.1,
    section=sr.Circle(6e-3),
    young_modulus=5e4,
    poisson_ratio=0.49,
    density=1070.0,
    bending_damping=1e-6,
)


def driven(scene=PAPER, offsets=OFFSETS, **more):
    tendons = {k: more.pop(k) for k in ("stiffness", "pretension", "ends_at", "paths") if k in more}
    return dataclasses.replace(
        scene, tendons=sr.Tendons(offsets, control="length", **tendons), **more
    )


HELD = driven(gravity=[-3.0, 0.0, 9.81])
ELASTIC = driven(stiffness=(200.0,) * 3)


@pytest.mark.parametrize(
    "name, scene, pulls",
    [
        ("length_inextensible", HELD, [6e-3, 0.0, 0.0]),
        ("length_elastic", ELASTIC, [5e-3, 1e-3, -2e-3]),
    ],
)
def test_independent_equilibria(name, scene, pulls):
    known = KNOWN["equilibria"][name]
    solution = sr.solve_static(scene, pulls=pulls)
    np.testing.assert_allclose(solution.tip_position, known["tip"], rtol=0, atol=1e-7)
    np.testing.assert_allclose(solution.tensions, known["tensions"], rtol=1e-7)
    slack = np.array(known["tensions"]) == 0
    assert np.any(slack) and np.all(np.asarray(solution.tensions)[slack] == 0)


TWO = sr.Scene(
    segments=(
        sr.Segment(length=0.06, section=sr.Circle(6e-3), young_modulus=2e5),
        sr.Segment(length=0.05, section=sr.Circle(5e-3), young_modulus=8e4),
    ),
    poisson_ratio=0.49,
    density=1070.0,
    gravity=[0.0, 0.0, -5.0],
    tendons=sr.Tendons(
        [[5e-3, 0.0], [-3e-3, 4e-3], [0.0, -4e-3], [0.0, 0.0]],
        ends_at=(0.06, 0.06, None, None),
        paths=(None, None, None, sr.Helix(4e-3, 0.5, 0.4)),
    ),
)


def drawn(rng):
    """A two-segment robot, and tensions for it."""
    moduli = rng.uniform(0.5, 2.0, 2)
    segments = tuple(
        dataclasses.replace(x, young_modulus=x.young_modulus * k)
        for x, k in zip(TWO.segments, moduli)
    )
    scene = dataclasses.replace(TWO, segments=segments, gravity=rng.uniform(-9.81, 9.81, 3))
    return as_arrays(scene), jnp.array(rng.uniform(0.0, 0.25, 4))


@pytest.fixture(scope="module")
def there_and_back():
    """Solve with tensions, read the lengths, solve with these lengths, for 12 robots.

    Only the first solve is asked for more than Newton's tolerance.
    """
    rng = np.random.default_rng(5)
    samples = [drawn(rng) for _ in range(12)]
    scenes, tensions = jax.tree.map(lambda *x: jnp.stack(x), *samples)

    def both(scene, tensions):
        strict = sr.NewtonOptions(tolerance=1e-13)
        there = sr.solve_static(scene, tensions, newton=strict, throw=False)
        pulls = sr.tendon_pulls(scene, there)
        tendons = dataclasses.replace(scene.tendons, control="length")
        scene = dataclasses.replace(scene, tendons=tendons)
        return there, sr.solve_static(scene, pulls=pulls, throw=False)

    return tensions, *jax.jit(jax.vmap(both))(scenes, tensions)


def test_pull_and_tension_are_inverse_to_each_other(there_and_back):
    tensions, there, back = there_and_back
    solved = np.asarray((there.result == 0) & (back.result == 0))
    assert solved.sum() >= 11
    # A tenth of what Newton's tolerance would leave here without the last correction.
    largest = np.max(tensions, axis=1, keepdims=True)
    off = np.abs(back.tensions - tensions)[solved] / largest[solved]
    np.testing.assert_array_less(off, 1e-11)
    moved = back.tip_position[solved] - there.tip_position[solved]
    np.testing.assert_allclose(moved, 0.0, atol=1e-9)


def test_a_tendon_that_ends_later_bends_both_segments():
    """Where it acts alone, a tension tau bends each by tau r / EI; held, the first bends less."""
    tendons = dataclasses.replace(TWO.tendons, control="length")
    scene = dataclasses.replace(TWO, gravity=None, tendons=tendons)
    free = sr.solve_static(scene, pulls=[-0.01, -0.01, 3e-3, -0.01])
    tension, r = float(free.tensions[2]), 4e-3
    assert np.all(free.tensions[jnp.array([0, 1, 3])] == 0) and tension > 0
    for at, segment in ((0.03, TWO.segments[0]), (0.085, TWO.segments[1])):
        EI = segment.young_modulus * np.pi * segment.section.radius**4 / 4
        EA = segment.young_modulus * np.pi * segment.section.radius**2
        k = int(np.argmin(np.abs(np.asarray(free.arc_lengths) - at)))
        # About x, towards -y; the tendon runs along the rod that it shortens.
        np.testing.assert_allclose(abs(free.strains[k, 3]), tension * r / EI, rtol=1e-9)
        np.testing.assert_allclose(free.strains[k, 2], 1 - tension / EA, rtol=1e-9)
    pulls = np.array([0.0, 0.0, 3e-3, -0.01])
    held = sr.solve_static(scene, pulls=pulls)
    taut = np.asarray(held.tensions) > 0
    np.testing.assert_allclose(sr.tendon_pulls(scene, held)[taut], pulls[taut], atol=1e-12)
    assert taut[1] and np.all(sr.tendon_pulls(scene, held)[~taut] > pulls[~taut])
    bend = lambda solution: abs(float(solution.at(0.06).position[1]))
    assert held.tensions[2] > tension and bend(held) < 0.9 * bend(free)


def of_statics(modulus, pulls, scene=HELD):
    solution = sr.solve_static(dataclasses.replace(scene, young_modulus=modulus), pulls=pulls)
    return jnp.concatenate([10 * solution.tip_position, solution.tensions])


def of_motions(modulus, pulls):
    scene = dataclasses.replace(HELD, young_modulus=modulus)
    rows = pulls * jnp.array([0.2, 0.4, 0.7])[:, None]
    motion = sr.simulate(scene, 4e-3, pulls=rows, max_time_error=1.0)
    return jnp.concatenate([10 * motion.tip_positions[-1], motion.tensions[-1]])


@pytest.mark.parametrize("function", [of_statics, of_motions])
def test_derivatives_by_modulus_and_pulls(function):
    # The motion has none near 4e-3: there a tendon of it is about to become taut.
    second = 4e-3 if function is of_statics else 1e-3
    at = jnp.array(5e4), jnp.array([6e-3, second, -2e-3])
    function = jax.jit(function)
    forward = jax.jit(jax.jacfwd(function, (0, 1)))(*at)
    reverse = jax.jit(jax.jacrev(function, (0, 1)))(*at)
    steps = 5.0, 1e-6
    by_modulus = (function(at[0] + steps[0], at[1]) - function(at[0] - steps[0], at[1])) / 10.0
    by_pulls = [
        (function(at[0], at[1] + e) - function(at[0], at[1] - e)) / (2 * steps[1])
        for e in steps[1] * np.eye(3)
    ]
    for a, b, c in zip(forward, reverse, (by_modulus, jnp.stack(by_pulls, 1)), strict=True):
        size = np.abs(c).max()
        assert size > 0
        np.testing.assert_allclose(a, b, rtol=0, atol=1e-10 * size)
        np.testing.assert_allclose(a, c, rtol=0, atol=1e-6 * size)


@pytest.mark.long
def test_the_other_method_agrees():
    method = sr.Shooting(segments=2, steps=12)
    shot = sr.solve_static(HELD, pulls=[6e-3, 0.0, 0.0], method=method)
    known = KNOWN["equilibria"]["length_inextensible"]
    np.testing.assert_allclose(shot.tip_position, known["tip"], atol=1e-7)
    np.testing.assert_allclose(shot.tensions, known["tensions"], rtol=1e-7)


def test_in_a_plane_and_without_stretch():
    """The only tendon of three that is not slack holds a rod in its plane just so."""
    known, one = KNOWN["equilibria"]["length_inextensible"], driven(offsets=OFFSETS[:1])
    flat = dataclasses.replace(one, plane="xz", gravity=[-3.0, 0.0, 9.81])
    solution = sr.solve_static(flat, pulls=[6e-3])
    np.testing.assert_allclose(solution.tip_position, known["tip"], atol=1e-7)
    np.testing.assert_allclose(solution.tensions, known["tensions"][:1], rtol=1e-7)
    # A circle's arc: the tendon's moment tau r is EI d / (r L).
    flat = dataclasses.replace(one, plane="xz", inextensible=True)
    solution = sr.solve_static(flat, pulls=[6e-3])
    EI, r = 5e4 * np.pi * 6e-3**4 / 4, 4e-3
    np.testing.assert_allclose(solution.tensions, EI * 6e-3 / (r**2 * 0.1), rtol=1e-9)


@pytest.mark.parametrize("stiffness", [None, (300.0,) * 3])
def test_pretension_is_the_tension_at_pull_zero(stiffness):
    scene = driven(pretension=(0.1, 0.05, None), stiffness=stiffness)
    solution = sr.solve_static(scene, pulls=[0.0, 0.0, 0.0])
    np.testing.assert_allclose(solution.tensions[:2], [0.1, 0.05], rtol=1e-8)
    assert solution.tensions[2] >= 0


def test_tendons_that_hold_the_same_share():
    """Four in one section, pulled alike: pure shortening by the sum of their tensions."""
    cross = 4e-3 * np.array([[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0]])
    solution = sr.solve_static(driven(offsets=cross), pulls=[1e-3] * 4)
    area = np.pi * 6e-3**2
    np.testing.assert_allclose(solution.tensions, 0.01 * 5e4 * area / 4, rtol=1e-6)
    np.testing.assert_allclose(solution.tip_position, [0, 0, 0.099], atol=1e-12)


def test_what_cannot_be_is_said_and_spoils_nothing_else():
    """A rod that does not stretch cannot have all its tendons shorter."""
    scene = driven(inextensible=True)
    rows = jnp.array([[6e-3, 0.0, 0.0], [4e-3, -4e-3, -4e-3], [jnp.nan, 0.0, 0.0]])

    def tip(pulls):
        solution = sr.solve_static(scene, pulls=pulls, throw=False)
        return solution.tip_position @ jnp.array([1.0, 2.0, 3.0]), solution.result

    slopes, results = jax.jit(jax.vmap(jax.grad(tip, has_aux=True)))(rows)
    assert results[1] == 0 and results[2] == sr.RESULTS.bad_input
    assert results[0] in (sr.RESULTS.diverged, sr.RESULTS.no_equilibrium)
    assert np.all(np.isfinite(slopes)) and np.any(slopes[1] != 0)
    assert np.all(slopes[jnp.array([0, 2])] == 0)


def test_lengths_hold_a_column_that_tensions_do_not():
    """Three tendons without slack keep the tip's section level: the column buckles sideways only.

    Under its own weight, a clamped column buckles at rho A g L^3 / EI = 7.837 and one whose tip may
    move but not turn at 18.96 (Greenhill; zeros of Bessel functions of order -1/3 and -2/3).
    """
    EI, weight = 5e4 * np.pi * 6e-3**4 / 4, 1070.0 * np.pi * 6e-3**2 * 0.1**3
    heavy = lambda load: [1e-7, 0.0, -load * EI / weight]
    pulls = [1e-3] * 3
    for load, by_tensions, by_lengths in [
        (5.0, True, True),
        (11.0, False, True),
        (25.0, False, False),
    ]:
        held = driven(pretension=None, gravity=heavy(load))
        solution = sr.solve_static(held, pulls=pulls, throw=False)
        straight = abs(float(solution.tip_position[0])) < 1e-4
        assert (straight and bool(solution.stats["stable"])) == by_lengths, load
        if not straight:
            continue
        loose = dataclasses.replace(held, tendons=sr.Tendons(OFFSETS))
        same = sr.solve_static(loose, solution.tensions, throw=False)
        straight = abs(float(same.tip_position[0])) < 1e-4
        assert (straight and bool(same.stats["stable"])) == by_tensions, load


def test_a_tendon_let_go_is_slack_and_caught_again():
    """Released from an equilibrium, the rod swings through; no tension is ever below zero."""
    scene = driven(offsets=OFFSETS[:2], gravity=[0.0, 0.0, 9.81])
    begin = sr.solve_static(scene, pulls=[8e-3, -5e-3])
    rows = np.tile([-1e-3, -1e-3], (60, 1))
    go = jax.jit(lambda rows: sr.simulate(scene, 4e-3, pulls=rows, initial=begin, throw=False))
    motion = go(rows)
    assert motion.result in (0, sr.RESULTS.inaccurate)
    tensions = np.asarray(motion.tensions)
    np.testing.assert_allclose(tensions[0], begin.tensions)
    assert np.all(tensions >= 0) and tensions[0, 0] > 0.1
    slack = tensions == 0
    assert np.all(slack[2:6, 0])
    changes = np.diff(slack.astype(int), axis=0)
    assert np.sum(changes == -1) >= 2, "tendons become taut again"


def test_goes_into_a_file_and_back(tmp_path):
    scene = driven(stiffness=(200.0, None, 150.0), pretension=(None, 0.2, None))
    path = tmp_path / "servo.toml"
    sr.save_scene(scene, path)
    again = sr.load_scene(path)
    assert again.tendons.control == "length"
    assert [x is None for x in again.tendons.stiffness] == [False, True, False]
    assert float(again.tendons.pretension[1]) == 0.2
    assert "control = length" in str(again) and "stiffness = 200 N/m" in str(again)


@pytest.mark.parametrize(
    "call, words",
    [
        (lambda: sr.solve_static(HELD, tensions=[1.0] * 3), ["tensions", 'control = "length"']),
        (lambda: sr.solve_static(HELD, pulls=[1e-3] * 2), ["pulls", "(2,)", "(3,)"]),
        (lambda: sr.solve_static(HELD, pulls=[np.inf] * 3), ["pulls", "finite"]),
        (
            lambda: sr.solve_static(
                dataclasses.replace(PAPER, tendons=sr.Tendons(OFFSETS, stiffness=(1.0,) * 3))
            ),
            ["tendons[0].stiffness", 'control = "length"'],
        ),
        (lambda: sr.Tendons(OFFSETS, control="pull"), ["control='pull'", '"tension" or "length"']),
    ],
)
def test_refuses(call, words):
    with pytest.raises(ValueError) as error:
        call()
    for word in words:
        assert word in str(error.value)
