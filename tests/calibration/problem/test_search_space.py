"""What the coordinates of a search stand for, and which recordings it is given: no simulation."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest

import softrod_jax as sr
from calibration import Recording, RecordingError
from calibration.experiment.clock import Clock
from calibration.parameters.unknowns import choose_unknowns
from calibration.problem.dataset import datasets
from calibration.problem.space import SearchSpace
from calibration.search.settings import SearchOptions

NAMES = ("young_modulus", "bending_damping")
SCENE = sr.hybrid_robot()
TIMES = np.arange(40) / 50


def recording(name, **changes):
    tip = np.stack([0.01 * np.sin(20 * TIMES), 0 * TIMES, 0.1 + 0 * TIMES], axis=1)
    tensions = np.stack([TIMES, 0 * TIMES, 0 * TIMES], axis=1)
    whole = Recording(TIMES, tensions, np.zeros((40, 1)), tip, name=name)
    return replace(whole, **changes)


def space(time_offset=True):
    """Two recordings, of which the first drifts in its clock, and the second in its tip as well."""
    both = [recording("a"), recording("b")]
    _, parameters = choose_unknowns(SCENE, both, ["a", "b"], NAMES, NAMES[:1])
    first = Clock(0.0, 0.0, -0.1, 0.2, 0.01, 0.02, {"clock": 2}, 0.0, 0.8)
    second = replace(first, windows={"clock": 1, "tip": 2})
    return SearchSpace(parameters, [first, second], time_offset, {"clock": 2, "tip": 2}, 0.1)


@pytest.mark.parametrize("time_offset", [True, False])
def test_parameters_then_delays_then_drifts(time_offset):
    found = space(time_offset)
    n, m = 3, 2 * time_offset
    assert [u.label for u in found.parameters.items] == [
        "young_modulus@a", "young_modulus@b", "bending_damping",
    ]  # fmt: skip
    assert found.parameter_count == n and found.delays == slice(n, n + m)
    assert found.drifts == slice(n + m, n + m + 2 + 1 + 2 * 3)
    low, high = found.bounds
    assert len(low) == len(high) == len(found.origin()) == found.drifts.stop
    # In sample intervals.
    np.testing.assert_allclose(low[found.delays], -5.0)
    np.testing.assert_allclose(high[found.delays], 10.0)
    assert np.all(low[found.drifts] == -high[found.drifts])


def test_what_a_recording_does_not_have_stays_zero():
    found = space()
    nuisance = found.nuisance(np.ones(found.drifts.stop))
    np.testing.assert_allclose(nuisance["delay"], 0.02)
    assert nuisance["clock"].shape == (2, 2, 1) and nuisance["tip"].shape == (2, 2, 3)
    assert np.all(nuisance["clock"][0] > 0) and np.all(nuisance["tip"][0] == 0)
    # One window is twice as long as each of two, and believed to be off by twice as much.
    np.testing.assert_allclose(nuisance["clock"][1, :, 0], [2 * nuisance["clock"][0, 0, 0], 0.0])
    assert all(np.all(x == 0) for x in found.nuisance(found.origin()).values())


@pytest.mark.parametrize("time_offset", [True, False])
def test_the_chain_rule(time_offset):
    """Of residuals that are linear in what each recording's simulation takes."""
    found, random = space(time_offset), np.random.default_rng(0)
    by_parameter = random.normal(size=(2, 5, len(NAMES)))
    by_nuisance = {
        "delay": random.normal(size=(2, 5)),
        "clock": random.normal(size=(2, 5, 2, 1)),
        "tip": random.normal(size=(2, 5, 2, 3)),
    }

    def residuals(x):
        total = np.einsum("ksj,kj->ks", by_parameter, found.parameters.theta(x))
        for name, value in found.nuisance(x).items():
            total += np.einsum(
                "ksn,kn->ks", by_nuisance[name].reshape(2, 5, -1), value.reshape(2, -1)
            )
        return total

    J = found.derivatives(by_parameter, by_nuisance)
    assert J.shape == (2, 5, found.drifts.stop) and np.all(np.any(J != 0, axis=(0, 1)))
    for i, axis in enumerate(np.eye(found.drifts.stop)):
        np.testing.assert_allclose(J[..., i], residuals(axis) - residuals(0 * axis), atol=1e-12)


def test_recordings_are_told_apart_and_share_what_they_differ_in():
    scene = replace(SCENE, payload=sr.Payload(jnp.array(0.01)))
    heavy = recording("a", conditions={"payload_mass": 0.02})
    fitted, unseen = datasets(scene, [recording("a"), heavy], recording("a"), drift={"tip": 1.0})
    assert fitted.labels == ("a", "a-2") and unseen.labels == ("a-3",)
    assert fitted.conditions == unseen.conditions == {"payload_mass": 0.01}
    assert fitted.drift == {"tip": 1.0} and not unseen.drift
    twice = fitted.take([1, 0, 1])
    assert twice.labels == ("a-2", "a", "a-2") and twice.recordings[0] is heavy
    assert twice.selections[1] is fitted.selections[0] and twice.drift == fitted.drift


def test_what_is_kept_aside_is_checked_before_anything_is_simulated():
    with pytest.raises(ValueError, match="none given"):
        datasets(SCENE, [])
    late = recording("late", times=TIMES + 9)
    with pytest.raises(RecordingError, match="0 samples of the tip between 0 and 0.5"):
        datasets(SCENE, recording("a"), [late], window=(0.0, 0.5))


def test_usual_settings_of_a_search():
    few, many = SearchOptions().settings(3), SearchOptions().settings(1000)
    assert (few.optimiser, many.optimiser) == ("levenberg_marquardt", "adam")
    assert few.max_iterations < many.max_iterations
    assert SearchOptions("adam", max_iterations=7).settings(3).max_iterations == 7
    with pytest.raises(ValueError, match="max_iterations=0"):
        SearchOptions(max_iterations=0)
