"""The estimated error of steps in time against motions known from an independent explicit code."""

import dataclasses
import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import softrod_jax as sr
from softrod_jax.rod.reduction import make_rod
from softrod_jax.rod.rotations import to_base
from softrod_jax.scene.scene import as_arrays
from softrod_jax.stepping.first_mode import moved_by_speed, rate_of_change
from softrod_jax.stepping.step_control import run_checked

# Tips after 5, 10, 15 and 20 steps, and at the end of the other motion: from explicit finite
# differences of a discrete Lagrangian, known to 1e-3 and 3e-3 lengths.
SWING = np.array(
    [
        [0.05519885359, 0.05595336710, 0.05898359963],
        [0.00415095441, 0.01722848690, 0.10238702259],
        [0.05022991182, 0.02529807473, 0.08982816531],
        [0.02302367656, 0.05592482525, 0.07350657027],
    ]
)
TWO_JUMPS = np.array([-0.01297, 0.01416, 0.08271])


def swinging():
    """A stout stiff rod under its weight and a moment: second bending modes ring on."""
    scene = sr.Scene(
        length=0.10361517482013251,
        section=sr.Circle(0.010924443549341778),
        young_modulus=13211736831.73909,
        poisson_ratio=0.29084731657971535,
        density=6626.355102717394,
        bending_damping=[2.222023730252496e-05, 3.2047955452596774e-05, 3.6440863588664484e-05],
        gravity=[351872.553284569, 191612.41532122315, 167800.16387458862],
        drag_coefficient=[0.7491274804124288] * 3,
        payload=sr.Payload(0.0032863563975823245),
        tip_load=sr.TipLoad(
            force=jnp.zeros(3), moment=[-196.72616747008578, -740.4331281225489, 829.1052365533359]
        ),
    )
    return as_arrays(dataclasses.replace(scene, bending_damping=jnp.array(scene.bending_damping)))


SWING_DT, SWING_STEPS = 1.651061604324290208e-04, 20


def two_jumps():
    """The paper's robot, stiffer, with a payload: one tendon lets go, and another one pulls."""
    scene = dataclasses.replace(
        sr.hybrid_robot(gravity=jnp.array([0.0, 0.0, 9.81])),
        drag_coefficient=None,
        chambers=None,
        young_modulus=2e5,
        payload=sr.Payload(2e-3),
    )
    tensions = np.zeros((40, 3))
    tensions[:13, 0], tensions[13:, 1] = 3.0, 1.8
    return scene, tensions


def test_a_motion_that_rings_is_right_by_default():
    scene = swinging()
    motion = sr.simulate(scene, SWING_DT, steps=SWING_STEPS)
    error = np.linalg.norm(motion.tip_positions[5::5] - SWING, axis=1) / scene.length
    assert error.max() < 3e-3
    assert motion.stats["time_error"][-1] < 3e-3
    # The steps as they are asked for: what they miss is told, and what steps would not.
    given = sr.simulate(scene, SWING_DT, steps=SWING_STEPS, substeps=1, throw=False)
    error = np.linalg.norm(given.tip_positions[5::5] - SWING, axis=1) / scene.length
    assert error.max() > 0.1
    assert given.result == sr.RESULTS.inaccurate and given.failed_step >= 0
    assert 0.9 * error.max() < given.stats["time_error"][-1] < 2 * error.max()
    needed = int(given.stats["needed_substeps"])
    with pytest.raises(sr.SolveError, match=f"substeps={needed}"):
        sr.simulate(scene, SWING_DT, steps=SWING_STEPS, substeps=1)


def test_jumps_are_right_by_default():
    scene, tensions = two_jumps()
    motion = sr.simulate(scene, 0.01, tensions)
    assert motion.result == 0
    np.testing.assert_allclose(motion.tip_positions[-1], TWO_JUMPS, atol=4e-4)


@pytest.mark.parametrize(
    "scheme", [sr.SDIRK(2), sr.SDIRK(3), sr.SDIRK(3, 6), sr.SDIRK(4), sr.BDFAlpha()], ids=str
)
def test_under_jit_the_code_tells_steps_that_are_too_long(scheme):
    scene, tensions = two_jumps()
    run = jax.jit(lambda tau: sr.simulate(scene, 0.01, tau, scheme=scheme, throw=False))
    motion = run(jnp.array(tensions))
    error = np.linalg.norm(motion.tip_positions[-1] - TWO_JUMPS) / scene.length
    assert error > 0.05
    assert motion.result == sr.RESULTS.inaccurate
    assert motion.stats["time_error"][-1] > error / 3
    assert motion.stats["needed_substeps"] > 1
    # The rod moves on, and so do derivatives.
    assert np.linalg.norm(motion.tip_positions[-1] - motion.tip_positions[-2]) > 0
    assert motion.result == run(jnp.array(tensions)).result


def test_steps_that_are_short_enough_are_not_refused():
    """The paper's rod falls; good to 1e-4 lengths, by a step of an eighth."""
    scene = sr.hybrid_robot(gravity=jnp.array([-9.81, 0.0, 0.0]))
    motion = sr.simulate(scene, 0.01, steps=40)
    fine = sr.simulate(scene, 0.01, steps=40, substeps=8)
    true = np.linalg.norm(motion.tip_positions - fine.tip_positions, axis=1).max() / 0.1
    assert true < 1e-4
    assert np.all(motion.stats["substeps"] == 1)
    assert true < motion.stats["time_error"][-1] < 3e-3


def under_a_moment(moment, **numbers):
    """A soft rod, 8 cm long, to whose tip a moment of about 1.8 EI/L is given at once."""
    scene = dict(
        length=0.0820869,
        section=sr.Circle(0.0018837),
        young_modulus=1.82616e7,
        poisson_ratio=0.249596,
        density=7334.13,
        bending_damping=3.26397e-07,
        shear_damping=0.367943,
        tip_load=sr.TipLoad(force=jnp.zeros(3), moment=moment),
    )
    return as_arrays(sr.Scene(**scene | numbers))


def test_motions_of_the_same_steps_do_not_confirm_each_other():
    """Local errors too small to divide a step add up: the first motions have the same steps."""
    scene = under_a_moment(
        [0.00313644, 0.000612325, 0.00231565],
        gravity=[-0.0146552, 0.0219323, 0.029981],
        payload=sr.Payload(0.0465287),
        base_quaternion=[-0.461588, -0.501491, -0.444665, -0.581133],
    )
    dt = 0.0110258
    fine = sr.simulate(scene, dt, steps=20, substeps=64)
    off = lambda motion: float(
        np.max(np.linalg.norm(motion.tip_positions - fine.tip_positions, axis=1)) / scene.length
    )
    given = sr.simulate(scene, dt, steps=20, substeps=1, max_time_error=np.inf)
    assert off(given) > 1.2e-2
    for options in ({}, {"tolerance": 1e-2}):
        motion = sr.simulate(scene, dt, steps=20, **options)
        assert off(motion) < 1e-2
        assert off(motion) < 3 * motion.stats["time_error"][-1]


def buckling():
    """A thin rod under a force from above, 560 EI/L^2, that it and a heavy payload give way to."""
    return as_arrays(
        sr.Scene(
            length=0.0662226,
            section=sr.Annulus(7.70654e-05, 5.83503e-05),
            young_modulus=9.75576e8,
            poisson_ratio=0.110157,
            density=2588.81,
            bending_damping=1.99913e-13,
            shear_damping=8.55808e-05,
            gravity=[0.0297665, 0.00148165, 0.00552688],
            payload=sr.Payload(4.57547e-4),
            tip_load=sr.TipLoad(force=[1.788548e-3, -3.733489e-4, 1.438873e-3]),
            base_quaternion=[0.711245, 0.583919, -0.20021, -0.336282],
        )
    )


@pytest.mark.parametrize("options", [{}, {"tolerance": 2e-3}], ids=str)
def test_every_step_is_divided_for_a_motion_that_tells_an_error(options):
    """Where two motions have the same steps, their difference lacks an error of speed made there.

    Here it is made in the first three steps, whose local errors move the tip by little at once.
    """
    scene, dt, grid = buckling(), 5.177695e-3, sr.Collocation(24)
    fine = sr.simulate(scene, dt, steps=20, substeps=32, method=grid)
    motion = sr.simulate(scene, dt, steps=20, method=grid, **options)
    assert motion.result == sr.RESULTS.successful
    off = np.max(np.linalg.norm(motion.tip_positions - fine.tip_positions, axis=1)) / scene.length
    assert off < 3 * motion.stats["time_error"][-1]


def pulled_next_to_its_axis():
    """A thin rod whose tendons, at 4 % of its length from each other, are pulled in the first step.

    It turns fast then, and by the end of that step it has hardly moved.
    """
    scene = sr.Scene(
        length=0.063,
        section=sr.Circle(8e-4),
        young_modulus=9.27e8,
        poisson_ratio=0.483,
        density=2930.0,
        bending_damping=4.33e-7,
        shear_damping=2.71,
        gravity=[11.0, -11.5, -53.2],
        tendons=sr.Tendons(
            [[-6.5e-5, -3.235e-4], [3.127e-4, 1.054e-4], [-2.476e-4, 2.181e-4]], control="length"
        ),
    )
    return as_arrays(scene), np.tile([1.25e-3, -4.7e-4, -5.5e-5], (10, 1))


def test_errors_of_a_speed_with_which_tendons_start_a_rod_are_seen():
    """The estimate by places alone is a tenth of the error."""
    scene, pulls = pulled_next_to_its_axis()
    given, fine = (
        sr.simulate(scene, 2.84e-4, pulls=pulls, substeps=k, max_time_error=np.inf) for k in (1, 32)
    )
    off = np.linalg.norm(given.tip_positions - fine.tip_positions, axis=1).max() / scene.length
    assert off > 1.5e-2
    assert off / 2 < given.stats["time_error"][-1] < 10 * off


# Solutions of cos x cosh x = -1, and the size of their modes' sine parts.
@pytest.mark.parametrize(
    "root, weight, known", [(1.8751041, 0.7340955, 1.0), (4.6940911, 1.0184673, 0.0)]
)
def test_a_speed_moves_the_tip_by_what_its_first_mode_does(root, weight, known):
    """Of a straight uniform rod: speed over frequency, and hardly anything of the second mode."""
    scene = as_arrays(
        sr.Scene(
            length=LENGTH, section=sr.Circle(RADIUS), young_modulus=YOUNG, poisson_ratio=0.3,
            density=DENSITY, payload=None,
        )
    )  # fmt: skip
    method = sr.Collocation(20).fitted(scene)
    grid = method.grid(scene)
    rod = make_rod(scene, grid=grid)
    x = np.asarray(method.outputs(grid.s)) * root / LENGTH
    shape = np.cosh(x) - np.cos(x) - weight * (np.sinh(x) - np.sin(x))
    along = np.broadcast_to([0.0, 0.0, 1.0], (len(x), 3))
    first = 1.8751041**2 * np.sqrt(EI_LL / OWN_MASS / LENGTH)
    # Along the rod it is stretch, and no bending.
    speed = (0.3 * shape / shape[-1])[:, None] * [0.6, -0.8, 0.0] + along
    moved = moved_by_speed(jnp.array(speed), jnp.array(along), rod, method)
    np.testing.assert_allclose(moved * LENGTH * first / 0.3, known, atol=0.04)


@pytest.fixture(scope="module")
def hanging():
    """A rod, and a motion of it for others to be made of."""
    rod = dict(length=0.1, section=sr.Circle(6e-3), young_modulus=5e4, poisson_ratio=0.49)
    scene = as_arrays(sr.Scene(**rod, density=1070.0))
    return scene, sr.simulate(scene, 5e-3, steps=3, method=sr.Collocation(6))


def checked(
    hanging,
    tip,
    time_error,
    along=lambda k: 0.0,
    breaks=lambda k: False,
    broken=sr.RESULTS.diverged,
    fixed_steps=False,
    substeps=500,
    missed=None,
):
    """What `run_checked` makes of motions whose k-th has these numbers, and the care of each."""
    (scene, motion), taken = hanging, []

    def run(care, method, limit):
        k = len(taken)
        taken.append((care, method))
        same = jnp.ones(3)
        stats = {"time_error": time_error(k) * same, "error": along(k) * same}
        if missed is not None:
            stats["touch_error"] = missed[k] * same
        code = sr.RESULTS.inaccurate if time_error(k) > limit else sr.RESULTS.successful
        code = broken if breaks(k) else code
        return dataclasses.replace(
            motion,
            tip_positions=motion.tip_positions.at[1:, 0].set(tip(k) * scene.length),
            result=jnp.array(code, jnp.int32),
            stats=motion.stats | stats | {"substeps": jnp.full(3, substeps * 2**k)},
        )

    options = dict(fixed_grid=False, fixed_steps=fixed_steps, substeps=1, limit=1e-2)
    method = sr.Collocation(6)
    return run_checked(run, scene, 5e-3, sr.SDIRK(), method, **options), taken


def test_motions_that_never_agree_are_as_wrong_as_the_best_of_them_says(hanging):
    motion, taken = checked(
        hanging, tip=lambda k: [0.0, 0.1, 0.3, 0.5][k], time_error=lambda k: 0.02
    )
    assert len(taken) == 4
    assert motion.result == sr.RESULTS.inaccurate
    np.testing.assert_allclose(motion.stats["time_error"], 0.5)


@pytest.mark.parametrize(
    "tips, missed, grids",
    [
        ((0.0,), (1e-3,), 1),
        ((0.0, 8e-3), (4e-3, 2e-3), 2),  # the finer one is good
        ((0.0, 1e-3), (9e-3, 8e-3), 2),  # both are, better than they say
        ((0.0, 1e-3, 1e-3), (0.3, 0.1, 8e-3), 3),
        ((0.0, 0.05, 0.051), (4e-3, 1e-3, 1e-3), 3),  # the first was worse than it said
    ],
)
def test_a_motion_that_touches_is_on_a_grid_that_sees_it(hanging, tips, missed, grids):
    motion, taken = checked(hanging, lambda k: tips[k], lambda k: 1e-3, missed=missed)
    assert [method.intervals for _, method in taken] == [6, 12, 24][:grids]
    assert motion.result == sr.RESULTS.successful
    assert motion.stats["intervals"] == taken[-1][1].intervals
    np.testing.assert_allclose(motion.tip_positions[-1, 0], 0.1 * tips[-1])


@pytest.mark.parametrize(
    "left, code", [(3e-3, sr.RESULTS.successful), (5e-3, sr.RESULTS.inaccurate)]
)
def test_what_is_rough_on_the_finest_grid_may_be_wrong(hanging, left, code):
    """Estimates along the rod fall with each grid, and still say 0.3 and 0.5 % on the last one."""
    motion, taken = checked(hanging, lambda k: 0.0, lambda k: 1e-3, lambda k: left * 5 ** (4 - k))
    assert taken[-1][1].intervals == 96
    assert motion.result == code


@pytest.mark.parametrize("broken", [5, 1])
def test_a_touch_on_which_no_two_grids_agree_is_inaccurate(hanging, broken):
    """They differ on all of them, or there is no other."""
    motion, taken = checked(
        hanging, lambda k: 0.05 * k, lambda k: 1e-3, missed=[0.02] * 5, breaks=lambda k: k >= broken
    )
    grids = [6, 12, 24, 48, 96][: broken + 1]
    assert [method.intervals for _, method in taken] == grids
    assert motion.result == sr.RESULTS.inaccurate
    told = 0.05 if broken > 1 else 1e-3  # what another grid says, or the motion of itself
    np.testing.assert_allclose(motion.stats["time_error"], told)


@pytest.mark.parametrize("other, solved", [(0.3015, True), (0.6, False)])
def test_where_small_errors_grow_only_another_grid_confirms(hanging, other, solved):
    """The third motion differs by much from the second, and the fourth agrees with it."""
    tips = [0.0, 0.1, 0.3, 0.3005, other, 0.9]
    motion, taken = checked(hanging, lambda k: tips[k], time_error=lambda k: 0.02)
    assert [method.intervals for _, method in taken[:5]] == [6, 6, 6, 6, 12]
    assert taken[3][0] == taken[4][0]
    assert (motion.result == sr.RESULTS.successful) == solved
    if solved:
        assert len(taken) == 5 and motion.stats["intervals"] == 6
        np.testing.assert_allclose(motion.stats["time_error"], 1e-3, rtol=1e-6)
    else:
        assert motion.result == sr.RESULTS.inaccurate and motion.stats["time_error"][-1] > 0.25


def test_motions_of_few_steps_are_tried_more_often(hanging):
    tips = [0.0, 0.1, 0.11, 0.12, 0.13, 0.131]
    motion, taken = checked(hanging, lambda k: tips[k], time_error=lambda k: 0.02, substeps=1)
    assert len(taken) == 6
    assert motion.result == sr.RESULTS.successful
    np.testing.assert_allclose(motion.stats["time_error"], 1e-3, rtol=1e-6)


def test_more_care_means_shorter_substeps_and_a_grid_for_what_they_show(hanging):
    """The first motion, with long steps, has no waves that would be rough on its grid."""
    motion, taken = checked(
        hanging,
        tip=lambda k: [0.1, 0.01, 0.0, 0.0][k],
        time_error=lambda k: 0.02,
        along=lambda k: [0.0, 3e-4, 0.0, 0.0][k],
    )
    cares = [care for care, _ in taken[1:]]
    assert len(cares) == 3
    assert all(b.limit < a.limit and b.longest < a.longest for a, b in itertools.pairwise(cares))
    assert [method.intervals for _, method in taken] == [6, 6, 12, 12]
    assert motion.result == sr.RESULTS.successful and motion.stats["intervals"] == 12


def test_a_motion_that_breaks_off_is_tried_with_more_care(hanging):
    """Twice: the first tries break off, too, and the last two agree, or do not."""
    numbers = dict(time_error=lambda k: 1e-3, breaks=lambda k: k < 2)
    motion, taken = checked(hanging, tip=lambda k: 0.1 + 1e-3 * (k == 2), **numbers)
    assert len(taken) == 4 and motion.result == sr.RESULTS.successful
    np.testing.assert_allclose(motion.stats["time_error"], 1e-3, rtol=1e-6)
    assert all(b.longest < a.longest for (a, _), (b, _) in itertools.pairwise(taken[1:]))
    # The grid may be to blame, too.
    assert [method.intervals for _, method in taken] == [6, 6, 12, 12]
    motion, taken = checked(hanging, tip=lambda k: 0.1 * k, **numbers)
    assert len(taken) == 6 and motion.result == sr.RESULTS.inaccurate
    np.testing.assert_allclose(motion.stats["time_error"], 0.1, rtol=1e-6)
    motion, taken = checked(hanging, tip=lambda k: 0.1, fixed_steps=True, **numbers)
    assert len(taken) == 1 and motion.result == sr.RESULTS.diverged


def test_a_motion_that_stretches_too_far_may_have_had_too_long_steps(hanging):
    """If two others do so, too, there is none, and that is said whatever the first one said."""
    beyond = sr.RESULTS.no_equilibrium
    numbers = dict(tip=lambda k: 0.1, time_error=lambda k: 1e-3, broken=beyond)
    motion, taken = checked(hanging, breaks=lambda k: k == 0, **numbers)
    assert len(taken) == 3 and motion.result == sr.RESULTS.successful
    motion, taken = checked(hanging, breaks=lambda k: True, **numbers)
    assert len(taken) == 3 and motion.result == beyond


def test_errors_grow_under_a_moment_that_makes_the_rod_flutter():
    """A moment about the rod's own axis, of fixed direction, does work in a whirling motion."""
    scene = under_a_moment([0.000592, 0.000197, 0.00391], bending_damping=1e-8)
    move = lambda substeps: sr.simulate(
        scene, 4e-3, steps=40, substeps=substeps, max_time_error=np.inf
    )
    rough, fine = move(1), move(32)
    apart = np.linalg.norm(rough.tip_positions - fine.tip_positions, axis=1) / scene.length
    assert np.max(apart) > 3 * np.max(apart[:11])  # errors grow,
    estimate = rough.stats["time_error"]
    assert estimate[-1] > 3 * estimate[9]  # and so does the estimate
    assert np.all(3 * estimate > np.maximum.accumulate(apart)[1:])


LENGTH, RADIUS, YOUNG, DENSITY = 0.1, 1e-3, 1e6, 1e3
EI_LL = YOUNG * np.pi / 4 * RADIUS**4 / LENGTH**2
OWN_MASS = DENSITY * np.pi * RADIUS**2 * LENGTH
# Poses of the clamp: any, and one in each plane.
POSES = {
    None: [0.5, 0.7, -0.3, 0.4],
    "xz": [np.cos(0.7), 0.0, np.sin(0.7), 0.0],
    "yz": [np.cos(0.7), np.sin(0.7), 0.0, 0.0],
}


# The loads of Euler, pi^2/4, and Greenhill, 7.837, in EI/L^2, press `part` of them on a rod.
@pytest.mark.parametrize("plane", POSES)
@pytest.mark.parametrize(
    "loads",
    [
        lambda down: dict(tip_load=sr.TipLoad(force=np.pi**2 / 4 * down)),
        lambda down: dict(loads=[sr.Load(0.999 * LENGTH, force=np.pi**2 / 4 * down)]),
        lambda down: dict(gravity=7.837 / OWN_MASS * down),
        lambda down: dict(
            gravity=down / OWN_MASS,
            payload=sr.Payload((np.pi**2 / 4 - 0.3) * OWN_MASS / 2),
            masses=[sr.Mass(0.999 * LENGTH, (np.pi**2 / 4 - 0.3) * OWN_MASS / 2)],
        ),
    ],
    ids=["tip force", "force", "weight", "payload and mass"],
)
def test_errors_grow_where_a_rod_gives_way(loads, plane):
    pose = np.array(POSES[plane]) / np.linalg.norm(POSES[plane])
    axis = to_base(jnp.array(pose), jnp.array([0.0, 0.0, 1.0]))

    def rate(part):
        scene = sr.Scene(
            length=LENGTH,
            section=sr.Circle(RADIUS),
            young_modulus=YOUNG,
            poisson_ratio=0.3,
            density=DENSITY,
            base_quaternion=pose,
            plane=plane,
            **loads(-part * EI_LL * axis),
        )
        method = sr.Collocation(20).fitted(scene)
        grid = method.grid(as_arrays(scene))
        rod = make_rod(as_arrays(scene), grid=grid)
        straight = jnp.array([0.0, 0.0, 1.0]) if plane else axis
        tangent = jnp.broadcast_to(straight, (*method.outputs(grid.s).shape, 3))
        return rate_of_change(rod, tangent, method)

    assert rate(0.98) == 0
    assert rate(1.04) > 0
    assert rate(-5.0) == 0


@pytest.mark.parametrize("damping", [None, 1e-6])
@pytest.mark.parametrize("moment", [[0.0, 0.0, 0.0], [0.0, 0.0, 1e-4]])
def test_an_estimate_has_no_slope_and_spoils_none(moment, damping):
    """Its roots are at zero where a moment is; reverse mode must not see them."""
    scene = as_arrays(
        sr.Scene(
            length=0.1,
            section=sr.Circle(6e-3),
            young_modulus=5e4,
            poisson_ratio=0.49,
            density=1070.0,
            bending_damping=damping,
            gravity=[-9.81, 0.0, 0.0],
            tip_load=sr.TipLoad(moment=moment),
        )
    )

    def both(scene):
        motion = sr.simulate(scene, 5e-3, steps=3, method=sr.Collocation(6), throw=False)
        return motion.tip_positions[-1, 0], motion.stats["time_error"][-1]

    by_tip, by_estimate = (
        jax.jit(jax.grad(lambda scene, k=k: both(scene)[k]))(scene) for k in (0, 1)
    )
    assert abs(by_tip.young_modulus) > 0
    assert all(np.all(np.isfinite(x)) for x in jax.tree.leaves(by_tip))
    assert not any(np.any(x) for x in jax.tree.leaves(by_estimate))
