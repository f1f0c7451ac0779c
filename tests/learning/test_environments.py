"""Many environments at once are one after the other; pictures of one."""

import numpy as np
import pytest

import softrod_jax as sr

gymnasium = pytest.importorskip("gymnasium")

from softrod_jax.learning.environment import ReachEnv  # noqa: E402
from softrod_jax.learning.vector_environment import ReachVectorEnv  # noqa: E402

NAME = "softrod_jax.learning.environment:softrod/Reach-v0"
ROBOT = sr.hybrid_robot()
SCENE = sr.Scene(
    **{
        name: getattr(ROBOT, name)
        for name in ("length", "section", "young_modulus", "poisson_ratio", "density", "tendons")
    },
    bending_damping=2e-5,
)
SETTINGS = dict(dt=0.01, max_steps=3, method=sr.Collocation(4))
TARGETS = np.array([[0.02, 0.0, 0.09], [0.0, 0.03, 0.08]])


def test_many_are_one_after_the_other():
    """Through the end of their episodes: the step after it begins the next one."""
    many = ReachVectorEnv(2, SCENE, **SETTINGS)
    one = ReachEnv(SCENE, **SETTINGS)
    actions = np.random.default_rng(0).uniform(-1, 1, (3, 2, 3))
    seen, info = many.reset(seed=1, options={"targets": TARGETS})
    assert seen.shape == (2, 12) and many.observation_space.contains(seen)
    rows = [many.step(row) for row in actions]
    for k, target in enumerate(TARGETS):
        first, at_first = one.reset(options={"target": target})
        np.testing.assert_array_equal(seen[k], first)
        assert info["distance"][k] == pytest.approx(at_first["distance"])
        for row, action in zip(rows, actions[:, k], strict=True):
            alone = one.step(action)
            np.testing.assert_allclose(row[0][k], alone[0], atol=1e-6)
            np.testing.assert_allclose(row[1][k], alone[1], rtol=1e-9)
            assert row[2][k] == alone[2] and row[3][k] == alone[3]
            assert row[4]["result"][k] == alone[4]["result"] == 0
    assert rows[-1][3].tolist() == [True, True]
    renewed, reward, _, ended, _ = many.step(actions[0])
    assert reward.tolist() == [0, 0] and not np.any(ended)
    np.testing.assert_allclose(renewed[:, :6], seen[:, :6], atol=1e-7)
    assert np.abs(renewed[:, 6:9] - seen[:, 6:9]).min(axis=1).max() > 1e-4  # other targets


def test_by_name_and_seeded():
    kwargs = dict(scene=SCENE, **SETTINGS)
    many = gymnasium.make_vec(NAME, 3, vectorization_mode="vector_entry_point", **kwargs)
    first, again = many.reset(seed=5)[0], many.reset(seed=5)[0]
    np.testing.assert_array_equal(first, again)
    assert np.abs(first - many.reset(seed=6)[0]).max() > 1e-3
    many.action_space.seed(0)
    for _ in range(5):
        seen, reward, terminated, truncated, info = many.step(many.action_space.sample())
        assert many.observation_space.contains(seen) and np.all(reward <= 0)
        assert not np.any(terminated | info["failed"])


def test_gymnasium_tells_its_episodes_apart():
    """The step in which an episode begins anew belongs to none."""
    wrapper = pytest.importorskip("gymnasium.wrappers.vector").RecordEpisodeStatistics
    recorded = wrapper(ReachVectorEnv(2, SCENE, **SETTINGS))
    recorded.reset(options={"targets": TARGETS})
    rewards = np.array([recorded.step(np.zeros((2, 3), np.float32))[1] for _ in range(8)])
    assert np.all(rewards[[3, 7]] == 0)
    returns = np.reshape(recorded.return_queue, (2, 2))
    np.testing.assert_allclose(returns, [rewards[:3].sum(0), rewards[4:7].sum(0)], rtol=1e-6)
    assert list(recorded.length_queue) == [3] * 4


def test_one_that_fails_begins_anew_and_spoils_no_other():
    many = ReachVectorEnv(2, SCENE, tension_limit=3.0, **{**SETTINGS, "max_steps": 40})
    many.reset(seed=0, options={"targets": TARGETS})
    actions = np.array([[1.0, -1.0, -1.0], [-1.0, -1.0, -1.0]])
    for _ in range(40):
        seen, _, _, ended, info = many.step(actions)
        assert np.all(np.isfinite(seen)) and not info["failed"][1]
        if ended[0]:
            break
    assert info["failed"].tolist() == [True, False]
    _, _, _, ended, info = many.step(-np.ones((2, 3)))
    assert not np.any(ended) and info["result"].tolist() == [0, 0]


def test_pictures():
    pytest.importorskip("matplotlib")
    one = ReachEnv(SCENE, render_mode="rgb_array", **SETTINGS)
    one.reset(options={"target": TARGETS[0]})
    before = one.render()
    for _ in range(3):
        one.step(np.array([1.0, -1.0, -1.0]))
    after = one.render()
    assert before.shape == after.shape == (320, 320, 3) and before.dtype == np.uint8
    # The rod has moved, in axes that have not.
    changed = np.any(before != after, axis=-1)
    assert 20 < changed.sum() < 0.1 * changed.size


def test_bad_input():
    with pytest.raises(ValueError, match="num_envs=0"):
        ReachVectorEnv(0)
    with pytest.raises(ValueError, match="render_mode='human'"):
        ReachEnv(SCENE, render_mode="human")
    many = ReachVectorEnv(2, SCENE, **SETTINGS)
    with pytest.raises(gymnasium.error.ResetNeeded):
        many.step(np.zeros((2, 3)))
    with pytest.raises(ValueError, match="targets need shape"):
        many.reset(options={"targets": TARGETS[:1]})
    many.reset(options={"targets": TARGETS})
    with pytest.raises(ValueError, match=r"shape \(3,\); \(2, 3\) is needed"):
        many.step(np.zeros(3))
    with pytest.raises(ValueError, match="not finite"):
        many.step(np.full((2, 3), np.nan))
