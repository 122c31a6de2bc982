"""Where elements go: what moves, gathers, sums and sorts them, on arrays of nodes."""

from __future__ import annotations

import functools
import itertools
from collections.abc import Callable, Sequence
from typing import Any

import jax
import numpy as np
from jax import lax

from hydrojax.errors import InputError
from hydrojax.export.codegen.graph import BOOL, DOUBLE, INT, Graph

Ids = np.ndarray


def _broadcast(graph: Graph, params: dict, args: list[Ids]) -> Ids:
    shape, dimensions = params["shape"], params["broadcast_dimensions"]
    wide = [1] * len(shape)
    for own, at in enumerate(dimensions):
        wide[at] = args[0].shape[own]
    return np.broadcast_to(args[0].reshape(wide), shape)


def _slice(graph: Graph, params: dict, args: list[Ids]) -> Ids:
    strides = params["strides"] or [1] * args[0].ndim
    limits = zip(params["start_indices"], params["limit_indices"], strides, strict=True)
    return args[0][tuple(slice(*s) for s in limits)]


def _split(graph: Graph, params: dict, args: list[Ids]) -> list[Ids]:
    return np.split(args[0], np.cumsum(params["sizes"])[:-1], params["axis"])


def _iota(graph: Graph, params: dict, args: list[Ids]) -> Ids:
    along = np.indices(params["shape"])[params["dimension"]]
    kind = DOUBLE if np.issubdtype(params["dtype"], np.floating) else INT
    return mapped(lambda v: graph.const(v, kind), along)


def _pad(graph: Graph, params: dict, args: list[Ids]) -> Ids:
    """By JAX itself, on the numbers of the nodes."""
    with jax.ensure_compile_time_eval():
        return np.asarray(lax.pad(args[0], args[1], params["padding_config"]))


def mapped(f: Callable[..., int], *arrays: Ids) -> Ids:
    """A function of nodes on every element of arrays of one shape."""
    columns = zip(*(a.ravel().tolist() for a in arrays), strict=True)
    return np.array([f(*each) for each in columns], np.int64).reshape(arrays[0].shape)


# -- elements whose place is known in C only --


def _linear(graph: Graph, terms: Sequence[tuple[int, int]], base: int) -> int:
    """`base + sum of index times stride` as a node."""
    at = graph.const(base, INT)
    for index, stride in terms:
        scaled = graph.op("imul", (index, graph.const(stride, INT)), INT)
        at = graph.op("iadd", (at, scaled), INT)
    return at


def _clamped(graph: Graph, index: int, most: int) -> int:
    low = graph.op("imax", (index, graph.const(0, INT)), INT)
    return graph.op("imin", (low, graph.const(most, INT)), INT)


def _look(graph: Graph, table: Ids, index: int) -> int:
    """An element of a table; not a number beyond its ends."""
    flat = [int(v) for v in table.ravel()]
    kind = graph.nodes[flat[0]].kind
    return graph.op("look", (index, *flat), kind)


def _strides(shape: Sequence[int]) -> list[int]:
    return [int(np.prod(shape[i + 1 :])) for i in range(len(shape))]


def _dynamic_slice(graph: Graph, params: dict, args: list[Ids]) -> Ids:
    table, starts = args[0], [int(a) for a in args[1:]]
    sizes, strides = params["slice_sizes"], _strides(args[0].shape)
    room = [n - s for n, s in zip(table.shape, sizes, strict=True)]
    first = [_clamped(graph, s, m) for s, m in zip(starts, room, strict=True)]
    terms = list(zip(first, strides, strict=True))
    out = [
        _look(graph, table, _linear(graph, terms, int(np.dot(at, strides))))
        for at in itertools.product(*(range(s) for s in sizes))
    ]
    return np.array(out, np.int64).reshape(sizes)


def _dynamic_update(graph: Graph, params: dict, args: list[Ids]) -> Ids:
    table, new, starts = args[0], args[1], [int(a) for a in args[2:]]
    room = [n - s for n, s in zip(table.shape, new.shape, strict=True)]
    first = [_clamped(graph, s, m) for s, m in zip(starts, room, strict=True)]
    out = table.copy()
    for at in np.ndindex(*table.shape):
        value = int(table[at])
        for of in np.ndindex(*new.shape):
            here = graph.const(True, BOOL)
            for start, place, offset in zip(first, at, of, strict=True):
                same = ("eq", (start, graph.const(place - offset, INT)), BOOL)
                here = graph.op("and", (here, graph.op(*same)), BOOL)
            kind = graph.nodes[value].kind
            value = graph.op("select", (here, value, int(new[of])), kind)
        out[at] = value
    return out


def _gather(graph: Graph, params: dict, args: list[Ids]) -> Ids:
    """As XLA defines it, one element of the result after the other."""
    table, indices = args
    numbers, sizes = params["dimension_numbers"], params["slice_sizes"]
    batch_of_table = tuple(numbers.operand_batching_dims)
    gone = {*numbers.collapsed_slice_dims, *batch_of_table}
    kept = [d for d in range(table.ndim) if d not in gone]
    window = [sizes[d] for d in kept]
    batch = indices.shape[:-1]
    clips = params["mode"] == lax.GatherScatterMode.CLIP
    strides = _strides(table.shape)
    out: dict[tuple[int, ...], int] = {}
    for b in np.ndindex(*batch):
        starts = list(zip(numbers.start_index_map, indices[b], strict=True))
        inside, terms = graph.const(True, BOOL), []
        for d, index in starts:
            index, room = int(index), table.shape[d] - sizes[d]
            if not clips:
                inside = _and_within(graph, inside, index, room)
            terms.append((_clamped(graph, index, room), strides[d]))
        fixed = sum(
            b[i] * strides[d]
            for d, i in zip(
                batch_of_table, numbers.start_indices_batching_dims, strict=True
            )
        )
        for w in np.ndindex(*window):
            base = fixed + sum(i * strides[d] for i, d in zip(w, kept, strict=True))
            value = _look(graph, table, _linear(graph, terms, base))
            out[(*b, *w)] = _or_fill(graph, params, clips, inside, value)
    found = np.array([out[at] for at in np.ndindex(*batch, *window)], np.int64)
    found = found.reshape((*batch, *window))
    places = numbers.offset_dims
    return np.moveaxis(found, range(len(batch), found.ndim), places)


def _and_within(graph: Graph, so_far: int, index: int, most: int) -> int:
    low = graph.op("ge", (index, graph.const(0, INT)), BOOL)
    high = graph.op("le", (index, graph.const(most, INT)), BOOL)
    return graph.op("and", (so_far, graph.op("and", (low, high), BOOL)), BOOL)


def _or_fill(graph: Graph, params: dict, clips: bool, inside: int, value: int) -> int:
    kind, fill = graph.nodes[value].kind, params["fill_value"]
    if clips or params["mode"] == lax.GatherScatterMode.PROMISE_IN_BOUNDS:
        return value
    if fill is None:
        fill = np.nan if kind == DOUBLE else np.iinfo(np.int64).min
    return graph.op("select", (inside, graph.const(fill, kind), value), kind)


# -- sums, products, orders --


def _fold(graph: Graph, op: str, integer: str, boolean: str) -> Callable[..., int]:
    def two(a: int, b: int) -> int:
        kind = graph.nodes[a].kind
        name = {INT: integer, BOOL: boolean}.get(kind, op)
        return graph.op(name, (int(a), int(b)), kind)

    return two


def _reduce(op: str, integer: str = "", boolean: str = "") -> Callable[..., Ids]:
    def of(graph: Graph, params: dict, args: list[Ids]) -> Ids:
        axes = tuple(params["axes"])
        kept = [d for d in range(args[0].ndim) if d not in axes]
        table = args[0].transpose(*kept, *axes)
        shape = table.shape[: len(kept)]
        rows = table.reshape(*shape, -1)
        two = _fold(graph, op, integer, boolean)
        out = [functools.reduce(two, rows[at]) for at in np.ndindex(*shape)]
        return np.array(out, np.int64).reshape(shape)

    return of


def _accumulate(op: str, integer: str) -> Callable[..., Ids]:
    def of(graph: Graph, params: dict, args: list[Ids]) -> Ids:
        table = np.moveaxis(args[0], params["axis"], 0)
        table = table[::-1] if params["reverse"] else table
        two, out = _fold(graph, op, integer, ""), [table[0]]
        for row in table[1:]:
            out.append(mapped(two, out[-1], row))
        done = np.stack(out)
        done = done[::-1] if params["reverse"] else done
        return np.moveaxis(done, 0, params["axis"])

    return of


def _arg(which: str) -> Callable[..., Ids]:
    """The first place of the largest or least element."""

    def of(graph: Graph, params: dict, args: list[Ids]) -> Ids:
        (axis,) = params["axes"]
        rows = np.moveaxis(args[0], axis, 0)

        def best(*column: int) -> int:
            value, at = column[0], graph.const(0, INT)
            for i, other in enumerate(column[1:], 1):
                beats = graph.op(which, (other, value), BOOL)
                at = graph.op("select", (beats, at, graph.const(i, INT)), INT)
                kind = graph.nodes[value].kind
                value = graph.op("select", (beats, value, other), kind)
            return at

        return mapped(best, *rows)

    return of


def _dot(graph: Graph, params: dict, args: list[Ids]) -> Ids:
    (contract_l, contract_r), (batch_l, batch_r) = params["dimension_numbers"]
    left, right = args
    free_l = [d for d in range(left.ndim) if d not in (*contract_l, *batch_l)]
    free_r = [d for d in range(right.ndim) if d not in (*contract_r, *batch_r)]
    a = left.transpose(*batch_l, *free_l, *contract_l)
    b = right.transpose(*batch_r, *free_r, *contract_r)
    n, inner = len(batch_l), len(contract_l)
    batch = a.shape[:n]
    rows, columns = a.shape[n : a.ndim - inner], b.shape[n : b.ndim - inner]
    a = a.reshape(*batch, int(np.prod(rows)), -1)
    b = b.reshape(*batch, int(np.prod(columns)), -1)
    add, times = _fold(graph, "add", "iadd", "or"), _fold(graph, "mul", "imul", "and")

    def product(row: Ids, column: Ids) -> int:
        terms = (times(x, y) for x, y in zip(row, column, strict=True))
        return functools.reduce(add, terms)

    out = [
        product(a[(*at, i)], b[(*at, j)])
        for at in np.ndindex(*batch)
        for i in range(a.shape[n])
        for j in range(b.shape[n])
    ]
    return np.array(out, np.int64).reshape((*batch, *rows, *columns))


def _sort(graph: Graph, params: dict, args: list[Ids]) -> list[Ids]:
    """By exchanging neighbours, which keeps the order of what is equal."""
    if params["num_keys"] != 1:
        raise InputError("c: a sort by several keys has no form in C; sort by one")
    tables = [np.moveaxis(a, params["dimension"], 0).copy() for a in args]
    n = tables[0].shape[0]
    for last in range(n - 1, 0, -1):
        for i in range(last):
            for at in np.ndindex(*tables[0].shape[1:]):
                key = (tables[0][(i + 1, *at)], tables[0][(i, *at)])
                swap = graph.op("lt", tuple(int(k) for k in key), BOOL)
                for t in tables:
                    a, b = int(t[(i, *at)]), int(t[(i + 1, *at)])
                    kind = graph.nodes[a].kind
                    t[(i, *at)] = graph.op("select", (swap, a, b), kind)
                    t[(i + 1, *at)] = graph.op("select", (swap, b, a), kind)
    return [np.moveaxis(t, 0, params["dimension"]) for t in tables]


INDEXING: dict[str, Callable[..., Any]] = {
    "reshape": lambda g, p, a: a[0].reshape(p["new_sizes"]),
    "squeeze": lambda g, p, a: a[0].squeeze(tuple(p["dimensions"])),
    "expand_dims": lambda g, p, a: np.expand_dims(a[0], tuple(p["dimensions"])),
    "transpose": lambda g, p, a: a[0].transpose(p["permutation"]),
    "rev": lambda g, p, a: np.flip(a[0], p["dimensions"]),
    "concatenate": lambda g, p, a: np.concatenate(a, p["dimension"]),
    "stack": lambda g, p, a: np.stack(a, p["axis"]),
    "broadcast_in_dim": _broadcast, "slice": _slice, "split": _split, "iota": _iota,
    "pad": _pad, "gather": _gather, "dynamic_slice": _dynamic_slice,
    "dynamic_update_slice": _dynamic_update, "dot_general": _dot, "sort": _sort,
    "reduce_sum": _reduce("add", "iadd"), "reduce_prod": _reduce("mul", "imul"),
    "reduce_max": _reduce("max", "imax", "or"),
    "reduce_min": _reduce("min", "imin", "and"),
    "reduce_and": _reduce("", "iand", "and"), "reduce_or": _reduce("", "ior", "or"),
    "cumsum": _accumulate("add", "iadd"), "cumprod": _accumulate("mul", "imul"),
    "cummax": _accumulate("max", "imax"), "cummin": _accumulate("min", "imin"),
    "argmax": _arg("gt"), "argmin": _arg("lt"),
}  # fmt: skip
"""Operations of JAX on whole arrays: `(graph, parameters, arguments)` to the result."""
