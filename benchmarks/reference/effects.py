# ruff: noqa: E501  (lines of the page)
"""The page of the effects: law, picture, sizes, look-alikes and how to tell."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

from benchmarks.reference.known import KNOWN, MEASURED
from benchmarks.reference.markdown import HEADS, doc, rows, table
from hydrojax.effects import EFFECTS
from hydrojax.parameters import Spec, specs
from hydrojax.plant.effect import Effect
from hydrojax.report.text import engineering

SAID = """\
What a trace can add to the model, and a rig file declare under `[effects.NAME]`. Strengths
are zero where an effect is absent; the other parameters are its shape. `scale` is the unit in
which a fit steps: about the least that matters.

The pictures are of one simulated log: a differential cylinder of 12.5 and 9 cm², 14 MPa,
force of 800 N RMS, motion of up to 20 mm/s, replayed in windows of 0.25 s as `identify` and
`trace` do. Grey is what the effect leaves to a model without it, and blue what is left once
the declared parameters are refitted (valve constants, bulk modulus, friction): only that can
give an effect away. Effects on flows move a pressure's *rate*, which is drawn at the right.
Look-alikes are those that reproduce at least half of the blue, squared, in this log; in
yours it may be more or less. `python -m benchmarks.reference.signatures` draws and
measures all of it.
"""
"""What stands above the effects."""


def effects_page() -> str:
    """Every effect: law, picture, where it acts, what it needs and looks like."""
    measured = json.loads(MEASURED.read_text(encoding="utf-8"))
    parts = ["# Effects\n", SAID]
    for name, kind in EFFECTS.items():
        parts += [f"## {name}\n", doc(kind) + "\n"]
        parts.append(table(HEADS, rows(specs(kind))))
        parts.append(_picture(kind, measured[name]))
        needs = ", ".join(f"`{n}`" for n in kind.needs)
        facts = [
            f"- **Usual size:** {KNOWN[name].usual}.",
            f"- **Acts at:** {kind.place}; a log must have {needs}. In a report its "
            f"residual is drawn against `{kind.residual_axis}`.",
            f"- **Look-alikes:** {_alike(name, measured[name])}",
            f"- **How to tell:** {KNOWN[name].tell}",
        ]
        parts.append("\n".join(facts) + "\n")
    return "\n".join(parts)


def _alike(name: str, measured: Mapping[str, Any]) -> str:
    """What else would take the residual, and the command that separates them."""
    shares = measured["look_alikes"]
    axis = EFFECTS[name].residual_axis
    near = [n for n, k in EFFECTS.items() if k.residual_axis == axis and n != name]
    said = [f"[`{n}`](#{n}) ({100 * s:.0f} %)" for n, s in shares.items()]
    if not said:
        rest = ", ".join(f"[`{n}`](#{n})" for n in near)
        also = f" Others that show against `{axis}`: {rest}." if rest else ""
        return f"none takes half of its squared residual in this log.{also}"
    other = next(iter(shares))
    return (
        f"{', '.join(said)} of its squared residual. `hydrojax excite RIG --separate "
        f"{name} {other}` designs the run that tells them apart."
    )


def _picture(kind: type[Effect], measured: Mapping[str, Any]) -> str:
    """The picture of an effect, and its caption."""
    spec, at = specs(kind), KNOWN[kind.name].at
    sizes = ", ".join(f"{n} = {_size(v, spec[n])}" for n, v in at.items())
    times = ", ".join(f"{v:.2g} in {c}" for c, v in measured["over_noise"].items())
    taken = 100 * (1 - measured["left_by_refit"] ** 2)
    return (
        f"![Residual that {kind.name} leaves, over time and against its axis]"
        f"(effects/{kind.name}.png)\n\n"
        f"*{sizes}. Refitting the declared parameters takes {taken:.0f} % of the squared "
        f"residual; what is left is, in units of the noise, {times}.*\n"
    )


def _size(value: float, spec: Spec) -> str:
    """A strength with its unit, as a rig file has it."""
    if spec.outside and value:
        value, unit = 1 / value, spec.outside[1]
    else:
        unit = spec.unit
    factor, shown = engineering(value, unit.replace("{u}", "V"))
    return f"{value / factor:.3g} {shown}".strip()
