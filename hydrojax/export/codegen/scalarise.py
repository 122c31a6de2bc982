"""A jaxpr as scalar operations: every element of every array becomes a node."""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from jax.extend.core import ClosedJaxpr, Jaxpr, Literal

from hydrojax.errors import InputError
from hydrojax.export.codegen.graph import BOOL, DOUBLE, INT, Graph
from hydrojax.export.codegen.indexing import INDEXING, Ids, mapped

UNROLLED = 8
"""Rounds up to which a loop is written out; longer ones stay loops."""


def kind_of(dtype: Any) -> str:
    """The kind of number that an array's elements are."""
    if dtype == np.bool_:
        return BOOL
    return INT if np.issubdtype(dtype, np.integer) else DOUBLE


def constants(graph: Graph, value: Any) -> Ids:
    """An array of numbers as nodes."""
    array = np.asarray(value)
    flat = [graph.const(v, kind_of(array.dtype)) for v in array.ravel()]
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
        kind = kind_of(eqn.outvars[0].aval.dtype)
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
        pick = functools.partial(_select, graph, here)
        both = zip(chosen, outs[i], strict=True)
        chosen = [mapped(pick, *each) for each in both]
    return chosen


CONTROL = {"scan": _scan, "while": _while, "cond": _cond}


def _select(graph: Graph, which: int, no: int, yes: int) -> int:
    return graph.op("select", (which, no, yes), graph.nodes[no].kind)


# -- element by element --

Elementwise = Callable[[Graph, dict, str], Callable[..., int] | None]


def _plain(name: str, integer: str = "", boolean: str = "") -> Elementwise:
    """The operation of the same name, or that on integers or booleans."""

    def of(graph: Graph, params: dict, kind: str) -> Callable[..., int] | None:
        def made(*args: int) -> int:
            given = graph.nodes[args[0]].kind
            op = {INT: integer, BOOL: boolean}.get(given, name)
            if not op:
                raise InputError(f"c: {name!r} of {given} has no form in C")
            return graph.op(op, tuple(int(a) for a in args), kind)

        return made

    return of


def _power(graph: Graph, params: dict, kind: str) -> Callable[..., int]:
    """A whole power as products, by squaring."""
    times = "imul" if kind == INT else "mul"

    def made(x: int) -> int:
        n, square, out = abs(params["y"]), int(x), None
        while n:
            if n & 1:
                out = square if out is None else graph.op(times, (out, square), kind)
            n >>= 1
            if n:
                square = graph.op(times, (square, square), kind)
        if out is None:
            return graph.const(1, kind)
        if params["y"] > 0:
            return out
        return graph.op("div", (graph.const(1.0, kind), out), kind)

    return made


def _convert(graph: Graph, params: dict, kind: str) -> Callable[..., int]:
    def made(x: int) -> int:
        if kind == BOOL and graph.nodes[x].kind != BOOL:
            zero = graph.const(0, graph.nodes[x].kind)
            return graph.op("ne", (int(x), zero), BOOL)
        return graph.op("convert", (int(x),), kind)

    return made


def _bitcast(graph: Graph, params: dict, kind: str) -> Callable[..., int]:
    def made(x: int) -> int:
        if graph.nodes[x].kind == kind:
            return int(x)
        return graph.op("number" if kind == DOUBLE else "bits", (int(x),), kind)

    return made


def _choice(graph: Graph, params: dict, kind: str) -> Callable[..., int]:
    def made(which: int, *cases: int) -> int:
        if graph.nodes[which].kind == BOOL:
            return _select(graph, int(which), int(cases[0]), int(cases[1]))
        out = int(cases[-1])
        for i in reversed(range(len(cases) - 1)):
            here = graph.op("eq", (int(which), graph.const(i, INT)), BOOL)
            out = _select(graph, here, out, int(cases[i]))
        return out

    return made


def _clamp(graph: Graph, params: dict, kind: str) -> Callable[..., int]:
    most, least = ("max", "min") if kind == DOUBLE else ("imax", "imin")

    def made(low: int, x: int, high: int) -> int:
        inner = graph.op(least, (int(x), int(high)), kind)
        return graph.op(most, (inner, int(low)), kind)

    return made


def _round(graph: Graph, params: dict, kind: str) -> Callable[..., int]:
    even = int(params["rounding_method"]) == 1
    return lambda x: graph.op("round" if even else "round_away", (int(x),), kind)


def _of(formula: Callable[..., int]) -> Elementwise:
    """An operation that is a formula of others: `formula(op, number, x)`."""

    def of(graph: Graph, params: dict, kind: str) -> Callable[..., int]:
        def op(name: str, *args: int) -> int:
            return graph.op(name, args, kind)

        return lambda x: formula(op, lambda v: graph.const(v, kind), int(x))

    return of


_SAME = _of(lambda op, number, x: x)

ELEMENTWISE: dict[str, Elementwise] = {
    "add": _plain("add", "iadd"), "add_any": _plain("add", "iadd"),
    "sub": _plain("sub", "isub"), "mul": _plain("mul", "imul"),
    "div": _plain("div", "idiv"), "rem": _plain("rem", "irem"),
    "neg": _plain("neg", "ineg"), "abs": _plain("abs", "iabs"),
    "sign": _plain("sign", "isign"),
    "max": _plain("max", "imax", "or"), "min": _plain("min", "imin", "and"),
    "and": _plain("and", "iand", "and"), "or": _plain("or", "ior", "or"),
    "xor": _plain("xor", "ixor", "xor"), "not": _plain("not", "inot", "not"),
    **{n: _plain(n, n, n) for n in ("lt", "le", "gt", "ge", "eq", "ne")},
    "lt_to": _plain("lt", "lt", "lt"), "le_to": _plain("le", "le", "le"),
    "shift_right_arithmetic": _plain("", "shift_right"),
    "shift_right_logical": _plain("", "shift_zeros"),
    "shift_left": _plain("", "shift_left"),
    **{
        n: _plain(n)
        for n in (
            "floor", "ceil", "is_finite", "sqrt", "rsqrt", "pow", "atan2", "exp",
            "exp2", "expm1", "log", "log1p", "cbrt", "sin", "cos", "tan", "asin",
            "acos", "atan", "sinh", "cosh", "tanh", "asinh", "acosh", "atanh", "erf",
            "erfc",
        )
    },
    "round": _round, "integer_pow": _power, "convert_element_type": _convert,
    "bitcast_convert_type": _bitcast, "select_n": _choice, "clamp": _clamp,
    "stop_gradient": _SAME, "copy": _SAME, "copy_p": _SAME, "reduce_precision": _SAME,
    "optimization_barrier": _SAME,
    "square": _of(lambda op, number, x: op("mul", x, x)),
    "logistic": _of(
        lambda op, number, x: op(
            "div", number(1), op("add", number(1), op("exp", op("neg", x)))
        )
    ),
}  # fmt: skip
"""Operations of JAX that act on each element alone."""
