"""Programs that are compiled several at a time and measured in turn, and what is kept of them."""

import concurrent.futures
import dataclasses
import json
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax

from softrod_jax.foundation.compiling import compiler_options


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
