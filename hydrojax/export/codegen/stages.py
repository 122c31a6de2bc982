"""Operations that differ by lane and tick, cut into stages: loops over the lanes."""

from __future__ import annotations

from collections.abc import Sequence

from hydrojax.export.codegen.emit import Block, literal
from hydrojax.export.codegen.graph import BOOL, DOUBLE, Graph, Node
from hydrojax.export.codegen.operations import C99

STAGE = 30
"""Operations in a stage: 15 to 30 are equally fast, 80 take a third longer."""


class Stages:
    """The operations that differ by lane and tick, in loops over the lanes.

    Each stage is a function of its own: gcc's time grows faster than a function does.

    Attributes:
        names: what the nodes are called.
        rows: arrays over the lanes that stages leave to later ones.
        functions: the stages.
        lines: of C that run them.
    """

    def __init__(self, graph: Graph, zones: dict[int, int], order: list[int]):
        self.graph, self.order = graph, order
        self.names: dict[int, str] = {}
        self.rows: list[str] = []
        self.functions: list[str] = []
        self.lines: list[str] = []

    def cut(self, states: Sequence[tuple[int, str]], kept: Sequence[int]) -> None:
        """Write all stages; `states` are the nodes that become state, by its name."""
        stages = self._stages()
        where = {at: i for i, stage in enumerate(stages) for at in stage}
        last: dict[int, int] = {}
        for at in where:
            for a in self._numbers(at):
                last[a] = max(last.get(a, 0), where[at])
        for at in [*kept, *(at for at, _ in states)]:
            last[at] = len(stages)
        arrays = [at for at in where if last.get(at, 0) > where[at]]
        self.rows += [f"a{at}" for at in arrays]
        stored = set(arrays)
        for stage in stages:
            if self.graph.nodes[stage[0]].op == "loop":
                self._loop(stage, stored)
            else:
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

    def _stages(self) -> list[list[int]]:
        """The operations of each stage; a loop is one of its own, with its results."""
        nodes, out = self.graph.nodes, [[]]
        for at in self.order:
            op = nodes[at].op
            if op == "loop":
                out += [[at], []]
            elif op == "result":
                next(s for s in out if s[:1] == [nodes[at].args[0]]).append(at)
            elif nodes[at].kind == DOUBLE:
                if len(out[-1]) == STAGE:
                    out.append([])
                out[-1].append(at)
        return [stage for stage in out if stage]

    def _numbers(self, at: int) -> list[int]:
        """What an operation rests on that is stored: not comparisons, but theirs."""
        out, node = [], self.graph.nodes[at]
        for a in self.graph.outside(at) if node.op == "loop" else node.args:
            own = self.graph.nodes[a]
            if own.op == "loop":
                continue
            if own.kind != DOUBLE and own.op != "result" and a not in self.names:
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
            if node.op == "result" and node.kind not in (BOOL, DOUBLE):
                return f"(int64_t){name}"
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
        lines = [f"    {line}" for line in outside]
        lines += ["    OVER(k) {", *(f"        {line}" for line in inside)]
        for at in stage:
            node = self.graph.nodes[at]
            text = self._text(node, own)
            own[at] = f"v{at}"
            lines.append(f"        const double v{at} = {text};")
        for at in stage:
            if at in stored:
                lines.append(f"        a{at}[k] = v{at};")
                self.names[at] = f"a{at}[k]"
        self._apart([*lines, "    }"])

    def _apart(self, lines: list[str]) -> None:
        """Add a stage of these lines."""
        name = f"stage_{len(self.functions)}"
        head = f"APART {name}(double *restrict w, const double *restrict t)"
        self.functions.append("\n".join([head, "{", *lines, "}"]))
        self.lines.append(f"            {name}(w, t);")

    def _loop(self, stage: list[int], stored: set[int]) -> None:
        """A loop and its results. Rounds that all lanes take are taken side by side;
        where each lane goes on as long as it wants, it does so by itself.
        """
        at, *results = stage
        graph = self.graph
        loop = graph.nodes[at].value
        results = [r for r in results if r in stored]
        known = {a: self._read(a, {}) for a in self.graph.outside(at)}
        nested = any(graph.nodes[i].op == "loop" for i in graph.live(loop.results))
        if loop.go is None and not nested:
            wanted = [graph.nodes[r].value for r in results]
            rows, lines = self._rounds(at, known, wanted)
            names = {r: f"{rows[graph.nodes[r].value]}[k]" for r in results}
            lines.append("    OVER(k) {")
        else:
            block = Block(graph, known, 2)
            block.make(stage)
            names = {r: block.name(r) for r in results}
            lines = ["    OVER(k) {", *block.lines]
        lines += [f"        a{r}[k] = {names[r]};" for r in results]
        self._apart([*lines, "    }"])
        self.names |= {r: f"a{r}[k]" for r in results}

    def _rounds(
        self, at: int, known: dict[int, str], wanted: list[int]
    ) -> tuple[dict[int, str], list[str]]:
        """A loop's rounds, each over all lanes.

        Args:
            at: the loop.
            known: what is called how outside of it.
            wanted: places of the results that are.

        Returns:
            The arrays of what is carried on from round to round for their sake, by its
            place (a counter that only counts is none of them), and the lines.
        """
        graph = self.graph
        starts, loop = graph.nodes[at].args, graph.nodes[at].value
        while True:
            behind = set(graph.live(loop.results[i] for i in wanted))
            more = [i for i, c in enumerate(loop.carried) if c in behind]
            if set(more) <= set(wanted):
                break
            wanted = sorted({*wanted, *more})
        rows = {i: f"c{loop.carried[i]}" for i in wanted}
        inside, takes = dict(known), []
        for a, name in known.items():
            node = graph.nodes[a]
            if a in behind and node.kind == DOUBLE and node.op != "const":
                takes.append(f"            const double x{a} = {name};")
                inside[a] = f"x{a}"
        for i, name in rows.items():
            kind = graph.nodes[loop.carried[i]].kind
            cast = "" if kind == DOUBLE else f"({kind})"
            inside[loop.carried[i]] = f"({cast}{name}[k])"
        block = Block(graph, inside, 3)
        block.inner(loop.scope, [loop.results[i] for i in wanted])
        out = [f"    ROW({name});" for name in rows.values()]
        out.append("    OVER(k) {")
        out += [f"        {n}[k] = {known[starts[i]]};" for i, n in rows.items()]
        out += [
            "    }",
            f"    for (int i = 0; i < {loop.count}; i++) {{",
            "        OVER(k) {",
            *takes,
            *block.lines,
        ]
        news = {name: block.name(loop.results[i]) for i, name in rows.items()}
        out += [f"            const double n{n} = {v};" for n, v in news.items()]
        out += [f"            {n}[k] = n{n};" for n in news]
        return rows, [*out, "        }", "    }"]
