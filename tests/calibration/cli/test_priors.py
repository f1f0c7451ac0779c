"""Priors on the command line: of motions, and from another fit."""

import json

import pytest

from calibration.cli.common import UsageError, prior_in, priors_of
from calibration.cli.main import main


def found(**parameters):
    return {"parameters": parameters}


def estimate(value, low, high, known=True, recording=None):
    ends = {"value": value, "ci95": [low, high], "identifiable": known}
    return {**ends, "recording": recording}


def test_what_another_fit_found_is_known(tmp_path):
    content = found(
        young_modulus=estimate(2e5, 1.9e5, 2.1e5),
        density=estimate(900.0, None, None, known=False),
        bending_damping=estimate(1e-5, 0.9e-5, 1.1e-5, recording="one"),
        chamber_area=estimate([1e-4, 1e-4], [1e-5] * 2, [1e-3] * 2),
    )
    (tmp_path / "parameters.json").write_text(json.dumps(content), encoding="utf-8")
    assert priors_of(str(tmp_path)) == {"young_modulus": (2e5, pytest.approx(5e3))}
    assert priors_of(None) == {}


@pytest.mark.parametrize("content", ["[]", "{", '{"parameters": {"density": 3}}'])
def test_what_is_no_fit_is_told(tmp_path, content):
    (tmp_path / "parameters.json").write_text(content, encoding="utf-8")
    with pytest.raises(UsageError, match="is not what `softrod calibrate` writes"):
        priors_of(str(tmp_path))


def test_a_prior_is_a_mean_and_a_spread():
    assert prior_in("tendons[*].friction=0.2:0.05") == ("tendons[*].friction", (0.2, 0.05))
    with pytest.raises(UsageError, match="expected NAME=MEAN:SPREAD"):
        prior_in("density=1070")


@pytest.mark.parametrize(
    "words, message",
    [
        (["--prior", "density=1070"], "expected NAME=MEAN:SPREAD"),
        (["--folds", "3"], "--folds: for --postures only"),
        (["--draws", "7"], "--draws: of --posterior"),
        (["--postures", "x.csv", "--draws", "9"], "--draws: of --posterior"),
        (["--postures", "x.csv", "--one-frame"], "--one-frame: for motions only"),
        (["--postures", "x.csv", "--priors-from", "y"], "--priors-from: for motions only"),
    ],
)
def test_options_that_do_not_go_together(tmp_path, capsys, words, message):
    log = [] if "--postures" in words else [str(tmp_path / "log.csv")]
    scene = str(tmp_path / "robot.toml")
    assert main(["calibrate", scene, *log, *words, "--out", str(tmp_path / "out")]) == 2
    assert message in capsys.readouterr().err
