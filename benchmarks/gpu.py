"""Thousands of rods on a GPU: what a second of it computes, and what bounds it.

    python benchmarks/gpu.py [--small] [--minutes 6.5] [--sizes 1 256 65536] [--json FILE]
        [--render FILE] [--write-docs]

The robot of `hybrid_robot` under gravity, random tensions on all three tendons that rise within
0.1 s, motions of 1 s: equilibria, motions, reverse gradients and forward Jacobians by Young's
modulus, damping and drag, in batches by `jax.vmap`. Whatever is measured is printed at once, and
kept in FILE; after so many minutes the script ends with the tables of what there is. What matters
most comes first: programs are compiled several at a time, in waves, and nothing is compiled while
a wave is measured. Errors are those of 16 rods against a refined solution, which another process
computes on the CPU.

Kernels and bytes are counted in the compiled program, loop by loop (`launches.py`), and the passes
of its loops by a copy of it that counts. Without a GPU all of it runs on the CPU, with smaller
batches; the counted program is then the one for rods in lockstep, as on a GPU, which XLA optimised
for the CPU. --small is for tests. --render makes the tables from a FILE, --write-docs puts
them into `docs/pages/gpu.md`. JAX for CUDA is installed if there is a GPU, and it is not.
"""

import argparse
import importlib.util
import json
import os
import subprocess
import sys
import threading
from pathlib import Path

ROOT = Path(__file__).parents[1]
_INSTALLED = "SOFTROD_GPU_INSTALLED"


def install_if_needed() -> None:
    """JAX's plug-in for CUDA, where there is a GPU, and start again with it."""
    has = lambda name: importlib.util.find_spec(name) is not None
    plugin = any(has(f"jax_cuda{k}_plugin") for k in (12, 13))
    needed = Path("/dev/nvidiactl").exists() and not (plugin and has("diffrax"))
    if not needed or os.environ.get(_INSTALLED):
        return
    command = [sys.executable, "-m", "pip", "install", "-q", "jax[cuda12]", str(ROOT)]
    done = subprocess.run(command).returncode
    print(f"installing JAX for CUDA: {'done' if done == 0 else 'failed'}", flush=True)
    os.environ[_INSTALLED] = "1"
    os.execv(sys.executable, [sys.executable, *sys.argv])


if __name__ == "__main__":
    install_if_needed()
    # Most of the memory, and not the three quarters that JAX takes by itself.
    os.environ.setdefault("XLA_PYTHON_CLIENT_MEM_FRACTION", "0.93")
    sys.path.insert(0, str(ROOT))

import jax

jax.config.update("jax_enable_x64", True)

import numpy as np
from gpu_jobs import Report
from gpu_programs import JUDGED, SIZES, STEPS, refined
from gpu_run import Run
from gpu_tables import render
from report import put


def main(arguments: list[str] | None = None) -> list[dict]:
    parser = argparse.ArgumentParser()
    parser.add_argument("--small", action="store_true")
    parser.add_argument("--minutes", type=float, default=6.5)
    parser.add_argument("--sizes", type=int, nargs="+")
    parser.add_argument("--steps", type=int, default=STEPS)
    parser.add_argument("--json")
    parser.add_argument("--render")
    parser.add_argument("--write-docs", action="store_true")
    parser.add_argument("--reference", help=argparse.SUPPRESS)
    options = parser.parse_args(arguments)
    if options.reference:
        np.save(options.reference, refined(JUDGED, options.steps))
        return []
    if options.render:
        rows = json.loads(Path(options.render).read_text(encoding="utf-8"))
        return finish(rows, options.write_docs)
    report = Report(options.json, options.minutes)
    on_gpu = jax.default_backend() == "gpu"
    sizes = options.sizes or ([2] if options.small else SIZES if on_gpu else SIZES[:3])
    if arguments is None:
        # Whatever hangs: what has been measured is shown in time.
        def enough():
            finish(report.rows, options.write_docs)
            sys.stdout.flush()
            os._exit(0)

        timer = threading.Timer(report.seconds, enough)
        timer.daemon = True
        timer.start()
    run = Run(report, sizes, 3 if options.small else options.steps, options.small)
    run.go()
    finish(report.rows, options.write_docs)
    return report.rows


def finish(rows: list[dict], write: bool) -> list[dict]:
    text = render(rows)
    print(text, flush=True)
    if write:
        put("gpu", "gpu.md", text)
    return rows


if __name__ == "__main__":
    main()
    sys.stdout.flush()
    # Programs that are still being compiled are not waited for.
    os._exit(0)
