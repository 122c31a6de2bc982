"""A curve that was found as a Python file that `--effects` takes as it is."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from jaxtyping import Float

from hydrojax import units
from hydrojax.identify.discovery.formula import Formula
from hydrojax.identify.discovery.free_form import FACTORS, PISTON, ROUNDED, Term
from hydrojax.identify.results.curve import FoundCurve
from hydrojax.plant.turned import AGES

BASES = {
    "command": "CommandChannel",
    "flow": "FlowEffect",
    "compliance": "ComplianceEffect",
    "level": "LevelEffect",
    "friction": "FrictionForce",
    "hysteresis": "HysteresisForce",
    "force": "ForceEffect",
}
METHODS = {
    "compliance": ("compliance(self, P)", "{}"),
    "level": ("level(self, at, base)", "{}"),
    "friction": ("force(self, at)", "{}"),
    "hysteresis": ("force(self, w)", "{}"),
    "force": ("force(self, at)", "{}"),
}
SIGNALS = {
    **{name: f"at.{name}" for name in ("v", "x", "a", "t", "z", "since", "way")},
    **{f"age_{1e6 * D:.0f}um": f"at.ages[{i}]" for i, D in enumerate(AGES)},
    "F": "at.F",
    "u": "u",
    "back": "w",
    "behind": "behind",
    "w": "w",
    "level": "base",
    "P": "P",
    "P_mean": "(at.P_a1 + at.P_a2) / 2",
    "P_net": "at.P_a2 - at.P_a1",
    "P_a1": "at.P_a1",
    "P_a2": "at.P_a2",
}
FLOWING = {
    **{name: f"at.{name}" for name in ("v", "x", "t", "P_s")},
    "u": "spool",
    "P_net": "at.P_a2 - at.P_a1",
}
AXES = {
    "w": "x",
    "back": "u_rate",
    "behind": "u_rate",
    **{f"age_{1e6 * D:.0f}um": "v" for D in AGES},
    "since": "t",
    "way": "x",
    "P_mean": "P_a1 + P_a2",
    "P_net": "P_a1 - P_a2",
    "P": "P_a1 + P_a2",
}
"""What a residual is drawn against, by signal, where it is not the signal."""

OF_TURNS = list(PISTON)[list(PISTON).index("since") :]
"""Signals that are remembered where an effect asks for them."""

NAMES = ("logaddexp(", "exp(", "sign(", "maximum(", "minimum(", "sin(", "cos(", "tanh(",
         "abs(")  # fmt: skip
"""What a form's code calls."""

FAR = 600.0
"""Exponent up to which a form falls: beyond it the law would be exactly 0, and an
effect that is so where it is tried is refused."""


@dataclass(frozen=True)
class FoundLaw:
    """What is written: a term, its curve, and the formula that stands for it.

    Attributes:
        term: place and signal.
        knots: of the curve, and its `coefficients`, SI.
        seen: range of the signal on which it rests, `gaps` those in it without samples.
        formula: in its place, if one does as well.
        command: the command's unit.
    """

    term: Term
    knots: Float[np.ndarray, "n+4"]
    coefficients: Float[np.ndarray, "n"]
    seen: tuple[float, float]
    formula: Formula | None
    command: str = "V"
    gaps: tuple[tuple[float, float], ...] = ()

    @property
    def unit(self) -> str:
        """Of the curve."""
        return units.with_command(self.term.of, self.command)

    @property
    def signal_unit(self) -> str:
        """Of its signal."""
        return units.with_command(self.term.unit, self.command)

    @property
    def narrow(self) -> float:
        """Over how much of the signal a corner is rounded."""
        return float(f"{(self.seen[1] - self.seen[0]) / 50:.3g}")

    def says(self) -> str:
        """The formula with its values: `-3.1e4 N/(m/s)^2 * abs(v) * v`; or ""."""
        if self.formula is None:
            return ""
        f, by = self.formula, f" * {self.term.factor}" if self.term.factor else ""
        parts = []
        said = f.form.said or f.form.code
        for a, power, code in zip(f.amplitudes, f.form.powers, said, strict=True):
            text = _with_signal(code, self.term.signal)
            if f.shape is not None:
                text = text.replace("s_0", f"{f.shape:.4g} {self.signal_unit}")
            unit = over(self.unit, self.signal_unit, power)
            unit = "" if unit == "1" else f" {unit}"
            parts.append(f"{a:.4g}{unit}{by} * {text}")
        return " + ".join(parts).replace("+ -", "- ")


def _with_signal(code: str, signal: str) -> str:
    """A form's code with the signal's name for `s`."""
    out, word = "", ""
    for letter in f"{code}\0":
        if letter.isalnum() or letter in "_.":
            word += letter
            continue
        out += signal if word == "s" else word
        out += letter
        word = ""
    return out[:-1]


def effect_file(rig: str, curves: Sequence[FoundCurve]) -> str:
    """The text of a Python file that defines an effect for each curve."""
    names = {"Array", "param"} | {BASES[c.place] for c in curves}
    rig = rig.replace("\\", "/").replace('"', "'")  # it stands in a docstring
    if any("* curve(" in c.source for c in curves):
        names.add("curve")
    lines = [
        f'"""What the logs of {rig} hold beside the known effects.',
        "",
        "Found by `hydrojax.discover`; for `hydrojax trace --effects`.",
        '"""',
        "",
        "import jax.numpy as jnp",
        "",
        f"from hydrojax.effects import {', '.join(sorted(names, key=str.lower))}",
    ]
    return "\n".join(lines) + "\n" + "".join(c.source for c in curves)


def class_name(name: str) -> str:
    """Of the effect of this name, as Python writes names of classes."""
    return "".join(word.capitalize() for word in name.split("_"))


def effect_source(law: FoundLaw, name: str) -> str:
    """The class of an effect of this name, in Python."""
    term = law.term
    by = f" times {term.factor}" if term.factor else ""
    needs = '("u",)' if term.place in ("command", "flow", "compliance") else '("F",)'
    said = f"    {law.says()}" if law.formula else "    A curve, as found."
    return "\n".join(
        [
            "",
            "",
            f"class {class_name(name)}({BASES[term.place]}):",
            f'    """At {term.place}{by}, over {term.signal}, in {law.unit}.',
            "",
            said,
            "",
            *_rests_on(law),
            '    """',
            "",
            f'    name = "{name}"',
            f"    needs = {needs}",
            f'    residual_axis = "{AXES.get(term.signal, term.signal)}"',
            *(["    of_turns = True"] if term.signal in OF_TURNS else []),
            *_declared(law),
            "",
            *_law(law),
            "",
        ]
    )


def _rests_on(law: FoundLaw) -> list[str]:
    """Where an effect is what logs show, and where it is a guess: lines of its text."""
    unit = law.signal_unit

    def span(ends: tuple[float, float]) -> str:
        return "from {:.4g} to {:.4g} ".format(*ends) + unit

    means = f", {law.term.means}," if law.term.means else ""
    text = f"It rests on {law.term.signal}{means} {span(law.seen)}; "
    text += "beyond that it is extrapolated."
    if law.term.factor in FACTORS:
        text += f" {law.term.factor} is {FACTORS[law.term.factor]}."
    if law.gaps:
        text += f" Without samples, and a guess, {', '.join(map(span, law.gaps))}."
    return textwrap.wrap(text, 84, initial_indent="    ", subsequent_indent="    ")


def _declared(law: FoundLaw) -> list[str]:
    """The parameters of an effect."""
    f, term = law.formula, law.term
    if f is None:
        return [
            "    amount: Array = param(",
            '        "1", 0.0, -5.0, 5.0, "of the curve as found", strength=True, '
            "size=1.0",
            "    )",
            *_numbers("KNOTS", law.signal_unit, law.knots),
            *_numbers("COEFFICIENTS", law.unit, law.coefficients),
        ]
    lines = []
    for i, (a, power) in enumerate(zip(f.amplitudes, f.form.powers, strict=True)):
        size = float(f"{max(abs(a), 1e-300):.3g}")
        reach = float(f"{10 * size:.3g}")
        unit = over(term.of, term.unit, power)
        lines += [
            f"    a_{i + 1}: Array = param(",
            f'        "{unit}", 0.0, {-reach!r}, {reach!r}, "amplitude",',
            f"        strength=True, size={size!r},",
            "    )",
        ]
    if f.shape is not None:
        at = float(f"{f.shape:.4g}")
        low, high = at / 4, at * 4
        if f.form.signed:
            quarter = (law.seen[1] - law.seen[0]) / 4
            low, high = at - quarter, at + quarter
        low, high = (float(f"{end:.4g}") for end in (low, high))
        lines.append(
            f'    s_0: Array = param("{term.unit}", {at!r}, {low!r}, {high!r}, "shape")'
        )
    return lines


def _numbers(name: str, unit: str, values: Float[np.ndarray, "n"]) -> list[str]:
    """An array as a tuple of the class."""
    rows = [
        "        " + ", ".join(f"{v:.8g}" for v in values[i : i + 5]) + ","
        for i in range(0, len(values), 5)
    ]
    return [f"    {name} = (  # {unit}", *rows, "    )"]


@cache
def _algebra() -> Any:
    import pint  # slow to import

    registry = pint.UnitRegistry()
    registry.define("command = [command]")
    return registry


def over(unit: str, by: str, power: int) -> str:
    """A unit over a power of another, as a parameter writes it; `{u}` is the
    command's.
    """
    one, other = (_algebra().Unit(u.replace("{u}", "command")) for u in (unit, by))
    text = f"{one / other**power:~C}".replace("**", "^")
    return text.replace("command", "{u}") or "1"


def _law(law: FoundLaw) -> list[str]:
    """The method of an effect, and the curve that it calls."""
    if law.formula is None:
        body = "self.amount * curve(s, self.KNOTS, self.COEFFICIENTS)"
    else:
        wide = {"narrow": law.narrow, "sharp": law.narrow / 4}
        wide |= {"far": FAR, "farther": FAR + 1}
        terms = (
            f"self.a_{i + 1} * ({_jax(code.format(**wide))})"
            for i, code in enumerate(law.formula.form.code)
        )
        body = " + ".join(terms)
    lines = ["    def along(self, s):", f"        return {body}", ""]
    if law.term.place == "flow":
        return [*lines, *_flow(law.term)]
    if law.term.place == "command":
        return [*lines, *_command(law.term)]
    if law.term.slip:
        lines += ["    def reach(self):", f"        return {law.term.slip!r}  # m", ""]
    head, out = METHODS[law.term.place]
    factor = f"({SIGNALS[law.term.factor]}) * " if law.term.factor else ""
    call = f"{factor}self.along({SIGNALS[law.term.signal]})"
    return [*lines, f"    def {head}:", f"        return {out.format(call)}"]


def _command(term: Term) -> list[str]:
    """The methods of a channel that adds a curve to the command."""
    memory, lines = "memory", []
    if term.slip:
        end = f"{term.slip!r}"
        lines = [
            "        before, w = memory",
            "        w = w + u - before",
            f"        w = jnp.where(w > {end}, {end}, w)",
            f"        w = jnp.where(w < -{end}, -{end}, w)",
        ]
        memory = "(u, w)"
    elif term.tau:
        lines = [
            f"        fade = -jnp.expm1(-h / {term.tau!r})",
            f"        behind = (memory - u) * fade * {term.tau!r} / h",
        ]
        memory = "u + (memory - u) * (1 - fade)"
    begin = {"back": "u, 0 * u", "behind": "u"}.get(term.signal)
    return [
        *(["    def init(self, u):", f"        return {begin}", ""] if begin else []),
        "    def step(self, memory, u, h):",
        *lines,
        f"        return {memory}, u + self.along({SIGNALS[term.signal]})",
    ]


def _jax(code: str) -> str:
    """A law's Python with the names that an effect has."""
    for name in NAMES:
        code = code.replace(name, f"jnp.{name}")
    code = code.replace("logaddjnp.exp(", "logaddexp(")
    return code.replace("s_0", "self.s_0").replace(" pi ", " jnp.pi ")


def _heads(edges: Sequence[float]) -> list[str]:
    """By how much flows rise with the command, as `free_form.heads` has it."""
    c_p1, c_n1, c_p2, c_n2 = (f"{c:.6g}" for c in edges)
    text = f"""\
drops = (
    jnp.where(spool > 0, at.P_s - at.P_a1, at.P_a1 - at.P_r),
    jnp.where(spool > 0, at.P_a2 - at.P_r, at.P_s - at.P_a2),
)
edges = (
    jnp.where(spool > 0, {c_p1}, {c_n1}),
    jnp.where(spool > 0, {c_n2}, {c_p2}),
)
heads = [
    c * d * (d * d + {ROUNDED!r}) ** -0.25 for c, d in zip(edges, drops, strict=True)
]"""
    return textwrap.indent(text, " " * 8).splitlines()


def _flow(term: Term) -> list[str]:
    out = ["    def flow(self, at):"]
    filling = term.factor in ("filling", "emptying")
    through = term.factor in ("head", "through")
    if filling or through or term.signal == "u":
        out += [
            "        way = at.opening",
            "        spool = way[0] if len(way) == 1 else way[0] - way[1]",
        ]
    if through:
        out += _heads(term.edges)
    each = []
    for i, share in enumerate(term.share):
        factor = ""
        if filling:
            way = "spool" if (term.factor == "filling") == (i == 0) else "-spool"
            factor = f"jnp.maximum({way}, 0.0) * "
        elif through:
            by = "spool * " if term.factor == "through" else ""
            factor = f"{by}{('', '-')[i]}heads[{i}] * "
        elif term.factor:
            factor = f"({FLOWING[term.factor]}) * "
        signal = FLOWING.get(term.signal, f"at.P_a{i + 1}")
        times = {1.0: "", -1.0: "-"}.get(share, f"{share!r} * ")
        each.append(f"{times}{factor}self.along({signal})")
    return [
        *out,
        f"        return (\n            {each[0]},\n            {each[1]},\n        )",
    ]
