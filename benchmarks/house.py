"""The structure of the package in figures: rooms, circles, lengths, shapes.

    python -m benchmarks.house             # all of it; runs one trace of the demo
    python -m benchmarks.house --static    # what can be read from the sources alone

Counted are the modules of `hydrojax/`, `identify/` and `tune/`:

- loose files: modules directly in `hydrojax/`;
- doubled names: public classes and functions that two modules define;
- circles: modules that import each other in a ring, imports for types included;
- long functions and files: past 60 and past 300 lines;
- shapeless signatures: arrays without a shape in a public function or class;
- files run: package files in which a function ran between the first row of a CSV and
  the last byte of report.json, in a call of `hydrojax.trace`; with the lines of all of
  them, since no file may pass 300.
"""

from __future__ import annotations

import argparse
import ast
import inspect
import json
import math
import re
import sys
import threading
from collections import defaultdict
from collections.abc import Iterator
from importlib import resources
from pathlib import Path

ROOT = Path(__file__).parents[1]
ROOMS = {
    "hydrojax": "hydrojax",
    "identify": "hydrojax.identify",
    "tune": "hydrojax.tune",
}
"""Folders and the packages they are."""

LONG_FUNCTION = 60
LONG_FILE = 300
FUNCTION = inspect.CO_OPTIMIZED | inspect.CO_NEWLOCALS
"""Flags of the code of a function; that of a module or a class body lacks them."""

BARE = re.compile(
    r"(?<![\w\[.])(?:(?:jax|jnp|np)\.)?(?:Array|ndarray)\b(?!\s*,\s*['\"])(?!Like)"
)
"""An array type that stands by itself, not in `Float[Array, "..."]`."""


def modules() -> dict[str, Path]:
    """Every module of the package by its full name, and its file."""
    out = {}
    for folder, package in ROOMS.items():
        for path in sorted((ROOT / folder).rglob("*.py")):
            inner = path.relative_to(ROOT / folder).with_suffix("").parts
            if folder == "hydrojax" and inner[0] in ("identify", "tune"):
                continue  # the links to the two folders at the top
            out[".".join((package, *inner)).removesuffix(".__init__")] = path
    return out


def parsed(path: Path) -> ast.Module:
    """The syntax tree of a source file."""
    return ast.parse(path.read_text(encoding="utf-8"))


def only_for_types(node: ast.AST) -> bool:
    """Whether this is `if TYPE_CHECKING:`, which never runs."""
    return isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test)


def _walk(node: ast.AST, types: bool) -> Iterator[ast.AST]:
    for child in ast.iter_child_nodes(node):
        if types or not only_for_types(child):
            yield child
            yield from _walk(child, types)


def imports(module: str, path: Path, types: bool = True) -> set[str]:
    """What a module imports anywhere in its text, as absolute names.

    `from a import b` gives both `a` and `a.b`: the name may be a module. Imports under
    `if TYPE_CHECKING:` count where `types` is True.
    """
    out: set[str] = set()
    package = module if path.name == "__init__.py" else module.rpartition(".")[0]
    for node in _walk(parsed(path), types):
        if isinstance(node, ast.Import):
            out |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            base = node.module or ""
            if node.level:
                stem = package.split(".")
                stem = stem[: len(stem) - node.level + 1]
                base = ".".join([*stem, base] if base else stem)
            out |= {base} | {f"{base}.{alias.name}" for alias in node.names}
    return out


def under(module: str, package: str) -> bool:
    """Whether a module is a package or lies in it."""
    return module == package or module.startswith(package + ".")


def arrows(types: bool = True) -> dict[str, set[str]]:
    """Each module, and the modules of the package that it imports.

    A package that is named only on the way to a module of its own does not count.
    """
    known = modules()
    return {
        m: {n for n in imports(m, path, types) & set(known) if not under(m, n)}
        for m, path in known.items()
    }


def circles(graph: dict[str, set[str]]) -> list[list[str]]:
    """Groups of modules that reach each other (strongly connected components)."""
    index: dict[str, int] = {}
    low: dict[str, int] = {}
    stack: list[str] = []
    found: list[list[str]] = []

    def visit(node: str) -> None:
        index[node] = low[node] = len(index)
        stack.append(node)
        for other in graph[node]:
            if other not in index:
                visit(other)
                low[node] = min(low[node], low[other])
            elif other in stack:
                low[node] = min(low[node], index[other])
        if low[node] == index[node]:
            at = stack.index(node)
            group = stack[at:]
            del stack[at:]
            if len(group) > 1:
                found.append(sorted(group))

    for node in graph:
        if node not in index:
            visit(node)
    return found


def loose_files() -> list[str]:
    """Modules directly in `hydrojax/`."""
    return sorted(p.name for p in (ROOT / "hydrojax").glob("*.py"))


def doubled_names() -> dict[str, list[str]]:
    """Public classes and functions that more than one module defines.

    A command of the command line (`hydrojax.cli`) has the name of the function that
    does its work, which is the same thing, so `cli` is left out.
    """
    homes: dict[str, set[str]] = defaultdict(set)
    for module, path in modules().items():
        if under(module, "hydrojax.cli"):
            continue
        for node in parsed(path).body:
            named = isinstance(node, ast.ClassDef | ast.FunctionDef)
            if named and not node.name.startswith("_"):
                homes[node.name].add(module)
    return {name: sorted(found) for name, found in homes.items() if len(found) > 1}


def _functions(tree: ast.Module) -> Iterator[ast.FunctionDef]:
    return (n for n in ast.walk(tree) if isinstance(n, ast.FunctionDef))


def long_functions() -> list[str]:
    """Functions past `LONG_FUNCTION` lines, as `module.name (lines)`."""
    return [
        f"{module}.{f.name} ({lines})"
        for module, path in modules().items()
        for f in _functions(parsed(path))
        if (lines := (f.end_lineno or 0) - f.lineno + 1) > LONG_FUNCTION
    ]


def long_files() -> list[str]:
    """Modules past `LONG_FILE` lines, as `module (lines)`."""
    lengths = {m: _length(p) for m, p in modules().items()}
    return [f"{m} ({n})" for m, n in lengths.items() if n > LONG_FILE]


def _length(path: Path) -> int:
    return len(path.read_text(encoding="utf-8").splitlines())


def _annotations(body: list[ast.stmt], name: str) -> Iterator[tuple[str, str]]:
    """Names and annotations of public functions, methods and fields."""
    for node in body:
        if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
            for field in node.body:
                if isinstance(field, ast.AnnAssign):
                    yield f"{name}.{node.name}", ast.unparse(field.annotation)
            yield from _annotations(node.body, f"{name}.{node.name}")
        elif isinstance(node, ast.FunctionDef) and not node.name.startswith("_"):
            arguments = node.args
            every = [*arguments.posonlyargs, *arguments.args, *arguments.kwonlyargs]
            given = [a.annotation for a in every] + [node.returns]
            for annotation in given:
                if annotation is not None:
                    yield f"{name}.{node.name}", ast.unparse(annotation)


def shapeless() -> list[str]:
    """Public functions and classes with an array whose shape is not given."""
    found = [
        where
        for module, path in modules().items()
        for where, annotation in _annotations(parsed(path).body, module)
        if BARE.search(annotation)
    ]
    return sorted(set(found))


def files_run() -> list[str]:
    """Package files in which a function ran from a CSV row to report.json.

    From Python, `hydrojax.trace` of the demo's logs, and the text of report.json: no
    command line, no pictures, no page. What runs once because a module is imported
    (its own lines, bodies of classes, decorators) is not work on a row, and does not
    count.
    """
    import hydrojax
    from hydrojax.identify.results.report_json import report_json

    demo = resources.files("hydrojax") / "demo"
    mine = {str(path.resolve()) for path in modules().values()}
    with resources.as_file(demo) as here, Listener(mine) as listener:
        fitted = [here / f"fit_{i}.csv.gz" for i in (1, 2)]
        found = hydrojax.trace(here / "rig.toml", fitted, [here / "validate.csv.gz"])
        json.dumps(report_json(found.outcome), allow_nan=False)
    return sorted(str(Path(name).relative_to(ROOT)) for name in listener.heard)


class Listener:
    """Hears in which files functions run, in this thread and in those it starts."""

    def __init__(self, files: set[str]):
        self.files, self.heard = files, set[str]()
        self._real: dict[str, str] = {}
        self._imports = threading.local()

    def __enter__(self):
        threading.setprofile(self._hear)
        sys.setprofile(self._hear)
        return self

    def __exit__(self, *_):
        sys.setprofile(None)
        threading.setprofile(None)

    def _hear(self, frame, event, _):
        """Count imports of the package's modules that are under way in this thread."""
        if event not in ("call", "return"):
            return
        code = frame.f_code
        file = self._real.get(code.co_filename)
        if file is None:
            file = str(Path(code.co_filename).resolve())
            self._real[code.co_filename] = file
        if file not in self.files:
            return
        open_ = getattr(self._imports, "open", 0)
        if code.co_name == "<module>":
            self._imports.open = open_ + (1 if event == "call" else -1)
        elif event == "call" and not open_ and code.co_flags & FUNCTION == FUNCTION:
            self.heard.add(file)


def main() -> None:
    """Print every figure, and beside it what it counts."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--static", action="store_true", help="read the sources only")
    parser.add_argument("--list", action="store_true", help="name what is counted")
    given = parser.parse_args()
    rows: list[tuple[str, list[str], str]] = [
        ("loose files in hydrojax/", loose_files(), "at most 6"),
        (
            "public names in two modules",
            [f"{n}: {', '.join(m)}" for n, m in doubled_names().items()],
            "0 that differ in meaning",
        ),
        ("import circles", [" ".join(c) for c in circles(arrows())], "0"),
        ("functions past 60 lines", long_functions(), "0"),
        ("files past 300 lines", long_files(), "few"),
        ("signatures without shapes", shapeless(), "0"),
    ]
    if not given.static:
        rows.append(("files run, CSV row to report.json", files_run(), "at most 30"))
    for name, found, goal in rows:
        print(f"{name:36s} {len(found):4d}   (goal: {goal})")
        if given.list:
            print("".join(f"    {line}\n" for line in found), end="")
    if not given.static:
        lines = sum(_length(ROOT / name) for name in rows[-1][1])
        print(
            f"{'their lines':36s} {lines:4d}   (at {LONG_FILE} a file these need "
            f"{math.ceil(lines / LONG_FILE)} files)"
        )


if __name__ == "__main__":
    main()
