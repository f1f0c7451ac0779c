"""Notebooks as pages, with their pictures and films, and a gallery of them.

Each notebook in `notebooks/` becomes the page `notebooks/NAME.md`, with the outputs that are
committed with it; the tests run the notebooks and ask for outputs. With EXECUTE_NOTEBOOKS=true in
the environment they are executed when the site is built, which takes minutes.

    <!-- notebooks -->     a line of a page that is replaced by all notebooks: a picture, the title,
                           what it is about
"""

import base64
import json
import re
from pathlib import Path

from mkdocs.exceptions import PluginError
from mkdocs.structure.files import File

FOLDER = Path(__file__).parents[1] / "notebooks"
_COMMENT = "<!-- notebooks -->"
_PICTURES = {"image/gif": "gif", "image/png": "png"}  # the film rather than its first moment
_LINK = re.compile(r"\]\((\w+)\.ipynb\)")


def on_files(files, config):
    for path in sorted(FOLDER.glob("*.ipynb")):
        text, pictures = page_of(_read(path, config["extra"].get("execute_notebooks")), path.stem)
        files.append(File.generated(config, f"notebooks/{path.stem}.md", content=text))
        for name, content in pictures.items():
            files.append(File.generated(config, f"notebooks/{name}", content=content))
    return files


def on_page_markdown(markdown, page, config, files):
    if _COMMENT not in markdown:
        return markdown
    return markdown.replace(_COMMENT, "\n\n".join(map(_entry, sorted(FOLDER.glob("*.ipynb")))))


def _read(path: Path, execute: bool) -> dict:
    if not execute:
        return json.loads(path.read_text(encoding="utf-8"))
    try:
        import nbclient
        import nbformat
    except ImportError:
        raise PluginError(
            'EXECUTE_NOTEBOOKS needs the extra: pip install -e ".[docs,notebooks]"'
        ) from None
    fresh = nbformat.read(path, as_version=4)
    where = {"metadata": {"path": str(path.parent)}}
    nbclient.NotebookClient(fresh, timeout=1200, resources=where).execute()
    return json.loads(nbformat.writes(fresh))


def page_of(notebook: dict, name: str) -> tuple[str, dict[str, bytes]]:
    """The page of a notebook as markdown, and its pictures by their names."""
    parts, pictures = [], {}
    for cell in notebook["cells"]:
        source = "".join(cell["source"]).strip()
        if cell["cell_type"] == "markdown":
            parts.append(_LINK.sub(r"](\1.md)", source))
        elif cell["cell_type"] == "code" and source:
            parts.append(f"```python\n{source}\n```")
        written = []
        for output in cell.get("outputs", []):
            kind, content = _shown(output)
            if kind is None:
                written.append(content)
            else:
                parts += _block(written)
                picture = f"{name}/{len(pictures) + 1}.{kind}"
                pictures[picture] = content
                parts.append(f"![What the code above draws]({picture})")
        parts += _block(written)
    title, first, *others = parts[0].split("\n\n", 1) + parts[1:]
    where = f"*The notebook `notebooks/{name}.ipynb`, as it runs.*"
    return "\n\n".join([title, where, first, *others]) + "\n", pictures


def _block(written: list[str]) -> list[str]:
    """What was written since the last picture, as one block; leaves `written` empty."""
    text = "\n".join(written)
    written.clear()
    return [f"```text\n{text}\n```"] if text else []


def _shown(output: dict) -> tuple[str | None, str | bytes]:
    """The ending of a picture's name and its bytes, or None and the text of what is no picture."""
    data = output.get("data", {})
    for mime, kind in _PICTURES.items():
        if mime in data:
            return kind, base64.b64decode("".join(data[mime]))
    return None, "".join(output.get("text") or data.get("text/plain") or []).strip()


def _entry(path: Path) -> str:
    """A notebook in the gallery: its film if it has one, or the picture with most in it."""
    text, pictures = page_of(json.loads(path.read_text(encoding="utf-8")), path.stem)
    title = text.split("\n", 1)[0].removeprefix("# ")
    _, _, first, *_ = text.split("\n\n")
    films = [name for name in pictures if name.endswith(".gif")]
    picture = films[0] if films else max(pictures, key=lambda name: len(pictures[name]))
    page = f"notebooks/{path.stem}.md"
    image = f"[![{title}: a picture of this notebook](notebooks/{picture})]({page})"
    return f"## {title}\n\n{first}\n\n{image}\n\n[Read on]({page})"
