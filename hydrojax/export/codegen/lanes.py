"""A step as C that runs many instances side by side, in vectors.

Operations are sorted by what they depend on: nothing (worked out here), the tick (once
for all instances, in a pass before), the instance (once for all ticks), and both. The
last are cut into short stages, each a loop over the lanes of a group: what stands side
by side in a stage keeps a processor busy where one long body would wait.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Float

from hydrojax.export.codegen.emit import Block, helpers
from hydrojax.export.codegen.graph import DOUBLE, INT, LANE, TICK, Graph
from hydrojax.export.codegen.scalarise import scalarise
from hydrojax.export.codegen.stages import Stages

LANES = 32
"""Instances in a group: four of AVX-512's vectors."""

FLAGS = (
    "-std=gnu11", "-O3", "-march=native", "-mprefer-vector-width=512", "-fopenmp",
    "-fno-math-errno", "-fno-trapping-math", "-shared", "-fPIC",
)  # fmt: skip

IN_VECTORS = ("exp", "expm1", "log", "sin", "cos", "tanh")
"""Functions that the C library has for vectors."""


class Laned(NamedTuple):
    """The source, and how many numbers it keeps at each tick."""

    source: str
    kept: int


def laned(
    step: Callable[..., tuple[Any, Any]],
    row: Float[np.ndarray, "numbers"],
    state: Any,
    tick: Any,
    alike: Sequence[bool],
    ends: Sequence[int] = (),
) -> Laned:
    """A step as C over many instances.

    Args:
        step: `step(row, state, tick)` gives the state and an array of what is kept.
        row: of one instance: what differs between instances.
        state: of one instance, a pytree of arrays of float64.
        tick: of one tick: what changes from tick to tick.
        alike: of the state's numbers, whether all instances begin with the same.
        ends: of the state's numbers, those whose last value is wanted.

    Raises:
        InputError: an operation that has no form here.
    """
    graph = Graph()
    closed = jax.make_jaxpr(step)(row, state, tick)
    leaves, ticks = jax.tree.leaves(state), jax.tree.leaves(tick)

    def given(owner: str, arrays: Sequence[Any], zone: int) -> list[np.ndarray]:
        out, i = [], 0
        for a in arrays:
            n = int(np.prod(np.shape(a)))
            ids = [graph.given(f"{owner}{i + j}", DOUBLE, zone) for j in range(n)]
            out.append(np.array(ids, np.int64).reshape(np.shape(a)))
            i += n
        return out

    rows, states = given("r", [row], LANE), given("s", leaves, TICK)
    made = scalarise(graph, closed, [*rows, *states, *given("c", ticks, TICK)])
    before = [int(v) for a in states for v in a.ravel()]
    count = len(leaves)
    after = [int(v) for a in made[:count] for v in a.ravel()]
    kept = [int(v) for a in made[count:] for v in a.ravel()]
    width = sum(int(np.prod(np.shape(a))) for a in ticks)
    return _Writer(graph, before, after, kept, alike, ends).text(width)


class _Writer:
    def __init__(
        self,
        graph: Graph,
        before: list[int],
        after: list[int],
        kept: list[int],
        alike: Sequence[bool],
        ends: Sequence[int],
    ):
        self.graph, self.before, self.after, self.kept = graph, before, after, kept
        self.needed = self._needed(ends)
        for at, same in zip(before, alike, strict=True):
            graph.zones[at] = TICK if same else TICK | LANE
        self.zones = self._settled_zones()

    def _needed(self, ends: Sequence[int]) -> list[int]:
        """Numbers of the state on which what is kept rests."""
        index = {at: i for i, at in enumerate(self.before)}
        wanted = {*self.kept, *(self.after[i] for i in ends)}
        wanted |= {self.before[i] for i in ends}
        while True:
            found = [index[at] for at in self.graph.live(wanted) if at in index]
            more = {self.after[i] for i in found} - wanted
            if not more:
                return sorted(found)
            wanted |= more

    def _settled_zones(self) -> dict[int, int]:
        """On what each operation depends, once a state that mixes lanes is one."""
        graph = self.graph
        wanted = [*self.kept, *(self.after[i] for i in self.needed)]
        order = graph.live([*wanted, *(self.before[i] for i in self.needed)])
        while True:
            zones = graph.zone(order)
            changed = [
                i
                for i in self.needed
                if zones[self.after[i]] & LANE and not zones[self.before[i]] & LANE
            ]
            if not changed:
                return zones
            for i in changed:
                graph.zones[self.before[i]] = TICK | LANE

    def text(self, inputs: int) -> Laned:
        """The whole source; `inputs` are the numbers of a tick."""
        graph, zones = self.graph, self.zones
        both = [
            at
            for at, z in zones.items()
            if z == TICK | LANE and graph.nodes[at].op != "given"
        ]
        used = {a for at in both for a in graph.nodes[at].args}
        loops = (at for at in both if graph.nodes[at].op == "loop")
        used |= {a for at in loops for a in graph.outside(at)}
        ends = [*self.kept, *(self.after[i] for i in self.needed)]
        used |= set(ends)
        of_tick = sorted(a for a in used if zones.get(a) == TICK)
        of_lane = sorted(a for a in used if zones.get(a) == LANE)
        body = Stages(graph, zones, both)
        for i, at in enumerate(of_tick):
            whole = "(int64_t)" if graph.nodes[at].kind == INT else ""
            body.names[at] = f"{whole}t[{i}]"
        for at in of_lane:
            whole = "(int64_t)" if graph.nodes[at].kind == INT else ""
            body.names[at] = f"{whole}l{at}[k]"
        mine = [i for i in self.needed if zones[self.before[i]] & LANE]
        shared = [i for i in self.needed if not zones[self.before[i]] & LANE]
        for i in mine:
            body.names[self.before[i]] = f"s{i}[k]"
        body.cut([(self.after[i], f"s{i}") for i in mine], self.kept)
        own = [*(f"s{i}" for i in mine), *(f"l{at}" for at in of_lane)]
        rows = [*own, *body.rows]
        return Laned(
            _SOURCE.format(
                lanes=LANES,
                simd="\n".join(_VECTOR.format(name=n) for n in IN_VECTORS),
                helpers="\n".join(helpers("as_integer( as_double( whole(")),
                rows="\n".join(
                    f"#define {name} (w + {i}L * LANES)" for i, name in enumerate(rows)
                ),
                size=max(1, len(rows)),
                functions="\n\n".join(body.functions),
                shared=self._pass(shared, of_tick),
                width=max(1, len(of_tick)),
                load=self._load(mine, of_lane),
                stages="\n".join(body.lines),
                store="\n".join(
                    f"            F[{i}L * B + b + k] = s{i}[k];" for i in mine
                ),
                outputs=len(self.kept),
                inputs=inputs,
            ),
            len(self.kept),
        )  # fmt: skip

    def _input(self, at: int) -> int:
        node = self.graph.nodes[at]
        named = node.op == "given" and node.value.startswith("c")
        return int(node.value[1:]) if named else -1

    def _pass(self, shared: list[int], of_tick: list[int]) -> str:
        """What is the same in all lanes: its state from tick to tick, and its table."""
        graph = self.graph
        known = {self.before[i]: f"s{i}" for i in shared}
        known |= {
            at: f"c[{self._input(at)}]" for at in self.zones if self._input(at) >= 0
        }
        block = Block(graph, known, 2)
        block.make([*of_tick, *(self.after[i] for i in shared)])
        lines = [f"    double s{i} = S[{i}L * B];" for i in shared]
        lines += ["    for (long i = 0; i < T; i++, c += inputs, t += WIDTH) {"]
        lines += block.lines
        for j, at in enumerate(of_tick):
            lines.append(f"        t[{j}] = (double){block.name(at)};")
        lines += [
            f"        const double n{i} = {block.name(self.after[i])};" for i in shared
        ]
        lines += [f"        s{i} = n{i};" for i in shared]
        return "\n".join([*lines, "    }"])

    def _load(self, mine: list[int], of_lane: list[int]) -> str:
        """State, and what is the same at all ticks, of each lane."""
        graph = self.graph
        known = {
            at: f"R[{graph.nodes[at].value[1:]}L * B + j]"
            for at, z in self.zones.items()
            if z == LANE and graph.nodes[at].op == "given"
        }
        block = Block(graph, known, 3)
        block.make(of_lane)
        lines = ["        for (long k = 0; k < LANES; k++) {"]
        lines += ["            const long j = b + k < B ? b + k : B - 1;"]
        lines += block.lines
        lines += [f"            s{i}[k] = S[{i}L * B + j];" for i in mine]
        lines += [f"            l{at}[k] = (double){block.name(at)};" for at in of_lane]
        return "\n".join([*lines, "        }"])


_VECTOR = '__attribute__((simd("notinbranch"))) double {name}(double);'
_SOURCE = """\
#include <math.h>
#include <stdbool.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#define LANES {lanes}
#define WIDTH {width}
#define ROW(name) double name[LANES] __attribute__((aligned(64)))
#define OVER(k) _Pragma("omp simd") for (int k = 0; k < LANES; k++)
#ifdef __clang__
#define APART __attribute__((noinline)) static void
#else
#define APART __attribute__((noipa)) static void
#endif

{rows}

{simd}
{helpers}
{functions}

/* B instances over T ticks: rows R [., B], first state S [., B], course C [T, .]; kept
 * O [T, ., B] or NULL, last state F [., B]. Not 0 where there is no memory. */
int run(long B, long T, const double *R, const double *S, const double *C, double *O,
        double *F, int threads)
{{
    const long inputs = {inputs}, outputs = {outputs};
    double *const table = malloc(sizeof(double) * WIDTH * (size_t)T);
    if (!table) return 1;
    {{
        const double *c = C;
        double *t = table;
{shared}
    }}
#pragma omp parallel for schedule(static) num_threads(threads)
    for (long b = 0; b < B; b += LANES) {{
        const long live = B - b < LANES ? B - b : LANES;
        const double *t = table;
        double w[{size} * LANES] __attribute__((aligned(64)));
{load}
        for (long i = 0; i < T; i++, t += WIDTH) {{
            double *const out = O ? O + i * outputs * B + b : NULL;
{stages}
        }}
        for (long k = 0; k < live; k++) {{
{store}
        }}
    }}
    free(table);
    return 0;
}}
"""
