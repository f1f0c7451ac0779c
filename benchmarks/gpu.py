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
import concurrent.futures
import contextlib
import dataclasses
import functools
import importlib.util
import json
import os
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

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

import equinox as eqx
import jax

jax.config.update("jax_enable_x64", True)

import jax.numpy as jnp
import launches
import numpy as np
from limits import operations
from report import machine, table
from timing import FITTED, with_values

import softrod_jax as sr
from softrod_jax.bvp import block_sweep
from softrod_jax.bvp.equations import Equations
from softrod_jax.bvp.unloaded import unloaded_guess
from softrod_jax.foundation.compiling import compiler_options, in_lockstep
from softrod_jax.rod.constitutive import compliance, recover_strain
from softrod_jax.rod.ode import pointwise_problem
from softrod_jax.rod.reduction import make_rod
from softrod_jax.rod.state import History, layout_of
from softrod_jax.scene.inputs import Inputs
from softrod_jax.stepping import inertial_continuation

PAGE = ROOT / "docs" / "pages" / "gpu.md"
DT, STEPS, RISE, MOST_TENSION, JUDGED = 20e-3, 50, 0.1, 0.3, 16
SIZES = 1, 16, 256, 1024, 4096, 16384, 65536
SCENE = sr.hybrid_robot(gravity=jnp.array([-9.81, 0.0, 0.0]))
VALUES = jnp.array([getattr(SCENE, name) for name in FITTED])
# A measurement ends after so many calls, or so many seconds.
CALLS, SECONDS = 5, 1.5


@dataclasses.dataclass(frozen=True)
class Setting:
    scheme: Any
    method: Any
    substeps: int = 1
    tolerance: float = sr.NewtonOptions().tolerance

    def __str__(self):
        scheme, method = self.scheme, self.method
        stages = (
            f", {scheme.stages} stages" if scheme.stages != sr.SDIRK(scheme.order).stages else ""
        )
        return (
            f"SDIRK({scheme.order}{stages}), {1e3 * DT / self.substeps:g} ms, {method.intervals} "
            f"intervals of order {method.order}, Newton's method to {self.tolerance:g}"
        )


# Of those that keep 1e-3 lengths on this robot the one with the fewest evaluations along the rod.
# Newton's method stops where what it leaves is a hundredth of the error in time.
COARSE = Setting(sr.SDIRK(3, stages=6), sr.Collocation(5), tolerance=1e-5)
DEFAULT = Setting(sr.SDIRK(3), sr.Collocation())
REFINED = Setting(sr.SDIRK(4), sr.Collocation(12), 8)
TIGHT = dataclasses.replace(COARSE, tolerance=DEFAULT.tolerance)
SETTINGS = {"1e-3 L": COARSE, "1e-3 L, solved tightly": TIGHT, "default": DEFAULT}
# Gradients of so many rods at a time: what reverse mode keeps of a motion fills the memory.
CHUNK = 16384


def tensions(count: int, steps: int):
    """(count, steps, 3) [N]; the first rods are the same whatever the count."""
    most = np.random.default_rng(0).uniform(size=(count, 1, 3)) * MOST_TENSION
    return most * np.minimum(1.0, np.arange(steps) * DT / RISE)[:, None]


# What is counted when a program runs, and the function that is called as often.
COUNTED = {"evaluations": "residual", "factorisations": "factorise", "attempts": "search_directly"}


# What is measured, of one rod: functions of (E, damping, drag) and tensions.


def equilibrium(values, tensions):
    scene = with_values(SCENE, values)
    solution = sr.solve_static(scene, tensions[-1], method=sr.Collocation(), throw=False)
    return solution.tip_position, solution.result, solution.stats["iterations"]


def motion(setting: Setting, values, tensions):
    moved = sr.simulate(
        with_values(SCENE, values),
        DT,
        tensions,
        scheme=setting.scheme,
        method=setting.method,
        substeps=setting.substeps,
        newton=sr.NewtonOptions(tolerance=setting.tolerance),
        max_time_error=jnp.inf,
        throw=False,
    )
    return moved.tip_positions, moved.result, jnp.sum(moved.stats["iterations"])


def reverse(setting: Setting, values, tensions):
    def loss(values):
        tips, *rest = motion(setting, values, tensions)
        return jnp.sum(tips**2), (tips, *rest)

    (_, (tips, *rest)), slope = jax.value_and_grad(loss, has_aux=True)(values)
    return tips, *rest, slope


def forward(setting: Setting, values, tensions):
    def tips(values):
        tips, *rest = motion(setting, values, tensions)
        return tips, (tips, *rest)

    slope, (tips, *rest) = jax.jacfwd(tips, has_aux=True)(values)
    return tips, *rest, slope


GRADIENTS = {"reverse gradient": reverse, "forward Jacobian": forward}
KINDS = {"motion": motion, **GRADIENTS}


@dataclasses.dataclass
class Job:
    """A program to be compiled and measured.

    `measure(compiled, arguments, seconds to trace and compile)` makes the row of the report.
    """

    name: str
    function: Callable
    arguments: tuple
    measure: Callable
    x64: bool = True
    key: tuple = ()
    size: int = 1

    def lower(self):
        with jax.enable_x64(self.x64), jax.default_matmul_precision("highest"):
            program = jax.jit(self.function, compiler_options=compiler_options())
            return program.lower(*self.arguments)


class Report:
    """Rows of measurements, printed and kept as soon as they are there."""

    def __init__(self, file: str | None, minutes: float):
        self.begin, self.seconds = time.perf_counter(), 60 * minutes
        self.file, self.rows, self.lock = file, [], threading.RLock()

    @property
    def left(self) -> float:
        return self.seconds - (time.perf_counter() - self.begin)

    def add(self, part: str, **row) -> dict:
        with self.lock:
            row = {"part": part, **row, "at": round(self.seconds - self.left, 1)}
            self.rows.append(row)
            shown = {k: v for k, v in row.items() if k not in ("tips", "loops")}
            short = lambda v: float(f"{v:.4g}") if isinstance(v, float) else v
            print(json.dumps({k: short(v) for k, v in shown.items()}), flush=True)
            if self.file:
                Path(self.file).write_text(json.dumps(self.rows), encoding="utf-8")
            return row

    def select(self, part: str, **wanted) -> list[dict]:
        with self.lock:
            rows = [row for row in self.rows if row["part"] == part]
        return [row for row in rows if all(row.get(k) == v for k, v in wanted.items())]


def out_of_memory(error: Exception) -> bool:
    return "RESOURCE_EXHAUSTED" in str(error) or "out of memory" in str(error).lower()


def run_timed(call: Callable) -> tuple[float, Any]:
    begin = time.perf_counter()
    out = jax.block_until_ready(call())
    return time.perf_counter() - begin, out


def clock(call: Callable) -> float:
    return run_timed(call)[0]


def needed_memory(compiled) -> int:
    sizes = compiled.memory_analysis()
    if sizes is None:
        return 0
    parts = ("argument_size_in_bytes", "output_size_in_bytes", "temp_size_in_bytes")
    return sum(getattr(sizes, part) for part in parts)


def device_memory(what: str) -> int | None:
    return (jax.devices()[0].memory_stats() or {}).get(what)


def analysed(compiled) -> dict:
    """XLA's own count, in which loops pass once."""
    costs = compiled.cost_analysis() or {}
    costs = costs[0] if isinstance(costs, list) else costs
    return {name: costs.get(name) for name in ("flops", "bytes accessed")}


class Run:
    """One run of the script: what is to be measured, and how."""

    def __init__(self, report: Report, sizes, steps: int, small: bool):
        self.report, self.steps, self.small = report, steps, small
        self.sizes, self.middle = sorted(sizes), min(4096, max(sizes))
        self.on_gpu = jax.default_backend() == "gpu"
        self.reference = None
        self.counts: dict[str, int] = {}

    # Jobs

    def batch(self, name: str, key: tuple, function: Callable, size: int, seconds: float) -> Job:
        arguments = jnp.tile(VALUES, (size, 1)), jnp.array(tensions(size, self.steps))
        mapped = jax.vmap(function)
        if size == 1:
            one = lambda *a: jax.tree.map(lambda x: x[None], function(*[x[0] for x in a]))
            mapped = one
        elif name in GRADIENTS and size > CHUNK:
            mapped = lambda *a: jax.lax.map(lambda a: function(*a), a, batch_size=CHUNK)

        def measure(compiled, arguments, times):
            row = dict(name=name, setting=key[1], rods=size, **times)
            row |= dict(at_a_time=min(size, CHUNK if name in GRADIENTS else size))
            memory, limit = needed_memory(compiled), device_memory("bytes_limit")
            row |= dict(memory=memory, bytes_a_rod=memory / size, **analysed(compiled))
            if limit and memory > limit:
                return self.report.add("batch", **row, problem="more memory than there is")
            known = self.report.select("batch", name=name, setting=key[1])
            known = [old for old in known if "seconds" in old and old["rods"] <= size]
            ahead = max((old["seconds"] * size / old["rods"] for old in known), default=0.0)
            if ahead > self.report.left - 10:
                return self.report.add("batch", **row, problem="no time left")
            first, out = run_timed(lambda: compiled(*arguments))
            # What takes long has warmed up by itself.
            taken, begin = [first] if first > 10 else [], time.perf_counter()
            while not taken or len(taken) < CALLS and time.perf_counter() - begin < SECONDS:
                taken.append(clock(lambda: compiled(*arguments)))
            tips, codes, passes = (np.asarray(x) for x in out[:3])
            median = float(np.median(taken))
            steps = self.steps * (1 if seconds == 0 else SETTINGS[key[1]].substeps)
            row |= dict(
                first=first,
                seconds=median,
                calls=len(taken),
                solved=float(np.mean(codes == 0)),
                evaluations_mean=float(passes.mean()),
                evaluations_max=int(passes.max()),
                rods_a_second=size / median,
                peak_memory=device_memory("peak_bytes_in_use"),
                tips=tips[:JUDGED].tolist(),
            )
            if seconds:
                row |= dict(
                    rod_steps_a_second=size * steps / median,
                    rod_seconds_a_second=size * seconds / median,
                )
            self.report.add("batch", **row)
            if key[1] == "1e-3 L" and size == self.middle and (self.on_gpu or name != "motion"):
                self.loops(name, compiled, median)

        return Job(f"{name}, {key[1]}, {size} rods", mapped, arguments, measure, True, key, size)

    def of_motion(self, name: str, setting: str, size: int) -> Job:
        function = functools.partial(KINDS[name], SETTINGS[setting])
        return self.batch(name, (name, setting), function, size, self.steps * DT)

    def of_equilibrium(self, size: int) -> Job:
        return self.batch("equilibrium", ("equilibrium", ""), equilibrium, size, 0.0)

    def loops(self, name: str, compiled, seconds: float) -> None:
        """What the compiled program launches and moves, and the time that this predicts."""
        whole = launches.program(compiled.as_text())
        shown = [
            dict(
                depth=depth,
                name=loop.name,
                passes=loop.passes,
                kernels=loop.kernels,
                products=loop.products,
                bytes=loop.bytes,
            )
            for depth, loop in whole.walk()
        ]
        row: dict[str, Any] = dict(name=name, rods=self.middle, seconds=seconds)
        if self.counts and name == "motion":
            row |= self.predict(whole)
        self.report.add("loops", **row, loops=shown)

    def predict(self, whole: launches.Loop) -> dict:
        counts, runs = self.counts, functools.partial(passes_of, self.counts)
        kernels = whole.total(lambda loop: loop.kernels, runs)
        moved = whole.total(lambda loop: loop.bytes, runs)
        waits = sum(counts.get(k, 0) for k in ("attempts", "factorisations", "evaluations"))
        limits = {row["name"]: row["value"] for row in self.report.select("device")}
        return dict(
            kernels=kernels,
            kernels_a_step=kernels / (self.steps * COARSE.substeps),
            bytes_moved=moved,
            bytes_a_rod_step=moved / (self.steps * COARSE.substeps * self.middle),
            waits=waits,
            launching=kernels * limits.get("kernel in a loop", 0.0)
            + waits * limits.get("pass of a loop of unknown length", 0.0),
            moving=moved / limits.get("copying", np.inf),
        )

    # Pieces

    def pieces(self, x64: bool) -> list[Job]:
        """The parts of Newton's method on the default grid, each by itself."""
        kind = "float64" if x64 else "float32"
        method = sr.Collocation(2) if self.small else sr.Collocation()
        made = pieces_of_newton(method)
        jobs = []
        for name, (function, arguments) in made.items():
            cast = lambda x: x if x64 or not eqx.is_inexact_array(x) else x.astype(kind)
            arrays, static = eqx.partition(jax.tree.map(cast, arguments), eqx.is_array)
            one = lambda arrays, static=static, function=function: function(
                *eqx.combine(arrays, static)
            )
            try:
                count = operations(jax.make_jaxpr(one)(arrays).jaxpr) if x64 else None
            except ValueError:
                count = None
            size = self.middle
            many = jax.tree.map(lambda x, n=size: jnp.tile(x, (n, *[1] * x.ndim)), arrays)

            def measure(compiled, arguments, times, name=name, count=count):
                first = clock(lambda: compiled(*arguments))
                first = clock(lambda: compiled(*arguments))
                calls = int(np.clip(0.3 / first, 1, 50))

                def several():
                    for _ in range(calls):
                        out = compiled(*arguments)
                    return out

                taken = float(np.median([clock(several) / calls for _ in range(3)]))
                whole = launches.program(compiled.as_text())
                unknown = any(loop.passes is None for _, loop in whole.walk())
                none = lambda loop: None
                self.report.add(
                    "piece",
                    name=name,
                    numbers=kind,
                    rods=self.middle,
                    **times,
                    seconds=taken,
                    one_call=first,
                    operations=None if count is None else count * self.middle,
                    kernels=whole.total(lambda loop: loop.kernels, none),
                    bytes_moved=whole.total(lambda loop: loop.bytes, none),
                    loops_of_unknown_length=unknown,
                    memory=needed_memory(compiled),
                )

            job = Job(f"{name}, {kind}", jax.vmap(one), (many,), measure, x64, size=size)
            jobs.append(job)
        return jobs

    # The device, and the passes of its loops

    def device(self) -> None:
        """What the device can do at most, and what a launch costs."""
        add = functools.partial(self.report.add, "device")
        jit = lambda f: jax.jit(f, compiler_options=compiler_options())

        def chain(x):
            for _ in range(8):
                x = x - jnp.mean(jnp.sin(x))
            return x

        passes = 1000 if self.on_gpu else 20
        run = jit(lambda x: jax.lax.fori_loop(0, passes, lambda _, x: chain(x), x))
        x = jnp.ones(1024)
        compiled = run.lower(x).compile()
        count = launches.program(compiled.as_text()).total(
            lambda loop: loop.kernels, lambda loop: None
        )
        clock(lambda: compiled(x))
        add(name="kernel in a loop", value=clock(lambda: compiled(x)) / count, unit="s", of=count)
        wait = jit(lambda x: jax.lax.while_loop(lambda x: x[0] < passes, lambda x: x + 1.0, x))
        zero = jnp.zeros(4)
        clock(lambda: wait(zero))
        taken = clock(lambda: wait(zero)) / passes
        add(name="pass of a loop of unknown length", value=taken, unit="s")
        large = jnp.ones(2**28 if self.on_gpu else 2**18)
        double = jit(lambda x: 1.5 * x)
        clock(lambda: double(large))
        taken = min(clock(lambda: double(large)) for _ in range(5))
        add(name="copying", value=2 * large.nbytes / taken, unit="B/s")
        del large
        n = 8192 if self.on_gpu else 256
        product = jit(lambda a, b: jnp.matmul(a, b, precision="highest"))
        for kind in ("float64", "float32"):
            a = jnp.full((n, n), 0.5, kind)
            clock(lambda a=a: product(a, a))
            taken = min(clock(lambda a=a: product(a, a)) for _ in range(3))
            add(name=f"products, {kind}", value=2 * n**3 / taken, unit="op/s")

    def counting(self) -> Job:
        """The motion of `COARSE` that counts the passes of its loops, all samples in lockstep."""
        ticks: dict[str, int] = dict.fromkeys(COUNTED, 0)
        function = functools.partial(motion, COARSE)
        arguments = (
            jnp.tile(VALUES, (self.middle, 1)),
            jnp.array(tensions(self.middle, self.steps)),
        )

        def measure(compiled, arguments, times):
            del times
            ticks.update(dict.fromkeys(COUNTED, 0))
            out = jax.block_until_ready(compiled(*arguments))
            jax.effects_barrier()
            self.counts = dict(ticks)
            own = np.asarray(out[2])
            stages = self.steps * COARSE.substeps * COARSE.scheme.stages
            self.report.add(
                "lockstep",
                rods=self.middle,
                solves=stages,
                **self.counts,
                evaluations_mean=float(own.mean()),
                evaluations_most=int(own.max()),
                lockstep_over_mean=self.counts.get("evaluations", 0) / float(own.mean()),
            )

        job = Job("passes of loops", jax.vmap(function), arguments, measure, size=self.middle)
        with in_lockstep(), counted(ticks):
            lowered = job.lower()
        job.lower = lambda: lowered
        return job

    def lockstep(self) -> Job:
        """The motion of `COARSE` as a GPU has it, on a CPU: what it would launch."""
        arguments = (
            jnp.tile(VALUES, (self.middle, 1)),
            jnp.array(tensions(self.middle, self.steps)),
        )

        def measure(compiled, arguments, times):
            del times
            self.loops("motion", compiled, clock(lambda: compiled(*arguments)))

        function = jax.vmap(functools.partial(motion, COARSE))
        job = Job("motion in lockstep", function, arguments, measure, size=self.middle)
        with in_lockstep():
            lowered = job.lower()
        job.lower = lambda: lowered
        return job

    # All of it

    def go(self) -> None:
        self.report.add("machine", name=machine(), device=jax.devices()[0].device_kind)
        if not self.small:
            self.report.add("float32", refused=float32_refused())
        self.device()
        every = Reference(self)
        middle, at = self.middle, self.of_motion
        # Largest and smallest tell most.
        others = [n for n in self.sizes if n != middle]
        order = [others[-1:], others[:1], others[-2:-1], others[1:-2]]
        sizes = list(dict.fromkeys(n for part in order for n in part))
        # Tracing it must not meet the other programs' traces: it comes first.
        counting = [self.counting(), *([] if self.on_gpu else [self.lockstep()])]
        if self.small:
            waves = [
                [
                    *counting,
                    at("motion", "1e-3 L", middle),
                    at("reverse gradient", "1e-3 L", middle),
                ]
                + [self.pieces(x64)[0] for x64 in (True, False)]
            ]
        else:
            tight = "1e-3 L, solved tightly"
            waves = [
                [at("motion", "1e-3 L", n) for n in others[-1:]]
                + [*counting, at("motion", "1e-3 L", middle)]
                + [at(name, "1e-3 L", middle) for name in GRADIENTS]
                + [at("motion", tight, n) for n in (middle, *others[-1:])],
                [at(name, "1e-3 L", n) for n in others[-1:] for name in GRADIENTS]
                + self.pieces(True)
                + [at("motion", "default", middle), self.of_equilibrium(middle)],
                [at("motion", "1e-3 L", n) for n in sizes[1:3]]
                + [self.of_equilibrium(n) for n in sizes[:2]]
                + [at(name, "1e-3 L", n) for n in sizes[1:2] for name in GRADIENTS]
                + [at("motion", "default", n) for n in sizes[:2]],
                [at("motion", "1e-3 L", n) for n in sizes[3:]]
                + [at(name, "default", middle) for name in GRADIENTS],
                [at(name, "1e-3 L", n) for n in sizes[2:] for name in GRADIENTS]
                + [self.of_equilibrium(n) for n in sizes[2:]]
                + [at("motion", "default", n) for n in sizes[2:]]
                + self.pieces(False)[:4],
            ]
        for wave in waves:
            if self.report.left < 20:
                break
            measure_wave(wave, self.report, workers=8 if self.on_gpu else 1)
            every.judge(wait=wave is waves[-1])


class Reference:
    """The refined motion of the first rods, by another process where there is a GPU."""

    def __init__(self, run: Run):
        self.run, self.file, self.process, self.exact = run, None, None, None
        if run.on_gpu:
            self.file = Path(tempfile.mkdtemp()) / "reference.npy"
            command = [sys.executable, __file__, "--reference", str(self.file)]
            environment = {**os.environ, "JAX_PLATFORMS": "cpu", _INSTALLED: "1"}
            self.process = subprocess.Popen(command, env=environment)

    def tips(self, wait: bool):
        """`None` if they are not there yet."""
        if self.exact is None and self.process is None:
            self.exact = refined(min(JUDGED, self.run.middle), self.run.steps)
        if self.exact is None and self.process is not None and self.file is not None:
            with contextlib.suppress(subprocess.TimeoutExpired):
                self.process.wait(max(self.run.report.left - 5, 0) if wait else 0)
                self.exact = np.load(self.file)
        return self.exact

    def judge(self, wait: bool) -> None:
        """The errors of all motions that are not judged yet."""
        report, exact = self.run.report, self.tips(wait)
        if exact is None:
            return
        for row in report.select("batch"):
            of = {name: row[name] for name in ("name", "setting", "rods")}
            if row["name"] == "equilibrium" or "tips" not in row or report.select("error", **of):
                continue
            tips = np.array(row["tips"])
            off = np.linalg.norm(tips - exact[: len(tips)], axis=-1).max(1) / float(SCENE.length)
            largest, median = float(off.max()), float(np.median(off))
            report.add("error", **of, judged=len(tips), largest=largest, median=median)


def refined(count: int, steps: int):
    """Tips (count, steps + 1, 3) of the first rods."""
    arguments = jnp.tile(VALUES, (count, 1)), jnp.array(tensions(count, steps))
    run = jax.vmap(functools.partial(motion, REFINED))
    tips, codes, _ = jax.jit(run, compiler_options=compiler_options())(*arguments)
    if np.any(codes != 0):
        raise RuntimeError(f"refined: codes {np.unique(codes)}")
    return np.asarray(tips)


def measure_wave(jobs: list[Job], report: Report, workers: int) -> None:
    """Compile several programs at a time, and then measure them in turn."""
    lock = threading.Lock()

    def compile_one(job):
        begin = time.perf_counter()
        with lock:
            # Tracing holds Python anyway, and is not known to be safe in threads.
            lowered = job.lower()
            tracing = time.perf_counter() - begin
        begin = time.perf_counter()
        return lowered.compile(), tracing, time.perf_counter() - begin

    pool = concurrent.futures.ThreadPoolExecutor(workers)
    pending = {pool.submit(compile_one, job): job for job in jobs}
    # Half of what is left: the other half is for measuring.
    concurrent.futures.wait(pending, timeout=max(report.left / 2, 1))
    late = sum(not future.done() for future in pending)
    if late:
        report.add("late", programs=late)
    for future, job in pending.items():
        if report.left < 8:
            break
        if not future.done() and (report.left < 60 or future.cancel()):
            report.add("skipped", name=job.name, problem="not compiled in time")
            continue
        try:
            compiled, tracing, compiling = future.result(timeout=max(report.left / 2, 1))
            job.measure(compiled, job.arguments, dict(trace=tracing, compile=compiling))
        except concurrent.futures.TimeoutError:
            report.add("skipped", name=job.name, problem="not compiled in time")
        except Exception as error:  # of whatever kind: the others are still to be measured
            if not report.file and not out_of_memory(error) and "pytest" in sys.modules:
                raise
            report.add("skipped", name=job.name, problem=str(error)[:300])
    pool.shutdown(wait=False, cancel_futures=True)


@contextlib.contextmanager
def counted(ticks: dict[str, int]):
    """Programs traced here add to `ticks` when they run: once a pass for a batch in lockstep."""

    def ticking(name, function):
        def tick():
            ticks[name] = ticks.get(name, 0) + 1

        @jax.custom_batching.custom_vmap
        def passing(x):
            jax.debug.callback(tick)
            return x

        @passing.def_vmap
        def _(size, batched, x):
            jax.debug.callback(tick)
            return x, batched[0]

        def call(*arguments, **options):
            passing(jnp.zeros(()))
            return function(*arguments, **options)

        return call

    places = list(zip((Equations, Equations, inertial_continuation), COUNTED.values(), COUNTED))
    before = [getattr(place, attribute) for place, attribute, _ in places]
    jax.clear_caches()
    try:
        for (place, attribute, name), old in zip(places, before):
            setattr(place, attribute, ticking(name, old))
        yield
    finally:
        for (place, attribute, _), old in zip(places, before):
            setattr(place, attribute, old)
        jax.clear_caches()


def passes_of(counts: dict[str, int], loop: launches.Loop) -> int | None:
    """How often a loop of unknown length passes in the whole call, by the function it is in.

    Attempts with factors in float64 are rare in a batch. How they share the passes of Newton's
    method is not known: they count as one each.
    """
    if loop.passes is not None:
        return None
    names = {"newton_with": "evaluations", "_in_single": "factorisations"}
    return counts.get(names.get(loop.name.split(".")[0], "attempts"))


def pieces_of_newton(method) -> dict[str, tuple[Callable, tuple]]:
    """{piece: (function of one rod, its arguments)}, in a step of 20 ms."""
    pull = jnp.array([0.1, 0.2, 0.3])
    rod = make_rod(SCENE, Inputs(pull), grid=method.grid(SCENE), spread_fronts=True)
    layout = layout_of(rod, dynamic=True)
    guess = unloaded_guess(layout, rod)
    c0 = jnp.array(1 / (0.22365 * DT))
    history = History(c0, -c0 * guess.strain, jnp.zeros_like(guess.strain))
    problem = Equations(method, layout, rod, history, guess.strain)
    U = problem.start(guess)
    noise = jax.random.normal(jax.random.key(0), U.along.shape)
    U = U._replace(along=U.along * (1 + 1e-3 * noise))
    F, factors = problem.residual(U), problem.factorise(U)
    of_method = lambda at, U: (U.along, at.rod, at.layout, at.history, at.guess)
    linear = method.linearise(*of_method(problem, U))
    slope = problem._tip(method.states(U.along, layout)).by_base_part
    defect, _ = method.condense(factors.inner, F.along)
    point = pointwise_problem(U.along[:, : layout.size], rod, layout, history)
    # As motions on a GPU have them.
    single = functools.partial(Equations.factorise, single=True)
    return {
        "evaluation": (lambda at, U: at.residual(U), (problem, U)),
        "correction": (lambda at, f, F: at.correct(f, F), (problem, factors, F)),
        "correction, factors in float32": (
            lambda at, f, F: at.correct(f, F),
            (problem, single(problem, U), F),
        ),
        "new factors in float32": (single, (problem, U)),
        "of it sweeps": (block_sweep.solve_sweeps, (factors.sweeps, defect, F.tip)),
        "new factors": (lambda at, U: at.factorise(U), (problem, U)),
        "of it Jacobians of intervals": (
            lambda at, U: method.linearise(*of_method(at, U))[:2],
            (problem, U),
        ),
        "of it compliances of points": (compliance, (point, guess.strain)),
        "of it block elimination": (
            block_sweep.factorise,
            (linear.left, linear.right, slope),
        ),
        "one inverse of an interval": (
            block_sweep.inverse,
            (linear.left[0] - 2 * linear.right[0],),
        ),
        "strains by minimisation (`Shooting`)": (recover_strain, (point, guess.strain)),
    }


def float32_refused() -> str:
    """What the package says to float32."""
    with jax.enable_x64(False):
        try:
            sr.solve_static(SCENE, [0.1, 0.1, 0.1], throw=False)
        except ValueError as error:
            return str(error)
    return "not refused"


# Tables


def render(rows: list[dict]) -> str:
    """All of a run in Markdown."""
    select = lambda part: [row for row in rows if row["part"] == part]
    parts = [row["device"] + "; " + row["name"] + "." for row in select("machine")]
    parts += [_batches(select("batch"), select("error"))]
    parts += [_pieces(select("piece"))]
    parts += [_loops(row) for row in select("loops")]
    for row in select("lockstep"):
        parts.append(
            f"Lockstep of {row['rods']} rods, {row['solves']} solves in time: "
            f"{row.get('evaluations')} evaluations, {row.get('factorisations')} factorisations, "
            f"{row.get('attempts')} attempts; a rod by itself needs "
            f"{row['evaluations_mean']:.0f} evaluations in the mean and {row['evaluations_most']} "
            f"at most: lockstep makes {row['lockstep_over_mean']:.2f} times as many."
        )
    limits = [f"{row['name']}: {row['value']:.3g} {row['unit']}" for row in select("device")]
    parts += ["The device: " + "; ".join(limits) + "."] if limits else []
    left_out = [f"{row['name']}: {row['problem']}" for row in select("skipped")]
    parts += ["Left out: " + "; ".join(left_out) + "."] if left_out else []
    return "\n\n".join(part for part in parts if part)


def _number(x, digits=3) -> str:
    if x is None:
        return ""
    return f"{x:.{digits}g}" if abs(x) < 1e5 else f"{x:.{digits - 1}e}"


def _batches(rows: list[dict], errors: list[dict]) -> str:
    if not rows:
        return ""
    off = {(row.get("name"), row.get("setting"), row.get("rods")): row for row in errors}
    motions = {
        (row["setting"], row["rods"]): row["seconds"]
        for row in rows
        if row["name"] == "motion" and "seconds" in row
    }
    lines = []
    order = {name: k for k, name in enumerate(["equilibrium", *KINDS])}
    for row in sorted(rows, key=lambda r: (order[r["name"]], r["setting"], r["rods"])):
        error = off.get((row["name"], row["setting"], row["rods"]), {}).get("largest")
        before = motions.get((row["setting"], row["rods"]))
        ratio = row["seconds"] / before if before and "seconds" in row else None
        setting = str(SETTINGS.get(row["setting"], ""))
        start = [row["name"], setting, str(row["rods"]), _number(row["compile"])]
        memory = _number(row["bytes_a_rod"] / 1e3)
        if "seconds" not in row:
            lines.append([*start, row["problem"], "", "", "", "", memory, "", ""])
            continue
        lines.append(
            [
                *start,
                _number(row["seconds"]),
                _number(row["rods_a_second"]),
                _number(row.get("rod_steps_a_second")),
                _number(row.get("rod_seconds_a_second")),
                f"{row['solved']:.2%}",
                memory,
                "" if row["name"] in ("motion", "equilibrium") else _number(ratio),
                _number(error, 2),
            ]
        )
    header = [
        "",
        "setting",
        "rods",
        "compile [s]",
        "a call [s]",
        "rods a second",
        "rod-steps a second",
        "rod-seconds a second",
        "solved",
        "memory a rod [kB]",
        "times the motion",
        "largest error [L]",
    ]
    return table(header, lines)


def _pieces(rows: list[dict]) -> str:
    lines, names = [], list(dict.fromkeys(row["name"] for row in rows))
    for name in names:
        by = {row["numbers"]: row for row in rows if row["name"] == name}
        row, single = by.get("float64"), by.get("float32")
        if row is None:
            continue
        taken, count = row["seconds"], row["operations"]
        lines.append(
            [
                name,
                _number(1e3 * taken),
                _number(1e6 * taken / row["rods"]),
                "" if count is None else _number(count / taken / 1e9),
                _number(row["bytes_moved"] / taken / 1e9),
                _number(row["kernels"], 4) + (" a pass" * row["loops_of_unknown_length"]),
                "" if single is None else _number(1e3 * single["seconds"]),
            ]
        )
    if not lines:
        return ""
    header = [
        f"piece, {rows[0]['rods']} rods",
        "float64 [ms]",
        "a rod [us]",
        "[Gop/s]",
        "[GB/s]",
        "kernels",
        "float32 [ms]",
    ]
    return table(header, lines)


def _loops(row: dict) -> str:
    lines = [
        [
            "· " * loop["depth"] + loop["name"],
            "?" if loop["passes"] is None else str(loop["passes"]),
            str(loop["kernels"]),
            str(loop["products"]),
            _number(loop["bytes"] / 1e6),
        ]
        for loop in row["loops"]
    ]
    header = [
        f"{row['name']}, {row['rods']} rods: loop",
        "passes",
        "kernels a pass",
        "of them products",
        "moved a pass [MB]",
    ]
    text = table(header, lines)
    if "kernels_a_step" in row:
        text += (
            f"\n\n{row['kernels_a_step']:.0f} kernels and {row['bytes_a_rod_step'] / 1e6:.3g} MB "
            f"a rod in a step. Launches predict {row['launching']:.3g} s, bytes "
            f"{row['moving']:.3g} s; measured {row['seconds']:.3g} s."
        )
    return text


def write_page(text: str) -> None:
    begin, end = "<!-- gpu: begin -->\n", "\n<!-- gpu: end -->"
    content = PAGE.read_text(encoding="utf-8")
    before, rest = content.split(begin)
    _, after = rest.split(end)
    PAGE.write_text(f"{before}{begin}{text}{end}{after}", encoding="utf-8")


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
        write_page(text)
    return rows


if __name__ == "__main__":
    main()
    sys.stdout.flush()
    # Programs that are still being compiled are not waited for.
    os._exit(0)
