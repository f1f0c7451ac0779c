"""Many rods at once: the time of a step of one rod, alone and in batches.

    python benchmarks/batches.py [--sizes 1 16 256] [--write-docs]

Random tensions on all three tendons of `hybrid_robot` and a random pressure rise within 75 ms,
gravity and drag act, a step is 15 ms. Batches by `jax.vmap` on one device, and by `sr.spread` on
all: on a CPU, one for each core that this process may use. The errors are those of the first rods
against a refined solution. On a GPU, sizes go up to 65,536 rods.
"""

import argparse
import os
import time

import jax

jax.config.update("jax_enable_x64", True)
CORES = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
jax.config.update("jax_num_cpu_devices", CORES)

import jax.numpy as jnp
import numpy as np
from report import machine, publish, table

import softrod_jax as sr

DT, STEPS, RISE, ROUNDS = 15e-3, 40, 5, 3
SETTINGS = {
    "`BDFAlpha(-0.45)`, 6 intervals": (sr.BDFAlpha(-0.45), sr.Collocation(6)),
    "`BDFAlpha(-0.45)`, 12 intervals": (sr.BDFAlpha(-0.45), sr.Collocation()),
}
REFINED = dict(scheme=sr.SDIRK(4), method=sr.Collocation(12), substeps=5)
SCENE = sr.hybrid_robot(gravity=jnp.array([-9.81, 0.0, 0.0]))


def actuations(count):
    """Tensions (count, steps, 3) [N] and pressures (count, steps, 1) [Pa]."""
    rise = np.minimum(1.0, np.arange(1, STEPS + 1) / RISE)[:, None]
    most = np.random.default_rng(0).uniform(size=(count, 1, 4)) * [0.3, 0.3, 0.3, 1e4]
    both = jnp.array(most * rise)
    return both[..., :3], both[..., 3:]


def tip(tensions, pressures, **options):
    motion = sr.simulate(
        SCENE, DT, tensions, pressures, max_time_error=jnp.inf, throw=False, **options
    )
    # What fails is not fast: it must not count.
    return jnp.where(motion.result == 0, motion.tip_positions, jnp.nan)


def programs(scheme, method, size):
    one = lambda *inputs: tip(*inputs, scheme=scheme, method=method)
    if size == 1:
        return {"alone": jax.jit(lambda T, p: one(T[0], p[0])[None])}
    several = {"`vmap`": jax.jit(jax.vmap(one))}
    if jax.device_count() > 1:
        several["`spread`"] = sr.spread(one)
    return several


def measure(scheme, method, sizes):
    """{(size, how): median time of a step of one rod [s]}, and the tips of the first rods."""
    compiled = {}
    for size in sizes:
        inputs = actuations(size)
        for how, program in programs(scheme, method, size).items():
            tips = jax.block_until_ready(program(*inputs))
            compiled[size, how] = program, inputs
    taken = {key: [] for key in compiled}
    for _ in range(ROUNDS):
        for key, (program, inputs) in compiled.items():
            begin = time.perf_counter()
            jax.block_until_ready(program(*inputs))
            taken[key].append((time.perf_counter() - begin) / (key[0] * STEPS))
    return {key: np.median(times) for key, times in taken.items()}, tips[:4]


def main():
    on_gpu = jax.default_backend() != "cpu"
    parser = argparse.ArgumentParser()
    default = [1, *4 ** np.arange(2, 9)] if on_gpu else [1, 16, 256]
    parser.add_argument("--sizes", type=int, nargs="+", default=default)
    parser.add_argument("--write-docs", action="store_true")
    sizes = parser.parse_args().sizes
    few = actuations(max(sizes))
    exact = jnp.stack([tip(few[0][k], few[1][k], **REFINED) for k in range(min(4, max(sizes)))])
    rows = []
    for name, (scheme, method) in SETTINGS.items():
        times, tips = measure(scheme, method, sizes)
        error = jnp.max(jnp.linalg.norm(tips - exact, axis=-1))
        alone = times.get((1, "alone"))
        for (size, how), taken in times.items():
            ratio = "" if alone is None else f"{alone / taken:.1f}"
            row = [name, f"{error:.0e}".replace("e-0", "e-"), str(size), how]
            rows.append([*row, f"{1e3 * taken:.2g}", ratio, f"{DT / taken:.0f}"])
            print(rows[-1], flush=True)
    header = [
        "",
        "error [m]",
        "rods",
        "how",
        "step of a rod [ms]",
        "alone / this",
        "times real time",
    ]
    where = f"{machine()}, {jax.device_count()} of `{jax.devices()[0].device_kind}`"
    publish("batches", "benchmarks.md", f"{table(header, rows)}\n\n{where}.")


if __name__ == "__main__":
    main()
