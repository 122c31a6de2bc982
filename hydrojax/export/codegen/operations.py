"""What each operation on numbers is: worked out here, and written in C99."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from scipy import special

C99: Mapping[str, str] = {
    "add": "{0} + {1}", "sub": "{0} - {1}", "mul": "{0} * {1}", "div": "{0} / {1}",
    "neg": "-{0}", "abs": "fabs({0})", "max": "{0} > {1} ? {0} : {1}",
    "min": "{0} < {1} ? {0} : {1}", "rem": "fmod({0}, {1})",
    "sign": "(double)(({0} > 0.0) - ({0} < 0.0))", "select": "{0} ? {2} : {1}",
    "lt": "{0} < {1}", "le": "{0} <= {1}", "gt": "{0} > {1}", "ge": "{0} >= {1}",
    "eq": "{0} == {1}", "ne": "{0} != {1}", "and": "{0} && {1}", "or": "{0} || {1}",
    "xor": "{0} != {1}", "not": "!{0}", "is_finite": "isfinite({0}) != 0",
    "floor": "floor({0})", "ceil": "ceil({0})", "round": "rint({0})",
    "round_away": "round({0})", "sqrt": "sqrt({0})", "rsqrt": "1.0 / sqrt({0})",
    "pow": "pow({0}, {1})", "atan2": "atan2({0}, {1})",
    "bits": "as_integer({0})", "number": "as_double({0})",
    "iadd": "{0} + {1}", "isub": "{0} - {1}", "imul": "{0} * {1}", "ineg": "-{0}",
    "idiv": "{0} / {1}", "irem": "{0} % {1}", "imax": "{0} > {1} ? {0} : {1}",
    "imin": "{0} < {1} ? {0} : {1}", "iabs": "{0} < 0 ? -{0} : {0}",
    "isign": "(int64_t)(({0} > 0) - ({0} < 0))",
    "iand": "{0} & {1}", "ior": "{0} | {1}", "ixor": "{0} ^ {1}", "inot": "~{0}",
    "shift_left": "(int64_t)((uint64_t){0} << {1})", "shift_right": "{0} >> {1}",
    "shift_zeros": "(int64_t)((uint64_t){0} >> {1})",
    **{
        name: f"{name}({{0}})"
        for name in (
            "exp", "exp2", "expm1", "log", "log1p", "cbrt", "sin", "cos", "tan", "asin",
            "acos", "atan", "sinh", "cosh", "tanh", "asinh", "acosh", "atanh", "erf",
            "erfc",
        )
    },
}  # fmt: skip
"""In place of `{0}` and `{1}` stand the arguments' names or numbers."""


def _truncated(quotient: Callable[[int, int], int]) -> Callable[..., int]:
    """Division of integers as C has it: toward zero."""
    return lambda a, b, _: quotient(abs(a), abs(b)) * (1 if (a < 0) == (b < 0) else -1)


FOLDED: dict[str, Callable[..., Any]] = {
    "add": lambda a, b, _: a + b, "sub": lambda a, b, _: a - b,
    "mul": lambda a, b, _: a * b, "div": lambda a, b, _: np.float64(a) / b,
    "neg": lambda a, _: -a, "abs": lambda a, _: abs(a),
    "max": lambda a, b, _: a if a > b else b, "min": lambda a, b, _: a if a < b else b,
    "rem": lambda a, b, _: np.fmod(a, b), "sign": lambda a, _: np.sign(a),
    "select": lambda p, a, b, _: b if p else a,
    "lt": lambda a, b, _: a < b, "le": lambda a, b, _: a <= b,
    "gt": lambda a, b, _: a > b, "ge": lambda a, b, _: a >= b,
    "eq": lambda a, b, _: a == b, "ne": lambda a, b, _: a != b,
    "and": lambda a, b, _: a and b, "or": lambda a, b, _: a or b,
    "xor": lambda a, b, _: a != b, "not": lambda a, _: not a,
    "is_finite": lambda a, _: math.isfinite(a),
    "floor": lambda a, _: np.floor(a), "ceil": lambda a, _: np.ceil(a),
    "round": lambda a, _: np.rint(a), "sqrt": lambda a, _: np.sqrt(a),
    "rsqrt": lambda a, _: 1 / np.sqrt(np.float64(a)),
    "round_away": lambda a, _: math.copysign(math.floor(abs(a) + 0.5), a),
    "pow": lambda a, b, _: np.power(np.float64(a), b),
    "atan2": lambda a, b, _: np.arctan2(a, b), "convert": lambda a, _: a,
    "bits": lambda a, _: np.float64(a).view(np.int64),
    "number": lambda a, _: np.int64(a).view(np.float64),
    "iadd": lambda a, b, _: a + b, "isub": lambda a, b, _: a - b,
    "imul": lambda a, b, _: a * b, "ineg": lambda a, _: -a,
    "idiv": _truncated(lambda a, b: a // b if b else -1),
    "irem": lambda a, b, _: math.copysign(1, a) * (abs(a) % abs(b)) if b else a,
    "imax": lambda a, b, _: max(a, b), "imin": lambda a, b, _: min(a, b),
    "iabs": lambda a, _: abs(a), "isign": lambda a, _: (a > 0) - (a < 0),
    "iand": lambda a, b, _: a & b, "ior": lambda a, b, _: a | b,
    "ixor": lambda a, b, _: a ^ b, "inot": lambda a, _: ~a,
    "shift_right": lambda a, b, _: a >> b,
    **{
        name: (lambda f: lambda a, _: f(np.float64(a)))(getattr(np, f"{long}"))
        for name, long in (
            *((n, n) for n in ("exp", "exp2", "expm1", "log", "log1p", "cbrt", "sin",
                               "cos", "tan", "sinh", "cosh", "tanh")),
            ("asin", "arcsin"), ("acos", "arccos"), ("atan", "arctan"),
            ("asinh", "arcsinh"), ("acosh", "arccosh"), ("atanh", "arctanh"),
        )
    },
    "erf": lambda a, _: special.erf(a), "erfc": lambda a, _: special.erfc(a),
}  # fmt: skip
"""Each operation on constants; last comes what the node holds beside its arguments."""
