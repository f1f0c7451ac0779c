"""A motion as a film: a GIF, or one HTML page that holds all its frames."""

import base64
import io
import shutil
import subprocess
from collections.abc import Mapping
from os import PathLike
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from PIL import Image

from softrod_jax.pictures.body import Line, body_of, line_along
from softrod_jax.pictures.drawing import (
    POINTS,
    TENDON_COLOURS,
    draw_line,
    draw_obstacles,
    rod_axes,
    shares,
    unit_of,
)
from softrod_jax.pictures.obstacles import courses_by_number
from softrod_jax.pictures.page import PAGE
from softrod_jax.pictures.stills import add_legend, check_solved, draw_dots
from softrod_jax.scene.poses import PosesLike
from softrod_jax.scene.scene import Scene

# A frame takes 0.1 s to draw, and half a megabyte of memory until all are there.
MOST_FRAMES = 600


def animate(
    scene: Scene,
    trajectory,
    path: str | PathLike,
    tensions=None,
    pressures=None,
    *,
    speed: float = 1.0,
    fps: float = 25.0,
    view: tuple[float, float] = (16.0, -60.0),
    size: tuple[int, int] = (480, 440),
    measured_tip=None,
    contacts: Mapping[str, PosesLike] | None = None,
) -> Path:
    """Write a motion to `path`: a .gif, an .mp4, or an .html that needs no other file and no
    network. (`film` writes one that can be turned.)

    - `trajectory`: a `Trajectory`, or what else has `ts`, `positions`, `quaternions` and `strains`.
    - `tensions` [N], (steps, tendons), and `pressures` [Pa], (steps, chambers): as in `simulate`;
      a tendon is drawn the wider and a chamber the darker, the larger its input.
    - `speed`: of the film, 1 being real time. `fps`: frames a second, at most 50 in a GIF. A frame
      shows the step that is nearest in time.
    - `view`: elevation and azimuth [deg]. `size` of the film [pixels].
    - `measured_tip` [m], (steps + 1, 3): dots, as far as it is known.
    - `contacts`: where obstacles are carried, as in `simulate`.

    Returns `path`. Raises `ValueError` for a failed motion, a batch, another ending of the name,
    more than 600 frames, and an .mp4 where ffmpeg is not installed.
    """
    path = Path(path)
    check_solved("animate", trajectory)
    kind = path.suffix.lower()
    if kind not in (".gif", ".html", ".mp4"):
        raise ValueError(
            f"animate: {path}: the name ends in {kind!r}; expected .gif, .mp4 or .html"
        )
    if kind == ".mp4" and shutil.which("ffmpeg") is None:
        raise ValueError(f"animate: {path}: an .mp4 needs ffmpeg; install it, or write a .gif")
    if not (speed > 0 and np.isfinite(speed)):
        raise ValueError(f"animate: speed={speed}; a positive number is needed")
    if not 0 < fps <= 50:
        raise ValueError(f"animate: fps={fps}; a number above 0 and up to 50 is needed")
    shown = _shown(np.asarray(trajectory.ts), speed, fps)
    courses = courses_by_number("animate", scene, contacts, len(trajectory.ts))
    inputs = tensions, pressures
    frames = _frames(scene, trajectory, inputs, courses, shown, speed, view, size, measured_tip)
    if kind == ".mp4":
        return _encoded(frames, path, fps)
    # A GIF counts in hundredths of a second.
    wait = max(round(100 / fps), 2) * 10 if kind == ".gif" else 1000 / fps
    if kind == ".gif":
        frames[0].save(path, save_all=True, append_images=frames[1:], duration=wait, loop=0)
    else:
        page = PAGE.replace("WAIT", f"{wait:.6g}").replace(
            "FRAMES", ",\n".join(f'"{_data(frame)}"' for frame in frames)
        )
        path.write_text(page, encoding="utf-8")
    return path


def _encoded(frames: list[Image.Image], path: Path, fps: float) -> Path:
    """The frames as an .mp4, by ffmpeg."""
    width, height = frames[0].size
    command = ["ffmpeg", "-y", "-loglevel", "error", "-f", "rawvideo", "-pix_fmt", "rgb24"]
    command += ["-s", f"{width}x{height}", "-r", f"{fps:g}", "-i", "-", "-pix_fmt", "yuv420p"]
    # Its usual coding of colours needs even sizes.
    command += ["-vf", "pad=ceil(iw/2)*2:ceil(ih/2)*2", str(path)]
    raw = b"".join(frame.convert("RGB").tobytes() for frame in frames)
    done = subprocess.run(command, input=raw, capture_output=True)
    if done.returncode:
        raise ValueError(f"animate: {path}: ffmpeg: {done.stderr.decode(errors='replace').strip()}")
    return path


def _shown(ts, speed, fps) -> np.ndarray:
    """The indices of the times that are shown."""
    count = int(np.floor(ts[-1] * fps / speed * (1 + 1e-9))) + 1
    if count > MOST_FRAMES:
        raise ValueError(
            f"animate: {ts[-1]:g} s at speed={speed:g} and fps={fps:g} make {count} frames, and "
            f"{MOST_FRAMES} are the most: raise speed, or lower fps"
        )
    times = np.arange(count) * speed / fps
    return np.clip(np.round(times / ts[1]).astype(int), 0, len(ts) - 1)


def _frames(scene, trajectory, inputs, courses, shown, speed, view, size, measured):
    body = body_of(scene, POINTS)
    lines = line_along(trajectory, body.arc)
    ts = np.asarray(trajectory.ts)
    pull = _course(inputs[0], len(ts), len(body.tendons))
    air = _course(inputs[1], len(ts), len(body.chambers))
    places = lines.p.reshape(-1, 3)

    figure = Figure(figsize=(size[0] / 100, size[1] / 100), dpi=100)
    canvas = FigureCanvasAgg(figure)
    axes = rod_axes(figure, scene, trajectory, view=view)
    figure.subplots_adjust(left=0, right=1, bottom=0, top=1)
    add_legend(axes, scene)
    unit, _ = unit_of(scene)
    tip = unit * lines.p[:, -1]
    (trail,) = axes.plot([], [], [], color="black", lw=0.8, zorder=8)
    if measured is not None:
        draw_dots(axes, unit * np.asarray(measured))
    pace = "" if speed == 1 else f"  (speed {speed:g})"
    clock = axes.text2D(0.98, 0.96, "", ha="right", transform=axes.transAxes, fontsize=9)

    pictures, drawn = [], []
    for k in shown:
        for artist in drawn:
            artist.remove()
        poses = {i: rows[k] for i, rows in courses.items()}
        drawn = draw_obstacles(axes, scene, places, poses)
        drawn += draw_line(axes, scene, body, Line(lines.p[k], lines.R[k]), pull[k], air[k])
        trail.set_data_3d(*tip[: k + 1].T)  # pyright: ignore[reportAttributeAccessIssue]  # a Line3D
        clock.set_text(f"t = {ts[k]:.2f} s{pace}")
        canvas.draw()
        pictures.append(Image.fromarray(np.asarray(canvas.buffer_rgba())[..., :3]))
    return _with_one_palette(pictures, TENDON_COLOURS[: len(body.tendons)])


def _with_one_palette(pictures, keys) -> list[Image.Image]:
    """The frames in 256 colours, the same for all: with others each, they would flicker.

    Every colour counts once and not by its pixels, for tendons are thin. White stays white, and
    `keys`, such as "#0072b2", what they are.
    """
    codes = [np.unique(_codes(image)) for image in pictures]
    colours = np.unique(np.concatenate(codes))
    rgb = ((colours[:, None] >> np.array([16, 8, 0])) & 0xFF).astype(np.uint8)
    coarse = np.unique(rgb & 0xF8, axis=0) + np.uint8(4)
    others = 255 - len(keys)
    chosen = Image.fromarray(coarse[None]).quantize(others).getpalette() or []
    exact = [x for key in keys for x in bytes.fromhex(key[1:])]
    palette = np.array([252, 252, 252, *exact, *chosen[: 3 * others]]).reshape(-1, 3)
    nearest = [np.argmin(np.sum((palette - colour.astype(int)) ** 2, axis=1)) for colour in rgb]
    nearest = np.array(nearest, dtype=np.uint8)
    palette[0] = 255
    indexed = [Image.fromarray(nearest[np.searchsorted(colours, _codes(x))]) for x in pictures]
    for image in indexed:
        image.putpalette(palette.astype(np.uint8).tobytes())
    return indexed


def _codes(image: Image.Image) -> np.ndarray:
    """Each pixel's colour, to 6 bits a channel, as one number."""
    return (np.asarray(image) & 0xFC).astype(np.int32) @ np.array([1 << 16, 1 << 8, 1])


def _course(inputs, times, count) -> np.ndarray:
    """Shares of the largest input, (times, count); row k acts in the step that ends at ts[k]."""
    if inputs is None:
        return np.full((times, count), 0.5)
    inputs = np.asarray(inputs, dtype=float)
    if inputs.shape != (times - 1, count):
        raise ValueError(
            f"animate: inputs of shape {inputs.shape}; the scene and the motion need "
            f"({times - 1}, {count})"
        )
    largest = np.max(np.abs(inputs), initial=0.0)
    rows = np.concatenate([inputs[:1], inputs])
    return np.stack([shares(row, largest, count) for row in rows])


def _data(image: Image.Image) -> str:
    buffer = io.BytesIO()
    image.save(buffer, format="PNG", optimize=True)
    return "data:image/png;base64," + base64.b64encode(buffer.getvalue()).decode()
