"""Which postures to record: chosen ones against all other choices, and closed forms."""

import csv
import itertools
import json
from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest

import softrod_jax as sr
from calibration import RecordingError
from calibration.postures.data import Postures, load_candidates
from calibration.postures.design import (
    badness,
    chosen_rows,
    design_postures,
    information,
    standard_errors,
)
from calibration.postures.fitting import calibrate_postures
from softrod_jax.scene.inputs import Inputs

GRID = sr.Collocation(intervals=6)
FIT = ("young_modulus", "density")
TENSIONS = np.random.default_rng(3).uniform(size=(12, 2)) ** 2


def robot(friction=None):
    """One segment that hangs, and two tendons."""
    return sr.Scene(
        length=0.1,
        section=sr.Circle(6e-3),
        young_modulus=jnp.array(2e5),
        poisson_ratio=0.45,
        density=jnp.array(1070.0),
        gravity=jnp.array([-9.81, 0.0, 0.0]),
        tendons=sr.Tendons(
            5e-3 * np.array([[1.0, 0.0], [0.0, 1.0]]),
            friction=None if friction is None else (friction,) * 2,
        ),
        markers=(sr.Marker("middle", 0.05, jnp.array([0.0, 8e-3, 0.0])),),
    )


def candidates(tensions=TENSIONS, trials=()):
    nothing = np.zeros((len(tensions), 3))
    positions = {"tip": nothing, "middle": nothing}
    return Postures(Inputs(tensions=tensions), positions, trials=trials)


def test_the_best_choice_of_all_is_found():
    told = information(robot(), candidates(), FIT, method=GRID)
    choices = np.array(list(itertools.combinations(range(12), 4)))
    together = told.start + told.each[choices].sum(1)
    for criterion, which in (("D", [0, 1]), ("A", [0, 1]), ("D", [1])):
        design = design_postures(
            robot(), candidates(), fit=FIT, count=4, criterion=criterion,
            shrink=[FIT[i] for i in which], method=GRID,
        )  # fmt: skip
        of_all = badness(together, which, criterion)
        own = badness(told.start + told.each[design.rows].sum(0), which, criterion)
        assert np.mean(of_all > own - 1e-12) >= 0.99, (criterion, which)


def test_intervals_are_those_of_a_fit():
    scene = robot()
    solve = lambda T: sr.solve_static(scene, tensions=T, method=GRID, throw=False).markers
    seen = sr.spread(solve)(jnp.asarray(TENSIONS))
    exact = {k: np.asarray(seen[k].position) for k in ("middle", "tip")}
    design = design_postures(scene, candidates(), fit=FIT, count=12, noise_scale=0.3, method=GRID)
    rng, noise = np.random.default_rng(1), 3e-4
    made = {k: x + noise * rng.normal(size=x.shape) for k, x in exact.items()}
    fit = calibrate_postures(scene, replace(candidates(), positions=made), fit=FIT, method=GRID)
    for name in FIT:
        half = np.log(fit.parameters[name].ci95[1] / fit.parameters[name].value)
        assert design.half_widths[name] == pytest.approx(half, rel=0.2)
        low, high = design.intervals[name]
        assert np.sqrt(low * high) == pytest.approx(float(getattr(scene, name)))
    assert design.half_widths == pytest.approx(design.all_rows)


def test_what_is_known_counts():
    own = candidates()
    once = design_postures(robot(), own, fit=FIT, count=3, method=GRID)
    rows = once.rows.tolist()
    more = design_postures(robot(), own, fit=FIT, count=2, known=rows, method=GRID)
    assert not set(rows) & set(more.rows.tolist())
    apart = design_postures(
        robot(), own, fit=FIT, count=2, recorded=own.take(once.rows), method=GRID
    )
    for name in FIT:
        assert more.before[name] == pytest.approx(once.half_widths[name])
        assert apart.before[name] == pytest.approx(once.half_widths[name])
        assert more.half_widths[name] < once.half_widths[name]
    sure = {"density": (1070.0, 1.07)}
    priors = design_postures(robot(), own, fit=FIT, count=3, priors=sure, method=GRID)
    assert priors.half_widths["density"] < 1.96e-3


@pytest.mark.long
def test_where_tendons_rub_whole_trials_are_chosen():
    trials = tuple("aabbcc")
    tensions = np.array([[0.1, 0], [0.2, 0], [0.9, 0], [0.3, 0], [0.05, 0], [0.06, 0]])
    fit, scene, coarse = ("young_modulus", "tendon_friction"), robot(friction=0.2), 2
    options = {"fit": fit, "method": sr.Collocation(coarse)}
    own = candidates(tensions, trials)
    design = design_postures(scene, own, count=1, **options)
    # Each trial by itself, in a log of its own, three times.
    rows = {x: [k for k in range(6) if trials[k] == x] for x in "abc"}
    thrice = lambda x: candidates(np.tile(tensions[rows[x]], (3, 1)), trials)
    alone = {x: information(scene, thrice(x), **options) for x in "abc"}
    best = min(alone, key=lambda x: badness(alone[x].start + alone[x].each[0], [0, 1]))
    assert design.trials == (best,) and design.rows.tolist() == rows[best]
    with pytest.raises(ValueError, match="say with a column `trial`"):
        design_postures(scene, candidates(tensions), count=1, **options)


def test_closed_forms():
    one = np.eye(2)[None] * np.arange(1.0, 6.0)[:, None, None]
    H = np.array([[4.0, 2.0], [2.0, 3.0]])
    np.testing.assert_allclose(standard_errors(H), np.sqrt([3 / 8, 4 / 8]))
    np.testing.assert_allclose(badness(H, [0, 1]), -np.log(8.0))
    np.testing.assert_allclose(badness(H, [0]), np.log(3 / 8))
    np.testing.assert_allclose(badness(H, [0, 1], "A"), np.log(7 / 8))
    # What is sharp in one direction alone is exchanged for a pair that is good together.
    sharp = np.array([np.diag([9.0, 0.0]), np.diag([8.0, 0.0]), np.diag([3.0, 3.0]), 2 * np.eye(2)])
    assert set(chosen_rows(sharp, [0, 1, 2, 3], 2, 1e-6 * np.eye(2))) == {0, 2}
    assert set(chosen_rows(one, [*range(5)], 2, 1e-9 * np.eye(2))) == {3, 4}


@pytest.mark.parametrize(
    "change, message",
    [
        ({"count": 13}, "12 rows can be chosen"),
        ({"shrink": "poisson_ratio"}, "is not fitted; add it to fit"),
        ({"criterion": "E"}, "expected one of D, A"),
        ({"noise_scale": 0.0}, "a number above 0 is needed"),
        ({"known": [*range(12)]}, "0 rows can be chosen"),
    ],
)
def test_what_cannot_be_designed_is_told(change, message):
    with pytest.raises(ValueError, match=message):
        design_postures(
            robot(), candidates(), **({"fit": FIT, "count": 2, "method": GRID} | change)
        )


def table(path, tensions):
    rows = [",".join(map(repr, row)) for row in tensions.tolist()]
    path.write_text("\n".join(["tau1_N,tau2_N", *rows]), encoding="utf-8")
    return path


def test_the_command_line_chooses_rows(tmp_path, capsys):
    from calibration.cli.main import main

    scene, inputs = tmp_path / "robot.toml", table(tmp_path / "inputs.csv", TENSIONS)
    sr.save_scene(robot(), scene)
    out = tmp_path / "chosen.csv"
    words = ["design", str(scene), str(inputs), "--fit", ",".join(FIT), "--count", "3"]
    words += ["--intervals", "6"]
    assert main([*words, "--out", str(out), "--json", "--noise", "2e-3"]) == 0
    told = json.loads(capsys.readouterr().out)
    own = design_postures(robot(), candidates(), fit=FIT, count=3, noise_scale=2.0, method=GRID)
    assert told["rows"] == (own.rows + 1).tolist()
    for name in FIT:
        low, high = told["parameters"][name]["expected_ci95"]
        assert np.log(high / low) == pytest.approx(2 * own.half_widths[name])
    with out.open(encoding="utf-8") as file:
        chosen = [[float(x) for x in row.values()] for row in csv.DictReader(file)]
    np.testing.assert_array_equal(chosen, TENSIONS[np.sort(own.rows)])
    before = tmp_path / "fit"
    before.mkdir()
    (before / "parameters.json").write_text('{"noise_scale": 2.0}', encoding="utf-8")
    assert main([*words, "--noise-from", str(before), "--markers", "tip"]) == 0
    assert "times as wide as with all candidates" in capsys.readouterr().out
    (before / "parameters.json").write_text("[]", encoding="utf-8")
    assert main([*words, "--noise-from", str(before)]) == 2
    assert "is not what `softrod calibrate --postures` writes" in capsys.readouterr().err


def test_candidates_need_no_measurements(tmp_path):
    path = table(tmp_path / "inputs.csv", TENSIONS)
    own = load_candidates(path, robot())
    assert set(own.positions) == {"tip", "middle"} and own.rows == 12
    assert set(load_candidates(path, robot(), ["tip"]).positions) == {"tip"}
    with pytest.raises(RecordingError, match="has no marker 'top'"):
        load_candidates(path, robot(), ["top"])
