"""A sampled system as one header and one source of C99."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import numpy as np

from hydrojax import parameters, units
from hydrojax.export.codegen.elementwise import number_kind
from hydrojax.export.codegen.emit import Block, helpers
from hydrojax.export.codegen.graph import PARAMETER, TICK, Graph
from hydrojax.export.codegen.indexing import Ids
from hydrojax.export.codegen.scalarise import scalarise
from hydrojax.export.tree import meaning

Numbers = dict[str, Any]
"""Arrays by name."""

TAKEN = frozenset(
    ("auto", "bool", "break", "case", "char", "const", "continue", "default", "do",
     "double", "else", "enum", "extern", "false", "float", "for", "goto", "if",
     "inline", "int", "long", "register", "restrict", "return", "short", "signed",
     "sizeof", "static", "struct", "switch", "true", "typedef", "union", "unsigned",
     "void", "volatile", "while", "NAN", "INFINITY", "none")
)  # fmt: skip
"""Names that mean something in C, and `none` of an empty struct."""


class Machine(NamedTuple):
    """What is written as C, with a word on each of its quantities.

    `start(parameters, inputs)` and `step(parameters, state, inputs)` give the state and
    the outputs. Parameters, inputs and outputs are arrays by name, the state any
    pytree; `outputs` are the names that are written, `says` is a comment on any name.
    """

    parameters: Numbers
    inputs: Numbers
    outputs: tuple[str, ...]
    start: Callable[..., tuple[Any, Numbers]]
    step: Callable[..., tuple[Any, Numbers]]
    says: Mapping[str, str]


class Field(NamedTuple):
    """A field of a struct; `ids` are the nodes of its elements, `start` its numbers."""

    name: str
    says: str
    kind: str
    ids: Ids
    start: Any = None

    @property
    def declared(self) -> str:
        """Name and size as C declares them."""
        return f"{self.name}[{self.ids.size}]" if self.ids.ndim else self.name

    def elements(self, owner: str) -> list[tuple[int, str]]:
        """Each element's node, and what C calls it."""
        flat = [int(v) for v in self.ids.ravel()]
        if not self.ids.ndim:
            return [(flat[0], f"{owner}->{self.name}")]
        return [(v, f"{owner}->{self.name}[{i}]") for i, v in enumerate(flat)]


class Code(NamedTuple):
    """The fields of the structs, and the lines of the functions.

    Constants are what follows from the parameters alone; `prepare` works them out.
    """

    parameters: list[Field]
    constants: list[Field]
    state: list[Field]
    inputs: list[Field]
    outputs: list[Field]
    prepare: list[str]
    start: list[str]
    step: list[str]
    helpers: list[str]


def identifiers(names: Sequence[str]) -> list[str]:
    """Names as C takes them, each once."""
    out: list[str] = []
    for name in names:
        plain = re.sub(r"\W+", "_", name).strip("_") or "value"
        plain = f"_{plain}" if plain[0].isdigit() else plain
        while plain in out or plain in TAKEN:
            plain += "_"
        out.append(plain)
    return out


def numbers_of(
    module: eqx.Module, command_unit: str
) -> tuple[Numbers, dict[str, str], Callable[[Numbers], Any]]:
    """All arrays of a tree by name, what each is, and the tree from such arrays.

    A declared parameter has its own name, another array its path.
    """
    arrays, rest = eqx.partition(module, eqx.is_array)
    leaves, tree = jax.tree_util.tree_flatten_with_path(arrays)
    declared = {
        ".".join(str(p) for p in path): name
        for name, path in parameters.paths(module).items()
    }
    specs = parameters.parameter_specs(module)
    values, says, order = {}, {}, []
    for path, value in leaves:
        where = ".".join(_step(p) for p in path)
        name = declared.get(where, where)
        if name in values:
            name = where
        values[name] = value
        order.append(name)
        if name in specs:
            text = f"{specs[name].unit}, {meaning(specs[name])}"
            says[name] = units.with_command(text, command_unit)

    def build(values: Numbers) -> Any:
        made = jax.tree.unflatten(tree, [values[name] for name in order])
        return eqx.combine(made, rest)

    return values, says, build


def _step(key: Any) -> str:
    for name in ("name", "idx", "key"):
        if hasattr(key, name):
            return str(getattr(key, name))
    return str(key)


def code_of(machine: Machine) -> Code:
    """A machine as C.

    Raises:
        InputError: it uses an operation that has no form in C.
    """
    graph, says = Graph(), machine.says
    given = _fields(graph, "p", machine.parameters, says, PARAMETER)
    inputs = _fields(graph, "in", machine.inputs, says, TICK)
    empty, outs = jax.eval_shape(machine.start, machine.parameters, machine.inputs)
    leaves, tree = jax.tree_util.tree_flatten_with_path(empty)
    paths = [".".join(_step(p) for p in path) for path, _ in leaves]
    memory = dict(zip(identifiers(paths), (leaf for _, leaf in leaves), strict=True))
    state = _fields(graph, "s", memory, {}, TICK)

    def flat(function: Callable[..., Any], *args: Any) -> list[Any]:
        """In the order of the fields: JAX sorts what it finds in a dict."""
        made, out = function(*args)
        return [*jax.tree.leaves(made), *(out[n] for n in machine.outputs)]

    def named(numbers: Numbers, values: list) -> Numbers:
        return dict(zip(numbers, values, strict=True))

    def start(p: list, i: list) -> list:
        given = named(machine.parameters, p), named(machine.inputs, i)
        return flat(machine.start, *given)

    def step(p: list, m: list, i: list) -> list:
        given = named(machine.parameters, p), named(machine.inputs, i)
        return flat(machine.step, given[0], jax.tree.unflatten(tree, m), given[1])

    both = list(machine.parameters.values()), list(machine.inputs.values())
    first = _traced(graph, start, both, [*given, *inputs])
    all_three = both[0], list(memory.values()), both[1]
    later = _traced(graph, step, all_three, [*given, *state, *inputs])
    outputs = [
        Field(called, says.get(n, ""), number_kind(outs[n].dtype), ids)
        for n, called, ids in zip(
            machine.outputs,
            identifiers(machine.outputs),
            first[len(state) :],
            strict=True,
        )
    ]
    return _written(graph, (given, state, inputs, outputs), (first, later))


def _fields(
    graph: Graph, owner: str, numbers: Numbers, says: Mapping[str, str], zone: int
) -> list[Field]:
    """Arrays as fields of a struct that is called `owner`."""
    out = []
    for name, called in zip(numbers, identifiers(list(numbers)), strict=True):
        array = numbers[name]
        kind = number_kind(array.dtype)
        ids = [
            graph.given(f"{owner}->{called}[{i}]", kind, zone)
            for i in range(int(np.prod(array.shape)))
        ]
        start = None if isinstance(array, jax.ShapeDtypeStruct) else np.asarray(array)
        shaped = np.array(ids, np.int64).reshape(array.shape)
        out.append(Field(called, says.get(name, ""), kind, shaped, start))
    return out


def _traced(
    graph: Graph, function: Callable[..., Any], args: Sequence[Any], fields: list[Field]
) -> list[Ids]:
    """The results of a function on the fields, which are its arguments' leaves."""
    closed = jax.make_jaxpr(function)(*args)
    return scalarise(graph, closed, [f.ids for f in fields])


def _written(
    graph: Graph, fields: tuple[list[Field], ...], results: tuple[list[Ids], list[Ids]]
) -> Code:
    """The functions' lines, and the parameters that act."""
    given, state, inputs, outputs = fields
    wanted = [[int(v) for ids in made for v in ids.ravel()] for made in results]
    crossing = _crossing(graph, [v for each in wanted for v in each])
    called = {v: name for f in given for v, name in f.elements("p")}
    constants = [
        Field(_constant(called, at, i), "", graph.nodes[at].kind, np.array(at))
        for i, at in enumerate(crossing)
    ]
    prepare = Block(graph, called)
    prepare.make(crossing)
    for f, at in zip(constants, crossing, strict=True):
        prepare.lines.append(f"    c->{f.name} = {prepare.name(at)};")
    known = {at: f"c->{f.name}" for f, at in zip(constants, crossing, strict=True)}
    known |= {v: name for f in inputs for v, name in f.elements("in")}
    before = {v: name for f in state for v, name in f.elements("s")}
    targets = [name for f in state for _, name in f.elements("s")]
    targets += [name for f in outputs for _, name in f.elements("out")]

    def body(values: list[int], at_hand: dict[int, str]) -> list[str]:
        block = Block(graph, known | at_hand)
        block.make(values)
        return block.lines + _stores(block, targets, values)

    start, step = body(wanted[0], {}), body(wanted[1], before)
    used = set(graph.live(crossing))
    acting = [f for f in given if used & {v for v, _ in f.elements("p")}]
    own = helpers("\n".join([*prepare.lines, *start, *step]))
    return Code(
        acting, constants, state, inputs, outputs, prepare.lines, start, step, own
    )


def _stores(block: Block, targets: list[str], values: list[int]) -> list[str]:
    """Assignments at the end of a function; what they overwrite is read before."""
    lines, moves, written = [], [], set(targets)
    for i, (target, at) in enumerate(zip(targets, values, strict=True)):
        source = block.name(at)
        if source == target:
            continue
        if source in written:  # another field's number of before
            kind = block.graph.nodes[at].kind
            lines.append(f"    const {kind} was_{i} = {source};")
            source = f"was_{i}"
        moves.append(f"    {target} = {source};")
    return lines + moves


def _constant(called: Mapping[int, str], at: int, i: int) -> str:
    """A constant's name: the parameter's, or a number."""
    if at not in called:
        return f"k{i}"
    return re.sub(r"\W+", "_", called[at].removeprefix("p->")).strip("_")


def _crossing(graph: Graph, wanted: list[int]) -> list[int]:
    """What follows from the parameters alone, and is used by what does not."""
    order = graph.live(wanted)
    zones = graph.zone(order)
    out = {v for v in wanted if not zones[v]}
    for at in order:
        if zones.get(at, TICK) == PARAMETER:
            continue
        node = graph.nodes[at]
        uses = [*node.args]
        if node.op == "loop":
            uses += [*node.value.results]
        out |= {a for a in uses if a in zones and not zones[a]}
    return sorted(at for at in out if graph.nodes[at].op != "const")
