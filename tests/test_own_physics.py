"""Energies, materials, distributed loads and a time scheme that exist only here: one class each.

Each works in statics, motions, derivatives, batches and continuation, and none of it is known to
the package.
"""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads
from plain_rod import E, L, R, rod

import softrod_jax as sr
from softrod_jax.rod.reduction import make_rod
from softrod_jax.rod.rotations import to_body
from softrod_jax.rod.state import layout_of
from softrod_jax.scene.scene import as_arrays
from softrod_jax.stepping.scheme import AbstractTimeScheme, LocalErrors, combine

METHOD = sr.Collocation(6)
EA, EI = E * np.pi * R**2, E * np.pi * R**4 / 4


class Stiffening(sr.AbstractEnergy):
    """Springs that resist bending the more, the more they are bent: k4 |u|^4 / 4."""

    k4: jax.Array

    def density(self, v, u, s):
        return 0.25 * self.k4 * jnp.sum(u * u) ** 2


class Linear(sr.AbstractEnergy):
    """The linear law of the package, written as an energy."""

    E: jax.Array
    nu: float

    def density(self, v, u, s):
        G, A, I = self.E / (2 * (1 + self.nu)), np.pi * R**2, np.pi * R**4 / 4
        K_se = jnp.stack([G * A, G * A, self.E * A])
        K_bt = jnp.stack([self.E * I, self.E * I, 2 * G * I])
        e = v - jnp.array([0.0, 0.0, 1.0])
        return 0.5 * (e @ (K_se * e) + u @ (K_bt * u))


class Logarithmic(Linear):
    """A law whose force is EA (1 - 1/l) in pure stretch l."""

    def density(self, v, u, s):
        A, l = np.pi * R**2, v[2]
        straight = 0.5 * self.E * A * (l - 1) ** 2
        return super().density(v, u, s) - straight + self.E * A * (l - 1 - jnp.log(l))


class Viscous(sr.AbstractDissipation):
    """Kelvin-Voigt damping of bending and twist: B |u_t|^2 / 2."""

    B: jax.Array

    def potential(self, v_t, u_t, s):
        return 0.5 * self.B * jnp.sum(u_t * u_t)


class Cubic(sr.AbstractDissipation):
    """Damping that grows with the rate: B |u_t|^4 / 4."""

    B: jax.Array

    def potential(self, v_t, u_t, s):
        return 0.25 * self.B * jnp.sum(u_t * u_t) ** 2


class Wind(sr.AbstractDistributedLoad):
    """A force per length that is the same everywhere, [N/m], base frame."""

    force: jax.Array

    def wrench(self, here):
        return to_body(here.quaternion, self.force), jnp.zeros(3)


class Water(sr.AbstractDistributedLoad):
    """Square-law drag."""

    C: jax.Array

    def wrench(self, here):
        return -self.C * here.velocity * jnp.abs(here.velocity), jnp.zeros(3)


WEIGHT = 1070.0 * np.pi * R**2 * 9.81
ACROSS = np.array([-9.81, 0.0, 0.0])
PULLS = dict(tendons=sr.Tendons([[4e-3, 0.0], [0.0, 4e-3]]))


def linear(**changes):
    """A rod of the linear law, as a material of one's own."""
    own = dict(young_modulus=None, poisson_ratio=None, material=Linear(E, 0.49))
    return rod(**(own | changes))


def windy(**changes):
    return rod(distributed_loads=(Wind(WEIGHT * ACROSS / 9.81),), **changes)


PAIRS = {
    "material": (linear(gravity=ACROSS, **PULLS), rod(gravity=ACROSS, **PULLS)),
    "material, inextensible": (
        linear(gravity=ACROSS, inextensible=True),
        rod(gravity=ACROSS, inextensible=True),
    ),
    "material, plane": (linear(gravity=ACROSS, plane="xz"), rod(gravity=ACROSS, plane="xz")),
    "load": (windy(**PULLS), rod(gravity=ACROSS, **PULLS)),
    "load, plane": (windy(plane="xz"), rod(gravity=ACROSS, plane="xz")),
    "damping": (
        rod(gravity=ACROSS, bending_damping=None, dissipations=(Viscous(1e-6),), **PULLS),
        rod(gravity=ACROSS, **PULLS),
    ),
    "damping, plane, inextensible": (
        rod(
            gravity=ACROSS,
            bending_damping=None,
            dissipations=(Viscous(1e-6),),
            plane="xz",
            inextensible=True,
        ),
        rod(gravity=ACROSS, plane="xz", inextensible=True),
    ),
}


def tensions(scene):
    return None if scene.tendons is None else jnp.array([0.3, 0.1])


def moved(scene, steps=6):
    pulls = tensions(scene)
    rows = None if pulls is None else jnp.tile(pulls, (steps, 1))
    motion = sr.simulate(
        scene, 0.01, rows, steps=steps, method=METHOD, max_time_error=0.5, throw=False
    )
    return motion.tip_positions, motion.result


@pytest.mark.parametrize("name", PAIRS)
def test_what_is_written_again_does_the_same(name):
    own, built_in = PAIRS[name]
    still = [sr.solve_static(x, tensions(x), method=METHOD) for x in (own, built_in)]
    np.testing.assert_allclose(still[0].positions, still[1].positions, rtol=0, atol=1e-9)
    moving = [jax.jit(moved)(x) for x in (own, built_in)]
    assert [int(x[1]) for x in moving] == [0, 0]
    np.testing.assert_allclose(moving[0][0], moving[1][0], rtol=0, atol=1e-8)


def test_damping_written_again_has_the_same_modes():
    own, built_in = (as_arrays(dataclasses.replace(x, tendons=None)) for x in PAIRS["damping"])
    found = [sr.modes(x, method=METHOD, count=4).eigenvalues for x in (own, built_in)]
    assert np.min(np.abs(found[1].real)) > 1e-3
    np.testing.assert_allclose(found[0], found[1], rtol=1e-8)


def test_damping_that_grows_with_the_rate_takes_energy_and_has_derivatives():
    """A rod that is let go: with such damping its highest swings are lost first, never gained."""
    undamped = dict(gravity=ACROSS, bending_damping=None)

    @jax.jit
    def tip(B):
        scene = rod(dissipations=(Cubic(B),), **undamped)
        motion = sr.simulate(scene, 0.01, steps=12, method=METHOD, max_time_error=0.5, throw=False)
        return 10 * motion.tip_positions[-1, 0], jnp.min(motion.tip_positions[:, 0])

    sunk = [float(tip(B)[1]) for B in (1e-12, 1e-10, 1e-9)]
    assert sunk[0] < sunk[1] < sunk[2] < -1e-3
    check_grads(lambda x: tip(1e-9 * x)[0], (1.0,), order=1, atol=1e-6, rtol=1e-6, eps=1e-4)


def test_drag_written_again_does_the_same():
    own = rod(gravity=ACROSS, distributed_loads=(Water(jnp.full(3, 2.0)),))
    built_in = rod(gravity=ACROSS, drag_coefficient=jnp.full(3, 2.0))
    a, b, none = (jax.jit(moved)(x)[0] for x in (own, built_in, rod(gravity=ACROSS)))
    assert np.abs(b - none).max() > 1e-3
    np.testing.assert_allclose(a, b, rtol=0, atol=1e-9)


@pytest.mark.parametrize("method", [METHOD, sr.Shooting(2, 10)], ids=["collocation", "shooting"])
def test_springs_have_their_closed_form(method):
    """E I u + k4 u^3 = M0 under a moment at the tip."""
    k4, u = 3e-7, 12.0
    M0 = EI * u + k4 * u**3
    load = sr.TipLoad(moment=np.array([0.0, M0, 0.0]))
    solution = sr.solve_static(rod(tip_load=load, energies=(Stiffening(k4),)), method=method)
    np.testing.assert_allclose(solution.strains[:, 4], u, rtol=1e-9)


def test_a_material_has_its_closed_form():
    """EA (1 - 1/l) = N under a force along the rod, in a steep continuation."""
    N = 0.9 * EA
    scene = rod(
        young_modulus=None,
        poisson_ratio=None,
        material=Logarithmic(E, 0.49),
        tip_load=sr.TipLoad(force=np.array([0.0, 0.0, N])),
    )
    solution = sr.solve_static(scene, method=METHOD)
    np.testing.assert_allclose(solution.strains[:, 2], 10.0, rtol=1e-8)


def test_derivatives_and_batches():
    """Forward, reverse and central differences agree, and a batch is a loop."""
    scene = rod(
        gravity=ACROSS,
        energies=(Stiffening(1e-7),),
        distributed_loads=(Wind(np.array([0.0, 0.3, 0.1])),),
        **PULLS,
    )

    def tip(x):
        changed = dataclasses.replace(
            scene,
            energies=(Stiffening(1e-7 * x[0]),),
            distributed_loads=(Wind(x[1] * jnp.array([0.0, 0.3, 0.1])),),
        )
        still = sr.solve_static(changed, tensions(scene), method=METHOD, throw=False)
        return jnp.concatenate([still.tip_position, moved(changed, 3)[0][-1]])

    at = jnp.array([1.0, 0.8])
    forward, reverse = jax.jit(jax.jacfwd(tip))(at), jax.jit(jax.jacrev(tip))(at)
    assert np.abs(forward).min(axis=0).max() > 1e-6
    np.testing.assert_allclose(forward, reverse, rtol=0, atol=1e-9 * np.abs(forward).max())
    batch = jax.jit(jax.vmap(tip))
    d = 1e-3
    points = jnp.stack([at + s * d * e for e in jnp.eye(2) for s in (1.0, -1.0)])
    moved_by = batch(points)
    slopes = np.stack([(moved_by[0] - moved_by[1]), (moved_by[2] - moved_by[3])], 1) / (2 * d)
    np.testing.assert_allclose(forward, slopes, rtol=0, atol=1e-5 * np.abs(forward).max())
    np.testing.assert_allclose(moved_by[1], jax.jit(tip)(points[1]), rtol=0, atol=1e-12)


def test_continuation_raises_loads_of_ones_own():
    """A wind of 40 times the weight: loads rise in steps, and the answer is that of gravity."""
    strong = 40 * WEIGHT * ACROSS / 9.81
    own = sr.solve_static(rod(distributed_loads=(Wind(strong),)))
    gravity = sr.solve_static(rod(gravity=40 * ACROSS))
    assert int(own.stats["load_steps"]) > 1
    np.testing.assert_allclose(own.tip_position, gravity.tip_position, rtol=0, atol=1e-8)


class Bed(sr.AbstractDistributedLoad):
    """Springs across the rod, k [N/m^2], to the line along z from `origin` (Winkler's bed)."""

    k: jax.Array
    origin: jax.Array
    needs_position = True

    def wrench(self, here):
        off = (here.position - self.origin) * jnp.array([1.0, 1.0, 0.0])
        return to_body(here.quaternion, -self.k * off), jnp.zeros(3)


BED = 4 * EI * (2.5 / L) ** 4


def on_a_bed(force, k=BED, **changes):
    bed = Bed(jnp.asarray(k), np.asarray(changes.get("base_position", np.zeros(3))))
    load = sr.TipLoad(force=force * np.array([EI / L**2, 0.0, 0.0]))
    return rod(distributed_loads=(bed,), tip_load=load, **changes)


@pytest.mark.parametrize("method", [METHOD, sr.Shooting(4, 10)], ids=["collocation", "shooting"])
@pytest.mark.parametrize("plane", [None, "xz"])
def test_a_bed_of_springs_has_its_closed_form(method, plane):
    """Hetenyi, Beams on Elastic Foundation (1946): a cantilever under a force at its free end."""
    force = 1e-4
    scene = on_a_bed(force, inextensible=True, plane=plane, base_position=np.array([0.3, 0.2, 0.1]))
    tip = sr.solve_static(scene, method=method).tip_position - np.array([0.3, 0.2, 0.1])
    x = 2.5
    shape = np.sinh(x) * np.cosh(x) - np.sin(x) * np.cos(x)
    expected = 2 * force * EI / L**2 * (x / L) / BED * shape / (np.cosh(x) ** 2 + np.cos(x) ** 2)
    np.testing.assert_allclose(tip[:2], [expected, 0.0], rtol=1e-6, atol=1e-12)


def test_a_bed_of_springs_in_motion():
    """A damped rod comes to rest where statics is, in a batch; derivatives agree."""
    damped = dict(bending_damping=5e-6, inextensible=True)

    def tip(force, k):
        scene = on_a_bed(force, k, **damped)
        motion = sr.simulate(
            scene, 0.5, steps=20, method=METHOD, scheme=sr.SDIRK(2), max_time_error=1e9, throw=False
        )
        return motion.tip_positions[-1]

    still = sr.solve_static(on_a_bed(5.0, **damped), method=METHOD)
    assert still.tip_position[0] > 0.1 * L
    by = jax.jit(jax.jacfwd(tip, argnums=(0, 1)))(5.0, BED)
    reverse = jax.jit(jax.jacrev(tip, argnums=(0, 1)))(5.0, BED)
    np.testing.assert_allclose(by, reverse, rtol=1e-8, atol=1e-12)
    batch = jax.jit(jax.vmap(tip, (0, None)))(jnp.array([4.999, 5.0, 5.001]), BED)
    np.testing.assert_allclose(batch[1], still.tip_position, rtol=0, atol=1e-6)
    np.testing.assert_allclose(by[0], (batch[2] - batch[0]) / 2e-3, rtol=0, atol=1e-5 * L)


def test_the_position_is_an_unknown_only_where_a_load_asks():
    grid = METHOD.grid(rod())
    size = lambda scene: layout_of(make_rod(scene, grid=grid), dynamic=True).size
    assert (size(rod()), size(windy()), size(on_a_bed(1.0))) == (12, 16, 19)


class BackwardEuler(AbstractTimeScheme):
    """y_1 = y_0 + dt y_t,1."""

    stages: int = eqx.field(static=True, default=1, init=False)
    order: int = eqx.field(static=True, default=1, init=False)
    one_step: bool = eqx.field(static=True, default=False, init=False)

    def coefficients(self, dt, restart):
        return jnp.broadcast_to(1 / dt, restart.shape)

    def start(self, y, guess):
        return y, jax.tree.map(jnp.zeros_like, y)

    def step(self, memory, coefficients, solve, carry):
        (y0, rate0), c0 = memory, coefficients
        history = jax.tree.map(lambda x: -c0 * x, y0)
        y, carry = solve(c0, history, 1.0, carry)
        rate = combine((c0, y), (1.0, history))
        local = combine((0.5 / c0, rate), (-0.5 / c0, rate0))
        return (y, rate), carry, LocalErrors(difference=local)


def test_a_time_scheme_of_ones_own():
    """Of first order, with an estimate above its error and derivatives of both kinds."""
    scene = rod(gravity=ACROSS)

    def end(factor, substeps):
        motion = sr.simulate(
            dataclasses.replace(scene, gravity=factor * ACROSS), 0.01, steps=5, substeps=substeps,
            scheme=BackwardEuler(), method=METHOD, max_time_error=1e9, throw=False,
        )  # fmt: skip
        return motion.tip_positions[-1], motion.stats["time_error"][-1]

    run = jax.jit(end, static_argnums=1)
    right = jax.jit(lambda: sr.simulate(scene, 1e-3, steps=50, method=METHOD, throw=False))()
    found = [run(1.0, n) for n in (8, 16)]
    errors = [np.linalg.norm(tip - right.tip_positions[-1]) for tip, _ in found]
    assert 1.7 < errors[0] / errors[1] < 2.5
    for error, (_, estimate) in zip(errors, found, strict=True):
        assert error < L * estimate < 20 * error
    tip = lambda factor: end(factor, 4)[0]
    forward, reverse = (jax.jit(by(tip))(1.0) for by in (jax.jacfwd, jax.jacrev))
    np.testing.assert_allclose(forward, reverse, rtol=1e-9, atol=1e-12)
