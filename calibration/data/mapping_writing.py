"""A mapping file written from what was found in a file, with what was assumed as comments."""

import json
from collections.abc import Iterable, Sequence

from calibration.data.guesses import Guess


def mapping_text(
    source: str,
    found: Guess,
    csv: dict[str, str | int | bool],
    notes: Sequence[str] = (),
) -> str:
    """The text of a mapping file for `calibration.data.mapping`.

    `source`: the file it was made from; `csv`: what the reader of text has to be told; `notes`:
    what was assumed.
    """
    lines = [f"# How to read {source}: every key is in the documentation, `Your own data`."]
    lines += [f"# - {note}" for note in notes]
    lines += _time(found)
    lines += _tip(found)
    for kind, parts in found.inputs.items():
        for part in parts:
            scale = None if part.scale is None else f"{part.scale!r}"
            lines += _table(
                f"[[{kind}]]",
                {"column": _text(part.column), "unit": _text(part.unit), "scale": scale},
            )
    if csv:
        quoted = {key: _text(v) if isinstance(v, str) else str(v).lower() for key, v in csv.items()}
        lines += _table("[csv]", quoted)
    return "\n".join(lines) + "\n"


def _time(found: Guess) -> list[str]:
    if found.rate is not None:
        return _table("[time]", {"rate": repr(float(found.rate))})
    if found.time is None:  # the file knows
        return []
    offset = None if found.time_offset is None else repr(found.time_offset)
    return _table(
        "[time]",
        {"column": _text(found.time), "unit": _text(found.time_unit), "offset": offset},
    )


def _tip(found: Guess) -> list[str]:
    if found.tip is None:
        return []
    origin = None if found.origin is None else _list(map(repr, found.origin))
    return _table(
        "[tip]",
        {
            "columns": _list(map(_text, found.tip)),
            "unit": _text(found.unit),
            "axes": _text(found.axes),
            "origin": origin,
            "rest": "true" if found.rest else None,
        },
    )


def _table(head: str, values: dict) -> list[str]:
    return [head, *(f"{key} = {value}" for key, value in values.items() if value is not None)]


def _list(values: Iterable) -> str:
    return f"[{', '.join(map(str, values))}]"


def _text(value: str | None) -> str | None:
    """As TOML writes a text: as JSON does, but for a character that JSON may leave as it is."""
    return (
        None if value is None else json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    )
