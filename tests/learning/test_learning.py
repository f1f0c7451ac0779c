"""The rod in learning pipelines: steps, their gradients, batches, resets; layer; environment."""

import subprocess
import sys
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest

import softrod_jax as sr
from softrod_jax import learning
from softrod_jax.learning import Action, Stepper, reset_where
from softrod_jax.stepping.step_inputs import jumps

SCENE = sr.hybrid_robot(gravity=jnp.array([-2.0, 0.0, 9.81]))
GRID, DT, STEPS = sr.Collocation(4, order=6), 0.03, 10
BDF = dict(scheme=sr.BDFAlpha(), method=GRID)


def inputs():
    """A tendon that is pulled evenly, and two inputs that jump in step 6."""
    tensions, pressures = np.zeros((STEPS, 3)), np.zeros((STEPS, 1))
    tensions[:, 0] = 0.02 * np.arange(STEPS)
    tensions[6:, 1], pressures[6:] = 0.1, 1e4
    return tensions, pressures


def by_rollout(stepper, actions, jump):
    return stepper.rollout(stepper.reset(), actions, jump)


def by_single_steps(stepper, actions, jump):
    state, seen = stepper.reset(), []
    for k in range(STEPS):
        state = stepper.step(state, jax.tree.map(lambda x, k=k: x[k], actions), jump[k])
        seen.append(stepper.view(state))
    return state, jax.tree.map(lambda *rows: jnp.stack(rows), *seen)


@pytest.mark.parametrize(
    "scheme, go",
    [(sr.BDFAlpha(), by_single_steps), (sr.SDIRK(2), by_rollout)],
    ids=["bdf", "sdirk"],
)
def test_steps_are_those_of_simulate(scheme, go):
    """To rounding, inputs that jump among them."""
    tensions, pressures = inputs()
    tensions[6:, 0] += 0.1  # a stepper's action jumps as a whole
    jump = jumps(jnp.array(tensions))[:, 1]
    assert np.flatnonzero(jump).tolist() == [0, 6]
    # With these steps, too long as they are for good tips.
    steps = dict(substeps=1, max_time_error=jnp.inf)
    motion = sr.simulate(SCENE, DT, tensions, pressures, scheme=scheme, method=GRID, **steps)
    stepper = Stepper(SCENE, DT, scheme=scheme, method=GRID)
    state, seen = go(stepper, Action(tensions, pressures), jump)
    np.testing.assert_allclose(seen.time, motion.ts[1:], rtol=1e-12)
    np.testing.assert_allclose(seen.tip_position, motion.tip_positions[1:], atol=1e-12)
    np.testing.assert_allclose(seen.tip_velocity, motion.tip_velocities[1:], atol=1e-11)
    np.testing.assert_allclose(seen.positions, motion.positions[1:], atol=1e-12)
    np.testing.assert_allclose(seen.strains, motion.strains[1:], atol=1e-10)
    assert np.ptp(motion.tip_positions, axis=0).max() > 5e-3
    assert state.result == 0


PULLED = sr.Scene(
    length=0.1,
    section=sr.Circle(6e-3),
    young_modulus=2e5,
    poisson_ratio=0.45,
    density=1070.0,
    bending_damping=1e-5,
    gravity=jnp.array([-3.0, 0.0, 0.0]),
    plane="xz",
    tendons=sr.Tendons(
        [[4e-3, 0.0], [-4e-3, 0.0], [-4e-3, 0.0]],
        control=("length", "tension", "length"),
        stiffness=(200.0, None, None),
        pretension=(0.05, None, None),
    ),
)


def test_steps_of_pulls_are_those_of_simulate():
    """Tensions are seen, and a layer's path is the same."""
    tensions = np.full((STEPS, 1), 0.05)
    pulls = 2e-4 * np.stack([np.arange(STEPS), -np.arange(STEPS)], axis=1)
    held = Action(tensions[0], None, pulls[0])
    initial = sr.solve_static(PULLED, *held, method=GRID)
    steps = dict(substeps=1, max_time_error=jnp.inf, initial=initial, **BDF)
    motion = sr.simulate(PULLED, DT, tensions, None, pulls, **steps)
    stepper = Stepper(PULLED, DT, **BDF)
    state = stepper.reset(initial, held)
    np.testing.assert_allclose(stepper.view(state).tensions, initial.tensions, atol=1e-12)
    state, seen = stepper.rollout(state, Action(tensions, None, pulls))
    assert state.result == 0
    np.testing.assert_allclose(seen.tip_position, motion.tip_positions[1:], atol=1e-12)
    np.testing.assert_allclose(seen.tensions, motion.tensions[1:], rtol=1e-9, atol=1e-12)
    np.testing.assert_array_equal(seen.tensions[:, 1], 0.05)
    assert np.ptp(seen.tensions[:, 0]) > 0.05
    path = learning.RodLayer(PULLED, DT, **BDF)(tensions, None, pulls, initial=initial)
    np.testing.assert_allclose(path.tip_positions, motion.tip_positions[1:], atol=1e-12)
    # An action that says nothing of pulls is one of pull 0.
    at_zero = stepper.step(stepper.reset(), Action(None, None, np.zeros(2)))
    nothing = stepper.step(stepper.reset(), Action())
    np.testing.assert_array_equal(
        stepper.view(at_zero).tip_position, stepper.view(nothing).tip_position
    )


def test_a_rod_in_equilibrium_stays_there():
    held = Action(jnp.array([0.1, 0.0, 0.0]), jnp.array([1e4]))
    initial = sr.solve_static(SCENE, *held, method=GRID)
    stepper = Stepper(SCENE, DT, **BDF)
    state = stepper.reset(initial, held)
    # Only from an unloaded rod does the first action jump by default, as in `simulate`.
    assert stepper.reset().jumps and not state.jumps
    np.testing.assert_allclose(stepper.view(state).tip_position, initial.tip_position, atol=1e-14)
    for _ in range(3):
        state = stepper.step(state, held)
        assert not state.jumps
    np.testing.assert_allclose(stepper.view(state).tip_position, initial.tip_position, atol=1e-9)
    np.testing.assert_allclose(state.velocities, 0.0, atol=1e-7)


# A batch of rods that a small policy drives. What the tests ask of it is one program.


def policy_of(key):
    return eqx.nn.MLP(9, 3, width_size=8, depth=1, activation=jnp.tanh, dtype=float, key=key)


TARGETS = jnp.array([[0.02, 0.01, 0.098], [-0.01, 0.02, 0.098], [-0.01, -0.02, 0.098]])
NEVER = STEPS


def drive(params, target, reset_at, poison):
    """The tip's path, (STEPS, 3), and the codes, of a rod driven by a policy in a loop.

    `params`: the policy, "pulls" (STEPS, 3) [N] added to what it says, and the logarithm of "E" in
    units of the scene's. The rod is reset before step `reset_at`; before that, `poison` [N] is
    added to a tension.
    """
    E = SCENE.young_modulus * jnp.exp(params["log_E"])
    stepper = Stepper(eqx.tree_at(lambda s: s.young_modulus, SCENE, E), DT, **BDF)
    fresh = stepper.reset()

    def one(state, row):
        k, pull = row
        state = reset_where(k == reset_at, fresh, state)
        view = stepper.view(state)
        seen = jnp.concatenate([view.tip_position / 0.1, view.tip_velocity, target / 0.1])
        tension = 0.3 * jax.nn.sigmoid(params["policy"](seen) - 2) + pull
        tension = tension.at[0].add(jnp.where(k < reset_at, poison, 0.0))
        state = stepper.step(state, Action(tension))
        return state, (stepper.view(state).tip_position, state.result)

    return jax.lax.scan(one, fresh, (jnp.arange(STEPS), params["pulls"]))[1]


def losses(params, targets, reset_at, poison, weights):
    """Mean square distance to the targets in the second half [cm^2], and all paths and codes."""
    batch = jax.vmap(partial(drive, params))(targets, reset_at, poison)
    far = jnp.sum((batch[0] - targets[:, None]) ** 2, -1) * 1e4
    return jnp.sum(weights * jnp.mean(far[:, STEPS // 2 :], axis=1)), batch


@pytest.fixture(scope="module")
def loss_and_slope():
    """Of `losses`, in all parameters."""
    program = eqx.filter_jit(eqx.filter_value_and_grad(losses, has_aux=True))

    def call(
        params, reset_at=3 * (NEVER,), poison=3 * (0.0,), weights=3 * (1 / 3,), targets=TARGETS
    ):
        return program(params, targets, *map(jnp.array, (reset_at, poison, weights)))

    return call


@pytest.fixture(scope="module")
def params():
    pulls = 0.02 + 0.01 * jnp.sin(jnp.arange(3.0 * STEPS)).reshape(STEPS, 3)
    return {"policy": policy_of(jax.random.key(0)), "pulls": pulls, "log_E": jnp.zeros(())}


@pytest.mark.long
def test_forward_reverse_and_differences_agree_through_steps(loss_and_slope, params):
    """In the actions, in Young's modulus, and in the weights of a policy in the loop."""
    arrays, static = eqx.partition(params, eqx.is_array)
    directions = {
        "pulls": lambda key, x: jax.random.normal(key, x.shape) * 0.02,
        "log_E": lambda key, x: jnp.ones(()),
        "policy": lambda key, x: jax.random.normal(key, x.shape),
    }
    (_, (_, result)), slope = loss_and_slope(params)
    assert not np.any(result)

    @jax.jit
    def forward(arrays, along):
        def f(arrays):
            p = eqx.combine(arrays, static)
            never, none = jnp.full(3, NEVER), jnp.zeros(3)
            return losses(p, TARGETS, never, none, jnp.ones(3) / 3)[0]

        return jax.jvp(f, (arrays,), (along,))[1]

    for i, (name, draw) in enumerate(directions.items()):
        leaves, tree = jax.tree.flatten(arrays[name])
        keys = jax.random.split(jax.random.key(i), len(leaves))
        part = jax.tree.unflatten(tree, [draw(k, x) for k, x in zip(keys, leaves, strict=True)])
        along = {**jax.tree.map(jnp.zeros_like, arrays), name: part}
        reverse = sum(jax.tree.leaves(jax.tree.map(lambda a, b: jnp.sum(a * b), slope, along)))
        np.testing.assert_allclose(forward(arrays, along), reverse, rtol=1e-8)

        def at(x, along=along):
            moved = jax.tree.map(lambda a, b: a + x * b, arrays, along)
            return loss_and_slope(eqx.combine(moved, static))[0][0]

        d = 1e-3
        difference = (8 * (at(d) - at(-d)) - (at(2 * d) - at(-2 * d))) / (12 * d)
        assert abs(reverse) > 1e-3
        np.testing.assert_allclose(reverse, difference, rtol=1e-6)


def test_a_batch_is_a_loop_and_each_sample_resets_by_itself(loss_and_slope, params):
    at = (3, NEVER, 6)
    same = {**params, "pulls": params["pulls"][:1].repeat(STEPS, 0)}
    (_, (tips, result)), _ = loss_and_slope(same, at, targets=TARGETS[:1].repeat(3, 0))
    assert not np.any(result)
    for i, k in enumerate(at):
        np.testing.assert_allclose(tips[i, :k], tips[1, :k], atol=1e-12)
        np.testing.assert_allclose(tips[i, k:], tips[1, : STEPS - k], atol=1e-12)
    # And the loop: one sample, no vmap, no scan.
    stepper = Stepper(SCENE, DT, **BDF)
    state = stepper.reset()
    for k in range(STEPS):
        view = stepper.view(state)
        seen = [view.tip_position / 0.1, view.tip_velocity, TARGETS[0] / 0.1]
        tension = 0.3 * jax.nn.sigmoid(same["policy"](jnp.concatenate(seen)) - 2)
        state = stepper.step(state, Action(tension + same["pulls"][k]))
        np.testing.assert_allclose(stepper.view(state).tip_position, tips[1, k], atol=1e-12)


@pytest.mark.parametrize(
    "poison, code",
    [(np.nan, sr.RESULTS.bad_input), (-9.0, sr.RESULTS.bad_input), (9.0, None)],
)
def test_a_sample_that_fails_spoils_nothing(loss_and_slope, params, poison, code):
    """Neither the others' paths, nor the gradient; a reset heals it."""
    poisoned = jnp.array([0.0, poison, 0.0])
    weights = jnp.array([0.5, 0.0, 0.5])
    (clean, (tips, _)), slope = loss_and_slope(params, weights=weights)
    (loss, (seen, result)), bad = loss_and_slope(params, poison=poisoned, weights=weights)
    assert np.all(result[1] != 0) and not np.any(result[::2])
    assert code is None or np.all(result[1] == code)
    np.testing.assert_array_equal(seen[::2], tips[::2])
    np.testing.assert_array_equal(seen[1], np.tile(seen[1, 0], (STEPS, 1)))  # held
    assert loss == clean
    for a, b in zip(jax.tree.leaves(slope), jax.tree.leaves(bad), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-12, atol=1e-15)
    # With a weight of its own, its derivative is zero and not NaN.
    _, alone = loss_and_slope(params, poison=poisoned, weights=jnp.array([0.0, 1.0, 0.0]))
    assert all(np.all(x == 0) for x in jax.tree.leaves(alone))
    (_, (seen, result)), _ = loss_and_slope(params, reset_at=(NEVER, 4, NEVER), poison=poisoned)
    assert np.all(result[1, :4] != 0) and not np.any(result[1, 4:])
    assert np.all(np.ptp(seen[1, 4:], axis=0) > 1e-4)


def test_a_policy_improves(loss_and_slope, params):
    """Thirty steps of Adam on the policy alone, to less than a quarter of the loss."""
    policy, optimiser = params["policy"], optax.adam(0.1)
    memory = optimiser.init(eqx.filter(policy, eqx.is_array))
    course = []
    for _ in range(30):
        (loss, (_, result)), slope = loss_and_slope({**params, "policy": policy})
        assert not np.any(result)
        updates, memory = optimiser.update(slope["policy"], memory)
        policy = eqx.apply_updates(policy, updates)
        course.append(float(loss))
    assert course[-1] < 0.25 * course[0], course


@pytest.mark.parametrize(
    "call, words",
    [
        (lambda s: Stepper(SCENE, 0.0), "dt"),
        (lambda s: Stepper(SCENE, DT, substeps=0), "substeps"),
        (lambda s: s.reset(action=Action(np.ones(3))), "initial"),
        (lambda s: s.step(s.reset(), Action(np.ones(2))), r"shape \(2,\)"),
        (lambda s: s.step(s.reset(), Action(-np.ones(3))), "negative"),
        (lambda s: s.step(s.reset(), Action(np.full(3, np.nan))), "not finite"),
        (lambda s: s.rollout(s.reset(), Action()), "how many steps"),
        (lambda s: s.rollout(s.reset(), Action(np.ones((2, 3))), np.ones(3, bool)), "jumps"),
        (lambda s: s.rollout(s.reset(), Action(np.ones((2, 3)), np.ones((4, 1)))), "one row a"),
        (lambda s: Stepper(SCENE, DT).step(s.reset(), Action()), "one stepper"),
        (lambda s: learning.RodLayer(SCENE, DT, positive=["payload.mass"]), "payload.mass"),
        (lambda s: learning.RodLayer(SCENE, DT, positive=["gravity"]), "free"),
        (lambda s: learning.RodLayer(SCENE, DT, positive=["density"], free=["density"]), "once"),
    ],
)
def test_bad_arguments(call, words):
    with pytest.raises(ValueError, match=words):
        call(Stepper(SCENE, DT, **BDF))


class Model(eqx.Module):
    """A network in front of the rod."""

    gains: eqx.nn.Linear
    rod: learning.RodLayer

    def __call__(self, commands):
        return self.rod(0.2 * jax.nn.softplus(jax.vmap(self.gains)(commands)))


def test_a_layer_in_a_model():
    """Gradients of its parts and of a network before it, against differences."""
    rod = learning.RodLayer(
        SCENE, DT, positive=("young_modulus", "density"), free=("gravity",), **BDF
    )
    np.testing.assert_allclose(rod.scene.young_modulus, SCENE.young_modulus, rtol=1e-14)
    model = Model(eqx.nn.Linear(2, 3, dtype=float, key=jax.random.key(1)), rod)
    commands = jnp.stack([jnp.arange(STEPS) / STEPS - 3, jnp.full(STEPS, -1.0)], axis=1)

    @eqx.filter_jit
    @partial(eqx.filter_value_and_grad, has_aux=True)
    def loss(model):
        path = model(commands)
        return jnp.sum(path.tip_positions[-1] * jnp.array([1.0, 2.0, 3.0])), path

    (_, path), slope = loss(model)
    assert path.tip_positions.shape == (STEPS, 3) and path.result == 0
    assert not any(np.any(x) for x in jax.tree.leaves((slope.rod.untrained, slope.rod.dt)))
    cases = {
        "young_modulus": lambda m: m.rod.logarithms["young_modulus"],
        "density": lambda m: m.rod.logarithms["density"],
        "gravity": lambda m: m.rod.values["gravity"],
        "network": lambda m: m.gains.weight,
    }
    for name, pick in cases.items():
        d = 1e-4
        at = lambda x, pick=pick: loss(eqx.tree_at(pick, model, pick(model) + x))[0][0]
        difference = (8 * (at(d) - at(-d)) - (at(2 * d) - at(-2 * d))) / (12 * d)
        assert abs(difference) > 1e-6, name
        np.testing.assert_allclose(np.sum(pick(slope)), difference, rtol=1e-5, err_msg=name)


def test_the_environment_checks(recwarn):
    gymnasium = pytest.importorskip("gymnasium")
    from gymnasium.utils.env_checker import check_env

    kwargs = dict(scene=SCENE, dt=DT, max_steps=4, method=GRID)
    name = "softrod_jax.learning.environment:softrod/Reach-v0"
    environment = gymnasium.make(name, **kwargs).unwrapped
    check_env(environment)
    assert not recwarn.list, [str(w.message) for w in recwarn.list]

    def episode(seed):
        seen, info = environment.reset(seed=seed)
        rows, end = [seen], False
        environment.action_space.seed(seed)
        while not end:
            seen, reward, terminated, end, info = environment.step(
                environment.action_space.sample()
            )
            assert not terminated and reward == -info["distance"] / 0.1
            rows.append(seen)
        assert info["result"] == 0 and not info["failed"] and len(rows) == 5
        return np.array(rows)

    one, again, other = episode(3), episode(3), episode(4)
    np.testing.assert_array_equal(one, again)
    assert np.abs(one[0, 6:9] - other[0, 6:9]).max() > 1e-3  # the targets
    # The reward is highest at the target, and the target can be given.
    environment.reset(
        options={"target": environment.task.stepper.view(environment.task.fresh()).tip_position}
    )
    assert environment.step(-np.ones(4))[1] > -1e-6
    with pytest.raises(ValueError, match="three numbers"):
        environment.reset(options={"target": (1.0, 2.0)})
    with pytest.raises(ValueError, match="not finite"):
        environment.step(np.full(4, np.nan))


def test_an_environment_of_pulls():
    pytest.importorskip("gymnasium")
    from softrod_jax.learning.environment import ReachEnv

    environment = ReachEnv(PULLED, dt=DT, max_steps=3, method=GRID, pull_limit=2e-3)
    environment.reset(seed=0)
    for action in ([-1.0, -1.0, -1.0], [-1.0, 1.0, -1.0], [0.0, 0.0, -1.0]):
        _, _, _, _, info = environment.step(np.array(action))
        assert info["result"] == 0
    acts = environment._state.action
    np.testing.assert_allclose(acts.tensions, [0.1])
    np.testing.assert_allclose(acts.pulls, [1e-3, 0.0])
    assert acts.pressures is None
    with pytest.raises(ValueError, match="pull_limit=0"):
        ReachEnv(PULLED, pull_limit=0)


def test_an_episode_whose_solve_fails_is_truncated():
    pytest.importorskip("gymnasium")
    from softrod_jax.learning.environment import ReachEnv

    environment = ReachEnv(SCENE, dt=DT, tension_limit=9.0, method=GRID)
    environment.reset(seed=0, options={"target": (0.0, 0.0, 0.1)})
    ones = np.array([1.0, -1.0, -1.0, -1.0])
    for _ in range(20):
        seen, reward, terminated, truncated, info = environment.step(ones)
        assert np.all(np.isfinite(seen)) and np.isfinite(reward) and not terminated
        if truncated:
            break
    assert truncated and info["failed"] and info["result"] != 0
    assert info["message"] == sr.result_message(info["result"])
    _, info = environment.reset(seed=0, options={"target": (0.0, 0.0, 0.1)})
    assert info["result"] == 0
    assert not environment.step(-np.ones(4))[3]


def test_without_gymnasium_the_error_names_the_extra():
    program = (
        "import sys; sys.modules['gymnasium'] = None\n"
        "import softrod_jax.learning\n"
        "import softrod_jax.learning.environment\n"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert done.returncode != 0 and "softrod_jax[learning]" in done.stderr


def test_methods_are_functions_that_jit_takes():
    """One program for one stepper, another for one with other numbers."""
    stepper = Stepper(SCENE, DT, scheme=sr.SDIRK(2), method=GRID)
    action = Action(jnp.array([0.1, 0.0, 0.0]), jnp.zeros(1))
    state = stepper.reset()
    assert stepper.step == stepper.step and hash(stepper.step) == hash(stepper.step)
    other = Stepper(SCENE, 2 * DT, scheme=sr.SDIRK(2), method=GRID)
    assert stepper.step != other.step and stepper.step != stepper.view
    jax.jit(stepper.step).lower(state, action)
    ours, theirs = jax.jit(stepper.view)(state), stepper.view(state)
    np.testing.assert_allclose(ours.positions, theirs.positions, atol=1e-14)
