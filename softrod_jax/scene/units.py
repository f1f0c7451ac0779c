"""Numbers of a scene file that are written with their unit, such as "10 cm" or "0.2 MPa".

What units there are, and which are of one kind, pint knows (extra `units`). It takes a second to
import, and is asked only where a number is in quotes.
"""

import functools
import re
from typing import Any

_WRITTEN = re.compile(r"\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*([^\d\s.,+\-].*)")


class UnitError(ValueError):
    """What is wrong with a number and its unit, and what to do about it."""


def in_unit(value: Any, unit: str) -> Any:
    """`value`, a number or lists of them, with each that is written "NUMBER UNIT" in `unit`.

    Whatever else it holds stays as it is. Raises `UnitError` for a unit that there is not, or of
    another kind, and without pint.
    """
    if isinstance(value, list):
        return [in_unit(x, unit) for x in value]
    written = _WRITTEN.fullmatch(value) if isinstance(value, str) else None
    return value if written is None else _converted(float(written[1]), written[2], unit)


def _converted(number: float, given: str, unit: str) -> float:
    if not unit:
        raise UnitError("this number has no one unit: write it without")
    try:
        import pint
    except ImportError:
        raise UnitError(
            f"units need pint: pip install 'softrod_jax[units]'; or write the number in {unit}, "
            "without quotes"
        ) from None
    try:
        return float(_registry().Quantity(number, given).to(unit).magnitude)
    except pint.DimensionalityError:
        raise UnitError(f"{given} is no unit of this: give one like {unit}") from None
    except Exception:  # whatever a parser says of a text that is no unit
        raise UnitError(f"there is no unit {given}: give one like {unit}") from None


@functools.cache
def _registry():
    import pint

    return pint.UnitRegistry()
