"""Rods that move in contact: bounces, friction, forces in time, derivatives."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from scipy.integrate import solve_ivp

import softrod_jax as sr
from softrod_jax.rod.contact import ContactForce
from softrod_jax.scene.acting import Here
from softrod_jax.scene.scene import as_arrays

METHOD = sr.Collocation(6)
L, R, E, NU, RHO, G = 0.1, 6e-3, 5e4, 0.49, 1070.0, 9.81
A, I = np.pi * R**2, np.pi * R**4 / 4
K, WALL = 2000.0, -0.03


def above_a_wall(*contacts, **changes):
    """The rod is held at one end, and falls on a wall when it is let go."""
    own = dict(
        length=L, section=sr.Circle(R), young_modulus=E, poisson_ratio=NU, density=RHO,
        gravity=[-G, 0.0, 0.0], plane="xz",
    )  # fmt: skip
    return as_arrays(sr.Scene(**(own | changes), contacts=contacts))


def wall(**parts):
    return sr.Contact(sr.Plane([WALL, 0.0, 0.0], [1.0, 0.0, 0.0]), K, name="wall", **parts)


def energies(motion):
    """Of motion, and of all together, at every step [J]: Simpson's rule over the nodes."""
    nodes = len(motion.arc_lengths)
    rule = np.array([1, *[4, 2] * ((nodes - 3) // 2), 4, 1]) * L / (nodes - 1) / 3
    shear, bend = E * A / (2 * (1 + NU)), np.array([E * I, E * I, E * I / (1 + NU)])
    stiffness = np.array([shear, shear, E * A, *bend])
    inertia = RHO * np.array([A, A, A, I, I, 2 * I])
    strains = motion.strains - np.array([0, 0, 1, 0, 0, 0])
    x = motion.positions[..., 0]
    depth = np.maximum(R - (x - WALL), 0)
    kinetic = motion.velocities**2 @ inertia / 2
    stored = strains**2 @ stiffness / 2 + K * depth**2 / 2 + RHO * A * G * x
    return kinetic @ rule, (kinetic + stored) @ rule


def test_a_rod_that_bounces_keeps_its_energy():
    """It falls, bounces and flies on: 99 % is kept, and damping and friction only take."""
    run = lambda dt, contact: sr.simulate(
        above_a_wall(contact), dt, steps=round(0.15 / dt), scheme=sr.SDIRK(4),
        method=sr.Collocation(24), max_time_error=1e9,
    )  # fmt: skip
    free, lossy = run(2.5e-3, wall()), run(2.5e-3, wall(damping=3.0, friction=0.3))
    # It has left the wall again, having been pressed by ten times its weight.
    push = np.array(free.contact_forces["wall"][:, 0])
    assert push.max() > 3 * RHO * A * L * G and push[-1] == 0 and push[0] == 0
    kinetic, total = energies(free)
    assert np.abs(total).max() < 0.01 * kinetic.max()
    # What the quadrature of the wall's energy misses between the nodes is below this.
    noise = 1e-3 * kinetic.max()
    assert np.diff(total).max() < noise
    _, left = energies(lossy)
    assert np.diff(left).max() < noise and left[-1] < -0.5 * kinetic.max()


def test_it_comes_to_rest_where_statics_is():
    """With damping in long steps, in a batch of walls; the force is that of the equilibrium."""
    scene = above_a_wall(wall(damping=1.0, friction=0.2), bending_damping=5e-6)

    def end(stiffness):
        changed = eqx.tree_at(lambda s: s.contacts[0].stiffness, scene, stiffness)
        motion = sr.simulate(
            changed, 0.5, steps=20, method=METHOD, scheme=sr.SDIRK(2), max_time_error=1e9,
            throw=False,
        )  # fmt: skip
        push = motion.contact_forces["wall"][-1]
        return motion.tip_positions[-1], push, motion.result

    tips, pushes, results = jax.jit(jax.vmap(end))(jnp.array([K, -1.0, 2 * K]))
    assert results.tolist() == [0, int(sr.RESULTS.bad_input), 0]
    still = sr.solve_static(scene, method=METHOD)
    np.testing.assert_allclose(tips[0], still.tip_position, rtol=0, atol=1e-7)
    np.testing.assert_allclose(pushes[0], still.contact_force["wall"], rtol=0, atol=1e-7)
    assert tips[2, 0] > tips[0, 0] + 1e-4
    # A motion that begins in an equilibrium has its force from the beginning on, and stays.
    motion = sr.simulate(scene, 0.01, steps=3, initial=still)
    pushes = motion.contact_forces["wall"]
    assert pushes.shape == (4, 3)
    np.testing.assert_allclose(pushes, np.tile(still.contact_force["wall"], (4, 1)), atol=1e-7)


def test_derivatives_of_a_force():
    """Of the mean over a motion into the wall: forward, reverse and central differences agree."""
    scene = above_a_wall(
        wall(damping=2.0, friction=0.3), tendons=sr.Tendons([[-4e-3, 0.0]]), bending_damping=1e-6
    )

    def mean(x):
        contact = dataclasses.replace(
            scene.contacts[0], stiffness=K * x[1], damping=2.0 * x[2], friction=0.3 * x[3]
        )
        motion = sr.simulate(
            dataclasses.replace(scene, contacts=(contact,)), 0.01, 0.1 * x[0] * jnp.ones((12, 1)),
            method=METHOD, max_time_error=1e9, throw=False,
        )  # fmt: skip
        return jnp.mean(motion.contact_forces["wall"], 0)[jnp.array([0, 2])]

    at = jnp.ones(4)
    forward, reverse = jax.jit(jax.jacfwd(mean))(at), jax.jit(jax.jacrev(mean))(at)
    size = np.abs(forward).max()
    assert np.all(np.abs(forward).max(axis=0) > 1e-3 * size)
    np.testing.assert_allclose(forward, reverse, rtol=0, atol=1e-9 * size)
    d = 1e-5
    points = jnp.stack([at + s * d * e for e in jnp.eye(4) for s in (1.0, -1.0)])
    values = jax.jit(jax.vmap(mean))(points)
    slopes = (values[0::2] - values[1::2]).T / (2 * d)
    np.testing.assert_allclose(forward, slopes, rtol=0, atol=1e-5 * size)


def test_the_force_of_a_wall_on_a_point():
    """Coulomb's law at the surface, with its moment about the axis; no velocity gains energy."""
    mu, slow, depth = 0.3, 1e-3, 2e-3
    plane = sr.Plane(jnp.array([0.0, 0.0, 0.0]), jnp.array([1.0, 0.0, 0.0]))
    load = ContactForce(sr.Contact(plane, K, damping=5.0, friction=mu, slip_speed=slow))
    turn = jnp.array([np.cos(0.2), 0.0, 0.0, np.sin(0.2)])  # about z
    n = np.array([np.cos(0.4), -np.sin(0.4), 0.0])
    across = np.array([np.sin(0.4), np.cos(0.4), 0.0])
    at = lambda q, w, x=R - depth: load.wrench(
        Here(
            jnp.array(0.0), turn, jnp.array(q), jnp.array(w), jnp.array([x, 0.0, 0.0]), jnp.array(R)
        )
    )
    still = np.zeros(3)
    f, l = at(still, still)
    np.testing.assert_allclose(f, K * depth * n, rtol=1e-12, atol=1e-15)
    np.testing.assert_allclose(l, 0.0, atol=1e-15)
    # Sliding along the rod, and across it: full friction, and a moment that rolls the rod.
    f, l = at(np.array([0.0, 0.0, 1.0]), still)
    np.testing.assert_allclose(f @ n, K * depth, rtol=1e-12)
    np.testing.assert_allclose(f[2], -mu * K * depth, rtol=1e-6)
    f, l = at(0.5 * across, still)
    np.testing.assert_allclose(f @ across, -mu * K * depth, rtol=1e-5)
    np.testing.assert_allclose(l, np.cross(-R * n, f), rtol=1e-12, atol=1e-15)
    # Rolling does not rub; at the slip speed friction is 1 / sqrt(2) of what it can be.
    f, _ = at(R * across, np.array([0.0, 0.0, 1.0]))
    np.testing.assert_allclose(f @ across, 0.0, atol=1e-12)
    f, _ = at(slow * across, still)
    np.testing.assert_allclose(f @ across, -mu * K * depth / np.sqrt(2), rtol=1e-12)
    # Hunt and Crossley: more when it goes in, less when it comes out, and never a pull.
    for speed, factor in ((0.1, 0.5), (-0.1, 1.5), (0.3, 0.0)):
        f, _ = at(speed * n, still)
        np.testing.assert_allclose(f @ n, factor * K * depth, rtol=1e-12, atol=1e-15)
    rng = np.random.default_rng(3)
    for q, w in rng.normal(size=(20, 2, 3)) * np.array([[0.2], [20.0]]):
        f, l = at(q, w)
        assert (f - K * depth * n) @ q + l @ w < 0
        assert np.all(np.stack(at(q, w, R + 1e-6)) == 0)


def test_on_an_incline_it_slides_as_a_block_does():
    """It creeps below the friction angle at the speed of the law, and slides off above it.

    A rod that lies on a slope across, so soft that its tip does not know the clamp yet, is a block:
    v' = g (sin a - mu cos a v / sqrt(v^2 + e^2)).
    """
    mu, slow, k, mass, dt, steps = 0.3, 1e-2, 1e4, 0.12, 1e-3, 12

    def slides(share):
        slope = jnp.arctan(share * mu)
        depth = mass * G * jnp.cos(slope) / k  # at which it carries the rod
        table = sr.Plane(jnp.array([1.0, 0.0, 0.0]) * (depth - R), [1.0, 0.0, 0.0])
        scene = sr.Scene(
            L, sr.Circle(R), linear_density=mass, inextensible=True,
            stiffness=sr.Stiffness(bending=[1e-6, 1e-6], torsion=10.0),
            gravity=G * jnp.stack([-jnp.cos(slope), jnp.sin(slope), 0.0 * slope]),
            contacts=(sr.Contact(table, k, friction=mu, slip_speed=slow),),
        )  # fmt: skip
        motion = sr.simulate(
            scene, dt, steps=steps, method=sr.Collocation(16), throw=False, max_time_error=1.0
        )
        return motion.tip_velocities[:, 1], motion.result

    shares = np.array([0.5, 0.9, 1.1, 2.0])
    speeds, results = jax.jit(jax.vmap(slides))(shares)
    assert results.tolist() == [0] * 4
    t = dt * np.arange(steps + 1)
    for share, speed in zip(shares, np.asarray(speeds), strict=True):
        slope = np.arctan(share * mu)
        rate = lambda t, v, a=slope: G * (np.sin(a) - mu * np.cos(a) * v / np.hypot(v, slow))
        block = solve_ivp(rate, (0, t[-1]), [0.0], "Radau", t, rtol=1e-9, atol=1e-13).y[0]
        np.testing.assert_allclose(speed[3:], block[3:], rtol=2e-3)
        if share < 1:
            assert np.all(speed <= slow * share / np.sqrt(1 - share**2))
        else:
            assert np.all(speed >= 0.999 * G * (np.sin(slope) - mu * np.cos(slope)) * t)
