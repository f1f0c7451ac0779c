"""Motions against beam theory, independent solutions, and the statics."""

import json
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.interpolate import CubicSpline
from scipy.optimize import brentq, least_squares

import softrod_jax as sr
from softrod_jax import dynamics, statics
from softrod_jax.scene.scene import as_arrays

REFERENCES = json.loads((Path(__file__).parent / "references" / "dynamic.json").read_text("utf-8"))


def with_(scene, **changes):
    return as_arrays(sr.Scene(**{**vars(scene), **changes}))


def slender(**parts):
    """EI = 1e-3 N m^2, rho A = 0.1 kg/m, L = 0.5 m; rotary inertia and shear negligible."""
    section = sr.GeneralSection(1e-4, jnp.array([1e-11, 1e-11]), 2e-11)
    return as_arrays(sr.Scene(0.5, section, 1e8, 0.3, 1000.0, **parts))


def fit_ringing(t, x, omegas, zeta):
    """Frequencies and damping ratios of the damped cosines that make up `x`."""
    n = len(omegas)

    def columns(p):
        w, z = p[:n], p[n:]
        decay = np.exp(-z * w * t[:, None])
        wd = w * np.sqrt(1 - z**2)
        return np.hstack(
            [decay * np.cos(wd * t[:, None]), decay * np.sin(wd * t[:, None]), np.ones((len(t), 1))]
        )

    def residual(p):
        A = columns(p)
        return (A @ np.linalg.lstsq(A, x, rcond=None)[0] - x) / np.std(x)

    p = least_squares(residual, np.r_[omegas, np.full(n, zeta)], xtol=1e-14, ftol=1e-14).x
    return p[:n], p[n:]


def test_cantilever_frequencies_and_kelvin_voigt_decay():
    EI, rho_A, L, B = 1e-3, 0.1, 0.5, 2e-6
    scene = slender(gravity=jnp.array([-1e-3, 0.0, 0.0]), bending_damping=B)
    omega = np.array([1.87510407, 4.69409113]) ** 2 * np.sqrt(EI / (rho_A * L**4))
    period = 2 * np.pi / omega[0]
    dt, steps = period / 100, 500
    motion = sr.simulate(scene, dt, steps=steps, scheme=sr.SDIRK(order=4))
    t, x = np.array(motion.ts), np.array(motion.tip_positions[:, 0])
    # The third mode and above, 2 % of the second's amplitude, die out in the first period.
    late = t > period
    w, z = fit_ringing(t[late], x[late], omega * 1.01, 0.01)
    zeta = omega * B / (2 * EI)
    np.testing.assert_allclose(w, omega, rtol=3e-4)
    np.testing.assert_allclose(z, zeta, rtol=2e-2)


def test_frequency_with_a_payload():
    EI, rho_A, L, mass = 1e-3, 0.1, 0.5, 0.1
    mu = mass / (rho_A * L)
    characteristic = lambda b: (
        1 + np.cos(b) * np.cosh(b) + mu * b * (np.cos(b) * np.sinh(b) - np.sin(b) * np.cosh(b))
    )
    omega = brentq(characteristic, 0.5, 1.8) ** 2 * np.sqrt(EI / (rho_A * L**4))
    scene = slender(gravity=jnp.array([-1e-4, 0.0, 0.0]), payload=sr.Payload(mass))
    dt = 2 * np.pi / omega / 100
    motion = sr.simulate(scene, dt, steps=400, scheme=sr.SDIRK(order=4))
    t, x = np.array(motion.ts), np.array(motion.tip_positions[:, 0])
    w, _ = fit_ringing(t, x, np.array([omega * 1.02]), 1e-3)
    np.testing.assert_allclose(w[0], omega, rtol=1e-3)


@pytest.mark.parametrize(
    "name, limit",
    [("gravity_step", 5e-5), ("tendon_step_0.1N", 1e-3), ("tendon_ramp_0.3N_50ms", 5e-5)],
)
def test_independent_motions(name, limit):
    """Tip over 1 s at dt = 1 ms, default settings."""
    case, dt, steps = REFERENCES[name], 1e-3, 1000
    load, t = case["load"], dt * np.arange(1, 1001)
    scene = with_(sr.hybrid_robot(), drag_coefficient=None)
    tensions = None
    if "g" in load:
        scene = with_(scene, gravity=jnp.array([load["g"][0], 0.0, load["g"][1]]))
    else:
        x = np.minimum(1, t / load["ramp"]) if load.get("ramp") else np.ones(steps)
        tensions = np.zeros((steps, 3))
        tensions[:, 0] = load["tau"] * x**3 * (10 - 15 * x + 6 * x**2)
    motion = sr.simulate(scene, dt, tensions, steps=steps)
    tip = np.array(motion.tip_positions)[::5]
    assert np.abs(tip[:, 0] - case["x"]).max() < limit
    assert np.abs(tip[:, 2] - case["z"]).max() < limit
    assert np.abs(tip[:, 1]).max() < 1e-12


@pytest.mark.parametrize(
    "scheme, dts, ratio, limit",
    [
        # Second order; the limits are the tip errors at the first dt.
        (sr.BDFAlpha(alpha=-0.2), (5e-3, 2.5e-3, 1.25e-3), 3.5, 6.5e-4),
        (sr.BDFAlpha(alpha=-0.45), (5e-3, 2.5e-3, 1.25e-3), 3.5, 2.7e-4),
        (sr.SDIRK(order=3), (20e-3, 10e-3), 8.0, 6.5e-5),
        (sr.SDIRK(order=4), (20e-3, 10e-3), 8.0, 6.5e-5),
    ],
    ids=str,
)
@pytest.mark.long
def test_order_on_the_gravity_step(scheme, dts, ratio, limit):
    errors = [_gravity_step(scheme, dt)[0] for dt in dts]
    assert errors[0] < limit
    assert np.all(np.array(errors[:-1]) / errors[1:] > ratio), errors


@pytest.mark.long
@pytest.mark.parametrize(
    "alpha, scheme, steps", [(-0.2, sr.SDIRK(), 53), (-0.45, sr.SDIRK(3, stages=6), 33)], ids=str
)
def test_a_tenth_of_the_error_of_bdf_alpha_at_equal_cost(alpha, scheme, steps):
    """Equal within 5 %, by evaluations along the rod."""
    error, evaluations = _gravity_step(sr.BDFAlpha(alpha=alpha), 5e-3)
    error_3, evaluations_3 = _gravity_step(scheme, 1 / steps)
    assert error_3 < error / 10
    assert evaluations_3 < 1.05 * evaluations


def _gravity_step(scheme, dt):
    """The largest error of the tip over 1 s, against the independent solution; evaluations."""
    path = REFERENCES["gravity_step"]
    scene = with_(sr.hybrid_robot(), gravity=jnp.array([-9.81, 0.0, 0.0]), drag_coefficient=None)
    # By these very steps, which no second motion judges.
    as_given = dict(substeps=1, max_time_error=jnp.inf)
    motion = sr.simulate(scene, dt, steps=round(1 / dt), scheme=scheme, **as_given)
    answer = CubicSpline(5e-3 * np.arange(len(path["x"])), np.stack([path["x"], path["z"]], axis=1))
    error = np.linalg.norm(motion.tip_positions[:, ::2] - answer(motion.ts), axis=1).max()
    return error, int(motion.stats["iterations"].sum())


def test_a_long_motion_ends_in_the_equilibrium():
    scene = with_(sr.hybrid_robot(gravity=jnp.array([-9.81, 2.0, 0.0])), bending_damping=5e-6)
    bdf2 = sr.BDFAlpha(alpha=0.0)  # damps the axial waves, which have no damping of their own
    tensions, pressures = np.tile([0.1, 0.05, 0.0], (400, 1)), np.full((400, 1), 2e4)
    motion = sr.simulate(scene, 0.02, tensions, pressures, scheme=bdf2)
    rest = sr.solve_static(scene, tensions[0], pressures[0])
    np.testing.assert_allclose(motion.tip_positions[-1], rest.tip_position, atol=1e-8)
    np.testing.assert_allclose(motion.positions[-1], rest.positions, atol=1e-8)
    np.testing.assert_allclose(motion.strains[-1], rest.strains, atol=1e-5)
    # And a motion that starts there stays there.
    still = sr.simulate(scene, 0.02, tensions[:5], pressures[:5], initial=rest, scheme=bdf2)
    np.testing.assert_allclose(still.tip_positions, jnp.tile(rest.tip_position, (6, 1)), atol=1e-9)


def test_tip_velocity_is_the_rate_of_the_tip():
    scene = sr.hybrid_robot(gravity=jnp.array([-9.81, 0.0, 0.0]))
    motion = sr.simulate(scene, 1e-3, steps=200)
    rate = np.gradient(np.array(motion.tip_positions), 1e-3, axis=0)
    error = np.abs(rate - np.array(motion.tip_velocities))[2:-1].max()
    assert error < 2e-3 * np.abs(rate).max()


@pytest.mark.parametrize("scheme", [sr.BDFAlpha(), sr.BDFAlpha(-0.2), sr.SDIRK(4)], ids=str)
def test_the_estimated_error_in_time(scheme):
    """Not below the true one, and not over twelve times it, with its factor of caution of 1.3."""
    path, dt = REFERENCES["gravity_step"], 1e-2
    scene = with_(sr.hybrid_robot(), gravity=jnp.array([-9.81, 0.0, 0.0]), drag_coefficient=None)
    motion = sr.simulate(scene, dt, steps=100, scheme=scheme)
    error = np.abs(np.array(motion.tip_positions[:, 0]) - np.array(path["x"])[::2]).max() / 0.1
    assert error < motion.stats["time_error"][-1] < 12 * error


def test_a_tolerance_is_kept():
    scene = with_(sr.hybrid_robot(), gravity=jnp.array([-9.81, 0.0, 0.0]), drag_coefficient=None)
    run = lambda **options: sr.simulate(scene, 0.03, steps=10, **options)
    motion, refined = run(tolerance=1e-4), run(substeps=30)
    error = np.abs(motion.tip_positions - refined.tip_positions).max() / 0.1
    assert error < 1e-4
    assert np.sum(motion.stats["substeps"]) > 10
    equal = run(tolerance=1e-4, scheme=sr.BDFAlpha())
    assert np.abs(equal.tip_positions - refined.tip_positions).max() / 0.1 < 1e-4
    assert float(np.max(motion.stats["time_error"])) < 1e-4
    with pytest.raises(ValueError, match="jit"):
        jax.jit(lambda dt: sr.simulate(scene, dt, steps=10, tolerance=1e-4))(0.03)


def test_tensions_that_fall_to_zero_stay_above_it():
    """Between samples inputs are interpolated, and rounding must not make a tendon push."""
    tensions = np.outer(np.maximum(0.0, 0.3 - 0.01 * np.arange(60)), [1.0, 1 / 3, 0.7])
    motion = sr.simulate(sr.hybrid_robot(), 0.01, tensions)
    assert motion.result == 0


def test_a_tension_without_equilibrium_is_reported():
    scene = sr.hybrid_robot()
    tensions = np.zeros((60, 3))
    tensions[:, 0] = np.linspace(0, 4.0, 60)
    motion = sr.simulate(scene, 0.02, tensions, throw=False)
    assert int(motion.result) != 0
    k = int(motion.failed_step)
    assert 0 < k < 60
    assert np.all(np.isfinite(motion.tip_positions))
    # What shrinks to nothing is inaccurate before; where it fails it is held.
    moves = np.any(np.diff(motion.tip_positions, axis=0) != 0, axis=1)
    assert k <= np.flatnonzero(moves)[-1] + 1 < 50
    with pytest.raises(sr.SolveError):
        sr.simulate(scene, 0.02, tensions)


def test_batch_equals_loop_and_a_bad_sample_spoils_nothing():
    scene = sr.hybrid_robot()
    tensions = np.zeros((3, 20, 3))
    tensions[0, :, 0], tensions[1, :, 1], tensions[2, 10:, 2] = 0.1, np.nan, 0.2

    def run(tau, E):
        return sr.simulate(with_(scene, young_modulus=E), 0.01, tau, throw=False)

    batched = jax.jit(jax.vmap(run, in_axes=(0, None)))
    batch = batched(jnp.array(tensions), 5e4)
    assert batch.result.tolist() == [0, sr.RESULTS.bad_input, 0]
    assert batch.failed_step.tolist() == [-1, 0, -1]
    for i in (0, 2):
        one = run(tensions[i], 5e4)
        np.testing.assert_allclose(batch.tip_positions[i], one.tip_positions, atol=1e-12)

    def loss(E):
        motion = batched(jnp.array(tensions), E)
        tip = motion.tip_positions[:, -1]
        return jnp.sum(jnp.where(motion.result[:, None] == 0, tip**2, 0.0))

    slope = (8 * (loss(5e4 + 50) - loss(5e4 - 50)) - (loss(5e4 + 100) - loss(5e4 - 100))) / 600
    np.testing.assert_allclose(jax.grad(loss)(5e4), slope, rtol=1e-6)


@pytest.mark.parametrize(
    "arguments, words",
    [
        (dict(dt=0.0, steps=3), "dt"),
        (dict(dt=-1.0, steps=3), "dt"),
        (dict(dt=0.01), "steps"),
        (dict(dt=0.01, steps=0), "steps"),
        (dict(dt=0.01, steps=3, substeps=0), "substeps"),
        (dict(dt=0.01, steps=3, tolerance=0.0), "tolerance"),
        (dict(dt=0.01, steps=3, tensions=np.zeros((4, 3))), "disagree"),
        (dict(dt=0.01, tensions=np.zeros((4, 2))), "shape"),
        (dict(dt=0.01, tensions=np.zeros(3)), "shape"),
        (dict(dt=0.01, tensions=-np.ones((4, 3))), "negative"),
        (dict(dt=0.01, pressures=np.full((4, 1), np.inf)), "finite"),
    ],
)
@pytest.mark.usefixtures("wrong_types")
def test_bad_arguments(arguments, words):
    with pytest.raises(ValueError, match=words):
        sr.simulate(sr.hybrid_robot(), **arguments)


def test_other_numbers_compile_nothing_new(monkeypatch):
    """A program is made once for each combination of parts, settings and number of steps."""
    traced = []
    for module, name in ((dynamics, "march"), (statics, "solve_boundary_value")):

        def counted(*arguments, original=getattr(module, name), **options):
            traced.append(1)
            return original(*arguments, **options)

        monkeypatch.setattr(module, name, counted)
    jax.clear_caches()
    for E, dt, pull in ((5e4, 5e-3, 0.1), (6e4, 4e-3, 0.2), (7e4, 5e-3, 0.0)):
        scene = with_(sr.hybrid_robot(gravity=jnp.array([-9.81, 0.0, 0.0])), young_modulus=E)
        tensions = np.full((2, 3), pull)
        sr.simulate(scene, dt, tensions, scheme=sr.BDFAlpha())
        sr.solve_static(scene, tensions[0])
        if E == 5e4:
            first = len(traced)
    assert len(traced) == first > 1
