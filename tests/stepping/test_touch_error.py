"""What the grid misses of a push: against integrals, a swinging mass, and a motion."""

import sys
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import softrod_jax as sr
from softrod_jax.bvp.missed_push import Push, push_on
from softrod_jax.bvp.unloaded import unloaded_guess
from softrod_jax.rod.reduction import make_rod
from softrod_jax.rod.state import layout_of
from softrod_jax.scene.scene import as_arrays
from softrod_jax.stepping.first_mode import Swing
from softrod_jax.stepping.touch_error import swung, unshaken

sys.path.insert(0, str(Path(__file__).parents[2] / "benchmarks"))

import contact_stress  # noqa: E402

LENGTH, RADIUS, STIFFNESS = 0.1, 5e-3, 300.0


@pytest.mark.parametrize("order, intervals", [(6, 5), (4, 8)])
@pytest.mark.parametrize("plane, angle", [(None, 0.0), (None, 0.3), ("xz", 0.3)])
def test_a_straight_rod_across_a_wall(plane, angle, order, intervals):
    """The push grows linearly from where the rod goes into the wall: its integral is known."""
    along = np.array([np.sin(angle), 0.0, np.cos(angle)])
    normal, place = np.array([-0.6, 0.0, -0.8]), np.array([0.0, 0.0, 0.0637])
    scene = as_arrays(
        sr.Scene(
            LENGTH,
            sr.Circle(RADIUS),
            1e5,
            0.49,
            1070.0,
            plane=plane,
            gravity=[0.0, 0.0, -9.81],
            base_quaternion=[np.cos(angle / 2), 0.0, np.sin(angle / 2), 0.0],
            contacts=(sr.Contact(sr.Plane(place, normal), STIFFNESS),),
        )  # fmt: skip
    )
    method = sr.Collocation(intervals, order=order)
    rod = make_rod(scene, grid=method.grid(scene))
    layout = layout_of(rod, dynamic=True)
    push = push_on(unloaded_guess(layout, rod).y, rod, layout, method)

    nodes = np.linspace(0.0, LENGTH, intervals + 1)
    # The depth of the surface is slope (s - edge) from there on.
    slope = -normal @ along
    edge = (place @ normal + RADIUS) / (normal @ along)
    integral = 0.5 * STIFFNESS * slope * np.maximum(nodes - edge, 0.0) ** 2
    points = np.array([7, 32, 12, 32, 7]) / 90 if order == 6 else np.array([1, 4, 1]) / 6
    s = nodes[:-1, None] + np.diff(nodes)[:, None] * np.linspace(0.0, 1.0, len(points))
    known = LENGTH / intervals * (STIFFNESS * slope * np.maximum(s - edge, 0.0)) @ points
    missed = np.diff(integral) - known
    inside = int(edge // (LENGTH / intervals))
    assert 0 < edge < LENGTH and abs(missed[inside]) > 1e-5
    # The trapezoidal rule on the parts is wrong by this much at an edge.
    apart = LENGTH / intervals / (4 * (len(points) - 1))
    allowed = STIFFNESS * slope * apart**2 / 8 + 1e-12
    np.testing.assert_allclose(push.missed, missed[:, None] * normal, rtol=0, atol=allowed)
    others = np.delete(np.asarray(push.missed), inside, 0)
    np.testing.assert_allclose(others, 0.0, atol=1e-14)
    held = STIFFNESS * np.diff(np.maximum(nodes - edge, 0.0))
    expected = held[:, None, None] * np.outer(normal, normal)
    np.testing.assert_allclose(push.stiffness, expected, rtol=0, atol=STIFFNESS * apart)


# A mass of 2 kg on a spring of 50 N/m, on which one interval acts with half of its force.
MODE = Swing(jnp.array(50.0), jnp.array(5.0), jnp.array(0.4), 0.5 * jnp.eye(3)[None])


def after(time, steps, shaken, missed, held=0.0, mode=MODE):
    push = Push(jnp.array([missed]), held * jnp.eye(3)[None])
    advance = lambda _, shaken: swung(shaken, mode, push, time / steps, 0.1)
    return jax.lax.fori_loop(0, steps, advance, shaken)


def test_a_push_that_is_always_missed_moves_the_mode_as_a_force_does():
    force, time = np.array([0.3, 0.0, -0.1]), 0.37
    free = MODE._replace(decay=jnp.zeros(()))
    found = after(time, 20_000, unshaken(), force, mode=free)
    moved = 0.5 * force / 50 * (1 - np.cos(5 * time))
    np.testing.assert_allclose(found.place, moved, rtol=1e-3, atol=1e-12)
    np.testing.assert_allclose(found.speed, 0.5 * force / 50 * 5 * np.sin(5 * time), rtol=1e-3)
    held = after(100.0, 5_000, unshaken(), force, held=120.0)
    np.testing.assert_allclose(held.place, 0.5 * force / (50 + 0.25 * 120), rtol=1e-6)


def test_a_speed_left_over_counts_as_what_it_leads_to():
    """The estimate of a struck mode is there at once, and is how far it swings later."""
    struck = after(1e-4, 10, unshaken(), np.array([200.0, 0.0, 0.0]))
    swings = 0.5 * 200 * 1e-4 / 2 / 5 / 0.1
    np.testing.assert_allclose(struck.most, 1.5 * swings, rtol=1e-3)
    later = after(3.0, 1000, struck, np.zeros(3))
    np.testing.assert_allclose(later.most, struck.most, rtol=1e-2)
    assert np.linalg.norm(later.speed) < 0.5 * np.linalg.norm(struck.speed)


@pytest.mark.long
def test_a_grid_that_is_too_coarse_for_a_touch_is_told():
    """Number 211 of the stress test leaves what it touches wrongly on 12 intervals.

    Nothing else tells: its strains are smooth, and its steps short enough.
    """
    scene, tensions = contact_stress.scene_of(0, 211, True)
    rise = jnp.minimum(jnp.arange(1, 31) * 0.01 / 0.1, 1.0)[:, None] * tensions

    def moved(method):
        return jax.jit(lambda rise: sr.simulate(scene, 0.01, rise, method=method, **how))(rise)

    how = dict(substeps=4, throw=False)
    coarse, fine = moved(sr.Collocation(12)), moved(sr.Collocation(48))
    apart = np.linalg.norm(coarse.tip_positions - fine.tip_positions, axis=-1).max()
    apart /= float(scene.length)
    assert apart > 1e-2
    assert coarse.result == sr.RESULTS.inaccurate and fine.result == sr.RESULTS.successful
    assert coarse.stats["touch_error"][-1] > apart / 3
    assert np.max(coarse.stats["error"]) < 1e-4 and coarse.stats["time_error"][-1] < 1e-2
    assert fine.stats["touch_error"][-1] < 1e-3
