"""A fit on disk while it runs, so that one that was interrupted goes on where it was."""

import hashlib
import json
import os
from os import PathLike
from pathlib import Path

import jax
import numpy as np

from calibration.problem.problem import Problem
from calibration.search.settings import SearchSettings


class CheckpointError(ValueError):
    """A checkpoint that does not belong to this fit; the message says so."""


class Checkpoint:
    """The best place so far and the starts that are done, in a JSON file.

    Of several processes that fit together the first writes it.

    - `path`: None keeps nothing. `resume`: go on from what is there; raises `CheckpointError` if
      there is nothing, or it is of another fit.
    """

    def __init__(
        self,
        path: str | PathLike | None,
        problem: Problem,
        resume: bool,
        settings: SearchSettings,
    ):
        self.path = None if path is None else Path(path)
        self.done: list[dict] = []
        self.x: np.ndarray | None = None
        self._loss = np.inf
        self._of = _fingerprint(problem, settings)
        if resume:
            self._read()

    def point(self, point) -> None:
        """Keep the point if it is the best of this start."""
        if self.path is not None and point.ok and point.loss < self._loss:
            self._loss, self.x = point.loss, point.x
            self._write()

    def finish(self, x: np.ndarray, loss: float, result: str) -> None:
        """A start is done."""
        self.done.append({"x": x.tolist(), "loss": loss, "result": result})
        self._loss, self.x = np.inf, None
        self._write()

    def remove(self) -> None:
        """The fit is complete."""
        if self.path is not None and jax.process_index() == 0:
            self.path.unlink(missing_ok=True)

    def _write(self) -> None:
        if self.path is None or jax.process_index() > 0:
            return
        x = None if self.x is None else self.x.tolist()
        content = {"fit": self._of, "done": self.done, "x": x, "loss": self._loss}
        # Never half a file, whenever the power goes.
        partial = self.path.with_name(self.path.name + ".new")
        partial.write_text(json.dumps(content), encoding="utf-8")
        os.replace(partial, self.path)

    def _read(self) -> None:
        fit, done, x, loss = read_checkpoint(self.path)
        if fit != self._of:
            raise CheckpointError(
                f"{self.path}: is of a fit with another scene, other recordings or other settings; "
                "give those, or start without resuming"
            )
        self.done, self.x, self._loss = done, x, loss


def read_checkpoint(path: str | PathLike | None):
    """Which fit it is of, the ends of its searches, and where the search is: parameters and loss.

    Raises `CheckpointError` where there is none, and for what is none.
    """
    if path is None:
        raise CheckpointError("resume: give the checkpoint file to go on from")
    try:
        content = json.loads(Path(path).read_text(encoding="utf-8"))
        fit, done, x, loss = (content[k] for k in ("fit", "done", "x", "loss"))
        x, loss = None if x is None else _vector(x), float(loss)
        for start in done:
            _ = _vector(start["x"]), float(start["loss"]), str(start["result"])
    except OSError as e:
        raise CheckpointError(
            f"{path}: nothing to go on from ({e.strerror or e}); start without resuming"
        ) from None
    except (ValueError, KeyError, TypeError, OverflowError, RecursionError):
        raise CheckpointError(
            f"{path}: not a checkpoint of a fit; start without resuming"
        ) from None
    return fit, done, x, loss


def _vector(numbers) -> np.ndarray:
    """Raises `ValueError` or `TypeError` for what is no list of numbers."""
    x = np.array(numbers, dtype=float)
    if x.ndim != 1:
        raise ValueError("not a list of numbers")
    return x


def _fingerprint(problem: Problem, settings: SearchSettings) -> str:
    """Differs between fits that do not search the same space in the same way."""
    space = problem.space
    how = (settings.optimiser, settings.loss, settings.starts, settings.seed)
    how += (sorted(problem.priors.items()),) if problem.priors else ()
    how += () if problem.beside is None else (type(problem.beside).__name__,)
    parts = hashlib.sha256(repr((space.parameters.names, space.time_offset, how)).encode())
    for leaf in jax.tree.leaves((problem.setup, problem.batch)):
        parts.update(np.asarray(leaf).tobytes())
    return parts.hexdigest()
