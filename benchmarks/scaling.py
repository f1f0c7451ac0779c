"""Weak scaling: more devices and as many more rods, in one process and in several.

    python benchmarks/scaling.py [--rods 64] [--write-docs]

`sr.spread` over the devices of one process, and over processes that `jax.distributed` connects on
this machine. The motions of `benchmarks/batches.py`, so many `--rods` for each device; the time
is that of a whole call, with the result gathered in each process. The first rods must move as
those of one device.
"""

import argparse
import socket
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from report import machine, publish, table

# (processes, devices of each)
ARRANGEMENTS = [(1, 1), (1, 2), (2, 1)]
ROUNDS, CALLS, TIMEOUT = 3, 5, 600
_WORKER = "--worker"


def work(address: str, processes: int, number: int, devices: int, rods: int, out: str) -> None:
    """One process of an arrangement: times of its calls [s] and the first rods' tips, to `out`."""
    import jax

    jax.config.update("jax_enable_x64", True)
    jax.config.update("jax_num_cpu_devices", devices)
    if processes > 1:
        jax.distributed.initialize(address, processes, number, initialization_timeout=60)
    import jax.numpy as jnp

    import softrod_jax as sr

    dt, steps, rise = 15e-3, 40, 5
    scene = sr.hybrid_robot(gravity=jnp.array([-9.81, 0.0, 0.0]))
    ramp = np.minimum(1.0, np.arange(1, steps + 1) / rise)[:, None]
    count = rods * processes * devices
    most = np.random.default_rng(0).uniform(size=(count, 1, 4)) * [0.3, 0.3, 0.3, 1e4]

    def tip(inputs):
        motion = sr.simulate(
            scene,
            dt,
            inputs[:, :3],
            inputs[:, 3:],
            scheme=sr.BDFAlpha(),
            method=sr.Collocation(6),
            max_time_error=jnp.inf,
            throw=False,
        )
        # What fails is not fast: it must not count.
        return jnp.where(motion.result == 0, motion.tip_positions, jnp.nan)

    inputs, mapped, times = most * ramp, sr.spread(tip), []
    for _ in range(1 + CALLS):
        begin = time.perf_counter()
        tips = jax.block_until_ready(mapped(inputs))
        times.append(time.perf_counter() - begin)
    np.savez(f"{out}/{number}.npz", times=times[1:], tips=tips[:rods])


def measure(processes: int, devices: int, rods: int) -> tuple[np.ndarray, np.ndarray]:
    """Times of the slowest process's calls [s], and the tips of the first rods."""
    with socket.socket() as s:
        s.bind(("127.0.0.1", 0))
        address = f"127.0.0.1:{s.getsockname()[1]}"
    with tempfile.TemporaryDirectory() as out:
        command = [sys.executable, __file__, _WORKER, address, str(processes)]
        running = [
            subprocess.Popen([*command, str(k), str(devices), str(rods), out])
            for k in range(processes)
        ]
        try:
            codes = [p.wait(TIMEOUT) for p in running]
        finally:
            for p in running:
                p.kill()
        if any(codes):
            raise RuntimeError(f"{processes} processes of {devices} devices ended with {codes}")
        found = [np.load(Path(out) / f"{k}.npz") for k in range(processes)]
        return np.max([x["times"] for x in found], axis=0), found[0]["tips"]


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--rods", type=int, default=64)
    parser.add_argument("--write-docs", action="store_true")
    rods = parser.parse_args().rods
    taken = {arrangement: [] for arrangement in ARRANGEMENTS}
    for _ in range(ROUNDS):
        for arrangement, times in taken.items():
            some, tips = measure(*arrangement, rods)
            times += list(some)
            if arrangement == ARRANGEMENTS[0]:
                on_one = tips
            np.testing.assert_allclose(tips, on_one, rtol=0, atol=1e-12)
    rows = []
    for (processes, devices), times in taken.items():
        ratio = np.median(taken[ARRANGEMENTS[0]]) / np.median(times)
        call, low, high = np.median(times), min(times), max(times)
        total = rods * processes * devices
        row = [str(processes), str(devices), str(total), f"{call:.2f} ({low:.2f} to {high:.2f})"]
        rows.append([*row, f"{1e3 * call / rods:.1f}", f"{total / call:.0f}", f"{ratio:.2f}"])
    header = [
        "processes",
        "devices of each",
        "rods",
        "time, fastest to slowest [s]",
        "time of a rod on its device [ms]",
        "rods a second",
        "efficiency",
    ]
    publish("scaling", "benchmarks.md", f"{table(header, rows)}\n\n{machine()}.")


if __name__ == "__main__":
    if _WORKER in sys.argv[1:2]:
        address, out = sys.argv[2], sys.argv[7]
        work(address, *(int(x) for x in sys.argv[3:7]), out)
    else:
        main()
