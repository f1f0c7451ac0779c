"""Stiffness that relaxes: closed forms of small motions, order, energy, and any elastic law."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import softrod_jax as sr
import softrod_jax.learning
from softrod_jax.rod.body import body_along
from softrod_jax.rod.reduction import make_rod
from softrod_jax.scene.scene import as_arrays

METHOD = sr.Collocation(6)
L, R, E, RHO = 0.1, 6e-3, 5e4, 1070.0
A, I = np.pi * R**2, np.pi * R**4 / 4
G, TAU = np.array([0.3, 0.2]), np.array([0.05, 0.3])
BRANCHES = np.stack([G, TAU], 1)
ACROSS, ALONG = np.array([-9.81, 0.0, 0.0]), np.array([0.0, 0.0, 1.0])
ON_AXIS = sr.Tendons([[0.0, 0.0]])
# So light a rod that waves are gone at once, and what is left creeps.
LIGHT = dict(density=1e-3, plane="xz")


def rod(**changes):
    own = dict(
        length=L,
        section=sr.Circle(R),
        young_modulus=E,
        poisson_ratio=0.49,
        density=RHO,
        relaxation=BRANCHES,
    )
    return as_arrays(sr.Scene(**(own | changes)))


def moved(scene, dt, steps, tensions=None, scheme=sr.SDIRK(), method=METHOD, **options):
    return sr.simulate(
        scene, dt, tensions, steps=steps, scheme=scheme, method=method, max_time_error=1e9,
        throw=False, **options,
    )  # fmt: skip


# Closed forms of small motions


def crept(t, load):
    """The strain at times t after a load EA `load` came, of both branches."""
    # e = load + sum g_j a_j, a_j,t = (e - a_j) / tau_j: a = exp(M t) (0 - rest) + rest.
    M = (np.ones((2, 1)) * G - np.eye(2)) / TAU[:, None]
    rates, modes = np.linalg.eig(M)
    rest = load / (1 - G.sum())
    weights = np.linalg.solve(modes, -rest * np.ones(2))
    return load + G @ (rest + modes @ (weights[:, None] * np.exp(rates[:, None] * t)))


@pytest.mark.parametrize("scheme", [sr.SDIRK(), sr.SDIRK(4), sr.BDFAlpha(0.0)], ids=str)
def test_creep(scheme):
    load = 1e-4
    scene = rod(tip_load=sr.TipLoad(force=load * E * A * ALONG), **LIGHT)
    motion = moved(scene, 2e-3, 300, scheme=scheme)
    known = crept(np.asarray(motion.ts), load)
    settled = motion.ts > 0.02
    assert known[-1] > 1.8 * load
    errors = np.abs(motion.strains[:, 3, 2] - 1 - known)[settled]
    assert errors.max() < 1e-4 * load / (1 - G.sum())


@pytest.mark.parametrize("method", [METHOD, sr.Shooting(2, 4)], ids=["colloc.", "shoot."])
def test_stress_relaxation(method):
    """Of an inextensible tendon on the axis, pulled within one step and held."""
    strain, dt, steps = 1e-4, 2e-3, 200
    scene = rod(**LIGHT, tendons=sr.Tendons([[0.0, 0.0]], control=("length",)))
    pulls = np.full((steps, 1), strain * L)
    motion = moved(scene, dt, steps, method=method, pulls=pulls)
    # The strain rises in the first step.
    t = np.asarray(motion.ts)[1:, None]
    a = 1 - TAU / dt * (1 - np.exp(-dt / TAU))
    a = 1 - (1 - a) * np.exp(-(t - dt) / TAU)
    known = E * A * strain * (1 - a @ G)
    assert known[-1] < 0.75 * known[0]
    errors = np.abs(motion.tensions[1:, 0] - known)[10:]
    assert errors.max() < 1e-4 * E * A * strain


@pytest.mark.parametrize("part", [0.4, 3.0])
def test_loss_tangent(part):
    """Of a rod that a tendon on its axis presses together, to and fro."""
    omega, n, periods = part / TAU[0], 100, 50
    dt = 2 * np.pi / omega / n
    phase = 2 * np.pi * np.arange(1, n * periods + 1) / n
    tensions = 1e-4 * E * A * (1 - np.cos(phase))[:, None]
    motion = moved(rod(tendons=ON_AXIS, **LIGHT), dt, n * periods, tensions)
    last, wave = slice(-n, None), np.exp(-1j * phase[-n:])
    modulus = -(tensions[last, 0] @ wave) / (motion.strains[1:, 3, 2][last] @ wave) / A
    x = omega * TAU
    stored, lost = 1 - G @ (1 / (1 + x**2)), G @ (x / (1 + x**2))
    np.testing.assert_allclose(modulus.imag / modulus.real, lost / stored, rtol=0, atol=1e-4)
    np.testing.assert_allclose(modulus.real, E * stored, rtol=2e-4)


def test_equilibria_are_relaxed_and_stay():
    """They are those of the stiffness that is left, and motions from there do not move."""
    scene = rod(gravity=ACROSS / 3)
    softer = rod(gravity=ACROSS / 3, young_modulus=E * (1 - G.sum()), relaxation=None)
    still, known = (sr.solve_static(x, method=METHOD) for x in (scene, softer))
    np.testing.assert_allclose(still.positions, known.positions, rtol=0, atol=1e-12)
    motion = moved(scene, 0.02, 10, initial=still)
    assert int(motion.result) == 0
    np.testing.assert_allclose(
        motion.tip_positions, np.broadcast_to(still.tip_position, (11, 3)), rtol=0, atol=1e-9
    )


def test_a_rod_at_rest_for_ever_is_in_equilibrium():
    damped = rod(gravity=ACROSS / 3, plane="xz", bending_damping=2e-6)
    end = moved(damped, 0.5, 40, scheme=sr.SDIRK(2)).tip_positions[-1]
    np.testing.assert_allclose(
        end, sr.solve_static(damped, method=METHOD).tip_position, rtol=0, atol=1e-6
    )


# Time schemes


@pytest.mark.parametrize(
    "scheme, order, steps",
    [(sr.SDIRK(2), 2, 6), (sr.SDIRK(), 3, 6), (sr.SDIRK(4), 4, 6), (sr.BDFAlpha(0.0), 2, 24)],
    ids=["sdirk 2", "sdirk 3", "sdirk 4", "bdf"],
)
def test_order_in_creep(scheme, order, steps):
    load, end = 1e-3, 0.48
    scene = rod(tip_load=sr.TipLoad(force=load * E * A * ALONG), **LIGHT)
    known = crept(np.array([end]), load)[0]

    def error(n):
        close = sr.NewtonOptions(tolerance=1e-13)
        motion = jax.jit(lambda s: moved(s, end / n, n, scheme=scheme, newton=close))(scene)
        return abs(motion.strains[-1, 3, 2] - 1 - known)

    errors = np.array([error(n) for n in (steps, 2 * steps, 4 * steps)])
    assert np.log2(errors[:-1] / errors[1:]).min() > order - 0.3, errors


@pytest.mark.parametrize(
    "scheme, steps, ratio", [(sr.SDIRK(), (10, 20), 3.5), (sr.BDFAlpha(), (40, 80), 3.7)], ids=str
)
def test_errors_of_a_swing(scheme, steps, ratio):
    """They fall as they do without branches, and are as small: what creeps adds none."""
    errors = []
    for branches in (None, BRANCHES):
        scene = rod(gravity=ACROSS, plane="xz", bending_damping=2e-6, relaxation=branches)

        def tips(scheme, steps, scene=scene):
            method = sr.Collocation(12)
            run = lambda s: moved(s, 0.4 / steps, steps, scheme=scheme, method=method)
            return jax.jit(run)(scene).tip_positions[:: steps // 10]

        right = tips(sr.SDIRK(4), 160)
        errors.append([np.linalg.norm(tips(scheme, n) - right, axis=1).max() for n in steps])
    without, own = np.array(errors)
    assert own[0] > ratio * own[1] and (own < 1.1 * without).all(), errors


def test_energy_never_grows():
    """Of motion, of height, of the spring that stays and of those of the branches, all together."""
    scene = rod(gravity=ACROSS / 3, plane="xz", tip_load=sr.TipLoad(force=2e-3 * ALONG))
    method = sr.Collocation(12)
    stepper = sr.learning.Stepper(scene, 4e-3, method=method, scheme=sr.SDIRK(4))

    def one(state, _):
        state = stepper.step(state, sr.learning.Action())
        view = stepper.view(state)
        return state, (state.memory[0], view.positions, view.result)

    _, (fields, positions, results) = jax.lax.scan(one, stepper.reset(), None, length=150)
    assert not np.any(results)
    # In the plane: v across and along, u.
    K = E * np.array([A / 2.98, A, I])
    e = np.asarray(fields.strain) - np.array([0.0, 1.0, 0.0])
    springs = 0.5 * (1 - G.sum()) * e**2 @ K
    springs = springs + 0.5 * (e[:, :, None] - np.asarray(fields.crept)) ** 2 @ K @ G
    moving = 0.5 * RHO * np.asarray(fields.velocity) ** 2 @ np.array([A, A, I])
    height = -RHO * A * positions @ scene.gravity
    simpson = L / 36 * np.array([1, *[4, 2] * 5, 4, 1])
    total = (springs + moving)[:, ::4] @ simpson + height @ simpson
    total = total - positions[:, -1] @ scene.tip_load.force
    lost = total[0] - total[-1]
    assert lost > 1e-5
    assert np.diff(total).max() < 1e-4 * lost


# With all else that a rod can be


class Linear(sr.AbstractEnergy):
    """The linear law of the package, written as an energy."""

    def density(self, v, u, s):
        K_se, K_bt = E * A * np.array([1 / 2.98, 1 / 2.98, 1.0]), E * I * np.array([1, 1, 2 / 2.98])
        e = v - ALONG
        return 0.5 * (e @ (K_se * e) + u @ (K_bt * u))


PULL = dict(tendons=sr.Tendons([[4e-3, 0.0]]))
CHANGES = {
    "tendons": dict(gravity=ACROSS / 3, **PULL),
    "plane, inextensible": dict(gravity=ACROSS / 3, plane="xz", inextensible=True),
    "bent at rest": dict(gravity=ACROSS / 3, rest_curvature=np.array([0.0, 5.0, 2.0])),
}


@pytest.mark.parametrize("name", ["tendons", "plane, inextensible"])
def test_a_law_of_ones_own_relaxes_as_well(name):
    own = dict(young_modulus=None, poisson_ratio=None, material=Linear())
    scenes = rod(**CHANGES[name]), rod(**CHANGES[name], **own)
    pull = "tendons" in CHANGES[name]
    still = [sr.solve_static(x, [0.1] if pull else None, method=METHOD) for x in scenes]
    np.testing.assert_allclose(still[0].positions, still[1].positions, rtol=0, atol=1e-9)
    rows = np.full((6, 1), 0.1) if pull else None
    tips = [jax.jit(lambda x: moved(x, 0.01, 6, rows).tip_positions)(x) for x in scenes]
    assert np.abs(tips[0][-1] - tips[0][0]).max() > 2e-3
    np.testing.assert_allclose(tips[0], tips[1], rtol=0, atol=1e-8)


def test_short_and_long_times():
    """Branches far slower than a motion are as if there were none, far faster ones are lost."""
    changes = dict(gravity=ACROSS / 3, rest_curvature=np.array([0.0, 5.0, 0.0]), plane="xz")
    run = jax.jit(lambda x: moved(x, 0.01, 10).tip_positions)
    known = (
        run(rod(**changes, relaxation=None)),
        run(rod(**changes, relaxation=None, young_modulus=E / 2)),
    )
    for time, tips in ((1e8, known[0]), (1e-8, known[1])):
        own = rod(**changes, relaxation=np.array([[0.2, time], [0.3, 2 * time]]))
        np.testing.assert_allclose(run(own), tips, rtol=0, atol=1e-6)


def test_rubber_relaxes_to_a_part_of_its_energy():
    """By a half: twice the stiffness at once, and in an equilibrium the law without branches."""
    law = dict(young_modulus=None, poisson_ratio=None, gravity=ACROSS)
    half = dict(relaxation=np.array([[0.2, 1e-8], [0.3, 2e-8]]), material=sr.MooneyRivlin(8e3, 4e3))
    whole = dict(relaxation=None, material=sr.MooneyRivlin(4e3, 2e3))
    scenes = [rod(**law, **x) for x in (half, whole)]
    tips = [sr.solve_static(x, method=METHOD).tip_position for x in scenes]
    np.testing.assert_allclose(tips[0], tips[1], rtol=0, atol=1e-9)
    tips = [jax.jit(lambda x: moved(x, 0.01, 8).tip_positions)(x) for x in scenes]
    np.testing.assert_allclose(tips[0], tips[1], rtol=0, atol=1e-6)


def test_segments():
    """Each with branches of its own, or none; of the same ones it is one rod."""
    part = lambda length, **own: sr.Segment(length=length, section=sr.Circle(R), **own)
    same = (part(0.05), part(0.05, relaxation=BRANCHES))
    rest = dict(length=None, section=None, gravity=ACROSS / 3, plane="xz")
    fine = sr.Collocation(12)
    run = jax.jit(lambda x: moved(x, 0.01, 8, method=fine).tip_positions)
    np.testing.assert_allclose(
        run(rod(**(rest | dict(length=L, section=sr.Circle(R))))),
        jax.jit(lambda x: moved(x, 0.01, 8, method=fine.fitted(x)).tip_positions)(
            rod(segments=same, **rest)
        ),
        rtol=0,
        atol=1e-6,
    )
    own = (part(0.05, relaxation=np.array([[0.5, 1.0]])), part(0.05))
    scene = rod(segments=own, **rest)
    along = body_along(scene, METHOD.fitted(scene).grid(scene)).relaxation
    np.testing.assert_allclose(along.parts[0], [0.5, 0.0])
    np.testing.assert_allclose(along.parts[-1], G)
    assert along.times[0, 1] == 1.0
    left = make_rod(scene, dynamic=False, grid=METHOD.fitted(scene).grid(scene))
    np.testing.assert_allclose(left.K_bt[:, 0] / (E * I), along.left)


def test_without_branches_there_is_nothing():
    plain = make_rod(rod(relaxation=None))
    assert plain.relaxation is None and plain.relaxed is plain


# A time that makes a damping of the stiffness

K_BT = E * I * np.array([1.0, 1.0, 2 / 2.98])
K_SE = E * A * np.array([1 / 2.98, 1 / 2.98, 1.0])
TIMED = {
    "in space": {},
    "beside another": dict(bending_damping=1e-7),
    "plane, inextensible": dict(plane="xz", inextensible=True),
    "with branches": dict(relaxation=BRANCHES, plane="xz"),
}


@pytest.mark.parametrize("name", TIMED)
def test_a_time_of_damping_is_a_part_of_the_stiffness(name):
    time = 5e-3
    changes = dict(gravity=ACROSS, relaxation=None) | TIMED[name]
    bending = time * K_BT + changes.get("bending_damping", 0.0)
    known = dict(bending_damping=bending)
    if "inextensible" not in changes:
        known["shear_damping"] = time * K_SE
    run = jax.jit(lambda x: moved(x, 0.01, 8).tip_positions)
    tips = run(rod(**changes, damping_time=time))
    np.testing.assert_allclose(tips, run(rod(**(changes | known))), rtol=0, atol=1e-12)
    without = run(rod(**changes))
    assert np.abs(tips - without).max() > 1e-4


def test_a_time_of_damping_by_segments_tapers_and_rubber():
    def along(**own):
        parts = [
            sr.Segment(0.05, sr.Circle(R), section_at_end=sr.Circle(R / 2), young_modulus=2 * E),
            sr.Segment(0.05, sr.Circle(R), material=sr.NeoHookean(E), damping_time=0.02),
        ]
        scene = rod(length=None, section=None, segments=parts, relaxation=None, **own)
        return body_along(scene, METHOD.fitted(scene).grid(scene))

    body = along(damping_time=5e-3)
    # On either side of the node at the border, which is there twice.
    half = len(body.K_bt) // 2
    for B, K in ((body.B_bt, body.K_bt), (body.B_se, body.K_se)):
        np.testing.assert_allclose(B[: half - 1], 5e-3 * K[: half - 1], rtol=1e-12)
        np.testing.assert_allclose(B[half + 1 :], 0.02 * K[half + 1 :], rtol=1e-12)
    assert along().B_bt[0, 0] == 0.0 and along().B_bt[-1, 0] > 0.0


def test_a_loss_factor_is_a_time_of_damping():
    """Of a rod that a tendon on its axis presses together, to and fro, at the frequency."""
    eta, omega, n, periods = 0.3, 2 * np.pi * 4.0, 100, 4
    dt = 2 * np.pi / omega / n
    phase = 2 * np.pi * np.arange(1, n * periods + 1) / n
    tensions = 1e-4 * E * A * (1 - np.cos(phase))[:, None]
    scene = rod(relaxation=None, damping_time=eta / omega, tendons=ON_AXIS, **LIGHT)
    motion = moved(scene, dt, n * periods, tensions)
    last, wave = slice(-n, None), np.exp(-1j * phase[-n:])
    modulus = -(tensions[last, 0] @ wave) / (motion.strains[1:, 3, 2][last] @ wave) / A
    np.testing.assert_allclose(modulus.imag / modulus.real, eta, rtol=0, atol=1e-4)
    np.testing.assert_allclose(modulus.real, E, rtol=1e-3)


# Derivatives, and what cannot be


@pytest.mark.long
def test_derivatives_and_batches():
    """By parts and times: forward, reverse and central differences agree; a batch is a loop."""
    scene = rod(gravity=ACROSS / 3, plane="xz")

    def tip(x):
        changed = dataclasses.replace(scene, relaxation=BRANCHES * x)
        still = sr.solve_static(changed, method=METHOD, throw=False)
        from_there = dataclasses.replace(changed, gravity=-changed.gravity)
        motion = moved(from_there, 0.02, 4, initial=still)
        return jnp.concatenate([still.tip_position, motion.tip_positions[-1]])

    at = jnp.array([[1.0, 0.9], [0.8, 1.1]])
    forward, reverse = jax.jit(jax.jacfwd(tip))(at), jax.jit(jax.jacrev(tip))(at)
    assert np.abs(forward[3]).min() > 1e-5
    np.testing.assert_allclose(forward, reverse, rtol=0, atol=1e-9 * np.abs(forward).max())
    d, eye = 1e-4, jnp.eye(4).reshape(4, 2, 2)
    ends = jax.jit(jax.vmap(tip))(jnp.concatenate([at + d * eye, at - d * eye]))
    slopes = ((ends[:4] - ends[4:]) / (2 * d)).T.reshape(6, 2, 2)
    np.testing.assert_allclose(forward, slopes, rtol=0, atol=1e-6 * np.abs(forward).max())


@pytest.mark.parametrize(
    "relaxation, expected",
    [
        ([[0.5, 1.0], [0.5, 2.0]], "sum is below 1"),
        ([[0.5, 0.0]], "above 0"),
        ([[0.5]], "2 numbers"),
        ([[-0.1, 1.0]], "above 0"),
    ],
)
def test_what_cannot_be(relaxation, expected):
    scene = dataclasses.replace(rod(), relaxation=relaxation)
    with pytest.raises(ValueError, match=f"rod.relaxation.*{expected}"):
        sr.solve_static(scene)


def test_traced_numbers_have_a_code():
    tip = lambda x: (
        sr.solve_static(
            dataclasses.replace(rod(gravity=ACROSS / 3), relaxation=x), method=METHOD, throw=False
        ).result
    )
    codes = jax.jit(jax.vmap(tip))(jnp.array([[[0.5, 1.0]], [[1.0, 1.0]], [[0.5, -1.0]]]))
    assert codes.tolist() == [0, sr.RESULTS.bad_input, sr.RESULTS.bad_input]
