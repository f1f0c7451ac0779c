"""The page in the browser: the rod in space, and sliders for what drives it. By viser."""

import threading
import time
from os import PathLike

import numpy as np

from softrod_jax.live.session import Session
from softrod_jax.pictures.body import body_of, line_along, placed
from softrod_jax.pictures.drawing import CHAMBER_COLOUR, TENDON_COLOURS, upright
from softrod_jax.scene.inputs import KINDS

_PLACES = 25
# Steps that one frame may take to keep up; a slower machine shows slow motion.
_MOST_STEPS = 4
_BODY = (215, 184, 158)


class Page:
    """A server with the page of one `Session`. `frames`: how many were shown.

    - `host`, `port`: where it listens; of others only this machine reaches 127.0.0.1.
    - `log`: where the button saves what was done.
    """

    def __init__(self, session: Session, host: str, port: int, log: str | PathLike):
        try:
            import viser
        except ImportError as e:
            raise ImportError(f"view: {e}: pip install 'softrod_jax[view]'") from None
        self.session, self.frames, self.log = session, 0, log
        self._running, self._ended = True, threading.Event()
        self._ended.set()
        self.server = viser.ViserServer(host, port, label="softrod view", verbose=False)
        axis, sign = upright(session.scene)
        self.server.scene.set_up_direction(tuple(sign * np.eye(3)[axis]))
        length = float(session.scene.length)
        start = session.shape.positions
        middle = np.mean(start[[0, -1]], axis=0)
        away = np.roll(np.array([0.6, -2.0, 0.0]), axis - 2) + 0.4 * sign * np.eye(3)[axis]
        camera = self.server.initial_camera
        camera.position, camera.look_at = tuple(middle + length * away), tuple(middle)
        self._parts = _Parts(self.server, session)
        self._sliders()

    @property
    def port(self) -> int:
        return self.server.get_port()

    def _sliders(self) -> None:
        gui, session = self.server.gui, self.session
        self.status = gui.add_markdown("")
        self.sliders = {}
        for kind in KINDS:
            count = session.counts.get(kind.name, 0)
            unit, size = kind.shown
            most = size * session.most.get(kind.name, 1.0)
            least = 0.0 if kind.at_least == 0 else -most
            self.sliders[kind.name] = [
                gui.add_slider(
                    f"{kind.one} {i + 1} [{unit}]" if count > 1 else f"{kind.one} [{unit}]",
                    least,
                    most,
                    most / 200,
                    0.0,
                )
                for i in range(count)
            ]
        self.gravity = []
        if session.gravity is not None:
            most = session.gravity_range
            self.gravity = [
                gui.add_slider(
                    f"gravity {axis} [m/s^2]", -most, most, most / 100, float(session.gravity[i])
                )
                for i, axis in enumerate("xyz")
            ]
        self.reset_button, self.save_button = gui.add_button("Reset"), gui.add_button("Save log")
        self.reset_button.on_click(lambda _: self._reset())
        self.save_button.on_click(lambda _: self._save())

    def _reset(self) -> None:
        for sliders in self.sliders.values():
            for slider in sliders:
                slider.value = 0.0
        self.session.reset()
        self.session.message = ""

    def _save(self) -> None:
        try:
            self.session.message = f"saved as {self.session.save(self.log)}"
        except OSError as e:
            self.session.message = f"{self.log}: {e.strerror or e}"

    def frame(self, steps: int = 1) -> None:
        """Take over the sliders, step, and show the rod."""
        session = self.session
        sizes = {kind.name: kind.shown[1] for kind in KINDS}
        for name, sliders in self.sliders.items():
            for i, slider in enumerate(sliders):
                session.wanted[name][i] = float(slider.value) / sizes[name]
        if session.gravity is not None:
            session.gravity[:] = [float(slider.value) for slider in self.gravity]
        for _ in range(steps):
            if not session.step():
                message = session.message
                self._reset()
                session.message = message
                break
        with self.server.atomic():
            self._parts.show(session)
        self.frames += 1

    def run(self, duration: float | None = None) -> None:
        """Frames in real time, for `duration` [s] or until `stop`."""
        self._ended.clear()
        try:
            self._run(duration)
        finally:
            self._ended.set()

    def _run(self, duration: float | None) -> None:
        self.frame()  # compiles
        begun = time.perf_counter()
        done, said = self.session.time, begun
        while self._running:
            now = time.perf_counter()
            if duration is not None and now - begun > duration:
                return
            behind = (now - begun) - (self.session.time - done)
            steps = int(behind / self.session.dt)
            if steps < 0 or steps > _MOST_STEPS:  # reset, or too slow: from here on
                begun, done = (now, self.session.time) if duration is None else (begun, done)
                steps = min(max(steps, 1), _MOST_STEPS)
            if steps == 0:
                time.sleep(max(0.0, self.session.dt - behind))
                continue
            self.frame(steps)
            if now - said > 0.2:
                said = now
                self._say()

    def _say(self) -> None:
        session = self.session
        tip = ", ".join(f"{1e3 * x:.1f}" for x in session.tip)
        lines = [f"t = {session.time:.1f} s, tip ({tip}) mm"]
        if session.counts.get("pulls"):
            lines.append("tensions " + ", ".join(f"{x:.3g}" for x in session.tensions) + " N")
        if session.message:
            lines.append(f"**{session.message}**")
        self.status.content = "\n\n".join(lines)

    def stop(self) -> None:
        """End `run` and the server."""
        self._running = False
        self._ended.wait()
        self.server.stop()


class _Parts:
    """What is seen of the rod, as meshes and lines that move."""

    def __init__(self, server, session: Session):
        self._body = body_of(session.scene, _PLACES)
        self._meshes, self._lines = [], []
        purple = tuple(bytes.fromhex(CHAMBER_COLOUR[1:]))
        line = line_along(session.shape, self._body.arc)
        for parts, colour, opacity in (
            (self._body.outlines, _BODY, 0.55),
            (self._body.chambers, purple, 0.6),
        ):
            for part in parts:
                grid = placed(line.part(part.where), part.points)
                mesh = server.scene.add_mesh_simple(
                    f"/rod/mesh{len(self._meshes)}",
                    grid.reshape(-1, 3).astype(np.float32),
                    _faces(*grid.shape[:2]),
                    color=colour,
                    opacity=opacity,
                    side="double",
                )
                self._meshes.append((part, mesh))
        for i, part in enumerate(self._body.tendons):
            colour = tuple(bytes.fromhex(TENDON_COLOURS[i % len(TENDON_COLOURS)][1:]))
            points = _segments(placed(line.part(part.where), part.points))
            lines = server.scene.add_line_segments(
                f"/rod/tendon{i}",
                points,
                np.array(colour, np.uint8),
                thickness=3.0,
                thickness_units="screen",
            )
            self._lines.append((part, lines))
        # However thin the rod is, it is seen.
        self._axis = server.scene.add_line_segments(
            "/rod/axis",
            _segments(line.p),
            np.array(_BODY, np.uint8),
            thickness=2.0,
            thickness_units="screen",
        )
        length = float(session.scene.length)
        server.scene.add_frame("/clamp", axes_length=0.15 * length, axes_radius=0.004 * length,
                               position=tuple(line.p[0]))  # fmt: skip

    def show(self, session: Session) -> None:
        line = line_along(session.shape, self._body.arc)
        for part, mesh in self._meshes:
            grid = placed(line.part(part.where), part.points)
            mesh.vertices = grid.reshape(-1, 3).astype(np.float32)
        for part, lines in self._lines:
            lines.points = _segments(placed(line.part(part.where), part.points))
        self._axis.points = _segments(line.p)


def _segments(points: np.ndarray) -> np.ndarray:
    """A line, (n, 3), as its pieces, (n - 1, 2, 3)."""
    return np.stack([points[:-1], points[1:]], axis=1).astype(np.float32)


def _faces(rings: int, corners: int) -> np.ndarray:
    """The triangles between rings of corners."""
    a = np.arange((rings - 1) * corners).reshape(rings - 1, corners)
    b, c, d = np.roll(a, -1, axis=1), a + corners, np.roll(a, -1, axis=1) + corners
    both = np.concatenate([np.stack([a, b, d], -1), np.stack([a, d, c], -1)])
    return both.reshape(-1, 3).astype(np.uint32)
