"""Inextensible rods and scenes in a plane: the same answers from fewer unknowns."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from problems import beam, elastica
from test_rod_ode import random_point

import softrod_jax as sr
from softrod_jax.rod.constants import full_strain, inner_strain
from softrod_jax.rod.constitutive import compliance, imbalance, local_problem, recover_strain
from softrod_jax.rod.jacobian import rod_ode_jacobian
from softrod_jax.rod.ode import rod_ode
from softrod_jax.rod.reduction import make_rod
from softrod_jax.rod.state import History, Layout, layout_of
from softrod_jax.scene.inputs import Inputs
from softrod_jax.scene.planes import in_space, turn_in, vector_in
from softrod_jax.scene.scene import as_arrays

TENSIONS, PRESSURES = jnp.array([0.1, 0.05]), jnp.array([1e4])
# The plane y-z differs in what is made of the scene and not in the equations.
COMBINATIONS = [(None, True), ("xz", False), ("xz", True)]


# About z by a quarter: x becomes y.
TO_YZ = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])


def with_(scene, **changes):
    return as_arrays(dataclasses.replace(scene, **changes))


def scene_in(axes, scale=1.0, **changes):
    """Every part that a scene can have, in the plane of these axes.

    The area is `scale` times that of a circle, at the same mass per length: a stiff rod.
    """
    R = TO_YZ if axes == "yz" else np.eye(3)
    parts = dict(
        length=0.1,
        section=sr.GeneralSection(1.131e-4 * scale, 1.018e-9 * np.ones(2), 2.036e-9),
        young_modulus=5e4,
        poisson_ratio=0.49,
        density=1070.0 / scale,
        bending_damping=1e-6,
        shear_damping=1e-3,
        gravity=R @ [-9.0, 0.0, 3.0],
        drag_coefficient=0.03,
        tendons=sr.Tendons(np.array([[4e-3, 0.0], [-3e-3, 0.0]]) @ R[:2, :2].T),
        chambers=sr.Chambers(np.array([7e-6]), np.array([[1e-3, 0.0]]) @ R[:2, :2].T),
        payload=sr.Payload(2e-3),
        tip_load=sr.TipLoad(R @ [1e-3, 0.0, 2e-3], R @ [0.0, 1e-5, 0.0]),
        shear_correction=0.9,
        rest_curvature=R @ [0.0, 2.0, 0.0],
        rest_stretch=R @ [0.01, 0.0, 1.02],
        base_quaternion=np.array([0.96, *R @ [0.0, 0.28, 0.0]]),
    )
    return as_arrays(sr.Scene(**(parts | changes)))


def inextensible(scene):
    return with_(scene, inextensible=True, shear_damping=None, shear_correction=None)


# At a point of the rod


def full_and_restricted(plane, no_stretch, moving=True):
    """Rods, layouts, and a state with its history that both can have."""
    full = scene_in(plane)
    scene = with_(inextensible(full) if no_stretch else full, plane=plane)
    rods = [make_rod(x, Inputs(TENSIONS, PRESSURES), dynamic=moving) for x in (full, scene)]
    layouts = [layout_of(rod, dynamic=moving) for rod in rods]
    y, history = random_point(9, Layout(attitude=True, dynamic=True))
    h, q, w, N, M = Layout(attitude=True, dynamic=True).split(y)
    inside = lambda a, b: jnp.concatenate([vector_in(plane, a), turn_in(plane, b)])
    h_in, h_full = h, h
    if plane is not None:
        h_in = jnp.array([0.7])
        turn = in_space(jnp.array([0.0, 0.0, np.sin(0.35)]), plane)[3:]
        h_full = jnp.array([np.cos(0.35), *turn])
    velocity = inside(q, w) if moving else None
    restricted = layouts[1].join(h_in, velocity, inside(N, M))
    whole = layouts[0].join(
        h_full, in_space(velocity, plane) if moving else None, in_space(inside(N, M), plane)
    )
    if not moving:
        return rods, layouts, (whole, restricted), (None, None)
    strain_h = inner_strain(history.strain, rods[1])
    velocity_h = inside(*jnp.split(history.velocity, 2))
    ours = History(history.c0, strain_h, velocity_h)
    theirs = History(history.c0, full_strain(strain_h, rods[1]), in_space(velocity_h, plane))
    return rods, layouts, (whole, restricted), (theirs, ours)


@pytest.mark.parametrize("plane", ["xz", "yz"])
def test_equations_in_a_plane_are_those_in_space(plane):
    rods, layouts, states, histories = full_and_restricted(plane, no_stretch=False)
    guess = jnp.array([0.0, 0, 1, 0, 0, 0])
    whole = rod_ode(states[0], rods[0], layouts[0], histories[0], guess)
    ours = rod_ode(states[1], rods[1], layouts[1], histories[1], inner_strain(guess, rods[1]))
    np.testing.assert_allclose(
        full_strain(ours.strain, rods[1]), whole.strain, rtol=1e-10, atol=1e-12
    )
    parts = [in_space(ours.y_s[i : i + 3], plane) for i in (1, 4)]
    np.testing.assert_allclose(jnp.concatenate(parts), whole.y_s[4:], rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("plane, no_stretch", COMBINATIONS)
@pytest.mark.parametrize("moving", [True, False])
def test_jacobian_is_the_derivative(plane, no_stretch, moving):
    rods, layouts, states, histories = full_and_restricted(plane, no_stretch, moving)
    rod, layout, y, history = rods[1], layouts[1], states[1], histories[1]
    guess = inner_strain(jnp.array([0.0, 0, 1, 0, 0, 0]), rod)
    rates = jax.jit(lambda y: rod_ode(y, rod, layout, history, guess))
    written = jax.jit(lambda y: rod_ode_jacobian(y, rates(y).strain, rod, layout, history).state)(y)
    derived = jax.jit(jax.jacfwd(lambda y: rates(y).y_s))(y)
    size = np.abs(derived).max(axis=1, keepdims=True)
    np.testing.assert_allclose(written / size, derived / size, atol=1e-12)


@pytest.mark.parametrize("plane, no_stretch", COMBINATIONS)
def test_strains_minimise_the_energy(plane, no_stretch):
    rods, layouts, states, histories = full_and_restricted(plane, no_stretch)
    wrench = states[1][-rods[1].strain_size :]
    problem = local_problem(rods[1], wrench, histories[1].c0, histories[1].strain)
    x, solvable = recover_strain(problem, inner_strain(jnp.array([0.0, 0, 1, 0, 0, 0]), rods[1]))
    assert bool(solvable)
    slope = jax.jacfwd(lambda x: imbalance(problem, x))(x)
    np.testing.assert_allclose(imbalance(problem, x), 0, atol=1e-12)
    np.testing.assert_allclose(compliance(problem, x) @ slope, np.eye(x.size), atol=1e-10)


def test_a_tendon_path_vanishes_later_where_nothing_is_compressed():
    """At tau = EI / r^2, where curvature alone takes the path's length: 3.181 N, not 2.036 N."""
    rod = lambda tension: make_rod(
        with_(sr.hybrid_robot(), inextensible=True), Inputs(jnp.array([tension, 0.0, 0.0]))
    )
    limit = float(rod(1.0).K_bt[1]) / 4e-3**2
    for tension in (0.999 * limit, 1.001 * limit):
        problem = local_problem(rod(tension), jnp.zeros((1, 3)))
        _, solvable = recover_strain(problem, jnp.zeros((1, 3)))
        assert bool(solvable) == (tension < limit)


def test_nothing_of_what_is_absent_is_in_the_program():
    def program(scene):
        def one(scene):
            rod = make_rod(scene, Inputs(TENSIONS, PRESSURES), spread_fronts=True)
            layout = layout_of(rod, dynamic=True)
            still = jnp.ones(layout.pair)
            strain = inner_strain(jnp.ones(6), rod)
            history = History(jnp.ones(()), strain, still)
            y = jnp.ones(layout.size)
            return rod_ode(y, rod, layout, history, strain).y_s

        return jax.make_jaxpr(one)(scene).jaxpr

    full = scene_in("xz")
    rigid = inextensible(full)
    scenes = [full, with_(full, plane="xz"), rigid, with_(rigid, plane="xz")]
    sizes = [program(x).outvars[0].aval.shape[0] for x in scenes]
    assert sizes == [16, 7, 16, 7]
    counts = [len(program(x).eqns) for x in scenes]
    assert counts[0] > counts[2] > counts[3] and counts[1] < counts[0], counts
    for scene, used in zip(scenes, (True, True, True, False), strict=True):
        jaxpr = program(scene)
        ratio = [x is scene.poisson_ratio for x in jax.tree.leaves(scene)].index(True)
        read = any(v is jaxpr.invars[ratio] for e in jaxpr.eqns for v in e.invars)
        assert read == used  # of G: GA, and GJ of the twist


# Whole rods

METHOD = sr.Collocation(32)


def rest(scene):
    return sr.solve_static(scene, TENSIONS, PRESSURES, method=METHOD)


def test_equilibria_in_a_plane_are_those_in_space():
    full, ours = rest(scene_in("xz")), rest(scene_in("xz", plane="xz"))
    assert abs(full.tip_position[0]) > 0.03
    for name in ("positions", "quaternions", "strains", "wrenches"):
        one, other = getattr(ours, name), getattr(full, name)
        scale = np.abs(other).max(axis=0).max()
        np.testing.assert_allclose(one, other, rtol=0, atol=1e-8 * scale, err_msg=name)
    np.testing.assert_allclose(ours.positions, full.positions, rtol=0, atol=1e-9)


def test_inextensible_equilibria_are_the_limit_of_stiff_rods():
    straight = np.array([0.0, 0.0, 1.0])
    stiff = [scene_in("xz", scale, rest_stretch=straight) for scale in (1e3, 1e5)]
    less, more = map(rest, stiff)
    ours = rest(inextensible(stiff[1]))
    far, near = (np.abs(x.positions - ours.positions).max() for x in (less, more))
    assert near < 1e-6 * 0.1
    np.testing.assert_allclose(far / near, 100, rtol=0.02)
    np.testing.assert_array_equal(ours.strains[:, :3], np.tile(straight, (33, 1)))
    # The constraint's force, held by no strain.
    np.testing.assert_allclose(ours.wrenches, more.wrenches, rtol=0, atol=1e-6)


@pytest.mark.parametrize("plane", [None, "yz"])
def test_closed_forms_of_inextensible_rods(plane):
    R = TO_YZ if plane == "yz" else np.eye(3)

    def bend(force, moment):
        load = sr.TipLoad(R @ force, R @ moment)
        # The area has no say.
        scene = beam(area=1.0, tip_load=load, inextensible=True, plane=plane)
        solution = sr.solve_static(scene)
        return solution.tip_position @ R, solution.stats

    nothing = np.zeros(3)
    circle, _ = bend(nothing, np.array([0.0, 2 * np.pi, 0.0]))
    np.testing.assert_allclose(circle, 0, atol=1e-12)
    for problem in (
        elastica(1.0, 0.3017207738, 0.0564332363),
        elastica(10.0, 0.8106090249, 0.5549955978),
    ):
        tip, _ = bend(np.array(problem.scene.tip_load.force), nothing)
        np.testing.assert_allclose(tip, problem.tip, atol=problem.tolerance)
    euler = np.pi**2 / 4
    for load in (0.99 * euler, 1.01 * euler):
        _, stats = bend(np.array([0.0, 0.0, -load]), nothing)
        assert bool(stats["stable"]) == (load < euler)


def moving(scene, scheme, method, steps, **options):
    inputs = jnp.tile(TENSIONS, (steps, 1)), jnp.tile(PRESSURES, (steps, 1))
    motion = sr.simulate(scene, 0.01, *inputs, scheme=scheme, method=method, throw=False, **options)
    return motion.positions, motion.velocities, motion.result


def test_motions_in_a_plane_are_those_in_space():
    move = jax.jit(lambda scene: moving(scene, sr.SDIRK(), sr.Collocation(12), 8))
    full, ours = move(scene_in("xz")), move(scene_in("xz", plane="xz"))
    assert int(full[2]) == int(ours[2]) == 0
    assert abs(full[0][-1, -1, 0] - full[0][0, -1, 0]) > 0.01
    np.testing.assert_allclose(ours[0], full[0], rtol=0, atol=1e-9)
    np.testing.assert_allclose(ours[1], full[1], rtol=0, atol=1e-5)


STIFF = scene_in("xz", 1e5, rest_stretch=np.array([0.0, 0.0, 1.0]), plane="xz")
RIGID = inextensible(STIFF)
# Of order 4: the same equations in less time to compile.
# Steps that are too long for BDF-alpha: two motions by the same steps are compared.
swing = jax.jit(
    lambda scene: moving(scene, sr.BDFAlpha(), sr.Collocation(8, order=4), 6, max_time_error=0.1)
)


def test_inextensible_motions_are_those_of_a_stiff_rod():
    stiff, rigid = swing(STIFF), swing(RIGID)
    assert int(stiff[2]) == int(rigid[2]) == 0
    assert abs(stiff[0][-1, -1, 0] - stiff[0][0, -1, 0]) > 0.01
    np.testing.assert_allclose(rigid[0], stiff[0], rtol=0, atol=1e-6 * 0.1)


def test_forward_reverse_and_differences_agree():
    """With both restrictions, in a motion."""
    names = ("young_modulus", "bending_damping", "length", "base_quaternion")

    def tip(x):
        turn = jnp.array([0.96, 0.0, 0.28, 0.0])
        turn = turn + 0.1 * (x[3] - 1) * jnp.array([-0.28, 0.0, 0.96, 0.0])
        values = [getattr(RIGID, n) * k for n, k in zip(names[:3], x, strict=False)]
        changed = dict(zip(names, [*values, turn / jnp.linalg.norm(turn)], strict=True))
        return dataclasses.replace(RIGID, **changed)

    last = lambda x: swing(tip(x))[0][-1, -1]
    one = jnp.ones(4)
    forward, reverse = jax.jit(jax.jacfwd(last))(one), jax.jit(jax.jacrev(last))(one)
    np.testing.assert_allclose(forward, reverse, atol=1e-9 * np.abs(forward).max())
    d = 1e-3
    for i, e in enumerate(d * np.eye(4)):
        slope = (8 * (last(one + e) - last(one - e)) - last(one + 2 * e) + last(one - 2 * e)) / (
            12 * d
        )
        np.testing.assert_allclose(forward[:, i], slope, atol=1e-6 * np.abs(slope).max())


# What is refused

OFF = {
    "rod.gravity": dict(gravity=np.array([-9.81, 0.1, 0.0])),
    "rod.rest_stretch": dict(rest_stretch=np.array([0.0, 0.01, 1.0])),
    "rod.rest_curvature": dict(rest_curvature=np.array([0.0, 1.0, 0.1])),
    "rod.base_quaternion": dict(base_quaternion=np.array([0.96, 0.28, 0.0, 0.0])),
    "tip_load.force": dict(tip_load=sr.TipLoad(force=np.array([0.0, 1e-3, 0.0]))),
    "tip_load.moment": dict(tip_load=sr.TipLoad(moment=np.array([1e-3, 0.0, 0.0]))),
    "tendons[1].offset": dict(tendons=sr.Tendons(np.array([[4e-3, 0.0], [0.0, 4e-3]]))),
    "chambers[0].offset": dict(chambers=sr.Chambers(np.array([7e-6]), np.array([[0.0, 1e-3]]))),
}


@pytest.mark.parametrize("key", OFF)
def test_what_is_off_the_plane_is_refused(key):
    scene = scene_in("xz", plane="xz", **OFF[key])
    actuation = [None if x is None else jnp.zeros(x.count) for x in (scene.tendons, scene.chambers)]
    with pytest.raises(ValueError, match='not in the plane "xz".*expected 0 for') as error:
        sr.solve_static(scene, *actuation)
    assert f"solve_static: the scene's {key} = [" in str(error.value)
    with pytest.raises(ValueError, match="simulate: the scene's"):
        sr.simulate(scene, 0.01, steps=1)


def test_rounding_errors_are_not_off_the_plane():
    angle = np.pi / 2
    offsets = 4e-3 * np.array([[np.cos(angle), np.sin(angle)], [0.0, -1.0]])
    scene = scene_in("yz", plane="yz", tendons=sr.Tendons(offsets))
    assert offsets[0, 0] != 0.0
    sr.scene.checks.checked_scene("here", scene)


@pytest.mark.usefixtures("wrong_types")
def test_keys_without_meaning_are_refused():
    for name in ("shear_damping", "shear_correction"):
        scene = with_(inextensible(scene_in("xz")), **{name: 0.9})
        with pytest.raises(ValueError, match=f"rod.{name} = 0.9: an inextensible rod"):
            sr.solve_static(scene, TENSIONS, PRESSURES)
    with pytest.raises(ValueError, match="plane='xy' is not offered; use \"xz\""):
        with_(sr.hybrid_robot(), plane="xy")
    with pytest.raises(ValueError, match="inextensible=1"):
        with_(sr.hybrid_robot(), inextensible=1)


def test_traced_numbers_off_the_plane_have_a_code():
    scene = beam(tip_load=sr.TipLoad(force=jnp.zeros(3)), plane="xz")

    @jax.jit
    @jax.vmap
    def solve(force):
        loaded = dataclasses.replace(scene, tip_load=sr.TipLoad(force=force))
        x = sr.solve_static(loaded, method=sr.Collocation(6), throw=False)
        return x.result, x.tip_position

    forces = np.array([[0.1, 0.0, 0.2], [0.1, 0.1, 0.0], [0.1, np.nan, 0.0], [0.1, 0.0, 0.2]])
    result, tip = solve(forces)
    np.testing.assert_array_equal(result, [0, 4, 4, 0])
    np.testing.assert_array_equal(tip[0], tip[3])
