"""--verbose and SOFTROD_LOG: what is refined and tried, on stderr, for one command."""

# ruff: noqa: F811 - pytest knows fixtures by their names

import logging

import pytest
from command_line import in_a_directory_of_its_own, run  # noqa: F401

SOLVE = ("solve", "chamber.toml", "--intervals", "4", "--pressure", "1e4")
SAID = "softrod_jax.statics: equilibrium: successful, "


@pytest.fixture(autouse=True)
def unset(monkeypatch):
    monkeypatch.delenv("SOFTROD_LOG", raising=False)


@pytest.mark.parametrize(
    "words, variable, said",
    [
        (SOLVE, "", False),
        ((*SOLVE, "-v"), "", False),
        ((*SOLVE, "-vv"), "", True),
        (("-v", *SOLVE, "--verbose"), "", True),
        (("--verbose", "-v", *SOLVE), "", True),
        (SOLVE, "debug", True),
        (SOLVE, "INFO", False),
        ((*SOLVE, "-v"), "debug", False),
    ],
)
def test_as_much_is_said_as_is_asked_for(capsys, monkeypatch, words, variable, said):
    monkeypatch.setenv("SOFTROD_LOG", variable)
    status, out, err = run(capsys, *words)
    assert status == 0 and out.startswith('{"result": "successful"')
    assert (SAID in err) == said and (said or err == "")
    # Another command is not asked, and neither is whoever calls `main`.
    for name in ("softrod_jax", "calibration"):
        logger = logging.getLogger(name)
        assert [type(h) for h in logger.handlers] == [logging.NullHandler] and logger.level == 0


def test_reading_and_refining_are_told_by_one_v(capsys, tmp_path):
    log = "t_s,p1_Pa,tip_x_m,tip_y_m,tip_z_m\n0,0,0,0,0.1\n0.1,1e4,0,0,0.1\n"
    (tmp_path / "log.csv").write_text(log)
    step = ("--dt", "0.05", "--duration", "0.1", "--log", "log.csv")
    status, _, err = run(capsys, "simulate", "chamber.toml", *step, "-v", "--intervals", "4")
    assert status == 0
    assert "calibration.data.loading: reading log.csv\n" in err
    assert "softrod_jax.stepping.step_control: the motion once: successful, 2 substeps, 4" in err


def test_an_unknown_level_is_refused(capsys, monkeypatch):
    monkeypatch.setenv("SOFTROD_LOG", "loud")
    status, _, err = run(capsys, *SOLVE)
    assert status == 2
    assert err == "softrod: error: SOFTROD_LOG=loud: expected one of warning, info, debug\n"
