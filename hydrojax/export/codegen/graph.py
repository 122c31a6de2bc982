"""Scalar operations as a graph: shared, folded, and sorted by what they depend on.

A node is one number. What is the same is made once, what is constant is worked out
here, and each node knows in which loop it stands.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from hydrojax.export.codegen.operations import FOLDED

DOUBLE, BOOL, INT = "double", "bool", "int64_t"

PARAMETER, TICK, LANE = 0, 1, 2
"""On what a node depends, as bits: on parameters alone, on what changes from tick to
tick, on what differs from lane to lane."""


class Node(NamedTuple):
    """One number: an operation on others, a constant, or what is given.

    `value` is a constant's number, an input's name, a loop, or a result's index;
    `scope` the loop in which the node stands, 0 outside of all.
    """

    op: str
    args: tuple[int, ...]
    kind: str
    value: Any
    scope: int


@dataclass(frozen=True)
class Repeat:
    """`count` rounds, or as many as `go` holds, of `carried` becoming `results`."""

    scope: int
    carried: tuple[int, ...]
    results: tuple[int, ...]
    count: int | None
    go: int | None


@dataclass
class Graph:
    """Nodes by number; a node's arguments have lower numbers than it."""

    nodes: list[Node] = field(default_factory=list)
    zones: dict[int, int] = field(default_factory=dict)
    _known: dict[tuple, int] = field(default_factory=dict)
    _parents: list[int] = field(default_factory=lambda: [0])
    _inside: list[int] = field(default_factory=lambda: [0])

    def const(self, value: Any, kind: str) -> int:
        """A constant."""
        number = _python(value, kind)
        return self._node("const", (), kind, number, ("const", kind, repr(number)))

    def given(self, name: str, kind: str, zone: int) -> int:
        """What a caller gives under a name, and on what it depends."""
        at = self._node("given", (), kind, name, ("given", name))
        self.zones[at] = zone
        return at

    def op(self, name: str, args: Sequence[int], kind: str, value: Any = None) -> int:
        """An operation; one that can be simplified or worked out now is."""
        simple = self._simplified(name, args, kind, value)
        if simple is not None:
            return simple
        return self._node(name, tuple(args), kind, value, (name, *args, kind, value))

    def constant(self, at: int) -> Any:
        """The number of a constant, else None."""
        node = self.nodes[at]
        return node.value if node.op == "const" else None

    def loop(
        self,
        starts: Sequence[int],
        body: Callable[[list[int]], tuple[int | None, list[int]]],
        count: int | None = None,
    ) -> list[int]:
        """Values after a loop.

        Args:
            starts: what is carried into the first round.
            body: of what is carried, whether to go on (None with a `count`) and what
                the round makes of it.
            count: of rounds.
        """
        scope = len(self._parents)
        self._parents.append(self._inside[-1])
        self._inside.append(scope)
        carried = [len(self.nodes) + i for i in range(len(starts))]
        kinds = [self.nodes[s].kind for s in starts]
        self.nodes += [Node("carried", (), k, None, scope) for k in kinds]
        go, results = body(list(carried))
        self._inside.pop()
        loop = Repeat(scope, tuple(carried), tuple(results), count, go)
        at = len(self.nodes)
        self.nodes.append(Node("loop", tuple(starts), "", loop, self._inside[-1]))
        out = []
        for i, kind in enumerate(kinds):
            out.append(len(self.nodes))
            self.nodes.append(Node("result", (at,), kind, i, self._inside[-1]))
        return out

    def within(self, scope: int, outer: int) -> bool:
        """Whether a loop is another, or stands in it."""
        while scope and scope != outer:
            scope = self._parents[scope]
        return scope == outer

    def live(self, wanted: Iterable[int]) -> list[int]:
        """The nodes that `wanted` rest on, in order."""
        seen: set[int] = set()
        todo = list(wanted)
        while todo:
            at = todo.pop()
            if at in seen:
                continue
            seen.add(at)
            node = self.nodes[at]
            todo += node.args
            if node.op == "loop":
                loop = node.value
                todo += [*loop.carried, *loop.results]
                todo += [] if loop.go is None else [loop.go]
        return sorted(seen)

    def outside(self, at: int) -> list[int]:
        """What a loop takes from outside of all loops: its first values, and what is
        read in it.
        """
        loop = self.nodes[at].value
        wanted = [*loop.results, *([] if loop.go is None else [loop.go])]
        inner = (
            i for i in self.live(wanted) if self.within(self.nodes[i].scope, loop.scope)
        )
        read = [*wanted, *(a for i in inner for a in self.nodes[i].args)]
        read = [a for a in read if not self.nodes[a].scope]
        return list(dict.fromkeys([*self.nodes[at].args, *read]))

    def zone(self, order: Iterable[int]) -> dict[int, int]:
        """On what each of the nodes outside of loops depends; `order` as of `live`."""
        order = list(order)
        out: dict[int, int] = {}
        for at in order:
            node = self.nodes[at]
            if node.scope:
                continue
            args = self.outside(at) if node.op == "loop" else node.args
            zone = self.zones.get(at, PARAMETER)
            for a in args:
                zone |= out[a]
            out[at] = zone
        return out

    def _node(
        self, op: str, args: tuple[int, ...], kind: str, value: Any, key: tuple
    ) -> int:
        at = self._known.get(key)
        if at is None:
            at = self._known[key] = len(self.nodes)
            scopes = [self.nodes[a].scope for a in args]
            scope = max(scopes, key=self._depth, default=0)
            self.nodes.append(Node(op, args, kind, value, scope))
        return at

    def _depth(self, scope: int) -> int:
        depth = 0
        while scope:
            scope, depth = self._parents[scope], depth + 1
        return depth

    def _simplified(
        self, name: str, args: Sequence[int], kind: str, value: Any
    ) -> int | None:
        """The node that an operation comes to without being one, exactly."""
        numbers = [self.constant(a) for a in args]
        if name in FOLDED and None not in numbers:
            with np.errstate(all="ignore"):
                return self.const(FOLDED[name](*numbers, value), kind)
        match name:
            case "mul" | "imul" if 1 in numbers:
                return args[1 - numbers.index(1)]
            case "add" | "iadd" if 0 in numbers:
                return args[1 - numbers.index(0)]
            case "sub" if numbers[1] == 0:
                return args[0]
            case "div" if numbers[1] is not None and kind == DOUBLE:
                return self._over(args[0], numbers[1])
            case "select" if numbers[0] is not None:
                return args[2] if numbers[0] else args[1]
            case "select" if args[1] == args[2]:
                return args[1]
            case "convert" if self.nodes[args[0]].kind == kind:
                return args[0]
            case "neg" if self.nodes[args[0]].op == "neg":
                return self.nodes[args[0]].args[0]
            case "look" if numbers[0] is not None:
                size = len(args) - 1
                inside = 0 <= numbers[0] < size
                return args[1 + numbers[0]] if inside else self.const(math.nan, kind)
        return None

    def _over(self, at: int, number: float) -> int | None:
        """Division by a power of two, which a product does exactly."""
        if not 1e-100 < abs(number) < 1e100 or abs(math.frexp(number)[0]) != 0.5:
            return None
        return self.op("mul", (at, self.const(1 / number, DOUBLE)), DOUBLE)


def _python(value: Any, kind: str) -> Any:
    if kind == BOOL:
        return bool(value)
    return float(value) if kind == DOUBLE else int(value)
