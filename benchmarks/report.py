"""What the benchmarks share: the machine's name, tables, and their place in the docs."""

import os
import platform
import sys
from importlib.metadata import version
from pathlib import Path

PAGES = Path(__file__).parents[1] / "docs" / "pages"


def machine() -> str:
    """One line: processor, cores and versions."""
    packages = ", ".join(f"{name} {version(name)}" for name in ("jax", "jaxlib", "numpy"))
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    return f"{_processor()}, {cores} cores, Python {platform.python_version()}, {packages}"


def _processor() -> str:
    try:
        for line in Path("/proc/cpuinfo").read_text().splitlines():
            if line.startswith("model name"):
                return line.split(":", 1)[1].strip()
    except OSError:
        pass  # not Linux
    return platform.processor() or platform.machine()


def table(header: list[str], rows: list[list[str]]) -> str:
    """A markdown table."""
    lines = [header, ["---"] * len(header), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def publish(name: str, page: str, text: str) -> None:
    """Print `text`; with --write-docs put it between the markers of this name in `page`."""
    print(text)
    if "--write-docs" in sys.argv[1:]:
        put(name, page, text)


def put(name: str, page: str, text: str) -> None:
    """`text` between the markers of this name in a page of the documentation.

    Raises `ValueError` if the page does not have both markers once.
    """
    path = PAGES / page
    begin, end = f"<!-- {name}: begin -->\n", f"\n<!-- {name}: end -->"
    content = path.read_text(encoding="utf-8")
    if content.count(begin) != 1 or content.count(end) != 1:
        raise ValueError(f"{path}: the markers {begin.strip()} and {end.strip()} are needed once")
    before, rest = content.split(begin)
    _, after = rest.split(end)
    path.write_text(f"{before}{begin}{text}{end}{after}", encoding="utf-8")
