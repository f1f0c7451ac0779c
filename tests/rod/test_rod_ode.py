"""The rod equations against the paper's own form, and their written-out Jacobian."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from paper_form import balance, material_wrench

import softrod_jax as sr
from softrod_jax.rod.boundary_conditions import tip_condition
from softrod_jax.rod.constitutive import compliance, imbalance, local_problem, recover_strain
from softrod_jax.rod.grid import uniform_grid
from softrod_jax.rod.jacobian import rod_ode_jacobian, to_body_by_attitude
from softrod_jax.rod.ode import rod_ode
from softrod_jax.rod.reduction import make_rod
from softrod_jax.rod.rotations import hat, quaternion_exp, rotation_matrix, to_body
from softrod_jax.rod.state import History, Layout
from softrod_jax.scene.inputs import Inputs
from softrod_jax.scene.scene import as_arrays


def full_scene(**changes):
    parts = dict(
        length=0.1,
        section=sr.Annulus(6e-3, 2e-3),
        young_modulus=1e5,
        poisson_ratio=0.45,
        density=1070.0,
        bending_damping=jnp.array([1e-6, 2e-6, 3e-6]),
        shear_damping=0.02,
        gravity=jnp.array([-9.0, 1.0, 2.0]),
        drag_coefficient=jnp.array([0.03, 0.02, 0.01]),
        tendons=sr.Tendons(jnp.array([[4e-3, 0.0], [-2e-3, 3e-3], [0.0, -4e-3]])),
        chambers=sr.Chambers(jnp.array([7e-6, 4e-6]), jnp.array([[0.0, 0.0], [1e-3, -2e-3]])),
        payload=sr.Payload(0.01),
        tip_load=sr.TipLoad(jnp.array([0.01, 0.02, 0.03]), jnp.array([1e-4, -2e-4, 3e-4])),
        shear_correction=0.9,
        rest_curvature=jnp.array([2.0, -1.0, 3.0]),
        rest_stretch=jnp.array([0.01, -0.02, 1.1]),
    )
    return as_arrays(sr.Scene(**(parts | changes)))


TENSIONS, PRESSURES = jnp.array([0.2, 0.05, 0.1]), jnp.array([2e4, 1e4])


def random_point(seed, layout):
    rng = np.random.default_rng(seed)
    h = quaternion_exp(jnp.array(rng.normal(size=3)))
    wrench = jnp.array(rng.normal(size=6)) * jnp.array([0.05] * 3 + [1e-4] * 3)
    q, w = jnp.array(rng.normal(size=3)), 5 * jnp.array(rng.normal(size=3))
    y = layout.join(h if layout.attitude else None, q, w, wrench[:3], wrench[3:])
    history = History(
        jnp.array(100.0),
        jnp.array(rng.normal(size=6)) * jnp.array([0.1] * 3 + [50.0] * 3),
        jnp.array(rng.normal(size=6)) * 20,
    )
    return y, history


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_total_wrench_form_equals_the_papers(seed):
    scene = full_scene()
    rod = make_rod(scene, Inputs(TENSIONS, PRESSURES))
    layout = Layout(attitude=True, dynamic=True)
    y, history = random_point(seed, layout)
    guess = jnp.array([0.0, 0, 1, 0, 0, 0])

    # Move along the rod by the ODE: all that the paper's form needs is a function of s.
    def along(ds):
        y_s = rod_ode(y, rod, layout, history, guess).y_s
        here = y + ds * y_s
        h, q, w, N, M = layout.split(here)
        x, _ = recover_strain(local_problem(rod, here[-6:], history.c0, history.strain), guess)
        v, u = x[:3], x[3:]
        v_t, u_t = history.c0 * v + history.strain[:3], history.c0 * u + history.strain[3:]
        R = rotation_matrix(h)
        n, m = material_wrench(rod, v, u, v_t, u_t, R)
        return {"v": v, "u": u, "n": n, "m": m, "h": h, "p_s": R @ v}

    at = along(0.0)
    slope = jax.jacfwd(along)(0.0)
    h, q, w, N, M = layout.split(y)
    q_t, w_t = history.c0 * q + history.velocity[:3], history.c0 * w + history.velocity[3:]
    n_s, m_s = balance(
        rod, scene, PRESSURES, h, q, w, q_t, w_t, at["v"], at["u"], slope["v"], slope["u"], at["n"]
    )
    np.testing.assert_allclose(slope["n"], n_s, rtol=1e-9, atol=1e-10)
    np.testing.assert_allclose(slope["m"], m_s, rtol=1e-9, atol=1e-12)


def test_kinematics_are_those_of_a_moving_frame():
    scene = full_scene()
    rod = make_rod(scene, Inputs(TENSIONS, PRESSURES))
    layout = Layout(attitude=True, dynamic=True)
    y, history = random_point(3, layout)
    rates = rod_ode(y, rod, layout, history, jnp.array([0.0, 0, 1, 0, 0, 0]))
    h, q, w, _, _ = layout.split(y)
    h_s, q_s, w_s, _, _ = layout.split(rates.y_s)
    v, u = rates.strain[:3], rates.strain[3:]
    v_t = history.c0 * v + history.strain[:3]
    u_t = history.c0 * u + history.strain[3:]
    _, R_s = jax.jvp(rotation_matrix, (h,), (h_s,))
    np.testing.assert_allclose(R_s, rotation_matrix(h) @ hat(u), rtol=1e-12, atol=1e-9)
    np.testing.assert_allclose(q_s, v_t - hat(u) @ q + hat(w) @ v, rtol=1e-12)
    np.testing.assert_allclose(w_s, u_t - hat(u) @ w, rtol=1e-12)


@pytest.mark.parametrize("attitude", [True, False])
@pytest.mark.parametrize("tendons", [True, False])
def test_jacobian_is_the_derivative(attitude, tendons):
    none = {} if attitude else dict(gravity=None, tip_load=None)
    rod = make_rod(full_scene(**none), Inputs(TENSIONS if tendons else None, PRESSURES))
    layout = Layout(attitude=attitude, dynamic=True)
    y, history = random_point(4, layout)
    guess = jnp.array([0.0, 0, 1, 0, 0, 0])
    rates = rod_ode(y, rod, layout, history, guess)
    written = rod_ode_jacobian(y, rates.strain, rod, layout, history).state
    derived = jax.jacfwd(lambda y: rod_ode(y, rod, layout, history, guess).y_s)(y)
    size = np.abs(derived).max(axis=1, keepdims=True)
    np.testing.assert_allclose(written / size, derived / size, atol=1e-13)


def test_static_jacobian_is_the_derivative():
    rod = make_rod(full_scene(), Inputs(TENSIONS, PRESSURES), dynamic=False)
    layout = Layout(attitude=True, dynamic=False)
    y, _ = random_point(5, Layout(attitude=True, dynamic=True))
    y = jnp.concatenate([y[:4], y[-6:]])
    guess = jnp.array([0.0, 0, 1, 0, 0, 0])
    rates = rod_ode(y, rod, layout, None, guess)
    written = rod_ode_jacobian(y, rates.strain, rod, layout, None).state
    derived = jax.jacfwd(lambda y: rod_ode(y, rod, layout, None, guess).y_s)(y)
    np.testing.assert_allclose(written, derived, rtol=1e-10, atol=1e-12)


def test_attitude_derivative():
    rng = np.random.default_rng(6)
    h, a = jnp.array(rng.normal(size=4)), jnp.array(rng.normal(size=3))
    np.testing.assert_allclose(
        to_body_by_attitude(h, a), jax.jacfwd(lambda h: to_body(h, a))(h), atol=1e-14
    )


def test_strains_minimise_the_energy():
    rod = make_rod(full_scene(), Inputs(TENSIONS, PRESSURES))
    rng = np.random.default_rng(7)
    wrench = jnp.array(rng.normal(size=(50, 6))) * jnp.array([0.05] * 3 + [1e-4] * 3)
    problem = local_problem(rod, wrench)
    start = jnp.broadcast_to(jnp.array([0.0, 0, 1, 0, 0, 0]), (50, 6))
    x, solvable = recover_strain(problem, start)
    assert bool(solvable)

    def energy(x, wrench):  # as in the module's heading, without its shortcuts
        v, u = x[:3], x[3:]
        W = 0.5 * (v - rod.v_star) @ (rod.K_se * (v - rod.v_star))
        W += 0.5 * (u - rod.u_star) @ (rod.K_bt * (u - rod.u_star))
        for tau, (a, b) in zip(TENSIONS, full_scene().tendons.offsets, strict=True):
            W += tau * jnp.linalg.norm(v + jnp.cross(u, jnp.array([a, b, 0.0])))
        chambers = full_scene().chambers
        for P, area, (a, b) in zip(PRESSURES, chambers.areas, chambers.offsets, strict=True):
            W -= P * area * (v + jnp.cross(u, jnp.array([a, b, 0.0])))[2]
        return W - wrench @ x

    slope = jax.vmap(jax.grad(energy))(x, wrench)
    np.testing.assert_allclose(slope[:, :3], 0, atol=1e-10)
    np.testing.assert_allclose(slope[:, 3:], 0, atol=1e-13)
    hessian = jax.vmap(jax.hessian(energy))(x, wrench)
    product = np.einsum("pij,pjk->pik", compliance(problem, x), hessian)
    np.testing.assert_allclose(product, np.broadcast_to(np.eye(6), product.shape), atol=1e-9)


def test_the_viscosity_of_fronts_follows_from_a_potential():
    """tau_i mu |l_t|^3 / (3 c0) for each tendon's path, on top of the energy."""
    plain = make_rod(full_scene(), Inputs(TENSIONS, PRESSURES))
    grid = uniform_grid(full_scene().length, 5, np.zeros(1), np.ones(6))
    rod = make_rod(full_scene(), Inputs(TENSIONS, PRESSURES), grid=grid, spread_fronts=True)
    rng = np.random.default_rng(8)
    wrench = jnp.array(rng.normal(size=(20, 6))) * jnp.array([0.05] * 3 + [1e-4] * 3)
    c0, history = jnp.array(800.0), jnp.array(rng.normal(size=(20, 6))) * 5
    history = history.at[:, 2].add(-800.0)  # rates about as large as those of a front
    arguments = wrench, c0, history
    problem, without = local_problem(rod, *arguments), local_problem(plain, *arguments)
    x, solvable = recover_strain(problem, jnp.array([0.0, 0, 1, 0, 0, 0]))
    assert bool(solvable)

    def potential(x, history):
        rate = c0 * x + history
        total = 0.0
        for tau, (a, b) in zip(TENSIONS, full_scene().tendons.offsets, strict=True):
            l_t = rate[:3] + jnp.cross(rate[3:], jnp.array([a, b, 0.0]))
            total += rod.front_viscosity[0] * tau * jnp.linalg.norm(l_t) ** 3 / (3 * c0)
        return total

    force = jax.vmap(jax.grad(potential))(x, history)
    assert np.abs(force[:, 2]).max() > 0.01 * np.abs(TENSIONS).max()  # it does something
    np.testing.assert_allclose(imbalance(without, x) + force, 0, atol=1e-10)
    stiffness = jax.vmap(jax.hessian(potential))(x, history)
    added = jnp.linalg.inv(compliance(problem, x)) - jnp.linalg.inv(compliance(without, x))
    np.testing.assert_allclose(added, stiffness, rtol=1e-6, atol=1e-8)


def test_second_derivative_of_the_strains():
    """The implicit derivative can be differentiated again: no constant was frozen into it."""
    rod = make_rod(full_scene(), Inputs(TENSIONS, PRESSURES))
    wrench = jnp.array([0.02, 0.01, -0.03, 1e-4, -2e-4, 1e-4])
    guess = jnp.array([0.0, 0, 1, 0, 0, 0])

    def strain(scale):
        return recover_strain(local_problem(rod, scale * wrench), guess)[0]

    second = jax.jacfwd(jax.jacfwd(strain))(1.0)
    d = 1e-4
    first = jax.jacfwd(strain)
    expected = (first(1 + d) - first(1 - d)) / (2 * d)
    np.testing.assert_allclose(second, expected, rtol=1e-6, atol=1e-9)


def test_a_tendon_path_that_shrinks_to_nothing_is_reported():
    scene = sr.hybrid_robot()
    for tension, exists in [(2.03, True), (2.04, False), (3.0, False)]:
        rod = make_rod(scene, Inputs(jnp.array([tension, 0.0, 0.0]), None))
        problem = local_problem(rod, jnp.zeros((1, 6)))
        _, solvable = recover_strain(problem, jnp.array([[0.0, 0, 1, 0, 0, 0]]))
        assert bool(solvable) == exists, tension


def test_absent_parts_are_not_in_the_program():
    """A scene without tendons, drag or gravity has nothing of them in its equations."""

    def count(scene, tensions):
        rod = make_rod(scene, Inputs(tensions, None))
        layout = Layout(attitude=rod.has_dead_load, dynamic=True)
        y, history = jnp.ones(layout.size), History(jnp.ones(()), jnp.ones(6), jnp.ones(6))
        jaxpr = jax.make_jaxpr(lambda y: rod_ode(y, rod, layout, history, jnp.ones(6)).y_s)(y)
        return len(jaxpr.eqns), layout.size

    bare = full_scene(
        gravity=None,
        tip_load=None,
        payload=None,
        drag_coefficient=None,
        shear_damping=None,
        bending_damping=None,
        tendons=None,
        chambers=None,
    )
    n_bare, size_bare = count(bare, None)
    assert size_bare == 12
    for name in ("gravity", "drag_coefficient", "shear_damping", "bending_damping"):
        with_part = full_scene(
            **{
                k: getattr(bare, k)
                for k in (
                    "gravity",
                    "tip_load",
                    "payload",
                    "drag_coefficient",
                    "shear_damping",
                    "bending_damping",
                    "tendons",
                    "chambers",
                )
                if k != name
            }
        )
        n, size = count(with_part, None)
        assert n > n_bare, name
        assert size == (16 if name == "gravity" else 12)
    assert count(full_scene(), TENSIONS)[0] > count(full_scene(), None)[0]


def test_tip_condition():
    scene = full_scene()
    rod = make_rod(scene, Inputs(TENSIONS, PRESSURES))
    layout = Layout(attitude=True, dynamic=True)
    y, history = random_point(8, layout)
    tip = tip_condition(y, rod, layout, history)
    h, q, w, _, _ = layout.split(y)
    R = np.array(rotation_matrix(h))
    q_t = history.c0 * q + history.velocity[:3]
    acceleration = R @ (q_t + np.cross(w, q))  # p_tt
    N = scene.tip_load.force + scene.payload.mass * (scene.gravity - acceleration)
    np.testing.assert_allclose(tip.value[:3], R.T @ N, rtol=1e-12)
    np.testing.assert_allclose(tip.value[3:], R.T @ scene.tip_load.moment, rtol=1e-12)
