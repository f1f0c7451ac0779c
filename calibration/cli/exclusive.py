"""One run at a time in a directory of results."""

import contextlib
from collections.abc import Iterator
from pathlib import Path

from calibration.cli.common import UsageError

try:
    import fcntl
except ImportError:  # a system without it has no lock
    fcntl = None

_LOCK = ".lock"


@contextlib.contextmanager
def alone_in(directory: Path) -> Iterator[None]:
    """Raises `UsageError` if another run is at work in `directory`.

    The lock is the operating system's, and ends with the process, however that ends.
    """
    if fcntl is None:
        yield
        return
    path = directory / _LOCK
    with path.open("w") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise UsageError(
                f"--out {directory}: another run is writing there; wait for it, or give another "
                "directory"
            ) from None
        try:
            yield
        finally:
            path.unlink(missing_ok=True)
