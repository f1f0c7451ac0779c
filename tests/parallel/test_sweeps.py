"""Sweeps on disk: interrupted and gone on with, shared, and refused if they have changed."""

import dataclasses
import signal
import subprocess
import sys

import jax.numpy as jnp
import numpy as np
import processes
import pytest
import together
from together import SCENE, bend, wave

import softrod_jax as sr
from softrod_jax.parallel import sweeps

# Some have no equilibrium, one is no number.
PULLS = np.linspace(0.0, 3.0, 33)
PULLS[7] = np.nan
CHUNK = len(together.PULLS)
X = np.random.default_rng(0).normal(size=(11, 3))

# Killed with the third of its chunks half written.
KILLED = """
import os, signal, sys
import jax
jax.config.update("jax_enable_x64", True)
import softrod_jax as sr
from softrod_jax.parallel import sweeps
from test_sweeps import CHUNK, PULLS, bend
whole, calls = sweeps.np.savez, []
class Half:
    def __getattr__(self, name):
        return getattr(sweeps_np, name)
    def savez(self, file, **leaves):
        calls.append(None)
        if len(calls) < 3:
            return whole(file, **leaves)
        file.write(b"half a chunk")
        file.flush()
        os.kill(os.getpid(), signal.SIGKILL)
sweeps_np, sweeps.np = sweeps.np, Half()
sr.sweep(bend, PULLS, directory=sys.argv[1], chunk=CHUNK, share=(1, 2))
"""


def equal(a, b):
    np.testing.assert_array_equal(a["tip"], b["tip"])
    for one, other in zip(a["at"], b["at"], strict=True):
        np.testing.assert_array_equal(one, other)


@pytest.fixture
def computed(monkeypatch):
    """The chunks that are written, in order."""
    written = []
    write = sweeps._Store.write

    def count(self, k, leaves):
        written.append(k)
        write(self, k, leaves)

    monkeypatch.setattr(sweeps._Store, "write", count)
    return written


def test_killed_and_gone_on_with(tmp_path, computed):
    uninterrupted = sr.sweep(bend, PULLS, directory=tmp_path / "whole", chunk=CHUNK)
    assert computed == list(range(7))
    computed.clear()

    at = tmp_path / "killed"
    command = [sys.executable, "-c", KILLED, str(at)]
    killed = subprocess.run(
        command, env=processes.environment(), capture_output=True, text=True, timeout=300
    )
    assert killed.returncode == -signal.SIGKILL, killed.stderr
    finished = {path.name: path.stat().st_mtime_ns for path in at.glob("*.npz")}
    assert sorted(finished) == ["chunk-000001.npz", "chunk-000003.npz"]
    assert len(list(at.glob("*.part"))) == 1

    # The process that is left does its own chunks and then those of the lost one.
    result = sr.sweep(bend, PULLS, directory=at, chunk=CHUNK, share=(0, 2))
    assert computed == [0, 2, 4, 6, 5]
    assert all((at / name).stat().st_mtime_ns == time for name, time in finished.items())
    equal(result, uninterrupted)

    codes = result["at"][1]
    assert codes.shape == PULLS.shape and codes[0] == 0
    assert codes[7] == sr.RESULTS.bad_input and codes[-1] == sr.RESULTS.no_equilibrium
    # As without files.
    whole = [sr.spread(bend)(PULLS[k * CHUNK :][:CHUNK])["tip"] for k in range(6)]
    np.testing.assert_array_equal(result["tip"][: 6 * CHUNK], np.concatenate(whole))


def test_a_complete_sweep_computes_nothing(tmp_path, computed):
    first = sr.sweep(wave, X, directory=tmp_path, chunk=4)
    assert computed == [0, 1, 2]
    again = sr.sweep(wave, X, directory=tmp_path, chunk=4, share=(2, 5))
    assert computed == [0, 1, 2]
    for a, b, c in zip(first, again, sr.spread(wave)(X), strict=True):
        np.testing.assert_array_equal(a, b)
        np.testing.assert_array_equal(a, c)


@pytest.mark.parametrize("processes", [1, 2, 3, 7])
@pytest.mark.parametrize("chunks", [1, 5, 6])
def test_every_process_would_do_all_and_begins_with_its_own(chunks, processes):
    orders = [sweeps._order(chunks, k, processes) for k in range(processes)]
    assert all(sorted(order) == list(range(chunks)) for order in orders)
    begun = [order[0] for order in orders[:chunks]]
    assert len(set(begun)) == len(begun)


def scaled(scene):
    return lambda x: x * scene.young_modulus


def test_a_changed_sweep_is_refused(tmp_path):
    sr.sweep(scaled(SCENE), X, directory=tmp_path, chunk=4)
    refused = lambda words: pytest.raises(sr.SweepError, match=words)
    softer = dataclasses.replace(SCENE, young_modulus=SCENE.young_modulus * (1 - 1e-15))
    with refused("another scene"):
        sr.sweep(scaled(softer), X, directory=tmp_path, chunk=4)
    with refused("another function"):
        sr.sweep(wave, X, directory=tmp_path, chunk=4)
    with refused("other samples"):
        sr.sweep(scaled(SCENE), X + 1e-15, directory=tmp_path, chunk=4)
    with refused("samples=11, and not 10"):
        sr.sweep(scaled(SCENE), X[:10], directory=tmp_path, chunk=4)
    with refused("chunk=4, and not 5"):
        sr.sweep(scaled(SCENE), X, directory=tmp_path, chunk=5)


def test_damage_is_named(tmp_path):
    run = lambda: sr.sweep(wave, X, directory=tmp_path, chunk=4)
    result = run()
    path = tmp_path / "chunk-000001.npz"
    path.write_bytes(path.read_bytes()[:100])
    with pytest.raises(sr.SweepError, match="chunk-000001.npz.*delete it"):
        run()
    path.unlink()
    np.testing.assert_array_equal(run()[0], result[0])
    sr.sweep(wave, X + 1, directory=tmp_path / "other", chunk=4)
    path.write_bytes((tmp_path / "other" / path.name).read_bytes())
    with pytest.raises(sr.SweepError, match="of another sweep"):
        run()
    (tmp_path / "sweep.json").write_text("{}")
    with pytest.raises(sr.SweepError, match="sweep.json: cannot be read"):
        run()


@pytest.mark.parametrize(
    "samples, options, words",
    [
        (X, dict(chunk=0), "chunk=0"),
        (X, dict(chunk=2.0), "chunk=2.0"),
        (X[:0], dict(chunk=1), "0 samples"),
        (X, dict(chunk=1, share=(2, 2)), r"share=\(2, 2\)"),
        (jnp.float64(1.0), dict(chunk=1), "one row a sample"),
    ],
)
@pytest.mark.usefixtures("wrong_types")
def test_bad_arguments(tmp_path, samples, options, words):
    with pytest.raises(ValueError, match=words):
        sr.sweep(wave, samples, directory=tmp_path, **options)
