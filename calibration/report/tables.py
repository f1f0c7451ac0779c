"""Tables of a report in HTML."""

from html import escape


class Html(str):
    """Text that is HTML; all other text is escaped where it goes into a table."""


def table(head, rows) -> str:
    """An HTML table; text is escaped."""
    shown = lambda cell: cell if isinstance(cell, Html) else escape(cell)
    line = lambda cells, tag: (
        "<tr>" + "".join(f"<{tag}>{shown(c)}</{tag}>" for c in cells) + "</tr>"
    )
    return "<table>" + line(head, "th") + "".join(line(row, "td") for row in rows) + "</table>"
