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
  the last byte of report.json.
"""

from __future__ import annotations

import argparse
import ast
import re
import sys
import tempfile
from collections import defaultdict
from collections.abc import Iterator
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
    lengths = {
        m: len(p.read_text(encoding="utf-8").splitlines()) for m, p in modules().items()
    }
    return [f"{m} ({n})" for m, n in lengths.items() if n > LONG_FILE]


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
    """Package files in which a function ran from a CSV row to report.json."""
    from importlib import resources

    from hydrojax import cli
    from hydrojax.jax_setup import set_up_jax

    set_up_jax()
    seen: set[str] = set()
    mine = {str(path.resolve()) for path in modules().values()}

    def hear(frame, event, _):
        if event == "call" and frame.f_code.co_name != "<module>":
            seen.add(frame.f_code.co_filename)

    demo = resources.files("hydrojax") / "demo"
    with tempfile.TemporaryDirectory() as out, resources.as_file(demo) as here:
        words = ["trace", here / "rig.toml"]
        words += [here / f"fit_{i}.csv.gz" for i in (1, 2)]
        words += ["--validate", here / "validate.csv.gz", "--out", Path(out) / "found"]
        sys.argv = ["hydrojax", *map(str, words)]
        sys.setprofile(hear)
        try:
            cli.main()
        except SystemExit:
            pass
        finally:
            sys.setprofile(None)
    reached = {str(Path(name).resolve()) for name in seen}
    return sorted(str(Path(f).relative_to(ROOT)) for f in reached & mine)


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


if __name__ == "__main__":
    main()
