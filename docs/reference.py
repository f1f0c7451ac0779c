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
import itertools
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
        text = file.content_string
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
    if not source.exists():  # a folder of tests
        return ""
    return ast.get_docstring(ast.parse(source.read_text(encoding="utf-8"))) or ""


def _layout(package: str) -> str:
    """Rooms in an order in which each imports from those above it; so do the files of a room."""
    trees = sources(package)
    imports = {name: imports_of(package, tree, trees) for name, tree in trees.items()}
    order = in_order(imports)
    rooms = in_order(between_rooms(imports))
    sections = []
    for alone, group in itertools.groupby(rooms, key=trees.__contains__):
        if alone:  # files outside of any room
            sections.append(_table(package, list(group), imports, trees))
            continue
        for room in group:
            path = f"{package}/{room.replace('.', '/')}/"
            files = [name for name in order if room_of(name) == room]
            title = f"**`{path}`** {_docstring(f'{package}.{room}')}"
            sections.append(f"{title}\n\n{_table(package, files, imports, trees)}")
    return "\n\n".join(sections)


def _table(package: str, files, imports, trees) -> str:
    rows = []
    for name in files:
        head = (ast.get_docstring(trees[name]) or "").split("\n\n")[0].replace("\n", " ")
        others = ", ".join(f"`{short(x, name)}`" for x in sorted(imports[name]))
        path = f"{package}/{name.replace('.', '/')}.py"
        rows.append([f"`{path}`", head.replace("|", "&#124;"), others])
    columns = 3 if any(row[2] for row in rows) else 2
    rows = [["file", "what it is for", "imports"], ["---"] * 3, *rows]
    return "\n".join("| " + " | ".join(row[:columns]) + " |" for row in rows)


def sources(package: str) -> dict[str, ast.Module]:
    """The files of a package and of its rooms, by their dotted names below it."""
    folder = ROOT / package
    return {
        ".".join(path.relative_to(folder).with_suffix("").parts): ast.parse(path.read_text("utf-8"))
        for path in sorted(folder.rglob("*.py"))
        if path.stem not in ("__init__", "__main__")
    }


def imports_of(package: str, tree, known) -> set[str]:
    """The files of the package that one imports, also those that it imports when it is used."""
    found = set()
    for module, name in imported(tree):
        if module != package and not module.startswith(f"{package}."):
            continue
        inside = module.removeprefix(package).removeprefix(".")
        full = f"{inside}.{name}".removeprefix(".")
        found |= {x for x in (full, inside) if x in known}
    return found


def imported(tree) -> list[tuple[str, str]]:
    """Every module that a file imports from, anywhere in it, and the name that it takes."""
    pairs = []
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            pairs += [(alias.name, "") for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.module:
            pairs += [(node.module, alias.name) for alias in node.names]
    return pairs


def room_of(name: str) -> str:
    """The folder that a file lies in; empty for those of the package itself."""
    return name.rpartition(".")[0]


def between_rooms(imports: dict[str, set[str]]) -> dict[str, set[str]]:
    """Which rooms each room imports from. A file outside of any room is a room of its own."""
    place = lambda name: room_of(name) or name
    found = {place(name): set() for name in imports}
    for name, others in imports.items():
        found[place(name)] |= {place(x) for x in others} - {place(name)}
    return found


def in_order(imports: dict[str, set[str]]) -> list[str]:
    """Each after all that it imports. Raises `graphlib.CycleError` where they go in circles."""
    return list(TopologicalSorter(imports).static_order())


def short(name: str, seen_from: str) -> str:
    """A file's name as its neighbours call it."""
    inside = room_of(name) == room_of(seen_from)
    return name.rpartition(".")[2] if inside else name.replace(".", "/")
