"""Ways to damage a log or a rig file, each drawn by a seeded generator."""

from __future__ import annotations

import json
import random
import re
from collections.abc import Callable, Sequence

import numpy as np
import pandas as pd

HARM = (
    "../../../escape",
    "<script>alert(1)</script>",
    "{{ 7*7 }}",
    "=cmd|' /C calc'!A0",
)
"""Text that must stay text."""

# -- bytes and text --


def flip(text: bytes, r: random.Random) -> bytes:
    """Some bytes become others."""
    out = bytearray(text)
    for _ in range(r.choice((1, 3, 30))):
        out[r.randrange(len(out))] = r.randrange(256)
    return bytes(out)


def drop(text: bytes, r: random.Random) -> bytes:
    """A run of bytes is lost."""
    at, size = r.randrange(len(text)), r.choice((1, 7, 100, 5000))
    return text[:at] + text[at + size :]


def cut(text: bytes, r: random.Random) -> bytes:
    """The file ends early."""
    return text[: r.randrange(len(text))]


def repeat(text: bytes, r: random.Random) -> bytes:
    """A run of bytes comes twice."""
    at, size = r.randrange(len(text)), r.choice((1, 20, 3000))
    return text[: at + size] + text[at:]


def insert(text: bytes, r: random.Random) -> bytes:
    """Foreign bytes come in."""
    what = r.choice((
        b"\0", b"\xff\xfe", b"\r\n", b'"', b",", b"\n\n", b"#", b"[" * 400, b"9" * 400,
        "é".encode(), "−".encode(), b"\x1a", b"'",
    ))  # fmt: skip
    at = r.randrange(len(text))
    return text[:at] + what + text[at:]


def recode(text: bytes, r: random.Random) -> bytes:
    """Another encoding or line end, which should do no harm, or be refused."""
    kind = r.choice(("utf-16", "utf-8-sig", "crlf", "cr"))
    if kind == "crlf":
        return text.replace(b"\n", b"\r\n")
    if kind == "cr":
        return text.replace(b"\n", b"\r")
    return text.decode("utf-8", "replace").encode(kind)


BYTES = (flip, drop, cut, repeat, insert, recode)

# -- tables --

Table = dict[str, list[str]]
"""Cells as text, by heading."""


def _some(table: Table, r: random.Random) -> str:
    return r.choice(list(table))


def _numbers(cells: Sequence[str]) -> np.ndarray:
    return pd.to_numeric(pd.Series(cells), errors="coerce").to_numpy(float, copy=True)


def _text(values: np.ndarray) -> list[str]:
    return [f"{v:.10g}" for v in values]


def odd_cells(table: Table, r: random.Random) -> None:
    """Cells hold what is no number, or no sound one."""
    cells = table[_some(table, r)]
    what = r.choice((
        "nan", "", "inf", "-inf", "1e308", "1e-320", "1,5", "abc", "--", "0x1F",
        "1e400", "True", "NULL", "2026-11-20", "9" * 50, "1_000",
    ))  # fmt: skip
    for _ in range(r.choice((1, 5, len(cells) // 3))):
        cells[r.randrange(len(cells))] = what


def heading(table: Table, r: random.Random) -> None:
    """A heading is changed."""
    name = _some(table, r)
    plain, _, unit = name.partition(" ")
    units = ("furlong", "Pa", "V", "kN", "MPa", "deg", "ms", "", "__import__('os')")
    new = r.choice((
        *(f"{plain} [{u}]" for u in units), plain, "", f"{plain} [m", f" {name} ",
        f"{plain.upper()} {unit}", r.choice(HARM),
    ))  # fmt: skip
    items = [(new if k == name else k, v) for k, v in table.items()]
    table.clear()
    table.update(items)


def swap(table: Table, r: random.Random) -> None:
    """Two columns trade places."""
    a, b = _some(table, r), _some(table, r)
    table[a], table[b] = table[b], table[a]


def lose(table: Table, r: random.Random) -> None:
    """A column is missing."""
    del table[_some(table, r)]


def spoil(table: Table, r: random.Random) -> None:
    """A whole signal is wrong: at rest, scaled, turned round, drowned in noise."""
    name = _some(table, r)
    y = _numbers(table[name])
    kind = r.choice(
        ("rest", "scale", "turn", "noise", "stuck", "spikes", "steps", "late")
    )
    i, n = r.randrange(len(y)), len(y)
    known = y[np.isfinite(y)]
    scatter = float(np.std(known)) if known.size else 0.0
    if kind == "rest":
        y[:] = y[i]
    elif kind == "scale":
        y = y * r.choice((0.0, 1e-3, 1e3, 1e6, 1e300))
    elif kind == "turn":
        y = -y
    elif kind == "noise":
        y = y + np.random.default_rng(i).normal(size=n) * (scatter + 1e-9)
    elif kind == "stuck":
        y[i:] = y[i]
    elif kind == "spikes":
        y[:: max(n // r.choice((3, 30)), 1)] += r.choice((-1, 1)) * 1e3 * scatter
    elif kind == "steps":
        step = scatter + 1e-9
        y = np.round(y / step) * step
    else:
        y = np.roll(y, r.choice((-40, 40)))
    table[name] = _text(y)


def rows(table: Table, r: random.Random) -> None:
    """Rows are lost, doubled, or in another order."""
    n = len(next(iter(table.values())))
    kind = r.choice(("few", "gap", "twice", "swap", "back", "shuffle", "thin", "none"))
    order = list(range(n))
    i = r.randrange(n)
    if kind == "few":
        order = order[: r.choice((1, 3, 60, 400))]
    elif kind == "gap":
        del order[i : i + r.choice((1, 50, 1000))]
    elif kind == "twice":
        order.insert(i, i)
    elif kind == "swap":
        j = r.randrange(n)
        order[i], order[j] = order[j], order[i]
    elif kind == "back":
        order.reverse()
    elif kind == "shuffle":
        r.shuffle(order)
    elif kind == "thin":
        order = order[:: r.choice((2, 7, 100))]
    else:
        order = []
    for name, cells in table.items():
        table[name] = [cells[k] for k in order]


def clock(table: Table, r: random.Random) -> None:
    """The time stamps are wrong."""
    name = next((k for k in table if k.startswith("time")), None)
    if name is None:
        return
    t = _numbers(table[name])
    kind = r.choice(("far", "fast", "slow", "jitter", "coarse", "jump", "fall"))
    i = r.randrange(len(t)) if len(t) else 0
    if kind == "far":
        t = t + 1.7e9
    elif kind == "fast":
        t = t * 1e-3
    elif kind == "slow":
        t = t * 1e3
    elif kind == "jitter":
        t = t + np.random.default_rng(i).normal(size=len(t)) * 2e-4
    elif kind == "coarse":
        t = np.round(t, 2)
    elif kind == "jump":
        t[i:] += 1e6
    else:
        t[i:] -= 1.0
    table[name] = [f"{v:.6f}" for v in t]


CELLS = (odd_cells, heading, swap, lose, spoil, rows, clock)


def damaged_log(text: bytes, r: random.Random) -> tuple[bytes, list[str]]:
    """A CSV with one to three damages, and their names."""
    said = []
    for _ in range(r.choice((1, 1, 2, 3))):
        if r.random() < 0.35:
            how = r.choice(BYTES)
            if len(text) > 1:
                text = how(text, r)
        else:
            how = r.choice(CELLS)
            lines = text.decode("utf-8", "replace").splitlines()
            names, *body = [line.split(",") for line in lines] or [[""]]
            sound = [row for row in body if len(row) == len(names)]
            table = {n: [row[i] for row in sound] for i, n in enumerate(names)}
            if table and sound:
                how(table, r)
            names = list(table)
            shown = [",".join(names), *map(",".join, zip(*table.values(), strict=True))]
            text = ("\n".join(shown) + "\n").encode()
        said.append(how.__name__)
    return text, said


# -- rig files --

VALUES = (
    "nan", "inf", "-inf", "0", "-1", "1e400", "true", "[]", "{}", "[[1]]", '""', '"Pa"',
    '"nan Pa"', '"inf N"', '"-5 N"', '"0 m^2"', '"1e300 Pa"', '"1e-300 m^2"',
    '"5 apples"', '"5 N*"', '"__import__(\'os\').system(\'true\')"', '"5**9**9 Pa"',
    '"5 Pa**9**9**9"', '"(1 Pa"', "1979-05-27", '"""', '"1 Pa" "2 Pa"',
    '{ start = "1 N" }', '{ range = ["1 N", "2 N"] }', '["1 N", "2 N"]', '"8e8 bar"',
    '{ start = "1 N", range = ["2 N"] }', '{ start = "1 N", range = "wide" }',
    '{ start = "1 N", range = ["0 N", "inf N"] }', '{ start = 3, range = [1, 2] }',
    '{ start = "9e8 Pa", range = ["9e8 Pa", "9e8 Pa"] }', *map(json.dumps, HARM),
)  # fmt: skip


def line_of(text: bytes, r: random.Random, change: Callable[[str], str]) -> bytes:
    """One line, not blank, changed."""
    lines = text.decode("utf-8", "replace").splitlines()
    full = [i for i, line in enumerate(lines) if line.strip()]
    if full:
        i = r.choice(full)
        lines[i] = change(lines[i])
    return ("\n".join(lines) + "\n").encode()


def value(text: bytes, r: random.Random) -> bytes:
    """A value becomes another kind of thing."""
    return line_of(text, r, lambda s: f"{s.partition('=')[0]}= {r.choice(VALUES)}")


def number(text: bytes, r: random.Random) -> bytes:
    """A number becomes another."""
    new = r.choice(
        ("0", "-1", "1e-9", "1e12", "1e300", "-1e300", "nan", "7,5", "1e", "٣")
    )
    return line_of(text, r, lambda s: re.sub(r"[-\d.]+(e[+-]?\d+)?", new, s, count=1))


def unit(text: bytes, r: random.Random) -> bytes:
    """A unit becomes another."""
    new = r.choice(
        ("", "N", "bar", "Pa", "m", "m^2", "parsec", "V", "Pa*", "degC", "dB", "s")
    )
    return line_of(text, r, lambda s: re.sub(r' [A-Za-z][^"]*"', f' {new}"', s))


def line(text: bytes, r: random.Random) -> bytes:
    """A line is lost, doubled, or new."""
    new = r.choice((
        "surprise = 1", "[effects.internal_leakage]\nc_il = 3", "[effects.stribeck]",
        "[channels]\nF = { column = \"psi [rad]\" }", "[load]\nmass = \"5 kg\"",
        "[channels]\nu = { column = \"/etc/passwd\", unit = \"V\" }", "[[parameters]]",
        "[channels]\nF = { column = \"F [N]\", unit = \"N\", invert = true }",
        "layout = \"single\"", "[controller]\nk_p = \"x\"", "[geometry]", "import os",
        "[effects.internal_leakage]\nc_il = { start = \"1e-13 m^3/(s*Pa)\", "
        "range = [\"0 m^3/(s*Pa)\", \"1e-11 m^3/(s*Pa)\"] }", "a.b.c.d = {e = [1, {}]}",
    ))  # fmt: skip
    how = r.choice((lambda s: "", lambda s: f"{s}\n{s}", lambda s: f"{s}\n{new}"))
    return line_of(text, r, how)


LINES = (value, number, unit, line)


def damaged_rig(text: bytes, r: random.Random) -> tuple[bytes, list[str]]:
    """A rig file with one or two damages, and their names."""
    said = []
    for _ in range(r.choice((1, 1, 2))):
        how = r.choice(LINES if r.random() < 0.7 else BYTES)
        if len(text) > 1:
            text = how(text, r)
        said.append(how.__name__)
    return text, said
