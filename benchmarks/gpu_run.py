"""One run on a GPU: which programs, in which order, and how far off their answers are."""

import contextlib
import functools
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import launches
import numpy as np
from gpu_jobs import (
    Job,
    Report,
    analysed,
    clock,
    device_memory,
    measure_wave,
    needed_memory,
    run_timed,
)
from gpu_programs import (
    CALLS,
    CHUNK,
    COARSE,
    COUNTED,
    DT,
    GRADIENTS,
    JUDGED,
    KINDS,
    SCENE,
    SECONDS,
    SETTINGS,
    VALUES,
    counted,
    equilibrium,
    float32_refused,
    motion,
    passes_of,
    pieces_of_newton,
    refined,
    tensions,
)
from limits import operations
from report import machine

import softrod_jax as sr
from softrod_jax.foundation.compiling import compiler_options, in_lockstep


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
            command = [
                sys.executable,
                str(Path(__file__).with_name("gpu.py")),
                "--reference",
                str(self.file),
            ]
            environment = {**os.environ, "JAX_PLATFORMS": "cpu"}
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
