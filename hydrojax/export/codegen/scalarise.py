"""A jaxpr as scalar operations: every element of every array becomes a node."""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from jax.extend.core import ClosedJaxpr, Jaxpr, Literal

from hydrojax.errors import InputError
from hydrojax.export.codegen.elementwise import ELEMENTWISE, number_kind, select
from hydrojax.export.codegen.graph import BOOL, INT, Graph
from hydrojax.export.codegen.indexing import INDEXING, Ids, mapped

UNROLLED = 8
"""Rounds up to which a loop is written out; longer ones stay loops."""


def constants(graph: Graph, value: Any) -> Ids:
    """An array of numbers as nodes."""
    array = np.asarray(value)
    flat = [graph.const(v, number_kind(array.dtype)) for v in array.ravel()]
    return np.array(flat, np.int64).reshape(array.shape)


def scalarise(graph: Graph, closed: ClosedJaxpr, args: Sequence[Ids]) -> list[Ids]:
    """The results of a jaxpr on arrays of nodes, which are added to the graph.

    Raises:
        InputError: an operation that has no form in C, by its name.
    """
    consts = [constants(graph, c) for c in closed.consts]
    return _run(graph, closed.jaxpr, consts, args)


def _run(
    graph: Graph, jaxpr: Jaxpr, consts: Sequence[Ids], args: Sequence[Ids]
) -> list[Ids]:
    known: dict[Any, Ids] = {}

    def read(atom: Any) -> Ids:
        if isinstance(atom, Literal):
            return constants(graph, np.asarray(atom.val))
        return known[atom]

    known.update(zip(jaxpr.constvars, consts, strict=True))
    known.update(zip(jaxpr.invars, args, strict=True))
    for eqn in jaxpr.eqns:
        known.update(
            zip(
                eqn.outvars,
                _equation(graph, eqn, [read(v) for v in eqn.invars]),
                strict=True,
            )
        )
    return [read(v) for v in jaxpr.outvars]


def _equation(graph: Graph, eqn: Any, args: list[Ids]) -> list[Ids]:
    name, params = eqn.primitive.name, eqn.params
    if name in CONTROL:
        return CONTROL[name](graph, params, args)
    for key in ("jaxpr", "call_jaxpr"):
        if key in params:
            inner = params[key]
            if isinstance(inner, ClosedJaxpr):
                return scalarise(graph, inner, args)
            return _run(graph, inner, (), args)
    if name in INDEXING:
        out = INDEXING[name](graph, params, args)
        return out if isinstance(out, list) else [out]
    if name in ELEMENTWISE:
        kind = number_kind(eqn.outvars[0].aval.dtype)
        made = ELEMENTWISE[name](graph, params, kind)
        if made is not None:
            return [mapped(made, *np.broadcast_arrays(*args))]
    raise InputError(
        f"c: the operation {name!r} has no form in C; write the effect or controller "
        "that uses it with other functions of jax.numpy"
    )


# -- control flow --


def _scan(graph: Graph, params: dict, args: list[Ids]) -> list[Ids]:
    n_consts, n_carry = params["num_consts"], params["num_carry"]
    consts, rest = args[:n_consts], args[n_consts:]
    carry, xs = rest[:n_carry], rest[n_carry:]
    length = params["length"]
    rounds = list(range(length))[:: -1 if params["reverse"] else 1]
    body = params["jaxpr"]
    n_ys = len(body.jaxpr.outvars) - n_carry
    if length > UNROLLED and not xs and not n_ys:
        return _looped(
            graph,
            carry,
            lambda c: (None, scalarise(graph, body, [*consts, *c])),
            length,
        )
    ys: list[Any] = [None] * length
    for i in rounds:
        out = scalarise(graph, body, [*consts, *carry, *(x[i] for x in xs)])
        carry, ys[i] = out[:n_carry], out[n_carry:]
    return [*carry, *(np.stack([y[k] for y in ys]) for k in range(n_ys))]


def _while(graph: Graph, params: dict, args: list[Ids]) -> list[Ids]:
    n_cond, n_body = params["cond_nconsts"], params["body_nconsts"]
    of_cond, of_body = args[:n_cond], args[n_cond : n_cond + n_body]

    def body(c: list[Ids]) -> tuple[Ids, list[Ids]]:
        (go,) = scalarise(graph, params["cond_jaxpr"], [*of_cond, *c])
        return go, scalarise(graph, params["body_jaxpr"], [*of_body, *c])

    return _looped(graph, args[n_cond + n_body :], body)


def _looped(
    graph: Graph,
    carry: Sequence[Ids],
    body: Callable[[list[Ids]], tuple[Ids | None, list[Ids]]],
    count: int | None = None,
) -> list[Ids]:
    shapes = [c.shape for c in carry]
    ends = np.cumsum([c.size for c in carry])[:-1]

    def arrays(flat: Sequence[int]) -> list[Ids]:
        parts = np.split(np.array(flat, np.int64), ends)
        return [p.reshape(s) for p, s in zip(parts, shapes, strict=True)]

    def flat(values: Sequence[Ids]) -> list[int]:
        return [int(v) for a in values for v in a.ravel()]

    def scalar(flat_carry: list[int]) -> tuple[int | None, list[int]]:
        go, out = body(arrays(flat_carry))
        return (None if go is None else int(go)), flat(out)

    return arrays(graph.loop(flat(carry), scalar, count))


def _cond(graph: Graph, params: dict, args: list[Ids]) -> list[Ids]:
    """Every branch, and of each result the one that is chosen."""
    index, rest = args[0], args[1:]
    outs = [scalarise(graph, branch, rest) for branch in params["branches"]]
    chosen = outs[-1]
    for i in reversed(range(len(outs) - 1)):
        here = graph.op("eq", (int(index), graph.const(i, INT)), BOOL)
        pick = functools.partial(select, graph, here)
        both = zip(chosen, outs[i], strict=True)
        chosen = [mapped(pick, *each) for each in both]
    return chosen


CONTROL = {"scan": _scan, "while": _while, "cond": _cond}
