"""What the packages tell `logging` about themselves, on stderr where it is asked for."""

import argparse
import contextlib
import logging
import os
import sys
from collections.abc import Iterator

from calibration.cli.common import UsageError

VERBOSE = ("-v", "-vv", "--verbose")
_PACKAGES = ("softrod_jax", "calibration")
_VARIABLE = "SOFTROD_LOG"
_LEVELS = {"warning": logging.WARNING, "info": logging.INFO, "debug": logging.DEBUG}


class _Stderr(logging.Handler):
    """Writes to what `sys.stderr` is at that moment: while a bar is shown, that is another."""

    def emit(self, record):
        print(self.format(record), file=sys.stderr, flush=True)


def add_verbose(parser) -> None:
    """The option --verbose, whose absence leaves no trace among the arguments."""
    parser.add_argument(
        "-v",
        "--verbose",
        action="count",
        default=argparse.SUPPRESS,
        help="say on stderr what is refined, tried and fallen back to; twice: every evaluation",
    )


@contextlib.contextmanager
def shown(verbose: int) -> Iterator[None]:
    """Show messages while the block runs: those of `verbose` times --verbose, or of SOFTROD_LOG.

    Raises `UsageError` for a level that is none.
    """
    level = _level(verbose)
    if level is None:
        yield
        return
    handler = _Stderr()
    handler.setFormatter(logging.Formatter("%(asctime)s %(name)s: %(message)s", "%H:%M:%S"))
    loggers = [logging.getLogger(name) for name in _PACKAGES]
    before = [logger.level for logger in loggers]
    for logger in loggers:
        logger.addHandler(handler)
        logger.setLevel(level)
    try:
        yield
    finally:
        for logger, old in zip(loggers, before, strict=True):
            logger.removeHandler(handler)
            logger.setLevel(old)


def _level(verbose: int) -> int | None:
    if verbose:
        return logging.INFO if verbose == 1 else logging.DEBUG
    name = os.environ.get(_VARIABLE, "").lower()
    if name and name not in _LEVELS:
        raise UsageError(f"{_VARIABLE}={name}: expected one of {', '.join(_LEVELS)}")
    return _LEVELS.get(name)
