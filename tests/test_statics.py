"""Static equilibria against closed forms, published problems and independent solutions."""

import json
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from problems import CLOSED_FORMS

import softrod_jax as sr
from softrod_jax.scene.scene import as_arrays

REFERENCES = json.loads((Path(__file__).parent / "references" / "static.json").read_text("utf-8"))
FINE = {4: sr.Collocation(40, order=4), 6: sr.Collocation(16, order=6)}
# Order 4 on a few: every new program costs its compilation.
CASES = [(p, 6) for p in CLOSED_FORMS]
CASES += [(p, 4) for p in CLOSED_FORMS if p.name in ("elastica_5", "straight_tendon_1")]


@pytest.mark.parametrize("problem, order", CASES, ids=str)
def test_closed_forms(problem, order):
    solution = sr.solve_static(
        problem.scene, problem.tensions, problem.pressures, method=FINE[order]
    )
    np.testing.assert_allclose(solution.tip_position, problem.tip, atol=problem.tolerance)
    assert bool(solution.stats["stable"])


@pytest.mark.parametrize("order", [4, 6])
def test_order_of_convergence(order):
    gravity = jnp.array([-4.0, 2.0, 1.0])
    scene = sr.hybrid_robot(gravity=gravity)
    tips = {
        n: sr.solve_static(scene, (0.1, 0.02, 0.0), method=sr.Collocation(n, order)).tip_position
        for n in ((6, 12, 48) if order == 4 else (3, 6, 24))
    }
    coarse, middle, fine = tips.values()
    ratio = np.linalg.norm(coarse - fine) / np.linalg.norm(middle - fine)
    assert ratio > 0.7 * 2**order


def test_independent_solutions():
    """Every case, at default settings, within 1e-6 m."""
    for case in REFERENCES:
        gravity = jnp.array(case["gravity"]) if any(case["gravity"]) else None
        solution = sr.solve_static(
            sr.hybrid_robot(gravity=gravity), case["tau_N"], [case["P_Pa"]], throw=False
        )
        if case["status"] == "no smooth equilibrium":
            assert int(solution.result) == sr.RESULTS.no_equilibrium, case["name"]
        else:
            assert int(solution.result) == sr.RESULTS.successful, case["name"]
            error = np.abs(solution.tip_position - np.array(case["tip"])).max()
            assert error < 1e-6, (case["name"], error)


def test_no_equilibrium_is_an_error_that_says_so():
    with pytest.raises(sr.SolveError, match="tendon path"):
        sr.solve_static(sr.hybrid_robot(), tensions=(3.0, 0.0, 0.0))


def test_a_column_past_buckling():
    """Upright, over its critical weight: raised with a tendon, it falls to the tendon's side."""
    scene = sr.hybrid_robot(gravity=jnp.array([0.0, 0.0, -9.81]))
    straight = sr.solve_static(scene, (0.0, 0.0, 0.0))
    assert not bool(straight.stats["stable"])
    np.testing.assert_allclose(straight.tip_position[:2], 0.0, atol=1e-12)
    for tension in (0.001, 0.1, 0.3):
        bent = sr.solve_static(scene, (tension, 0.0, 0.0))
        assert bool(bent.stats["stable"])
        assert float(bent.tip_position[0]) > 0.02


def test_every_symmetry_of_three_tendons():
    """The tendons stand at 120 degrees: permuting the tensions turns the answer."""
    scene = sr.hybrid_robot()
    turn = np.array([[-0.5, -np.sqrt(0.75), 0], [np.sqrt(0.75), -0.5, 0], [0, 0, 1]])
    a = sr.solve_static(scene, (0.3, 0.1, 0.0), (2e4,)).tip_position
    b = sr.solve_static(scene, (0.0, 0.3, 0.1), (2e4,)).tip_position
    np.testing.assert_allclose(turn @ a, b, atol=1e-13)


def test_turning_the_base_turns_the_answer():
    base = sr.hybrid_robot(gravity=jnp.array([-3.0, 1.0, 2.0]))
    h = jnp.array([0.8, 0.2, -0.4, 0.4])
    from softrod_jax.rod.rotations import rotation_matrix, to_base

    turned = sr.Scene(
        **{
            **vars(base),
            "gravity": to_base(h, base.gravity),
            "base_quaternion": h,
            "base_position": jnp.array([1.0, 2.0, 3.0]),
        }
    )
    a = sr.solve_static(base, (0.1, 0.0, 0.05))
    b = sr.solve_static(turned, (0.1, 0.0, 0.05))
    expected = a.positions @ rotation_matrix(h).T + jnp.array([1.0, 2.0, 3.0])
    np.testing.assert_allclose(b.positions, expected, atol=1e-9)


def test_batch_equals_loop_and_a_bad_sample_spoils_nothing():
    scene = sr.hybrid_robot()
    tensions = jnp.array([[0.1, 0.0, 0.0], [3.0, 0.0, 0.0], [0.5, 0.2, 0.0], [-1.0, 0, 0]])

    def solve(tau, E):
        softer = sr.Scene(**{**vars(scene), "young_modulus": E})
        return sr.solve_static(softer, tau, throw=False)

    batched = jax.jit(jax.vmap(solve, (0, None)))
    batch = batched(tensions, 5e4)
    assert batch.result.tolist() == [0, 1, 0, 4]
    for i in (0, 2):
        one = sr.solve_static(scene, tensions[i])
        np.testing.assert_allclose(batch.tip_position[i], one.tip_position, atol=1e-14)

    def loss(E):
        s = batched(tensions, E)
        return jnp.sum(jnp.where(s.result[:, None] == 0, s.tip_position**2, 0.0))

    slope = (8 * (loss(5e4 + 50) - loss(5e4 - 50)) - (loss(5e4 + 100) - loss(5e4 - 100))) / 600
    np.testing.assert_allclose(jax.grad(loss)(5e4), slope, rtol=1e-7)


def test_errors_are_raised_under_jit_too():
    scene = sr.hybrid_robot()
    with pytest.raises(Exception, match="tendon path"):
        jax.block_until_ready(
            jax.jit(lambda tau: sr.solve_static(scene, tau).tip_position)(jnp.array([3.0, 0, 0]))
        )


@pytest.mark.parametrize(
    "tensions, pressures, words",
    [
        ((0.1, 0.2), None, "shape"),
        ((0.1, 0.2, -0.3), None, "negative"),
        ((0.1, 0.2, np.nan), None, "finite"),
        (None, (1.0, 2.0), "shape"),
        (None, 1.0, "shape"),
    ],
)
@pytest.mark.usefixtures("wrong_types")
def test_bad_inputs(tensions, pressures, words):
    with pytest.raises(ValueError, match=words):
        sr.solve_static(sr.hybrid_robot(), tensions, pressures)


def test_inputs_without_an_actuator():
    scene = sr.Scene(**{**vars(sr.hybrid_robot()), "tendons": None})
    with pytest.raises(ValueError, match="no tendons"):
        sr.solve_static(scene, (1.0,))


def upright(**loads):
    return as_arrays(
        sr.Scene(**{**vars(sr.hybrid_robot()), "gravity": jnp.array([0.0, 0.0, -9.81]), **loads})
    )


def test_a_nearly_perfect_column_buckles(caplog):
    """rho A g L^3 / EI = 23 is above 7.84: the path of equilibria is not the straight one."""
    push = lambda force: sr.TipLoad(force=jnp.array([force, 0.0, 0.0]))
    caplog.set_level("INFO", "softrod_jax")
    perfect = sr.solve_static(upright())
    assert not perfect.stats["stable"]
    forces = 1e-4, 1e-6, 1e-7
    clear, small, slight = (sr.solve_static(upright(tip_load=push(f))) for f in forces)
    # What 1e-7 N adds against turning about the vertical is below the rounding of the sweep.
    assert clear.stats["stable"] and small.stats["stable"]
    assert small.stats["transient_steps"] > 0
    said = [record.getMessage() for record in caplog.records]
    assert f"the damped motion: successful after {small.stats['transient_steps']} steps" in said
    assert slight.stats["transient_steps"] > 0
    assert slight.tip_position[0] > 0.05
    # 1e-4 N itself moves the buckled tip by 1.2e-4 m.
    np.testing.assert_allclose(slight.tip_position, clear.tip_position, atol=3e-4)
    batch = jax.vmap(lambda f: sr.solve_static(upright(tip_load=push(f)), throw=False))
    assert batch(jnp.array([1e-7, 1e-3])).result.tolist() == [sr.RESULTS.diverged, 0]


def test_a_tolerance_is_kept_in_statics():
    scene = sr.hybrid_robot(gravity=jnp.array([-9.81, 0.0, 0.0]))
    coarse = sr.Collocation(4, order=4)
    rough = sr.solve_static(scene, method=coarse, throw=False)
    fine = sr.solve_static(scene, method=coarse, tolerance=1e-4)
    best = sr.solve_static(scene)
    assert np.abs(rough.tip_position - best.tip_position).max() > 1e-5
    assert np.abs(fine.tip_position - best.tip_position).max() < 1e-5
    assert rough.stats["error"] > 1e-4


class Helix(sr.Tendons):
    """Tendons that wind about the axis by `pitch` [rad/m]."""

    pitch: float = 15.0

    def routing(self, s, length=None):
        angle, (x, y) = self.pitch * jnp.asarray(s)[..., None], self.offsets.T
        cos, sin = jnp.cos(angle), jnp.sin(angle)
        none = jnp.zeros_like(cos * x)
        r = jnp.stack([cos * x - sin * y, sin * x + cos * y, none], -1)
        return r, self.pitch * jnp.stack([-r[..., 1], r[..., 0], none], -1)


def test_a_tendon_that_winds_about_the_axis():
    """A small tension: the moment r x t tau of the tendon's direction t, at each point."""
    robot, tension, r = sr.hybrid_robot(), 1e-4, 4e-3
    scene = as_arrays(sr.Scene(**{**vars(robot), "tendons": Helix(jnp.array([[r, 0.0]]))}))
    solution = sr.solve_static(scene, (tension,), method=sr.Collocation(6))
    pitch = scene.tendons.pitch
    along = tension / np.sqrt(1 + (pitch * r) ** 2)
    EI = robot.young_modulus * robot.section.second_moments[0]
    GJ = robot.shear_modulus * robot.section.torsion_constant
    angle = pitch * solution.arc_lengths
    bend, twist = along * r / EI, -along * pitch * r**2 / GJ
    u = np.stack([-bend * np.sin(angle), bend * np.cos(angle), twist + 0 * angle], -1)
    np.testing.assert_allclose(solution.strains[:, 3:], u, atol=1e-3 * bend)
    np.testing.assert_allclose(solution.strains[:, 5], twist, rtol=1e-3)
