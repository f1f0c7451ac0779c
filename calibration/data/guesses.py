"""What the columns of a file may be, by their names, their units and what is plausible.

A guess is a proposal: each says what it goes by, and whoever asks for it can give what is known.
"""

import re
from dataclasses import dataclass, field, replace

import numpy as np

from calibration.data import units
from calibration.data.table import Table, bare_name

_TIME = re.compile(
    r"(t|time|zeit|temps|tiempo|tempo|time ?stamp|zeitstempel|date|date ?time|datum|uhrzeit|"
    r"elapsed.*|.*\btime|time\b.*|sec|secs|seconds?|sekunden?|clock)(_?(s|ms|us))?"
)
_TENSION = re.compile(r"tension|tau|tendon|force|kraft|zug|seil|load|cable|fil\b|\bf ?_?\d*$|^f\d")
_PRESSURE = re.compile(r"press|druck|^p ?_?\d*$|\bp\d+$")
_PULL = re.compile(r"pull|motor|servo|encoder|stroke|weg\b|hub\b|winch|angle|winkel|displacement")
_TIP = re.compile(r"tip|end|spitze|tcp|\bee\b|punta|bout")
_BASE = re.compile(r"base|clamp|fix|sockel|basis|root|mount")
# Triples of coordinates that are no places.
_NO_PLACE = re.compile(r"rot|quat|euler|acc|gyro|mag|vel|speed|force|moment|torque|angle")
_KINDS = {"tensions": (_TENSION, "force"), "pressures": (_PRESSURE, "pressure"),
          "pulls": (_PULL, "length")}  # fmt: skip
_ANGLES = {"deg": np.pi / 180, "°": np.pi / 180, "degrees": np.pi / 180, "rad": 1.0}


@dataclass(frozen=True)
class Input:
    """One actuator: its column, its `unit` (None: the file says it), and `scale` if it has one."""

    column: str
    unit: str | None
    scale: float | None = None


@dataclass(frozen=True)
class Guess:
    """Which columns are what; None or empty where nothing is.

    - `time`: a column, `time_unit`, `time_offset` in it; or `rate` [Hz].
    - `tip`: three columns, `unit`, `axes`, and `origin` in the file's axes and unit, or `rest`.
    - `inputs`: by the name of their kind.
    - `notes`: what was assumed, and `doubts`: by what of it ("time", "tip", "unit", "axes",
      "tensions", ..) is uncertain, so that a person should be asked.
    """

    time: str | None = None
    time_unit: str | None = None
    time_offset: float | None = None
    rate: float | None = None
    tip: tuple[str, str, str] | None = None
    unit: str | None = None
    axes: str | None = None
    origin: tuple[float, float, float] | None = None
    rest: bool = False
    inputs: dict[str, list[Input]] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    doubts: frozenset[str] = frozenset()

    def noted(self, note: str, *doubts: str) -> "Guess":
        return replace(self, notes=(*self.notes, note), doubts=self.doubts | set(doubts))


def guess(table: Table, counts: dict[str, int] | None = None) -> Guess:
    """What the columns of `table` may be. `counts`: of the scene's actuators by kind, if known."""
    found = _time(table, Guess())
    found = _tip(table, found)
    taken = {found.time, *(found.tip or ())}
    for triple in triples(table):
        taken |= set(triple)
    for kind in _KINDS:
        found = _inputs(table, found, kind, taken, None if counts is None else counts[kind])
    return found


def triples(table: Table) -> list[tuple[str, str, str]]:
    """Columns that are called alike but for x, y and z, or 1, 2 and 3 of one array."""
    groups: dict[tuple[str, str], dict[str, str]] = {}
    for column in table.columns:
        name = bare_name(column).strip().casefold()
        for pattern in (r"(.*?[ ._\-/]?)([xyz])()", r"()([xyz])([ ._\-/].*)", r"(.*\[)([123])(\])"):
            match = re.fullmatch(pattern, name)
            before_is_word = match and match[1] and match[1][-1].isalpha() and len(match[1]) > 6
            if match and not before_is_word:
                letter = {"1": "x", "2": "y", "3": "z"}.get(match[2], match[2])
                groups.setdefault((match[1], match[3]), {}).setdefault(letter, column)
                break
    whole = [(g["x"], g["y"], g["z"]) for g in groups.values() if len(g) == 3]
    return [t for t in whole if all(table.columns[c].dtype.kind == "f" for c in t)]


def _time(table: Table, found: Guess) -> Guess:
    named = [c for c in table.columns if _TIME.fullmatch(bare_name(c).strip().casefold())]
    united = [c for c in table.columns if _kind(table, c) == "time"]
    rising = [c for c in dict.fromkeys([*named, *united]) if _rises(table, c)]
    if not rising and table.interval is not None:
        return found.noted(f"the file itself says its rate, {1 / table.interval:g} Hz")
    if not rising:
        others = [c for c in table.columns if _rises(table, c) and not _counts(table, c)]
        first = next(iter(table.columns))
        if others != [] and others[0] == first:
            return time_of(table, found, first).noted(f"time is {first!r}: it only rises", "time")
        return found
    return time_of(table, found, rising[0])


def time_of(table: Table, found: Guess, column: str, unit: str | None = None) -> Guess:
    """With this column as its time, in `unit` if the file does not say it."""
    found = replace(found, time=column)
    values = table.columns[column]
    if values.dtype.kind in "OM":
        return found.noted(f"time is {column!r}, dates or times of day")
    said = table.unit(column)
    unit = unit or (units.canonical(said) if said else None)
    step = float(np.nanmedian(np.diff(values))) if len(values) > 1 else 1.0
    if unit is None:
        unit = "s" if step < 1 else "ms" if step < 1000 else "us" if step < 1e6 else "ns"
        found = found.noted(
            f"time is {column!r}, in {unit}: its samples are then "
            f"{step * units.UNITS['time'][unit]:.3g} s apart",
            *(() if unit == "s" else ("time",)),
        )
    else:
        found = found.noted(f"time is {column!r}, in {unit}")
    offset = -float(values[0]) if abs(values[0]) > 1e6 else None
    return replace(found, time_unit=unit, time_offset=offset)


def _tip(table: Table, found: Guess) -> Guess:
    places = [
        t for t in triples(table)
        if not _NO_PLACE.search(t[0].casefold())
        and _kind(table, t[0]) in (None, "length") and not _no_unit(table, t[0])
    ]  # fmt: skip
    tips = [t for t in places if _TIP.search(_stem(t))]
    others = [t for t in places if not _BASE.search(_stem(t))]
    chosen = tips or others
    if not chosen:
        return found
    moved = [np.nansum([np.nanstd(table.columns[c]) for c in t]) for t in chosen]
    tip = chosen[int(np.argmax(moved))]
    found = replace(found, tip=tip)
    if len(chosen) > 1:
        rest = ", ".join(t[0] for t in chosen if t != tip)
        found = found.noted(f"the tip is {tip[0]!r} and so on, which moves most; not {rest}", "tip")
    else:
        found = found.noted(f"the tip is {', '.join(map(repr, tip))}")
    bases = [t for t in places if _BASE.search(_stem(t))]
    if len(bases) == 1:
        origin = tuple(float(np.nanmedian(table.columns[c])) for c in bases[0])
        found = replace(found, origin=origin).noted(
            f"the clamp is where {bases[0][0]!r} and so on are in the middle", "origin"
        )
    return found


def _inputs(table: Table, found: Guess, kind: str, taken, count: int | None) -> Guess:
    if count == 0:
        return found
    pattern, quantity = _KINDS[kind]
    inside = {i.column for parts in found.inputs.values() for i in parts}
    free = [
        c for c, values in table.columns.items()
        if c not in taken and c not in inside and values.dtype.kind == "f"
    ]  # fmt: skip
    named = [c for c in free if pattern.search(bare_name(c).strip().casefold())]
    named = [c for c in named if _kind(table, c) in (None, quantity)]
    united = [c for c in free if _kind(table, c) == quantity and quantity != "length"]
    columns = [c for c in free if c in {*named, *united}]
    if kind == "tensions":  # a force under a name of another kind is that kind's
        columns = [c for c in columns if not _PRESSURE.search(bare_name(c).casefold())]
    if not columns:
        return found
    if count is not None and len(columns) != count:
        found = found.noted(f"{kind}: {len(columns)} columns, and the scene has {count}", kind)
        columns = columns[:count]
    for column in columns:
        found = input_of(table, found, kind, column)
    return found


def input_of(table: Table, found: Guess, kind: str, column: str, unit: str | None = None) -> Guess:
    """With one more actuator of a kind, in `unit` if the file does not say it."""
    quantity = _KINDS[kind][1]
    said = unit or table.unit(column)
    one, what = Input(column, units.canonical(said) if said else None), ""
    if said is None or one.unit is None:
        largest = float(np.nanmax(np.abs(table.columns[column]), initial=0.0))
        usual = {
            "force": "N",
            "pressure": "bar" if largest < 15 else "kPa" if largest < 2000 else "Pa",
            "length": "mm" if largest > 0.5 else "m",
        }[quantity]
        if kind == "pulls" and said is not None and said.casefold() in _ANGLES:
            found = found.noted(f"{column!r} is an angle: --pulley gives the radius", "pulley")
            one = Input(column, None, _ANGLES[said.casefold()])
        else:
            one, what = Input(column, usual), f", which is assumed: it is up to {largest:.3g}"
    parts = [*found.inputs.get(kind, []), one]
    found = replace(found, inputs={**found.inputs, kind: parts})
    shown = f"in {one.unit}" if one.unit else "an angle"
    doubts = (kind,) if what else ()
    return found.noted(f"{kind[:-1]} {len(parts)} is {column!r}, {shown}{what}", *doubts)


def _stem(triple) -> str:
    return bare_name(triple[0]).casefold()


def _kind(table: Table, column: str) -> str | None:
    """The quantity of a column by its unit, if the file says that."""
    said = table.unit(column)
    name = units.canonical(said) if said else None
    return None if name is None else units.kind_of(name).removeprefix("a ")


def _no_unit(table: Table, column: str) -> bool:
    """Whether the file says a unit that is none of a length."""
    said = table.unit(column)
    return bool(said) and units.canonical(said) is None and units.is_unit(said)


def _rises(table: Table, column: str) -> bool:
    values = table.columns[column]
    if values.dtype.kind in "OM":
        return bool(_TIME.fullmatch(bare_name(column).strip().casefold()))
    return column not in table.wrong and len(values) > 1 and bool(np.all(np.diff(values) > 0))


def _counts(table: Table, column: str) -> bool:
    """Whether a column is the number of the row."""
    values = table.columns[column]
    return values.dtype.kind == "f" and bool(np.all(np.diff(values) == 1))
