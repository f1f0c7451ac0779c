"""Pictures: what is drawn lies where the rod is, and films open without a network."""

import base64
import dataclasses
import io
import re
import subprocess
import sys
from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np
import pytest

import softrod_jax as sr

pytest.importorskip("matplotlib")

from matplotlib.figure import Figure  # noqa: E402
from PIL import Image  # noqa: E402

from softrod_jax import pictures  # noqa: E402
from softrod_jax.pictures.body import body_of, line_along, placed  # noqa: E402
from softrod_jax.rod.rotations import quaternion_exp  # noqa: E402

# Arcs of known shape stand here for solutions.
pytestmark = pytest.mark.usefixtures("wrong_types")

LENGTH, STRETCH = 0.1, 0.95


def arc_at(s, u):
    """Position and attitude (rotation vector) of a rod bent to a circle by u [1/m] about y."""
    s = np.asarray(s)[..., None]
    p = np.concatenate([1 - np.cos(u * s), 0 * s, np.sin(u * s)], -1) * STRETCH / u
    return p, np.concatenate([0 * s, u * s, 0 * s], -1)


def arc(u, nodes=13):
    """Such a rod as a solution."""
    p, turn = arc_at(np.linspace(0, LENGTH, nodes), u)
    strains = np.tile([0, 0, STRETCH, 0, u, 0], (nodes, 1))
    quaternions = np.asarray(quaternion_exp(jnp.asarray(turn)))
    return SimpleNamespace(positions=p, quaternions=quaternions, strains=strains)


def motion(steps=4):
    """A rod that bends further and further."""
    shapes = [arc(u) for u in np.linspace(1.0, 20.0, steps + 1)]
    fields = {
        name: np.stack([getattr(shape, name) for shape in shapes])
        for name in ("positions", "quaternions", "strains")
    }
    return SimpleNamespace(ts=0.1 * np.arange(steps + 1), result=np.array(0), **fields)


def film(path, scene=None, trajectory=None, **options):
    scene = sr.hybrid_robot(LENGTH) if scene is None else scene
    trajectory = motion() if trajectory is None else trajectory
    return pictures.animate(scene, trajectory, path, size=(200, 180), **options)


def test_between_the_nodes_the_line_is_the_rod():
    line = line_along(arc(u=20.0), np.linspace(0, LENGTH, 49))
    p, turn = arc_at(np.linspace(0, LENGTH, 49), 20.0)
    angle = turn[:, 1]
    np.testing.assert_allclose(line.p, p, rtol=0, atol=1e-6 * LENGTH)
    across = np.stack([np.cos(angle), 0 * angle, -np.sin(angle)], 1)
    np.testing.assert_allclose(line.R[:, :, 0], across, rtol=0, atol=1e-5)
    np.testing.assert_allclose(line.R[:, :, 1], np.tile([0, 1, 0], (49, 1)), rtol=0, atol=1e-5)


def test_a_motion_is_its_shapes():
    places = np.linspace(0, LENGTH, 9)
    together, alone = line_along(motion(), places), line_along(arc(20.0), places)
    assert together.p.shape == (5, 9, 3) and together.R.shape == (5, 9, 3, 3)
    np.testing.assert_allclose(together.p[-1], alone.p, rtol=0, atol=1e-15)


def test_parts_lie_where_the_scene_has_them():
    scene = sr.hybrid_robot(LENGTH)
    body = body_of(scene, 49)
    line = line_along(arc(20.0), body.arc)
    inner = placed(line, body.tendons[0].points)  # 4 mm off, towards the inside of the bend
    centre = np.array([STRETCH / 20.0, 0, 0])
    radius = np.linalg.norm(inner - centre, axis=1)
    np.testing.assert_allclose(radius, STRETCH / 20.0 - 4e-3, rtol=0, atol=1e-6)
    for outline, size in ((body.outlines[0], 6e-3), (body.chambers[0], 1.5e-3)):
        away = placed(line, outline.points) - line.p[:, None]
        np.testing.assert_allclose(np.linalg.norm(away, axis=2), size, rtol=1e-4)
        along = line.R[:, :, 2]
        assert np.abs(np.einsum("sci,si->sc", away, along)).max() < 1e-4 * size


@pytest.mark.parametrize(
    "section, corners, bore",
    [
        (sr.Annulus(jnp.array(6e-3), jnp.array(2e-3)), 6e-3, 2e-3),
        (sr.Rectangle(jnp.array(8e-3), jnp.array(6e-3)), 5e-3, None),
        # The ellipse with the radii of gyration of a circle is the circle.
        (sr.GeneralSection(*(jnp.array(x) for x in (3.0, (12.0, 12.0), 24.0))), 4.0, None),
    ],
)
def test_outlines_of_sections(section, corners, bore):
    body = body_of(dataclasses.replace(sr.hybrid_robot(), section=section), 3)
    np.testing.assert_allclose(np.linalg.norm(body.outlines[0].points, axis=-1), corners)
    assert (not body.bores) == (bore is None)
    if bore is not None:
        np.testing.assert_allclose(np.linalg.norm(body.bores[0].points, axis=-1), bore)


def on_screen(axes):
    """Where a small step along x, y and z leads on the screen: rows of right, up and depth."""
    view = axes.get_proj()
    at = lambda x: (view @ np.append(x, 1.0))[:3] / (view @ np.append(x, 1.0))[3]
    corner = np.array([axes.get_xlim()[0], axes.get_ylim()[0], axes.get_zlim()[0]])
    return np.stack([at(corner + 0.01 * e) - at(corner) for e in np.eye(3)])


@pytest.mark.parametrize("gravity", [None, (0, 0, 9.81), (0, 0, -9.81), (-9.81, 0, 0), (0, 9.8, 1)])
def test_up_is_against_gravity_and_nothing_is_mirrored(gravity):
    scene = sr.hybrid_robot(LENGTH, None if gravity is None else jnp.array(gravity, float))
    axes = pictures.rod_axes(Figure(), scene, arc(20.0))
    steps = on_screen(axes)
    plain = on_screen(Figure().add_subplot(projection="3d"))
    assert np.sign(np.linalg.det(steps)) == np.sign(np.linalg.det(plain)) != 0
    up = np.array([0, 0, 1.0]) if gravity is None else -np.array(gravity) / 9.81
    x, y, _ = steps.T @ np.sign(np.where(np.abs(up) > 0.5, up, 0))
    assert y > 0 and abs(x) < 0.1 * y


def test_equal_axes_in_millimetres_or_metres():
    for length, size, unit in ((LENGTH, 1e3, "mm"), (2.0, 1.0, "m")):
        scene = sr.hybrid_robot(length)
        axes = pictures.rod_axes(Figure(), scene, arc(20.0))
        limits = np.array([axes.get_xlim(), axes.get_ylim(), axes.get_zlim()])
        ranges = np.ptp(limits, axis=1)
        np.testing.assert_allclose(ranges / ranges[0], axes._box_aspect / axes._box_aspect[0])
        positions = size * arc(20.0).positions
        assert np.all(limits[:, 0] < positions.min(axis=0))
        assert np.all(limits[:, 1] > positions.max(axis=0))
        assert axes.get_xlabel() == f"x [{unit}]"


def test_picture_shows_all_parts():
    scene = dataclasses.replace(
        sr.hybrid_robot(LENGTH, jnp.array([0, 0, 9.81])),
        payload=sr.Payload(2e-3),
        tip_load=sr.TipLoad(force=jnp.array([0.1, 0, 0])),
    )
    bare = dataclasses.replace(scene, tendons=None, chambers=None, payload=None, tip_load=None)
    full, less = (pictures.picture(s, arc(20.0)) for s in (scene, bare))
    names = [text.get_text() for text in full.axes[0].get_legend().get_texts()]
    assert names == ["tendon 1", "tendon 2", "tendon 3", "chamber"]
    assert less.axes[0].get_legend() is None
    # Three tendons, a chamber, a payload and a force.
    assert len(full.axes[0].collections) - len(less.axes[0].collections) == 6
    figure = pictures.picture(scene, arc(20.0), (0.1, 0.0, 0.2), (2e4,))
    names = [text.get_text() for text in figure.axes[0].get_legend().get_texts()]
    assert names == ["tendon 1: 0.1 N", "tendon 2: 0 N", "tendon 3: 0.2 N", "chamber: 20 kPa"]
    figure.savefig(io.BytesIO())


def test_drawn_where_the_rod_is():
    scene = dataclasses.replace(sr.hybrid_robot(LENGTH), tendons=None, chambers=None)
    axes = pictures.rod_axes(Figure(), scene, arc(20.0))
    drawn = pictures.draw_rod(axes, scene, arc(20.0), clamp=False)
    tube = 1e-3 * np.concatenate([artist._faces.reshape(-1, 3) for artist in drawn])
    line, _ = arc_at(np.linspace(0, LENGTH, 49), 20.0)
    away = np.linalg.norm(tube[:, None] - line, axis=2).min(axis=1)
    assert away.max() < 6.001e-3


def test_stills():
    figure = pictures.stills(sr.hybrid_robot(LENGTH), motion(), 3)
    (path,) = figure.axes[0].lines
    np.testing.assert_allclose(np.array(path.get_data_3d()).T, 1e3 * motion().positions[:, -1])


def test_gif(tmp_path):
    path = film(tmp_path / "a.gif", fps=10, tensions=np.ones((4, 3)))
    with Image.open(path) as gif:
        assert gif.size == (200, 180) and gif.n_frames == 5
        assert gif.info["duration"] == 100 and gif.info["loop"] == 0
        first = np.asarray(gif.convert("RGB")).astype(int)
        gif.seek(4)
        last = np.asarray(gif.convert("RGB")).astype(int)
    assert (first[0, 0] == 255).all()
    assert (np.abs(first - last).max(axis=2) > 50).sum() > 200  # the rod has moved


def test_html_is_complete_and_needs_no_network(tmp_path):
    path = film(tmp_path / "a.html", fps=20, speed=2.0)
    page = path.read_text(encoding="utf-8")
    assert "http" not in page and "FRAMES" not in page and "WAIT" not in page
    assert not re.search(r"<link|src=|@import", page)
    frames = re.findall(r"data:image/png;base64,([A-Za-z0-9+/=]+)", page)
    assert len(frames) == 5
    for frame in frames:
        assert Image.open(io.BytesIO(base64.b64decode(frame))).size == (200, 180)


def test_slow_motion_shows_each_step_for_longer(tmp_path):
    with Image.open(film(tmp_path / "a.gif", fps=10, speed=0.5)) as gif:
        total = 0
        for k in range(gif.n_frames):
            gif.seek(k)
            total += gif.info["duration"]
    assert total == pytest.approx(1000 * 0.4 / 0.5 + 100)


def test_bad_input(tmp_path):
    scene = sr.hybrid_robot(LENGTH)
    failed, batch = motion(), motion()
    failed.result, batch.result = np.array(2), np.zeros(3, int)
    endless = motion()
    endless.ts = 100.0 * endless.ts
    no_number = arc(20.0)
    no_number.positions = np.full((13, 3), np.nan)
    for call, message in (
        (lambda: film("a.avi"), r"a.avi: the name ends in '.avi'; expected .gif, .mp4 or .html"),
        (lambda: film("a.gif", trajectory=failed), "nothing to draw: Newton"),
        (lambda: film("a.gif", trajectory=batch), r"a batch of \(3,\); take one sample"),
        (lambda: film("a.gif", trajectory=endless, fps=50), "2001 frames.*raise speed"),
        (lambda: film("a.gif", speed=0.0), "speed=0.0; a positive"),
        (lambda: film("a.gif", fps=100), "fps=100; a number above 0 and up to 50"),
        (lambda: film("a.gif", tensions=np.ones((5, 3))), r"\(5, 3\).*need \(4, 3\)"),
        (lambda: pictures.picture(scene, failed), "nothing to draw"),
        (lambda: pictures.picture(scene, no_number), "not finite"),
        (lambda: pictures.picture(scene, motion()), r"\(5, 13, 3\), expected \(nodes, 3\)"),
        (lambda: pictures.picture(scene, arc(20.0), (1.0,)), r"shape \(1,\).*needs \(3,\)"),
        (lambda: pictures.stills(scene, motion(), 0), "count=0; at least 1"),
    ):
        with pytest.raises(ValueError, match=message):
            call()


def test_matplotlib_is_an_extra(monkeypatch):
    line = "import sys, softrod_jax; assert 'matplotlib' not in sys.modules"
    subprocess.run([sys.executable, "-c", line], check=True)
    for name in [name for name in sys.modules if name.startswith("softrod_jax.pictures")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(ImportError, match=r"pip install 'softrod_jax\[plots\]'"):
        import softrod_jax.pictures  # noqa: F401


def test_names_of_solutions():
    """The names that drawing relies on are those of a solution and a trajectory."""
    fields = {field.name for field in dataclasses.fields(sr.StaticSolution)}
    assert {"positions", "quaternions", "strains", "result"} <= fields
    fields = {field.name for field in dataclasses.fields(sr.Trajectory)}
    assert {"ts", "positions", "quaternions", "strains", "result"} <= fields


def wider():
    """Two segments, the first a taper; tendons on disks, a part of a tendon, and what is there."""
    return sr.Scene(
        segments=[
            sr.Segment(0.06, sr.Circle(6e-3), sr.Circle(4e-3)),
            sr.Segment(0.04, sr.Annulus(3e-3, 1e-3)),
        ],
        young_modulus=5e4,
        poisson_ratio=0.49,
        density=1070.0,
        tendons=sr.Tendons(
            [[2e-3, 0.0], [0.0, 0.0]],
            paths=[None, sr.Line([8e-3, 0.0], [2e-3, 0.0])],
            starts_at=[0.01, None],
            ends_at=[0.055, None],
            guided=("rod", "disks"),
        ),
        chambers=sr.Chambers([4e-6], [[0.0, 1e-3]], ends_at=[0.03]),
        loads=[
            sr.Load(0.035, force=[0.0, 2.0, 0.0]),
            sr.Load(0.1, force=[1.0, 0.0, 0.0], frame="body"),
        ],
        masses=[sr.Mass(0.035, 1e-3)],
        markers=[sr.Marker("eye", 0.05, offset=[0.0, 4e-3, 0.0])],
    )


def test_parts_of_a_wider_scene_lie_where_it_has_them():
    body = body_of(wider(), 49)
    assert {0.01, 0.03, 0.035, 0.05, 0.055} <= set(body.arc)
    cone, tube = body.outlines
    s = body.arc[cone.where]
    assert (s[0], s[-1]) == (0.0, 0.06) and body.arc[tube.where][0] == 0.06
    assert np.all(np.diff(s) > 0) and len(body.arc) == len(s) + len(body.arc[tube.where])
    radii = np.linalg.norm(cone.points, axis=-1)
    np.testing.assert_allclose(radii, np.tile((6e-3 - 2e-3 * s / 0.06)[:, None], radii.shape[1]))
    np.testing.assert_allclose(np.linalg.norm(tube.points, axis=-1), 3e-3)
    assert [bore.where for bore in body.bores] == [tube.where]
    straight, converging = body.tendons
    assert (body.arc[straight.where][0], body.arc[straight.where][-1]) == (0.01, 0.055)
    along = body.arc[converging.where]
    np.testing.assert_allclose(converging.points[:, 0], 8e-3 - 6e-3 * along / 0.1)
    np.testing.assert_array_equal([body.arc[end.where][0] for end in body.ends], [0.01, 0.055])
    assert body.arc[body.chambers[0].where][-1] == 0.03
    for disk in body.disks:
        away = 8e-3 - 6e-3 * body.arc[disk.where][0] / 0.1
        np.testing.assert_allclose(np.linalg.norm(disk.points, axis=1), 1.1 * away)
    assert len(body.disks) == 9
    np.testing.assert_allclose([body.radius, body.reach], [6e-3, 8.8e-3])


def test_between_nodes_that_are_not_even_the_line_is_the_rod():
    """With two nodes at one place, and a rod that bends from there on only."""
    s = np.concatenate([[0.0, 0.02, 0.05], np.linspace(0.05, 0.08, 6), np.linspace(0.084, 0.1, 4)])
    s = np.append(s, 0.1)
    bends = np.arange(len(s)) > 2
    p, turn = arc_at(np.maximum(s - 0.05, 0.0), 20.0)
    p = p + STRETCH * np.stack([0 * s, 0 * s, np.minimum(s, 0.05)], 1)
    strains = np.zeros((len(s), 6))
    strains[:, 2], strains[:, 4] = STRETCH, 20.0 * bends
    shape = SimpleNamespace(
        positions=p,
        quaternions=np.asarray(quaternion_exp(jnp.asarray(turn))),
        strains=strains,
        arc_lengths=s,
    )
    places = np.linspace(0.0, 0.1, 41)
    expected, _ = arc_at(np.maximum(places - 0.05, 0.0), 20.0)
    expected[:, 2] += STRETCH * np.minimum(places, 0.05)
    np.testing.assert_allclose(line_along(shape, places).p, expected, rtol=0, atol=1e-6 * LENGTH)


def test_a_wider_scene_is_drawn_with_its_loads_and_markers():
    scene, shape = wider(), arc(20.0)
    axes = pictures.rod_axes(Figure(), scene, shape)
    full = pictures.draw_rod(axes, scene, shape)
    bare = dataclasses.replace(scene, loads=None, masses=None, markers=None)
    assert len(full) - len(pictures.draw_rod(axes, bare, shape)) == 5
    assert [text.get_text() for text in axes.texts] == [" eye"]
    # Each arrow is a quarter of the rod: one across at 35 mm, one with the body at the tip.
    across, body = [x for x in full if type(x).__name__ == "Line3DCollection"][-2:]
    for quiver, u, at in ((across, [0, 1, 0], 0.035), (body, None, 0.1)):
        shaft = np.asarray(quiver._segments3d[0])
        p, turn = arc_at(np.array(at), 20.0)
        angle = turn[1]
        u = np.array([np.cos(angle), 0, -np.sin(angle)]) if u is None else np.array(u)
        np.testing.assert_allclose(shaft[1], 1e3 * p, rtol=0, atol=2e-4)
        np.testing.assert_allclose(shaft[0] - shaft[1], 25.0 * u, rtol=0, atol=1e-3)
    limits = np.array([axes.get_xlim(), axes.get_ylim(), axes.get_zlim()])
    assert limits[1].max() > 25.0


def test_a_film_of_a_wider_scene(tmp_path):
    with Image.open(film(tmp_path / "a.gif", scene=wider())) as image:
        assert image.n_frames > 1
