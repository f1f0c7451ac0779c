"""Units: their factors to SI, and what files write for them.

A file that says a unit (a C3D, a row of units, `X [mm]`) is believed, and a mapping that says
another is an error: a factor of 1000 must not be applied twice, or not at all.
"""

import re

UNITS = {
    "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0, "h": 3600.0, "d": 86400.0},
    "length": {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6, "in": 0.0254},
    "force": {"N": 1.0, "mN": 1e-3, "kN": 1e3, "gf": 9.80665e-3, "kgf": 9.80665,
              "ozf": 0.2780139, "lbf": 4.4482216},
    "pressure": {"Pa": 1.0, "hPa": 1e2, "kPa": 1e3, "MPa": 1e6, "mbar": 1e2, "bar": 1e5,
                 "psi": 6894.757, "mmHg": 133.322387, "atm": 101325.0},
}  # fmt: skip

# What else they are called, in lower case. A load cell that shows grams means their weight.
_ALIASES = {
    "s": "sec secs second seconds seconde secondes sekunde sekunden sek",
    "ms": "msec millisecond milliseconds millisecondes millisekunden",
    "us": "µs μs usec microsecond microseconds",
    "ns": "nanosecond nanoseconds",
    "min": "minute minutes minuten",
    "h": "hour hours stunden",
    "d": "day days tage jours",
    "m": "meter meters metre metres mètre mètres",
    "cm": "centimeter centimeters centimetre centimetres zentimeter",
    "mm": "millimeter millimeters millimetre millimetres millimètres",
    "um": "µm μm micrometer micrometers micron microns",
    "in": "inch inches zoll",
    "N": "newton newtons",
    "gf": "g gram grams gramm pond p",
    "kgf": "kg kilogram kilograms kilogramm kp",
    "ozf": "oz",
    "lbf": "lb lbs pound pounds",
    "Pa": "pascal pascals",
    "kPa": "kilopascal",
    "bar": "barg",
    "mbar": "millibar mbarg",
    "psi": "psig",
    "mmHg": "torr",
}
# What is neither time, length, force nor pressure, and must not be taken for one of them.
_OTHERS = {
    "an angle": "deg degree degrees ° rad radian radians grad euler quaternion",
    "a voltage": "v volt volts mv µv uv",
    "a current": "a ma amp amps",
    "a speed": "m/s mm/s rad/s deg/s °/s",
    "an acceleration": "m/s^2 m/s² m/s2 mm/s^2 mm/s² mm/s2",
    "a moment": "nm n*m n·m n.m nmm n*mm n·mm n.mm",
    "a power": "w watt",
    "a temperature": "°c °f k degc",
    "a frequency": "hz khz",
    "a part": "%",
}
_UNKNOWN = "no known unit"
_KIND = {name: kind for kind, names in UNITS.items() for name in names}
_BY_NAME = {
    **{other: name for name, others in _ALIASES.items() for other in others.split()},
    # A capital letter makes the difference between a milli- and a meganewton.
    **{name.lower(): name for name in _KIND if name != "mN"},
}
_OTHER = {name: kind for kind, names in _OTHERS.items() for name in names.split()}
_BRACKETED = re.compile(r"[\[(/]\s*([^\[\]()/]+(?:/[^\[\]()/]+)?)\s*[\])]?\s*$")
# Only those that stand for nothing else at the end of a name: `P_in` is no length.
_SUFFIX = re.compile(r"[_ ](ms|us|ns|mm|cm|mN|kN|gf|kgf|lbf|Pa|hPa|kPa|MPa|mbar|bar|psi)$")
_WORD = re.compile(r" in (s|ms|us|m|mm|cm|N|mN|kN|gf|kgf|lbf|Pa|hPa|kPa|MPa|mbar|bar|psi)$")


def canonical(text: str) -> str | None:
    """The name in `UNITS` of the unit that a file calls `text`, or None."""
    name = text.strip().strip("[](){}").strip()
    return name if name in _KIND else _BY_NAME.get(name.lower())


def is_unit(text: str) -> bool:
    """Whether `text` is any unit at all, or the dash that stands for none."""
    name = text.strip().strip("[](){}").strip().lower()
    return canonical(text) is not None or name in _OTHER or name in ("-", "1", "")


def kind_of(text: str) -> str:
    """What a unit measures, in words."""
    name = canonical(text)
    if name is not None:
        kind = _KIND[name]
        return f"a {kind}"
    return _OTHER.get(text.strip().strip("[](){}").strip().lower(), _UNKNOWN)


def in_name(column: str) -> str | None:
    """The unit that a column's name ends with: `F [N]`, `Time (Seconds)`, `P / kPa`, `x_mm`, `P in
    kPa`."""
    found = _BRACKETED.search(column)
    if found and found.start() > 0 and kind_of(found.group(1)) != _UNKNOWN:
        return found.group(1).strip()
    found = _SUFFIX.search(column) or _WORD.search(column)
    return found.group(1) if found else None


def factor(kind: str, name: str) -> float | None:
    """The factor to SI of the unit `name` of this kind, under any of its names; None if none."""
    return UNITS[kind].get(canonical(name) or "")
