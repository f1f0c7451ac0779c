"""What is carried step by step: exact where motions are quadratic, and close to `simulate`."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import softrod_jax as sr
from softrod_jax.learning import Action, Stepper
from softrod_jax.scene.scene import as_arrays

L, G = 0.1, 9.81
STILL = np.array([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
WALL = sr.Contact(sr.Plane([0.0, 0.0, 0.995 * L], [-0.3, 0.0, -1.0]), 2e4, damping=2.0, name="wall")


def rod(**changes):
    own = dict(bending_damping=2e-6, plane="xz")
    return as_arrays(sr.Scene(L, sr.Circle(4e-3), 2e5, 0.49, 1070.0, **(own | changes)))


def rows(steps, **columns):
    names = ["x", "y", "z", "qw", "qx", "qy", "qz"]
    poses = np.tile(STILL, (steps, 1))
    for name, values in columns.items():
        poses[:, names.index(name)] = values
    return poses


def test_a_base_in_free_fall_feels_no_gravity():
    dt, steps = 5e-3, 12
    t = dt * np.arange(1, steps + 1)
    fall = rows(steps, x=-0.5 * G * t**2)
    stepper = Stepper(rod(gravity=np.array([-G, 0.0, 0.0])), dt, method=sr.Collocation(4))
    start = stepper.reset(carried=["base"])
    _, seen = stepper.rollout(start, Action(), base=fall)
    assert not np.any(seen.result)
    np.testing.assert_allclose(seen.tip_position, fall[:, :3] + [0, 0, L], rtol=0, atol=1e-12)
    np.testing.assert_allclose(seen.tip_velocity[:, 0], -G * t, rtol=0, atol=1e-11)
    np.testing.assert_allclose(seen.positions[:, 0], fall[:, :3], rtol=0, atol=1e-15)


def test_it_is_close_to_a_motion_and_has_its_derivatives():
    """A shaken base and a wall that beats; a step alone is that of a rollout."""
    dt, steps = 1e-2, 15
    t = dt * np.arange(1, steps + 1)
    angle = -0.2 * np.sin(20 * t) ** 2  # and its negative quaternions are the same attitudes
    base = rows(steps, x=1e-3 * np.sin(20 * t) ** 2, qw=np.cos(angle), qy=np.sin(angle))
    base[::2, 3:] *= -1
    wall = rows(steps, z=-1e-3 * (1 - np.cos(2 * np.pi * 1.2 * t)))
    scene, method = rod(contacts=(WALL,)), sr.Collocation(8, max_error=0.1)  # coarse, for both
    motion = sr.simulate(
        scene, dt, base=base, contacts={"wall": wall}, method=method, max_time_error=1.0
    )
    stepper = Stepper(scene, dt, method=method, newton=sr.NewtonOptions(tolerance=1e-13))
    start = stepper.reset(carried=("wall", "base"))

    @jax.jit
    def run(base):
        _, seen = stepper.rollout(start, Action(), base=base, contacts={"wall": wall})
        return seen.tip_position, seen.contact_forces["wall"], seen.result

    tips, pushes, results = run(base)
    assert not np.any(results)
    np.testing.assert_allclose(tips, motion.tip_positions[1:], rtol=0, atol=2e-4 * L)
    size = np.abs(motion.contact_forces["wall"]).max()
    assert size > 0.1
    np.testing.assert_allclose(pushes, motion.contact_forces["wall"][1:], rtol=0, atol=1e-2 * size)
    one = stepper.step(start, Action(), base=base[0], contacts={"wall": (wall[0, :3], wall[0, 3:])})
    seen = stepper.view(one)
    np.testing.assert_allclose(seen.tip_position, tips[0], rtol=0, atol=1e-12)
    np.testing.assert_allclose(seen.contact_forces["wall"], pushes[0], rtol=0, atol=1e-9)

    force = lambda shift: run(base + shift * rows(steps, x=1.0, qw=0.0) * (t / t[-1])[:, None])[1]
    last = lambda shift: force(shift)[-1, 2]
    slope, d = jax.jvp(last, (0.0,), (1.0,))[1], 1e-6
    np.testing.assert_allclose(slope, (last(d) - last(-d)) / (2 * d), rtol=1e-5)
    # From a pose that cannot be on it is held, and the code says so.
    held, _, results = run(jnp.asarray(base).at[9, 0].set(jnp.nan))
    assert results.tolist() == [0] * 9 + [int(sr.RESULTS.bad_input)] * 6
    np.testing.assert_array_equal(held[:9], tips[:9])


@pytest.mark.parametrize(
    "given, message",
    [
        (dict(), "poses of nothing, and the state carries base, wall; give those"),
        (dict(base=STILL), "poses of base, and the state carries base, wall"),
        (dict(base=STILL[:6], contacts={"wall": STILL}), r"base has shape \(1, 6\)"),
        (dict(base=STILL, contacts={"floor": STILL}), "contacts has 'floor', no contact"),
        (dict(base=STILL * np.nan, contacts={"wall": STILL}), "base has a value that is not"),
    ],
)
def test_other_poses_are_refused(given, message):
    stepper = Stepper(rod(contacts=(WALL,)), 0.01, method=sr.Collocation(8))
    state = stepper.reset(carried=["base", "wall"])
    with pytest.raises(ValueError, match=message):
        stepper.step(state, Action(), **given)


def test_what_is_not_there_cannot_be_carried():
    stepper = Stepper(rod(contacts=(WALL,)), 0.01, method=sr.Collocation(8))
    with pytest.raises(ValueError, match="carried has 'floor'; there are base, wall"):
        stepper.reset(carried=["floor"])
