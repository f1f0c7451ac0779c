"""A few scenes of the stress test; all of them are in `benchmarks/stress.py`."""

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[2] / "benchmarks"))

import stress  # noqa: E402
import stress_equilibria  # noqa: E402
import stress_motions  # noqa: E402
import stress_scenes  # noqa: E402

# Of one structure, so that few programs are compiled. A weight, a coil, a payload, a
# jump of the loads, one let go, and a moment that is tried with shorter steps.
MOTIONS = 6, 11, 13, 25, 42


@pytest.mark.long
def test_motions_are_right_and_their_estimates_honest():
    rows = [stress.one(("motion", 0, k, False)) for k in MOTIONS]
    assert {row["structure"] for row in rows} == {"circle"}
    assert [row["scene"] for row in rows if not np.isfinite(row["error"])] == []
    assert [row["scene"] for row in rows if not stress.is_solved(row)] == []
    assert [row["scene"] for row in rows if stress.is_wrong(row)] == []
    assert [row["scene"] for row in rows if stress.is_flattering(row)] == []
    assert max(row["error"] for row in rows if stress.is_solved(row)) < 2e-3


# Of one structure, so that few programs are compiled. Layers at the clamp, tip forces of 80 to 700,
# payloads of 130 and 370, moments with twist, coils of three turns; most need a finer grid.
EQUILIBRIA = 10, 31, 38, 53, 74, 87, 90, 101, 119, 166, 174, 199


@pytest.mark.long
def test_equilibria_are_right_and_their_estimates_honest():
    rows = [stress_equilibria.one(0, k, judged=True) for k in EQUILIBRIA]
    assert {row["structure"] for row in rows} == {"circle"}
    assert len({row["kind"] for row in rows}) == 6
    assert [row["scene"] for row in rows if row["judge"] == "none"] == []
    assert max(row["judge_error"] for row in rows) < 1e-8
    assert [row["scene"] for row in rows if not stress.is_solved(row)] == []
    assert max(row["error"] for row in rows) < 2e-4
    for of in ("", "grid_"):
        assert [row["scene"] for row in rows if stress_equilibria.is_wrong(row, of)] == []
        assert [row["scene"] for row in rows if stress_equilibria.is_flattering(row, of)] == []
    assert max(row["intervals"] for row in rows) > 12 == min(row["intervals"] for row in rows)


def test_a_wrong_answer_would_be_seen():
    row = {"what": "motion", "result": "successful", "estimate": 0.02, "error": 0.02, "known": 1e-3}
    assert stress.is_wrong(row) and not stress.is_wrong({**row, "error": 0.001})
    assert not stress.is_wrong({**row, "known": 0.011})  # as far as the refined run can tell
    assert not stress.is_wrong({**row, "error": np.nan, "known": np.nan})
    assert stress.is_remarkable(row | {"time": 0.0})
    assert not stress.is_solved({"result": "diverged"})
    row = {"what": "equilibrium", "result": "successful", "estimate": 0.01, "error": 0.02}
    assert stress.is_wrong(row) and not stress.is_wrong({**row, "error": 0.001})
    assert stress.is_wrong({**row, "error": np.nan})  # near no equilibrium at all
    assert not stress.is_wrong({**row, "result": "inaccurate"})


def test_an_estimate_that_flatters_would_be_seen():
    row = {"estimate": 1e-5, "error": 4e-5}
    assert stress_equilibria.is_flattering(row)
    assert not stress_equilibria.is_flattering({**row, "estimate": 2e-5})
    assert not stress_equilibria.is_flattering({**row, "error": 9e-6, "estimate": 0.0})
    assert stress_equilibria.is_flattering({**row, "estimate": np.nan})
    row |= {"what": "motion", "known": 1e-6}
    assert stress.is_flattering(row) and stress.is_flattering({**row, "estimate": np.nan})
    assert not stress.is_flattering({**row, "known": 2e-5})
    assert not stress.is_flattering({**row, "error": 9e-6, "estimate": 0.0})


def test_scenes_depend_on_the_seed_alone():
    draw = lambda: stress_motions.random_motion(np.random.default_rng([0, 3]))
    assert draw()[-1] == draw()[-1]
    draw = lambda: stress_scenes.random_equilibrium(np.random.default_rng([0, 3]))
    assert draw()[-1] == draw()[-1]
