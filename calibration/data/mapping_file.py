"""Reading a mapping file: each key asked for with its type, and nothing in it that was not asked
for."""

import reprlib
import tomllib
from os import PathLike
from typing import Any

import numpy as np

from calibration.data import units
from calibration.data.recording import RecordingError


class Spec:
    """A table of a mapping file; everything in it must be asked for before `done`."""

    def __init__(self, content: dict, where: str):
        self.content, self.where, self.asked = content, where, set()

    def get(self, key, kind, what, default, required):
        self.asked.add(key)
        if key not in self.content:
            if required:
                raise RecordingError(f"{self.where}{key} is missing: expected {what}")
            return default
        value = self.content[key]
        if not isinstance(value, kind) or isinstance(value, bool) != (kind is bool):
            raise self.wrong(key, value, what)
        return value

    def wrong(self, key, value, what) -> RecordingError:
        """The complaint about a value; one that is nested without end is cut."""
        return RecordingError(f"{self.where}{key} = {reprlib.repr(value)}: expected {what}")

    def table(self, key, required=True) -> "Spec":
        content = self.get(key, dict, "a table", {}, required)
        return Spec(content, f"{self.where}{key}.")

    def tables(self, key) -> list["Spec"]:
        content = self.get(key, list, f"tables [[{key}]]", [], False)
        for part in content:
            if not isinstance(part, dict):
                raise RecordingError(f"{self.where}{key}: expected tables [[{key}]]")
        return [Spec(part, f"{self.where}{key}[{i}].") for i, part in enumerate(content)]

    def text(self, key, *default) -> Any:
        (usual,) = default or (None,)
        return self.get(key, str, "a text", usual, not default)

    def flag(self, key, default=False) -> bool:
        return self.get(key, bool, "true or false", default, False)

    def number(self, key, *default):
        what = "a finite number"
        (usual,) = default or (None,)
        value = self.get(key, int | float, what, usual, not default)
        return None if value is None else self._finite(key, value, what)

    def whole(self, key, default):
        """A whole number from 0."""
        value = self.get(key, int | float, "a whole number from 0", default, False)
        if value is not None and not (0 <= value < 1e15 and value == int(value)):
            raise self.wrong(key, value, "a whole number from 0")
        return None if value is None else int(value)

    def texts(self, key, count, required=True) -> Any:
        return self._list(key, str, f"a list of {count} column names", count, required)

    def vector(self, key, required=True):
        what = "a list of 3 finite numbers"
        values = self._list(key, int | float, what, 3, required)
        if values is None:
            return None
        return np.array([self._finite(key, value, what) for value in values])

    def character(self, key, default, names):
        """One character; `names`: words for those that are hard to write."""
        value = self.text(key, default)
        if value is None:
            return None
        value = names.get(value.lower(), value)
        if len(value) != 1 or value in '"\r\n\0':
            what = f"one character{''.join(f', or {name!r}' for name in names)}"
            raise self.wrong(key, value, what)
        return value

    def scalars(self, key) -> list[float | str]:
        """A number, a text, or a list of them."""
        what = "a number, a text, or a list of them"
        values = self.get(key, int | float | str | list, what, [], False)
        values = values if isinstance(values, list) else [values]
        for value in values:
            if isinstance(value, bool) or not isinstance(value, int | float | str):
                raise self.wrong(key, value, what)
        return [x if isinstance(x, str) else self._finite(key, x, what) for x in values]

    def numbers(self) -> dict[str, Any]:
        return {key: self.number(key) for key in self.content}

    def unit(self, kind: str) -> str | None:
        """A unit of this kind, or None if none is given."""
        name = self.text("unit", None)
        if name is not None and units.factor(kind, name) is None:
            raise RecordingError(
                f"{self.where}unit = {name!r}: expected one of {', '.join(units.UNITS[kind])}"
            )
        return name

    def done(self) -> None:
        for key in self.content:
            if key not in self.asked:
                allowed = ", ".join(sorted(self.asked))
                raise RecordingError(f"{self.where}{key}: unknown key; allowed here: {allowed}")

    def _list(self, key, kind, what, count, required):
        values = self.get(key, list, what, None, required)
        if values is not None and not (
            len(values) == count
            and all(isinstance(v, kind) and not isinstance(v, bool) for v in values)
        ):
            raise self.wrong(key, values, what)
        return values

    def _finite(self, key, value, what) -> float:
        try:
            number = float(value)
        except OverflowError:
            number = np.inf
        if not np.isfinite(number):
            raise self.wrong(key, value, what)
        return number


def read_toml(path: str | PathLike) -> Spec:
    """The mapping file `path`. Raises `RecordingError` if it cannot be read, or is not TOML."""
    try:
        with open(path, "rb") as file:
            return Spec(tomllib.load(file), f"{path}: ")
    except OSError as e:
        raise RecordingError(f"{path}: cannot read the mapping: {e.strerror or e}") from None
    except RecursionError:
        raise RecordingError(f"{path}: not a mapping: nested too deeply") from None
    except ValueError as e:  # not TOML, not UTF-8, a number of thousands of digits
        raise RecordingError(f"{path}: not a TOML file: {e}") from None
