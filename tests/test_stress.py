"""A few scenes of the stress test; all of them are in `benchmarks/stress.py`."""

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[1] / "benchmarks"))

import stress  # noqa: E402


@pytest.mark.long
@pytest.mark.parametrize(
    "kind, scenes", [("equilibrium", range(2, 42, 2)), ("motion", range(3, 43, 4))]
)
def test_solved_and_right(kind, scenes):
    rows = [stress.one((0, k)) for k in scenes]
    assert {row["kind"] for row in rows} == {kind}
    assert [row["scene"] for row in rows if not stress.is_solved(row)] == []
    assert [row["scene"] for row in rows if stress.is_wrong(row)] == []
    assert [row["scene"] for row in rows if not stress.is_confirmed(row)] == []
    assert max(row["error"] for row in rows) < stress.TOLERANCE


def test_a_wrong_answer_would_be_seen():
    row = {"result": "successful", "refined": "successful", "error": 0.02}
    assert stress.is_wrong(row) and not stress.is_wrong({**row, "error": 0.001})
    assert stress.is_remarkable(row | {"time": 0.0})
    assert not stress.is_solved({"result": "diverged"})


def test_scenes_depend_on_the_seed_alone():
    draw = lambda: stress.random_scene(np.random.default_rng([0, 3]), "motion")
    assert draw()[-1] == draw()[-1]
