"""Files that are written whole or not at all: a full disk leaves what was there before."""

import contextlib
import os
import shutil
import socket
from collections.abc import Iterator
from pathlib import Path
from typing import IO


@contextlib.contextmanager
def whole_file(path: str | os.PathLike, mode: str = "w", **options) -> Iterator[IO]:
    """As `open(path, mode, **options)`, to write: `path` is replaced when all has been written.

    It is written beside it until then, and on the disk before its name is. What is no file (a
    terminal, a pipe), or in a directory that takes no other file, is written as it is. Raises
    `OSError`, which names `path`.
    """
    target = Path(os.path.realpath(path))
    if _takes_no_other(target):
        with _named(path), open(target, mode, **options) as file:
            yield file
        return
    partial = target.with_name(f"{target.name}.{socket.gethostname()}-{os.getpid()}.part")
    try:
        with _named(path):
            with open(partial, mode, **options) as file:
                yield file
                file.flush()
                os.fsync(file.fileno())
            if target.exists():
                shutil.copymode(target, partial)
            os.replace(partial, target)
    finally:
        partial.unlink(missing_ok=True)


def _takes_no_other(target: Path) -> bool:
    if not target.exists():
        return False
    return not target.is_file() or not os.access(target.parent, os.W_OK)


@contextlib.contextmanager
def _named(path):
    """An error while writing says of itself only that the disk is full, and not of what file."""
    try:
        yield
    except OSError as e:
        raise OSError(e.errno, e.strerror, str(path)) from e
