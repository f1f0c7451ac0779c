"""Several processes that JAX connects on this machine, for tests. None outlives its time."""

import os
import socket
import subprocess
import sys
import time

import jax

# A port that is free when it is asked for may be taken a moment later.
_PORTS_TRIED = 3
_PORT_TAKEN = ("address already in use", "failed to bind", "errno: 98", "errno 98")


def free_port() -> int:
    with socket.socket() as s:
        s.bind(("127.0.0.1", 0))
        return s.getsockname()[1]


def environment() -> dict:
    """Of a process that finds the tests' modules, and the cache of compiled programs."""
    return {
        **os.environ,
        "PYTHONPATH": os.pathsep.join([os.path.dirname(__file__), *sys.path]),
        "JAX_COMPILATION_CACHE_DIR": jax.config.jax_compilation_cache_dir,
    }


def run_together(script: str, count: int, *arguments: str, timeout: float) -> None:
    """`script` in `count` processes, with the coordinator's address and their own number.

    Raises `AssertionError` with what they wrote if one fails, or after `timeout` [s].
    """
    for _ in range(_PORTS_TRIED):
        failure = _run_once(script, count, arguments, f"127.0.0.1:{free_port()}", timeout)
        if failure is None:
            return
        if not any(words in failure.lower() for words in _PORT_TAKEN):
            break
    raise AssertionError(failure)


def _run_once(script, count, arguments, address, timeout) -> str | None:
    """What went wrong, None if nothing did."""
    running = [
        subprocess.Popen(
            [sys.executable, "-c", script, address, str(k), *arguments],
            env=environment(),
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )
        for k in range(count)
    ]
    deadline = time.monotonic() + timeout
    try:
        while any(p.poll() is None for p in running) and time.monotonic() < deadline:
            if any(p.returncode for p in running):
                break  # the others wait for it
            time.sleep(0.1)
        codes = [p.poll() for p in running]
    finally:
        for p in running:
            if p.poll() is None:
                p.kill()
        written = [p.communicate()[0] for p in running]
    if codes == [0] * count:
        return None
    late = f"no end within {timeout} s\n" if time.monotonic() >= deadline else ""
    parts = zip(range(count), codes, written, strict=True)
    return late + "\n".join(f"process {k}: {code}\n{text}" for k, code, text in parts)
