"""Operations that differ by lane and tick, cut into stages: loops over the lanes."""

from __future__ import annotations

from collections.abc import Sequence

from hydrojax.export.codegen.emit import literal
from hydrojax.export.codegen.graph import BOOL, DOUBLE, Graph, Node
from hydrojax.export.codegen.operations import C99

STAGE = 30
"""Operations in a stage: 15 to 30 are equally fast, 80 take a third longer."""


class Stages:
    """The operations that differ by lane and tick, in loops over the lanes."""

    def __init__(self, graph: Graph, zones: dict[int, int], order: list[int]):
        self.graph, self.order = graph, order
        self.names: dict[int, str] = {}
        self.lines: list[str] = []

    def cut(self, states: Sequence[tuple[int, str]], kept: Sequence[int]) -> None:
        """Write all stages; `states` are the nodes that become state, by its name."""
        graph = self.graph
        heavy = [at for at in self.order if graph.nodes[at].kind == DOUBLE]
        stages = [heavy[i : i + STAGE] for i in range(0, len(heavy), STAGE)]
        where = {at: i for i, stage in enumerate(stages) for at in stage}
        last: dict[int, int] = {}
        for at in heavy:
            for a in self._numbers(at):
                last[a] = max(last.get(a, 0), where[at])
        for at in [*kept, *(at for at, _ in states)]:
            last[at] = len(stages)
        arrays = [at for at in heavy if last.get(at, 0) > where[at]]
        self.lines += [f"            ROW(a{at});" for at in arrays]
        stored = set(arrays)
        for stage in stages:
            self._stage(stage, stored)
        news = [
            f"                const double n{name} = {self._read(at, {})};"
            for at, name in states
        ]
        news += [f"                {name}[k] = n{name};" for _, name in states]
        out = [
            f"                out[{i}L * B + k] = {self._read(at, {})};"
            for i, at in enumerate(kept)
        ]
        self.lines += ["            if (O) for (long k = 0; k < live; k++) {"]
        self.lines += [*out, "            }"]
        self.lines += ["            OVER(k) {", *news, "            }"]

    def _numbers(self, at: int) -> list[int]:
        """What an operation rests on that is stored: not comparisons, but theirs."""
        out = []
        for a in self.graph.nodes[at].args:
            if self.graph.nodes[a].kind != DOUBLE and a not in self.names:
                out += self._numbers(a)
            else:
                out.append(a)
        return out

    def _read(self, at: int, own: dict[int, str]) -> str:
        node = self.graph.nodes[at]
        if node.op == "const":
            return literal(node.value)
        if at in own:
            return own[at]
        if at in self.names:
            name = self.names[at]
            return f"({name} != 0.0)" if node.kind == BOOL else name
        if node.kind != DOUBLE:  # made again in each stage: cheaper than kept
            return f"({self._text(node, own)})"
        raise KeyError(at)

    def _text(self, node: Node, own: dict[int, str]) -> str:
        args = [self._read(a, own) for a in node.args]
        if node.op == "convert":
            return f"({'double' if node.kind == DOUBLE else 'int64_t'}){args[0]}"
        if node.op == "look":
            out = "NAN"
            for j, value in enumerate(args[1:]):
                out = f"{args[0]} == {j} ? {value} : ({out})"
            return out
        under = self.graph.constant(node.args[-1]) if node.op == "div" else None
        if under:  # vectors divide slowly; the last digit is not asked for here
            return f"{args[0]} * {literal(1.0 / under)}"
        return C99[node.op].format(*args)

    def _stage(self, stage: list[int], stored: set[int]) -> None:
        own: dict[int, str] = {}
        inputs = sorted({a for at in stage for a in self._numbers(at)} - set(stage))
        outside, inside = [], []
        for a in inputs:  # by name: of two places gcc would choose the address
            if a in self.names and self.graph.nodes[a].kind == DOUBLE:
                line = f"const double x{a} = {self.names[a]};"
                (outside if self.names[a].startswith("t[") else inside).append(line)
                own[a] = f"x{a}"
        self.lines += ["            {", *(f"            {line}" for line in outside)]
        self.lines.append("            OVER(k) {")
        self.lines += [f"                {line}" for line in inside]
        for at in stage:
            node = self.graph.nodes[at]
            text = self._text(node, own)
            own[at] = f"v{at}"
            self.lines.append(f"                const double v{at} = {text};")
        for at in stage:
            if at in stored:
                self.lines.append(f"                a{at}[k] = v{at};")
                self.names[at] = f"a{at}[k]"
        self.lines.append("            }}")
