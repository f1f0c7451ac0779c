"""Columns as a mapping means them: in which unit they are, and when their samples were taken."""

import numpy as np

from calibration.data import units
from calibration.data.mapping_file import Spec
from calibration.data.recording import RecordingError
from calibration.data.table import Table

_LARGEST_INTERVAL, _SMALLEST_INTERVAL = 5.0, 2e-6  # s


def factor(table: Table, part: Spec, kind: str, names: list[str], scaled: bool = False) -> float:
    """From the unit of columns to SI: the mapping's, the file's, or both if they agree.

    `scaled`: the mapping says how much the unit of a sensor stands for.
    """
    own, overrule = part.unit(kind), part.flag("ignore_file_unit")
    asked = None if own is None else units.factor(kind, own)
    usual = {"time": "s", "length": "m", "force": "N", "pressure": "Pa"}[kind]
    factors = set()
    for name in [] if overrule else names:
        said = table.unit(name)
        size = None if said is None else units.factor(kind, said)
        if said is None or not said.strip("[](){} -"):
            continue
        if size is None:
            if not scaled and (own is None or units.is_unit(said)):
                raise RecordingError(
                    f"{table.path}: column {name}: the file says {said!r}, "
                    f"{units.kind_of(said)}, where a {kind} is needed: choose another column, or "
                    f"set {part.where}unit, scale or ignore_file_unit = true"
                )
            continue
        if asked is not None and not np.isclose(size, asked, rtol=1e-6):
            raise RecordingError(
                f"{table.path}: column {name}: the file says {said!r}, and {part.where}unit = "
                f"{own!r}: leave it out, or set {part.where}ignore_file_unit = true if the file "
                "is wrong"
            )
        factors.add(size)
    if len(factors) > 1:
        raise RecordingError(f"{table.path}: columns {', '.join(names)}: have different units")
    if asked is not None:
        return asked
    return factors.pop() if factors else units.UNITS[kind][usual]


class TimeColumn:
    """When samples were taken: a column, a rate, or what the file knows. `key`: in the mapping."""

    def __init__(self, table: Table, spec: Spec):
        self.table, self.key, self.times, self.name = table, spec.where, None, None
        self.interval = table.interval
        if not spec.content:
            return
        rate = spec.number("rate", None)
        offset = spec.number("offset", 0.0)
        if rate is not None:
            spec.done()
            if not rate > 0:
                raise RecordingError(f"{spec.where}rate = {rate:g}: expected a number above 0 [Hz]")
            self.interval = 1 / rate
            return
        self.name = table.find(spec.text("column"), key=f"{spec.where}column")
        times = table.times(self.name, spec.text("format", None))
        texts = table.columns[self.name].dtype.kind in "OM"
        if texts and spec.content.get("unit", "s") != "s":
            raise RecordingError(
                f"{spec.where}unit = {spec.text('unit')!r}: column {self.name} holds dates, times "
                "of day or durations, which need none: leave it out"
            )
        size = factor(table, spec, "time", [] if texts else [self.name])
        spec.done()
        if times.dtype.kind == "M":
            if offset:
                times = times + np.timedelta64(round(1e9 * offset), "ns")
        else:
            times = size * (times + offset)
        self._check(times)
        self.times = times

    def of(self, count: int, column: str) -> np.ndarray:
        """The times of `count` samples, NaN or NaT where the clock has none."""
        if self.times is None:
            assert self.interval is not None, "a clock has times, or an interval"
            return self.interval * np.arange(count)
        if len(self.times) != count:
            raise RecordingError(
                f"{self.table.path}: column {column}: {count} samples, and its time has "
                f"{len(self.times)}; give it a time of its own, time = {{ column = .. }} in its "
                "table"
            )
        return self.times

    def _check(self, times) -> None:
        there = np.flatnonzero(~np.isnan(times))
        if not len(there):
            raise RecordingError(
                f"{self.table.path}: column {self.name}: every time is missing; name another in "
                f"{self.key}column, or give {self.key}rate [Hz]"
            )
        steps = np.diff(times[there]).astype(float)
        for k in np.flatnonzero(steps <= 0)[:1]:
            what = "repeats the time of" if steps[k] == 0 else "is earlier than"
            row = lambda j: self.table.row(int(there[j]), len(times))
            midnight = steps[k] < -80000 and times.dtype.kind != "M" and times[there[k]] < 90000
            remedy = (
                "is it the midnight of a time of day? give a column with the date"
                if midnight
                else "time must increase from row to row: sort the rows and delete repeated ones, "
                f"or give {self.key}rate [Hz] instead"
            )
            raise RecordingError(
                f"{self.table.path}: {row(k + 1)}, column {self.name}: {times[there[k + 1]]} "
                f"{what} {row(k)}; {remedy}"
            )


def one_zero(path, clocks):
    """Clocks in seconds: of dates, since the first of them all. And a note."""
    dated = [clock.dtype.kind == "M" for clock in clocks]
    if not any(dated):
        return clocks, ()
    if not all(dated):
        raise RecordingError(
            f"{path}: some of its clocks are dates and others are numbers: they do not overlap; "
            "give all from one clock"
        )
    zero = min(clock.min() for clock in clocks)
    seconds = [(c - zero) / np.timedelta64(1, "ns") * 1e-9 for c in clocks]
    return seconds, (
        f"time 0 is {np.datetime_as_string(zero, timezone='naive').rstrip('0').rstrip('.')}",
    )


def check_interval(path, mapping, times) -> None:
    """A clock of milliseconds or of days, read as seconds, looks like this."""
    interval = float(np.median(np.diff(times))) if len(times) > 1 else 1.0
    if interval > _LARGEST_INTERVAL:
        raise RecordingError(
            f"{path}: samples are {interval:g} s apart: is the time in ms? set [time] unit in "
            f"{mapping}"
        )
    if interval < _SMALLEST_INTERVAL:
        raise RecordingError(
            f"{path}: samples are {interval:.3g} s apart: is the time in days, as of Excel and "
            f"MATLAB? set [time] unit = 'd' in {mapping}"
        )


def steps_of(part: Spec) -> np.ndarray | None:
    """What was commanded, pairs (time [s], value); None where a column has it."""
    what = "a list of pairs [time in s, value], times increasing"
    given = part.get("steps", list, what, None, False)
    if given is None:
        return None
    if "column" in part.content:
        raise RecordingError(f"{part.where}column and {part.where}steps: one of them is too much")
    real = lambda x: isinstance(x, int | float) and not isinstance(x, bool) and abs(x) < np.inf
    good = given and all(isinstance(p, list) and len(p) == 2 and all(map(real, p)) for p in given)
    if not good or np.any(np.diff([p[0] for p in given]) <= 0):
        raise part.wrong("steps", given, what)
    return np.array(given, dtype=float)


def stepped(part: Spec, steps: np.ndarray, times: np.ndarray) -> np.ndarray:
    """The command at each of the times."""
    if times.dtype.kind == "M":
        raise RecordingError(f"{part.where}steps: are in seconds, and the clock is one of dates")
    k = np.searchsorted(steps[:, 0], times, side="right")
    return np.concatenate([[0.0], steps[:, 1]])[k]
