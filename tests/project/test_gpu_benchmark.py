"""The benchmark of a GPU, small and on the CPU, and its count of what a program launches."""

import json
import sys
from pathlib import Path

import jax
import jax.numpy as jnp
import pytest

sys.path.insert(0, str(Path(__file__).parents[2] / "benchmarks"))

import gpu  # noqa: E402
import gpu_programs  # noqa: E402
import launches  # noqa: E402

NONE = lambda loop: None


def loops_of(function, *arguments):
    return launches.program(jax.jit(function).lower(*arguments).compile().as_text())


def test_kernels_of_loops_are_counted_as_often_as_they_pass():
    x = jnp.ones((64, 64))
    product = lambda _, x: jnp.sin(x @ x)
    nested = lambda _, x: jax.lax.fori_loop(0, 5, product, product(0, x))
    once = loops_of(lambda x: jax.lax.fori_loop(0, 7, product, x), x)
    twice = loops_of(lambda x: jax.lax.fori_loop(0, 7, nested, x), x)
    products = lambda loop: loop.products
    assert once.total(products, NONE) == 7
    assert twice.total(products, NONE) == 7 * 6
    assert [(depth, loop.passes) for depth, loop in twice.walk()] == [(0, 1), (1, 7), (2, 5)]


def test_passes_of_a_loop_of_unknown_length_come_from_outside():
    x = jnp.ones((64, 64))
    grow = lambda x: jax.lax.while_loop(lambda x: x[0, 0] < 1e3, lambda x: x @ x, x)
    (loop,) = loops_of(grow, x).inner
    assert loop.passes is None and loop.products == 1
    whole = loops_of(grow, x)
    assert (
        whole.total(lambda loop: loop.products, lambda loop: 9 if loop.passes is None else None)
        == 9
    )


def test_bytes_are_those_read_and_written():
    x = jnp.ones(1000)
    assert loops_of(lambda x: 2 * x, x).bytes == pytest.approx(2 * x.nbytes, abs=16)
    rows = jnp.ones((100, 1000))
    # Of a row that is sliced, and of one that is updated, not the whole array.
    sliced = loops_of(lambda x, k: jnp.sin(x[k]), rows, 3)
    assert sliced.bytes < 4 * rows[0].nbytes
    text = loops_of(lambda x: jax.lax.scan(lambda c, row: (c + row, jnp.sin(row)), x[0], x), rows)
    (loop,) = text.inner
    assert 3 * rows[0].nbytes <= loop.bytes < 12 * rows[0].nbytes


def test_text_without_a_program_is_refused():
    with pytest.raises(ValueError, match="no entry"):
        launches.program("HloModule nothing")


@pytest.mark.long
def test_small_run_measures_everything_once(tmp_path, capsys):
    file = tmp_path / "gpu.json"
    rows = gpu.main(["--small", "--json", str(file)])
    assert len(json.loads(file.read_text())) == len(rows)
    select = lambda part: [row for row in rows if row["part"] == part]
    assert not select("skipped") and not select("late")
    batches = select("batch")
    assert {row["name"] for row in batches} == {"motion", "reverse gradient"}
    assert all(row["solved"] == 1.0 and row["seconds"] > 0 for row in batches)
    assert all(0 < row["largest"] < 1e-3 for row in select("error")) and select("error")
    (lockstep,) = select("lockstep")
    # All samples pass as often as the slowest; each solve shows that its factors serve, and the
    # stages of a step share them. Only what they do not serve for is attempted with others.
    assert lockstep["evaluations"] >= lockstep["evaluations_most"]
    assert (
        lockstep["evaluations"] >= 2 * lockstep["solves"] == 6 * gpu_programs.COARSE.scheme.stages
    )
    assert 3 <= lockstep["factorisations"] < lockstep["solves"]
    assert 0 <= lockstep["attempts"] < lockstep["solves"]
    motion = select("loops")[0]
    assert motion["kernels_a_step"] > 1000 and motion["bytes_a_rod_step"] > 1e5
    assert {row["numbers"] for row in select("piece")} == {"float64", "float32"}
    out = capsys.readouterr().out
    assert "rod-seconds a second" in out and "Lockstep of 2 rods" in out
    gpu.main(["--render", str(file)])
    assert "Lockstep of 2 rods" in capsys.readouterr().out
