"""Float64 for all tests. Compiling is most of their time: it is made cheaper, and kept."""

import gc
import os
import subprocess
import sys
import zlib
from pathlib import Path

# The first two are those of users (softrod_jax/foundation/compiling.py). LLVM's optimisations take
# half of what is left, and most programs run for milliseconds; and a program that is cut in parts,
# to be compiled side by side, takes longer where every core has its own tests. A flag that is set
# already stays: with XLA_FLAGS=--xla_backend_optimization_level=3, the tests run what users run.
# XLA aborts on a flag that it does not know, so a process of its own tries them first.
_FLAGS = (
    "--xla_cpu_use_fusion_emitters=false",
    "--xla_disable_hlo_passes=while-loop-invariant-code-motion",
    "--xla_backend_optimization_level=0",
    "--xla_cpu_parallel_codegen_split_count=1",
)
if "PYTEST_XDIST_WORKER" not in os.environ:
    given = os.environ.get("XLA_FLAGS", "")
    flags = " ".join([given, *(f for f in _FLAGS if f.partition("=")[0] not in given)]).strip()
    attempt = [sys.executable, "-c", "import jax; jax.devices()"]
    known = subprocess.run(attempt, env={**os.environ, "XLA_FLAGS": flags}, capture_output=True)
    if known.returncode == 0:
        os.environ["XLA_FLAGS"] = flags

# Tracing makes millions of objects that live on; looking for garbage among them as often as
# Python does by itself is a fifth of its time.
gc.set_threshold(200_000, 20, 50)

import jax  # noqa: E402
import jaxtyping  # noqa: E402
import pytest  # noqa: E402

# Before the packages are imported: calls of their functions are held against their annotations.
jaxtyping.install_import_hook(["softrod_jax", "calibration"], "checked.checked")

jax.config.update("jax_enable_x64", True)
if "JAX_COMPILATION_CACHE_DIR" not in os.environ:
    cache = Path(__file__).parents[1] / ".pytest_cache" / "jax"
    jax.config.update("jax_compilation_cache_dir", str(cache))
jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.5)


# Tests that take long are two thirds of all time. At each commit a fifth of them run, by turns.
_TURNS = 5
# Beside those that are marked: what took over 7 s on 2 cores when all were last measured, by
# `--durations=0`.
_MEASURED = frozenset((Path(__file__).parent / "long.txt").read_text().split())


def pytest_configure(config):
    """Whose turn it is, for the processes that run the tests, too, as `LONG` in the environment.

    All of them run with `LONG=all`, where tests are named, and where there is no git.
    """
    if "PYTEST_XDIST_WORKER" in os.environ:
        return
    named = config.args_source != pytest.Config.ArgsSource.TESTPATHS
    os.environ.setdefault("LONG", "all" if named or config.option.markexpr else _turn())


def _turn() -> str:
    asked = ["git", "rev-parse", "HEAD"]
    try:
        found = subprocess.run(asked, cwd=Path(__file__).parent, capture_output=True, text=True)
    except OSError:
        return "all"
    return "all" if found.returncode else str(int(found.stdout[:8], 16) % _TURNS)


def pytest_collection_modifyitems(items):
    turn = os.environ["LONG"]
    for item in items:
        if item.nodeid.partition("[")[0] in _MEASURED:
            item.add_marker("long")
    takes_long = [item for item in items if item.get_closest_marker("long")]
    for k, item in enumerate(takes_long):
        if turn != "all" and k % _TURNS != int(turn):
            item.add_marker(pytest.mark.skip("its turn is at another commit; LONG=all runs it"))


_compiled = []


def _note(event, duration, **details):
    if event.endswith("backend_compile_duration"):
        _compiled.append(duration)


jax.monitoring.register_event_duration_secs_listener(_note)


@pytest.fixture(autouse=True)
def few_programs():
    """Linux gives a process 65,530 mappings of memory; a compiled motion takes about 1,000."""
    yield
    maps = Path("/proc/self/maps")
    # Counting them takes 25 ms where there are many, and most tests compile nothing.
    if _compiled and maps.exists():
        _compiled.clear()
        if maps.read_bytes().count(b"\n") > 30_000:
            jax.clear_caches()
            gc.collect()


@pytest.fixture(autouse=True)
def types_are_checked(request):
    """In those of types, and in every sixth other one, always the same: all take 15 % longer.

    With `CHECK_TYPES=all` in the environment, in all.
    """
    chosen = zlib.crc32(request.node.nodeid.encode()) % 6 == 0
    checked = chosen or request.path.stem == "test_types" or os.environ.get("CHECK_TYPES") == "all"
    jaxtyping.config.update("jaxtyping_disable", not checked)


@pytest.fixture
def wrong_types(types_are_checked):
    """Lets a test give what annotations do not allow, to see how it is refused without them."""
    jaxtyping.config.update("jaxtyping_disable", True)


@pytest.fixture
def optimised_fits(monkeypatch):
    """Programs of fits with LLVM's optimisations: where one runs hundreds of times, they pay."""
    from calibration.problem import evaluation

    options = evaluation.compiler_options()
    if options is not None:
        options = {**options, "xla_backend_optimization_level": 3}
    monkeypatch.setattr(evaluation, "compiler_options", lambda: options)
    evaluation._compiled.cache_clear()
    yield
    evaluation._compiled.cache_clear()
