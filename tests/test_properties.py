"""What must hold for any numbers: symmetries, units, energy, and ways to call.

Hypothesis varies numbers only, and all scenes but one have every part: the tests share a few
compiled programs. Compiling these is most of the time that this file takes.
"""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

import softrod_jax as sr
from softrod_jax.rod.rotations import quaternion_product, rotation_matrix
from softrod_jax.scene.scene import as_arrays

# Scenes are made inside of strategies, and the checker of annotations looks at one item of a list,
# which it draws.
pytestmark = pytest.mark.filterwarnings("ignore:Do not use the `random` module inside strategies")

BARE = sr.hybrid_robot()
LENGTH, STEPS = 0.1, 24
NOTHING = np.zeros(3)

numbers = settings(derandomize=True, deadline=None, database=None, max_examples=12)
few = settings(numbers, max_examples=6)


def vectors(limit, size=3):
    return st.lists(st.floats(-limit, limit), min_size=size, max_size=size).map(np.array)


def positive(limit, size):
    return st.lists(st.floats(0.0, limit), min_size=size, max_size=size).map(np.array)


def _unit(h):
    return h / np.linalg.norm(h)


rotations = vectors(1.0, 4).filter(lambda h: np.linalg.norm(h) > 0.1).map(_unit)
# Down to a little uphill: a column near its buckling load amplifies any rounding error.
gravities = st.tuples(st.floats(-9.81, 9.81), st.floats(-9.81, 9.81), st.floats(-1.0, 9.81))
scenes = st.fixed_dictionaries(
    {
        "gravity": gravities.map(np.array),
        "force": vectors(5e-3),
        "moment": vectors(1e-4),
        "rest_curvature": vectors(3.0),
        "payload": st.floats(0.0, 2e-3),
        "bending_damping": st.floats(1e-7, 1e-5),
        "shear_damping": st.floats(1e-4, 1e-1),
        "drag_coefficient": st.floats(0.0, 5.0),
    }
).map(lambda parts: full_scene(**parts))
drives = st.fixed_dictionaries(
    {
        "dt": st.floats(5e-3, 15e-3),
        "held": positive(0.3, 3),
        "pulled": positive(0.3, 3),
        "pressure": positive(3e4, 1),
    }
)


def full_scene(force, moment, payload, **parts):
    """Every part that a scene can have."""
    return with_(
        BARE,
        chambers=sr.Chambers(BARE.chambers.areas, np.array([[1e-3, 2e-3]])),
        payload=sr.Payload(payload),
        tip_load=sr.TipLoad(force, moment),
        shear_correction=0.9,
        rest_stretch=np.array([0.01, -0.02, 1.03]),
        base_position=np.array([0.02, -0.01, 0.03]),
        base_quaternion=np.array([0.96, 0.0, 0.28, 0.0]),
        **parts,
    )


# Symmetries hold to rounding; how far Newton's method goes must not be what is seen.
CLOSE = sr.NewtonOptions(tolerance=1e-13)


def with_(scene, **changes):
    return as_arrays(dataclasses.replace(scene, **changes))


def with_load(scene, force, moment=NOTHING):
    return with_(scene, tip_load=sr.TipLoad(force, moment))


def respond(scene, **drive):
    """The equilibrium under the tensions that are held, and a motion from there."""
    rest = sr.solve_static(scene, drive["held"], drive["pressure"], newton=CLOSE)
    return rest, move(scene, rest, **drive)


def move(scene, rest, dt, held, pulled, pressure, throw=True):
    inputs = courses(held, pulled, pressure)
    # Substeps that errors choose may differ where rounding does.
    as_given = dict(substeps=1, max_time_error=jnp.inf)
    return sr.simulate(scene, dt, *inputs, initial=rest, newton=CLOSE, throw=throw, **as_given)


def courses(held, pulled, pressure):
    """Tensions and pressures of every step: `pulled` at first, later `held`."""
    early = jnp.arange(STEPS)[:, None] < STEPS // 2
    return jnp.where(early, pulled, held), jnp.tile(pressure, (STEPS, 1))


def assert_same(ours, theirs, change=lambda positions: positions):
    """The rod of `ours` after `change` is that of `theirs`, as well as Newton's method solves."""
    for one, other in zip(ours, theirs, strict=True):
        np.testing.assert_allclose(
            change(np.array(one.positions)), other.positions, rtol=0, atol=1e-10 * LENGTH
        )


# Symmetries


@given(scenes, drives, rotations, vectors(1.0))
@numbers
def test_turning_and_moving_the_world_takes_the_robot_along(scene, drive, h, shift):
    R = np.array(rotation_matrix(jnp.array(h)))
    moved = with_(
        with_load(scene, R @ scene.tip_load.force, R @ scene.tip_load.moment),
        gravity=R @ scene.gravity,
        base_quaternion=quaternion_product(jnp.array(h), scene.base_quaternion),
        base_position=R @ scene.base_position + shift,
    )
    ours, theirs = respond(scene, **drive), respond(moved, **drive)
    assert_same(ours, theirs, lambda positions: positions @ R.T + shift)
    np.testing.assert_allclose(
        ours[1].tip_velocities @ R.T, theirs[1].tip_velocities, rtol=0, atol=1e-9
    )


@given(scenes, drives)
@numbers
def test_a_mirrored_robot_moves_like_the_mirror_image(scene, drive):
    mirror = np.array([-1.0, 1.0, 1.0])  # for vectors; turns and moments change the other signs
    mirrored = with_(
        with_load(scene, mirror * scene.tip_load.force, -mirror * scene.tip_load.moment),
        gravity=mirror * scene.gravity,
        tendons=sr.Tendons(mirror[:2] * scene.tendons.offsets),
        chambers=sr.Chambers(scene.chambers.areas, mirror[:2] * scene.chambers.offsets),
        rest_stretch=mirror * scene.rest_stretch,
        rest_curvature=-mirror * scene.rest_curvature,
        base_position=mirror * scene.base_position,
        base_quaternion=np.array([1.0, 1.0, -1.0, -1.0]) * scene.base_quaternion,
    )
    assert_same(respond(scene, **drive), respond(mirrored, **drive), lambda x: mirror * x)


@given(scenes, drives, st.floats(-np.pi, np.pi))
@numbers
def test_a_round_rod_has_no_preferred_direction(scene, drive, angle):
    """Turning the section about its axis, with what is inside it, is a change of names."""
    # Square-law drag acts along each axis of the section: it does prefer directions.
    scene = with_(scene, drag_coefficient=0.0)
    c, s = np.cos(angle), np.sin(angle)
    R = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    turn = jnp.array([np.cos(angle / 2), 0.0, 0.0, np.sin(angle / 2)])
    turned = with_(
        scene,
        tendons=sr.Tendons(scene.tendons.offsets @ R[:2, :2]),
        chambers=sr.Chambers(scene.chambers.areas, scene.chambers.offsets @ R[:2, :2]),
        rest_stretch=scene.rest_stretch @ R,
        rest_curvature=scene.rest_curvature @ R,
        base_quaternion=quaternion_product(scene.base_quaternion, turn),
    )
    assert_same(respond(scene, **drive), respond(turned, **drive))


@given(scenes, drives, st.permutations(range(3)))
@numbers
def test_the_order_of_the_tendons_does_not_matter(scene, drive, order):
    order = np.array(order)
    shuffled = with_(scene, tendons=sr.Tendons(scene.tendons.offsets[order]))
    pulls = {"held": drive["held"][order], "pulled": drive["pulled"][order]}
    assert_same(respond(scene, **drive), respond(shuffled, **{**drive, **pulls}))


@given(scenes, drives)
@numbers
def test_two_tendons_in_one_place_pull_like_one(scene, drive):
    offsets = scene.tendons.offsets
    scene = with_(scene, tendons=sr.Tendons(offsets.at[1].set(offsets[0])))
    joined = np.array([[1.0, 1.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    pulls = {"held": joined @ drive["held"], "pulled": joined @ drive["pulled"]}
    # Time stepping starts anew where an input jumps: here in both, or in none.
    assume(np.any(pulls["held"] != pulls["pulled"]) or np.all(drive["held"] == drive["pulled"]))
    assert_same(respond(scene, **drive), respond(scene, **{**drive, **pulls}))


# Units: only ratios matter


@given(scenes, drives, *[st.floats(-1.0, 1.0).map(lambda x: 10**x)] * 3)
@numbers
def test_the_answer_does_not_depend_on_the_units(scene, drive, a, b, c):
    """Lengths times a, stresses times b, densities times c.

    Then forces are times b a^2, masses c a^3, and times, from force = mass length / time^2,
    a (c / b)^(1/2). The rest follows from its unit.
    """
    time, force, mass = a * np.sqrt(c / b), b * a**2, c * a**3
    scaled = with_(
        scene,
        length=a * scene.length,
        section=sr.Circle(a * scene.section.radius),
        young_modulus=b * scene.young_modulus,
        density=c * scene.density,
        bending_damping=force * a**2 * time * scene.bending_damping,
        shear_damping=force * time * scene.shear_damping,
        drag_coefficient=mass / a**2 * scene.drag_coefficient,
        gravity=force / mass * scene.gravity,
        tendons=sr.Tendons(a * scene.tendons.offsets),
        chambers=sr.Chambers(a**2 * scene.chambers.areas, a * scene.chambers.offsets),
        payload=sr.Payload(mass * scene.payload.mass),
        tip_load=sr.TipLoad(force * scene.tip_load.force, force * a * scene.tip_load.moment),
        rest_curvature=scene.rest_curvature / a,
        base_position=a * scene.base_position,
    )
    ours = respond(scene, **drive)
    theirs = respond(
        scaled,
        dt=time * drive["dt"],
        held=force * drive["held"],
        pulled=force * drive["pulled"],
        pressure=b * drive["pressure"],
    )
    assert_same(theirs, ours, lambda positions: positions / a)
    np.testing.assert_allclose(theirs[1].ts / time, ours[1].ts, rtol=1e-14)
    np.testing.assert_allclose(
        theirs[1].tip_velocities * time / a, ours[1].tip_velocities, rtol=0, atol=1e-9
    )


# What is zero, and what is left out


@given(scenes, st.floats(5e-3, 15e-3))
@numbers
def test_actuators_at_zero_act_like_actuators_left_out(scene, dt):
    absent = sr.solve_static(scene, newton=CLOSE)
    # Released from the tip load: else nothing would move.
    free = with_load(scene, NOTHING)
    moved = sr.simulate(free, dt, steps=STEPS, initial=absent, newton=CLOSE)
    tensions, pressures = np.zeros((STEPS, 3)), np.zeros((STEPS, 1))
    zero = sr.solve_static(scene, tensions[0], pressures[0], newton=CLOSE)
    moved_zero = sr.simulate(free, dt, tensions, pressures, initial=absent, newton=CLOSE)
    assert_same((absent, moved), (zero, moved_zero))


@given(drives)
@numbers
def test_parts_at_zero_act_like_parts_left_out(drive):
    """Without gravity and tip loads not even the attitude is part of the equations."""
    neutral = with_(
        with_load(BARE, NOTHING),
        shear_damping=0.0,
        gravity=NOTHING,
        payload=sr.Payload(0.0),
        shear_correction=1.0,
        rest_curvature=NOTHING,
        rest_stretch=np.array([0.0, 0.0, 1.0]),
        base_position=NOTHING,
        base_quaternion=np.array([1.0, 0.0, 0.0, 0.0]),
    )
    rest = sr.solve_static(neutral, NOTHING, np.zeros(1))
    assert_same([move(BARE, None, **drive)], [move(neutral, rest, **drive)])


@given(scenes, drives)
@numbers
def test_a_payload_at_rest_is_a_dead_load(scene, drive):
    weight = scene.payload.mass * scene.gravity
    hung = with_(
        with_load(scene, scene.tip_load.force + weight, scene.tip_load.moment),
        payload=sr.Payload(0.0),
    )
    load = drive["held"], drive["pressure"]
    assert_same(*([sr.solve_static(x, *load, newton=CLOSE)] for x in (scene, hung)))


# Ways to call


def _several(strategy, count=3):
    """One dictionary of stacked numbers."""
    many = st.lists(strategy, min_size=count, max_size=count)
    return many.map(lambda rows: {k: np.stack([row[k] for row in rows]) for k in rows[0]})


_batch = jax.jit(
    lambda scene, rest, drives: jax.vmap(lambda drive: move(scene, rest, **drive, throw=False))(
        drives
    )
)


@given(scenes, _several(drives))
@few
def test_a_compiled_batch_is_a_loop(scene, several):
    rest = sr.solve_static(scene, NOTHING, np.zeros(1))
    batch = _batch(scene, rest, several)
    for i in range(3):
        one = move(scene, rest, **{name: values[i] for name, values in several.items()})
        assert_same([jax.tree.map(lambda x, i=i: x[i], batch)], [one])


@given(scenes, drives)
@few
def test_running_twice_gives_the_same_bits(scene, drive):
    first, second = respond(scene, **drive), respond(scene, **drive)
    for one, other in zip(jax.tree.leaves(first), jax.tree.leaves(second), strict=True):
        np.testing.assert_array_equal(one, other)


# Energy

# Integrals from values at the nodes alone need twice the default's, or the error hides waves.
FINE = sr.Collocation(24)
# Boole's rule, of order 6 like the values at the nodes.
WEIGHTS = np.array([7, *[32, 12, 32, 14] * 5, 32, 12, 32, 7]) / 540


def along(scene, values):
    """The integral along the rod of `values`, (..., nodes, n) to (..., n)."""
    return scene.length * jnp.einsum("k,...kn->...n", WEIGHTS, values)


@jax.jit
def worked_on(scene, positions, strains):
    """What tip force, tensions and pressures do work on: (..., 3 + tendons + chambers).

    The tip [m], minus the lengths of the tendons [m], the volumes of the chambers [m^3].
    """
    v, u = strains[..., None, :3], strains[..., None, 3:]
    paths = lambda offsets: v + jnp.cross(u, jnp.pad(offsets, ((0, 0), (0, 1))))
    lengths = along(scene, jnp.linalg.norm(paths(scene.tendons.offsets), axis=-1))
    volumes = scene.chambers.areas * along(scene, paths(scene.chambers.offsets)[..., 2])
    return jnp.concatenate([positions[..., -1, :], -lengths, volumes], axis=-1)


@jax.jit
def energy(scene, tensions, pressures, positions, strains, velocities):
    """Kinetic and elastic, and that of all constant loads [J]: (...,)."""
    area, I = scene.section.area, scene.section.second_moments[0]
    E, G, rho = scene.young_modulus, scene.shear_modulus, scene.density
    kGA = scene.shear_correction * G * area
    stiffness = jnp.array([kGA, kGA, E * area, E * I, E * I, 2 * G * I])
    inertia = rho * jnp.array([area, area, area, I, I, 2 * I])
    strains_at_rest = jnp.concatenate([scene.rest_stretch, scene.rest_curvature])
    tip, mass = positions[..., -1, :], scene.payload.mass
    loads = jnp.concatenate([scene.tip_load.force, tensions, pressures])
    in_rod = stiffness * (strains - strains_at_rest) ** 2 + inertia * velocities**2
    return (
        jnp.sum(along(scene, in_rod), -1) / 2
        + mass * jnp.sum(velocities[..., -1, :3] ** 2, -1) / 2
        - rho * area * along(scene, positions) @ scene.gravity
        - mass * tip @ scene.gravity
        - worked_on(scene, positions, strains) @ loads
    )


@pytest.mark.parametrize("scheme", [sr.BDFAlpha(0.0), sr.SDIRK(3)], ids=str)
@given(scenes, drives)
@numbers
def test_the_energy_of_a_released_rod_never_grows(scheme, scene, drive):
    # A dead moment has no energy: its work depends on the path.
    pulled, free = with_load(scene, scene.tip_load.force), with_load(scene, NOTHING)
    tensions, pressures = courses(drive["held"], drive["held"], drive["pressure"])
    actuation = tensions[0], pressures[0]
    start, end = (sr.solve_static(x, *actuation, method=FINE) for x in (pulled, free))
    motion = sr.simulate(
        free, drive["dt"], tensions, pressures, initial=start, scheme=scheme, method=FINE
    )
    energies = energy(free, *actuation, motion.positions, motion.strains, motion.velocities)
    least = energy(free, *actuation, end.positions, end.strains, jnp.zeros((25, 6)))
    excess = np.array(energies - least)
    # A millionth of what there is to lose, and rounding errors.
    assert np.all(np.diff(excess) <= 1e-6 * excess[0] + 1e-12)


@given(scenes, drives)
@numbers
def test_equilibria_follow_from_an_energy(scene, drive):
    """Castigliano: a load's slope of the energy is minus what the load works on.

    Maxwell and Betti: load i moves what load j works on as j moves what i works on.
    """
    sizes = np.array([5e-3] * 3 + [0.3] * 3 + [3e4])
    middle = np.concatenate([scene.tip_load.force, drive["held"], drive["pressure"]])
    middle[3:] += 0.01 * sizes[3:]

    def under(loads):
        loaded, actuation = with_load(scene, loads[:3]), (loads[3:6], loads[6:])
        x = sr.solve_static(loaded, *actuation, method=FINE)
        still = jnp.zeros_like(x.strains)
        work = worked_on(loaded, x.positions, x.strains) * sizes
        return np.append(work, energy(loaded, *actuation, x.positions, x.strains, still))

    steps = 1e-3 * np.diag(sizes)
    change = np.array([under(middle + step) - under(middle - step) for step in steps]) / 2e-3
    response, slope, work = change[:, :-1], change[:, -1], under(middle)[:-1]
    size = np.abs(response).max()
    np.testing.assert_allclose(slope, -work, rtol=0, atol=2e-5 * size)
    np.testing.assert_allclose(response, response.T, rtol=0, atol=2e-5 * size)
    assert np.linalg.eigvalsh(response)[0] > -2e-5 * size  # else it would be unstable


@given(scenes, drives)
@few
def test_a_long_damped_motion_ends_in_the_equilibrium(scene, drive):
    # With these, bending and twisting decay at about the same rate.
    scene = with_(scene, bending_damping=8e-6, shear_damping=0.05)
    tensions, pressures = np.tile(drive["held"], (200, 1)), np.tile(drive["pressure"], (200, 1))
    # Steps too long for the way there are good enough for its end.
    as_given = dict(substeps=1, max_time_error=jnp.inf)
    motion = sr.simulate(scene, 0.05, tensions, pressures, scheme=sr.BDFAlpha(0.0), **as_given)
    rest = sr.solve_static(scene, tensions[0], pressures[0])
    np.testing.assert_allclose(motion.positions[-1], rest.positions, rtol=0, atol=1e-6 * LENGTH)
