"""A graph as text of C99: one operation a line, loops as loops."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping

from hydrojax.export.codegen.graph import BOOL, DOUBLE, Graph, Node
from hydrojax.export.codegen.operations import C99

HELPERS: Mapping[str, str] = {
    "as_integer": """\
static int64_t as_integer(double number)
{
    int64_t bits;
    memcpy(&bits, &number, sizeof bits);
    return bits;
}
""",
    "as_double": """\
static double as_double(int64_t bits)
{
    double number;
    memcpy(&number, &bits, sizeof number);
    return number;
}
""",
    "whole": """\
static int64_t whole(double number)
{
    if (!(number > -9.2e18)) {
        return INT64_MIN;
    }
    return number < 9.2e18 ? (int64_t)number : INT64_MAX;
}
""",
}
"""Functions that a text may call, by name."""


def literal(value: bool | int | float) -> str:
    """A constant in C, to the last digit."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, int):
        return f"({value})" if value < 0 else str(value)
    if math.isnan(value):
        return "NAN"
    if math.isinf(value):
        return "(double)INFINITY" if value > 0 else "(-(double)INFINITY)"
    text = repr(value)
    text = text if any(sign in text for sign in ".e") else f"{text}.0"
    return f"({text})" if text.startswith("-") else text


def helpers(text: str) -> list[str]:
    """The functions that a text calls and that are to stand before it."""
    return [body for name, body in HELPERS.items() if f"{name}(" in text]


class Block:
    """The lines that work out some nodes of a graph where others are known.

    Attributes:
        names: what each node is called so far.
        lines: of C.
    """

    def __init__(self, graph: Graph, known: Mapping[int, str], indent: int = 1):
        self.graph, self.names = graph, dict(known)
        self.lines: list[str] = []
        self._indent, self._tables = indent, {}
        self._count = 0

    def make(self, wanted: Iterable[int]) -> None:
        """Add what `wanted` rests on."""
        for at in self._missing(wanted):
            if not self.graph.nodes[at].scope:
                self._add(at)

    def name(self, at: int) -> str:
        """What a node is called."""
        node = self.graph.nodes[at]
        return literal(node.value) if node.op == "const" else self.names[at]

    def _missing(self, wanted: Iterable[int]) -> list[int]:
        """The nodes behind `wanted` that have no name yet, in order."""
        seen: set[int] = set()
        todo = list(wanted)
        while todo:
            at = todo.pop()
            if at in seen or at in self.names:
                continue
            seen.add(at)
            node = self.graph.nodes[at]
            todo += node.args
            if node.op == "loop":
                todo += node.value.results
                todo += [] if node.value.go is None else [node.value.go]
        return sorted(seen)

    def _line(self, text: str) -> None:
        self.lines.append("    " * self._indent + text)

    def _fresh(self, at: int) -> str:
        self._count += 1
        self.names[at] = f"v{self._count}"
        return self.names[at]

    def _add(self, at: int) -> None:
        node = self.graph.nodes[at]
        match node.op:
            case "const" | "carried":
                return
            case "loop":
                self._loop(node)
            case "result":
                loop = self.graph.nodes[node.args[0]].value
                self.names[at] = self.names[loop.carried[node.value]]
            case _:
                text = self._text(node)
                self._line(f"const {node.kind} {self._fresh(at)} = {text};")

    def _text(self, node: Node) -> str:
        if node.op == "look":
            return self._look(node)
        args = [self.name(a) for a in node.args]
        if node.op == "convert":
            source = self.graph.nodes[node.args[0]].kind
            if source == DOUBLE and node.kind != BOOL:
                return f"whole({args[0]})"
            return f"({node.kind}){args[0]}"
        return C99[node.op].format(*args)

    def _look(self, node: Node) -> str:
        index, table = self.name(node.args[0]), node.args[1:]
        key = (table, node.scope)
        if key not in self._tables:
            self._count += 1
            self._tables[key] = f"t{self._count}"
            values = ", ".join(self.name(a) for a in table)
            size = len(table)
            self._line(f"const {node.kind} {self._tables[key]}[{size}] = {{{values}}};")
        beyond = "NAN" if node.kind == DOUBLE else "0"
        inside = f"{index} >= 0 && {index} < {len(table)}"
        return f"{inside} ? {self._tables[key]}[{index}] : {beyond}"

    def _loop(self, node: Node) -> None:
        loop, graph = node.value, self.graph
        for at, start in zip(loop.carried, node.args, strict=True):
            kind = graph.nodes[at].kind
            first = self.name(start)
            self._line(f"{kind} {self._fresh(at)} = {first};")
        self._count += 1
        i = f"i{self._count}"
        rounds = f"int {i} = 0; {i} < {loop.count}; {i}++" if loop.go is None else ";;"
        self._line(f"for ({rounds}) {{")
        self._indent += 1
        if loop.go is not None:
            self.inner(loop.scope, [loop.go])
            self._line(f"if (!{self.name(loop.go)}) {{")
            self._line("    break;")
            self._line("}")
        self.inner(loop.scope, loop.results)
        news = list(zip(loop.carried, map(self.name, loop.results), strict=True))
        moved = {self.names[at] for at, _ in news}
        for at, new in news:  # a value that another takes over is kept first
            if new in moved and new != self.names[at]:
                self._line(f"const {graph.nodes[at].kind} n{self.names[at]} = {new};")
        for at, new in news:
            name = self.names[at]
            if new != name:
                self._line(f"{name} = {f'n{name}' if new in moved else new};")
        self._indent -= 1
        self._line("}")

    def inner(self, scope: int, wanted: Iterable[int]) -> None:
        """Add what `wanted` rests on in a loop, of its own operations."""
        for at in self._missing(wanted):
            if self.graph.nodes[at].scope == scope:
                self._add(at)
