"""Times of a static solve, of a step of a motion and of gradients, with and without tendons.

    python benchmarks/timing.py [--write-docs]

The robot of `softrod_jax.hybrid_robot` under transverse gravity, 100 steps of 15 ms; with
tendons, one of the three pulls with 0.1 N. Medians of interleaved repeats. Compilation is
measured apart, with JAX's cache of compiled programs switched off. First calls are those of new
processes, without a cache of compiled programs and with one; importing is not in them.
"""

import functools
import os
import subprocess
import sys
import tempfile
import time

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from report import machine, publish, table

import softrod_jax as sr

REPEATS = 7
STEPS = 100
DT = 15e-3  # s
SCHEMES = {"`SDIRK(3)`": sr.SDIRK(3), "`BDFAlpha(-0.45)`": sr.BDFAlpha()}
FITTED = ("young_modulus", "bending_damping", "drag_coefficient")


def with_values(scene, values):
    """The scene with the `FITTED` parameters at `values`."""
    pick = lambda s: [getattr(s, name) for name in FITTED]
    return eqx.tree_at(pick, scene, list(values))


def programs(tension: bool):
    """{what is measured: (function of (E, B_bt, C), solves or steps it makes)}."""
    scene = sr.hybrid_robot(gravity=jnp.array([-9.81, 0.0, 0.0]))
    values = jnp.array([getattr(scene, name) for name in FITTED])
    one = jnp.array([0.1, 0.0, 0.0]) if tension else None
    many = jnp.tile(one, (STEPS, 1)) if tension else None
    steps = None if tension else STEPS

    def static(values):
        return sr.solve_static(with_values(scene, values), one, throw=False).tip_position

    def motion(scheme, values):
        moved = with_values(scene, values)
        options = dict(steps=steps, scheme=scheme, throw=False)
        return sr.simulate(moved, DT, many, **options).tip_positions

    def loss(scheme, values):
        return jnp.sum(motion(scheme, values) ** 2)

    found = {"static solve": (static, 1)}
    for name, scheme in SCHEMES.items():
        tips, number = functools.partial(motion, scheme), functools.partial(loss, scheme)
        found[f"step of {name}"] = tips, STEPS
        found[f"{name}, step and reverse gradient"] = jax.value_and_grad(number), STEPS
        found[f"{name}, step and forward Jacobian"] = jax.jacfwd(tips), STEPS
    return values, found


def measure():
    """{(what, with tendons): (time [s] per solve or step, time to compile [s])}."""
    compiled, compile_time, samples = {}, {}, {}
    for tension in (False, True):
        values, functions = programs(tension)
        for what, (function, count) in functions.items():
            begin = time.perf_counter()
            program = jax.jit(function).lower(values).compile()
            key = (what, tension)
            compile_time[key] = time.perf_counter() - begin
            compiled[key] = (program, values, count)
            jax.block_until_ready(program(values))
    # Interleaved, so that a slow moment of the machine does not fall on one program alone.
    for _ in range(REPEATS):
        for key, (program, values, count) in compiled.items():
            begin = time.perf_counter()
            jax.block_until_ready(program(values))
            samples.setdefault(key, []).append((time.perf_counter() - begin) / count)
    return {key: (np.median(samples[key]), compile_time[key]) for key in compiled}


def milliseconds(seconds) -> str:
    return f"{1e3 * seconds:.2g}" if seconds < 0.1 else f"{1e3 * seconds:.0f}"


FIRST = """
import time, jax
jax.config.update("jax_enable_x64", True)
jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.2)
import jax.numpy as jnp, softrod_jax as sr
scene = sr.hybrid_robot(gravity=jnp.array([-9.81, 0.0, 0.0]))
pull = jnp.array([0.1, 0.0, 0.0])
pulls = jnp.tile(pull, (200, 1))
begin = time.perf_counter()
jax.block_until_ready({call}.tip_position{s})
print(time.perf_counter() - begin)
"""
CALLS = {
    "`solve_static`": dict(call="sr.solve_static(scene, pull)", s=""),
    "`simulate`": dict(call="sr.simulate(scene, 5e-3, pulls)", s="s"),
}


def first_calls() -> list[list[str]]:
    """Rows: what is called, its time [s] in a new process, and in one after it."""
    rows = []
    for name, call in CALLS.items():
        with tempfile.TemporaryDirectory() as cache:
            environment = {**os.environ, "JAX_COMPILATION_CACHE_DIR": cache}
            command = [sys.executable, "-c", FIRST.format(**call)]
            rows.append([name])
            for _ in range(2):
                printed = subprocess.check_output(command, env=environment, text=True)
                rows[-1].append(f"{float(printed):.1f}")
    return rows


def main() -> None:
    measured = measure()
    rows = [
        [
            what,
            *(milliseconds(measured[what, tension][0]) for tension in (False, True)),
            *(f"{measured[what, tension][1]:.1f}" for tension in (False, True)),
        ]
        for what in dict.fromkeys(what for what, _ in measured)
    ]
    header = ["", "no tendons [ms]", "tendons [ms]", "compile [s]", "compile, tendons [s]"]
    first = table(["first call, tendons", "[s]", "with a cache on disk [s]"], first_calls())
    publish("timing", "benchmarks.md", f"{table(header, rows)}\n\n{first}\n\n{machine()}.")


if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    jax.config.update("jax_enable_compilation_cache", False)
    main()
