"""Sweeps too long to lose: chunks of samples, each on disk as soon as it is computed.

Processes that sweep together share a directory and nothing else. None waits for another: each does
its own chunks first and then those of the others that are still missing. So the sweep is complete
as long as one process lives, and a next run does what is missing if none does.
"""

import hashlib
import json
import logging
import os
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import numpy as np

from softrod_jax.foundation.whole_files import whole_file
from softrod_jax.parallel.batches import count_samples, digest, padded, spread

_LOG = logging.getLogger(__name__)


class SweepError(ValueError):
    """A directory that holds another sweep, or a damaged one; the message says what to do."""


def sweep(
    function: Callable,
    *arguments,
    directory: str | os.PathLike,
    chunk: int,
    devices=None,
    share: tuple[int, int] | None = None,
):
    """`spread(function)(*arguments)`, kept on disk while it is computed; as NumPy arrays.

    Interrupted, the same call goes on: chunks that are in `directory` are not computed again. What
    is lost is at most the chunk that was being computed.

    - `function`: of one sample. With `throw=False` in its solves a failed sample has its result
      code, and stops nothing. It should return what is wanted and no more: everything is kept.
    - `directory`: made if it is not there. It holds one file for each chunk, and `sweep.json`,
      which tells what the sweep is of. Files that end in `.part` are what a process was writing
      when it was killed, and may be deleted.
    - `chunk`: samples in each file; a multiple of the number of devices leaves none idle.
    - `devices`: of this process; by default all of them.
    - `share`: (number, processes), counted from 0, of each of several processes that sweep
      together into a directory they all see. They are best started by themselves: those that
      `jax.distributed` connects, whose numbers are the default, end within minutes of one that is
      lost, and another run has to go on.

    Each process returns the whole result. Towards the end, processes that have nothing else to do
    may compute a chunk that another is still computing, which does no harm.

    Raises `SweepError` if `directory` holds a sweep of another function, other settings or scene,
    other samples or another `chunk`, computed with other versions of this package or of JAX if
    they make another program of it, or if a file in it cannot be read; `ValueError` for bad
    arguments.
    """
    count = count_samples("sweep", arguments)
    if not isinstance(chunk, int) or chunk < 1 or count < 1:
        raise ValueError(f"sweep: {count} samples, chunk={chunk!r}; at least 1 of both is needed")
    number, processes = share or (jax.process_index(), jax.process_count())
    if not 0 <= number < processes:
        raise ValueError(f"sweep: share={share}; (0, n) to (n - 1, n) for n processes are needed")
    devices = jax.local_devices() if devices is None else list(devices)
    if any(device.process_index != jax.process_index() for device in devices):
        raise ValueError("sweep: devices of other processes; give some of jax.local_devices()")

    traced = _trace(function, arguments)
    store = _Store(Path(directory), _fingerprint(traced, arguments), count, chunk)
    on_all = spread(function, devices)
    there = sum(store.path(k).exists() for k in range(store.chunks))
    _LOG.info("%s: %d of %d chunks are there", directory, there, store.chunks)
    for k in _order(store.chunks, number, processes):
        if not store.path(k).exists():
            rows = store.rows(k)
            # A last chunk of another size would be another program to compile.
            samples = jax.tree.map(lambda x, rows=rows: padded(x[rows], chunk), arguments)
            out = on_all(*samples)
            size = rows.stop - rows.start
            store.write(k, [np.asarray(x)[:size] for x in jax.tree.leaves(out)])
            _LOG.info("%s: chunk %d of %d is done", directory, k + 1, store.chunks)
    parts = [store.read(k) for k in range(store.chunks)]
    leaves = [np.concatenate(same) for same in zip(*parts, strict=True)]
    return jax.tree.unflatten(jax.tree.structure(traced.out_info), leaves)


def _order(chunks: int, number: int, processes: int) -> list[int]:
    """Own chunks first; then the others', from their ends, where nobody is yet."""
    own = list(range(number, chunks, processes))
    for ahead in range(1, processes):
        own += reversed(range((number + ahead) % processes, chunks, processes))
    return own


def _trace(function, arguments):
    sample = jax.tree.map(lambda x: jax.ShapeDtypeStruct(x.shape[1:], x.dtype), arguments)
    return jax.jit(lambda sample: function(*sample)).trace(sample)


def _fingerprint(traced, arguments) -> str:
    """Of the program, the numbers in it, and the samples.

    The program, because nothing else knows all that a function depends on.
    """
    parts = hashlib.blake2b(traced.lower().as_text().encode(), digest_size=16)
    parts.update(digest(traced.jaxpr.consts))
    parts.update(digest(arguments))
    return parts.hexdigest()


class _Store:
    """The files of one sweep."""

    def __init__(self, directory: Path, fingerprint: str, count: int, chunk: int):
        self.directory, self.fingerprint, self.count, self.chunk = (
            directory,
            fingerprint,
            count,
            chunk,
        )
        self.chunks = -(-count // chunk)
        directory.mkdir(parents=True, exist_ok=True)
        self._check(directory / "sweep.json")

    def _check(self, path: Path) -> None:
        mine = {"samples": self.count, "chunk": self.chunk, "fingerprint": self.fingerprint}
        if not path.exists():
            self._replace(path, lambda file: file.write(json.dumps(mine).encode()))
        try:
            found = json.loads(path.read_text(encoding="utf-8"))
            differing = [name for name in mine if found[name] != mine[name]]
        except (ValueError, KeyError, TypeError, OSError) as e:
            raise SweepError(f"{path}: cannot be read ({e}); give another directory") from None
        if differing:
            name = differing[0]
            what = f"{name}={found[name]}, and not {mine[name]}"
            if name == "fingerprint":
                what = "another function, other settings, another scene or other samples"
            raise SweepError(
                f"{path.parent}: holds a sweep of {what}; give another directory, or what this "
                "sweep was begun with"
            )

    def path(self, k: int) -> Path:
        return self.directory / f"chunk-{k:06d}.npz"

    def rows(self, k: int) -> slice:
        return slice(k * self.chunk, min((k + 1) * self.chunk, self.count))

    def write(self, k: int, leaves: list[np.ndarray]) -> None:
        named: dict[str, Any] = {f"leaf{i}": x for i, x in enumerate(leaves)}
        save = lambda file: np.savez(file, fingerprint=self.fingerprint, **named)
        self._replace(self.path(k), save)

    def read(self, k: int) -> list[np.ndarray]:
        path = self.path(k)
        try:
            with open(path, "rb") as opened, np.load(opened) as file:
                fingerprint = str(file["fingerprint"])
                leaves = [file[f"leaf{i}"] for i in range(len(file.files) - 1)]
        except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile) as e:
            raise SweepError(f"{path}: cannot be read ({e}); delete it and run again") from None
        if fingerprint != self.fingerprint:
            raise SweepError(f"{path}: is of another sweep; delete it and run again")
        return leaves

    @staticmethod
    def _replace(path: Path, write: Callable) -> None:
        """Never half a file, whenever the process is killed or the power goes."""
        with whole_file(path, "wb") as file:
            write(file)
