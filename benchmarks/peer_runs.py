"""Other packages, each in a virtual environment of its own, asked for one run at a time.

The drivers are in `peers/`; `peers/common.py` says how they answer.
"""

import dataclasses
import json
import subprocess
import sys
from pathlib import Path

from work_scenes import REFERENCE

DRIVERS = Path(__file__).parent / "peers"
# [s] About the largest that each bears: 1.4e-4 is too much for eight segments.
SOROMOX_STEPS = {1: 4e-3, 2: 2e-3, 4: 5e-4, 8: 1e-4}


@dataclasses.dataclass(frozen=True)
class Peer:
    """A package at one resolution. `requirement`: for pip; None: this environment will do."""

    name: str
    label: str
    driver: str
    arguments: tuple[str, ...]
    requirement: str | None


def _mujoco(dt):
    arguments = ("--segments", "40", "--dt", f"{dt:g}")
    name = f"MuJoCo, 40 segments, {1e3 * dt:g} ms"
    return Peer(name, f"M{1e3 * dt:g}", "mujoco_cable.py", arguments, "mujoco<4")


def _elastica(elements):
    name, arguments = f"PyElastica, {elements} elements", ("--elements", str(elements))
    return Peer(name, f"P{elements}", "pyelastica_rod.py", arguments, "pyelastica==1.0.*")


def _soromox(segments, dt):
    arguments = ("--segments", str(segments), "--dt", f"{dt:g}")
    name = f"soromox, {segments} segment{'s' * (segments > 1)}"
    return Peer(name, f"S{segments}", "soromox_rod.py", arguments, "soromox==0.5.*")


def _explicit(elements, case):
    arguments = ("--folder", str(REFERENCE), "--elements", str(elements), "--case", case)
    name = f"explicit finite differences, {elements} elements"
    return Peer(name, f"E{elements}", "explicit_rod.py", arguments, None)


def peers_of(case, quick: bool) -> list[Peer]:
    """Those that simulate this motion."""
    if case.reference is None:
        return []
    explicit = [_explicit(n, case.reference) for n in ((50,) if quick else (50, 100, 200, 330))]
    if case.reference != "gravity_step":
        return explicit
    if quick:
        return [_mujoco(2e-3), _elastica(10), _soromox(1, SOROMOX_STEPS[1]), *explicit]
    return [
        *(_mujoco(dt) for dt in (2e-2, 5e-3, 2e-3, 5e-4)),
        *(_elastica(elements) for elements in (10, 20, 50)),
        *(_soromox(segments, dt) for segments, dt in SOROMOX_STEPS.items()),
        *explicit,
    ]


class Running:
    """A driver that waits for requests."""

    def __init__(self, peer: Peer, python: str):
        self.peer, self.answers = peer, []
        self._process = subprocess.Popen(
            [python, str(DRIVERS / peer.driver), *peer.arguments],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
        )
        ready = self._read()
        self.setup = ready and ready["setup_seconds"]
        if ready:
            print(f"{peer.name}: {ready['version']}, ready in {self.setup:.1f} s", flush=True)

    def run(self) -> None:
        """One more run, unless it fails or those before took over 10 s."""
        if self.setup is None or any(a["seconds"] > 10 or a["tip"] is None for a in self.answers):
            return
        self._process.stdin.write("run\n")
        self._process.stdin.flush()
        answer = self._read()
        if answer:
            self.answers.append(answer)

    def close(self) -> None:
        self._process.stdin.close()
        self._process.wait()

    def _read(self):
        line = self._process.stdout.readline()
        if not line:
            print(f"{self.peer.name}: its driver ended, {self._process.wait()}: left out")
            self.setup = None
            return None
        return json.loads(line)


def start(peers: list[Peer], folder: Path | None) -> list[Running]:
    """The drivers that could be started. `folder`: of the environments; None: no packages."""
    running = []
    pythons = {None: sys.executable if REFERENCE.is_dir() else None}
    for peer in peers:
        if peer.requirement not in pythons:
            pythons[peer.requirement] = _environment(peer, folder)
        if pythons[peer.requirement] is not None:
            one = Running(peer, pythons[peer.requirement])
            if one.setup is not None:
                running.append(one)
    if pythons[None] is None and any(peer.requirement is None for peer in peers):
        print(f"explicit finite differences: no {REFERENCE}: left out")
    return running


def _environment(peer: Peer, folder: Path | None) -> str | None:
    """Python of the environment of a package, made where it is not there; None: it cannot be."""
    if folder is None:
        print(f"{peer.requirement}: left out without --peers DIR")
        return None
    place = folder / peer.requirement.replace("=", "").replace("<", "").replace("*", "")
    python, done = place / "bin" / "python", place / "installed"
    if not done.exists():
        pip = [str(python), "-m", "pip", "install", "-q", peer.requirement]
        for command in ([sys.executable, "-m", "venv", "--clear", str(place)], pip):
            if subprocess.run(command, capture_output=True).returncode:
                print(f"{peer.requirement}: could not be installed in {place}: left out")
                return None
        done.touch()
    return str(python)
