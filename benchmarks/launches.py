"""What a compiled program launches and moves, read off its optimised text, loop by loop.

On a GPU every instruction of the optimised program that computes is one kernel, or a call of a
library, and each pass of a loop launches those of its body again. XLA's own analysis of costs
counts the body of a loop once; here a loop is kept apart, with the number of its passes where XLA
knows it. A program for a CPU is cut into other pieces, and is counted in the same way.
"""

import dataclasses
import math
import re
from collections.abc import Callable, Iterator

# What computes nothing, and what leads to other computations.
_FREE = {
    "parameter", "constant", "tuple", "get-tuple-element", "bitcast", "after-all", "opt-barrier",
    "partition-id", "replica-id", "copy-done", "async-done", "async-update", "add-dependency",
}  # fmt: skip
_SIZES = {"pred": 1, "s4": 1, "u4": 1, "s8": 1, "u8": 1, "bf16": 2, "s16": 2, "u16": 2, "f16": 2}
_SIZES |= {"s32": 4, "u32": 4, "f32": 4, "s64": 8, "u64": 8, "f64": 8, "c64": 8, "c128": 16}
_HEADER = re.compile(r"^(ENTRY )?%?([\w.\-]+) \(.*\{\s*$")
_LINE = re.compile(r"^\s+(ROOT )?%?([\w.\-]+) = (.*)$")
_ARRAY = re.compile(r"\b([a-z]+[0-9]*)\[([\d,]*)\]")
_TABLES = ("FileNames", "FunctionNames", "FileLocations", "StackFrames")


@dataclasses.dataclass
class Instruction:
    """`bytes`: of what it makes; `rest`: its text from the bracket of its operands on."""

    name: str
    kind: str
    bytes: int
    operands: list[str]
    rest: str
    root: bool

    def attribute(self, name: str) -> str | None:
        """A computation that it names."""
        found = re.search(rf"\b{name}=%?([\w.\-]+)", self.rest)
        return found.group(1) if found else None


@dataclasses.dataclass
class Loop:
    """One loop, or the whole program.

    - `name`: of the functions in whose code it is, the innermost.
    - `passes`: how many, `None` where only the running program knows.
    - `kernels`, `products` (of matrices, by a library), `bytes`: of one pass, `inner` loops apart.
    """

    name: str
    passes: int | None
    kernels: int = 0
    products: int = 0
    bytes: float = 0.0
    inner: list["Loop"] = dataclasses.field(default_factory=list)

    def walk(self, depth: int = 0) -> Iterator[tuple[int, "Loop"]]:
        """This loop and those inside, and how deep they are."""
        yield depth, self
        for loop in self.inner:
            yield from loop.walk(depth + 1)

    def total(self, what: Callable, runs: Callable) -> float:
        """Of `what(loop)` in the whole program; `runs(loop)`: its passes, if it does not say."""

        def below(loop, times):
            whole = runs(loop)
            passes = times * (loop.passes or 1) if whole is None else whole
            return passes * what(loop) + sum(below(inner, passes) for inner in loop.inner)

        return below(self, 1)


def program(text: str, files: str = "softrod_jax") -> Loop:
    """The loops of an optimised program; they are named after functions in paths with `files`."""
    computations, entry = _computations(text)
    functions = _functions(text, files)
    whole = Loop("whole program", 1)
    _collect(computations, entry, whole, functions)
    return whole


def _computations(text: str) -> tuple[dict[str, list[Instruction]], str]:
    found, entry, here = {}, "", None
    for line in text.splitlines():
        header = _HEADER.match(line)
        if header and not line.startswith(" "):
            here = found[header.group(2)] = []
            entry = header.group(2) if header.group(1) else entry
        elif line.startswith("}"):
            here = None
        elif here is not None and (match := _LINE.match(line)):
            here.append(_instruction(bool(match.group(1)), match.group(2), match.group(3)))
    if not entry:
        raise ValueError("launches: the text has no entry; give compiled.as_text()")
    return found, entry


def _instruction(root: bool, name: str, text: str) -> Instruction:
    end = _closing(text) + 1 if text.startswith("(") else text.index(" ")
    kind, rest = text[end:].strip().split("(", 1)
    inside = rest[: _closing("(" + rest) - 1]
    operands = re.findall(r"%([\w.\-]+)", inside)
    return Instruction(name, kind, _size(text[:end]), operands, rest, root)


def _closing(text: str) -> int:
    """Where the bracket that `text` begins with is closed."""
    depth = 0
    for k, letter in enumerate(text):
        depth += (letter == "(") - (letter == ")")
        if depth == 0:
            return k
    return len(text)


def _size(shapes: str) -> int:
    """Of all arrays of a type, a tuple's too."""
    return sum(
        _SIZES.get(kind, 0) * math.prod(int(n) for n in dims.split(",") if n)
        for kind, dims in _ARRAY.findall(shapes)
    )


def _collect(computations, name: str, loop: Loop, functions: dict[str, str]) -> None:
    body = computations.get(name, [])
    known = {x.name: x for x in body}
    for x in body:
        if x.kind == "while":
            trips = re.search(r'known_trip_count":\{"n":"(\d+)"', x.rest)
            inner = Loop(_place(x, functions), int(trips.group(1)) if trips else None)
            for part in ("condition", "body"):
                _collect(computations, x.attribute(part), inner, functions)
            loop.inner.append(inner)
        elif x.kind in ("call", "async-start") or x.kind == "conditional":
            for called in _called(x):
                _collect(computations, called, loop, functions)
        elif x.kind not in _FREE:
            loop.kernels += 1
            # XLA may wrap a product into a fusion.
            parts = [x, *computations.get(x.attribute("calls") or "", [])]
            loop.products += any(y.kind == "dot" or "gemm" in y.rest for y in parts)
            loop.bytes += _moved(x, known, computations)


def _called(x: Instruction) -> list[str]:
    branches = re.search(r"branch_computations=\{([^}]*)\}", x.rest)
    if branches:
        return re.findall(r"%?([\w.\-]+)", branches.group(1))
    names = ("to_apply", "calls", "true_computation", "false_computation")
    return [name for name in map(x.attribute, names) if name is not None]


def _moved(x: Instruction, known, computations) -> float:
    """Bytes read and written; of what a fusion slices or updates in place, only that part."""
    reads = [known[name].bytes if name in known else 0 for name in x.operands]
    if x.kind in ("dynamic-slice", "gather"):
        return 2 * x.bytes
    if x.kind == "dynamic-update-slice":
        return 2 * reads[1]
    if x.kind != "fusion":
        return sum(reads) + x.bytes
    inside = computations.get(x.attribute("calls"), [])
    by_name = {y.name: y for y in inside}
    written = x.bytes
    for y in inside:
        if y.kind == "parameter":
            k = int(re.match(r"(\d+)", y.rest).group(1))
            uses = [z for z in inside if y.name in z.operands]
            sliced = [z for z in uses if z.kind == "dynamic-slice" and z.operands[0] == y.name]
            updated = [
                z for z in uses if z.kind == "dynamic-update-slice" and z.operands[0] == y.name
            ]
            if uses and len(sliced) + len(updated) == len(uses) and k < len(reads):
                reads[k] = sum(z.bytes for z in sliced)
        if y.kind == "dynamic-update-slice" and y.operands[0] in by_name:
            if by_name[y.operands[0]].kind == "parameter":
                written += by_name[y.operands[1]].bytes - y.bytes
    return sum(reads) + max(written, 0)


def _place(x: Instruction, functions: dict[str, str]) -> str:
    frame = re.search(r"stack_frame_id=(\d+)", x.rest)
    return functions.get(frame.group(1), "?") if frame else "?"


def _functions(text: str, files: str) -> dict[str, str]:
    """The name of the innermost function of each frame of calls."""
    tables: dict[str, dict[str, str]] = {name: {} for name in _TABLES}
    here = None
    for line in text.splitlines():
        if line in tables:
            here = tables[line]
        elif here is not None and (row := re.match(r"(\d+) (.*)$", line)):
            here[row.group(1)] = row.group(2)
        elif line.endswith("{") and here is not None and line[:1] not in "0123456789":
            break

    def of(row: str, name: str) -> str:
        found = re.search(rf"\b{name}=(\d+)", row)
        return found.group(1) if found else ""

    names = {}
    for frame in tables["StackFrames"]:
        at, seen = frame, set()
        while at and at not in seen:
            seen.add(at)
            row = tables["StackFrames"].get(at, "")
            place = tables["FileLocations"].get(of(row, "file_location_id"), "")
            if files in tables["FileNames"].get(of(place, "file_name_id"), ""):
                name = tables["FunctionNames"].get(of(place, "function_name_id"), "?").strip('"')
                names[frame] = name.replace(".<locals>", "")
                break
            at = of(row, "parent_frame_id")
    return names
