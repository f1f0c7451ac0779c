"""Numbers that cannot be: refused where known, a code where traced, and never in a gradient."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import softrod_jax as sr
from softrod_jax.scene.scene import as_arrays

METHOD = sr.Collocation(6)
BAD = int(sr.RESULTS.bad_input)


def robot() -> sr.Scene:
    """Everything that a scene can have."""
    return as_arrays(
        dataclasses.replace(
            sr.hybrid_robot(gravity=[3.0, 0.0, 9.81]),
            section=sr.Annulus(6e-3, 1e-3),
            shear_damping=1e-3,
            shear_correction=0.9,
            payload=sr.Payload(1e-3),
            tip_load=sr.TipLoad([1e-3, 0.0, 0.0], [0.0, 1e-5, 0.0]),
            rest_curvature=[1.0, 0.0, 0.0],
            rest_stretch=[0.0, 0.0, 1.01],
            base_position=[0.0, 0.0, 0.1],
            base_quaternion=[0.8, 0.6, 0.0, 0.0],
        )
    )


# A part of the scene, and values that it cannot have.
NAN, INF = np.nan, np.inf
SCENES = {
    "length": (0.0, -0.1, NAN, INF),
    "section.outer_radius": (0.0, -6e-3, NAN, 5e-4),
    "section.inner_radius": (-1e-3, NAN, 7e-3),
    "young_modulus": (0.0, -5e4, NAN, INF),
    "poisson_ratio": (99.0, 0.5, -1.0, NAN),
    "density": (0.0, -1070.0, NAN),
    "bending_damping": (-1e-6, NAN),
    "shear_damping": (-1e-3, INF),
    "gravity": (NAN, INF),
    "drag_coefficient": (-0.03, NAN),
    "tendons.offsets": (NAN, INF),
    "chambers.areas": (0.0, -1e-6, NAN),
    "chambers.offsets": (NAN,),
    "payload.mass": (-1e-3, NAN),
    "tip_load.force": (NAN, -INF),
    "tip_load.moment": (NAN,),
    "shear_correction": (0.0, -1.0, NAN),
    "rest_curvature": (NAN,),
    "rest_stretch": (0.0, -1.0, NAN),
    "base_position": (INF,),
    "base_quaternion": (0.0, 1.0, NAN),
}
INPUTS = {"tensions": (-0.1, NAN, INF), "pressures": (NAN, -INF), "dt": (0.0, -0.01, NAN, INF)}
# What has no solution, or none in floating point: it may show as late as in Newton's method.
EXTREMES = {
    "length": (1e300, 1e-300),
    "young_modulus": (1e308, 1e-310),
    "density": (1e-320, 1e306),
    "tip_load.force": (1e9, 1e300),
    "tensions": (5.0, 1e300),
    "pressures": (-1e9, 1e300),
    "dt": (1e300, 1e-300),
}
KINDS = [
    (name, value)
    for kinds in (SCENES, INPUTS, EXTREMES)
    for name, values in kinds.items()
    for value in values
]


def with_number(scene, inputs, name, value):
    """Scene and inputs with one number in them replaced."""
    if name in inputs:
        x = inputs[name]
        return scene, {**inputs, name: jnp.full_like(x, value)}
    get = lambda s: _part(s, name)
    return eqx.tree_at(get, scene, jnp.full_like(get(scene), value)), inputs


def _part(scene, name):
    for key in name.split("."):
        scene = getattr(scene, key)
    return scene


def inputs_of(moving):
    rows = (3,) if moving else ()
    tensions, pressures = jnp.full((*rows, 3), 0.02), jnp.full((*rows, 1), 1e3)
    inputs = {"tensions": tensions, "pressures": pressures}
    return {**inputs, "dt": jnp.array(0.01)} if moving else inputs


def tip(scene, inputs, moving):
    """The tip at the end and the code, of an equilibrium or a motion."""
    if moving:
        end = sr.simulate(scene, **inputs, method=METHOD, throw=False)
        return end.tip_positions[-1], end.result
    end = sr.solve_static(scene, **inputs, method=METHOD, throw=False)
    return end.tip_position, end.result


@pytest.fixture(scope="module")
def batches():
    """For statics and for motions: gradients, codes and tips of a batch of two, in one program."""

    def of(moving):
        def loss(shared, samples):
            """By a modulus that is added to all, and by all numbers of the samples."""

            def one(sample):
                scene, inputs = sample
                # A sum, because the derivative of a product with what is no number is none.
                stiffer = dataclasses.replace(scene, young_modulus=scene.young_modulus + shared)
                return tip(stiffer, inputs, moving)

            tips, codes = jax.vmap(one)(samples)
            return jnp.sum(tips**2), (tips, codes)

        def every(samples):
            reverse, out = jax.grad(loss, argnums=(0, 1), has_aux=True)(0.0, samples)
            forward = jax.jvp(lambda x: loss(x, samples)[0], (0.0,), (1.0,))[1]
            return reverse, forward, out

        return jax.jit(every)

    return {moving: of(moving) for moving in (False, True)}


def pair(*samples):
    return jax.tree.map(lambda *x: jnp.stack(x), *samples)


@pytest.mark.parametrize(
    "moving", [False, pytest.param(True, marks=pytest.mark.long)], ids=["statics", "motion"]
)
def test_a_bad_sample_is_not_in_the_gradient_of_its_batch(batches, moving):
    """Every kind of bad number: forward and reverse derivatives are those of the good sample."""
    good = (robot(), inputs_of(moving))
    both = batches[moving](pair(good, good))
    (by_shared, by_own), forward, (tips, codes) = both
    assert codes.tolist() == [0, 0] and by_shared != 0
    for name, value in KINDS:
        if name == "dt" and not moving:
            continue
        bad = with_number(*good, name, value)
        (shared, own), jvp, (ends, found) = batches[moving](pair(good, bad))
        case = f"{name} = {value}"
        assert found[0] == 0 and found[1] != 0, case
        assert found[1] == BAD or name in EXTREMES and value in EXTREMES[name], case
        assert np.all(np.isfinite(ends)), case
        np.testing.assert_allclose(ends[0], tips[0], rtol=1e-12, err_msg=case)
        np.testing.assert_allclose([shared, jvp], by_shared / 2, rtol=1e-9, err_msg=case)
        for x, expected in zip(jax.tree.leaves(own), jax.tree.leaves(by_own), strict=True):
            np.testing.assert_allclose(x[0], expected[0], rtol=1e-9, atol=1e-15, err_msg=case)
            np.testing.assert_array_equal(x[1], np.zeros_like(x[1]), err_msg=case)


@pytest.mark.parametrize("name", SCENES)
def test_refused_at_once_where_known(name):
    """In Python as in a scene file; also under `vmap`, and where only something else is traced."""
    for value in SCENES[name]:
        scene, _ = with_number(robot(), {}, name, value)
        words = "annulus|inner|outer" if "radius" in name else name.split(".")[-1].rstrip("s")
        with pytest.raises(ValueError, match=words):
            sr.solve_static(scene, throw=False)
        with pytest.raises(ValueError, match=words):
            sr.simulate(scene, 0.01, steps=2, throw=False)
        with pytest.raises(ValueError, match=words):
            jax.jit(lambda x, scene=scene: sr.solve_static(scene, x, throw=False).result)(
                jnp.zeros(3)
            )


@pytest.mark.parametrize(
    "change, words",
    [
        (dict(gravity=[9.81]), "gravity .* list of 3 numbers"),
        (dict(gravity=jnp.array(9.81)), "gravity .* list of 3 numbers"),
        (dict(gravity="down"), "gravity = 'down'"),
        (dict(gravity=[[1.0], [2.0, 3.0]]), "gravity"),
        (dict(length=[0.1]), "length .* a number"),
        (dict(bending_damping=[1e-6, 1e-6]), "bending_damping .* a number or a list of 3"),
        (dict(tendons=sr.Tendons([4e-3, 0.0])), "tendons.offsets .* list of 2 numbers"),
        (dict(tendons=sr.Tendons(np.zeros((0, 2)))), "tendons.offsets"),
        (dict(tendons=sr.Tendons([[1e-3, 0], [np.nan, 0]])), r"tendons\[1\].offset = \[nan, 0"),
        (dict(chambers=sr.Chambers([1e-5, 1e-5], [[0.0, 0.0]])), "2 areas and 1 offsets"),
        (dict(tip_load=sr.TipLoad(force=[1.0, 2.0])), "tip_load.force"),
        (dict(section=sr.GeneralSection(1e-4, [1e-9], 2e-9)), "second_moments .* list of 2"),
    ],
)
@pytest.mark.usefixtures("wrong_types")
def test_refuses_what_is_no_such_array(change, words):
    scene = dataclasses.replace(sr.hybrid_robot(), **change)
    with pytest.raises(ValueError, match=words):
        sr.solve_static(scene)
    with pytest.raises(ValueError, match=words):
        sr.simulate(scene, 0.01, steps=2)


def test_takes_lists_for_arrays():
    lists = dataclasses.replace(sr.hybrid_robot(), gravity=[9.81, 0, 0], bending_damping=[1e-6] * 3)
    arrays = sr.hybrid_robot(gravity=jnp.array([9.81, 0.0, 0.0]))
    arrays = dataclasses.replace(arrays, bending_damping=jnp.full(3, 1e-6))
    a, b = (sr.solve_static(scene, method=METHOD) for scene in (lists, arrays))
    np.testing.assert_array_equal(a.tip_position, b.tip_position)


@pytest.mark.parametrize(
    "arguments, words",
    [
        (dict(dt=np.nan), "dt"),
        (dict(dt="soon"), "dt"),
        (dict(dt=[0.1, 0.1]), "dt"),
        (dict(steps=np.nan), "steps"),
        (dict(steps=2.5), "steps"),
        (dict(substeps=0), "substeps"),
        (dict(substeps=True), "substeps"),
        (dict(tensions="many", steps=None), "tensions"),
    ],
)
@pytest.mark.usefixtures("wrong_types")
def test_refuses_arguments_of_a_motion(arguments, words):
    arguments = {"dt": 0.01, "steps": 3, **arguments}
    with pytest.raises(ValueError, match=words):
        sr.simulate(sr.hybrid_robot(), **arguments)
    if "dt" in words:
        with pytest.raises(ValueError, match=words):
            jax.jit(lambda x: sr.simulate(sr.hybrid_robot(), arguments["dt"], steps=3).ts * x)(1.0)


def test_a_motion_from_an_equilibrium_that_was_not_found():
    """It has the code of the equilibrium, alone and in a batch, and the derivative zero."""
    scene, rows = sr.hybrid_robot(), jnp.zeros((2, 3))

    @jax.jit
    @jax.vmap
    def run(pull):
        tension = jnp.stack([pull, 0.0 * pull, 0.0 * pull])
        initial = sr.solve_static(scene, tension, method=METHOD, throw=False)
        motion = sr.simulate(scene, 0.01, rows, initial=initial, method=METHOD, throw=False)
        return initial.result, motion.result, motion.failed_step, motion.tip_positions

    first, codes, failed, tips = run(jnp.array([0.1, 2.5]))
    assert first.tolist() == codes.tolist() == [0, sr.RESULTS.no_equilibrium]
    assert failed.tolist() == [-1, 0]
    assert np.all(np.isfinite(tips))
    initial = sr.solve_static(scene, (2.5, 0.0, 0.0), method=METHOD, throw=False)
    with pytest.raises(sr.SolveError, match="no smooth equilibrium"):
        sr.simulate(scene, 0.01, rows, initial=initial, method=METHOD)


def test_a_rod_that_is_sucked_through_itself():
    """A chamber of the tube's own area A under -P: v3 = 1 - P A_c / EA, which must stay above 0."""
    tube = sr.Annulus(6e-3, 5e-3)
    chamber = sr.Chambers([np.pi * 25e-6], [[0.0, 0.0]])
    scene = as_arrays(sr.Scene(0.1, tube, 5e4, 0.49, 1070.0, chambers=chamber))
    least = 5e4 * 11 / 25
    solve = jax.jit(lambda p: sr.solve_static(scene, None, p[None], method=METHOD, throw=False))
    for part, code in ((0.5, 0), (0.99, 0), (1.01, 1), (1.2, 1), (5.0, 1)):
        solution = solve(jnp.array(-part * least))
        assert solution.result == code, part
        if code == 0:
            np.testing.assert_allclose(solution.tip_position[2], 0.1 * (1 - part), rtol=1e-8)
    # Without damping, a sudden load stretches twice as much as a slow one.
    move = jax.jit(
        lambda p: sr.simulate(
            scene,
            3e-3,
            None,
            jnp.full((20, 1), p),
            method=METHOD,
            max_time_error=jnp.inf,  # steps are too long for fronts that nothing damps
            throw=False,
        )
    )
    for part, code in ((0.2, 0), (0.4, 0), (0.6, 1), (0.9, 1), (5.0, 1)):
        assert move(-part * least).result == code, part
