"""A base that is carried, and obstacles that move: closed forms, frames that are equivalent."""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.linalg
from jax.test_util import check_grads

import softrod_jax as sr
from softrod_jax.scene.scene import as_arrays

L, R, E, NU, RHO, G = 0.1, 4e-3, 2e5, 0.49, 1070.0, 9.81
METHOD = sr.Collocation(8)
STILL = np.array([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0])


def rod(**changes):
    own = dict(
        length=L,
        section=sr.Circle(R),
        young_modulus=E,
        poisson_ratio=NU,
        density=RHO,
        bending_damping=2e-6,
    )
    return as_arrays(sr.Scene(**(own | changes)))


def rows(steps, **columns):
    """Poses (steps, 7): at rest but for these columns."""
    names = ["x", "y", "z", "qw", "qx", "qy", "qz"]
    poses = np.tile(STILL, (steps, 1))
    for name, values in columns.items():
        poses[:, names.index(name)] = values
    return poses


def times(dt, steps):
    return dt * np.arange(1, steps + 1)


HOW = {"bdf": (METHOD, sr.BDFAlpha()), "shooting": (sr.Shooting(1, 6), sr.SDIRK(2))}


@pytest.mark.parametrize("method, scheme", HOW.values(), ids=HOW)
def test_a_base_in_free_fall_feels_no_gravity(method, scheme):
    t = times(5e-3, 20)
    fall = -0.5 * G * t**2
    scene = rod(gravity=np.array([-G, 0.0, 0.0]), payload=sr.Payload(2e-3))
    motion = sr.simulate(
        scene, 5e-3, base=rows(20, x=fall), method=method, scheme=scheme, max_time_error=0.1
    )
    expected = np.stack([fall, 0 * t, L + 0 * t], -1)
    # The multistep scheme knows the velocity of the clamp, and what it knew before, to its order.
    tolerance = 1e-12 if scheme.one_step else 2e-3 * L
    np.testing.assert_allclose(motion.tip_positions[1:], expected, rtol=0, atol=tolerance)
    if scheme.one_step:
        np.testing.assert_allclose(motion.tip_velocities[1:, 0], -G * t, rtol=0, atol=1e-11)


def test_a_rod_that_turns_steadily_is_stretched_by_its_own_inertia():
    """E A z'' = -rho A omega^2 z, with z(0) = 0 and z'(L) = 1: z = sin(k s) / (k cos(k L))."""
    omega, rise, dt, steps = 30.0, 0.5, 1e-2, 240
    t = times(dt, steps)
    x = np.minimum(t / rise, 1.0)
    angle = omega * rise * (x**3 - x**4 / 2) + omega * np.maximum(t - rise, 0.0)
    scene = rod(shear_damping=np.full(3, 0.02), bending_damping=5e-6)
    turning = rows(steps, qw=np.cos(angle / 2), qy=np.sin(angle / 2))
    motion = sr.simulate(scene, dt, base=turning, method=METHOD)
    k = omega * np.sqrt(RHO / E)
    stretched = np.sin(k * L) / (k * np.cos(k * L))
    away = np.linalg.norm(np.asarray(motion.tip_positions), axis=-1)
    assert stretched - L > 1e-4
    # At the last step the clamp's velocity is a one-sided difference.
    np.testing.assert_allclose(away[-10:-1], stretched, rtol=0, atol=2e-4 * (stretched - L))
    # It points where the clamp does, a little behind as long as that gains speed.
    tip = np.asarray(motion.tip_positions[-1]) / away[-1]
    np.testing.assert_allclose(tip, [np.sin(angle[-1]), 0.0, np.cos(angle[-1])], rtol=0, atol=1e-4)


def gain(scene, frequency, damping):
    """Tip over base of a beam that is shaken across: Timoshenko's equations, one exponential.

    (w, phi, M, Q)' = A (w, phi, M, Q) with E I (1 + i omega B / E I) for the bending stiffness;
    at the base w = 1 and phi = 0, at the tip M = Q = 0.
    """
    omega = 2 * np.pi * frequency
    area, inertia = np.pi * R**2, np.pi * R**4 / 4
    shear, bending = E / (2 * (1 + NU)) * area, E * inertia + 1j * omega * damping
    A = np.zeros((4, 4), complex)
    A[0, 1], A[0, 3] = 1, 1 / shear
    A[1, 2] = 1 / bending
    A[2, 1], A[2, 3] = -RHO * inertia * omega**2, -1
    A[3, 0] = -RHO * area * omega**2
    T = scipy.linalg.expm(A * L)
    start = np.linalg.solve(T[2:, 2:], -T[2:, 0])
    return T[0, 0] + T[0, 2:] @ start


def test_a_shaken_base_moves_the_tip_as_the_closed_form_says():
    damping, periods, per_period = 2e-6, 14, 60
    scene, steps = rod(bending_damping=damping), periods * per_period
    first = 1.8751**2 / (2 * np.pi * L**2) * np.sqrt(E * R**2 / 4 / RHO)
    small = 1e-4 * L

    @jax.jit
    def tip(frequency):
        dt = 1 / (frequency * per_period)
        shaken = small * (1 - jnp.cos(2 * jnp.pi * frequency * dt * jnp.arange(1, steps + 1)))
        base = jnp.tile(STILL, (steps, 1)).at[:, 0].set(shaken)
        motion = sr.simulate(scene, dt, base=base, method=METHOD, max_time_error=1.0, throw=False)
        return motion.tip_positions[1:, 0], motion.result

    for part in (0.3, 0.8, 1.2, 3.0):
        x, result = tip(part * first)
        assert int(result) == 0
        phase = 2 * np.pi * np.arange(1, steps + 1) / per_period
        waves = np.stack([np.cos(phase), np.sin(phase), np.ones(steps)], -1)[-per_period:]
        a, b, _ = np.linalg.lstsq(waves, np.asarray(x)[-per_period:], rcond=None)[0]
        found = -(a - 1j * b) / small
        right = gain(scene, part * first, damping)
        assert abs(found - right) < 1e-3 * abs(right), (part, found, right)


WALL = sr.Contact(
    sr.Plane([0.0, 0.0, 0.995 * L], [-0.3, 0.0, -1.0]), stiffness=2e4, damping=2.0, friction=0.2
)


def test_what_falls_together_is_what_stands_still_without_gravity():
    """A clamp and a wall that fall alike: the rod pressed on the wall does not know it."""
    dt, steps = 4e-3, 15
    fall = rows(steps, x=-0.5 * G * times(dt, steps) ** 2)
    pulls = np.full((steps, 1), 0.2)
    scene = rod(contacts=(WALL,), tendons=sr.Tendons([[2e-3, 0.0]]))
    falling = rod(
        contacts=(WALL,), tendons=sr.Tendons([[2e-3, 0.0]]), gravity=np.array([-G, 0.0, 0.0])
    )
    # Both on the same grid, which is coarse for this touch.
    coarse = dataclasses.replace(METHOD, max_error=0.1)
    how = dict(method=coarse, max_time_error=0.1, newton=sr.NewtonOptions(tolerance=1e-13))
    still = sr.simulate(scene, dt, pulls, **how)
    both = sr.simulate(falling, dt, pulls, base=fall, contacts={"contact1": fall}, **how)
    assert np.abs(still.contact_forces["contact1"]).max() > 5e-3
    np.testing.assert_allclose(
        both.tip_positions[1:] - fall[:, :3], still.tip_positions[1:], rtol=0, atol=1e-6
    )
    np.testing.assert_allclose(
        both.contact_forces["contact1"], still.contact_forces["contact1"], rtol=0, atol=1e-4
    )


def beating(steps, dt, amplitude=2e-3):
    return rows(steps, z=-amplitude * (1 - np.cos(2 * np.pi * 1.2 * times(dt, steps))))


@functools.cache
def beaten(dt, intervals):
    """The force on a wall that beats at 1.2 Hz, against which the rod was pressed at rest."""
    steps, method = round(0.4 / dt), sr.Collocation(intervals)
    wall = sr.Contact(sr.Plane([0.0, 0.0, 0.999 * L], [0.0, 0.0, -1.0]), stiffness=2e4, name="wall")
    scene = rod(contacts=(wall,), tip_load=sr.TipLoad([0.0, 0.0, 0.05]))
    motion = sr.simulate(
        scene,
        dt,
        contacts={"wall": beating(steps, dt, 5e-4)},
        initial=sr.solve_static(scene, method=method),
        max_time_error=0.1,
    )
    return -np.asarray(motion.contact_forces["wall"])[:: round(0.01 / dt), 2]


def test_the_force_of_a_wall_that_beats_is_right_at_ten_milliseconds():
    coarse, fine = beaten(0.01, 24), beaten(0.005, 48)
    assert np.ptp(fine) > 0.02
    np.testing.assert_allclose(coarse, fine, rtol=0.01, atol=0)


@pytest.mark.long
def test_derivatives_by_the_poses():
    dt, steps = 8e-3, 6
    scene = rod(gravity=np.array([G, 0.0, 0.0]), contacts=(WALL,))
    base, wall = rows(steps, x=1e-3 * np.sin(np.arange(steps))), beating(steps, dt, 0.05)

    @jax.jit
    def tip(base, wall):
        motion = sr.simulate(
            scene,
            dt,
            base=base,
            contacts={"contact1": wall},
            method=METHOD,
            newton=sr.NewtonOptions(tolerance=1e-13),
            throw=False,
        )
        return 10 * motion.tip_positions[-1], motion.contact_forces["contact1"][-1]

    start = jnp.asarray(base) + 1e-3 * np.random.default_rng(0).normal(size=base.shape)
    assert np.abs(tip(start, wall)[1]).max() > 1e-3
    # The wall turns about a place far away: what is not linear is large.
    check_grads(tip, (start, jnp.asarray(wall)), order=1, atol=1e-5, rtol=1e-5, eps=2e-8)


def test_a_lane_without_a_pose_leaves_the_others_alone():
    dt, steps = 8e-3, 4
    scene = rod(gravity=np.array([-G, 0.0, 0.0]))

    def tip(base):
        motion = sr.simulate(scene, dt, base=base, method=METHOD, throw=False)
        return motion.tip_positions[-1].sum(), motion.result

    good = jnp.asarray(rows(steps, x=1e-3 * np.arange(steps)))
    bad = [good.at[2, 1].set(jnp.nan), good.at[1, 3:].set(0.0)]
    derivative = jax.jit(jax.vmap(jax.value_and_grad(tip, has_aux=True)))
    (tips, results), slopes = derivative(jnp.stack([good, *bad]))
    assert results.tolist() == [0, *[int(sr.RESULTS.bad_input)] * 2]
    (alone, _), alone_slopes = derivative(jnp.stack([good] * 3))
    assert np.all(np.isfinite(tips)) and tips[0] == alone[0]
    np.testing.assert_allclose(slopes[0], alone_slopes[0], rtol=0, atol=1e-12)
    assert np.array_equal(slopes[1:], np.zeros((2, steps, 7)))


def test_in_a_plane_it_moves_as_in_space():
    """Also where the clamp turns by more than a whole turn."""
    # The grid has an error in a quaternion along the rod, of order 6, and none in an angle.
    dt, steps, fine = 5e-3, 24, sr.Collocation(16)
    x = np.arange(1, steps + 1) / steps
    angle = 7.0 * x**2
    base = rows(steps, x=1e-2 * angle, qw=np.cos(angle / 2), qy=np.sin(angle / 2))
    own = dict(gravity=np.array([-G, 0.0, 0.0]))
    flat = sr.simulate(rod(**own, plane="xz"), dt, base=base, method=fine)
    pair = base[:, :3], base[:, 3:]
    space = sr.simulate(rod(**own), dt, base=pair, method=fine)
    np.testing.assert_allclose(flat.tip_positions, space.tip_positions, rtol=0, atol=2e-9)


BAD = {
    "shape": (dict(base=np.zeros((3, 6))), r"base has shape \(3, 6\); \(steps, 7\) is needed"),
    "norm": (dict(base=np.ones((3, 7))), r"quaternion of base\[0\].* has the norm 2; expected 1"),
    "number": (dict(base=rows(3, x=np.nan)), "base has a value that is not finite"),
    "text": (dict(base="here"), "base = 'here' is not an array of numbers"),
    "name": (dict(contacts={"wall": rows(3)}), r"contacts has 'wall', no contact .* has contact1"),
    "lengths": (
        dict(base=rows(3), contacts={"contact1": rows(4)}),
        r"lengths disagree: \{'base': 3, 'contacts\[0\]': 4\}",
    ),
}


@pytest.mark.parametrize("kind", BAD)
def test_bad_poses_are_refused(kind, wrong_types):
    given, message = BAD[kind]
    with pytest.raises(ValueError, match=message):
        sr.simulate(rod(contacts=(WALL,)), 0.01, **given)


def test_a_base_that_leaves_the_plane_is_refused():
    with pytest.raises(ValueError, match=r'base\[1\].* leaves the plane "xz".*leave plane out'):
        sr.simulate(rod(plane="xz"), 0.01, base=rows(2, y=[0.0, 1e-3]), method=METHOD)
