"""What one cell of a text table says: a number as people in several countries write it.

Never guessed: `1,234` may be one or a thousand. With the decimal sign given the other sign can only
separate thousands; without, such a cell is refused, with the key of the mapping that decides.
"""

import math
import re
from dataclasses import dataclass, field

# What loggers, spreadsheets and statistics programs write for a sample that is missing.
_MISSING = frozenset(
    "nan -nan +nan na n/a n.a. #n/a #na #nv #nan <na> null nil none missing nul - -- --- "
    "nan(ind) -nan(ind) 1.#qnan -1.#qnan 1.#ind -1.#ind 1.#qnan0 -1.#ind0".split()
)
_SIGNS = str.maketrans({"\u2212": "-", "\u2013": "-"})
# Spaces and apostrophes inside a number can only be separators of thousands.
_SPACES = " \u00a0\u202f\u2009'\u2019"
_PLAIN = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?")


class CellError(ValueError):
    """A cell that is no number: what to do about it."""


@dataclass(frozen=True)
class NumberFormat:
    """How the numbers of a file are written.

    - `decimal`: "." or ",", or None if the mapping does not say: then it is a point.
    - `thousands`: what separates thousands, or None: what can be nothing else.
    - `missing`: further texts that stand for a missing sample, in lower case.
    """

    decimal: str | None = None
    thousands: str | None = None
    missing: frozenset[str] = field(default_factory=frozenset)

    def is_missing(self, text: str) -> bool:
        low = text.lower()
        return not text or low in _MISSING or low in self.missing

    def read(self, text: str) -> float:
        """The number; NaN for a cell that stands for a missing sample. Raises `CellError`."""
        if self.decimal != "," and not self.missing:
            # Nearly all cells are what Python takes for a finite number, and this is quick.
            try:
                value = float(text)
            except ValueError:
                value = math.inf
            if math.isfinite(value) and "_" not in text:
                return value
        text = text.strip()
        if self.is_missing(text):
            return math.nan
        text = text.translate(_SIGNS)
        number = self._ungrouped(text)
        if _PLAIN.fullmatch(number):
            value = float(number)
            if math.isinf(value):
                raise CellError("larger than any number of 64 bits")
            return value
        raise CellError(self._hint(text))

    def looks_like_one(self, text: str) -> bool:
        """Whether the cell is a number, however it is written; a missing one is none."""
        text = text.strip().translate(_SIGNS)
        return bool(text) and any(
            _PLAIN.fullmatch(NumberFormat(decimal)._ungrouped(text)) for decimal in ".,"
        )

    def _ungrouped(self, text: str) -> str:
        """`text` with a decimal point, and without separators of thousands."""
        decimal = self.decimal or "."
        separators = _SPACES if self.thousands is None else self.thousands
        other = "," if decimal == "." else "."
        if self.thousands is None and (self.decimal is not None or decimal in text):
            separators += other
        if _PLAIN.fullmatch(text):
            # With a decimal comma, a point is none: neither in 0.5 nor in 20.000.
            if decimal == "." or "." not in text:
                return text
        for separator in separators:
            if separator in text and _grouped(separator, decimal).fullmatch(text):
                text = text.replace(separator, "")
                break
        if decimal == ",":
            text = text.replace(".", "\0").replace(",", ".")
        return text

    def _hint(self, text: str) -> str:
        """What would make a number of a text that is none."""
        for decimal, thousands in ((",", None), (".", None), (".", ","), (",", ".")):
            if decimal != self.decimal and _PLAIN.fullmatch(
                NumberFormat(decimal, thousands)._ungrouped(text)
            ):
                way = f"[csv] decimal = '{decimal}' in the mapping reads it"
                if self.decimal is None and decimal == "," and "," in text:
                    both = _PLAIN.fullmatch(NumberFormat(".")._ungrouped(text))
                    way += ", or decimal = '.' if the comma separates thousands" if both else ""
                return way
        if text.lower() in ("inf", "-inf", "+inf", "infinity", "-infinity", "+infinity"):
            return "not finite"
        if text.startswith("#"):
            return "an error of the spreadsheet"
        return ""


def _grouped(separator: str, decimal: str) -> re.Pattern:
    """Numbers with groups of three digits, the first of which does not begin with a zero."""
    s, d = re.escape(separator), re.escape(decimal)
    return re.compile(rf"[+-]?[1-9]\d{{0,2}}({s}\d{{3}})+({d}\d*)?([eE][+-]?\d+)?")
