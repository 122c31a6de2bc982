# ruff: noqa: E501  (lines of the pages)
"""The reference pages of the documentation, from the declarations in the code.

`python -m benchmarks.reference` writes them; a test says when they are stale.
"""

from __future__ import annotations

import inspect
import json
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import typer

from hydrojax import cli
from hydrojax.effects import EFFECTS
from hydrojax.logs.tables import SIGNALS, TABLES
from hydrojax.parameters import Spec, specs
from hydrojax.plant.chambers import Chambers
from hydrojax.plant.friction import Friction
from hydrojax.plant.layout import LAYOUTS
from hydrojax.plant.valve import MeteringEdges
from hydrojax.report.schema import Report, report_schema
from hydrojax.rigfile.controller import KEYS, PAPER, written_unit
from hydrojax.rigfile.json_schema import KEY_MEANINGS, MEANINGS, rig_schema
from hydrojax.rigfile.sections import GEOMETRY, LOAD, SUPPLY_UNITS

FOLDER = Path(__file__).parents[1] / "docs/reference"

MODEL = """\
Numbers in parentheses are the paper's. Signs: a positive `u` fills chamber 1, a positive `P`
pushes toward positive `v`, and chamber 1 shrinks as `x` grows.

```text
flows         q_1 = c_p1 u √(P_s − P_a1)   u > 0,   c_n1 u √(P_a1 − P_r)   u < 0     (12)
              q_2 = −c_n2 u √(P_a2 − P_r)  u > 0,  −c_p2 u √(P_s − P_a2)   u < 0     (13)
lengths       x_1 = l/2 + delta_1 − x,   x_2 = l/2 + delta_2 + x                 (10)(11)
pressures     dP_a1/dt = beta/x_1 (q_1/A_1 + v)                                      (14)
              dP_a2/dt = beta/x_2 (q_2/A_2 − v)                                      (15)
drive force   P = A_2 P_a2 − A_1 P_a1                                                (16)
output force  F = P − f_f                                                            (22)
bristle       dz/dt = v − |v| z / z_ss                                                (4)
friction      f_f: Coulomb levels k_cp, k_cn and offset k_0, carried by z / z_ss; k_vp, k_vn
              with speed; presliding k_fp, k_fn with phi(F) = F/(1 + delta |F|)    (1)-(7)
switch        L = 1/(1 + (L_slope w)^3),   dw/dt = L_rate (|v| − w)
```
"""
"""The model in equations, by the names of the parameters."""


def pages() -> dict[str, str]:
    """The reference pages and schemas by file name."""
    return {
        "parameters.md": parameters_page(),
        "effects.md": effects_page(),
        "rig_file.md": rig_file_page(),
        "commands.md": commands_page(),
        "report.md": report_page(),
        "rig.schema.json": json.dumps(rig_schema(), indent=1) + "\n",
        "report.schema.json": json.dumps(report_schema(), indent=1) + "\n",
    }


def _table(heads: tuple[str, ...], rows: Iterator[tuple[str, ...]]) -> str:
    """A table in Markdown."""
    lines = [heads, tuple("---" for _ in heads), *rows]
    cells = (
        " | ".join(c.replace("|", "\\|").replace("\n", " ") for c in r) for r in lines
    )
    return "\n".join(f"| {line} |" for line in cells) + "\n"


def _unit(unit: str) -> str:
    return "–" if unit == "1" else f"`{unit.replace('{u}', 'V')}`"


def _rows(known: Mapping[str, Spec]) -> Iterator[tuple[str, ...]]:
    """Parameters as rows: key, unit, range, default or usual size, meaning."""
    for name, s in known.items():
        also = f" or `{s.outside[0]}`" if s.outside else ""
        usual = s.size if s.size is not None else s.default
        limits = f"{s.lower:.3g} to {s.upper:.3g}"
        yield (f"`{name}`{also}", _unit(s.unit), limits, f"{usual:.3g}", s.description)


HEADS = ("key", "unit", "limits", "usual size", "meaning")


def _doc(thing: object) -> str:
    """A docstring as Markdown."""
    text = inspect.cleandoc(getattr(thing, "__doc__", "") or "")
    return text.split("\n\nAttributes:")[0].split("\n\nArgs:")[0]


def parameters_page() -> str:
    """Every parameter of the base model, and the model in equations."""
    parts = ["# Parameters\n", MODEL]
    groups = {"Valve": MeteringEdges, "Chambers": Chambers, "Friction": Friction}
    for title, kind in groups.items():
        parts += [f"## {title}\n", _doc(kind).split("\n\n")[0] + "\n"]
        parts.append(_table(HEADS, _rows(specs(kind))))
    parts.append(
        "`V` in a unit is the unit of the command: leave it out where `u` is a fraction of "
        "full opening. `hydrojax init` drafts a start and a range for each from your log.\n"
    )
    return "\n".join(parts)


def effects_page() -> str:
    """Every effect: its law, where it acts, what it needs and looks like."""
    parts = ["# Effects\n", "What a trace can add to the model, and a rig file declare "
             "under `[effects.NAME]`. Strengths are zero where an effect is absent; the "
             "other parameters are its shape.\n"]  # fmt: skip
    axes: dict[str, list[str]] = {}
    for name, kind in EFFECTS.items():
        axes.setdefault(kind.residual_axis, []).append(name)
    for name, kind in EFFECTS.items():
        others = [n for n in axes[kind.residual_axis] if n != name]
        alike = ", ".join(f"[`{n}`](#{n})" for n in others)
        needs = ", ".join(f"`{n}`" for n in kind.needs) or "nothing more"
        facts = [
            f"- acts at: {kind.place}",
            f"- a log must have: {needs}",
            f"- the residual stands out against `{kind.residual_axis}`",
        ]
        if others:
            facts.append(
                f"- others that do: {alike}. Where a report cannot tell two apart, "
                f"`hydrojax excite RIG --separate {name} {others[0]}` designs the run "
                "that does"
            )
        parts += [f"## {name}\n", _doc(kind) + "\n", "\n".join(facts) + "\n"]
        parts.append(_table(HEADS, _rows(specs(kind))))
    return "\n".join(parts)


def rig_file_page() -> str:
    """Every section and key of a rig file."""
    parts = ["# Rig file\n", "TOML. A quantity is text with its unit, `\"8e8 Pa\"`; any "
             "unit of the right dimension is accepted. `hydrojax init` drafts a file; "
             "[rig.schema.json](rig.schema.json) is its JSON schema.\n"]  # fmt: skip
    for name, said in MEANINGS.items():
        title = name if name in ("name", "layout") else f"[{name}]"
        parts += [f"## {title}\n", f"{said}\n"]
        parts.append(_section(name))
    return "\n".join(p for p in parts if p)


def _section(name: str) -> str:
    """The keys of one section."""
    wants = {"geometry": GEOMETRY, "supply": SUPPLY_UNITS, "load": LOAD}
    if name == "layout":
        rows = ((f"`{n}`", ", ".join(f"`{k}`" for k in layout.geometry) or "–",
                 ", ".join(layout.pressures) or "none")
                for n, layout in LAYOUTS.items())  # fmt: skip
        return _table(("layout", "geometry it needs", "pressures"), rows)
    if name in wants:
        rows = ((f"`{k}`", _unit(u), KEY_MEANINGS[f"{name}.{k}"])
                for k, u in wants[name].items())  # fmt: skip
        return _table(("key", "SI unit", "meaning"), rows)
    if name in ("channels", "sensors"):
        rows = ((f"`{k}`", _unit(u)) for k, u in SIGNALS.items())
        example = '`u = { column = "MainU", unit = "1", invert = true }`\n\n'
        own = example if name == "channels" else '`F = "2.5 N"`\n\n'
        return own + _table(("signal", "SI unit"), rows)
    if name == "controller":
        rows = ((f"`{k}`", _unit(written_unit(k)),
                 f"{PAPER[k]:g}" if k in PAPER else "–",
                 g.description + ("; one value, or two bounds" if g.pair else ""))
                for k, g in KEYS.items())  # fmt: skip
        return _table(("key", "unit of a bare number", "default", "meaning"), rows)
    links = {
        "parameters": "[Every parameter](parameters.md). "
        '`beta = { start = "8e8 Pa", range = ["1e8 Pa", "3e9 Pa"] }`\n',
        "effects": "[Every effect](effects.md).\n",
    }
    return links.get(name, "")


def commands_page() -> str:
    """Every command with its arguments and options."""
    group: Any = typer.main.get_command(cli.app)
    parts = ["# Commands\n", "Exit status: 0 when the work was done, 2 on bad input with "
             "one line, 1 where `--fail-on` says so. Logs are "
             + ", ".join(f"`{e}`" for e in TABLES)
             + ", `.mcap` or a ROS 2 bag's folder. `hydrojax --install-completion` sets "
             "up completion for your shell.\n"]  # fmt: skip
    for name in sorted(group.commands):
        command = group.commands[name]
        parts += [f"## {name}\n", inspect.cleandoc(command.help or "") + "\n"]
        rows = (
            (f"`{_called(p)}`", _plain(getattr(p, "help", None)), _default(p))
            for p in command.params
        )
        parts.append(_table(("argument or option", "meaning", "default"), rows))
    return "\n".join(parts)


def _plain(text: str | None) -> str:
    """A help text, of which Markdown takes nothing for emphasis."""
    return re.sub(r"([*_<\[\]])", r"\\\1", text or "–")


def _called(parameter: Any) -> str:
    """What a parameter of a command is called on the line."""
    if parameter.param_type_name == "argument":
        return (parameter.name or "").upper() + ("..." if parameter.nargs == -1 else "")
    return ", ".join(parameter.opts)


def _default(parameter: Any) -> str:
    if isinstance(parameter.show_default, str):
        return parameter.show_default
    value = parameter.default
    if callable(value) or value in (None, "", False) or value == ():
        return "–"
    return f"`{value}`"


def report_page() -> str:
    """Every key of report.json."""
    keys = Report.model_fields.items()
    rows = ((f"`{name}`", key.description or "") for name, key in keys)
    return "\n".join([
        "# report.json\n",
        "`identify` and `trace` write it beside the page. SI units; `null` is no finite "
        "number. Readers ignore keys that they do not know. "
        "[report.schema.json](report.schema.json) is its JSON schema.\n",
        _table(("key", "meaning"), rows),
    ])  # fmt: skip


def main() -> None:
    """Write the pages."""
    FOLDER.mkdir(exist_ok=True)
    for name, text in pages().items():
        (FOLDER / name).write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
