"""What a fit can be told: whose parameters, bounds, outliers, starts, profiles, checkpoints."""

import json
from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest
from beams import FIT, NOISE, RATE, RELEASE, TRUTH, beam, release

import softrod_jax as sr
from calibration import RecordingError, calibrate
from calibration.data.windows import split
from calibration.problem.motion import simulate_motion
from calibration.report.numbers import as_json
from calibration.report.spectra import amplitudes
from calibration.report.writing import write_report
from calibration.search.checkpoint import CheckpointError
from calibration.search.optimise import MANY, gradient_descent, levenberg_marquardt, usual

ALL = (0.0, 1.0)
NAMES = ("young_modulus", "bending_damping")


def fit(recordings, scene=None, **options):
    plain = {"fit": NAMES, "checks": False, "window": ALL, "progress": False, **FIT}
    scene = beam(young_modulus=2.3e5, bending_damping=1e-4) if scene is None else scene
    return calibrate(scene, recordings, **{**plain, **options})


@pytest.fixture(scope="module")
def recording():
    return release(beam())


@pytest.fixture(scope="module")
def plain(recording):
    return fit([recording], starts=20, profiles=NAMES[:1])


def near(found, name, truth, widths=2.0):
    low, high = found.parameters[name].ci95
    middle, half = (low + high) / 2, (high - low) / 2
    return abs(truth - middle) < widths * half


def test_starts_end_in_the_same_place(plain):
    """From a decade around the scene's values on either side."""
    initial = np.array([s.initial["young_modulus"] for s in plain.starts])
    assert len(initial) == 20 and np.max(initial) / np.min(initial) > 10
    same = [s for s in plain.starts if s.rms < 1.001 * plain.starts[0].rms]
    assert len(same) >= 19
    for name, truth in TRUTH.items():
        assert near(plain, name, truth)
        assert all(s.values[name] == pytest.approx(same[0].values[name], rel=0.01) for s in same)


def test_a_profile_crosses_one_at_the_ends_of_the_interval(plain):
    profile = plain.profiles["young_modulus"]
    assert np.all(np.diff(profile.values) > 0)
    assert np.min(profile.excess) == pytest.approx(0, abs=1e-3)
    low, high = plain.parameters["young_modulus"].ci95
    at_ends = np.interp([low, high], profile.values, profile.excess)
    np.testing.assert_allclose(at_ends, 1.0, rtol=0.25)


def test_outliers_hardly_move_a_robust_fit(recording, plain):
    tip = recording.tip_positions.copy()
    tip[[9, 16, 23, 30]] += [0.02, -0.01, 0.0]
    spoiled = replace(recording, tip_positions=tip)
    truth = plain.parameters["young_modulus"]
    half = (truth.ci95[1] - truth.ci95[0]) / 2
    squares = fit([spoiled]).parameters["young_modulus"].value
    robust = fit([spoiled], loss="tukey")
    assert abs(robust.parameters["young_modulus"].value - truth.value) < half
    assert abs(squares - truth.value) > 2 * half
    weights = robust.recordings[0].weights
    assert np.all(weights[[9, 16, 23, 30], 0] == 0)
    assert np.mean(weights > 0.5) > 0.8
    assert any("4 of" in r and "outliers" in r for r in as_json(robust)["remarks"])


def test_bounds_hold(recording):
    found = fit([recording], bounds={"young_modulus": (1e5, 2.5e5)})
    estimate = found.parameters["young_modulus"]
    assert estimate.value == pytest.approx(2.5e5, rel=1e-6)


@pytest.fixture(scope="module")
def three(recording):
    """Recordings of different lengths, of two rods."""
    softer = beam(young_modulus=2.4e5)
    short = release(softer, seed=2, name="short").window(0.0, 0.28)
    return [recording, release(softer, seed=1, name="softer"), short]


@pytest.fixture(scope="module")
def each(three):
    """Their fit, with a modulus for each; and how often the simulation was traced."""
    traced = []

    def counted(*args):
        traced.append(args)
        return simulate_motion(*args)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("calibration.problem.evaluation.simulate_motion", counted)
        found = fit(three, per_recording=NAMES[:1], held_out=three[:1])
    return found, len(traced)


def test_each_recording_may_have_its_own(each):
    found, _ = each
    own = [f"young_modulus@{name}" for name in ("release", "softer", "short")]
    assert list(found.parameters) == [*own, "bending_damping"]
    for name, truth in zip(own, (2.9e5, 2.4e5, 2.4e5), strict=True):
        assert near(found, name, truth)
    assert found.parameters[own[1]].recording == "softer"


def test_all_recordings_run_through_one_program(each):
    found, traced = each
    assert found.evaluations > 5 and len(found.held_out) == 1
    assert traced == 1


def test_reverse_mode_goes_the_same_way(three, each, monkeypatch):
    """Gradient descent by what recordings share, what each has for itself, and their clocks."""
    options = dict(per_recording=NAMES[:1], optimiser="adam", max_iterations=12)
    forward = fit(three, **options)
    monkeypatch.setattr("calibration.problem.evaluation._TANGENTS_A_SWEEP", 1)
    directions = []

    def noted(problem, *args):
        directions.append(problem.reverse)
        return gradient_descent(problem, *args)

    monkeypatch.setattr("calibration.search.optimise.OPTIMISERS", {"adam": (noted, 12)})
    reverse = fit(three, **options)
    assert directions and all(directions)
    assert reverse.evaluations == forward.evaluations > 12
    assert reverse.history[-1]["rms_m"] < 0.9 * reverse.history[0]["rms_m"]
    for a, b in zip(reverse.history, forward.history, strict=True):
        assert a["rms_m"] == pytest.approx(b["rms_m"], rel=1e-7), a["stage"]
    for name, estimate in reverse.parameters.items():
        assert estimate.value == pytest.approx(forward.parameters[name].value, rel=1e-7)
        np.testing.assert_allclose(estimate.ci95, forward.parameters[name].ci95, rtol=1e-5)


def test_held_out_recordings_are_predicted(recording):
    others = [release(beam(), seed=5, name="same"), release(beam(young_modulus=2e5), name="other")]
    found = fit([recording], held_out=others)
    same, other = found.held_out
    assert same.rmse == pytest.approx(NOISE * np.sqrt(3), rel=0.2)
    assert same.time_offset == pytest.approx(RELEASE, abs=2e-3)
    assert other.rmse > 2 * same.rmse
    assert any("other, which was kept aside" in r for r in as_json(found)["remarks"])


def test_conditions_of_a_recording_are_its_own():
    heavy = beam(payload=sr.Payload(jnp.array(0.05)))
    recordings = [
        release(beam(), name="bare", conditions={"payload_mass": 0.0}),
        release(heavy, seed=1, name="heavy", conditions={"payload_mass": 0.04}),
    ]
    found = fit(recordings, fit=(*NAMES, "payload_mass"))
    # The bare one has no payload to be scaled.
    assert list(found.parameters) == [*NAMES, "payload_mass@heavy"]
    assert near(found, "payload_mass@heavy", 0.05)
    assert near(found, "young_modulus", TRUTH["young_modulus"])


def test_another_weight_is_predicted(recording):
    """Fitted without a weight, kept aside with one: of the weight only its mass is told."""
    scene = beam(payload=sr.Payload(jnp.array(0.05)))
    heavy = release(scene, seed=1, name="heavy", conditions={"payload_mass": 0.05})
    found = fit([recording], held_out=[heavy])
    assert found.held_out[0].rmse == pytest.approx(NOISE * np.sqrt(3), rel=0.2)
    with pytest.raises(RecordingError, match="heavy: condition 'weight' is unknown"):
        fit([recording], held_out=[replace(heavy, conditions={"weight": 0.05})])


@pytest.mark.parametrize(
    "conditions, words",
    [
        ({"weight": 1.0}, "condition 'weight' is unknown"),
        ({"payload_mass": np.nan}, "finite"),
        ({"payload_mass": -1.0}, "at least 0"),
        ({"tendon_offset": 1.0}, "unknown|none"),
    ],
)
def test_bad_conditions(recording, conditions, words):
    with pytest.raises(RecordingError, match=words):
        fit([replace(recording, conditions=conditions)])


@pytest.mark.parametrize(
    "options, words",
    [
        ({"per_recording": ("density",)}, "per_recording: 'density' is not fitted"),
        ({"bounds": {"density": (1, 2)}}, "bounds: 'density' is not fitted"),
        ({"bounds": {"young_modulus": (3e5, 4e5)}}, "must lie between"),
        ({"bounds": {"young_modulus": (-1, 4e5)}}, "above 0"),
        ({"bounds": {"young_modulus": 3e5}}, "pair"),
        ({"loss": "hope"}, "loss='hope'"),
        ({"starts": 0}, "starts=0"),
        ({"profiles": ("density",)}, "profiles: 'density'"),
        ({"material": "butter"}, "material='butter'"),
        ({"resume": True}, "resume"),
    ],
)
@pytest.mark.usefixtures("wrong_types")
def test_bad_options(recording, options, words):
    with pytest.raises(ValueError, match=words):
        fit([recording], **options)


def test_an_interrupted_fit_goes_on(recording, tmp_path, monkeypatch):
    path = tmp_path / "checkpoint.json"
    calls = []

    def interrupted(problem, start, max_iterations, report):
        levenberg_marquardt(problem, start, 2, report)
        calls.append(start)
        raise KeyboardInterrupt

    optimisers = {"levenberg_marquardt": (interrupted, 60)}
    with monkeypatch.context() as patch:
        patch.setattr("calibration.search.optimise.OPTIMISERS", optimisers)
        stopped = fit([recording], checkpoint=path)
    assert stopped.result == "interrupted"
    best = min(h["rms_m"] for h in stopped.history if h["stage"] == "levenberg marquardt")
    assert path.exists()

    def first_point(problem, start, max_iterations, report):
        calls.append(start)
        return levenberg_marquardt(problem, start, max_iterations, report)

    with monkeypatch.context() as patch:
        optimisers = {"levenberg_marquardt": (first_point, 60)}
        patch.setattr("calibration.search.optimise.OPTIMISERS", optimisers)
        done = fit([recording], checkpoint=path, resume=True)
    assert done.result == "converged"
    assert calls[-1].rms <= best * (1 + 1e-9)
    # Until the fit is written, the checkpoint is all that there is of it on disk.
    assert path.exists()
    write_report(done, tmp_path / "out")
    assert not path.exists()


def test_a_checkpoint_of_another_fit_is_refused(recording, tmp_path):
    path = tmp_path / "checkpoint.json"
    with pytest.raises(CheckpointError, match="nothing to go on from"):
        fit([recording], checkpoint=path, resume=True)
    path.write_text("{}")
    with pytest.raises(CheckpointError, match="not a checkpoint"):
        fit([recording], checkpoint=path, resume=True)
    path.write_text(json.dumps({"fit": "0", "done": [], "x": None, "loss": 1.0}))
    with pytest.raises(CheckpointError, match="another scene"):
        fit([recording], checkpoint=path, resume=True)


def test_the_report_is_one_file_and_its_scene_can_be_simulated(recording, plain, tmp_path):
    write_report(plain, tmp_path)
    page = (tmp_path / "report.html").read_text()
    assert "http" not in page.replace("http://www.w3.org", "")
    for word in ("young_modulus", "95 % interval", "Starts", "Profile of", "residuals"):
        assert word in page
    scene = sr.load_scene(tmp_path / "scene.toml")
    value = plain.parameters["young_modulus"].value
    assert float(scene.young_modulus) == pytest.approx(value)
    content = json.loads((tmp_path / "parameters.json").read_text())
    assert content["parameters"]["young_modulus"]["verdict"] == "identified"


def test_a_modulus_that_is_not_the_materials(plain):
    """2.9e5 Pa is a Dragon Skin 10, and far too stiff for an Ecoflex."""

    def said(material):
        return [r for r in as_json(replace(plain, material=material))["remarks"] if "range" in r]

    assert not said(None) and not said("dragon-skin-10")
    (remark,) = said("ecoflex-00-30")
    assert "young_modulus" in remark and "ecoflex-00-30" in remark and "10 psi" in remark


@pytest.mark.long
def test_what_a_hand_did_is_named():
    """A weight whose release took 80 ms, and a bare rod that was free at once."""
    scene = beam(payload=sr.Payload(jnp.array(0.05)))
    held_back = release(scene, 1, name="loaded", duration=0.08, conditions={"payload_mass": 0.05})
    bare = release(beam(), name="bare", conditions={"payload_mass": 0.0})
    found = fit([bare, held_back], explain=True)
    first = found.explanations[0]
    assert first.name == "release_duration"
    assert first.values["release_duration@loaded"] == pytest.approx(0.08, rel=0.1)
    assert first.values["release_duration@bare"] < 0.02
    assert first.rms == pytest.approx(NOISE * np.sqrt(3), rel=0.1)
    assert any("release_duration@loaded" in r for r in as_json(found)["remarks"])


@pytest.mark.long
def test_a_loss_that_does_not_grow_with_frequency_is_named():
    """Two rods that ring at different frequencies, the slow one with the larger damping; and no
    candidate where one damping is all there is."""
    weights = {"payload_mass": 0.0}, {"payload_mass": 0.05}
    heavy = beam(payload=sr.Payload(jnp.array(0.05)), bending_damping=1.1e-4)
    slow = release(heavy, seed=1, name="slow", conditions=weights[1])
    quick = release(beam(), name="quick", conditions=weights[0])
    found = fit([quick, slow], explain=True)
    named = {e.name: e for e in found.explanations}
    each = named["bending_damping of each recording"]
    assert each.rms == pytest.approx(NOISE * np.sqrt(3), rel=0.1)
    assert each.values["bending_damping@slow"] > 1.4 * each.values["bending_damping@quick"]
    assert any("does not grow with frequency" in r for r in as_json(found)["remarks"])
    heavy = beam(payload=sr.Payload(jnp.array(0.05)))
    same = release(heavy, seed=1, name="slow", conditions=weights[1])
    found = fit([quick, same], explain=True)
    assert any("There is no candidate" in r for r in as_json(found)["remarks"])


@pytest.mark.long
def test_numerical_damping_does_not_pose_as_the_materials(recording):
    """A scheme that damps by itself: the check at half the step says so, and by how much."""
    options = dict(scheme=sr.BDFAlpha(-0.2))
    found = fit([recording], checks=True, **options)
    damping = found.parameters["bending_damping"]
    finer = fit([recording], dt=0.5 / RATE, **options).parameters["bending_damping"]
    assert abs(damping.step_shift) > 100 * abs(damping.grid_shift)
    foreseen = damping.step_shift * 2 * damping.standard_error
    assert foreseen == pytest.approx(np.log(finer.value / damping.value), rel=0.5)
    remarks = as_json(found)["remarks"]
    assert any("half the time step, bending_damping" in r for r in remarks)
    assert not any("twice the grid" in r for r in remarks)


def test_the_usual_optimiser():
    assert usual(3) == usual(MANY) == "levenberg_marquardt" and usual(MANY + 1) == "adam"


def test_the_bar_tells_loss_parameters_and_time(recording, capsys):
    fit([recording], progress=True)
    shown = capsys.readouterr().err
    for word in ("levenberg marquardt", "rms 0.3", "mm", "left", "young_modulus 2.", "Pa"):
        assert word in shown


def test_amplitudes_of_a_sine():
    times = np.arange(0, 2, 0.01)
    values = np.stack([3 * np.sin(2 * np.pi * 10 * times), np.full(200, np.nan)], axis=1)
    values[[20, 21], 0] = np.nan
    f, size = amplitudes(times, values)
    k = np.argmax(size[:, 0])
    assert f[k] == pytest.approx(10, abs=0.3)
    assert size[k, 0] == pytest.approx(3, rel=0.05)
    assert np.all(size[:, 1] == 0)


def test_a_log_is_cut_into_windows_where_it_rests():
    t = np.arange(0, 10, 0.01)
    # Moves but for a tenth of a second before 2 s, and from 5.2 s on.
    moving = (t < 1.9) | ((t > 2.0) & (t < 5.2))
    tip = np.zeros((len(t), 3)) + [0, 0, 0.1]
    tip[:, 0] = np.where(moving, 0.01 * np.sin(20 * t), 0.0)
    log = replace(
        release(beam()), times=t, tensions=np.ones((len(t), 1)), tip_positions=tip, name="log"
    )
    windows = split(log, duration=3.0, lead=0.5)
    assert [w.name for w in windows] == ["log-1", "log-2", "log-3"]
    assert [w.times[0] for w in windows] == pytest.approx([0.0, 1.9, 5.2], abs=0.011)
    used = [w.times[w.has_tip] for w in windows]
    assert [u[0] for u in used] == pytest.approx([0.0, 3.0, 6.0])
    assert sum(map(len, used)) == len(t)
    assert [w.starts_hanging for w in windows] == [None, True, True]
    assert not any(w.notes for w in windows)
    restless = replace(log, tip_positions=tip + np.sin(20 * t)[:, None] * [0.01, 0, 0])
    assert "where the window's lead begins" in split(restless, 3.0, 0.5)[1].notes[0]
    with pytest.raises(RecordingError, match="release without inputs"):
        split(release(beam()), 1.0, 0.1)
    with pytest.raises(ValueError, match="duration=-1"):
        split(log, -1.0, 0.1)
