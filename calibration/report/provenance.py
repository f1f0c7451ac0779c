"""Where a result comes from: versions, command, date and the files that were read."""

import datetime
import hashlib
import platform
import sys
from collections.abc import Iterable
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path


def provenance(sources: Iterable[str]) -> dict:
    """Versions, the command, the date, and SHA-256 of those `sources` that are files."""
    files = [Path(x) for x in dict.fromkeys(sources) if x and Path(x).is_file()]
    return {
        "softrod_jax": _version("softrod_jax"),
        "jax": _version("jax"),
        "python": platform.python_version(),
        "command": sys.argv,
        "date": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
        "sha256": {str(x): hashlib.sha256(x.read_bytes()).hexdigest() for x in files},
    }


def _version(package: str) -> str | None:
    try:
        return version(package)
    except PackageNotFoundError:
        return None
