"""What a fit found is neither lost nor misread."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest
from beams import FIT, NOISE, TRUTH, beam, release

import softrod_jax as sr
from calibration import calibrate
from calibration.cli.common import UsageError
from calibration.cli.exclusive import alone_in
from calibration.cli.main import main
from calibration.parameters.unknowns import choose_unknowns
from calibration.report.films import FilmError, read_motions
from calibration.report.numbers import as_json
from calibration.report.plots import motion_figure
from calibration.report.writing import summary, write_report
from softrod_jax.scene.scene import as_arrays

EVIL = "<img src=x onerror=alert(1)>"
NAMES = ("young_modulus", "bending_damping")


def fit(recordings, **options):
    plain = {"fit": NAMES, "checks": False, "window": (0.0, 1.0), "progress": False, **FIT}
    scene = beam(young_modulus=2.3e5, bending_damping=1e-4)
    return calibrate(scene, recordings, **{**plain, **options})


@pytest.fixture(scope="module")
def recording():
    return release(beam())


@pytest.fixture(scope="module")
def plain(recording):
    return fit([recording], held_out=[release(beam(), seed=3, name="other")])


def test_a_name_is_text_wherever_it_is_shown(plain, tmp_path):
    """In every table, and in the titles of plots, where $ would begin a formula."""
    own, others = plain.recordings[0], plain.held_out
    labels = {f"{name}@{EVIL}": e for name, e in plain.parameters.items()}
    evil = replace(
        plain,
        recordings=(replace(own, name=EVIL),),
        held_out=(replace(others[0], name=f"{EVIL} $\\nothing$"),),
        parameters=labels,
        result=EVIL,
    )
    write_report(evil, tmp_path)
    page = (tmp_path / "report.html").read_text()
    assert "<img src=x" not in page and "&lt;img src=x" in page


def test_films_show_the_fitted_rod_beside_the_measured_tip(plain, tmp_path):
    """As far apart as the fit says, also when they are read back for another film."""
    write_report(plain, tmp_path)
    assert "href='film_1_release.html'" in (tmp_path / "report.html").read_text()
    assert (tmp_path / "film_2_other.html").stat().st_size > 20_000
    _, motions = read_motions(tmp_path)
    assert [m.kept_aside for m in motions] == [False, True]
    for filmed, fitted in zip(motions, (*plain.recordings, *plain.held_out), strict=True):
        rod, seen = filmed.motion, filmed.motion.seen
        tip = rod.positions[:, -1]
        there = np.stack([np.interp(rod.seen_times, rod.ts, c) for c in tip.T], axis=1)
        rms = np.sqrt(np.mean(np.sum((there - seen) ** 2, axis=1)))
        assert rms == pytest.approx(fitted.rmse, rel=0.03)  # straight lines between steps
        assert rod.quaternions.shape[:2] == rod.strains.shape[:2] == rod.positions.shape[:2]
    main(["film", str(tmp_path), "--recording", "other", "--out", str(tmp_path / "own.html")])
    assert ", kept aside and predicted</title>" in (tmp_path / "own.html").read_text()
    assert main(["film", str(tmp_path), "--recording", "none"]) == 2
    (tmp_path / "motions.npz").write_bytes(b"PK")
    with pytest.raises(FilmError, match="fit again"):
        read_motions(tmp_path)


def test_a_fit_shows_itself_in_a_notebook(plain):
    text, page = plain.summary(), plain._repr_html_()
    for label, estimate in plain.parameters.items():
        for shown in (text, page):
            assert label in shown and f"{estimate.value:.4g}" in shown
    assert text == summary(plain) and "release: " in text and "mm rms" in page
    evil = replace(plain, result=EVIL)
    assert "<img" not in evil._repr_html_()


def test_what_the_intervals_take_for_granted_is_said(plain):
    content = as_json(plain)
    assert "density 1070 kg/m^3" in content["taken_for_granted"]
    assert "take for granted: length 0.1 m, density 1070" in summary(plain)
    (remark,) = [r for r in content["remarks"] if "in proportion to the density" in r]
    assert "young_modulus, bending_damping" in remark


def test_the_same_motion_with_a_wrong_density_moves_the_modulus(recording, plain):
    """What the remark says is so: 10 % too heavy is 10 % too stiff, and fits as well."""
    heavy = as_arrays(replace(beam(young_modulus=2.3e5, bending_damping=1e-4), density=1177.0))
    found = calibrate(
        heavy, [recording], fit=NAMES, checks=False, window=(0.0, 1.0), progress=False, **FIT
    )
    for name in NAMES:
        ratio = found.parameters[name].value / plain.parameters[name].value
        assert ratio == pytest.approx(1.1, rel=1e-3)


def test_a_disk_that_is_full_loses_neither_fit_nor_checkpoint(recording, tmp_path, monkeypatch):
    path, out = tmp_path / "checkpoint.json", tmp_path / "out"
    found = fit([recording], checkpoint=path)
    write_report(found, out)
    before = (out / "parameters.json").read_text()
    found = fit([recording], checkpoint=path)

    def full(*_, **__):
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr("calibration.report.writing.write_plots", full)
        with pytest.raises(OSError, match="No space"):
            write_report(found, out)
    assert path.exists() and before[:20] == (out / "parameters.json").read_text()[:20]
    assert fit([recording], checkpoint=path, resume=True).rmse_m == found.rmse_m


def test_one_run_at_a_time_in_a_directory(tmp_path):
    with alone_in(tmp_path):
        with pytest.raises(UsageError, match="another run is writing there"):
            with alone_in(tmp_path):
                pass
    with alone_in(tmp_path):
        pass


@pytest.mark.parametrize("name", ["tendon_offset", "tendon_position_1_x", "tendon_position_2_y"])
def test_places_stay_in_the_section(recording, name):
    tendons = sr.Tendons(jnp.array([[4e-3, 0.0], [-2e-3, 3e-3]]))
    scene = replace(beam(), section=sr.Circle(jnp.array(6e-3)), tendons=tendons)
    log = replace(recording, tensions=np.zeros((len(recording.times), 2)))
    setup, unknowns = choose_unknowns(scene, [log], ["log"], (name,))
    (item,) = unknowns.items
    for end in (item.low, item.high):
        moved = item.parameter.put(setup, item.value(end)).scene
        # A tendon in the surface is inside, up to rounding.
        assert bool(jnp.all(moved.section.contains((1 - 1e-8) * moved.tendons.offsets)))
    beyond = item.parameter.put(setup, item.value(item.high + 0.05)).scene
    assert not bool(jnp.all(beyond.section.contains(beyond.tendons.offsets)))


def test_what_is_not_identifiable_does_not_go_into_the_scene(recording):
    """Drag does little here; the scene keeps what it had, which lies in the interval."""
    scene = beam(drag_coefficient=1e-3)
    names = (*NAMES, "drag_coefficient")
    found = calibrate(
        scene, [recording], fit=names, checks=False, window=(0.0, 1.0), progress=False, **FIT
    )
    estimate = found.parameters["drag_coefficient"]
    assert not estimate.identifiable
    assert float(found.scene.drag_coefficient) == pytest.approx(1e-3)
    value = found.parameters["young_modulus"].value
    assert float(found.scene.young_modulus) == pytest.approx(value)


def test_held_out_recordings_have_the_mean_of_what_each_has(recording):
    softer = release(beam(young_modulus=2.4e5), seed=1, name="softer")
    between = release(beam(young_modulus=2.64e5), seed=2, name="between")
    found = fit([recording, softer], per_recording=NAMES[:1], held_out=[between])
    assert found.held_out[0].rmse == pytest.approx(NOISE * np.sqrt(3), rel=0.2)
    assert any("with the mean of what each" in r for r in as_json(found)["remarks"])


def test_both_frames_of_a_recording_that_was_kept_aside_are_shown(recording):
    """The camera was turned by ten degrees after the fitted one: a frame of its own hides it."""
    free = replace(recording, origin_known=False)
    other = release(beam(), seed=4, name="turned", origin_known=False)
    tip, start = other.tip_positions, other.tip_positions[0]
    turned = start + (tip - start) + np.cross([0.1, 0.1, 0.1], tip - start)
    same, moved = fit([free], held_out=[other, replace(other, tip_positions=turned)]).held_out
    level = NOISE * np.sqrt(3)
    assert same.rmse == pytest.approx(level, rel=0.3)
    assert moved.rmse > 1.5 * level > 1.2 * moved.rmse_own_frame


def test_a_fit_at_the_noise_has_converged():
    """A motion hardly larger than the noise leaves much of itself, and there is nothing to find."""
    found = fit([release(beam(), noise=8e-3)], time_offset=False)
    assert found.result == "converged"
    assert found.rmse_m["release"] == pytest.approx(8e-3 * np.sqrt(3), rel=0.3)
    assert set(TRUTH) == set(found.parameters)


def test_rods_in_the_picture_of_a_motion_are_smooth(plain):
    """A fit's grid has few nodes; a polygon through them would leave the rod by more than 1e-3 of
    its length. The curve drawn is as long as the rod and ends where the tip is."""
    recording = plain.recordings[0]
    tip = 1e3 * recording.motion.positions[:, -1]
    path, *rods = motion_figure(recording).axes[0].lines
    np.testing.assert_allclose(path.get_xdata(), tip[:, 2])
    assert len(rods) == 14
    for rod, k in zip(rods, np.linspace(0, len(tip) - 1, 14).astype(int), strict=True):
        z, across = rod.get_data()
        assert len(z) == 60 and z[-1] == pytest.approx(tip[k, 2])
        turns = np.diff(np.unwrap(np.arctan2(np.diff(across), np.diff(z))))
        assert np.max(np.abs(turns)) < 0.1
