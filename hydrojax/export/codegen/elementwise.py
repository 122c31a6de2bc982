"""Operations of JAX that act on each element alone, as operations on nodes."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from hydrojax.errors import InputError
from hydrojax.export.codegen.graph import BOOL, DOUBLE, INT, Graph


def number_kind(dtype: Any) -> str:
    """The kind of number that an array's elements are."""
    if dtype == np.bool_:
        return BOOL
    return INT if np.issubdtype(dtype, np.integer) else DOUBLE


def select(graph: Graph, which: int, no: int, yes: int) -> int:
    """One of two nodes of a kind."""
    return graph.op("select", (which, no, yes), graph.nodes[no].kind)


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
            return select(graph, int(which), int(cases[0]), int(cases[1]))
        out = int(cases[-1])
        for i in reversed(range(len(cases) - 1)):
            here = graph.op("eq", (int(which), graph.const(i, INT)), BOOL)
            out = select(graph, here, out, int(cases[i]))
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
