"""Times of day and dates in the cells of a text table, as seconds or as moments."""

import re
from datetime import UTC, datetime

import numpy as np

from calibration.data import units

_MOMENT = np.dtype("datetime64[ns]")
# Forms that mean one thing only. 1/5/2024 is a day in January or in May.
_GERMAN = re.compile(r"(\d{1,2})\.(\d{1,2})\.(\d{4})[ T]+(\d{1,2}:\d{2}(?::\d{2}.*)?)")
_MATLAB = re.compile(r"\d{1,2}-[A-Za-z]{3}-\d{4}[ T]\d{1,2}:\d{2}:\d{2}.*")
_DURATION = re.compile(r"([\d.]+)\s*([a-zµ]+)")
_OF_DAY = re.compile(r"(?:(\d+):)?(\d{1,2}):(\d{2}(?:[.,]\d*)?)")


class DateError(ValueError):
    """A cell that is no date: what to do about it."""


def looks_like_one(text: str) -> bool:
    """Whether a cell is a date or a time of day, in whatever order."""
    return bool(
        re.match(r"\d{1,4}([-./])\w{1,3}\1\d{1,4}\b|\d{1,2}:\d{2}(:\d{2})?([.,]\d+)?$", text)
    )


def moment(text: str, form: str | None) -> np.datetime64 | float:
    """The moment that `text` names or the seconds since midnight if it is a time of day, or of a
    duration such as `0.01 sec`.

    `form`: as for `datetime.strptime`; None for ISO 8601, `5.1.2024 10:00:00,5`,
    `05-Jan-2024 10:00:00` and `10:00:00.5`. A moment with a zone is turned to UTC.

    Raises `DateError`.
    """
    text = text.strip()
    if form is not None:
        return _formed(text, form)
    found = _OF_DAY.fullmatch(text)
    if found:
        hours, minutes, seconds = found.groups()
        return 3600 * int(hours or 0) + 60 * int(minutes) + float(seconds.replace(",", "."))
    found = _DURATION.fullmatch(text)
    if found is not None:
        size = units.factor("time", found.group(2))
        if size is not None and found.group(1).count(".") < 2:
            return size * float(found.group(1))
    found = _GERMAN.fullmatch(text)
    if found:
        day, month, year, clock = found.groups()
        text = (
            f"{year}-{int(month):02}-{int(day):02} {clock.zfill(8 if clock.count(':') > 1 else 5)}"
        )
    if _MATLAB.fullmatch(text):
        return _formed(text.replace("T", " "), "%d-%b-%Y %H:%M:%S" + (".%f" if "." in text else ""))
    text, nanoseconds = _split_fraction(text.replace("/", "-") if text[4:5] == "/" else text)
    try:
        return _utc(datetime.fromisoformat(text)) + np.timedelta64(nanoseconds, "ns")
    except (ValueError, OverflowError):
        raise DateError(
            "neither a number nor a date that has one meaning: say its form in the mapping, such "
            "as [time] format = '%d/%m/%Y %H:%M:%S.%f'"
        ) from None


def _split_fraction(text: str) -> tuple[str, int]:
    """The text without its fraction of a second, and that in nanoseconds."""
    found = re.search(r"(?<=:\d\d)[.,](\d+)", text)
    if not found:
        return text, 0
    digits = found.group(1)[:9].ljust(9, "0")
    return text[: found.start()] + text[found.end() :], int(digits)


def _formed(text: str, form: str) -> np.datetime64:
    if "%f" in form:  # of which Python reads six digits
        text = re.sub(r"([.,:]\d{6})\d+", r"\1", text)
    try:
        return _utc(datetime.strptime(text, form))
    except (ValueError, OverflowError):
        raise DateError(f"does not have the form {form!r} of the mapping") from None


def _utc(when: datetime) -> np.datetime64:
    if when.tzinfo is not None:
        when = when.astimezone(UTC).replace(tzinfo=None)
    if not 1678 <= when.year < 2262:
        raise ValueError("beyond what nanoseconds of 64 bits hold")
    return np.datetime64(when).astype(_MOMENT)
