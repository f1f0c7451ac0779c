"""What lies between command and robot: a lag of first order, and thrust that outgrows pressure."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from beams import AS_FITTED, FIT

import softrod_jax as sr
from calibration import Recording, RecordingError, calibrate, load_recording
from calibration.experiment.setup import BAR, Setup, lagged
from calibration.parameters.catalogue import catalogue
from softrod_jax.scene.inputs import Inputs
from softrod_jax.scene.scene import as_arrays

LAG, GAINS, DT = 0.06, (1.5, 2.0), 0.01


def segment(**parts):
    """A silicone segment that hangs, with one chamber beside its axis."""
    known = {"young_modulus": 2e5, "damping_time": 5e-3, **parts}
    return as_arrays(
        sr.Scene(
            length=0.1,
            section=sr.Circle(0.015),
            poisson_ratio=0.45,
            density=1070.0,
            gravity=jnp.array([0.0, 0.0, 9.81]),
            chambers=sr.Chambers(np.array([1e-4]), np.array([[8e-3, 0.0]])),
            **known,
        )
    )


def test_a_lag_is_that_of_the_first_order():
    """The mean over each step of the exact answer to a step of the command, and its slope."""
    command = jnp.array([[0.0], [0.0], [3.0], [3.0], [3.0], [1.0]])
    own = np.asarray(lagged(command, jnp.array(LAG), jnp.array(DT)))[:, 0]
    fine = 20000
    u = np.repeat(np.asarray(command)[1:, 0], fine)
    y, now = np.zeros_like(u), 0.0
    for k, x in enumerate(u):
        new = now + (x - now) * (DT / fine) / LAG
        y[k], now = (now + new) / 2, new
    np.testing.assert_allclose(own[1:], y.reshape(-1, fine).mean(1), atol=1e-5)
    assert own[0] == 0.0
    # A lag that is next to none lets the command through, and a held one stays.
    np.testing.assert_allclose(lagged(command, jnp.array(1e-9), jnp.array(DT)), command, atol=1e-6)
    held = jnp.full((4, 2), 2.0)
    np.testing.assert_allclose(lagged(held, jnp.array(LAG), jnp.array(DT)), held)
    end = lambda lag: lagged(command, lag, jnp.array(DT))[-1, 0]
    here = jnp.array(LAG)
    forward, reverse = jax.jacfwd(end)(here), jax.jacrev(end)(here)
    difference = (end(here + 1e-5) - end(here - 1e-5)) / 2e-5
    np.testing.assert_allclose([forward, reverse], difference, rtol=1e-6)


def test_thrust_grows_with_pressure():
    setup = Setup(segment(), pressure_gain=jnp.array(GAINS))
    p = np.array([0.0, 0.1, 0.3]) * BAR
    arriving = setup.arriving(Inputs(pressures=p)).pressures
    x = p / BAR
    np.testing.assert_allclose(arriving, p * (1 + 1.5 * x + 2.0 * x**2))


def test_scenes_have_the_lags_of_what_drives_them():
    names = lambda scene: {n for n in catalogue(scene)[0] if n.endswith("_lag") or "_gain" in n}
    assert names(segment()) == {"pressure_lag", "pressure_gain_1", "pressure_gain_2"}
    tendons = sr.Tendons(np.array([[4e-3, 0.0], [0.0, 4e-3]]), control=("tension", "length"))
    both = replace(segment(), chambers=None, tendons=tendons)
    assert {"tension_lag", "pull_lag"} <= names(both)


@pytest.mark.long
def test_lag_and_gain_of_steps_are_recovered():
    steps, method = 32, FIT["method"]
    recordings = []
    for k, pressure in enumerate((1e4, 3e4)):
        p = np.zeros((steps + 1, 1))
        p[6:22] = pressure
        setup = Setup(segment(), pressure_lag=jnp.array(LAG), pressure_gain=jnp.array(GAINS))
        arriving = setup.arriving_in_time(Inputs(pressures=jnp.asarray(p)), jnp.array(DT))
        # Row 0 is what is held at the beginning: of a log that of time 0.
        start = sr.solve_static(setup.scene, pressures=(0.0,), method=method)
        motion = sr.simulate(
            setup.scene, DT, pressures=arriving.pressures[1:], initial=start, **AS_FITTED
        )
        tip = np.asarray(motion.tip_positions)
        tip = tip + 5e-5 * np.random.default_rng(k).normal(size=tip.shape)
        recordings.append(Recording(DT * np.arange(steps + 1), None, p, tip, name=f"{k}"))
    fit = calibrate(
        segment(), recordings, fit=("pressure_lag", "pressure_gain"),
        time_offset=False, checks=False, progress=False, window=(0.0, 1.0), **FIT,
    )  # fmt: skip
    names = ("pressure_lag", "pressure_gain_1", "pressure_gain_2")
    for name, value in zip(names, (LAG, *GAINS)):
        low, high = fit.parameters[name].ci95
        assert low <= value <= high, (name, low, value, high)
    assert fit.parameters["pressure_lag"].value == pytest.approx(LAG, rel=0.05)
    assert max(fit.rmse_m.values()) == pytest.approx(5e-5 * np.sqrt(3), rel=0.2)


def test_a_command_that_was_not_recorded_is_in_the_mapping(tmp_path):
    path, mapping = tmp_path / "log.csv", tmp_path / "log.map.toml"
    rows = [f"{0.01 * k},0.0,0.0,0.1" for k in range(30)]
    path.write_text("\n".join(["t,x,y,z", *rows]), encoding="utf-8")
    start = "[time]\ncolumn = 't'\n[tip]\ncolumns = ['x', 'y', 'z']\n[[pressures]]\n"
    text = start + "steps = [[0.1, 20.0], [0.2, 0.0]]\nunit = 'kPa'\n"
    mapping.write_text(text, encoding="utf-8")
    pressures = load_recording(path, segment(), mapping=mapping).pressures[:, 0]
    times = 0.01 * np.arange(30)
    on = (times > 0.1 - 1e-9) & (times < 0.2 - 1e-9)
    np.testing.assert_allclose(pressures, np.where(on, 2e4, 0.0))
    for wrong, message in (
        ("steps = [[0.2, 1.0], [0.1, 0.0]]", "times increasing"),
        ("steps = []", "times increasing"),
        ("steps = [[0.1, 1.0]]\ncolumn = 'x'", "one of them is too much"),
    ):
        mapping.write_text(start + wrong, encoding="utf-8")
        with pytest.raises(RecordingError, match=message):
            load_recording(path, segment(), mapping=mapping)
