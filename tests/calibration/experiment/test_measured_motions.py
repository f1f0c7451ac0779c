"""Measured besides the tip of a motion: tensions, the wrench at the base, curvatures."""

import json
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from beams import AS_FITTED, FIT, RATE, STEPS, TRUTH, beam

import softrod_jax as sr
from calibration import Recording, RecordingError, calibrate, load_recording
from calibration.data.quantities import quantities_in_motion
from calibration.experiment.alignment import Alignment
from calibration.experiment.quantities import aligned, apart, simulated, simulated_in_time
from calibration.experiment.setup import Setup
from calibration.report.numbers import as_json
from calibration.report.text import summary_text

NAMES = ("young_modulus", "bending_damping", "density")
KEYS = ("base_force", "middle_curvature", "middle_position", "tip_attitude")
NOISE = {"tip": 2e-4, "base_force": 0.02, "middle_curvature": 0.05}
NOISE |= {"middle_position": 1e-4, "tip_attitude": 0.01}
SIZE = {"tip_attitude": 0.005}  # of a quaternion's numbers


def rod(**values):
    return replace(beam(**values), markers=(sr.Marker("middle", 0.04),))


@pytest.fixture(scope="module")
def recording():
    """A release that a camera, a force plate under the clamp and a fibre grating see."""
    truth = rod()
    motion = sr.simulate(truth, 1 / RATE, None, steps=STEPS, **AS_FITTED)
    rng, others = np.random.default_rng(3), {}
    for key in KEYS:
        values = np.asarray(simulated_in_time(Setup(truth), motion, key))
        others[key] = values + SIZE.get(key, NOISE[key]) * rng.normal(size=values.shape)
    tip = np.asarray(motion.tip_positions)
    tip = tip + NOISE["tip"] * rng.normal(size=tip.shape)
    others["base_force"][5] = np.nan
    others["middle_curvature"][:, 2] = np.nan
    others["tip_attitude"][7] *= -1.0  # the same attitude
    times = np.arange(STEPS + 1) / RATE
    return Recording(times, None, None, tip, name="plate", others=others, noise=NOISE)


def fitted(recording, names=NAMES):
    start = replace(rod(young_modulus=2.4e5, bending_damping=9e-5), density=jnp.array(950.0))
    options = {"window": (-1.0, 1.0), "time_offset": False, "checks": False, "progress": False}
    return calibrate(start, [recording], fit=names, **options, **FIT)


def test_the_wrench_at_the_base_is_that_of_newton_and_of_the_equilibrium():
    """It changes the momentum, and begins as in the equilibrium in which a motion begins."""
    heavy = replace(rod(shear_damping=1.0), payload=sr.Payload(jnp.array(0.02)))
    start = sr.solve_static(heavy, method=sr.Collocation(4))
    turned = replace(heavy, gravity=jnp.array([-4.0, 0.0, -4.0]))
    dt = 2e-3
    motion = sr.simulate(turned, dt, steps=60, initial=start, method=sr.Collocation(4))
    first = np.asarray(motion.base_wrenches[0])
    np.testing.assert_allclose(first, start.wrenches[0], rtol=0, atol=1e-12)
    held = simulated(heavy, start, "middle_curvature")
    np.testing.assert_allclose(
        simulated_in_time(Setup(turned), motion, "middle_curvature")[0], held, atol=1e-12
    )
    velocity = jax.vmap(jax.vmap(_to_base))(motion.quaternions, motion.velocities[..., :3])
    line = 1070 * 0.03**2
    momentum = np.trapezoid(line * velocity, motion.arc_lengths, axis=1) + 0.02 * velocity[:, -1]
    weight = (line * 0.1 + 0.02) * np.asarray(turned.gravity)
    pushed = np.cumsum(dt * (weight - motion.base_wrenches[:, :3]), axis=0)
    # From the first steps, which jump, on; the trapezoid of five nodes is coarse.
    gained, given = momentum[-1] - momentum[20], pushed[-1] - pushed[20]
    np.testing.assert_allclose(gained, given, rtol=0.03, atol=0.03 * np.abs(given).max())


def _to_base(h, a):
    return a + 2 * jnp.cross(h[1:], jnp.cross(h[1:], a) + h[0] * a)


def test_a_force_plate_tells_the_scale_that_no_motion_shows(recording):
    found = fitted(recording)
    truth = {**TRUTH, "density": 1070.0}
    for name in NAMES:
        low, high = found.parameters[name].ci95
        assert low < truth[name] < high < 1.2 * low, (name, low, high)
    (told,) = found.recordings
    assert tuple(told.others) == KEYS
    for key, x in told.others.items():
        # What noise does to the length of a quaternion is no angle.
        size = 2 / np.sqrt(3) if key == "tip_attitude" else 1.0
        assert x.rms == pytest.approx(size * x.noise, rel=0.2)
    assert np.isnan(told.others["base_force"].measured[5]).all()
    assert "plate, base_force: 0.0" in summary_text(found)
    assert json.dumps(as_json(found)["others"]["plate"]["base_force"]["unit"]) == '"N"'
    # Without them the scale is anybody's guess.
    unknown = {**NOISE, **dict.fromkeys(KEYS, 1e6)}
    blind = fitted(replace(recording, noise=unknown))
    assert not blind.parameters["density"].identifiable


def test_what_is_stated_of_the_noise_weighs(recording):
    """A plate that is off by a half is believed, though the tip alone would contradict nothing."""
    off = {**recording.others, "base_force": 1.5 * recording.others["base_force"]}
    believed = fitted(replace(recording, others=off))
    assert believed.parameters["density"].value == pytest.approx(1.5 * 1070, rel=0.05)


def test_columns_of_a_log(recording, tmp_path):
    scene, log = rod(), tmp_path / "log.csv"
    names = [
        "t_s",
        *quantities_in_motion(scene)["base_force"].columns,
        "tip_x_m",
        "tip_y_m",
        "tip_z_m",
    ]
    names += ["middle_ux_per_m", "middle_uy_per_m", "base_force_noise_N", "tip_noise_m"]
    names[-2:-2] = quantities_in_motion(scene)["middle_position"].columns
    keys = KEYS[:3]
    force, curvature, middle = (recording.others[key] for key in keys)
    ones = np.ones((len(force), 1))
    table = [recording.times[:, None], force, recording.tip_positions, curvature[:, :2], middle]
    table = np.hstack([*table, NOISE["base_force"] * ones, NOISE["tip"] * ones])
    write = lambda header, rows=table: np.savetxt(
        log, rows, delimiter=",", header=",".join(header), comments="", fmt="%.17g"
    )
    write(names)
    read = load_recording(log, scene)
    for key in keys:
        np.testing.assert_array_equal(read.others[key], recording.others[key])
    assert read.noise == {"base_force": NOISE["base_force"], "tip": NOISE["tip"]}
    part = read.window(0.1, 0.2)
    np.testing.assert_array_equal(part.others["base_force"], force[10:21])
    write([*names[:-1], "tension1_N"])
    with pytest.raises(RecordingError, match="tension1_N"):
        load_recording(log, scene)
    bad = table.copy()
    bad[3, -1] = 1e-3
    write(names, bad)
    with pytest.raises(RecordingError, match="tip_noise_m: 0.0002 in the first row"):
        load_recording(log, scene)
    write([*names[:-2], names[1], names[-1]])
    with pytest.raises(RecordingError, match="is there twice"):
        load_recording(log, scene)
    wrong = replace(recording, others={"tension1": np.zeros((len(force), 1))})
    with pytest.raises(RecordingError, match="'tension1' is no measurement"):
        fitted(wrong)


def test_a_frame_that_is_turned_turns_markers():
    """To first order, as a rotation about where the tip began does."""
    rotation, offset = jnp.array([2e-4, -1e-4, 3e-4]), jnp.array([1e-3, 0.0, 2e-3])
    frame, start = Alignment(offset, rotation), jnp.array([0.0, 0.0, 0.1])
    place, turn = jnp.array([[0.03, 0.01, 0.05]]), jnp.array([[0.8, 0.0, 0.6, 0.0]])
    moved = aligned(place, "middle_position", frame, start)
    expected = place + offset + jnp.cross(rotation, place - start)
    np.testing.assert_allclose(moved, expected, atol=1e-12)
    turned = aligned(turn, "tip_attitude", frame, start)
    axis = jnp.array([0.0, 0.0, 1.0])
    seen, before = (_to_base(h[0] / jnp.linalg.norm(h[0]), axis) for h in (turned, turn))
    np.testing.assert_allclose(seen, before + jnp.cross(rotation, before), atol=1e-6)
    np.testing.assert_allclose(apart(turn, -turn, "tip_attitude"), 0.0)
    assert aligned(place, "base_force", frame, start) is place


def test_a_mapping_names_what_else_was_measured(recording, tmp_path):
    log, mapping = tmp_path / "lab.csv", tmp_path / "lab.map.toml"
    force, t = recording.others["base_force"], recording.times
    slow = np.where(np.arange(len(t)) % 2 == 0, t, np.nan)
    columns = [t, recording.tip_positions, 1e3 * force[:, [0, 2]] + 5.0, slow, np.arange(len(t))]
    table = np.column_stack(columns)
    names = "t,x,y,z,Fx mN,Fz mN,clock,u"
    np.savetxt(log, table, delimiter=",", header=names, comments="", fmt="%.17g")
    text = """[time]
column = "t"
[tip]
columns = ["x", "y", "z"]
[[measured]]
key = "base_force"
columns = ["Fx mN", "", "Fz mN"]
offset = -5.0
scale = 1e-3
noise = 0.03
[[measured]]
key = "middle_curvature"
columns = ["u", "", ""]
time = { column = "clock" }
"""
    mapping.write_text(text)
    read = load_recording(log, rod(), mapping=mapping)
    np.testing.assert_allclose(read.others["base_force"][:, [0, 2]], force[:, [0, 2]], atol=1e-12)
    assert np.isnan(read.others["base_force"][:, 1]).all() and read.noise == {"base_force": 0.03}
    # Of every other row; in between it is interpolated.
    seen = read.others["middle_curvature"][:, 0]
    np.testing.assert_allclose(seen, np.arange(len(t)), atol=1e-9)
    mapping.write_text(text.replace("base_force", "tension1"))
    with pytest.raises(RecordingError, match="key = 'tension1'.*one of base_force"):
        load_recording(log, rod(), mapping=mapping)
