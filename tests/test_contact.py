"""Rods in contact: equilibria with known answers, laws, derivatives and batches."""

import dataclasses
import json
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.linalg import expm
from scipy.optimize import brentq

import softrod_jax as sr
from softrod_jax.rod.reduction import make_rod
from softrod_jax.rod.state import layout_of
from softrod_jax.scene.scene import as_arrays

KNOWN = json.loads((Path(__file__).parent / "references" / "wider_static.json").read_text("utf-8"))
METHOD = sr.Collocation(6)
L, R, E = 0.1, 6e-3, 5e4
EI = E * np.pi * R**4 / 4


def rod(*contacts, **changes):
    own = dict(length=L, section=sr.Circle(R), young_modulus=E, poisson_ratio=0.49, density=1070.0)
    return as_arrays(sr.Scene(**(own | changes), contacts=contacts))


def wall(x, k=2000.0, **parts):
    """The rod is where its coordinate x is above this one."""
    return sr.Contact(sr.Plane([x, 0.0, 0.05], [3.0, 0.0, 0.0]), k, **parts)


TUBE = sr.Tube([[0.0, 0.0, 0.0], [0.0, 0.0, 0.06], [0.0, 0.0, L]], 0.012)
EQUILIBRIA = {
    "plane": rod(wall(-0.03), gravity=[-9.81, 0.0, 0.0]),
    "tube": rod(sr.Contact(TUBE, 2000.0), gravity=[-2.0, 0.0, -9.81]),
}


@pytest.mark.parametrize("name", EQUILIBRIA)
@pytest.mark.parametrize("plane", [None, "xz"])
def test_independent_equilibria(name, plane):
    scene = dataclasses.replace(EQUILIBRIA[name], plane=plane)
    known = KNOWN["equilibria"][name]
    tip = sr.solve_static(scene, tolerance=1e-5).tip_position
    assert np.linalg.norm(tip - np.array(known["tip"])) < 3 * known["error"]


def pushed_off(depth, x=1.2, method=METHOD, **changes):
    """A wall that is `depth` inside of the unloaded rod: a bed of springs, as stiff as `x` says."""
    k = 4 * EI * (x / L) ** 4
    return sr.solve_static(
        rod(wall(depth - R, k, name="bed"), inextensible=True, **changes), method=method
    )


@pytest.mark.parametrize("method", [METHOD, sr.Shooting(4, 10)], ids=["collocation", "shooting"])
@pytest.mark.parametrize("plane", [None, "xz"])
def test_a_rod_on_a_bed_has_its_closed_form(method, plane):
    """EI w'''' = k (depth - w) of a cantilever that all lies in the wall."""
    depth, x = 1e-6, 1.2
    solution = pushed_off(depth, x, method, plane=plane)
    root = x / L * np.array([1 + 1j, 1 - 1j, -1 + 1j, -1 - 1j])
    there = np.exp(root * L)
    rows = np.stack([np.ones(4), root, root**2 * there, root**3 * there])
    c = np.linalg.solve(rows, np.array([-depth, 0, 0, 0]))
    w = depth + (np.exp(np.outer(solution.arc_lengths, root)) @ c).real
    assert np.all(w < depth)
    np.testing.assert_allclose(solution.positions[:, 0], w, rtol=0, atol=1e-6 * depth)


def test_the_force_is_that_of_the_balance():
    """What the clamp holds is what obstacles and the tip's load bring, in space and a taper."""
    ball = sr.Contact(sr.Sphere([0.023, 0.004, 0.07], 0.02), 5e3, name="ball")
    force = np.array([0.0, 0.002, -0.001])
    scene = rod(
        wall(-0.004), ball, section_at_end=sr.Circle(4e-3), tip_load=sr.TipLoad(force=force)
    )
    solution = sr.solve_static(scene, method=sr.Collocation(24))
    assert set(solution.contact_force) == {"contact1", "ball"}
    pushes = np.stack([solution.contact_force[name] for name in ("contact1", "ball")])
    assert np.all(np.linalg.norm(pushes, axis=1) > 1e-3)
    np.testing.assert_allclose(pushes.sum(0) + force, solution.wrenches[0, :3], rtol=0, atol=1e-6)
    # A wall pushes along its normal, and a ball away from its centre.
    np.testing.assert_allclose(pushes[0, 1:], 0.0, atol=1e-12)
    assert pushes[0, 0] > 0 > pushes[1, 0]


def test_a_tip_pressed_on_a_wall_by_a_known_force():
    """A rod that is pulled along its axis into a wall across: statics of stretch, by quadrature."""
    F, k = 0.5, 4e4
    across = sr.Contact(sr.Plane([0.0, 0.0, L + R], [0.0, 0.0, -1.0]), k, name="wall")
    load = sr.TipLoad(force=np.array([0.0, 0.0, F]))
    scene = rod(across, tip_load=load, plane="xz", young_modulus=1e5)
    solution = sr.solve_static(scene, method=sr.Collocation(300))
    EA = 1e5 * np.pi * R**2
    depth = float(solution.tip_position[2]) - L
    base = float(solution.wrenches[0, 2])
    push = -float(solution.contact_force["wall"][2])
    assert 0.1 * F < push < F
    np.testing.assert_allclose(base, F - push, rtol=1e-6)
    # Within the wall EA v_s = k d for the depth d, and d_s = v: so EA v v_s = k d d_s.
    n0 = 1 + base / EA
    n1 = 1 + F / EA
    # The force begins within an interval, of which there are nine in the wall.
    np.testing.assert_allclose(EA * (n1**2 - n0**2), k * depth**2, rtol=3e-4)


def in_a_tube(gap, k, base=(0.0, 0.0, 0.0), **changes):
    """A slender rod in a straight tube with a gap around it, three times as long as the others."""
    tube = sr.Contact(sr.Tube([[0.0, 0.0, 0.0], [0.0, 0.0, 3 * L]], R + gap), k, name="tube")
    measured = sr.Stiffness(bending=[SLENDER, SLENDER], torsion=SLENDER)
    own = dict(stiffness=measured, linear_density=0.12, inextensible=True, base_position=base)
    return as_arrays(sr.Scene(3 * L, sr.Circle(R), contacts=(tube,), **(own | changes)))


SLENDER = 5e-5  # N m^2


def test_a_rod_in_a_tube_buckles_at_the_known_load():
    """One that lies in it: EI y'''' + F y'' + (w / r) y = 0, the tube's floor being a cradle.

    Long rods buckle at 2 sqrt(EI w / r) between their ends (Dawson & Paslay, 1984), and at half of
    it where an end is free (Hetenyi, 1946).
    """
    weight, gap, k = 0.12 * 9.81, 4e-3, 2e3
    r = gap + weight / k
    rows = lambda F: [[0, 1, 0, 0], [0, 0, 1 / SLENDER, 0], [0, -F, 0, 1], [-weight / r, 0, 0, 0]]
    # From the clamp, y = y' = 0, to the free end, where moment and force are zero.
    free_end = lambda F: np.linalg.det(expm(3 * L * np.array(rows(F)))[2:, 2:])
    long = 2 * np.sqrt(SLENDER * weight / r)
    known = brentq(free_end, 0.4 * long, 0.6 * long)
    np.testing.assert_allclose(known, long / 2, rtol=1e-4)

    @jax.jit
    @jax.vmap
    def straight(push):
        load = sr.TipLoad(force=jnp.array([0.0, 0.0, -1.0]) * push)
        scene = in_a_tube(gap, k, (-r, 0.0, 0.0), gravity=[-9.81, 0.0, 0.0], tip_load=load)
        solution = sr.solve_static(scene, method=sr.Collocation(24), throw=False)
        return solution.result, solution.stats["stable"], solution.tip_position

    results, stable, tips = straight(known * np.array([0.5, 0.99, 1.01, 1.1]))
    assert results.tolist() == [0] * 4 and stable.tolist() == [True, True, False, False]
    np.testing.assert_allclose(tips, np.tile([-r, 0.0, 3 * L], (4, 1)), rtol=0, atol=1e-9)


@pytest.mark.parametrize("bent", [False, True])
def test_distances_and_their_slopes(bent):
    """Of points on all sides of a tube's axis, and on it, where no direction leads away."""
    axis = [[0.0, 0.0, 0.0], [0.0, 0.0, 1.0], [1.0 if bent else 0.0, 0.0, 2.0]]
    tube = sr.Tube(jnp.array(axis), 0.3)
    slope = jax.grad(tube.distance)
    for z in (-5.0, 0.5, 0.999):
        p = jnp.array([0.0, 0.2, z])
        assert abs(tube.distance(p) - 0.1) < 1e-12
        np.testing.assert_allclose(slope(p), [0.0, -1.0, 0.0], atol=1e-12)
    on = jnp.array([0.0, 0.0, 0.4])
    assert tube.distance(on) == 0.3
    assert np.all(slope(on) == 0) and np.all(np.isfinite(jax.hessian(tube.distance)(on)))
    # Past the last point its last piece goes on.
    far = jnp.array([3.0 if bent else 0.0, 0.4, 4.0])
    assert abs(tube.distance(far) + 0.1) < 1e-12
    # Outside of the bend it is round.
    if bent:
        p = jnp.array([-0.2, 0.0, 1.05])
        np.testing.assert_allclose(tube.distance(p), 0.3 - np.hypot(0.2, 0.05), rtol=1e-12)
    ball = sr.Sphere(jnp.array([1.0, 0.0, 0.0]), 0.5)
    np.testing.assert_allclose(ball.distance(jnp.array([1.0, 3.0, 4.0])), 4.5)
    assert np.all(jax.grad(ball.distance)(jnp.array([1.0, 0.0, 0.0])) == 0)
    plane = sr.Plane(jnp.array([0.0, 0.0, 1.0]), jnp.array([0.0, -1e-200, 1e-200]))
    np.testing.assert_allclose(plane.distance(jnp.array([0.0, 0.0, 3.0])), np.sqrt(2))


@pytest.mark.long
def test_derivatives_and_batches():
    """Forward, reverse and central differences agree; a sample that cannot be fails alone."""
    scene = rod(
        wall(-0.03, name="wall"), sr.Contact(TUBE, 2000.0, name="tube"), gravity=[-9.0, 2.0, 0.0]
    )

    def found(x):
        changes = lambda s: (
            s.contacts[0].stiffness,
            s.contacts[0].obstacle.point,
            s.contacts[1].obstacle.radius,
            s.gravity,
        )
        values = 2000.0 * x[0], jnp.array([-0.008 * x[1], 0.0, 0.0]), 0.014 * x[2]
        changed = eqx.tree_at(changes, scene, (*values, x[3] * scene.gravity))
        solution = sr.solve_static(changed, method=METHOD, throw=False)
        forces = [100 * L * x for x in solution.contact_force.values()]
        return jnp.concatenate([solution.tip_position, *forces]), solution.result

    at = jnp.array([1.0, 1.0, 1.0, 1.0])
    answer = lambda x: found(x)[0]
    forward, reverse = jax.jit(jax.jacfwd(answer))(at), jax.jit(jax.jacrev(answer))(at)
    size = np.abs(forward).max()
    assert np.all(np.abs(forward).max(axis=0) > 1e-4)
    np.testing.assert_allclose(forward, reverse, rtol=0, atol=1e-9 * size)
    d, bad = 1e-5, at.at[0].set(-1.0)
    points = jnp.stack([*(at + s * d * e for e in jnp.eye(4) for s in (1.0, -1.0)), bad, at])
    values, results = jax.jit(jax.vmap(found))(points)
    assert results.tolist() == [0] * 8 + [int(sr.RESULTS.bad_input), 0]
    slopes = (values[0:8:2] - values[1:8:2]).T / (2 * d)
    np.testing.assert_allclose(forward, slopes, rtol=0, atol=1e-5 * size)
    np.testing.assert_allclose(values[-1], jax.jit(answer)(at), rtol=0, atol=1e-12)
    slope = jax.jit(jax.vmap(jax.jacrev(answer)))(jnp.stack([bad, at]))
    assert np.all(slope[0] == 0)
    np.testing.assert_allclose(slope[1], reverse, rtol=0, atol=1e-9 * size)


class Bowl(sr.AbstractObstacle):
    """A paraboloid: a distance that is right to first order only."""

    steepness: jax.Array

    def distance(self, p):
        return p[0] + 0.03 - self.steepness * (p[1] ** 2 + (p[2] - L) ** 2)


def test_an_obstacle_of_ones_own():
    """Flat it is the plane; curved the rod lies higher in it."""
    at = lambda steepness: (
        sr.solve_static(
            rod(sr.Contact(Bowl(jnp.array(steepness)), 2000.0), gravity=[-9.81, 0.0, 0.0]),
            method=METHOD,
        ).tip_position
    )
    flat = sr.solve_static(EQUILIBRIA["plane"], method=METHOD).tip_position
    np.testing.assert_allclose(at(0.0), flat, rtol=0, atol=1e-12)
    assert at(2.0)[0] > flat[0] + 1e-5


def test_what_is_not_touched_costs_nothing():
    grid = METHOD.grid(rod())
    size = lambda scene: layout_of(make_rod(scene, grid=grid), dynamic=True).size
    assert (size(rod()), size(rod(wall(-0.03)))) == (12, 19)
    assert make_rod(rod(), grid=grid).radius is None
    assert sr.solve_static(rod(), method=METHOD).contact_force == {}
    # An obstacle that the rod does not reach changes nothing.
    gravity = [-9.81, 0.0, 0.0]
    apart = [sr.solve_static(rod(*x, gravity=gravity), method=METHOD) for x in ((), [wall(-0.2)])]
    np.testing.assert_allclose(apart[0].positions, apart[1].positions, rtol=0, atol=1e-9)
    assert np.all(apart[1].contact_force["contact1"] == 0)
