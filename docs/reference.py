"""The reference: every public name, grouped by the file that it is from.

    <!-- reference: softrod_jax: scene sections -->   public names that come from these files
    <!-- reference: softrod_jax: rest -->             those that come from no file named anywhere,
                                                      if any, under the heading "Further"
    <!-- reference: softrod_jax: packages -->         those of the packages inside, if they have any
    <!-- layout: softrod_jax -->                      a table of its files, what each is for and
                                                      what it imports

A name is public if a package's `__init__` hands it on. A new one thus finds its place by itself.
"""

import ast
import re
from graphlib import TopologicalSorter
from pathlib import Path

ROOT = Path(__file__).parents[1]
_COMMENT = re.compile(r"^<!-- reference: ([\w.]+): ([\w. ]+) -->$", re.MULTILINE)
_LAYOUT = re.compile(r"^<!-- layout: (\w+) -->$", re.MULTILINE)

_placed = set()  # (package, file) of all comments on all pages


def public_names(package: str) -> dict[str, str]:
    """The module that each public name of `package` is from, in the order of `__init__`.

    Read from the source: imports, and the table of `calibration`, whose names are imported late.
    """
    folder = ROOT.joinpath(*package.split("."))
    tree = ast.parse((folder / "__init__.py").read_text(encoding="utf-8"))
    names = {}
    for node in tree.body:
        if isinstance(node, ast.ImportFrom) and node.module.startswith(f"{package}."):
            names |= {alias.asname or alias.name: node.module for alias in node.names}
        elif isinstance(node, ast.Assign) and node.targets[0].id == "_HOME":
            names |= ast.literal_eval(node.value)
    return names


def on_files(files, config):
    _placed.clear()
    for file in files.documentation_pages():
        text = Path(file.abs_src_path).read_text(encoding="utf-8")
        for package, homes in _COMMENT.findall(text):
            _placed.update((package, home) for home in homes.split())
    return files


def on_page_markdown(markdown, page, config, files):
    markdown = _LAYOUT.sub(lambda match: _layout(match.group(1)), markdown)
    return _COMMENT.sub(lambda match: _entries(*match.groups()), markdown)


def _entries(package: str, homes: str) -> str:
    if homes == "packages":
        inside = [
            f"{package}.{p.parent.name}" for p in sorted(ROOT.glob(f"{package}/*/__init__.py"))
        ]
        return "\n\n".join(
            f"## {inner}\n\n{_docstring(inner)}\n\n{_entries(inner, 'rest')}"
            for inner in inside
            if public_names(inner)
        )
    names = public_names(package)
    home = {name: module.removeprefix(f"{package}.") for name, module in names.items()}
    if homes == "rest":
        chosen = [name for name in names if (package, home[name]) not in _placed]
    else:
        chosen = []
        for h in homes.split():
            order = _definitions(package, h)
            own = [name for name in names if home[name] == h]
            chosen += sorted(own, key=lambda name: order.get(name, len(order)))
    # The anchor is the name as a user imports it.
    entries = [f'<a id="{package}.{name}"></a>\n\n::: {names[name]}.{name}' for name in chosen]
    heading = ["## Further"] if homes == "rest" and entries and "." not in package else []
    return "\n\n".join(heading + entries)


def _definitions(package: str, home: str) -> dict[str, int]:
    """What a file defines, and in which order."""
    source = ROOT.joinpath(*package.split("."), *home.split(".")).with_suffix(".py")
    body = ast.parse(source.read_text(encoding="utf-8")).body
    return {node.name: i for i, node in enumerate(body) if hasattr(node, "name")}


def _docstring(package: str) -> str:
    source = ROOT.joinpath(*package.split("."), "__init__.py")
    return ast.get_docstring(ast.parse(source.read_text(encoding="utf-8"))) or ""


def _layout(package: str) -> str:
    """Files in an order in which each imports from those above it."""
    trees = {
        path.stem: ast.parse(path.read_text(encoding="utf-8"))
        for path in sorted((ROOT / package).glob("*.py"))
        if path.stem != "__init__"
    }
    imports = {name: _imports(package, tree, trees) for name, tree in trees.items()}
    order = list(TopologicalSorter(imports).static_order())  # an error if they go in circles
    rows = []
    for name in order:
        head = (ast.get_docstring(trees[name]) or "").split("\n\n")[0].replace("\n", " ")
        others = ", ".join(f"`{x}`" for x in order if x in imports[name])
        rows.append([f"`{package}/{name}.py`", head.replace("|", "&#124;"), others])
    columns = 3 if any(row[2] for row in rows) else 2
    rows = [["file", "what it is for", "imports"], ["---"] * 3, *rows]
    return "\n".join("| " + " | ".join(row[:columns]) + " |" for row in rows)


def _imports(package: str, tree, known) -> list[str]:
    """The files of the package that one imports when it is imported itself."""
    found = set()
    for node in tree.body:
        if isinstance(node, ast.ImportFrom) and node.module == package:
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module.startswith(f"{package}."):
            found.add(node.module.split(".")[1])
    return sorted(found & set(known))
